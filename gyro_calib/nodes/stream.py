"""Blocks on their way from the executor's thread to the one that records: bounded, stamped by a steady clock."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError

__all__ = ["BlockStream"]

FloatArray = NDArray[np.float64]


class BlockStream:
    """A bounded queue of row blocks; when full the oldest go, which the one who records sees as lost rows.

    Parameters
    ----------
    max_rows : int
        Rows kept (96 bytes each).
    now : callable
        Steady clock [s].
    """

    def __init__(self, *, max_rows: int = 20_000, now: Callable[[], float] = time.monotonic) -> None:
        self._max_rows = max_rows
        self._now = now
        self._condition = threading.Condition()
        self._queue: deque[FloatArray | DataError] = deque()
        self._rows = 0
        self._latest: FloatArray | None = None
        self._last_s: float | None = None

    def put(self, block: FloatArray | DataError) -> None:
        """Take a block, or the error that it was unusable with."""
        with self._condition:
            self._queue.append(block)
            self._rows += _size(block)
            while len(self._queue) > 1 and (self._rows > self._max_rows or len(self._queue) > self._max_rows):
                self._rows -= _size(self._queue.popleft())
            self._last_s = self._now()
            if not isinstance(block, DataError) and len(block):
                self._latest = block[-1]
            self._condition.notify_all()

    def take(self, timeout_s: float) -> list[FloatArray]:
        """All waiting blocks in order; waits for the first one at most ``timeout_s``, then gives none.

        Raises
        ------
        DataError
            An unusable block came; the good ones before it are given first.
        """
        with self._condition:
            self._condition.wait_for(lambda: bool(self._queue), timeout_s)
            taken: list[FloatArray] = []
            while self._queue:
                block = self._queue[0]
                if isinstance(block, DataError):
                    if taken:
                        break
                    self._queue.popleft()
                    raise block
                self._queue.popleft()
                self._rows -= len(block)
                taken.append(block)
            return taken

    def clear(self) -> None:
        """Forget what waits."""
        with self._condition:
            self._queue.clear()
            self._rows = 0

    @property
    def latest(self) -> FloatArray | None:
        """Newest row, shape (12,), or None before the first."""
        return self._latest

    def silence_s(self, since_s: float) -> float:
        """Steady time since the last block, or since ``since_s`` if that is later [s]."""
        with self._condition:
            return self._now() - max(since_s, -np.inf if self._last_s is None else self._last_s)


def _size(block: FloatArray | DataError) -> int:
    return 0 if isinstance(block, DataError) else len(block)
