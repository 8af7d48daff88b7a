"""The rows of one recording picked from a stream: of one segment, after its settling time, in order, complete, finite."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, ExperimentAborted
from ..recording.integrity import check_rows

__all__ = ["LostRows", "RowWindow"]

FloatArray = NDArray[np.float64]


class LostRows(DataError):
    """Rows are missing inside a recording: recording again helps."""


class RowWindow:
    """Collects the rows of one recording.

    Rows before the recording (earlier segments, settling) may have gaps; time must not run back there either.

    Parameters
    ----------
    segment : int
        Segment of the command; rows of earlier ones are passed over.
    wanted : int
        Rows to collect.
    sample_rate_hz : float
        Rows per second.
    settle_s : float
        Device time to leave out, counted from the segment's first row.
    first_s : float, optional
        Device time of that first row if it has been seen before [s].
    """

    def __init__(self, segment: int, wanted: int, sample_rate_hz: float, settle_s: float = 0.0, first_s: float | None = None) -> None:
        self._segment = segment
        self._wanted = wanted
        self._rate_hz = sample_rate_hz
        self._settle_s = settle_s
        self._last_s: float | None = None
        self._parts: list[FloatArray] = []
        self.first_s = first_s
        self.collected = 0

    @property
    def full(self) -> bool:
        """Whether all rows are there."""
        return self.collected >= self._wanted

    @property
    def fraction(self) -> float:
        """Collected over wanted rows, 0 to 1."""
        return min(self.collected / self._wanted, 1.0)

    def rows(self) -> FloatArray:
        """The rows, shape (wanted, 12)."""
        return np.concatenate(self._parts)

    def add(self, block: FloatArray) -> None:
        """Take the next block of the stream.

        Raises
        ------
        LostRows
            Device time jumps ahead inside the recording.
        DataError
            A row is repeated, out of order, or not finite.
        ExperimentAborted
            The segment changed: somebody else commands the gyro.
        """
        if self.full or not len(block):
            return
        part = self._part_of(block)
        self._check_order(block[: part.start])
        mine = block[part]
        if len(mine):
            self._check(mine)
            mine = mine[: self._wanted - self.collected]
            self._parts.append(mine)
            self.collected += len(mine)

    def _part_of(self, block: FloatArray) -> slice:
        """Where the recording's rows lie in ``block``: from its start time to the block's end, or nowhere."""
        times, segments = block[:, 0], block[:, 1]
        own = np.flatnonzero(segments == self._segment)
        later = np.flatnonzero(segments > self._segment)
        if own.size and self.first_s is None:
            self.first_s = float(times[own[0]])
        if later.size and self.collected + own.size < self._wanted:
            raise ExperimentAborted(
                f"Segment must stay {self._segment} while recording, but got {int(segments[later[0]])} at t = {times[later[0]]:.4f} s. "
                "Somebody else commands the gyro: stop that, and start the run again."
            )
        if self.collected:
            return slice(0, int(later[0]) if later.size else len(block))
        if self.first_s is None:
            return slice(len(block), len(block))
        inside = own[~(times[own] < self.first_s + self._settle_s - 0.5 / self._rate_hz)]
        return slice(int(inside[0]), int(inside[-1]) + 1) if inside.size else slice(len(block), len(block))

    def _check(self, rows: FloatArray) -> None:
        """All of a recording's rows, and that they continue those before."""
        before = self._last_s if self.collected else None
        if before is None:
            self._check_order(rows[:1])
        steps = np.diff(rows[:, 0], prepend=rows[0, 0] if before is None else before) * self._rate_hz
        try:
            self._last_s = check_rows(rows, self._rate_hz, before)
        except DataError as error:
            complete = np.isfinite(rows).all()
            if complete and steps.max() > 1.5 and (steps[before is None :] > 0.5).all():
                raise LostRows(str(error)) from error
            raise

    def _check_order(self, rows: FloatArray) -> None:
        """Time does not run back before the recording; a gap does no harm there."""
        if not len(rows):
            return
        steps = np.diff(rows[:, 0], prepend=-np.inf if self._last_s is None else self._last_s)
        if not (steps > 0.0).all():
            at = int(np.argmin(steps > 0.0))
            raise DataError(
                f"Column t of the live block must increase, but got {rows[at, 0]:.6f} s at sample {at}: a block is repeated or out of "
                "order, or the gyro was restarted. One publisher per gyro; start the run again."
            )
        self._last_s = float(rows[-1, 0])
