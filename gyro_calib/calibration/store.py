"""The record on disk: one file per device, replaced atomically, with its previous versions beside it.

``<file>`` holds the record in force; ``<file>.previous/NNNN.yaml`` the ones before it, newest with the highest number. A save is: temporary
file, ``fsync``, keep the present one under its number, atomic rename, ``fsync`` of the directory. Whoever dies in between leaves the old
record or the new one.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ..errors import StoreError
from .document import MAX_DOCUMENT_CHARS, dump_record, parse_record
from .factory_record import FACTORY_FORMAT
from .files import clean_temporaries, locked_directory, make_directory, replace_text, sync_directory, take_copy
from .location import resolve_url
from .record import CalibrationRecord

__all__ = ["LoadedRecord", "RecordMissingError", "RecordStore", "read_record"]

_VERSION = re.compile(r"(\d{4,})\.yaml")


class RecordMissingError(StoreError):
    """There is no record of this device: it was never calibrated, or the path is another one."""


@dataclass(frozen=True)
class LoadedRecord:
    """A record and where it came from.

    Parameters
    ----------
    record : CalibrationRecord
        The record.
    path : Path
        The file it was read from.
    problem : str
        Why it is not the newest one; empty when it is.
    """

    record: CalibrationRecord
    path: Path
    problem: str = ""

    @property
    def fell_back(self) -> bool:
        """Whether the newest file was not usable and this is a previous version."""
        return bool(self.problem)


class RecordStore:
    """Keeps the calibration record of one device.

    Parameters
    ----------
    url_or_path : str, path or None
        See :func:`gyro_calib.calibration.location.resolve_url`; ``None`` for ``$ROS_HOME/gyro_calib/<device>.yaml``.
    device_id : str
        The only device whose records go in and come out.
    keep : int
        Number of previous versions kept, at least 1.
    lock_timeout_s : float
        How long to wait for another writer.

    Raises
    ------
    StoreError
        The URL cannot be resolved, or an argument is out of range.
    """

    def __init__(self, url_or_path: str | os.PathLike[str] | None, device_id: str, *, keep: int = 8, lock_timeout_s: float = 10.0) -> None:
        if not device_id:
            raise StoreError("Store device_id must not be empty, but got ''. Give the identity that the gyro reports.")
        if keep < 1:
            raise StoreError(f"Store keep must be >= 1, but got {keep!r}.")
        self.device_id = device_id
        self.path = _real_path(resolve_url(url_or_path, device_id))
        self._keep = keep
        self._lock_timeout_s = lock_timeout_s

    @property
    def previous_directory(self) -> Path:
        """Where previous versions are kept."""
        return self.path.with_name(self.path.name + ".previous")

    def save(self, record: CalibrationRecord) -> Path:
        """Store ``record`` as the one in force; the present one becomes the newest previous version.

        Returns
        -------
        Path
            The file written.

        Raises
        ------
        StoreError
            The record or the stored one belongs to another device, or the disk is full, read-only or otherwise refuses. What was stored
            before stays as it was.
        """
        if record.device_id != self.device_id:
            raise StoreError(f"Store of device {self.device_id!r} must get its own records, but got one of {record.device_id!r}.")
        document = dump_record(record)
        with self._writing():
            if _text_or_none(self.path) != document:
                self._keep_present()
                replace_text(self.path, document)
                self._prune()
        return self.path

    def load(self) -> CalibrationRecord:
        """Return the record in force.

        Raises
        ------
        RecordMissingError
            There is no file.
        StoreError
            The file is torn, foreign, of another schema or device, or not readable; the text says which.
        """
        return self._read(self.path)

    def load_last_good(self) -> LoadedRecord:
        """Return the record in force or, when its file is not usable, the newest good previous version, and say so.

        Raises
        ------
        RecordMissingError
            There is no file and no previous version.
        StoreError
            Neither the file nor any previous version is usable.
        """
        try:
            return LoadedRecord(self.load(), self.path)
        except StoreError as error:
            first = error
        for path in reversed(self._versions()):
            with contextlib.suppress(StoreError):
                record = self._read(path)
                return LoadedRecord(record, path, f"{first} The last good record, {record.record_id}, is used instead.")
        raise first

    def previous(self) -> list[LoadedRecord]:
        """Return the usable previous versions, newest first."""
        found = []
        for path in reversed(self._versions()):
            with contextlib.suppress(StoreError):
                found.append(LoadedRecord(self._read(path), path))
        return found

    def revert(self) -> CalibrationRecord:
        """Put the newest good previous version in force and return it.

        What was in force is kept as ``reverted.yaml`` beside the previous versions; a second call goes one further back.

        Raises
        ------
        StoreError
            There is no previous version, or the disk refuses; what was stored stays as it was.
        """
        with self._writing():
            present = _text_or_none(self.path)
            for candidate in self.previous():
                if _text_or_none(candidate.path) == present:
                    continue  # left by a writer that died after keeping it
                if present is not None:
                    take_copy(self.path, self.previous_directory / "reverted.yaml")
                os.replace(candidate.path, self.path)
                sync_directory(self.path.parent)
                sync_directory(self.previous_directory)
                return candidate.record
        raise StoreError(f"Store {self.path} must hold a previous version to revert to, but there is none. The present record stays.")

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """Directories made, lock held, stale temporaries gone; errors of the disk become a :class:`StoreError`."""
        try:
            make_directory(self.path.parent)
            with locked_directory(self.path.parent, self._lock_timeout_s):
                make_directory(self.previous_directory)
                clean_temporaries(self.path.parent)
                clean_temporaries(self.previous_directory)
                yield
        except OSError as error:
            raise StoreError(
                f"Store {self.path} must be writable, but got: {error}. Free space or choose another URL; the previous record is untouched."
            ) from error

    def _keep_present(self) -> None:
        """Give the present file its number among the previous versions; one that nobody can use goes out of the way."""
        present = _text_or_none(self.path)
        if present is None and not self.path.exists():
            return
        if present and FACTORY_FORMAT in present[:400]:
            raise StoreError(
                f"Store {self.path} must hold field calibrations, but holds the factory record, which a field calibration never "
                "overwrites. Choose another URL."
            )
        try:
            owner = parse_record(present or "").device_id
        except StoreError:  # torn or of another schema: kept for a look, but not among the good ones
            take_copy(self.path, self.previous_directory / "rejected.yaml")
            return
        if owner != self.device_id:
            raise StoreError(
                f"Store {self.path} must hold records of device {self.device_id!r}, but holds one of {owner!r}. "
                "Give each device a file of its own."
            )
        versions = self._versions()
        if versions and _text_or_none(versions[-1]) == present:
            return  # a writer died after keeping it
        take_copy(self.path, self.previous_directory / f"{_number(versions[-1]) + 1 if versions else 1:04d}.yaml")

    def _versions(self) -> list[Path]:
        """Numbered previous versions, oldest first."""
        try:
            names = [p for p in self.previous_directory.iterdir() if _VERSION.fullmatch(p.name)]
        except OSError:
            return []
        return sorted(names, key=_number)

    def _prune(self) -> None:
        for path in self._versions()[: -self._keep]:
            with contextlib.suppress(OSError):
                path.unlink()

    def _read(self, path: Path) -> CalibrationRecord:
        return parse_record(_read_text(path), device_id=self.device_id, source=f"Calibration record {path}")


def read_record(path: str | os.PathLike[str]) -> CalibrationRecord:
    """Return the record in a file, of whatever device it is; raises like :meth:`RecordStore.load`."""
    return parse_record(_read_text(Path(path)), source=f"Calibration record {os.fspath(path)}")


def _read_text(path: Path) -> str:
    try:
        with open(path, "rb") as file:
            # one byte more than is allowed tells "too long" without reading a disk full of it
            data = file.read(MAX_DOCUMENT_CHARS + 1)
        return data.decode()
    except FileNotFoundError as error:
        raise RecordMissingError(f"Calibration record {path} must exist, but does not. Calibrate it, or correct the path.") from error
    except UnicodeDecodeError as error:
        raise StoreError(f"Calibration record {path} must be UTF-8, but is not ({error.reason}). It is torn or foreign.") from error
    except OSError as error:
        raise StoreError(f"Calibration record {path} must be readable, but got: {error}.") from error


def _number(path: Path) -> int:
    return int(path.name.split(".")[0])


def _real_path(path: Path) -> Path:
    # a symbolic link stays one: the rename happens where it points to
    try:
        return path.resolve()
    except (OSError, RuntimeError) as error:
        raise StoreError(f"Store path must be resolvable, but got {path} ({error}).") from error


def _text_or_none(path: Path) -> str | None:
    with contextlib.suppress(StoreError):
        return _read_text(path)
    return None
