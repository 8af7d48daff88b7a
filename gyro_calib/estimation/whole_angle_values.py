"""What follows from the slow flow of a whole-angle gyro, with covariance: rate, biases, scale factors, drive chain, damping and
stiffness axes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..device.operating_point import ftr_operating_point
from ..device.wave_point import wave_point
from ..quantity import Quantity
from .angle_drift import AngleDrift, damping_pattern
from .drive_chain import DriveChain, coupling_in_quadrature, drive_chain_of, physical_gain
from .separation import Deviations, PickoffFrame, Priors, angular_response, input_rate_times_kappa, solve_pickoff_frame
from .whole_angle_fit import WholeAngleEstimate

__all__ = ["Derived", "WholeAngleValues", "unit_of"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
_AXIS = {"x": 0, "y": 1}
#: azimuths over a period of 4 theta: exact means up to its 4th harmonic
_AZIMUTHS = 5
#: how well kappa is known where the factory does not say, relative (effects.md row 41: ppm); it is the whole scale factor of a free wave
KAPPA_SD = 20e-6
#: what enters the covariance besides the recordings: n, rho, r, eps, drive-gain ratio (separation), kappa, latency, fixed rate difference,
#: crosstalk in phase with 2 delta and with 2 lambda
NUISANCES = 10


@dataclass(frozen=True)
class Derived:
    """Everything derived from one parameter vector, by name, and the pick-off frame it used."""

    names: tuple[str, ...]
    values: FloatArray
    frame: PickoffFrame


class WholeAngleValues:
    """Derived values of an estimate and their propagation.

    Parameters
    ----------
    estimate : WholeAngleEstimate
    factory : mapping
        ``angular_gain_kappa`` and, if known, its sd, ``drive_gain_ratio_x_over_y``, ``fixed_rate_difference_rad_s`` and its sd.
    priors : Priors
    amplitude_v : float
        Of the mission.
    latency : Quantity
        Of the loops [s].
    compensation : ndarray, shape (2, 2)
        Drive compensation of the mission.
    quadrature : float
        That the loops hold, over the amplitude.
    with_wave : bool
        Also the whole-angle mission (slower: a steady state at several azimuths each time).
    """

    def __init__(
        self,
        estimate: WholeAngleEstimate,
        factory: Mapping[str, Any],
        priors: Priors,
        amplitude_v: float,
        latency: Quantity,
        compensation: FloatArray,
        *,
        quadrature: float = 0.0,
        with_wave: bool = True,
    ) -> None:
        self.estimate, self.priors, self.amplitude = estimate, priors, amplitude_v
        self.kappa = float(factory["angular_gain_kappa"])
        self._kappa_sd = _number(factory, "angular_gain_kappa_sd") or KAPPA_SD * self.kappa
        self._difference = _number(factory, "fixed_rate_difference_rad_s"), _number(factory, "fixed_rate_difference_sd_rad_s")
        ratio = _number(factory, "drive_gain_ratio_x_over_y")
        self.drive_ratio = ratio if ratio > 0.0 else None
        self._latency, self._compensation, self._quadrature, self._with_wave = latency, compensation, quadrature, with_wave
        self._extra = _cubic_forces(estimate.terms)
        deviations = Deviations.of(estimate.flow, priors)
        if estimate.rate_response is not None:
            size = abs(np.sqrt(np.linalg.det(estimate.rate_response)))
            spread = np.sqrt(np.diag(estimate.covariance))[-8:].reshape(4, 2) / size
            deviations = replace(deviations, rate_response=spread)
        self.deviations = deviations

    def derive(self, vector: FloatArray, nuisance: FloatArray) -> Derived:
        """Derived values of a parameter vector; ``nuisance`` in standard deviations, shape (:data:`NUISANCES`,)."""
        kappa = self.kappa + self._kappa_sd * nuisance[5]
        flow = self.estimate.flow
        v, turned = self.estimate.unpack(vector)
        own = vector[: flow.covariance.shape[0]]
        frame = solve_pickoff_frame(flow, own, self.deviations, self.drive_ratio, self.priors, nuisance[:5], turned)
        rate = input_rate_times_kappa(v.A, frame) / kappa - self._difference[0] - self._difference[1] * nuisance[7]
        at_rest = v.A - rate * angular_response(frame, kappa)
        named: dict[str, float] = {"rate": rate}
        named |= self._rebalance(at_rest, v.G, frame, kappa)
        if self._with_wave:
            latency_s = self._latency.value + self._latency.sd * nuisance[6]
            named |= self._free_wave(at_rest, v.G, v.E, kappa, latency_s, self._compensation)
        named |= {"pickoff_ratio": frame.ratio, "pickoff_phase": frame.phase_rad, "pickoff_non_orthogonality": 0.5 * frame.skew}
        named |= self._chains(v.G, frame, nuisance[8:10])
        named |= _axes(at_rest, frame)
        for matrix, name in ((v.A, "A"), (v.G, "G"), (v.E, "E")):
            for i, row in enumerate("xy"):
                for j, column in enumerate("xy"):
                    named[f"{name}_{row}{column}_re"] = float(matrix[i, j].real)
                    named[f"{name}_{row}{column}_im"] = float(matrix[i, j].imag)
        for i, row in enumerate("xy"):
            named[f"G_{row}{row}_abs"] = abs(v.G[i, i])
            named[f"decay_rate_{row}"] = -float(v.A[i, i].real)
        return Derived(tuple(named), np.array(list(named.values())), frame)

    def propagate(self, covariance: FloatArray) -> tuple[Derived, FloatArray]:
        """Derived values and their covariance under a covariance of the parameter vector, priors added, by central differences."""
        vector, zero = self.estimate.vector(), np.zeros(NUISANCES)
        here = self.derive(vector, zero)
        sd = np.sqrt(np.diag(covariance))
        columns = []
        for i in range(vector.size):
            step = np.zeros_like(vector)
            step[i] = sd[i]
            columns.append((self.derive(vector + step, zero).values - self.derive(vector - step, zero).values) / (2.0 * sd[i]))
        jacobian = np.column_stack(columns)
        out = jacobian @ covariance @ jacobian.T
        for i in range(NUISANCES):
            step = np.zeros(NUISANCES)
            step[i] = 1.0
            slope = 0.5 * (self.derive(vector, step).values - self.derive(vector, -step).values)
            out += np.outer(slope, slope)
        return here, out

    def at_rest(self, vector: FloatArray | None = None) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """A without the input rate, G and E of a parameter vector (default: the estimate)."""
        vector = self.estimate.vector() if vector is None else vector
        v, turned = self.estimate.unpack(vector)
        own, zero = vector[: self.estimate.flow.covariance.shape[0]], np.zeros(5)
        frame = solve_pickoff_frame(self.estimate.flow, own, self.deviations, self.drive_ratio, self.priors, zero, turned)
        rate = input_rate_times_kappa(v.A, frame) / self.kappa
        return v.A - rate * angular_response(frame, self.kappa), v.G, v.E

    def drift(self, compensation: FloatArray) -> AngleDrift:
        """Predicted drift of the mission against azimuth under a drive compensation, with covariance (recordings only)."""
        vector, covariance = self.estimate.vector(), self.estimate.covariance

        def harmonics(values: FloatArray) -> FloatArray:
            named = self._free_wave(*self.at_rest(values), self.kappa, self._latency.value, compensation)
            return np.array([named["wave_bias"], named["drift_cos_4theta"], named["drift_sin_4theta"]])

        return AngleDrift(harmonics(vector), _spread(harmonics, vector, covariance))

    def damping_pattern(self) -> tuple[DriveChain, FloatArray]:
        """What a compensation of drives and damping aims at (:func:`.damping_pattern`), and its covariance, shape (3, 3)."""

        def pattern(values: FloatArray) -> FloatArray:
            aim = damping_pattern(self.at_rest(values)[0])
            return np.array([aim.delta_g, aim.two_delta, aim.two_lambda])

        vector = self.estimate.vector()
        return DriveChain(*map(float, pattern(vector))), _spread(pattern, vector, self.estimate.covariance)

    def _rebalance(self, at_rest: ComplexArray, G: ComplexArray, frame: PickoffFrame, kappa: float) -> dict[str, float]:
        """Bias [rad/s] and scale factor [V/(rad/s)] of force to rebalance by oscillator axis, of the feedthrough-free sensor (Eq. 7)."""
        named = {}
        for axis, osc in _AXIS.items():
            point = ftr_operating_point(at_rest, G, np.zeros((2, 2), dtype=complex), self.amplitude, axis, extra=self._extra)
            gain = abs(G[1 - osc, 1 - osc])
            slope = kappa * self.amplitude * (frame.ratio / gain if axis == "x" else -1.0 / (frame.ratio * gain))
            named[f"bias_{axis}"], named[f"scale_{axis}"] = point.rate_channel_v / slope, slope
        return named

    def _free_wave(
        self, at_rest: ComplexArray, G: ComplexArray, E: ComplexArray, kappa: float, latency_s: float, compensation: FloatArray
    ) -> dict[str, float]:
        """Bias and scale factor of ``-2 theta'/kappa``: mean over the azimuth at rest; over whole turns, a turning wave shows the true
        angle whatever the pick-offs, so that only the latency of the loops is left in the scale factor. And the harmonics of the drift in 4
        theta.
        """
        angles = 2.0 * math.pi * np.arange(_AZIMUTHS) / _AZIMUTHS
        rates = np.array(
            [
                -2.0
                / self.kappa
                * wave_point(
                    at_rest,
                    G,
                    E,
                    self.amplitude,
                    0.25 * angle,
                    compensation=compensation,
                    latency_s=latency_s,
                    quadrature=self._quadrature,
                    extra=self._extra,
                ).theta_rate_rad_s
                for angle in angles
            ]
        )
        decay = -0.5 * float(np.trace(at_rest).real)
        return {
            "wave_bias": float(rates.mean()),
            "wave_scale": kappa / self.kappa / (1.0 + latency_s * decay),
            "drift_cos_4theta": 2.0 * float(np.mean(rates * np.cos(angles))),
            "drift_sin_4theta": 2.0 * float(np.mean(rates * np.sin(angles))),
        }

    def _chains(self, G: ComplexArray, frame: PickoffFrame, crosstalk: FloatArray) -> dict[str, float]:
        """Eq. 8 of the physical drive chain and as the controller sees it, and the virtual-precession gain [rad/s/V] of theta."""
        gain = physical_gain(G, frame, frame.rotation_rad)
        chain, seen = drive_chain_of(gain), drive_chain_of(G)
        # sum and difference of two couplings, each uncertain by as much as its part in quadrature
        aside = coupling_in_quadrature(gain) / math.sqrt(2.0)
        return {
            "delta_g": chain.delta_g,
            "two_delta": chain.two_delta + float(crosstalk[0]) * aside,
            "two_lambda": chain.two_lambda + float(crosstalk[1]) * aside,
            "delta_g_seen": seen.delta_g,
            "two_delta_seen": seen.two_delta,
            "two_lambda_seen": seen.two_lambda,
            "k_vir": 0.5 * abs(G[0, 0]) / self.amplitude,
        }


def _spread(function: Callable[[FloatArray], FloatArray], vector: FloatArray, covariance: FloatArray) -> FloatArray:
    """Covariance of a function of the parameter vector, by central differences of a standard deviation."""
    steps = np.diag(np.sqrt(np.diag(covariance)))
    jacobian = np.column_stack([(function(vector + h) - function(vector - h)) / (2.0 * h.sum()) for h in steps])
    return np.asarray(jacobian @ covariance @ jacobian.T)


def _axes(at_rest: ComplexArray, frame: PickoffFrame) -> dict[str, float]:
    """Damping and stiffness in the pick-offs' orthogonal axes: 1/tau, D(1/tau) and theta_tau, D omega and theta_omega of theory.md Eq.
    1.
    """
    n = 0.5 * frame.skew
    pick = np.array([[1.0, n], [n, frame.ratio]])
    inner = np.linalg.solve(pick, frame.without_phase(at_rest)) @ pick
    damping = -float((inner[0, 0] - inner[1, 1]).real), -float((inner[0, 1] + inner[1, 0]).real)
    stiffness = float((inner[0, 0] - inner[1, 1]).imag), float((inner[0, 1] + inner[1, 0]).imag)
    return {
        "decay_rate": -0.5 * float(np.trace(inner).real),
        "damping_anisotropy": math.hypot(*damping),
        "damping_azimuth": 0.25 * math.atan2(damping[1], damping[0]),
        "frequency_split": math.hypot(*stiffness),
        "frequency_azimuth": 0.25 * math.atan2(stiffness[1], stiffness[0]),
    }


def _cubic_forces(terms: Mapping[str, complex]) -> Callable[[ComplexArray], ComplexArray] | None:
    """N(p) of the cubic terms that act on the motion, or None."""
    wave = terms.get("cubic_wave", 0j)
    matrix = np.array([[terms.get("cubic_xx", 0j), terms.get("cubic_xy", 0j)], [terms.get("cubic_yx", 0j), terms.get("cubic_yy", 0j)]])
    if wave == 0j and not matrix.any():
        return None

    def forces(p: ComplexArray) -> ComplexArray:
        return np.asarray(wave * np.sum(np.abs(p) ** 2) * p + matrix @ (np.abs(p) ** 2 * p), dtype=np.complex128)

    return forces


def _number(factory: Mapping[str, Any], name: str) -> float:
    value = factory.get(name)
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else 0.0


def unit_of(name: str) -> str:
    """Unit of a derived value."""
    if name in ("rate", "bias_x", "bias_y", "wave_bias", "frequency_split") or name.startswith("drift_"):
        return "rad/s"
    if name in ("scale_x", "scale_y"):
        return "V/(rad/s)"
    if name.startswith(("two_", "pickoff_phase", "pickoff_non")) or name.endswith("_azimuth"):
        return "rad"
    if name.startswith(("E_", "delta_g")) or name in ("pickoff_ratio", "wave_scale"):
        return "1"
    return "rad/s/V" if name == "k_vir" else "1/s"
