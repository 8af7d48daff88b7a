"""Document 000's alternative without a self-oscillator: a drive stepped through resonance, A and G from the response.

Linear in (A, G~, E) like everything else (:mod:`.projection`), so the estimate is as good as the assumption that the resonance stands
still: no reference follows it. ``i lambda p`` of a resonance that is off by ``lambda`` while one step was recorded is the error that
dominates; how far it was off is found from what the fit leaves.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..errors import CalibrationRefused
from ..recording.recording import Recording
from .linear_fit import Equation, LinearFit, fit_axis
from .projection import Projected, project
from .slow_flow_estimate import SlowFlowEstimate, SlowFlowParameters

__all__ = ["fit_swept_drive"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: pick-off noise to begin with [V/sqrt(Hz)]
_PICKOFF_V = 1e-6
#: how far the resonance may be off in one record [rad/s]: what is tried
_WANDER_RAD_S = (1e-5, 30.0)
_ROUNDS = 2


def fit_swept_drive(recordings: list[Recording], omega0_rad_s: float, decay_rate: float) -> SlowFlowEstimate:
    """Fit A, G, E and the body response to loops-off recordings alone.

    Parameters
    ----------
    recordings : list of Recording
        Open drive on each axis through resonance and far from it, body excitation as there is; others are ignored.
    omega0_rad_s : float
        Frequency about which A is written.
    decay_rate : float
        Rough 1/tau [1/s].

    Raises
    ------
    CalibrationRefused
        An axis that was never driven, or too few frequencies.
    """
    opened = [r for r in recordings if r.command.mode == "loops_off" and r.command.excitation.kind in ("drive", "body")]
    for axis in "xy":
        if not any(r.command.excitation.kind == "drive" and r.command.excitation.axis == axis for r in opened):
            raise CalibrationRefused(
                f"Recordings must include open drive on {axis}, but got none. Step the drive through resonance on both axes."
            )
    bodies = sorted({r.command.excitation.frequency_hz for r in opened if r.command.excitation.kind == "body"})
    signal = [project(r, [0.0], omega0_rad_s, decay_rate) for r in opened]
    columns = [_columns(p, r, bodies) for p, r in zip(signal, opened, strict=True)]
    quiet = [project(r, _quiet_lines(r), omega0_rad_s, decay_rate) for r in opened]
    quiet_columns = [_columns(p, r, bodies) for p, r in zip(quiet, opened, strict=True)]
    # to begin with, pick-off noise alone: it grows with the distance from resonance
    rough = [_PICKOFF_V * (abs(float(r.ref_omega_rad_s.mean()) - omega0_rad_s) + decay_rate) for r in opened]
    fits = [_fit_axis(axis, signal, quiet, columns, quiet_columns, rough) for axis in range(2)]
    size = fits[0].covariance.shape[0]
    covariance = np.zeros((2 * size, 2 * size))
    covariance[:size, :size], covariance[size:, size:] = fits[0].covariance, fits[1].covariance
    temperatures = np.array([r.temperature_degc.mean() for r in opened])
    blank = SlowFlowEstimate(
        values=SlowFlowParameters(*(np.zeros((2, 2), dtype=complex) for _ in range(5))),
        covariance=covariance,
        has_feedthrough=True,
        has_cubic=False,
        cubic_gain=0.0,
        omega0_rad_s=omega0_rad_s,
        temperature_degc=float(temperatures.mean()),
        temperature_sd_k=float(temperatures.std()),
        chi2=sum(f.chi2 for f in fits),
        dof=sum(f.dof for f in fits),
        condition_number=max(f.condition_number for f in fits),
        noise={},
        table=(),
    )
    found = blank.unpack(np.concatenate([f.coefficients for f in fits]).view(np.float64))
    return SlowFlowEstimate(**{**vars(blank), "values": found})


def _quiet_lines(recording: Recording) -> list[float]:
    step = 1.0 / recording.duration_s
    return [float(f) for f in step * (2.0 + 1.3 * np.arange(12))]


def _columns(p: Projected, recording: Recording, bodies: list[float]) -> ComplexArray:
    own = [(p.body * (recording.command.excitation.frequency_hz == f))[:, None] for f in bodies]
    return np.hstack([p.pick, p.drive, p.drive_rate, *own])


def _fit_axis(
    axis: int,
    signal: list[Projected],
    quiet: list[Projected],
    columns: list[ComplexArray],
    quiet_columns: list[ComplexArray],
    rough: list[float],
) -> LinearFit:
    """One axis: noise of each record from its quiet lines, the wander of the resonance from chi-square."""
    sd = rough
    found = _with_wander(axis, signal, columns, sd)
    for _ in range(_ROUNDS):
        left = [p.lhs[:, axis] - c @ found.coefficients for p, c in zip(quiet, quiet_columns, strict=True)]
        sd = [max(math.sqrt(0.5 * float(np.mean(np.abs(q) ** 2))), 1e-15) for q in left]
        found = _with_wander(axis, signal, columns, sd)
    return found


def _with_wander(axis: int, signal: list[Projected], columns: list[ComplexArray], sd: list[float]) -> LinearFit:
    """The wander that brings chi-square to its degrees of freedom, by bisection: the more is allowed, the less is left."""
    low, high = (math.log(w) for w in _WANDER_RAD_S)
    for _ in range(24):
        middle = 0.5 * (low + high)
        found = fit_axis(
            [
                Equation(
                    p.lhs[:, axis],
                    c,
                    p.gram,
                    np.full(1, s),
                    np.full(1, s),
                    detuning=p.pick[:, axis : axis + 1],
                    detuning_sd=math.exp(middle),
                )
                for p, c, s in zip(signal, columns, sd, strict=True)
            ]
        )
        low, high = (middle, high) if found.chi2 > found.dof else (low, middle)
    return found
