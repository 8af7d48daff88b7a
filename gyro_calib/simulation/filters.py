"""The decimation filter: a cascade of three boxcars, the same for every column, as polyphase weights.

A cascade of three boxcars of n samples, decimated by n, has 3n - 2 taps; a sample at place j of its block therefore enters three outputs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["ORDER", "boxcar_cascade", "group_delay_samples", "polyphase_weights"]

FloatArray = NDArray[np.float64]
#: boxcars in the cascade
ORDER = 3


def boxcar_cascade(length: int) -> FloatArray:
    """Impulse response of the cascade, shape (3 length - 2,), sum 1, symmetric."""
    box = np.full(length, 1.0 / length)
    taps = box
    for _ in range(ORDER - 1):
        taps = np.convolve(taps, box)
    return taps


def polyphase_weights(length: int, after: FloatArray | None = None) -> FloatArray:
    """Weights, shape (3, length): ``[k, j]`` is what sample j of a block gives to the output at the end of the k-th block from its own.

    ``after``, shape (3,), are taps of a filter that the samples have not passed yet: folded in.
    """
    taps = boxcar_cascade(length)
    if after is not None:
        taps = np.convolve(taps, after)
    weights = np.zeros((ORDER, length))
    for k in range(ORDER):
        for j in range(length):
            age = (k + 1) * length - 1 - j
            if age < taps.size:
                weights[k, j] = taps[age]
    return weights


def group_delay_samples(length: int) -> float:
    """Delay of the centre of the kernel behind its newest sample [samples]."""
    return (ORDER * length - ORDER) / 2.0
