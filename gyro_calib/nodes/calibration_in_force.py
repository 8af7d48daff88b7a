"""Which calibration is in force, and how it gets in, out and onto the disk. No ROS here: the node publishes what this holds.

A record enters in three ways: loaded for the device that the gyro says it is, found by a run, or taken back by a revert. Each either
happens whole or leaves what was in force, and what is on disk, as it was.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from ..calibration.record import CalibrationRecord
from ..calibration.store import RecordMissingError, RecordStore
from ..errors import StoreError

__all__ = ["CalibrationInForce"]

#: a service waits for the answer of a save: better a refusal than a node that hangs behind another writer [s]
_LOCK_TIMEOUT_S = 2.0


class CalibrationInForce:
    """Holds the record in force.

    Parameters
    ----------
    record_url : str
        Where records live, see :func:`gyro_calib.calibration.location.resolve_url`; "" for the default of the device.
    on_change : callable
        Called after what is in force (or the reason why nothing is) has changed, from whatever thread changes it.
    """

    def __init__(self, record_url: str, on_change: Callable[[], None]) -> None:
        self._url = record_url
        self._on_change = on_change
        self._lock = threading.RLock()
        self._store: RecordStore | None = None
        self._record: CalibrationRecord | None = None
        self._saved = False
        self._problem = ""

    @property
    def record(self) -> CalibrationRecord | None:
        """What is in force, or None."""
        return self._record

    @property
    def saved(self) -> bool:
        """Whether what is in force is on disk."""
        return self._saved

    @property
    def problem(self) -> str:
        """Why nothing, or not the newest, is in force; "" when all is well."""
        return self._problem

    @property
    def store(self) -> RecordStore | None:
        """Where records of the bound device live; None until a device is bound."""
        return self._store

    @property
    def path(self) -> Path:
        """File of the bound device's records; StoreError until a device is bound."""
        return self._bound().path

    def bind(self, device_id: str) -> None:
        """Load the last good record of ``device_id`` and put it in force.

        When that device has none, a record of another device stays where it is: it names its device, and nothing else is known better.
        """
        with self._lock:
            self._problem = ""
            try:
                self._store = RecordStore(self._url, device_id, lock_timeout_s=_LOCK_TIMEOUT_S)
                loaded = self._store.load_last_good()
            except RecordMissingError:
                self._problem = f"Device {device_id} has no calibration record yet. Call self_calibrate."
            except StoreError as error:
                self._problem = f"{error} Call self_calibrate."
            else:
                self._record, self._saved, self._problem = loaded.record, True, loaded.problem
            self._on_change()

    def adopt(self, record: CalibrationRecord, *, save: bool) -> None:
        """Put ``record`` in force; with ``save`` store it first.

        Raises
        ------
        StoreError
            It could not be stored, or belongs to another device; what was in force stays.
        """
        with self._lock:
            store = self._bound()
            if record.device_id != store.device_id:
                raise StoreError(f"Record must belong to device {store.device_id!r}, but got one of {record.device_id!r}. Calibrate again.")
            if save:
                store.save(record)
            self._record, self._saved, self._problem = record, save, ""
            self._on_change()

    def save(self) -> str:
        """Store what is in force; a sentence that says where.

        Raises
        ------
        StoreError
            Nothing is in force, it belongs to another device, or the disk refuses.
        """
        with self._lock:
            store = self._bound()
            if self._record is None:
                raise StoreError("There must be a calibration to save, but none is in force. Call self_calibrate.")
            path = store.save(self._record)
            self._saved = True
            self._on_change()
            return f"saved {self._record.record_id} to {path}"

    def revert(self) -> str:
        """Put the calibration before this one back in force: the stored one if this one is not saved, else the previous version.

        Raises
        ------
        StoreError
            There is no earlier one, or the disk refuses; what was in force stays.
        """
        with self._lock:
            store = self._bound()
            before = self._record
            unsaved = before is not None and before.device_id == store.device_id and not self._saved
            record = store.load_last_good().record if unsaved else store.revert()
            self._record, self._saved, self._problem = record, True, ""
            self._on_change()
            if before is None or before.record_id == record.record_id:
                return f"put {record.record_id} in force, in place of what could not be read"
            return f"reverted from {before.record_id} to {record.record_id}"

    def _bound(self) -> RecordStore:
        if self._store is None:
            raise StoreError("Device of the gyro must be known, but it has not told its device_id yet. Start the gyro's driver.")
        return self._store
