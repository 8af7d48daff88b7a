"""One unknown of a campaign's equations, as a vector over all of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Column"]

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Column:
    """One real unknown.

    Parameters
    ----------
    name : str
        Parameter.
    signal, quiet : tuple of ndarray, complex
        By recording, turned by the wave's phase: what one unit adds to the right of the slow flow at its lines.
    prior_sd : float
        How far the unknown is believed to lie from zero; infinite when nothing is known.
    """

    name: str
    signal: tuple[ComplexArray, ...]
    quiet: tuple[ComplexArray, ...]
    prior_sd: float = float("inf")
