"""Damaged recordings: a campaign that is read from a damaged file has the numbers that were written, or it is refused in a sentence."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recording_samples import FACTORY, make_campaign, make_recording, make_rows

from gyro_calib.errors import DataError
from gyro_calib.recording import COLUMNS, Campaign, read_campaign_bag, read_campaign_h5, write_campaign_bag, write_campaign_h5
from gyro_calib.recording.mcap_checksums import add_checksums, check_checksums

FUZZ = settings(max_examples=80, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
CAMPAIGN = make_campaign(("ftr_x", "ftr_y"), n=120)


def read(reader: Callable[..., Campaign], path: Path) -> Campaign | None:
    """The campaign, or None when it was refused; anything but this package's error fails the test."""
    try:
        return reader(path)
    except DataError as error:
        message = str(error)
    assert len(message) > 20
    return None


def damaged(content: bytes, at: int, bit: int, length: int, insert: bytes) -> bytes:
    """One bit flipped, or a stretch overwritten, of its length or another."""
    at %= len(content)
    if length == 0:
        return content[:at] + bytes([content[at] ^ 1 << bit]) + content[at + 1 :]
    return content[:at] + insert + content[at + length :]


DAMAGE: dict[str, Any] = {
    "at": st.integers(0, 10**6),
    "bit": st.integers(0, 7),
    "length": st.integers(0, 12),
    "insert": st.binary(max_size=12),
}


@pytest.fixture(scope="module")
def h5(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_campaign_h5(tmp_path_factory.mktemp("h5") / "c.h5", CAMPAIGN)


@FUZZ
@given(**DAMAGE)
def test_columns_of_a_damaged_hdf5_file_are_as_written_or_refused(tmp_path: Path, h5: Path, **damage: Any) -> None:
    path = tmp_path / "damaged.h5"
    path.write_bytes(damaged(h5.read_bytes(), **damage))
    found = read(read_campaign_h5, path)
    if found is not None:  # its attributes are not covered: they are meant to be edited
        assert len(found) == len(CAMPAIGN)
        for ours, theirs in zip(CAMPAIGN, found, strict=True):
            assert theirs.data.tobytes() == ours.data.tobytes()


@FUZZ
@given(dropped=st.sets(st.sampled_from(COLUMNS), min_size=1, max_size=4), cut=st.integers(0, 119))
def test_columns_that_are_gone_or_cut_short(tmp_path: Path, h5: Path, dropped: set[str], cut: int) -> None:
    path = tmp_path / "dropped.h5"
    path.write_bytes(h5.read_bytes())
    with h5py.File(path, "r+") as file:
        for number, name in enumerate(sorted(dropped)):
            values = file[f"recording_000/{name}"][:cut]
            del file[f"recording_000/{name}"]
            if number % 2:
                file[f"recording_000/{name}"] = values
    found = read(read_campaign_h5, path)
    assert found is None or dropped == {"segment"}  # the only one that a recording does without: it is one segment


@FUZZ
@given(
    name=st.sampled_from(COLUMNS[2:]),
    value=st.sampled_from([np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, 2.6, -2.6]),
    row=st.integers(0, 119),
)
def test_impossible_numbers_in_a_column(name: str, value: float, row: int) -> None:
    """NaN, infinite and saturated samples are refused with the sample; a denormal is a number like another."""
    from gyro_calib.recording.integrity import validate

    rows = make_rows(120)
    column = COLUMNS.index(name)
    rows[row, column] = value
    recording = make_recording(rows)
    harmless = value == 5e-324 or (abs(value) == 2.6 and "pick" not in name) or name in ("ref_freq", "temperature")
    if not np.isfinite(value) or not harmless:
        with pytest.raises(DataError, match=rf"{name[:6]}.*sample {row}"):
            validate(recording, FACTORY)
    elif value == 5e-324:
        validate(recording, FACTORY)


def content_of(campaign: Campaign) -> list[Any]:
    """All that a bag carries."""
    return [
        campaign.device_id,
        json.dumps(campaign.factory),
        *((r.data.tobytes(), r.command, r.label, r.sample_rate_hz, json.dumps(r.extras)) for r in campaign),
    ]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("rosbags")
    return write_campaign_bag(tmp_path_factory.mktemp("bag") / "bag", CAMPAIGN)


@FUZZ
@given(**DAMAGE)
def test_a_damaged_bag_is_as_written_or_refused(tmp_path: Path, bag: Path, **damage: Any) -> None:
    (storage,) = bag.glob("*.mcap")
    copy = tmp_path / "bag"
    copy.mkdir(exist_ok=True)
    (copy / "metadata.yaml").write_bytes((bag / "metadata.yaml").read_bytes())
    (copy / storage.name).write_bytes(damaged(storage.read_bytes(), **damage))
    found = read(read_campaign_bag, copy)
    assert found is None or content_of(found) == content_of(CAMPAIGN)


@settings(FUZZ, max_examples=40)
@given(**DAMAGE)
def test_a_bag_with_damaged_metadata_is_as_written_or_refused(tmp_path: Path, bag: Path, **damage: Any) -> None:
    (storage,) = bag.glob("*.mcap")
    copy = tmp_path / "bag"
    copy.mkdir(exist_ok=True)
    (copy / storage.name).write_bytes(storage.read_bytes())
    (copy / "metadata.yaml").write_bytes(damaged((bag / "metadata.yaml").read_bytes(), **damage))
    found = read(read_campaign_bag, copy)
    assert found is None or content_of(found) == content_of(CAMPAIGN)


@settings(FUZZ, max_examples=40)
@given(cut=st.integers(0, 10**6))
def test_a_torn_bag_is_refused(tmp_path: Path, bag: Path, cut: int) -> None:
    (storage,) = bag.glob("*.mcap")
    content = storage.read_bytes()
    copy = tmp_path / "bag"
    copy.mkdir(exist_ok=True)
    (copy / "metadata.yaml").write_bytes((bag / "metadata.yaml").read_bytes())
    # the closing magic alone carries nothing
    (copy / storage.name).write_bytes(content[: cut % (len(content) - 8)])
    assert read(read_campaign_bag, copy) is None


def test_checksums_are_those_of_the_format(bag: Path, tmp_path: Path) -> None:
    """By hand, after the specification; and what the writer has filled in already is left alone."""
    from zlib import crc32

    (storage,) = bag.glob("*.mcap")
    content = storage.read_bytes()
    at = content.index(b"\x06", 8)
    while content[at] != 0x06 or struct.unpack_from("<Q", content, at + 1)[0] > len(content):
        at = content.index(b"\x06", at + 1)
    length = struct.unpack_from("<Q", content, at + 1)[0]
    size, stored, name = struct.unpack_from("<QII", content, at + 9 + 16)
    assert name == 0
    assert stored == crc32(content[at + 9 + length - size : at + 9 + length])
    copy = tmp_path / "again.mcap"
    copy.write_bytes(content)
    add_checksums(copy)
    assert copy.read_bytes() == content
    other = bytearray(content)
    other[at + 9 + 40] ^= 1
    copy.write_bytes(bytes(other))
    with pytest.raises(DataError, match="must have the checksum of its content"):
        check_checksums(copy)
