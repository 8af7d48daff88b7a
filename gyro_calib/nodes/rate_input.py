"""The input rate of a simulated gyro: what a robot simulator publishes, held from sample to sample."""

from __future__ import annotations

import math
import threading
from collections import deque

import numpy as np
from numpy.typing import NDArray

__all__ = ["RateInput"]

FloatArray = NDArray[np.float64]


class RateInput:
    """Zero-order hold of a stamped rate, filled by one thread and read by another.

    Each value holds from its stamp until the next one. A stamp that is absent, already simulated, or more than ``window_s`` in the
    future (a publisher on another clock) counts as "from now on".

    Parameters
    ----------
    timeout_s : float
        Device time after which a value that nobody renews counts as 0; 0 holds it for ever [s].
    window_s : float
        Stamps further ahead than this are not believed [s].
    depth : int
        Values kept that are not yet due; older ones go first.
    """

    def __init__(self, *, timeout_s: float = 0.0, window_s: float = 1.0, depth: int = 10_000) -> None:
        self._timeout_s = timeout_s
        self._window_s = window_s
        self._lock = threading.Lock()
        self._pending: deque[tuple[float, float]] = deque(maxlen=depth)
        self._held = (-math.inf, 0.0)
        self._now_s = 0.0
        self._stale = False

    @property
    def stale(self) -> bool:
        """Whether a rate was given once and has timed out."""
        return self._stale

    def push(self, rate_rad_s: float, stamp_s: float | None = None, clock_s: float = -math.inf) -> bool:
        """Take a value.

        Parameters
        ----------
        rate_rad_s : float
            Rate about the sense axis [rad/s].
        stamp_s : float, optional
            Device time from which it holds [s].
        clock_s : float, optional
            Device time that the clock which is followed allows [s]: a simulation that lags behind it must not take the rates that it has
            yet to reach for those of another clock.

        Returns
        -------
        bool
            False if the value is not finite: the one before stays.
        """
        if not math.isfinite(rate_rad_s):
            return False
        with self._lock:
            last = self._pending[-1][0] if self._pending else self._now_s
            if stamp_s is None or stamp_s > max(self._now_s, clock_s) + self._window_s:
                stamp_s = self._now_s
            self._pending.append((max(stamp_s, self._now_s, last), rate_rad_s))
        return True

    def catch_up(self) -> None:
        """Device time was put elsewhere on the clock: what waits is meant for a time that will not come, its last value holds from now."""
        with self._lock:
            if self._pending:
                self._held = (self._now_s, self._pending[-1][1])
                self._pending.clear()

    def sample(self, times_s: FloatArray) -> FloatArray:
        """Rate at each of ``times_s`` (increasing, after those asked before) [rad/s], same shape."""
        if times_s.size == 0:
            return np.zeros(0)
        with self._lock:
            points = [self._held]
            while self._pending and self._pending[0][0] <= times_s[-1]:
                points.append(self._pending.popleft())
            self._held = points[-1]
            self._now_s = float(times_s[-1])
        stamps, rates = np.array(points).T
        place = np.searchsorted(stamps, times_s, side="right") - 1
        held = rates[place]
        if self._timeout_s > 0.0:
            old = times_s - stamps[place] > self._timeout_s
            held[old] = 0.0
            self._stale = bool(old[-1]) and math.isfinite(points[-1][0])
        return held
