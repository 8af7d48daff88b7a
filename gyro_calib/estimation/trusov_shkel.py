"""Absolute amplitude from the pick-off's own nonlinearity (document 000: "driving the ring to large amplitudes and comparing side lobes to
the principal excitation peak, a technique known as Trusov-Shkel").

A capacitance ~ 1/(d - z) less its value at rest gives ``V = V_gap s cos(phi) / (1 - s cos(phi))`` for a motion of amplitude a = s d. With
``q = s / (1 + sqrt(1 - s^2))`` its Fourier series is geometric,

    1/(1 - s cos phi) = (1 + 2 sum_n q^n cos(n phi)) / sqrt(1 - s^2),   H_n = V_gap 2 q^n / sqrt(1 - s^2),

so H2/H1 = H3/H2 = q and s = 2 q/(1 + q^2): the motion in units of the gap, free of every gain. The principal line then gives the gap in
volts of that pick-off, ``V_gap = P d = H1 (1 - q^2) / (2 q (1 + q^2))``, and with equal gaps V_gap,y / V_gap,x is the relative pick-off
magnitude.

What else makes such lines: a converter's own quadratic term adds to H2/H1 in proportion to H1 just as the gap does, but not to H3/H2 (the
chi-square of the two together tells); harmonics that are a fixed share of the carrier stay when the amplitude changes (three amplitudes
separate them). An electronics gain at 2 omega other than at omega scales V_gap; where it is alike on both axes it cancels in the ratio.

Phase: H2's against twice H1's is phi_e(2 omega) - 2 phi_e(omega) of the electronics, zero for any pure delay. Each axis sees its own motion
only, so the relative pick-off phase eps is NOT in these lines; take it from the body excitation (:mod:`.separation`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import chdtri

from ..errors import CalibrationRefused
from ..quantity import Quantity
from ..recording.recording import Campaign, Recording
from .gap_lines import GapLines, amplitude_in_gaps, measure_lines, ratio_of_lines

__all__ = ["AxisGap", "TrusovShkelResult", "estimate_trusov_shkel"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: how equal two gaps of one ring are taken to be, relative (engineering estimate: etched in one step; not fitted to any device)
GAP_EQUALITY = 1e-3
#: feedthrough of a chain that nobody measured (engineering estimate): its share of the principal line is |E u|/|V|
FEEDTHROUGH = 1e-3
#: lines that are less than this many standard deviations say nothing
_SEEN = 5.0


@dataclass(frozen=True)
class AxisGap:
    """What the lines of one axis say.

    Parameters
    ----------
    gap_v : Quantity
        The gap in volts of its pick-off, P d [V].
    amplitude : Quantity
        a/d at the smallest amplitude recorded.
    steps : tuple of (float, Quantity)
        Principal line [V] and a/d of each recording.
    phase_excess_rad : Quantity
        arg H2 - 2 arg H1: electronics beyond a pure delay.
    chi2_per_dof : float
        Of H2/H1 and H3/H1 against the geometric law.
    """

    gap_v: Quantity
    amplitude: Quantity
    steps: tuple[tuple[float, Quantity], ...]
    phase_excess_rad: Quantity
    chi2_per_dof: float


@dataclass(frozen=True)
class TrusovShkelResult:
    """Absolute amplitude of both axes and the relative pick-off magnitude.

    Parameters
    ----------
    device_id : str
    axes : dict of {"x", "y"} to AxisGap
    covariance : ndarray, shape (2, 2)
        Of the two gaps in volts.
    pickoff_ratio : Quantity
        \\|r\\| = V_gap,y / V_gap,x, the equality of the gaps in its sd.
    not_observable, warnings : tuple of str
    """

    device_id: str
    axes: dict[str, AxisGap]
    covariance: FloatArray
    pickoff_ratio: Quantity
    not_observable: tuple[str, ...]
    warnings: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """JSON document."""
        return {
            "device_id": self.device_id,
            "method": "trusov_shkel",
            "gap": {a: g.gap_v.to_json() for a, g in self.axes.items()},
            "amplitude_over_gap": {a: g.amplitude.to_json() for a, g in self.axes.items()},
            "phase_excess": {a: g.phase_excess_rad.to_json() for a, g in self.axes.items()},
            "pickoff_ratio": self.pickoff_ratio.to_json(),
            "not_observable": list(self.not_observable),
            "warnings": list(self.warnings),
        }


def estimate_trusov_shkel(
    campaign: Campaign, *, feedthrough: ComplexArray | None = None, gap_equality: float = GAP_EQUALITY
) -> TrusovShkelResult:
    """Estimate a/d of each axis and the relative pick-off magnitude from raw recordings at large amplitude.

    Parameters
    ----------
    campaign : Campaign
        Force-rebalance recordings with raw blocks, each axis as the oscillator (plan ``pickoff_phase``); three amplitudes an axis separate
        the gap from harmonics in fixed proportion.
    feedthrough : ndarray, shape (2, 2), complex, optional
        E, taken off the principal line with the mean drives of the rows.
    gap_equality : float
        Relative standard deviation of d_y/d_x about 1.

    Raises
    ------
    CalibrationRefused
        No raw recordings of an axis, or no second harmonic above its noise.
    """
    axes: dict[str, AxisGap] = {}
    warnings: list[str] = []
    for axis in "xy":
        recordings = [
            r for r in campaign if r.command.oscillator_axis == axis and r.raw is not None and r.command.excitation.kind == "none"
        ]
        if not recordings:
            raise CalibrationRefused(
                f"Campaign must hold raw recordings with {axis} as the oscillator, but got none. Record the plan pickoff_phase."
            )
        lines = [measure_lines(r, axis, campaign.factory, feedthrough) for r in recordings]
        axes[axis], said = _gap(axis, lines, 0.0 if feedthrough is not None else FEEDTHROUGH * _effort(recordings, axis))
        warnings += said
    if feedthrough is None:
        warnings.append("feedthrough E was not given: its share of the principal lines stands in the standard deviations (run_feedthrough)")
    gx, gy = axes["x"].gap_v, axes["y"].gap_v
    ratio = gy.value / gx.value
    sd = ratio * math.sqrt((gx.sd / gx.value) ** 2 + (gy.sd / gy.value) ** 2 + gap_equality**2)
    return TrusovShkelResult(
        device_id=campaign.device_id,
        axes=axes,
        covariance=np.diag([gx.sd**2, gy.sd**2]),
        pickoff_ratio=Quantity(ratio, sd, "1"),
        not_observable=("pickoff_phase: each axis sees its own motion, so these lines do not hold it; record body excitation",),
        warnings=tuple(warnings),
    )


def _effort(recordings: list[Recording], axis: str) -> float:
    """Largest |u|/|V| of the recordings (0.2 when they hold no rows)."""
    rows = [r for r in recordings if len(r)]
    ratios = [float(np.linalg.norm(r.drive.mean(axis=0)) / abs(r.pick[:, "xy".index(axis)].mean())) for r in rows]
    return max(ratios, default=0.2)


def _gap(axis: str, lines: list[GapLines], unsure: float) -> tuple[AxisGap, list[str]]:
    """Fit one gap, and from three amplitudes on a fixed share of each harmonic, to the lines of an axis.

    ``unsure`` is the relative standard deviation of the principal lines, common to all amplitudes.
    """
    strongest = max(lines, key=lambda line: line.principal)
    if abs(strongest.second.value) < _SEEN * strongest.second.sd:
        raise CalibrationRefused(
            f"Second harmonic of the {axis} pick-off must stand out of its noise, but got {strongest.second.value:.2g} with sd "
            f"{strongest.second.sd:.2g} at {strongest.principal:.3g} V. Raise the amplitude, or record longer; a linear pick-off has none."
        )
    principal = np.array([line.principal for line in lines])
    measured = np.array([[line.second.value for line in lines], [line.third.value for line in lines]])
    sd = np.array([[line.second.sd for line in lines], [line.third.sd for line in lines]])
    spread = len({round(float(p), 3) for p in principal}) >= 3

    def residual(x: FloatArray) -> FloatArray:
        q = ratio_of_lines(principal * x[0])
        shares = x[1:] if spread else np.zeros(2)
        return np.asarray(((np.array([q + shares[0], q * q + shares[1]]) - measured) / sd).ravel())

    start = np.array([2.0 * strongest.second.value / strongest.principal, *([0.0, 0.0] if spread else [])])
    scale = np.array([abs(start[0]), *([1e-4, 1e-4] if spread else [])])
    solution = least_squares(residual, start, x_scale=scale, method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    dof = measured.size - start.size
    reduced = 2.0 * float(solution.cost) / max(dof, 1)
    covariance = np.linalg.inv(solution.jac.T @ solution.jac) * max(1.0, reduced)
    inverse = float(solution.x[0])
    inverse_sd = math.hypot(math.sqrt(covariance[0, 0]), unsure * inverse)
    warnings = []
    if dof > 0 and reduced * dof > float(chdtri(dof, 1e-4)):
        warnings.append(
            f"{axis} pick-off: the lines leave chi-square/dof {reduced:.1f} against a gap's geometric law; another nonlinearity"
        )
    if not spread:
        warnings.append(
            f"{axis} pick-off: fewer than three amplitudes, harmonics in fixed proportion to the carrier are taken for the gap's"
        )
    steps = []
    for p in principal:
        q = ratio_of_lines(np.array([p * inverse, p * (inverse + inverse_sd)]))
        s = amplitude_in_gaps(q)
        steps.append((float(p), Quantity(float(s[0]), abs(float(s[1] - s[0])), "1")))
    excess = [line.excess for line in lines]
    weight = np.array([1.0 / max(e.sd, 1e-12) ** 2 for e in excess])
    turn = Quantity(float(weight @ [e.value for e in excess] / weight.sum()), 1.0 / math.sqrt(float(weight.sum())), "rad")
    gap = Quantity(1.0 / abs(inverse), inverse_sd / inverse**2, "V")
    return AxisGap(gap, min(steps)[1], tuple(steps), turn, reduced), warnings
