"""The factory record on disk: one file per unit, written once, never by a field calibration."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from urllib.parse import quote

from ..errors import DataError, StoreError
from .document import dump_content, parse_content
from .factory_record import FACTORY_FORMAT, FACTORY_SCHEMA, FactoryRecord
from .files import clean_temporaries, locked_directory, make_directory, replace_text, take_copy
from .location import resolve_url, ros_home

__all__ = ["FactoryStore", "factory_path"]

_HEADER = """\
# Factory record of gyro_calib: what only a rate table tells. A field calibration reads it and never writes it.
# Do not edit: the checksum covers the content and an edited record is refused.
"""


def factory_path(url_or_path: str | os.PathLike[str] | None, device_id: str) -> Path:
    """File of a unit's factory record: what is given, ``<device>.factory.yaml`` in a directory given, else in ``$ROS_HOME/gyro_calib``."""
    name = f"{quote(device_id, safe='')}.factory.yaml"
    if url_or_path is None or not os.fspath(url_or_path):
        return ros_home() / "gyro_calib" / name
    path = resolve_url(url_or_path, device_id)
    given = os.fspath(url_or_path)
    return path.with_name(name) if given.endswith("/") or Path(given).is_dir() else path


class FactoryStore:
    """Keeps the factory record of one unit.

    Parameters
    ----------
    url_or_path : str, path or None
        See :func:`factory_path`.
    device_id : str
    lock_timeout_s : float
        How long to wait for another writer.
    """

    def __init__(self, url_or_path: str | os.PathLike[str] | None, device_id: str, *, lock_timeout_s: float = 10.0) -> None:
        self.device_id = device_id
        self.path = factory_path(url_or_path, device_id)
        self._lock_timeout_s = lock_timeout_s

    def load(self) -> FactoryRecord | None:
        """The record, or None when there is no file.

        Raises
        ------
        StoreError
            The file is torn, foreign, of another schema or device, or not readable.
        """
        try:
            content = self.path.read_text(encoding="utf-8")
        except FileNotFoundError:
            return None
        except (OSError, UnicodeDecodeError) as error:
            raise StoreError(f"Factory record {self.path} must be readable, but got: {error}.") from error
        source = f"Factory record {self.path}"
        try:
            record = FactoryRecord.from_dict(parse_content(content, FACTORY_FORMAT, FACTORY_SCHEMA, source=source))
        except DataError as error:
            raise StoreError(f"{source} must hold a valid record, but got: {error}") from error
        if record.device_id != self.device_id:
            raise StoreError(f"{source} must belong to device {self.device_id!r}, but got one of {record.device_id!r}. Correct the path.")
        return record

    def save(self, record: FactoryRecord, *, replace_existing: bool = False) -> Path:
        """Store ``record``; the one before it, if ``replace_existing``, is kept as ``<file>.before``.

        Raises
        ------
        StoreError
            Another device's record, one that is there already, or a disk that refuses; what was stored stays as it was.
        """
        if record.device_id != self.device_id:
            raise StoreError(f"Factory store of {self.device_id!r} must get its own record, but got one of {record.device_id!r}.")
        document = dump_content(_HEADER, FACTORY_FORMAT, FACTORY_SCHEMA, record.to_dict())
        try:
            make_directory(self.path.parent)
            with locked_directory(self.path.parent, self._lock_timeout_s):
                clean_temporaries(self.path.parent)
                if self.path.exists():
                    if not replace_existing:
                        raise StoreError(f"Factory record {self.path} must not be overwritten, but there is one. Say --replace to do so.")
                    take_copy(self.path, self.path.with_name(self.path.name + ".before"))
                replace_text(self.path, document)
                # only says what it is: whoever may write the directory can still replace the file
                with contextlib.suppress(OSError):
                    self.path.chmod(0o444)
        except OSError as error:
            raise StoreError(f"Factory record {self.path} must be writable, but got: {error}. What was stored is untouched.") from error
        return self.path
