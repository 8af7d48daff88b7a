"""Checksums of an MCAP file: rosbags writes none and some of its releases read none, so that a damaged bag would give wrong numbers.

Layout (mcap.dev/spec): magic, records (opcode, length, content), magic. A chunk holds the CRC-32 of its messages, the footer that of the
summary; 0 means that there is none, as rosbags leaves them. ``ros2 bag record`` fills them in.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import IO
from zlib import crc32

from ..errors import DataError

__all__ = ["add_checksums", "check_checksums"]

MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _CHUNK = 0x02, 0x06
#: opcode and length of a record
_HEAD = struct.Struct("<BQ")
#: first and last time, size, CRC of a chunk; then the name of its compression and its data
_CHUNK_HEAD = struct.Struct("<QQQI")
#: start of the summary and of its offsets, CRC of what is between that and itself
_FOOTER_BODY = struct.Struct("<QQI")


def add_checksums(path: Path) -> None:
    """Fill in the checksums of uncompressed chunks and of the summary that the writer left out."""
    with path.open("r+b") as file:
        for at, stored, computed in list(_checksums(file)):
            if not stored:
                file.seek(at)
                file.write(struct.pack("<I", computed))


def check_checksums(path: Path) -> None:
    """Compare what is stored with the content; compressed chunks have checksums of their own, which unpacking compares.

    Raises
    ------
    DataError
        One differs, or a record is longer than the file.
    """
    with path.open("rb") as file:
        for at, stored, computed in _checksums(file):
            if stored and stored != computed:
                raise DataError(
                    f"Bag file {path.name} must have the checksum of its content, but differs from it at byte {at}: it is damaged. "
                    "Copy or record it again."
                )


def _checksums(file: IO[bytes]) -> Iterator[tuple[int, int, int]]:
    """Where each checksum stands, what it is, and what it must be."""
    if file.read(len(MAGIC)) != MAGIC:
        return
    while len(head := file.read(_HEAD.size)) == _HEAD.size:
        opcode, length = _HEAD.unpack(head)
        start = file.tell()
        if opcode == _CHUNK:
            yield from _chunk(_exactly(file, length), start)
        elif opcode == _FOOTER:
            summary, _, stored = _FOOTER_BODY.unpack(_exactly(file, _FOOTER_BODY.size))
            if summary:
                at = start + _FOOTER_BODY.size - 4
                file.seek(summary)
                yield at, stored, crc32(_exactly(file, at - summary))
            return
        file.seek(start + length)


def _chunk(content: bytes, start: int) -> Iterator[tuple[int, int, int]]:
    if len(content) < _CHUNK_HEAD.size + 12:
        raise DataError(f"Chunk of a bag must hold its messages, but got {len(content)} bytes at byte {start}. Copy or record it again.")
    stored = _CHUNK_HEAD.unpack_from(content)[3]
    name_length = struct.unpack_from("<I", content, _CHUNK_HEAD.size)[0]
    data = _CHUNK_HEAD.size + 4 + name_length + 8
    if name_length == 0:
        yield start + _CHUNK_HEAD.size - 4, stored, crc32(memoryview(content)[data:])


def _exactly(file: IO[bytes], length: int) -> bytes:
    at = file.tell()
    # a damaged length must not fill the memory
    left = file.seek(0, 2) - at
    file.seek(at)
    if not 0 <= length <= left:
        raise DataError(
            f"Bag must be readable, but got a record of {length} bytes at byte {at}, past the end of its file. "
            "After a crash: ros2 bag reindex; else record it again."
        )
    return file.read(length)
