"""On which lines a recording is projected: where it holds signal, and where only noise is left once the model is taken away."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..estimation.wave_lines import quiet_lines, signal_lines
from ..recording.applied_rate import is_turned
from ..recording.recording import Recording

__all__ = ["Lines", "lines_of"]

#: harmonics of a side band that a nonlinearity fills
_SIDE_BAND_HARMONICS = 3
#: lines of a recording in which nothing was modulated: the mean and its slow changes
_STEADY_LINES = 5
_HIGHEST_HZ = 12.0
#: further harmonics of the azimuth psi: of many electrodes, or of a table of sines; highest line over the row rate
_FURTHER, _TOP = (6, 8), 0.05


@dataclass(frozen=True)
class Lines:
    """Frequencies from the carrier [Hz]."""

    signal: tuple[float, ...]
    quiet: tuple[float, ...]


def lines_of(recording: Recording, speed_rad_s: float) -> Lines:
    """Lines of a recording whose wave turns at this speed of the azimuth psi."""
    step = 1.0 / recording.duration_s
    excitation = recording.command.excitation
    if excitation.kind.endswith("modulation"):
        nu = excitation.frequency_hz
        signal = [0.0, *(k * nu for k in range(1, _SIDE_BAND_HARMONICS + 1) if k * nu < _HIGHEST_HZ)]
    elif recording.command.mode == "loops_off":
        signal = [0.0]
    elif recording.command.oscillator_axis and not is_turned(recording):
        signal = [step * k for k in range(_STEADY_LINES)]
    else:
        signal = signal_lines(recording, speed_rad_s)
    highest = max(signal)
    turn = speed_rad_s / (2.0 * math.pi)
    if recording.command.mode == "whole_angle" and turn > 1.5 * step:
        top = min(_HIGHEST_HZ, _TOP * recording.sample_rate_hz)
        signal += [k * turn for k in _FURTHER if highest + 1.2 * step < k * turn < top]
    quiet = [f for f in quiet_lines(recording, highest, speed_rad_s) if min(abs(f - s) for s in signal) > 1.2 * step]
    return Lines(tuple(float(f) for f in np.unique(np.round(signal, 9))), tuple(quiet))
