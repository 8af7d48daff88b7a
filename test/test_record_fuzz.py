"""Damaged records: whatever happens to the text of one, it is refused in this package's words or means exactly what was written."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest
import yaml
from calibration_samples import make_record
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gyro_calib.calibration import CalibrationRecord, FactoryRecord, FactoryStore, RecordStore, document, dump_record, parse_record
from gyro_calib.errors import StoreError
from gyro_calib.quantity import Quantity

DEVICE = "ring_15k-0007"
RECORD = make_record(DEVICE, condition_number=120.0)
GOOD = dump_record(RECORD)
FUZZ = settings(max_examples=120, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
#: what an editor, a merge or a bad sector leaves
INSERTS = st.one_of(st.binary(max_size=8), st.text("0123456789.eE-+:{}[]!&*?|>'\"\n#, abnul", max_size=12).map(str.encode))


def refused_or_same(data: bytes, path: Path) -> bool:
    """Whether it was refused; a record that is accepted must be the one that was written."""
    path.write_bytes(data)
    try:
        found = RecordStore(path, DEVICE).load()
    except StoreError as error:
        message = str(error)
    else:
        assert found == RECORD
        return False
    assert str(path) in message
    return True


@FUZZ
@given(data=st.binary(max_size=200))
def test_arbitrary_bytes_are_refused(tmp_path: Path, data: bytes) -> None:
    assert refused_or_same(data, tmp_path / "fuzz.yaml")


@FUZZ
@given(start=st.integers(0, len(GOOD) - 1), length=st.integers(0, 40), insert=INSERTS)
def test_a_stretch_that_is_lost_or_overwritten(tmp_path: Path, start: int, length: int, insert: bytes) -> None:
    data = GOOD.encode()
    refused_or_same(data[:start] + insert + data[start + length :], tmp_path / "fuzz.yaml")


@FUZZ
@given(at=st.integers(0, len(GOOD) - 1), bit=st.integers(0, 7))
def test_a_bit_that_flips(tmp_path: Path, at: int, bit: int) -> None:
    data = bytearray(GOOD.encode())
    data[at] ^= 1 << bit
    refused_or_same(bytes(data), tmp_path / "fuzz.yaml")


@FUZZ
@given(order=st.permutations(range(len(GOOD.splitlines()))), keep=st.integers(1, 60))
def test_lines_out_of_order_lost_and_doubled(tmp_path: Path, order: list[int], keep: int) -> None:
    lines = GOOD.splitlines(keepends=True)
    kept = [lines[i] for i in (*order[:keep], order[0])]
    refused_or_same("".join(kept).encode(), tmp_path / "fuzz.yaml")


JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**20), 10**20),
    st.floats(allow_nan=True, allow_infinity=True),
    st.text(max_size=8),
    st.lists(st.floats(), max_size=4),
    st.dictionaries(st.text(max_size=4), st.floats(), max_size=3),
)


def places(content: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of all values of a document's content."""
    if isinstance(content, dict):
        return (
            [at, *(path for key, value in content.items() for path in places(value, (*at, key)))]
            if at
            else [path for key, value in content.items() for path in places(value, (key,))]
        )
    return [at]


CONTENT = yaml.safe_load(GOOD)["record"]


@FUZZ
@given(place=st.sampled_from(places(CONTENT)), value=JUNK)
def test_a_stranger_that_knows_the_checksum_gets_no_impossible_record_in(place: tuple[Any, ...], value: Any) -> None:
    """Every field replaced by junk under a right checksum: what is accepted is finite, in its units, and survives its own text."""
    content = copy.deepcopy(CONTENT)
    inner = content
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    head = {"format": document.FORMAT, "schema_version": 1}
    try:
        text = yaml.safe_dump({**head, "checksum_sha256": document._checksum({**head, "record": content}), "record": content})
    except (ValueError, yaml.YAMLError):
        return
    try:
        found = parse_record(text)
    except StoreError:
        return
    assert isinstance(found, CalibrationRecord)
    for quantity in (found.bias, found.scale_factor):
        assert abs(quantity.value) < float("inf")
        assert 0.0 <= quantity.sd < float("inf")
    assert found.scale_factor.value != 0.0
    assert parse_record(dump_record(found)).to_dict() == found.to_dict()


ANGLE = Quantity(1e-4, 1e-6, "rad")
FACTORY = FactoryRecord(
    DEVICE,
    "2026-03-01T12:00:00Z",
    Quantity(0.8, 1e-5, "1"),
    Quantity(1.001, 1e-6, "1"),
    ANGLE,
    ANGLE,
    None,
    Quantity(1e-6, 1e-7, "rad/s"),
    25.0,
)


@pytest.fixture(scope="module")
def factory_text(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A factory record as stored."""
    return FactoryStore(f"{tmp_path_factory.mktemp('factory')}/", DEVICE).save(FACTORY).read_bytes()


@FUZZ
@given(start=st.integers(0, 2000), length=st.integers(0, 40), insert=INSERTS)
def test_a_factory_record_that_is_damaged(tmp_path: Path, factory_text: bytes, start: int, length: int, insert: bytes) -> None:
    start %= len(factory_text)
    path = tmp_path / "unit.factory.yaml"
    path.write_bytes(factory_text[:start] + insert + factory_text[start + length :])
    try:
        found = FactoryStore(path, DEVICE).load()
    except StoreError as error:
        message = str(error)
    else:
        assert found == FACTORY
        return
    assert str(path) in message
