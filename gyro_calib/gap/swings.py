"""Something goes to and fro some times in a record: a gain, a loss, a stiffness or a rate.

It is too fast for a course of time (:mod:`.courses`) and too near the carrier for the spectra of the pick-offs (:mod:`.spectra`).
It stands at one frequency in the spectra of what the linear device leaves of the slow flow (:mod:`.flow_left`), over their own floor, in
several records and in one or two of the four channels. The evidence is that of :mod:`.tones`.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .diagnosis import Unknown
from .evidence import CHANNELS
from .flow_left import FlowLeft
from .noise_law import fit_law
from .spectra import is_image

__all__ = ["HIGHEST_HZ", "SHORTEST_S", "Kind", "Swing", "find_swing", "is_imaged", "kinds_of"]

FloatArray = NDArray[np.float64]
#: bins about the mean, harmonics of a wave's turning, harmonics of a side band and bins about them that belong to the signal; highest [Hz]
_LEAST_BINS, _HARMONICS, _OF_SIDE_BAND, _SKIRT_BINS, HIGHEST_HZ = 4.0, 16.0, 5.0, 3.0, 12.0
#: log evidence beyond the search (26 healthy campaigns came to 1.2 at most); what a size costs in each record; power over the floor that
#: shows it, and in how many records at least
_MARGIN, _PRICE, _SHOWN, _FEWEST = 20.0, 2.0, 8.0, 2
#: a swing stands over the bins below it too: lowest bin of a floor, bins about a frequency that are its own, fewest below those in a record
_LOWEST_BIN, _OWN_BINS, _BELOW = 2.0, 2.0, 2
#: bins to either side whose median a swing must stand over as well, and how few of them tell one
_ABOUT_BINS, _FEWEST_ABOUT = 12.0, 10
#: frequencies of most evidence that are asked so
_ASKED = 6
#: a recording shorter than this says nothing [s]; fewest bins of a kind from which its floor is measured
SHORTEST_S, _FEWEST_BINS = 3.5, 24
#: frequency from which on nothing but electronics moves a resonance's frequency or its reference's [Hz]
_FASTER_HZ = 1.0
#: distance of the frequencies that are tried, in bins of the longest record
_STEP_BINS = 0.5
#: what swings, by channel
_WORDS = {
    "amplitude": ("drive or pick-off", "in phase", "a gain or a loss"),
    "frequency": ("dynamics", "in quadrature", "the stiffness or a delay"),
    "precession": ("environment", "in phase", "the rate, as of a base that sways, or a cross coupling"),
    "quadrature": ("dynamics", "in quadrature", "the cross stiffness"),
}
#: the same of what is another in waves of another azimuth
_WORDS_BY_AZIMUTH = {
    "amplitude": ("drive or pick-off", "in phase", "an unequal gain or loss of the axes"),
    "frequency": ("dynamics", "in quadrature", "a split"),
    "precession": ("dynamics or pick-off", "in phase", "an unequal loss or gain of the axes"),
    "quadrature": ("dynamics", "in quadrature", "a split"),
}


@dataclass(frozen=True)
class Swing:
    """What goes to and fro.

    Parameters
    ----------
    channel : str
    frequency_hz : float
    log_evidence : float
        Beyond the search.
    records : int
        That show it.
    size : float
        Amplitude of the relative rate of change [1/s], of a steady one; 0 where each record has its own.
    size_sd, frequency_sd_hz : float
    phase_rad, phase_sd_rad : float
        Of its cosine at the zero of the device's clock, of a steady one.
    shape : str
        How it goes with the azimuth psi of the wave; "": not at all.
    """

    channel: str
    frequency_hz: float
    log_evidence: float
    records: int
    size: float = 0.0
    size_sd: float = 0.0
    frequency_sd_hz: float = 0.0
    phase_rad: float = 0.0
    phase_sd_rad: float = 0.0
    shape: str = ""

    @property
    def is_a_rate(self) -> bool:
        """Whether it is a rate that keeps its time: of a base that sways."""
        return self.channel == "precession" and self.size > 0.0 and not self.shape

    @property
    def swings_the_phase(self) -> bool:
        """Whether it is the reference's phase: a resonance that follows its temperature is slower."""
        return self.channel == "frequency" and self.size > 0.0 and self.frequency_hz > _FASTER_HZ and not self.shape

    def unknown(self) -> Unknown:
        """As a finding."""
        location, phase, what = (_WORDS_BY_AZIMUTH if self.shape else _WORDS)[self.channel]
        goes = f", in waves of azimuth psi as {self.shape}" if self.shape else ""
        form = f"x times {what} that goes to and fro every {1.0 / self.frequency_hz:.3g} s{goes}"
        return Unknown(location, phase, form, "time", "", 2.0 * self.log_evidence)


@dataclass(frozen=True)
class _Spectrum:
    """Power of one channel of one record, by bin, where something may be heard, and where no more than its floor."""

    bin_hz: float
    frequency_hz: FloatArray
    power: FloatArray
    heard: NDArray[np.bool_]
    low: NDArray[np.bool_]

    @classmethod
    def of(cls, flow: FlowLeft, channel: str) -> _Spectrum:
        """Of what a channel of a record leaves."""
        power = _power(flow.rate[channel], flow.row_s)
        frequency_hz = np.arange(power.size) / flow.duration_s
        heard, low = (_hears(flow, frequency_hz, least) for least in (_LEAST_BINS, _LOWEST_BIN))
        return cls(1.0 / flow.duration_s, frequency_hz, power, heard, low)

    def beside(self, apart_hz: float | None) -> NDArray[np.bool_]:
        """Bins of its floor: those about a frequency are not of it where enough are left below."""
        if apart_hz is None:
            return self.low
        own = np.abs(self.frequency_hz - apart_hz) <= _OWN_BINS * self.bin_hz
        below = self.low & ~own & (self.frequency_hz < apart_hz)
        return self.low & ~own if int(below.sum()) >= _BELOW else self.low


@dataclass(frozen=True)
class Kind:
    """Records that share a floor."""

    flows: tuple[FlowLeft, ...]
    spectra: tuple[_Spectrum, ...]

    def over_floor(self, grid: FloatArray, apart_hz: float | None) -> list[FloatArray]:
        """Power over the floor by record, at every frequency of a grid; NaN where it holds signal."""
        found = []
        for s, floor in zip(self.spectra, self.floors(grid, apart_hz), strict=True):
            places = np.minimum(np.round(grid / s.bin_hz).astype(int), s.power.size - 1)
            found.append(s.power[places] / floor)
        return found

    def tells_floor(self, grid: FloatArray, fewest: int) -> NDArray[np.bool_]:
        """Whether so many records or more have bins down to each frequency."""
        lowest = [s.frequency_hz[s.low].min(initial=np.inf) for s in self.spectra]
        return np.sum(np.array(lowest)[:, None] <= grid, axis=0) >= fewest

    @property
    def lowest_hz(self) -> float:
        """From where on any record tells the floor: images may cover all below some hertz."""
        return min(float(s.frequency_hz[s.low].min(initial=np.inf)) for s in self.spectra)

    def law(self, grid: FloatArray) -> FloatArray:
        """The floor at frequencies, whatever stands there."""
        return np.asarray(_basis(grid) @ self._floor(None))

    def floors(self, grid: FloatArray, apart_hz: float | None) -> list[FloatArray]:
        """The floor by record at the bins of every frequency of a grid; NaN where they hold signal."""
        law = self._floor(apart_hz)
        if apart_hz is not None:
            law = law * max(1.0, self._about(apart_hz, law))
        found = []
        for s in self.spectra:
            places = np.minimum(np.round(grid / s.bin_hz).astype(int), s.power.size - 1)
            there = s.heard[places] & (np.round(grid / s.bin_hz) < s.power.size)
            found.append(np.where(there, _basis(np.maximum(s.frequency_hz[places], 1e-9)) @ law, np.nan))
        return found

    def _about(self, apart_hz: float, law: FloatArray) -> float:
        """Median power over a floor of the bins to both sides of a frequency: a loop's own hump is no line.

        Reference and resonance of a healthy hemisphere had three times as much from 1 to 3 Hz as white, flicker and walk say.
        """
        ratios = []
        for s in self.spectra:
            apart = np.abs(s.frequency_hz - apart_hz) / s.bin_hz
            near = s.low & (apart > _OWN_BINS) & (apart <= _ABOUT_BINS)
            ratios.append(s.power[near] / (_basis(s.frequency_hz[near]) @ law))
        together = np.concatenate(ratios)
        return float(np.median(together)) / math.log(2.0) if together.size >= _FEWEST_ABOUT else 1.0

    def _floor(self, apart_hz: float | None) -> FloatArray:
        """Coefficients of the floor over its basis: as bins tell that are no swing's; ``apart_hz``: its slow part as all others do.

        A resonance that wanders shows in the two or three lowest bins alone, which are as far above the others as a swing: a healthy
        hemisphere swung every 2.2 s by 90 of log evidence.
        """
        law = fit_law(*self._bins([s.heard for s in self.spectra]))
        if apart_hz is not None:
            law = law.not_below(fit_law(*self._bins([s.beside(apart_hz) for s in self.spectra]), capped=False).slow_part)
        return np.array(law.coefficients)

    def _bins(self, which: Sequence[NDArray[np.bool_]]) -> tuple[FloatArray, FloatArray]:
        frequency_hz = np.concatenate([s.frequency_hz[w] for s, w in zip(self.spectra, which, strict=True)])
        return _basis(frequency_hz), np.concatenate([s.power[w] for s, w in zip(self.spectra, which, strict=True)])


def find_swing(flows: Sequence[FlowLeft]) -> Swing | None:
    """The swing of most evidence, if it is one.

    Parameters
    ----------
    flows : sequence of FlowLeft
    """
    long_enough = [flow for flow in flows if flow.duration_s >= SHORTEST_S]
    if len(long_enough) < _FEWEST:
        return None
    step = _STEP_BINS / max(flow.duration_s for flow in long_enough)
    grid = np.arange(step, HIGHEST_HZ, step)
    searched = math.log(len(CHANNELS) * grid.size)
    found = [swing for channel in CHANNELS if (swing := _of_channel(kinds_of(long_enough, channel), grid, channel, searched)) is not None]
    return max(found, key=lambda swing: swing.log_evidence, default=None)


def _of_channel(kinds: Sequence[Kind], grid: FloatArray, channel: str, searched: float) -> Swing | None:
    """The frequency of most evidence that stands over the floor of the bins on both of its sides."""
    evidence, _ = _told(kinds, grid)
    for _ in range(_ASKED):
        best = int(np.argmax(evidence)) if evidence.size else 0
        if not evidence.size or evidence[best] - searched <= _MARGIN:
            return None
        asked, shown = _told(kinds, grid[best : best + 1], apart_hz=float(grid[best]))
        beyond = float(asked[0]) - searched
        if beyond > _MARGIN:
            return Swing(channel, float(grid[best]), beyond, int(shown[0]))
        evidence[max(best - 1, 0) : best + 2] = -np.inf
    return None


def _told(kinds: Sequence[Kind], grid: FloatArray, apart_hz: float | None = None) -> tuple[FloatArray, NDArray[np.int_]]:
    """Log evidence at every frequency, and how many records show it."""
    ratios = [ratio for kind in kinds for ratio in kind.over_floor(grid, apart_hz)]
    if not ratios:
        return np.array([]), np.array([], dtype=int)
    ratio = np.stack(ratios)
    heard = np.isfinite(ratio)
    z = np.where(heard, ratio, 1.0)
    each = np.where(heard, np.maximum(z - 1.0 - np.log(np.maximum(z, 1.0)), 0.0) - _PRICE, 0.0)
    shown = np.sum(heard & (z > _SHOWN), axis=0)
    # one record alone may have been disturbed: it does not count for more than all others
    return np.where(shown >= _FEWEST, np.sum(each, axis=0) - np.max(each, axis=0), -np.inf), shown


def kinds_of(flows: Sequence[FlowLeft], channel: str) -> list[Kind]:
    """Records by what they share a floor with, of kinds that tell one."""
    of_kind: dict[tuple[object, ...], list[FlowLeft]] = defaultdict(list)
    for flow in flows:
        of_kind[flow.kind].append(flow)
    kinds = [Kind(tuple(members), tuple(_Spectrum.of(flow, channel) for flow in members)) for members in of_kind.values()]
    return [kind for kind in kinds if sum(int(s.heard.sum()) for s in kind.spectra) >= _FEWEST_BINS]


def _basis(f: FloatArray) -> FloatArray:
    """White, flicker, pick-off noise through the derivative, walk: shape (n, 4)."""
    return np.column_stack([np.ones_like(f), 1.0 / f, f**2, f**-2.0])


def _power(x: FloatArray, row_s: float) -> FloatArray:
    window = np.hanning(len(x))
    return np.asarray(np.abs(np.fft.rfft(x * window)) ** 2 * row_s / np.sum(window**2))


def _hears(flow: FlowLeft, f: FloatArray, least_bins: float) -> NDArray[np.bool_]:
    """Bins from one on that belong neither to a turning wave nor to a side band and its harmonics, and where no image stands."""
    bin_hz = 1.0 / flow.duration_s
    heard = (f > max(least_bins * bin_hz, _HARMONICS * flow.turning_hz)) & (f < HIGHEST_HZ)
    if flow.excited_hz > 0.0:
        nearest = np.minimum(np.round(f / flow.excited_hz), _OF_SIDE_BAND)
        heard &= np.abs(f - flow.excited_hz * nearest) > _SKIRT_BINS * bin_hz
    return np.asarray(heard & ~is_imaged(flow, f))


def is_imaged(flow: FlowLeft, f: FloatArray, skirt_hz: float = 0.0) -> NDArray[np.bool_]:
    """Whether an image of the carrier's harmonics stands at a frequency of what is left, or on its skirt if that is known."""
    busy_hz, bin_hz = max(flow.excited_hz, flow.turning_hz), 1.0 / flow.duration_s
    images = [is_image(side * f, flow.carrier_hz, bin_hz, busy_hz, 1.0 / flow.row_s, skirt_hz) for side in (1.0, -1.0)]
    return np.asarray(np.any(images, axis=0))
