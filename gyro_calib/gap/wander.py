"""How a resonance wandered within a recording, told by the recording itself, for what feeds through and does not wander with it.

A millikelvin moves the resonance of a hemisphere by 4 mrad/s. On the wave that is the noise of its frequency channel, which is known as
such; but of the volts ``V = m + E u`` only m goes with it. What feeds through is, with 2.4 V of virtual precession and E = 2e-4, half a
thousandth of the wave, and comes out across it: four standard deviations at the lowest lines of a ninth plant's precessing waves, healthy
ones, which were *unknown* for it. The frequency channel itself tells the course a hundred times as well as that asks for, also of what is
as fast as the wave turns: of a healthy hemisphere of a nineteenth plant that left 1489 in chi-square of 1395 degrees of freedom, and a
cube of a pick-off that it did not have took 63 of them; followed it leaves 1385.

Where the temperature or the rate moves, or the amplitude is modulated, effects move the resonance as well and have their own column there;
those recordings are left alone here, and those that warm are asked how much of it feeds through (:mod:`.wander_feeds`). Left alone is what
goes with the azimuth of waves that turn, too, if it is more than a wander makes by chance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

from ..recording.applied_rate import is_turned
from .evidence import CampaignEvidence, RecordingEvidence
from .flow_left import rows_left
from .nuisance import SWITCHED
from .parts import Linear
from .whittle import likeliest

__all__ = ["FASTEST_HZ", "Spectrum", "harmonics_of", "is_moved_by_temperature", "tells_its_wander", "wander_within"]

FloatArray = NDArray[np.float64]
#: highest frequency of a wander that is followed [Hz]
FASTEST_HZ = 2.0
#: azimuth that a wave at rest keeps to [rad]; harmonics of the azimuth that belong to the device
_AT_REST, _HARMONICS = 0.3, (2.0, 4.0)
#: chi-square of those harmonics, four sizes, that a wander does not reach; share of what recordings would take with sizes of their own
_SURELY, _ALIKE = 25.0, 0.4


@dataclass(frozen=True)
class Spectrum:
    """Density of the frequency of waves: a wander falls with f, forces that turn the phase are white, noise of the pick-offs rises.

    Parameters
    ----------
    walk, flicker, white, pickoff : float
        One-sided at 1 Hz [rad^2/s^2/Hz], with 1/f^2, 1/f, 1 and f^2.
    """

    walk: float
    flicker: float
    white: float
    pickoff: float

    @classmethod
    def of(cls, courses: Mapping[int, FloatArray], row_s: Mapping[int, float]) -> Spectrum:
        """The likeliest one of recordings [rad/s by row], by their half cosines; none at all of no recordings."""
        if not courses:
            return cls(0.0, 0.0, 0.0, 0.0)
        f, squares = [], []
        for k, x in courses.items():
            hz = _frequencies(len(x), row_s[k])
            heard = (hz > 0.0) & (hz < FASTEST_HZ)
            f.append(hz[heard])
            squares.append(2.0 * row_s[k] * _cosines(x)[heard] ** 2)
        own = np.concatenate(f)
        found = likeliest(np.column_stack([own**-2.0, 1.0 / own, np.ones_like(own), own**2.0]), np.concatenate(squares))
        return cls(*map(float, found))

    def wander(self, x: FloatArray, row_s: float) -> FloatArray:
        """The part of rows that is wander, by Wiener; their mean is."""
        hz = _frequencies(len(x), row_s)
        f = np.maximum(hz, hz[1])
        share = np.where(hz < FASTEST_HZ, self._slow(f) / np.maximum(self._whole(f), 1e-300), 0.0)
        share[0] = 1.0
        return np.asarray(idct(share * _cosines(x), norm="ortho"))

    def whitened(self, x: FloatArray, row_s: float) -> FloatArray:
        """Half cosines of rows within what is followed, but for their mean, in units of their standard deviations."""
        hz = _frequencies(len(x), row_s)
        heard = (hz > 0.0) & (hz < FASTEST_HZ)
        return np.asarray(_cosines(x)[heard] * np.sqrt(2.0 * row_s / np.maximum(self._whole(hz[heard]), 1e-300)))

    def _slow(self, f: FloatArray) -> FloatArray:
        return self.walk * f**-2.0 + self.flicker / f

    def _whole(self, f: FloatArray) -> FloatArray:
        return self._slow(f) + self.white + self.pickoff * f**2.0


def wander_within(evidence: CampaignEvidence, linear: Linear) -> tuple[FloatArray, ...]:
    """Distance of the resonance beyond what ``linear`` knows of it [rad/s], by recording, shape (n,) each; zero where it is left alone."""
    told = {r.index: rows_left(r.signals, linear) for r in evidence if tells_its_wander(r)}
    courses = {k: along.imag for k, (_, along, _) in told.items()}
    row_s = {r.index: r.signals.row_s for r in evidence}
    spectrum = Spectrum.of(courses, row_s)
    turning = {k: azimuth for k, (azimuth, _, _) in told.items() if abs(float(azimuth[-1] - azimuth[0])) > _AT_REST}
    of_device = harmonics_of(turning, courses, row_s, spectrum)
    found = {k: spectrum.wander(x - of_device.get(k, 0.0), row_s[k]) for k, x in courses.items()}
    return tuple(found.get(r.index, np.zeros(len(r.signals.time_s))) for r in evidence)


def tells_its_wander(r: RecordingEvidence) -> bool:
    """Whether nothing but the resonator's own millikelvins moves the frequency of a recording's wave."""
    return _is_left_to_itself(r) and not r.is_warming


def is_moved_by_temperature(r: RecordingEvidence) -> bool:
    """Whether nothing but a temperature that is on its way moves it."""
    return _is_left_to_itself(r) and r.is_warming


def _is_left_to_itself(r: RecordingEvidence) -> bool:
    command = r.recording.command
    still = command.excitation.kind == "none" and command.mode not in SWITCHED
    return r.is_wave and still and not is_turned(r.recording)


def harmonics_of(
    turning: Mapping[int, FloatArray], courses: Mapping[int, FloatArray], row_s: Mapping[int, float], spectrum: Spectrum
) -> dict[int, FloatArray]:
    """What goes with the azimuth of waves that turn, alike in all of them, by recording; nothing where a wander makes as much.

    Parameters
    ----------
    turning : mapping
        Azimuth of waves [rad], shape (n,), by recording.
    courses : mapping
        Frequency that is left [rad/s], shape (n,), of these and others.
    row_s : mapping
        Time between rows [s].
    spectrum : Spectrum

    Returns
    -------
    dict
        By recording [rad/s], shape (n,).
    """
    shapes = {k: np.column_stack([f(h * azimuth) for h in _HARMONICS for f in (np.cos, np.sin)]) for k, azimuth in turning.items()}
    white = [np.column_stack([spectrum.whitened(x, row_s[k]) for x in (*shape.T, courses[k])]) for k, shape in shapes.items()]
    if not white:
        return {}
    sizes, gain = _fitted(np.concatenate(white))
    if gain < max(_SURELY, _ALIKE * sum(_fitted(of_one)[1] for of_one in white)):
        return {}
    return {k: shape @ sizes for k, shape in shapes.items()}


def _fitted(white: FloatArray) -> tuple[FloatArray, float]:
    """Sizes of all columns but the last, which is fitted, and the chi-square that they take."""
    sizes, *_ = np.linalg.lstsq(white[:, :-1], white[:, -1], rcond=None)
    return np.asarray(sizes, dtype=np.float64), float(np.sum((white[:, :-1] @ sizes) ** 2))


def _frequencies(rows: int, row_s: float) -> FloatArray:
    return np.asarray(np.arange(rows) / (2.0 * rows * row_s))


def _cosines(x: FloatArray) -> FloatArray:
    return np.asarray(dct(x, norm="ortho"))
