"""A line that goes with the wave: a gain that swings, or the phase of the reference, whether its frequency column says so or not.

Side bands ``V+`` and ``V-`` of a carrier ``V0`` are those of a gain where ``V+ V- / V0^2`` is above zero, of a phase where it is below. A
phase-locked loop answers what it sees, and a drive of another phase pulls the motion as much as the damping lets it; the swing of the
reference is what all three leave, ``(d/dt + 1/tau) arg V + omega - omega0``. Where nothing is left the column says all of it: the loop
itself swings, by a spur of its oscillator or of its detector.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ..recording.recording import Recording
from .parts import Linear
from .spectra import MEDIAN, detrended, plain_records, steep_window
from .tones import left_on_line

__all__ = ["is_driven", "phase_swing", "steered_swing"]

ComplexArray = NDArray[np.complex128]
#: share of the wave that its mean must be: one that turns has no carrier of its own
_STANDS = 0.9
#: how well one record's side bands tell the swing beside the loops' filters, over itself
_FILTERS = 0.05
#: frequencies that are tried within a bin to both sides
_TRIED = 17
#: share of a line that the log may leave beyond the floor of what it leaves, and that the reference must take; bins to both sides that tell
#: that floor
_LEFT, _TURNED, _FLOOR_BINS = 0.2, 0.5, (4, 12)
#: harmonics of a side band that hold signal, and bins about them
_OF_SIDE_BAND, _SKIRT_BINS = 5, 6.0


def steered_swing(recordings: Sequence[Recording], linear: Linear, frequency_hz: float) -> tuple[float, float] | None:
    """Amplitude and sd of the reference's phase by its own frequency column [rad], where that says all of a line; else nothing.

    Parameters
    ----------
    recordings : sequence of Recording
    linear : Linear
    frequency_hz : float
        Of the line, to a bin of the longest record.
    """
    found, moved, turned, left = [], 0.0, 0.0, 0.0
    for r, axis, carrier in _standing(recordings, frequency_hz):
        steered = detrended(r.ref_omega_rad_s[:, None].astype(np.complex128))[:, 0]
        f = max(_near(r, frequency_hz), key=lambda hz: abs(_line(r, steered, hz)))
        moved += _moved(r, linear, axis, f)
        turned += abs(_line(r, steered, f) * carrier) ** 2
        left += _left_of_line(r, linear, axis, f)
        found.append(2.0 * abs(_line(r, steered, f)) / (2.0 * np.pi * f))
    if not found or left > _LEFT * moved or turned < _TURNED * moved:
        return None
    size = float(np.median(found))
    return size, float(np.hypot(1.253 * np.std(found) / np.sqrt(len(found)), _FILTERS * size))


def is_driven(recordings: Sequence[Recording], linear: Linear, frequency_hz: float) -> bool:
    """Whether the log says all of a line that its frequency column does not have: the drives make it, as they are commanded."""
    moved, left = 0.0, 0.0
    for r, axis, _ in _standing(recordings, frequency_hz):
        f = max(_near(r, frequency_hz), key=lambda hz: abs(_line(r, detrended(r.pick)[:, axis], hz)))
        moved += _moved(r, linear, axis, f)
        left += _left_of_line(r, linear, axis, f)
    return moved > 0.0 and left < _LEFT * moved


def phase_swing(recordings: Sequence[Recording], linear: Linear, frequency_hz: float) -> tuple[float, float] | None:
    """Amplitude of the reference's phase at a frequency and its sd [rad]; nothing where the line is a gain's or no wave stands still.

    Parameters
    ----------
    recordings : sequence of Recording
    linear : Linear
        By whose damping a drive of another phase pulls the motion.
    frequency_hz : float
        Of the line, to a bin of the longest record.
    """
    found, sign = [], 0.0
    for r, axis, carrier in _standing(recordings, frequency_hz):
        v = detrended(r.pick)[:, axis]
        f = max(_near(r, frequency_hz), key=lambda hz: abs(_line(r, v, hz)) + abs(_line(r, v, -hz)))
        above, below = _line(r, v, f) / carrier, _line(r, v, -f) / carrier
        sign += float((above * below).real)
        steered = 2.0 * _line(r, detrended(r.ref_omega_rad_s[:, None].astype(np.complex128))[:, 0], f)
        omega = 2.0 * np.pi * f
        phase = -1j * (above - np.conj(below))
        found.append(abs((1j * omega - linear.A[axis, axis].real) * phase + steered) / omega)
    if not found or sign >= 0.0:
        return None
    size = float(np.median(found))
    return size, float(np.hypot(1.253 * np.std(found) / np.sqrt(len(found)), _FILTERS * size))


def _standing(recordings: Sequence[Recording], frequency_hz: float) -> Iterator[tuple[Recording, int, complex]]:
    """Plain records of a wave that stands along an axis, none of a side band with a harmonic there: that axis, and its mean volts."""
    for r in plain_records(recordings):
        side_band_hz = r.command.excitation.frequency_hz if r.command.excitation.kind != "none" else 0.0
        harmonic = min(round(frequency_hz / side_band_hz), _OF_SIDE_BAND) if side_band_hz > 0.0 else 0
        if harmonic and abs(frequency_hz - harmonic * side_band_hz) * r.duration_s < _SKIRT_BINS:
            continue
        axis = int(np.argmax(np.mean(np.abs(r.pick) ** 2, axis=0)))
        carrier = complex(r.pick[:, axis].mean())
        if abs(carrier) ** 2 >= _STANDS * float(np.mean(np.abs(r.pick[:, axis]) ** 2)):
            yield r, axis, carrier


def _near(r: Recording, frequency_hz: float) -> list[float]:
    """Frequencies within a bin."""
    return [float(f) for f in frequency_hz + np.linspace(-1.0, 1.0, _TRIED) / r.duration_s]


def _about(r: Recording, frequency_hz: float) -> list[float]:
    """Bins to both sides beyond the line's own."""
    first, last = _FLOOR_BINS
    return [frequency_hz + side * k / r.duration_s for side in (-1, 1) for k in range(first, last + 1)]


def _moved(r: Recording, linear: Linear, axis: int, away_hz: float) -> float:
    """Power of what must move an axis as its line does [V^2/s^2]."""
    return float(abs((2j * np.pi * away_hz - linear.A[axis, axis]) * _line(r, detrended(r.pick)[:, axis], away_hz)) ** 2)


def _left_of_line(r: Recording, linear: Linear, axis: int, away_hz: float) -> float:
    """Of that power what the log leaves, over the floor about it."""
    floor = float(np.median([_left(r, linear, axis, hz) for hz in _about(r, away_hz)])) / MEDIAN
    return _left(r, linear, axis, away_hz) - floor


def _left(r: Recording, linear: Linear, axis: int, away_hz: float) -> float:
    """Power of what the log leaves of an axis' slow flow at a distance from the carrier [V^2/s^2]."""
    return float(abs(left_on_line(r, linear, away_hz)[axis]) ** 2)


def _line(r: Recording, x: ComplexArray, away_hz: float) -> complex:
    """Complex amplitude at a distance from the carrier."""
    window = steep_window(len(r))
    return complex((window * np.exp(-2j * np.pi * away_hz * (r.t - r.t[0]))) @ x / window.sum())
