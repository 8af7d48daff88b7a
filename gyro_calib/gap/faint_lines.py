"""Lines too faint for any one record: of one size in all of them, they stand in the mean of their spectra.

The evidence is that of the mean ratio to the floor, ``n (m - 1 - ln m)``, the loudest of the n bins left out: a click in one record is no
line. A floor is known but to some tenths beside a wave's skirt, so the mean must say more than that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .spectra import PickSpectrum

__all__ = ["shared_line"]

FloatArray = NDArray[np.float64]
#: distance of the frequencies that are tried, in bins of the longest record; fewest bins that a mean is taken of
_STEP_BINS, _FEWEST_BINS = 0.5, 8


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
    total, count, loudest = np.zeros((3, grid.size))
    for s in spectra:
        for away in (grid, -grid) if hum else (middle + grid - s.carrier_hz,):
            heard = s.hears(away)
            ratio = np.where(heard[:, None], s.at(away), 0.0)
            total += ratio.sum(axis=1)
            count += ratio.shape[1] * heard
            loudest = np.maximum(loudest, ratio.max(axis=1))
    rest = np.maximum(count - 1.0, 1.0)
    mean = np.maximum((total - loudest) / rest, 1.0)
    evidence = np.where(count >= _FEWEST_BINS, rest * (mean - 1.0 - np.log(mean)), 0.0)
    best = int(np.argmax(evidence))
    return middle + float(grid[best]), float(evidence[best])
