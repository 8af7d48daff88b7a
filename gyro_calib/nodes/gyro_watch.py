"""Who the gyro is and whether it lives, known at every moment without asking: a service must answer at once.

:class:`GyroWatch` asks the driver once a second in a thread of its own; :class:`MonitoredInstrument` keeps the newest rows of the stream.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, GyroCalibError
from ..recording.command import Command
from .blocks import rows_from_block
from .command_parameters import COMMAND_NAMES
from .gyro_client import parse_facts
from .ros_instrument import RosInstrument

__all__ = ["GyroFacts", "GyroWatch", "MonitoredInstrument", "RecentRows"]

FloatArray = NDArray[np.float64]
_NAMES = ("device_id", "factory", "sample_rate_hz", *COMMAND_NAMES)
#: device time kept for a self-test [s], and its bound in rows
_KEPT_S, _KEPT_ROWS = 2.0, 20_000


@dataclass(frozen=True)
class GyroFacts:
    """What the driver says of its gyro."""

    device_id: str
    factory: Mapping[str, Any]
    sample_rate_hz: float
    command: Command

    @classmethod
    def read(cls, get: Callable[[Sequence[str]], Mapping[str, Any]]) -> GyroFacts:
        """Ask the driver; raises what ``get`` raises, and DataError for unusable answers."""
        values = get(_NAMES)
        device_id, factory, rate_hz = parse_facts(values)
        return cls(device_id, factory, rate_hz, Command.from_parameters({name: values[name] for name in COMMAND_NAMES}))


class GyroWatch:
    """Asks the driver again and again; the answers are there without waiting.

    Parameters
    ----------
    get : callable
        ``get(names) -> values``; may block, is called in the watch's thread.
    on_facts : callable of GyroFacts
        Called in that thread with every answer, before anybody else sees it.
    on_attempt : callable
        Called in that thread after every attempt.
    period_s : float
        Steady time between attempts [s].
    """

    def __init__(
        self,
        get: Callable[[Sequence[str]], Mapping[str, Any]],
        on_facts: Callable[[GyroFacts], None],
        on_attempt: Callable[[], None],
        *,
        period_s: float = 1.0,
    ) -> None:
        self._get, self._on_facts, self._on_attempt, self._period_s = get, on_facts, on_attempt, period_s
        self._facts: GyroFacts | None = None
        self._problem = "The gyro has not answered yet. Check that its driver runs, and wait a moment."
        self._failures = 0
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="gyro watch", daemon=True)

    @property
    def facts(self) -> GyroFacts | None:
        """The last answer; None before the first."""
        return self._facts

    @property
    def problem(self) -> str:
        """Why there is no answer; "" while there is. One answer that is lost says nothing, two do."""
        return self._problem if self._facts is None or self._failures > 1 else ""

    def start(self) -> None:
        """Begin to ask."""
        self._thread.start()

    def stop(self, timeout_s: float = 5.0) -> None:
        """Ask no more; waits for the thread."""
        self._end.set()
        if self._thread.is_alive():
            self._thread.join(timeout_s)

    def ask(self) -> None:
        """One attempt, in the caller's thread."""
        try:
            facts = GyroFacts.read(self._get)
            self._on_facts(facts)
            self._facts, self._problem, self._failures = facts, "", 0
        except GyroCalibError as error:
            self._problem, self._failures = str(error), self._failures + 1

    def _run(self) -> None:
        while not self._end.is_set():
            try:
                self.ask()
                if not self._end.is_set():
                    self._on_attempt()
            except Exception as error:
                # an answer of no known shape, or the context shut down under the thread: the watch itself must go on
                self._problem, self._failures = f"The gyro cannot be asked, {type(error).__name__}: {error}", self._failures + 1
            self._end.wait(self._period_s)


class RecentRows:
    """The latest stretch of a stream: bounded in device time and in rows.

    Parameters
    ----------
    now : callable
        Steady clock [s].
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._lock = threading.Lock()
        self._blocks: deque[FloatArray] = deque()
        self._last_s = -math.inf
        self._error = ""

    def put(self, block: FloatArray | DataError) -> None:
        """Take a block, or the error that it was unusable with."""
        with self._lock:
            if isinstance(block, DataError):
                self._error = str(block)
                return
            self._error, self._last_s = "", self._now()
            self._blocks.append(block)
            while len(self._blocks) > 1 and not self._needed():
                self._blocks.popleft()

    def _needed(self) -> bool:
        """Whether the oldest block is within the bounds; device time that jumped back makes it old."""
        first, last = self._blocks[0], self._blocks[-1]
        if not len(first) or not len(last) or sum(map(len, self._blocks)) > _KEPT_ROWS:
            return False
        return not abs(float(last[-1, 0]) - float(first[-1, 0])) > _KEPT_S

    @property
    def age_s(self) -> float:
        """Steady time since the last good block [s]; inf before the first."""
        return self._now() - self._last_s

    @property
    def error(self) -> str:
        """Why the last block was unusable; "" when it was not."""
        return self._error

    def rows(self) -> FloatArray | None:
        """What is kept, shape (n, 12), in order of arrival; None when there is nothing."""
        with self._lock:
            return np.concatenate(self._blocks) if self._blocks else None


class MonitoredInstrument(RosInstrument):
    """A live gyro whose latest rows can be looked at any time, run or not."""

    def __init__(self, node: Any, **options: Any) -> None:
        # before the subscription, whose first block may come at once
        self.recent = RecentRows()
        super().__init__(node, **options)

    def _take_block(self, message: Any) -> None:
        super()._take_block(message)
        try:
            self.recent.put(rows_from_block(message))
        except DataError as error:
            self.recent.put(error)
