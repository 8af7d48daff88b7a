"""The decimation filter of carrier-rate data: a cascade of boxcars, the same for every column (document 000: "all signals are filtered by
the same digital filters").

A cascade of k boxcars of n samples is symmetric, so it delays every frequency alike, and a row is stamped at the centre of its kernel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["RowGrid", "cascade", "decimate"]

FloatArray = NDArray[np.float64]


def cascade(length: int, order: int) -> FloatArray:
    """Impulse response of ``order`` boxcars of ``length`` samples, shape (order (length - 1) + 1,), sum 1, symmetric."""
    box = np.full(length, 1.0 / length)
    taps = box
    for _ in range(order - 1):
        taps = np.asarray(np.convolve(taps, box), dtype=np.float64)
    return taps


@dataclass(frozen=True)
class RowGrid:
    """Which samples make which row.

    Parameters
    ----------
    first : int
        Oldest sample of the first row's kernel.
    count : int
        Rows.
    decimation : int
        Samples from row to row, and length of each boxcar.
    order : int
        Boxcars in the cascade.
    """

    first: int
    count: int
    decimation: int
    order: int

    @property
    def span(self) -> int:
        """Samples of one row's kernel."""
        return self.order * (self.decimation - 1) + 1

    @property
    def centres(self) -> FloatArray:
        """Sample number of the centre of each row's kernel (half-integer when the kernel is even), shape (count,)."""
        return np.asarray(self.first + 0.5 * (self.span - 1) + self.decimation * np.arange(self.count), dtype=np.float64)

    @classmethod
    def within(cls, low: int, high: int, decimation: int, order: int, centre: float | None = None) -> RowGrid:
        """All whole kernels in samples ``low`` to ``high - 1``; with ``centre``, those on the grid of rows that has one there."""
        span = order * (decimation - 1) + 1
        first = low
        if centre is not None:
            wanted = round(centre - 0.5 * (span - 1))
            first = low + (wanted - low) % decimation
        return cls(first, max(0, (high - first - span) // decimation + 1), decimation, order)


def decimate(samples: NDArray[np.float64] | NDArray[np.complex128], grid: RowGrid) -> NDArray[np.float64] | NDArray[np.complex128]:
    """Filter and decimate a channel, shape (n,) -> (grid.count,)."""
    from scipy.signal import upfirdn  # takes most of a second to load, and few recordings are of the carrier

    # zeros before the first kernel put its newest sample on the decimated grid of upfirdn
    lead = -(grid.span - 1) % grid.decimation
    last = grid.first + grid.span + (grid.count - 1) * grid.decimation
    padded = np.concatenate([np.zeros(lead, dtype=samples.dtype), samples[grid.first : last]])
    filtered = upfirdn(cascade(grid.decimation, grid.order), padded, 1, grid.decimation)
    skip = (lead + grid.span - 1) // grid.decimation
    return np.asarray(filtered[skip : skip + grid.count])
