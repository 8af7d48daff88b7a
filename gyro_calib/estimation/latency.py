"""How late the loops of a whole-angle gyro push: the drive follows the wave that was, and lags behind the one that is.

While the wave turns at psi', an amplitude drive u_par along the wave of a latency T ago has the part ``-psi' T u_par`` across the wave
of now
(and a precession drive a part along it). That slows the precession, and the scale factor with it, by T/tau (theory.md section 2):
physics of
the device, not of the estimate, so it has to be in what the mission's rate is corrected with.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..quantity import Quantity
from ..recording.applied_rate import is_turned
from ..recording.recording import Recording
from .wave import smooth_angle, wave_coordinates

__all__ = ["loop_latency"]

FloatArray = NDArray[np.float64]

#: a recording tells the latency when the azimuth psi turns by more than this [rad]
_LEAST_TURN_RAD = 0.5
#: stretches of a recording whose scatter gives the standard deviation
_PARTS = 8
#: a precession drive that is short of its command by more than this share is at the end of its converter's range
_SATURATED = 0.02
#: what this model of one number leaves out, relative (a drive that saturates or a loop that swings is not in it)
_MODEL = 0.01
#: time over which the azimuth is smoothed [s]
_SMOOTH_S = 0.2


def loop_latency(recordings: Iterable[Recording]) -> Quantity | None:
    """Latency of the loops [s], or None when no wave turned.

    Parameters
    ----------
    recordings : iterable of Recording
        Those of mode ``whole_angle`` in which the wave turns steadily, and the drive keeps to its command, are used.
    """
    parts = [part for recording in recordings for part in _parts(recording)]
    if len(parts) < 3:
        return None
    # what turns is shortened by psi'^2: by the recorder's filter, and by the latency itself; that part is fitted beside
    scores = np.array([p.design.T @ p.design for p in parts]), np.array([p.design.T @ p.across for p in parts])
    inverse = np.linalg.pinv(scores[0].sum(axis=0), rcond=1e-12)
    solution = inverse @ scores[1].sum(axis=0)
    left = scores[1] - scores[0] @ solution
    covariance = inverse @ (left.T @ left) @ inverse * len(parts) / (len(parts) - 2)
    return Quantity(float(solution[0]), math.hypot(math.sqrt(float(covariance[0, 0])), _MODEL * float(solution[0])), "s")


@dataclass(frozen=True)
class _Part:
    """A stretch of a turning wave: columns ``-psi' u_par`` and ``psi'^2 u_vir``, and u_perp less the commanded volts."""

    design: FloatArray
    across: FloatArray


def _parts(recording: Recording) -> list[_Part]:
    if recording.command.mode != "whole_angle" or is_turned(recording):
        return []
    wave = wave_coordinates(recording, commanded=True)
    if np.ptp(wave.azimuth_rad) < _LEAST_TURN_RAD:
        return []
    width, volts = round(_SMOOTH_S * recording.sample_rate_hz), recording.command.setpoints.virtual_precession_v
    psi = smooth_angle(wave.azimuth_rad, width)
    speed = np.gradient(psi, 1.0 / recording.sample_rate_hz)
    design = np.column_stack([-speed * wave.drive_along.imag, volts * speed**2])
    across = wave.drive_across.imag - volts
    if abs(float(np.mean(across))) > _SATURATED * abs(volts):
        return []
    # the smoothed azimuth bends at its ends
    rows = np.array_split(np.arange(2 * width, wave.t.size - 2 * width), _PARTS)
    return [_Part(design[r], across[r]) for r in rows if r.size]
