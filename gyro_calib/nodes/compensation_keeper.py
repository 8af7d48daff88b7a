"""Keeps the drive compensation of the calibration in force on the gyro, which forgets it when it is switched off. No ROS here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ..calibration.apply import validity_problems
from ..calibration.record import CalibrationRecord
from ..recording.command import Command

__all__ = ["CompensationKeeper"]


class CompensationKeeper:
    """Owes the gyro a matrix after it was met or a calibration was reverted, and pays when the gyro can be set.

    Parameters
    ----------
    put : callable
        Sets parameters of the gyro by name; may block, is called where :meth:`pay` is.
    say : callable of str
        Hears what was put in force.
    """

    def __init__(self, put: Callable[[Mapping[str, Any]], None], say: Callable[[str], None]) -> None:
        self._put, self._say = put, say
        self._owed: tuple[tuple[float, ...], bool] | None = None
        self._just_paid = False

    def owe(self, record: CalibrationRecord | None, *, only_fresh: bool) -> None:
        """The gyro is to have the compensation of ``record``; ``only_fresh``: if it has none, as after its start."""
        self._owed = None if record is None else (record.compensation, only_fresh)

    def pay(self, command: Command) -> None:
        """Put in force what is owed, if ``command`` (in force now) differs from it; once."""
        self._just_paid = False
        owed, self._owed = self._owed, None
        if owed is None or owed[0] == command.compensation or (owed[1] and command.compensation != Command().compensation):
            return
        self._put({"compensation": list(owed[0])})
        self._just_paid = True
        self._say(f"Drive compensation of the calibration in force was put on the gyro: {list(owed[0])}.")

    def problems(self, record: CalibrationRecord, command: Command) -> tuple[str, ...]:
        """Why ``record`` does not hold with the compensation of ``command``; nothing until the gyro has told what became of a payment."""
        return () if self._owed is not None or self._just_paid else validity_problems(record, compensation=command.compensation)
