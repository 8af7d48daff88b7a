"""Where in frequency a whole-angle recording says something, where only noise is left, and which recordings share their noise."""

from __future__ import annotations

import math

import numpy as np

from ..recording.applied_rate import is_turned
from ..recording.recording import Recording

__all__ = ["quiet_lines", "role_of", "signal_lines"]

#: harmonics of the modal azimuth that a wave's equations hold: 2 psi from the linear model, 4 psi from cubic terms
_HARMONICS = 4
#: highest line of records whose drive is switched [Hz], and most lines of one of them
_SWITCHED_HZ, _SWITCHED_LINES = 1.5, 24
#: lowest line of their noise [Hz]
_SWITCHED_QUIET_HZ = 0.3
#: highest line at which the noise of a turned recording is measured, over its highest line of signal
_TURNED_QUIET = 2.0
#: above this many lines only the harmonics and their neighbours are taken
_MOST_LINES = 64
_QUIET_LINES = 24
#: least span of the quiet lines [Hz], and their highest line over the row rate
_QUIET_HZ, _QUIET_TOP = 4.0, 0.1


def role_of(recording: Recording) -> str:
    """Recordings of one role share their noise: it depends on what is driven, and in open drive on the distance from resonance."""
    mode = recording.command.mode
    if mode == "loops_off":
        return f"open at {recording.command.excitation.frequency_hz:.0f} Hz"
    if is_turned(recording):
        return "turned"
    if mode == "whole_angle":
        return "precession" if recording.command.setpoints.virtual_precession_v != 0.0 else "free"
    return "ring" if mode.startswith("ring") else mode


def signal_lines(recording: Recording, speed_rad_s: float) -> list[float]:
    """Lines that hold signal [Hz].

    Parameters
    ----------
    recording : Recording
    speed_rad_s : float
        How fast the azimuth psi moves.
    """
    if recording.command.mode == "loops_off":
        return [0.0]
    step = 1.0 / recording.duration_s
    excitation = recording.command.excitation
    if recording.command.oscillator_axis and not is_turned(recording):
        return [0.0, excitation.frequency_hz] if excitation.kind.endswith("modulation") else [step * k for k in range(4)]
    turn = speed_rad_s / (2.0 * math.pi)
    top = _HARMONICS * turn + 3.0 * step
    if recording.command.mode != "whole_angle" or is_turned(recording):
        top = max(top, min(_SWITCHED_HZ, _SWITCHED_LINES * step))
    top = min(top, 0.5 * _QUIET_TOP * recording.sample_rate_hz)
    lines = step * np.arange(int(top / step) + 1)
    if lines.size > _MOST_LINES:
        nearest = np.abs(lines[:, None] - turn * np.arange(_HARMONICS + 1)).min(axis=1)
        lines = lines[nearest <= 2.5 * step]
    return [float(f) for f in lines]


def quiet_lines(recording: Recording, highest_signal_hz: float, speed_rad_s: float) -> list[float]:
    """Lines of which only noise is expected once the model is taken away [Hz]: above the signal, and between the harmonics of the
    azimuth.
    """
    step = 1.0 / recording.duration_s
    first = highest_signal_hz + 1.8 * step
    if recording.command.mode != "whole_angle" or is_turned(recording):
        # what a switched drive excites falls fast with frequency, and the model takes it away: noise is measured among it, from where it
        # matters
        first = min(first, max(_SWITCHED_QUIET_HZ, 3.0 * step))
    last = max(min(first + max(_QUIET_HZ, 8.0 * step), _QUIET_TOP * recording.sample_rate_hz), first + 4.0 * step)
    if is_turned(recording):
        # a step of the table has its shape up there, which no log tells and no line of the signal needs
        last = max(min(last, _TURNED_QUIET * highest_signal_hz), highest_signal_hz + 8.0 * step)
    lines = np.geomspace(first, last, _QUIET_LINES)
    spaced = [lines[0]]
    for f in lines[1:]:
        if f - spaced[-1] >= 1.3 * step:
            spaced.append(f)
    # in the wave's own frame the even harmonics of psi are there, the odd ones are not
    turn = speed_rad_s / (2.0 * math.pi)
    if recording.command.mode == "whole_angle" and turn > 1.5 * step:
        spaced = [f for f in turn * (2.0 * np.arange(_HARMONICS) + 1.0) if f < first - 1.3 * step] + spaced
    excitation = recording.command.excitation
    if excitation.kind.endswith("modulation"):
        busy = excitation.frequency_hz * np.arange(1, 8)
        # of three periods there is nothing between the side bands: then above them
        beyond = [float(busy[-1]) + k * step for k in (2.0, 3.3, 4.6, 5.9)]
        spaced = [f for f in spaced if np.min(np.abs(busy - f)) > 1.7 * step] or beyond
    return [float(f) for f in spaced]
