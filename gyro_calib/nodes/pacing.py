"""When a simulated gyro may go on, and what its device time is on the ROS time axis."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

__all__ = ["FollowClock", "FreeRun", "Pacer"]

_NS = 1_000_000_000
#: no sleep is longer, so that a stop is noticed [s]
_LONGEST_WAIT_S = 0.05


class Pacer(Protocol):
    """Decides how long to wait before device time may reach a mark."""

    @property
    def started(self) -> bool:
        """Whether the place of device time on the ROS time axis is known."""

    def wait_s(self, mark_s: float) -> float:
        """How long to wait before asking again [s]; 0: device time ``mark_s`` may be simulated now."""

    def stamp_ns(self, time_s: float) -> int:
        """Device time on the ROS time axis [ns], never negative."""


class FreeRun:
    """Device time is the clock: nobody else's is followed, others follow it by ``/clock``.

    Parameters
    ----------
    factor : float
        Device seconds per wall second; 0 is as fast as possible. After a stall the pace goes on from there, without a burst.
    epoch_s : float
        ROS time of device time 0; > 0, because ROS reads 0 as "no clock yet" [s].
    now : callable
        Steady clock [s].
    """

    def __init__(self, factor: float, epoch_s: float = 1.0, now: Callable[[], float] = time.monotonic) -> None:
        self._factor = factor
        self._epoch_ns = round(epoch_s * _NS)
        self._now = now
        self._start: float | None = None

    @property
    def started(self) -> bool:
        """See :class:`Pacer`."""
        return True

    def wait_s(self, mark_s: float) -> float:
        """See :class:`Pacer`."""
        if self._factor <= 0.0:
            return 0.0
        now, due = self._now(), mark_s / self._factor
        if self._start is None or now - self._start - due > 0.5:
            self._start = now - due
        return min(max(self._start + due - now, 0.0), _LONGEST_WAIT_S)

    def stamp_ns(self, time_s: float) -> int:
        """See :class:`Pacer`."""
        return max(self._epoch_ns + round(time_s * _NS), 0)


class FollowClock:
    """Device time follows a clock at rate 1: the wall clock, or ``/clock`` of a robot simulator.

    Device time keeps its own count; the clock says when it may go on. If it lags or leads by more than ``tolerance_s`` (a machine
    too slow, a clock that was set) its place on the clock is taken anew and ``on_jump`` hears the lag.

    Parameters
    ----------
    now_ns : callable
        The clock [ns]; 0 means that it does not run yet.
    on_jump : callable
        Called with the lag [s], negative when the clock went backwards.
    tolerance_s : float
        Lag or lead that is made up by waiting or hurrying [s].
    longest_wait_s : float
        0.05 suits the wall clock; a simulated clock of unknown pace is looked at more often [s].
    """

    def __init__(
        self,
        now_ns: Callable[[], int],
        on_jump: Callable[[float], None] = lambda lag_s: None,
        *,
        tolerance_s: float = 5.0,
        longest_wait_s: float = _LONGEST_WAIT_S,
    ) -> None:
        self._now_ns = now_ns
        self._on_jump = on_jump
        self._tolerance_s = tolerance_s
        self._longest_wait_s = longest_wait_s
        self._epoch_ns: int | None = None

    @property
    def started(self) -> bool:
        """See :class:`Pacer`."""
        return self._epoch_ns is not None

    def wait_s(self, mark_s: float) -> float:
        """See :class:`Pacer`."""
        now = self._now_ns()
        if now == 0:
            return self._longest_wait_s
        if self._epoch_ns is None:
            self._epoch_ns = now - round(mark_s * _NS)
        lag_s = (now - self.stamp_ns(mark_s)) / _NS
        if abs(lag_s) > self._tolerance_s:
            self._on_jump(lag_s)
            self._epoch_ns = now - round(mark_s * _NS)
            return 0.0
        return min(max(-lag_s, 0.0), self._longest_wait_s)

    def stamp_ns(self, time_s: float) -> int:
        """See :class:`Pacer`."""
        return max((self._epoch_ns or 0) + round(time_s * _NS), 0)
