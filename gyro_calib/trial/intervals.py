"""Confidence intervals of a share."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy.stats import beta, norm

__all__ = ["Share"]

_LEVEL = 0.95


@dataclass(frozen=True)
class Share:
    """So many of so many.

    Parameters
    ----------
    hits, count : int
    """

    hits: int
    count: int

    @property
    def value(self) -> float:
        """The share; NaN of none."""
        return self.hits / self.count if self.count else math.nan

    @property
    def wilson(self) -> tuple[float, float]:
        """Wilson's 95 % interval: near the truth on average."""
        if not self.count:
            return 0.0, 1.0
        z, n, p = float(norm.isf(0.5 * (1.0 - _LEVEL))), self.count, self.value
        middle = (p + z**2 / (2.0 * n)) / (1.0 + z**2 / n)
        half = z * math.sqrt(p * (1.0 - p) / n + z**2 / (4.0 * n**2)) / (1.0 + z**2 / n)
        return max(middle - half, 0.0), min(middle + half, 1.0)

    @property
    def clopper_pearson(self) -> tuple[float, float]:
        """Exact 95 % interval: never too narrow."""
        tail = 0.5 * (1.0 - _LEVEL)
        low = float(beta.ppf(tail, self.hits, self.count - self.hits + 1)) if self.hits else 0.0
        high = float(beta.isf(tail, self.hits + 1, self.count - self.hits)) if self.hits < self.count else 1.0
        return low, high

    @property
    def upper(self) -> float:
        """Exact one-sided 95 % upper bound."""
        return float(beta.ppf(_LEVEL, self.hits + 1, self.count - self.hits)) if self.hits < self.count else 1.0
