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

import numpy as np

from ..quantity import Quantity
from ..recording.recording import Recording
from .wave import smooth_azimuth, wave_coordinates

__all__ = ["loop_latency"]

#: a recording tells the latency when the azimuth psi turns by more than this [rad]
_LEAST_TURN_RAD = 0.5
#: stretches of a recording whose scatter gives the standard deviation
_PARTS = 8
#: time over which the azimuth is smoothed [s]
_SMOOTH_S = 0.2


def loop_latency(recordings: Iterable[Recording]) -> Quantity | None:
    """Latency of the loops [s], or None when no wave turned.

    Parameters
    ----------
    recordings : iterable of Recording
        Those of mode ``whole_angle`` in which the wave turns steadily are used.
    """
    estimates, weights = [], []
    for recording in recordings:
        if recording.command.mode != "whole_angle" or "applied_rate" in recording.extras:
            continue
        wave = wave_coordinates(recording, commanded=True)
        if np.ptp(wave.azimuth_rad) < _LEAST_TURN_RAD:
            continue
        width = round(_SMOOTH_S * recording.sample_rate_hz)
        psi = smooth_azimuth(wave.azimuth_rad, width)
        lever = -np.gradient(psi, 1.0 / recording.sample_rate_hz) * wave.drive_along.imag
        across = wave.drive_across.imag - recording.command.setpoints.virtual_precession_v
        # the smoothed azimuth bends at its ends
        for part in np.array_split(np.arange(2 * width, wave.t.size - 2 * width), _PARTS):
            square = float(lever[part] @ lever[part])
            if square > 0.0:
                estimates.append(float(lever[part] @ across[part]) / square)
                weights.append(square)
    if len(estimates) < 2:
        return None
    share = np.array(weights) / sum(weights)
    mean = float(share @ np.array(estimates))
    variance = float(share**2 @ (np.array(estimates) - mean) ** 2) * len(estimates) / (len(estimates) - 1)
    return Quantity(mean, math.sqrt(variance), "s")
