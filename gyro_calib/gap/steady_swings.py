"""Something goes to and fro at one frequency, one size and one phase on the device's clock through the whole campaign.

A bench that rocks, a supply that hums. In no record need it stand over the floor: all of them together tell it, for it has two unknowns
where :mod:`.swings` gives each record two of its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import zoom_fft

from .evidence import CHANNELS
from .flow_left import FlowLeft
from .swings import HIGHEST_HZ, SHORTEST_S, Kind, Swing, kinds_of

__all__ = ["find_steady_swing"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: fewest records that tell it; distance of the frequencies that are tried, over what one campaign tells apart; how many are tried at
#: most, of a campaign of hours the lower ones
_FEWEST, _STEP, _MOST = 6, 0.25, 40_000
#: records of a kind that tell their floor at its lowest bins too: of two of a hemisphere it was a thousandth of the resonance's wander
_OWN_FLOOR = 4
#: log evidence beyond the search from which on it is one
_MARGIN = 12.0


def find_steady_swing(flows: Sequence[FlowLeft]) -> Swing | None:
    """The steady swing of most evidence, if it is one.

    Parameters
    ----------
    flows : sequence of FlowLeft
    """
    long_enough = [flow for flow in flows if flow.duration_s >= SHORTEST_S]
    if len(long_enough) < _FEWEST:
        return None
    span_s = max(f.start_s + f.duration_s for f in long_enough) - min(f.start_s for f in long_enough)
    step = _STEP / span_s
    grid = np.asarray(np.arange(1.0, min(HIGHEST_HZ / step, _MOST)) * step, dtype=np.float64)
    searched = math.log(len(CHANNELS) * grid.size)
    found = [swing for channel in CHANNELS if (swing := _of_channel(kinds_of(long_enough, channel), grid, channel, searched)) is not None]
    return max(found, key=lambda swing: swing.log_evidence, default=None)


def _of_channel(kinds: Sequence[Kind], grid: FloatArray, channel: str, searched: float) -> Swing | None:
    if sum(len(kind.flows) for kind in kinds) < _FEWEST:
        return None
    heard, expected = _matched(kinds, grid, channel)
    best = int(np.argmax(_evidence(heard, expected)))
    told = expected[:, best] > 0.0
    if int(told.sum()) < _FEWEST:
        return None
    one, unit = heard[told, best], expected[told, best]
    # without the record that says most: one alone may have been disturbed
    beyond = min(float(_evidence(np.delete(one, k)[:, None], np.delete(unit, k)[:, None])[0]) for k in range(one.size)) - searched
    return Swing(channel, float(grid[best]), beyond, one.size) if beyond > _MARGIN else None


def _evidence(heard: ComplexArray, expected: FloatArray) -> FloatArray:
    """Log likelihood that one swing of all records gains over floors that are higher there, as a resonance's that wanders are."""
    count = np.maximum(np.sum(expected > 0.0, axis=0), 1)
    whole = np.sum(np.abs(heard) ** 2 / np.where(expected > 0.0, expected, 1.0), axis=0)
    left = whole - np.abs(heard.sum(axis=0)) ** 2 / np.maximum(expected.sum(axis=0), 1e-300)
    higher, beside = np.maximum(whole / count, 1.0), np.maximum(left / count, 1.0)
    return np.asarray(count * np.log(higher / beside) + whole / higher - left / beside)


def _matched(kinds: Sequence[Kind], grid: FloatArray, channel: str) -> tuple[ComplexArray, FloatArray]:
    """By record: what it holds of a swing of any size at each frequency, and what it holds of one of unit size, both over its floor.

    Returns
    -------
    heard : ndarray, complex, shape (records, frequencies)
        Of variance ``expected`` where there is only the floor.
    expected : ndarray, shape (records, frequencies)
        0 where a record holds signal.
    """
    heard, expected = [], []
    flows = [flow for kind in kinds for flow in kind.flows]
    for flow, floor in zip(flows, _floors(kinds, grid), strict=True):
        window = np.hanning(len(flow.rate[channel]))
        found = _transform(window * flow.rate[channel], flow.row_s, grid) * np.exp(-2j * np.pi * grid * flow.start_s)
        # of a cosine of unit size half stands at either sign of its frequency
        held, noise = 0.5 * window.sum(), floor * np.sum(window**2) / flow.row_s
        there = np.isfinite(noise)
        noise = np.where(there, noise, 1.0)
        heard.append(np.where(there, held * found / noise, 0.0))
        expected.append(np.where(there, held**2 / noise, 0.0))
    return np.array(heard), np.array(expected)


def _floors(kinds: Sequence[Kind], grid: FloatArray) -> FloatArray:
    """By record. Of a kind of few not below that of most records: no bin near the mean tells it, and all are of one device that wanders."""
    floors = np.array([floor for kind in kinds for floor in kind.floors(grid, None, low=True)])
    few = np.repeat([len(kind.flows) < _OWN_FLOOR for kind in kinds], [len(kind.flows) for kind in kinds])
    there = np.isfinite(floors)
    usual = np.nanmedian(np.where(there.any(axis=0), floors, 0.0), axis=0)
    return np.where(few[:, None], np.maximum(floors, usual), floors)


def _transform(x: FloatArray, row_s: float, grid: FloatArray) -> ComplexArray:
    """Fourier sum at the frequencies of an even grid."""
    step = grid[1] - grid[0]
    return np.asarray(zoom_fft(x, [grid[0], grid[-1] + step], m=grid.size, fs=1.0 / row_s))
