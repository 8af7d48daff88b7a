"""Does what a recording was commanded stand in its attributes? What moves the wave and is not said would be an effect of the device."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..errors import DataError
from ..estimation.wave import wave_coordinates
from ..recording.applied_rate import is_turned
from ..recording.recording import Recording

__all__ = ["check_commanded"]

#: share of a wave that is left at the second half of a record over that of the first, of which the decay alone leaves at most so much
_STAYS, _DECAYED = 0.95, 0.8
#: share of the largest wave below which a gyro rests
_RESTS = 3e-3
#: drive of an axis over what the recordings' largest carries, from which on it acts
_ACTS = 1e-3
#: swing of a held wave's amplitude that no loop leaves, relative to its mean, less a parabola in time
_SWINGS = 0.02
#: an open drive's volts over the stated ones, against the other open drives' (a multiplexed drive acts for a share of the time)
_UNLIKE = 0.25
_FEWEST_OPEN = 3
#: a wave is turned by so much [rad of psi], by so many of the most volts, for its sense to be told; share of the turned records that have
#: the others' sense
_TURNED_RAD, _STRONG, _MOST_SENSE = 0.2, 0.4, 0.7


def check_commanded(recordings: Sequence[Recording], decay_rate: float) -> None:
    """Refuse recordings that something moves of which their attributes say nothing, or another thing than those of the others.

    Parameters
    ----------
    recordings : sequence of Recording
    decay_rate : float
        1/tau of the factory [1/s].

    Raises
    ------
    DataError
        Names the recording, what is seen and the attribute.
    """
    largest_v = max((float(np.abs(r.drive).max()) for r in recordings), default=0.0)
    wave_v = max((float(np.sqrt(np.mean(np.abs(r.pick) ** 2))) for r in recordings), default=0.0)
    for r in recordings:
        if r.command.mode == "loops_off" and r.command.excitation.kind not in ("drive", "body"):
            _check_free(r, decay_rate, largest_v, wave_v)
        if r.command.mode.startswith("ftr"):
            _check_held(r)
    _check_open_volts([r for r in recordings if r.command.mode == "loops_off" and r.command.excitation.kind == "drive"])
    _check_senses([r for r in recordings if r.command.setpoints.virtual_precession_v != 0.0 and not is_turned(r)])


def _check_free(r: Recording, decay_rate: float, largest_v: float, wave_v: float) -> None:
    """With loops off and no excitation a wave decays, and no drive acts."""
    volts = np.median(np.abs(r.drive), axis=0)
    axis = int(np.argmax(volts))
    if volts[axis] > _ACTS * largest_v:
        raise DataError(
            f"Recording {r.label!r} says that its loops are off and nothing excites it, but its {'xy'[axis]} drive carries "
            f"{volts[axis]:.4g} V. Give the attribute open_drive (frequency, axis, volts), or correct the mode."
        )
    half = len(r) // 2
    first, second = (float(np.sqrt(np.mean(np.abs(part) ** 2))) for part in (r.pick[:half], r.pick[half:]))
    # what is left of a wave that was braked is noise
    if math.exp(-0.5 * decay_rate * r.duration_s) < _DECAYED and second > max(_STAYS * first, _RESTS * wave_v):
        raise DataError(
            f"Recording {r.label!r} says that its loops are off and nothing excites it, but its wave of {second:.4g} V does not decay. "
            "Give the attribute body_excitation (frequency, volts) or open_drive, or leave the recording out."
        )


def _check_held(r: Recording) -> None:
    """A held wave whose amplitude swings is modulated."""
    if r.command.excitation.kind != "none" or is_turned(r):
        return
    amplitude = np.sqrt(np.sum(np.abs(r.pick) ** 2, axis=1))
    place = np.linspace(-1.0, 1.0, len(r))
    left = amplitude - np.polynomial.polynomial.polyval(place, np.polynomial.polynomial.polyfit(place, amplitude, 2))
    if float(left.std()) > _SWINGS * float(amplitude.mean()):
        power = np.abs(np.fft.rfft(left * np.hanning(len(r)))) ** 2
        every_s = r.duration_s / max(float(np.argmax(power)), 1e-9)
        share = math.sqrt(2.0) * float(left.std() / amplitude.mean())
        raise DataError(
            f"Recording {r.label!r} says that its wave is held, but its amplitude swings by {100 * share:.3g} % about every "
            f"{every_s:.3g} s. Give the attribute excitation (kind, m, nu_hz), or record after the loop has settled."
        )


def _check_open_volts(opened: Sequence[Recording]) -> None:
    if len(opened) < _FEWEST_OPEN:
        return
    carried = [float(np.median(np.abs(r.drive[:, "xy".index(r.command.excitation.axis)]))) for r in opened]
    ratios = np.array([v / max(abs(r.command.excitation.volts), 1e-300) for v, r in zip(carried, opened, strict=True)])
    usual = float(np.median(ratios))
    for r, volts, ratio in zip(opened, carried, ratios, strict=True):
        if abs(ratio / max(usual, 1e-300) - 1.0) > _UNLIKE:
            raise DataError(
                f"Recording {r.label!r} says that {r.command.excitation.axis} is driven with {r.command.excitation.volts:.4g} V, but its "
                f"column shows {volts:.4g} V, {ratio:.3g} of that, where the other open drives show {usual:.3g}. Correct the attribute."
            )


def _check_senses(turned: Sequence[Recording]) -> None:
    """Waves turn with the sign of the volts that turn them, or all of them against it."""
    volts = [r.command.setpoints.virtual_precession_v for r in turned]
    strongest = max((abs(v) for v in volts), default=0.0)
    # a slow one may be turned back by the drift of the device
    strong = [(r, v, wave_coordinates(r).azimuth_rad) for r, v in zip(turned, volts, strict=True) if abs(v) > _STRONG * strongest]
    angles = [(r, v, float(psi[-1] - psi[0])) for r, v, psi in strong]
    senses = [(r, math.copysign(1.0, a * v)) for r, v, a in angles if abs(a) > _TURNED_RAD]
    usual = math.copysign(1.0, sum(s for _, s in senses)) if senses else 0.0
    others = [r for r, s in senses if s != usual]
    if others and len(senses) - len(others) >= _MOST_SENSE * len(senses):
        r = others[0]
        raise DataError(
            f"Recording {r.label!r} says virtual_precession_V = {r.command.setpoints.virtual_precession_v:+.4g}, but its wave turns the "
            f"other way than those of the other {len(senses) - len(others)} do. Correct the sign of the attribute, or swap the axes."
        )
