"""Lines too faint for any one record: of one size in all of them, they stand in the mean of their spectra.

The evidence is that of the mean ratio to the floor, ``k (m - 1 - ln m)``. Of the loudest quarter of the bins it is only asked that they be
louder than the others (a censored sample): a click in one record, or what the loops of some do after they were closed, is no line of
all. Of fewer than four records one is more than that quarter: a steady wave's frequency that wanders shows alike on both axes and to both
sides of the carrier, four bins in one record of three. A floor is known but to some tenths beside a wave's skirt, so the mean must say more
than that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .spectra import PickSpectrum

__all__ = ["shared_line"]

FloatArray = NDArray[np.float64]
#: distance of the frequencies that are tried, in bins of the longest record; fewest bins and records that a mean is taken of
_STEP_BINS, _FEWEST_BINS, _FEWEST_RECORDS = 0.5, 8, 4
#: share of the bins of which no size is believed; frequencies that are looked at in one go
_CENSORED, _AT_ONCE = 0.25, 20_000


def shared_line(spectra: Sequence[PickSpectrum], *, hum: bool) -> tuple[float, float]:
    """Where the mean of all spectra is highest.

    Parameters
    ----------
    spectra : sequence of PickSpectrum
        At least one.
    hum : bool
        At one distance to both sides of the carrier; else at one frequency, whatever the carrier does.

    Returns
    -------
    frequency_hz, evidence : float
        From the carrier, or of the line itself; log likelihood ratio over noise alone, before the search is paid.
    """
    farthest = 0.5 * max(s.recording.sample_rate_hz for s in spectra)
    step = _STEP_BINS * min(s.bin_hz for s in spectra)
    grid = np.arange(0.0 if hum else -farthest, farthest, step)
    middle = 0.0 if hum else float(np.median([s.carrier_hz for s in spectra]))
    evidence = np.concatenate([_evidence(spectra, part, middle, hum) for part in np.split(grid, range(_AT_ONCE, grid.size, _AT_ONCE))])
    best = int(np.argmax(evidence))
    return middle + float(grid[best]), float(evidence[best])


def _evidence(spectra: Sequence[PickSpectrum], grid: FloatArray, middle_hz: float, hum: bool) -> FloatArray:
    """Log likelihood ratio of one mean over the floor, of what is left when the loudest bins are known to be the loudest, and no more."""
    bins, records = [], np.zeros(grid.size, dtype=int)
    for s in spectra:
        sides = (grid, -grid) if hum else (middle_hz + grid - s.carrier_hz,)
        hears = [s.hears(away) for away in sides]
        bins += [np.where(here[:, None], s.at(away), np.inf).T for here, away in zip(hears, sides, strict=True)]
        records += np.any(hears, axis=0)
    ratio = np.sort(np.concatenate(bins), axis=0)
    count = np.sum(np.isfinite(ratio), axis=0)
    censored = np.maximum(np.ceil(_CENSORED * count), 1.0).astype(int)
    kept = np.maximum(count - censored, 1)
    last = ratio[kept - 1, np.arange(grid.size)]
    total = np.sum(ratio, axis=0, where=np.arange(len(ratio))[:, None] < kept) + censored * last
    heard = (count >= _FEWEST_BINS) & (records >= _FEWEST_RECORDS)
    mean = np.maximum(np.where(heard, total, 1.0) / np.where(heard, kept, 1.0), 1.0)
    return np.where(heard, kept * (mean - 1.0 - np.log(mean)), 0.0)
