"""The record as text: YAML with the name of the format, the schema version and a checksum of the content.

The checksum is taken of the canonical JSON of the content, not of the text: white space and comments may change, numbers may not.
"""

from __future__ import annotations

import hashlib
from typing import Any

import yaml

from ..errors import DataError, StoreError
from ..plain_yaml import load_yaml
from .record import SCHEMA_VERSION, CalibrationRecord, canonical_json

__all__ = ["FORMAT", "MAX_DOCUMENT_CHARS", "dump_content", "dump_record", "parse_content", "parse_record"]

#: what the key ``format`` of a document says
FORMAT = "gyro_calib calibration record"
#: a record is some ten thousand characters; a hundred times that is not a record
MAX_DOCUMENT_CHARS = 1_000_000

_HEADER = """\
# Calibration record of gyro_calib: rate = (rate_raw - bias) / scale_factor, in the units given with each value.
# Do not edit: the checksum covers the content and an edited record is refused. Calibrate again, or revert to a previous version.
"""


class _Dumper(yaml.SafeDumper):
    """Safe dumper that writes equal parts out in full."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def dump_content(header: str, form: str, version: int, content: Any) -> str:
    """Return a document of plain types under the name of its format, with a checksum; the same content always gives the same text."""
    head = {"format": form, "schema_version": version}
    document = {**head, "checksum_sha256": _checksum({**head, "record": content}), "record": content}
    return header + yaml.dump(document, Dumper=_Dumper, sort_keys=False, width=140, default_flow_style=None)


def parse_content(text: str, form: str, version: int, *, source: str) -> Any:
    """Return what :func:`dump_content` wrote.

    Raises
    ------
    StoreError
        Not such a document, of another format or schema, torn or edited (checksum). The text says which.
    """
    document = _mapping(text, source)
    if document.get("format") != form:
        raise StoreError(f"{source} must be a {form!r}, but got format {_short(document.get('format'))}. It is another program's file.")
    found = document.get("schema_version")
    if found != version or isinstance(found, bool):
        raise StoreError(
            f"{source} must have schema_version {version}, but got {_short(found)}. Use the gyro_calib that wrote it, or calibrate again."
        )
    content = document.get("record")
    try:
        checksum = _checksum({"format": form, "schema_version": version, "record": content})
    except (TypeError, ValueError, RecursionError) as error:
        raise StoreError(f"{source} must hold a valid record, but got: {error}") from error
    if document.get("checksum_sha256") != checksum:
        raise StoreError(
            f"{source} must have the checksum of its content, {checksum}, but got {_short(document.get('checksum_sha256'))}. "
            "It is torn or was edited: use the previous version or calibrate again."
        )
    return content


def dump_record(record: CalibrationRecord) -> str:
    """Return the document of ``record``; the same record always gives the same text."""
    return dump_content(_HEADER, FORMAT, record.schema_version, record.to_dict())


def parse_record(text: str, *, device_id: str | None = None, source: str = "Calibration record") -> CalibrationRecord:
    """Return the record in ``text``.

    Parameters
    ----------
    text : str
        A document of :func:`dump_record`.
    device_id : str, optional
        The device that the record must belong to; ``None`` accepts any.
    source : str
        How error texts call the document: a path, a topic.

    Raises
    ------
    StoreError
        Not a record, of another schema, torn or edited (checksum), with impossible values, or of another device. The text says which.
    """
    content = parse_content(text, FORMAT, SCHEMA_VERSION, source=source)
    try:
        record = CalibrationRecord.from_dict(content)
    except (DataError, TypeError, ValueError, RecursionError) as error:
        raise StoreError(f"{source} must hold a valid record, but got: {error}") from error
    if device_id is not None and record.device_id != device_id:
        raise StoreError(
            f"{source} must belong to device {device_id!r}, but got a record of {record.device_id!r}. "
            "Calibrate this device, or correct the path."
        )
    return record


def _mapping(text: str, source: str) -> dict[str, Any]:
    if len(text) > MAX_DOCUMENT_CHARS:
        raise StoreError(f"{source} must be at most {MAX_DOCUMENT_CHARS} characters, but got {len(text)}. It is not a record.")
    if not text.strip("\x00 \t\r\n"):
        raise StoreError(f"{source} must hold a record, but got an empty text. It is torn: use the previous version or calibrate again.")
    try:
        document = load_yaml(text)
    except ValueError as error:
        raise StoreError(f"{source} must be YAML, but got a text that is not ({error}). It is torn or foreign.") from error
    if not isinstance(document, dict):
        raise StoreError(f"{source} must be a YAML mapping, but got {type(document).__name__}. It is torn or foreign.")
    return document


def _checksum(content: dict[str, Any]) -> str:
    return hashlib.sha256(canonical_json(content).encode()).hexdigest()


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
