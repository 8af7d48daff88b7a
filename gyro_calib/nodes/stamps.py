"""Time stamps of sample streams: which are new, how many a second, and which of several gyros belong together. No ROS here."""

from __future__ import annotations

from collections import deque
from statistics import median
from typing import Any

__all__ = ["Sample", "SampleClock", "StampJoin"]

#: stamp [ns], rate [rad/s], variance [(rad/s)**2], header of the raw message
Sample = tuple[int, float, float, Any]

#: a stamp further back than this is a restart of time, a nearer one a repeat [ns]
_JUMP_NS = 1_000_000_000
_NEVER_NS = -(1 << 62)
#: steps between stamps from which the rate is taken, at most
_STEPS = 2000


class SampleClock:
    """Tells new stamps from repeated ones and measures their rate.

    The rate is that at which the gyro samples, not that at which samples arrive: lost ones and jumps of time do not count, or the noise of
    a sample, which goes with its bandwidth, would be claimed too small.
    """

    def __init__(self) -> None:
        #: stamps in the present window of measurement
        self.count = 0
        #: samples dropped because their stamp was not newer
        self.repeated = 0
        #: restarts of time
        self.jumps = 0
        self._steps: deque[int] = deque(maxlen=_STEPS)
        self._last_ns = _NEVER_NS

    def accept(self, stamp_ns: int) -> bool:
        """Whether the sample is new. One more than a second older than the last is: time has been restarted."""
        step_ns = stamp_ns - self._last_ns
        if step_ns <= 0:
            if step_ns > -_JUMP_NS:
                self.repeated += 1
                return False
            self.jumps += 1
            self.count = 0
            self._steps.clear()
        elif self.count:
            self._steps.append(step_ns)
        self.count += 1
        self._last_ns = stamp_ns
        return True

    def rate_hz(self) -> float | None:
        """Sample rate in the present window [Hz], over the steps that are not gaps; ``None`` with fewer than two samples."""
        if not self._steps:
            return None
        longest = 1.5 * median(self._steps)
        near = [step for step in self._steps if step < longest]
        return len(near) * 1e9 / sum(near)

    def restart_window(self) -> None:
        """Begin a new window at the last sample."""
        self.count = min(self.count, 1)
        self._steps.clear()


class StampJoin:
    """Joins the samples of several gyros: to each of the first one, the nearest of every other, if near enough.

    A sample waits until no nearer one can come: until every other gyro has sent one at or after its time. Buffers are bounded; what
    overflows because another gyro is silent counts as unmatched.

    Parameters
    ----------
    count : int
        Number of gyros.
    tolerance_s : float
        Largest difference of stamps [s].
    depth : int
        Samples kept of each gyro.
    """

    def __init__(self, count: int, tolerance_s: float, depth: int = 500) -> None:
        self.tolerance_s = tolerance_s
        #: samples of the first gyro that found no partners
        self.unmatched = 0
        self._depth = depth
        self._queues: list[deque[Sample]] = [deque() for _ in range(count)]

    def clear(self) -> None:
        """Forget what waits, as after a restart of time."""
        for queue in self._queues:
            queue.clear()

    def add(self, index: int, sample: Sample) -> list[list[Sample]]:
        """Take a sample of gyro ``index`` (stamps of each gyro increase) and return the sets that are complete now, in order."""
        queue = self._queues[index]
        queue.append(sample)
        if len(queue) > self._depth:
            queue.popleft()
            self.unmatched += index == 0
        complete: list[list[Sample]] = []
        first, *others = self._queues
        while first:
            stamp_ns = first[0][0]
            found = [first[0]]
            for other in others:
                partner = _nearest(other, stamp_ns)
                if partner is None:
                    return complete
                found.append(partner)
            first.popleft()
            if all(abs(partner[0] - stamp_ns) <= self.tolerance_s * 1e9 for partner in found):
                complete.append(found)
            else:
                self.unmatched += 1
        return complete


def _nearest(queue: deque[Sample], stamp_ns: int) -> Sample | None:
    """The sample nearest to ``stamp_ns``, ``None`` while a nearer one may come; what is older cannot match again and is dropped."""
    while len(queue) > 1 and abs(queue[1][0] - stamp_ns) <= abs(queue[0][0] - stamp_ns):
        queue.popleft()
    if not queue or queue[-1][0] < stamp_ns:
        return None
    return queue[0]
