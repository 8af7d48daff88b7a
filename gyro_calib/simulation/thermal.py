"""Temperature of the resonator row by row: mean, ramp and Ornstein-Uhlenbeck wander, and where a chamber moves it."""

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
        #: begin and end of the chamber's last move [s], what it adds to the mean before and after [K]
        self._move: tuple[float, float, float, float] | None = None

    def move_to(self, temperature_degc: float, now_s: float, over_s: float) -> None:
        """Move the mean, straight from where it is now, to a temperature [degC]; ramp and wander go on about it."""
        before = 0.0 if self._move is None else float(self._moved(np.asarray([now_s], dtype=np.float64))[0])
        self._move = now_s, now_s + over_s, before, temperature_degc - self._environment.temperature_degc

    def _moved(self, t: NDArray[np.float64]) -> NDArray[np.float64]:
        assert self._move is not None
        begin, end, before, after = self._move
        share = np.clip((t - begin) / (end - begin), 0.0, 1.0) if end > begin else (t >= begin).astype(float)
        return np.asarray(before + share * (after - before))

    def rows(self, start_s: float, count: int, row_s: float) -> NDArray[np.float64]:
        """Temperature of the next rows [degC], shape (count,)."""
        e = self._environment
        mean = e.temperature_degc + e.ramp_k_per_s * (start_s + row_s * np.arange(count))
        if self._move is not None:
            mean = mean + self._moved(np.asarray(start_s + row_s * np.arange(count), dtype=np.float64))
        if self._sd == 0.0:
            return np.asarray(mean, dtype=float)
        keep = math.exp(-row_s / e.wander_time_s)
        kicks = self._sd * math.sqrt(1.0 - keep**2) * self._rng.standard_normal(count)
        wander, _ = lfilter([1.0], [1.0, -keep], kicks, zi=[keep * self._state])
        self._state = float(wander[-1])
        return np.asarray(mean + wander, dtype=float)
