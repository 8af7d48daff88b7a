"""Temperature of the resonator row by row: mean, ramp and Ornstein-Uhlenbeck wander."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from ..device import Environment

__all__ = ["TemperatureWander"]


class TemperatureWander:
    """Stateful temperature of a simulated device."""

    def __init__(self, environment: Environment, rng: np.random.Generator, *, noisy: bool) -> None:
        self._environment = environment
        self._rng = rng
        self._sd = environment.wander_k if noisy else 0.0
        self._state = self._sd * float(rng.standard_normal()) if self._sd > 0 else 0.0

    def rows(self, start_s: float, count: int, row_s: float) -> NDArray[np.float64]:
        """Temperature of the next rows [degC], shape (count,)."""
        e = self._environment
        mean = e.temperature_degc + e.ramp_k_per_s * (start_s + row_s * np.arange(count))
        if self._sd == 0.0:
            return np.asarray(mean, dtype=float)
        keep = math.exp(-row_s / e.wander_time_s)
        kicks = self._sd * math.sqrt(1.0 - keep**2) * self._rng.standard_normal(count)
        wander, _ = lfilter([1.0], [1.0, -keep], kicks, zi=[keep * self._state])
        self._state = float(wander[-1])
        return np.asarray(mean + wander, dtype=float)
