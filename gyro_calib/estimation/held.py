"""What the loops hold, as the pick-offs read it: a quadrature that is not nulled turns the wave by the frequency split (effects.md 47)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ..recording.recording import Recording
from .wave import wave_coordinates

__all__ = ["held_quadrature", "settled_mean"]

FloatArray = NDArray[np.float64]
#: stretches of a recording, of which the middle one counts: what still settles is in the first
_STRETCHES = 8


def held_quadrature(recordings: Iterable[Recording]) -> float:
    """Quadrature over the amplitude that whole-angle loops hold: the middle one of the recordings, each by its middle stretch.

    Parameters
    ----------
    recordings : iterable of Recording
        Of closed whole-angle loops, one at least.
    """
    waves = [wave_coordinates(r) for r in recordings]
    return float(np.median([settled_mean(w.quadrature_v / w.amplitude_v) for w in waves]))


def settled_mean(values: FloatArray) -> float:
    """Mean over the middle one of the stretches of a recording, by its value.

    Parameters
    ----------
    values : ndarray, shape (n,)
    """
    return float(np.median([stretch.mean() for stretch in np.array_split(values, _STRETCHES)]))
