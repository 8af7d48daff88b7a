"""A drive gain from stiffness control: drive in phase with the displacement moves the frequency (document 003, first method)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import CalibrationRefused
from ..quantity import Quantity
from ..recording.recording import Recording
from .drive_chain import DriveChain
from .wave import wave_coordinates
from .wave_drive import COUPLING_SD, SWITCHED, block_means, effective_drive, wave_off_axis

__all__ = ["stiffness_gain"]

FloatArray = NDArray[np.float64]
#: blocks over which the frequency is averaged [s]
_STIFFNESS_S = 0.1
#: how much more than in most blocks the reference moves in one in which the PLL still catches up
_CHASE = 3.0


def stiffness_gain(recordings: Sequence[Recording], axis: str, *, chain: DriveChain | None = None) -> Quantity:
    """Gain of one axis from the frequency under stiffness control (document 003, first method) [1/s].

    The frequency is that of the wave (reference and phase of the wave against it), so the PLL need not settle. The resonance wanders at
    random: what is regressed are steps between neighbouring means, which makes a control that alternates a few times a second worth far
    more than
    slow steps. Where the wander is as large as the effect (a hemisphere: 2e-3 of it), the amplitude method is the better one, as the
    document says.

    Parameters
    ----------
    recordings : sequence of Recording
        With CR switched within a recording, or one recording per value in close succession.
    axis : {"x", "y"}
    chain : DriveChain, optional
        As in :func:`ring_gain`.

    Raises
    ------
    CalibrationRefused
        CR did not change.
    """
    parts = [_stiffness_part(r, axis, chain) for r in sorted(recordings, key=lambda r: float(r.t[0]))]
    frequency, control, time = (np.diff(np.concatenate([p[k] for p in parts])) for k in range(3))
    if float(np.max(np.abs(control), initial=0.0)) < 1e-3:
        raise CalibrationRefused("Stiffness control must change during the recordings, but it did not. Step stiffness_v_per_v.")
    # what walks at random goes with the root of the time between
    apart = np.sqrt(time / float(np.min(time)))
    slope = _regressed((control / apart)[:, None], frequency / apart)
    off = 0.0 if chain is not None else 2.0 * abs(float(np.mean([p[3] for p in parts]))) * COUPLING_SD
    return Quantity(slope.value, math.hypot(slope.sd, slope.value * off), "1/s")


def _stiffness_part(recording: Recording, axis: str, chain: DriveChain | None) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Frequency of the wave [rad/s], minus u_par_c/a and time of every block in which the control is not switched; and the angle off the
    axis.
    """
    wave = wave_coordinates(recording)
    width = max(1, round(_STIFFNESS_S * recording.sample_rate_hz))
    count = wave.t.size // width
    ratio = effective_drive(wave, axis, chain).real / wave.amplitude_v
    # what the phase of the wave gains on the reference adds to the reference's own frequency
    gained = np.diff(wave.phase_rad[: count * width : width]) * recording.sample_rate_hz / width
    # from edge to edge, as the phase is: while the PLL catches up, half a row of the reference is half a per cent of the step
    reference, control = (_between_edges(values, width) for values in (recording.ref_omega_rad_s, -ratio))
    change, chase = (np.ptp(v[: count * width].reshape(count, width), axis=1)[:-1] for v in (ratio, recording.ref_omega_rad_s))
    still = change < SWITCHED * float(np.max(np.abs(ratio), initial=1e-300))
    still &= chase <= _CHASE * float(np.median(chase)) + 1e-3 * float(np.max(chase, initial=0.0))
    return (reference + gained)[still], control[still], wave.t[: count * width : width][:-1][still], wave_off_axis(wave, axis)


def _between_edges(values: FloatArray, width: int) -> FloatArray:
    """Means from the first row of each block to the first row of the next one, by the trapezoidal rule."""
    edges = values[: values.size // width * width : width]
    return np.asarray(block_means(values, width)[:-1] + 0.5 * np.diff(edges) / width)


def _regressed(design: FloatArray, target: FloatArray) -> Quantity:
    """First slope; the noise has the autocovariance up to lag two that the residuals show (the phase is read at the ends of blocks)."""
    solution, *_ = np.linalg.lstsq(design, target, rcond=None)
    information = np.eye(design.shape[1])
    for _ in range(3):
        left = target - design @ solution
        covariance = np.eye(left.size) * 1e-6 * float(left @ left) / left.size
        for k in range(3):
            lag = (1.0 - k / 3.0) * float(left[k:] @ left[: left.size - k]) / left.size
            covariance += lag * (np.eye(left.size, k=k) + (np.eye(left.size, k=-k) if k else 0.0))
        weighed = np.linalg.solve(covariance, design)
        information = weighed.T @ design
        solution = np.linalg.solve(information, weighed.T @ target)
    return Quantity(float(solution[0]), math.sqrt(float(np.linalg.inv(information)[0, 0])), "1/s")
