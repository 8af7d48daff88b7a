"""The side-band method (document 000) on a force-rebalance campaign: from recordings to rate, bias, scale factor, with covariance."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..device.operating_point import OperatingPoint, ftr_operating_point
from ..errors import CalibrationRefused
from ..quantity import Quantity
from ..recording.recording import Campaign, Recording
from .factory_values import angular_gain, factory_value
from .feedthrough_check import check_feedthrough
from .linear_fit import NoiseModel
from .result import CalibrationResult, ConvergencePoint, MissionChannel
from .separation import Deviations, PickoffFrame, Priors, angular_response, input_rate_times_kappa, solve_pickoff_frame
from .slow_flow_data import SLOPE_WINDOW_K, resonance_motion, usable_recordings
from .slow_flow_estimate import SlowFlowEstimate
from .slow_flow_fit import fit_slow_flow

__all__ = ["FIGURES", "SidebandProblem", "calibrate_sideband"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
_AXIS = {"x": 0, "y": 1}
#: a warning above this reduced chi-square; the covariance is scaled by it when it is above one
_CHI2_WARN = 2.0
_CONVERGENCE_POINTS = 6


def calibrate_sideband(
    campaign: Campaign,
    *,
    priors: Priors | None = None,
    on_progress: Callable[[float], None] | None = None,
    with_convergence: bool = True,
    temperature_window_k: float = SLOPE_WINDOW_K,
) -> CalibrationResult:
    """Estimate rate, bias and scale factor of a force-rebalance gyro that was not turned.

    Parameters
    ----------
    campaign : Campaign
        Side bands on both oscillator axes; better with open drive (feedthrough) and body excitation (pick-off phase).
    priors : Priors, optional
        What is known of the pick-off chain.
    on_progress : callable, optional
        Called with a fraction 0-1.
    with_convergence : bool
        Also estimate from growing subsets of the recordings.
    temperature_window_k : float
        Recordings further than this from the median temperature are left out [K].

    Raises
    ------
    CalibrationRefused
        The recordings do not support the estimate; the text says what to record.
    """
    kappa = angular_gain(campaign.factory)
    priors = priors or Priors()
    recordings, skipped = usable_recordings(campaign, temperature_window_k)
    if not recordings:
        raise CalibrationRefused("Campaign must hold force-rebalance recordings (ftr_x and ftr_y), but got none.")
    problem = SidebandProblem(recordings, campaign.factory, kappa, priors)
    values, covariance = problem.solve()
    if on_progress is not None:
        on_progress(0.5)
    convergence: tuple[ConvergencePoint, ...] = ()
    if with_convergence:
        convergence = _convergence(recordings, campaign.factory, kappa, priors, on_progress)
    result = problem.result(campaign.device_id, values, covariance, tuple(skipped), convergence)
    check = check_feedthrough(recordings, problem.fit)
    warnings = result.warnings if check.consistent else (*result.warnings, check.verdict)
    return replace(result, feedthrough=check, warnings=warnings)


@dataclass(frozen=True)
class _Derived:
    """Everything derived from one parameter vector, flat, with names."""

    names: tuple[str, ...]
    values: FloatArray
    frame: PickoffFrame


class SidebandProblem:
    """The estimate of one set of recordings and its propagation to derived quantities.

    ``fit`` is another estimator's slow flow of the same recordings, in place of :func:`.slow_flow_fit.fit_slow_flow`.
    """

    def __init__(
        self,
        recordings: list[Recording],
        factory: Mapping[str, Any],
        kappa: float,
        priors: Priors,
        *,
        cubic: bool | None = None,
        noise: Mapping[tuple[str, str, str], NoiseModel] | None = None,
        fit: SlowFlowEstimate | None = None,
    ) -> None:
        self.kappa = kappa
        # from the factory's rate table (calibration.factory_record), where there was one
        self.kappa_sd = factory_value(factory, "angular_gain_kappa_sd")
        difference, its_sd = (factory_value(factory, f"fixed_rate_difference_{name}") for name in ("rad_s", "sd_rad_s"))
        self.rate_difference = difference, its_sd
        self.priors = priors
        self.factory = factory
        decay = math.pi * float(factory.get("nominal_f0_hz", 0.0)) / float(factory.get("nominal_q", math.inf))
        self.fit: SlowFlowEstimate = fit_slow_flow(recordings, decay, cubic=cubic, noise=noise) if fit is None else fit
        self.deviations = Deviations.of(self.fit, priors)
        ratio = factory.get("drive_gain_ratio_x_over_y")
        self.drive_ratio = float(ratio) if isinstance(ratio, int | float) and math.isfinite(ratio) else None
        self.amplitude = float(factory.get("nominal_amplitude_v", 0.0)) or _main_amplitude(recordings)
        # the oscillator runs at its own resonance, not at the mean of both: G ~ 1/omega, ppm of the scale factor
        self.stretch = {axis: _reference(recordings, axis) / self.fit.omega0_rad_s for axis in _AXIS}
        self.volts = {axis: _held_volts(recordings, axis, self.amplitude) for axis in _AXIS}

    def derive(self, vector: FloatArray, nuisance: FloatArray) -> _Derived:
        """Rate, bias, scale factors, … of a parameter vector; ``nuisance`` are the priors' means in standard deviations.

        The rate is the true one: what the reciprocity finds less the fixed difference that the factory saw (document 000, "an estimated
        fixed difference between the two rates may be applied to subsequent calibrations in the field").
        """
        kappa = self.kappa + self.kappa_sd * nuisance[5]
        v = self.fit.unpack(vector)
        A, G, E = v.A, v.G, v.E
        frame = solve_pickoff_frame(self.fit, vector, self.deviations, self.drive_ratio, self.priors, nuisance)
        rate = input_rate_times_kappa(A, frame) / kappa - self.rate_difference[0] - self.rate_difference[1] * nuisance[6]
        response = angular_response(frame, kappa)
        at_rest = A - rate * response
        bare = frame.without_phase(at_rest)
        symmetric = bare @ frame.metric
        named: dict[str, float] = {"rate": rate}
        for axis, osc in _AXIS.items():
            # at the operating amplitude the cubic terms add to the column of the oscillator
            running = at_rest.copy()
            running[:, osc] += v.cubic[:, osc] * self.amplitude**2
            point = ftr_operating_point(running, G, np.zeros((2, 2), dtype=complex), self.amplitude, axis)
            gain = abs(G[1 - osc, 1 - osc])
            slope = self.stretch[axis] * kappa * self.amplitude * (frame.ratio / gain if axis == "x" else -1.0 / (frame.ratio * gain))
            named[f"bias_{axis}"], named[f"scale_{axis}"] = point.rate_channel_v / slope, slope
            named[f"mission_bias_{axis}"], named[f"mission_scale_{axis}"] = _line(
                running, self.stretch[axis] * response, G, E, self.volts[axis], self.amplitude, axis
            )
        named |= {"pickoff_ratio": frame.ratio, "pickoff_phase": frame.phase_rad, "pickoff_non_orthogonality": 0.5 * frame.skew}
        named["cross_damping"] = -float(symmetric[0, 1].real + symmetric[1, 0].real) / frame.ratio
        named["cross_stiffness"] = self.fit.omega0_rad_s * float(symmetric[0, 1].imag + symmetric[1, 0].imag) / frame.ratio
        matrices = [(A, "A"), (G, "G"), (E, "E")] + ([(v.cubic, "cubic")] if self.fit.has_cubic else [])
        for matrix, name in matrices:
            for i, row in enumerate("xy"):
                for j, column in enumerate("xy"):
                    named[f"{name}_{row}{column}_re"] = float(matrix[i, j].real)
                    named[f"{name}_{row}{column}_im"] = float(matrix[i, j].imag)
        for i, row in enumerate("xy"):
            named[f"G_{row}{row}_abs"] = abs(G[i, i])
            named[f"decay_rate_{row}"] = -float(A[i, i].real)
        return _Derived(tuple(named), np.array(list(named.values())), frame)

    def solve(self) -> tuple[_Derived, FloatArray]:
        """Derived values and their covariance: measured noise (scaled up when the model does not fit) and priors."""
        here, parts = self._solved
        return here, np.asarray(sum(parts.values()))

    @cached_property
    def _solved(self) -> tuple[_Derived, dict[str, FloatArray]]:
        return self.covariances(self._parameter_covariance())

    def _parameter_covariance(self) -> FloatArray:
        dof = max(self.fit.dof, 1)
        reduced = self.fit.chi2 / dof
        # a chi-square within chance of one says nothing against the measured noise
        scale = reduced if reduced > 1.0 + 2.0 * math.sqrt(2.0 / dof) else 1.0
        return np.asarray(scale * self.fit.covariance)

    def propagate(self, parameter_covariance: FloatArray) -> tuple[_Derived, FloatArray]:
        """Derived values and their covariance under a covariance of the parameter vector, priors added, by central differences."""
        here, parts = self.covariances(parameter_covariance)
        return here, np.asarray(sum(parts.values()))

    def covariances(self, parameter_covariance: FloatArray) -> tuple[_Derived, dict[str, FloatArray]]:
        """Derived values, and their covariance by where it comes from: the noise of the recordings and each prior."""
        vector = self.fit.vector()
        zero = np.zeros(len(NUISANCES))
        here = self.derive(vector, zero)
        sd = np.sqrt(np.diag(parameter_covariance))
        columns = []
        for i in range(vector.size):
            step = np.zeros_like(vector)
            step[i] = sd[i]
            columns.append((self.derive(vector + step, zero).values - self.derive(vector - step, zero).values) / (2.0 * sd[i]))
        jacobian = np.column_stack(columns)
        parts = {"noise of the recordings": np.asarray(jacobian @ parameter_covariance @ jacobian.T)}
        for i, name in enumerate(NUISANCES):
            step = np.zeros_like(zero)
            step[i] = 1.0
            slope = 0.5 * (self.derive(vector, step).values - self.derive(vector, -step).values)
            parts[name] = np.outer(slope, slope)
        return here, parts

    def limits(self) -> dict[str, dict[str, float]]:
        """Share of the variance of rate, bias and scale factors by where it comes from, the largest first; from 1 % on."""
        here, parts = self._solved
        found = {}
        for name in FIGURES:
            k = here.names.index(name)
            whole = sum(float(part[k, k]) for part in parts.values())
            shares = {source: float(part[k, k]) / whole for source, part in parts.items()}
            found[name] = {source: share for source, share in sorted(shares.items(), key=lambda item: -item[1]) if share >= 0.01}
        return found

    def result(
        self, device_id: str, derived: _Derived, covariance: FloatArray, skipped: tuple[str, ...], convergence: tuple[ConvergencePoint, ...]
    ) -> CalibrationResult:
        """Package the outcome."""
        index = {name: i for i, name in enumerate(derived.names)}
        sd = np.sqrt(np.diag(covariance))

        def q(name: str, unit: str) -> Quantity:
            return Quantity(float(derived.values[index[name]]), float(sd[index[name]]), unit)

        mission = {}
        for axis in _AXIS:
            pick = [index[f"mission_bias_{axis}"], index[f"mission_scale_{axis}"]]
            mission[axis] = MissionChannel(float(derived.values[pick[0]]), float(derived.values[pick[1]]), covariance[np.ix_(pick, pick)])
        not_observable, warnings = self._verdicts(derived, covariance, skipped)
        parameters = {name: q(name, _unit(name)) for name in derived.names if not name.startswith(("rate", "bias_", "scale_", "mission_"))}
        return CalibrationResult(
            device_id=device_id,
            method="sideband",
            rate=q("rate", "rad/s"),
            bias={a: q(f"bias_{a}", "rad/s") for a in _AXIS},
            scale_factor={a: q(f"scale_{a}", "V/(rad/s)") for a in _AXIS},
            mission=mission,
            parameters=parameters,
            rate_noise_density={a: self._noise_density(a, abs(derived.values[index[f"scale_{a}"]])) for a in _AXIS},
            condition_number=self.fit.condition_number,
            chi2_per_dof=self.fit.chi2 / max(self.fit.dof, 1),
            amplitude_v=self.amplitude,
            temperature_degc=self.fit.temperature_degc,
            temperature_sd_k=self.fit.temperature_sd_k,
            reference_frequency_hz=self.fit.omega0_rad_s / (2.0 * math.pi),
            not_observable=not_observable,
            warnings=warnings,
            table=self.fit.table,
            convergence=convergence,
            limits=self.limits(),
        )

    def _noise_density(self, oscillator: str, scale: float) -> Quantity:
        """White rate noise of the closed axis: the residual's force noise over the rate's own effect on it."""
        closed = "y" if oscillator == "x" else "x"
        model = self.fit.noise.get((closed, "closed", "re"))
        gain = abs(self.fit.values.G[_AXIS[closed], _AXIS[closed]])
        two_sided = model.coefficients[0] if model is not None else math.nan
        density = math.sqrt(2.0 * two_sided) / (gain * scale)
        return Quantity(density, 0.1 * density, "rad/s/sqrt(Hz)")

    def _verdicts(self, derived: _Derived, covariance: FloatArray, skipped: tuple[str, ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
        not_observable, warnings = ["angular_gain_kappa: taken from the factory, no self-calibration sees it"], []
        sd = np.sqrt(np.diag(covariance))
        limits = (
            (
                "pickoff_ratio",
                3e-4,
                "inject a known quadrature, record body excitation (equal gaps), or store the factory's drive-gain ratio",
            ),
            ("pickoff_phase", 1e-4, "record body excitation off resonance"),
        )
        for name, limit, remedy in limits:
            found = float(sd[derived.names.index(name)])
            if found > limit:
                not_observable.append(f"{name}: known to {found:.1e} only, {limit:.0e} is needed; {remedy}")
        if derived.frame.prior_share[1] > 0.5:
            not_observable.append("pickoff_non_orthogonality: from its prior; needs cross stiffness and a frequency split along the axes")
        if not (self.fit.has_feedthrough and self.fit.feedthrough_measured):
            share = "what may be of it is in the standard deviations" if self.fit.has_feedthrough else "it is taken as zero"
            warnings.append(f"feedthrough E was not measured, {share}: record open drive off resonance (run_feedthrough)")
        reduced = self.fit.chi2 / max(self.fit.dof, 1)
        if reduced > _CHI2_WARN:
            warnings.append(
                f"the linear model leaves chi-square/dof {reduced:.1f}: an effect is missing from it, or the base moved; "
                "standard deviations are scaled, diagnose the gap before trusting them"
            )
        if self.fit.has_cubic:
            warnings.append(
                f"cubic terms were needed (chi-square falls by {self.fit.cubic_gain:.0f}): a nonlinearity is part of this estimate"
            )
        if skipped:
            warnings.append("left out: " + "; ".join(skipped))
        return tuple(not_observable), tuple(warnings)


#: priors that enter the covariance, in the order of ``nuisance``: n, rho, r, eps, drive-gain ratio; kappa and the factory's rate difference
NUISANCES = (
    "non-orthogonality of the pick-offs (prior)",
    "rotation of the body's force (prior)",
    "ratio of the pick-offs (prior)",
    "phase of the pick-offs (prior)",
    "constancy of the factory's drive-gain ratio (prior)",
    "angular gain of the factory",
    "rate difference of the factory",
)
#: what a calibration is for, as named by :meth:`SidebandProblem.derive`
FIGURES = ("rate", "bias_x", "bias_y", "scale_x", "scale_y")


def _line(
    at_rest: ComplexArray, response: ComplexArray, G: ComplexArray, E: ComplexArray, volts: ComplexArray | None, amplitude: float, axis: str
) -> tuple[float, float]:
    """Rate channel [V] at rest and its slope with rate [V/(rad/s)], about zero."""
    step = 1e-3

    def at(rate: float) -> OperatingPoint:
        return ftr_operating_point(at_rest + rate * response, G, E, amplitude, axis, volts=volts)

    return at(0.0).rate_channel_v, (at(step).rate_channel_v - at(-step).rate_channel_v) / (2.0 * step)


def _main_amplitude(recordings: list[Recording]) -> float:
    values = [r.command.setpoints.amplitude_v for r in recordings if r.command.oscillator_axis]
    unmodulated = [r.command.setpoints.amplitude_v for r in recordings if r.command.oscillator_axis and r.command.excitation.kind == "none"]
    return float(np.median(unmodulated or values))


def _reference(recordings: list[Recording], axis: str) -> float:
    """Mean reference frequency of an oscillator axis at the mean temperature of the campaign [rad/s].

    In a campaign that drifts, the axis that came first was warmer or colder than the mean that the estimate is for: 25 ppm at 5 K.
    """
    slope, middle, _ = resonance_motion(recordings)
    own = [r for r in recordings if r.command.oscillator_axis == axis]
    return float(np.mean([r.ref_omega_rad_s.mean() - (slope or 0.0) * (r.temperature_degc.mean() - middle) for r in own]))


def _held_volts(recordings: list[Recording], axis: str, amplitude: float) -> ComplexArray | None:
    """Where the device's loops really hold the pick-offs: a PLL or a rebalance that sits off zero biases the rate channel."""
    own = [
        r.pick.mean(axis=0) / r.command.setpoints.amplitude_v
        for r in recordings
        if r.command.oscillator_axis == axis and r.command.setpoints.amplitude_v == amplitude
    ]
    return amplitude * np.mean(own, axis=0) if own else None


def _convergence(
    recordings: list[Recording], factory: Mapping[str, Any], kappa: float, priors: Priors, on_progress: Callable[[float], None] | None
) -> tuple[ConvergencePoint, ...]:
    """Estimates from the loops-off records and the first k loop records, k growing in time."""
    open_records = [r for r in recordings if r.command.oscillator_axis is None]
    loops = sorted((r for r in recordings if r.command.oscillator_axis), key=lambda r: float(r.t[0]))
    points = []
    marks = sorted({max(1, round(len(loops) * (k + 1) / _CONVERGENCE_POINTS)) for k in range(_CONVERGENCE_POINTS)})
    for done, mark in enumerate(marks):
        try:
            problem = SidebandProblem(open_records + loops[:mark], factory, kappa, priors)
            derived, covariance = problem.solve()
        except CalibrationRefused:
            continue
        index = {name: i for i, name in enumerate(derived.names)}
        sd = np.sqrt(np.diag(covariance))
        quantities = {
            kind: {a: Quantity(float(derived.values[index[f"{kind}_{a}"]]), float(sd[index[f"{kind}_{a}"]]), unit) for a in _AXIS}
            for kind, unit in (("bias", "rad/s"), ("scale", "V/(rad/s)"))
        }
        points.append(ConvergencePoint(float(loops[mark - 1].t[-1]), quantities["bias"], quantities["scale"]))
        if on_progress is not None:
            on_progress(0.5 + 0.5 * (done + 1) / len(marks))
    return tuple(points)


def _unit(name: str) -> str:
    if name.startswith("E_") or name in ("pickoff_ratio",):
        return "1"
    if name.startswith("cubic_"):
        return "1/(s V^2)"
    if name.startswith("G_"):
        return "1/s"
    return {"pickoff_phase": "rad", "pickoff_non_orthogonality": "rad", "cross_stiffness": "1/s^2"}.get(name, "1/s")
