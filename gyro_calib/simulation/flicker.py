"""Flicker noise row by row: a sum of Ornstein-Uhlenbeck processes whose correlation times are spread evenly in the logarithm.

With equal variances ``s^2`` and times in ratio r the sum has the one-sided density ``s^2 / (f ln r)`` between the ends, and flicker of
density ``h / f`` has the Allan variance ``2 ln 2 h``: the floor is s for r = 4.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

__all__ = ["FLICKER_TIMES_S", "GAIN_TIMES_S", "FlickerSource", "floor_of_density"]

FloatArray = NDArray[np.float64]
#: correlation times [s]; the floor holds between a second and some hours
FLICKER_TIMES_S: FloatArray = np.asarray(0.25 * 4.0 ** np.arange(10), dtype=np.float64)
#: of a gain, which is heard as far as the rows go: from milliseconds on
GAIN_TIMES_S: FloatArray = np.asarray(1e-3 * 4.0 ** np.arange(13), dtype=np.float64)


def floor_of_density(at_1_hz: float) -> float:
    """Allan deviation where it is flat of flicker with this one-sided amplitude density at 1 Hz [unit/sqrt(Hz)], times in ratio 4."""
    return at_1_hz * math.sqrt(math.log(4.0))


class FlickerSource:
    """Independent flicker noises, the same however the calls divide the time.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the noise, nobody else's.
    floor : float
        Allan deviation of each channel where it is flat; 0: silent.
    channels : int
        How many.
    row_s : float
        Time between rows [s].
    times_s : ndarray, shape (n,)
        Correlation times [s], in ratio 4.
    """

    def __init__(self, rng: np.random.Generator, floor: float, channels: int, row_s: float, times_s: FloatArray = FLICKER_TIMES_S) -> None:
        self._rng = rng
        self._floor = floor
        self._channels = channels
        self._keep = np.exp(-row_s / times_s)
        shape = (times_s.size, channels)
        self._state = floor * rng.standard_normal(shape) if floor > 0.0 else np.zeros(shape)

    def rows(self, count: int) -> FloatArray:
        """Noise of the next rows, shape (count, channels)."""
        total = np.zeros((count, self._channels))
        if self._floor == 0.0:
            return total
        kicks = self._rng.standard_normal((count, self._keep.size, self._channels))
        for k, keep in enumerate(self._keep):
            scale = self._floor * math.sqrt(1.0 - keep**2)
            wander, _ = lfilter([1.0], [1.0, -keep], scale * kicks[:, k], axis=0, zi=keep * self._state[None, k])
            self._state[k] = wander[-1]
            total += wander
        return total
