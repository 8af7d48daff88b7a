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

__all__ = ["Swing", "find_swing"]

FloatArray = NDArray[np.float64]
#: bins about the mean, harmonics of a wave's turning and bins about those of a side band that belong to the signal; highest [Hz]
_LEAST_BINS, _HARMONICS, _SKIRT_BINS, _HIGHEST_HZ = 4.0, 16.0, 3.0, 12.0
#: log evidence beyond the search; what a size costs in each record; power over the floor that shows it, and in how many records at least
_MARGIN, _PRICE, _SHOWN, _FEWEST = 30.0, 2.0, 8.0, 2
#: a recording shorter than this says nothing [s]; fewest bins of a kind from which its floor is measured
_SHORTEST_S, _FEWEST_BINS = 3.5, 24
#: distance of the frequencies that are tried, in bins of the longest record
_STEP_BINS = 0.5
#: what swings, by channel
_WORDS = {
    "amplitude": ("drive or pick-off", "in phase", "a gain or a loss"),
    "frequency": ("dynamics", "in quadrature", "the stiffness or a delay"),
    "precession": ("dynamics", "in phase", "the rate or a cross coupling"),
    "quadrature": ("dynamics", "in quadrature", "the cross stiffness"),
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
    """

    channel: str
    frequency_hz: float
    log_evidence: float
    records: int

    def unknown(self) -> Unknown:
        """As a finding."""
        location, phase, what = _WORDS[self.channel]
        form = f"x times {what} that goes to and fro every {1.0 / self.frequency_hz:.3g} s"
        return Unknown(location, phase, form, "time", "", 2.0 * self.log_evidence)


@dataclass(frozen=True)
class _Spectrum:
    """Power over the floor of one channel of one record, by bin; NaN where it holds signal."""

    bin_hz: float
    ratio: FloatArray

    def at(self, frequency_hz: FloatArray) -> FloatArray:
        places = np.round(frequency_hz / self.bin_hz).astype(int)
        return np.where(places < self.ratio.size, self.ratio[np.minimum(places, self.ratio.size - 1)], np.nan)


def find_swing(flows: Sequence[FlowLeft]) -> Swing | None:
    """The swing of most evidence, if it is one.

    Parameters
    ----------
    flows : sequence of FlowLeft
    """
    long_enough = [flow for flow in flows if flow.duration_s >= _SHORTEST_S]
    if len(long_enough) < _FEWEST:
        return None
    step = _STEP_BINS / max(flow.duration_s for flow in long_enough)
    grid = np.arange(step, _HIGHEST_HZ, step)
    searched = math.log(len(CHANNELS) * grid.size)
    found = [swing for channel in CHANNELS if (swing := _of_channel(_spectra(long_enough, channel), grid, channel, searched)) is not None]
    return max(found, key=lambda swing: swing.log_evidence, default=None)


def _of_channel(spectra: Sequence[_Spectrum], grid: FloatArray, channel: str, searched: float) -> Swing | None:
    if not spectra:
        return None
    ratio = np.stack([s.at(grid) for s in spectra])
    heard = np.isfinite(ratio)
    z = np.where(heard, ratio, 1.0)
    each = np.where(heard, np.maximum(z - 1.0 - np.log(np.maximum(z, 1.0)), 0.0) - _PRICE, 0.0)
    shown = np.sum(heard & (z > _SHOWN), axis=0)
    # one record alone may have been disturbed: it does not count for more than all others
    evidence = np.where(shown >= _FEWEST, np.sum(each, axis=0) - np.max(each, axis=0), -np.inf)
    best = int(np.argmax(evidence))
    beyond = float(evidence[best]) - searched
    return Swing(channel, float(grid[best]), beyond, int(shown[best])) if beyond > _MARGIN else None


def _spectra(flows: Sequence[FlowLeft], channel: str) -> list[_Spectrum]:
    kinds: dict[tuple[object, ...], list[FlowLeft]] = defaultdict(list)
    for flow in flows:
        kinds[flow.kind].append(flow)
    found = []
    for members in kinds.values():
        powers = [_power(flow.rate[channel], flow.row_s) for flow in members]
        frequencies = [np.arange(p.size) / flow.duration_s for p, flow in zip(powers, members, strict=True)]
        held = [_hears(flow, f) for f, flow in zip(frequencies, members, strict=True)]
        if sum(int(h.sum()) for h in held) < _FEWEST_BINS:
            continue
        law = _floor(*(np.concatenate([x[h] for x, h in zip(of_all, held, strict=True)]) for of_all in (frequencies, powers)))
        for p, f, h, flow in zip(powers, frequencies, held, members, strict=True):
            found.append(_Spectrum(1.0 / flow.duration_s, np.where(h, p / (_basis(np.maximum(f, 1e-9)) @ law), np.nan)))
    return found


def _floor(f: FloatArray, power: FloatArray) -> FloatArray:
    """Coefficients of the floor over its basis: as bins tell that are no swing's, its slow part as all of them do.

    A resonance that wanders shows in the two or three lowest bins alone, which are as far above the others as a swing: a healthy
    hemisphere swung every 2.2 s by 90 of log evidence.
    """
    basis = _basis(f)
    return np.array(fit_law(basis, power).not_below(fit_law(basis, power, capped=False).slow_part).coefficients)


def _basis(f: FloatArray) -> FloatArray:
    """White, flicker, pick-off noise through the derivative, walk: shape (n, 4)."""
    return np.column_stack([np.ones_like(f), 1.0 / f, f**2, f**-2.0])


def _power(x: FloatArray, row_s: float) -> FloatArray:
    window = np.hanning(len(x))
    return np.asarray(np.abs(np.fft.rfft(x * window)) ** 2 * row_s / np.sum(window**2))


def _hears(flow: FlowLeft, f: FloatArray) -> NDArray[np.bool_]:
    """Bins that belong neither to the mean, nor to a turning wave, nor to a side band and its harmonics, and where no image stands."""
    bin_hz = 1.0 / flow.duration_s
    heard = (f > max(_LEAST_BINS * bin_hz, _HARMONICS * flow.turning_hz)) & (f < _HIGHEST_HZ)
    if flow.excited_hz > 0.0:
        heard &= np.abs(f - flow.excited_hz * np.round(f / flow.excited_hz)) > _SKIRT_BINS * bin_hz
    images = is_image(f, flow.carrier_hz, bin_hz) | is_image(-f, flow.carrier_hz, bin_hz)
    return np.asarray(heard & ~images)
