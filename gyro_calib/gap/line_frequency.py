"""Where between two bins a line stands, told by all the records that hold it.

Records of one length have their bins in the same places, and what the nearest bin is wrong by is wrong in all of them: a spur at 24.155 Hz
came out as 24.111 +- 0.009 Hz where a record lasts twelve seconds. Between the bins the power of a line ``A exp(2 pi i f t)`` beside noise
is highest near its frequency, by a window w of moments ``W_n = sum w t^n`` (about its middle) and ``Q_n = sum w^2 t^n`` with a variance

    var f = Q_2 W_0^2 / (8 pi^2 z W_2^2 Q_0)

of a power z over the floor; records, axes and sides of the carrier add their information. A wave that turns parts a line of its phase in
two, by its turns a second to both sides: waves that stand say where it is, where there are any.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .spectra import PickSpectrum, detrended, steep_window, turns_of

__all__ = ["shift_of_line"]

FloatArray = NDArray[np.float64]
#: how far from the nearest bin a line is looked for [bins], and how finely
_FARTHEST, _PLACES = 0.75, 61
#: turns of a record's wave below which it stands
_STILL_TURNS = 0.05


def shift_of_line(spectra: Sequence[PickSpectrum], away_hz: Sequence[float], sides: Sequence[float]) -> tuple[float, float]:
    """How far a line lies beyond where bins have it, and the standard deviation of its frequency [Hz].

    Parameters
    ----------
    spectra : sequence of PickSpectrum
        Of the records that hold it.
    away_hz : sequence of float
        Where the bins have it, from the carrier of each record.
    sides : sequence of float
        Sides of the carrier at which it stands, 1 and -1 or one of them: it lies farther to both by the same.
    """
    turns = [turns_of(s.recording) for s in spectra]
    standing = [k for k, turned in enumerate(turns) if turned < _STILL_TURNS]
    if standing:
        spectra, away_hz = [spectra[k] for k in standing], [away_hz[k] for k in standing]
    apart_hz = 0.0 if standing else max(turned * s.bin_hz for turned, s in zip(turns, spectra, strict=True))
    shifts = _FARTHEST * max(s.bin_hz for s in spectra) * np.linspace(-1.0, 1.0, _PLACES)
    power, information = np.zeros(_PLACES), 0.0
    for s, away in zip(spectra, away_hz, strict=True):
        window, time = steep_window(len(s.recording)), s.recording.t - s.recording.t.mean()
        x = window[:, None] * detrended(s.recording.pick)
        for side in sides:
            heard = np.abs(np.exp(-2j * np.pi * side * np.outer(away + shifts, time)) @ x) ** 2
            nearest = round(side * away / s.bin_hz) * s.bin_hz
            on_bin = np.maximum(np.abs(np.exp(-2j * np.pi * nearest * time) @ x) ** 2, 1e-300)
            over = heard * s.at(np.array([nearest]))[0] / on_bin
            power += over.sum(axis=1)
            information += float(np.sum(np.maximum(over.max(axis=0) - 1.0, 0.0))) / _variance(window, time)
    return _highest(shifts, power), math.hypot(apart_hz, 1.0 / math.sqrt(max(information, 1e-300)))


def _variance(window: FloatArray, time_s: FloatArray) -> float:
    """Of the frequency of a line that is as loud as the floor [Hz^2]."""
    w0, w2 = float(np.sum(window)), float(np.sum(window * time_s**2))
    q0, q2 = float(np.sum(window**2)), float(np.sum(window**2 * time_s**2))
    return q2 * w0**2 / (8.0 * math.pi**2 * w2**2 * q0)


def _highest(places: FloatArray, power: FloatArray) -> float:
    """By a parabola through the three highest."""
    k = int(np.clip(np.argmax(power), 1, len(power) - 2))
    before, middle, after = power[k - 1 : k + 2]
    bend = before - 2.0 * middle + after
    off = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return float(places[k] + np.clip(off, -1.0, 1.0) * (places[1] - places[0]))
