"""A figure of a study with the limits that it must keep, and the statistics that studies share, with their own uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..quantity import Quantity

__all__ = ["Gate", "coverage", "quantile", "rms"]


@dataclass(frozen=True)
class Gate:
    """A figure and the interval it must lie in.

    Parameters
    ----------
    name : str
        What it is.
    value : Quantity
        The figure; its sd is the statistical uncertainty of the study itself (0 when it has none).
    lower, upper : float
        Limits, inclusive, in the unit of ``value``; infinite for none. A figure without limits informs and always passes.
    """

    name: str
    value: Quantity
    lower: float = -math.inf
    upper: float = math.inf

    @property
    def passed(self) -> bool:
        """Whether the value lies within the limits; NaN does not, unless there are none."""
        if math.isinf(self.lower) and math.isinf(self.upper):
            return True
        return self.lower <= self.value.value <= self.upper

    @property
    def limit(self) -> str:
        """The limits for a reader."""
        if math.isinf(self.lower) and math.isinf(self.upper):
            return ""
        if math.isinf(self.lower):
            return f"≤ {self.upper:g}"
        if math.isinf(self.upper):
            return f"≥ {self.lower:g}"
        return f"{self.lower:g} … {self.upper:g}"

    def to_json(self) -> dict[str, Any]:
        """``{"name", "value": {…}, "lower", "upper", "passed"}``; a limit that is infinite is None."""
        return {
            "name": self.name,
            "value": self.value.to_json(),
            "lower": self.lower if math.isfinite(self.lower) else None,
            "upper": self.upper if math.isfinite(self.upper) else None,
            "passed": self.passed,
        }


def rms(errors: ArrayLike, unit: str) -> Quantity:
    """Root mean square of ``errors`` over independent runs, in ``unit``, with the sd of a normal sample: ``rms / sqrt(2 n)``."""
    data = np.asarray(errors, dtype=float)
    value = float(np.sqrt(np.mean(np.square(data))))
    return Quantity(value, value / math.sqrt(2.0 * data.size), unit)


def quantile(values: ArrayLike, probability: float, unit: str) -> Quantity:
    """Quantile of ``values`` at ``probability``, in ``unit``, with the sd that the order statistics around it give."""
    data = np.sort(np.asarray(values, dtype=float))
    half = math.sqrt(probability * (1.0 - probability) / data.size)
    low, middle, high = np.quantile(data, np.clip([probability - half, probability, probability + half], 0.0, 1.0))
    return Quantity(float(middle), float(high - low) / 2.0, unit)


def coverage(errors: ArrayLike, sds: ArrayLike, sigmas: float = 1.959964) -> Quantity:
    """Share of runs [%] whose one of ``errors`` is within ``sigmas`` of its claimed ``sds``, with its binomial sd (Wilson)."""
    inside = np.abs(np.asarray(errors, dtype=float)) <= sigmas * np.asarray(sds, dtype=float)
    n, share = inside.size, float(np.mean(inside))
    centred = (share * n + 2.0) / (n + 4.0)
    return Quantity(100.0 * share, 100.0 * math.sqrt(centred * (1.0 - centred) / (n + 4.0)), "%")
