"""Which calibration is in force, without ROS: loaded, adopted, saved, reverted, or left as it was."""

from __future__ import annotations

from pathlib import Path

import pytest
from calibration_samples import make_record

from gyro_calib.calibration import CalibrationRecord, RecordStore
from gyro_calib.errors import StoreError
from gyro_calib.nodes.calibration_in_force import CalibrationInForce

DEVICE = "ring_15k-0007"


def record(day: int, device_id: str = DEVICE) -> CalibrationRecord:
    return make_record(device_id, created_utc=f"2026-03-{day:02d}T12:00:00Z", condition_number=100.0)


@pytest.fixture
def changes() -> list[str]:
    return []


@pytest.fixture
def held(tmp_path: Path, changes: list[str]) -> CalibrationInForce:
    return CalibrationInForce(f"{tmp_path}/", lambda: changes.append("change"))


def on_disk(tmp_path: Path, device_id: str = DEVICE) -> RecordStore:
    return RecordStore(f"{tmp_path}/", device_id)


def test_nothing_is_in_force_before_a_device_is_known(held: CalibrationInForce) -> None:
    assert held.record is None
    for action in (held.save, held.revert, lambda: held.adopt(record(1), save=True)):
        with pytest.raises(StoreError, match="has not told its device_id yet"):
            action()


def test_binding_loads_the_record_of_that_device(held: CalibrationInForce, changes: list[str], tmp_path: Path) -> None:
    on_disk(tmp_path).save(record(1))
    held.bind(DEVICE)
    assert (held.record, held.saved, held.problem) == (record(1), True, "")
    assert changes == ["change"]


def test_a_device_without_a_record_says_so_and_keeps_what_was(held: CalibrationInForce, tmp_path: Path) -> None:
    on_disk(tmp_path).save(record(1))
    held.bind(DEVICE)
    held.bind("ring_15k-0099")
    assert held.record == record(1)
    assert held.problem == "Device ring_15k-0099 has no calibration record yet. Call self_calibrate."
    with pytest.raises(StoreError, match=r"'ring_15k-0099'.* must get its own records, but got one of 'ring_15k-0007'"):
        held.save()


@pytest.mark.parametrize("save", [True, False])
def test_adopting_puts_a_record_in_force_and_on_disk_if_wanted(held: CalibrationInForce, tmp_path: Path, save: bool) -> None:
    on_disk(tmp_path).save(record(1))
    held.bind(DEVICE)
    held.adopt(record(2), save=save)
    assert (held.record, held.saved) == (record(2), save)
    assert on_disk(tmp_path).load() == record(2 if save else 1)


def test_a_record_of_another_device_is_not_adopted(held: CalibrationInForce, changes: list[str], tmp_path: Path) -> None:
    on_disk(tmp_path).save(record(1))
    held.bind(DEVICE)
    with pytest.raises(StoreError, match="must belong to device 'ring_15k-0007'"):
        held.adopt(record(2, "ring_15k-0099"), save=False)
    assert held.record == record(1)
    assert changes == ["change"]


def test_a_save_that_fails_leaves_what_was_in_force(held: CalibrationInForce, changes: list[str], tmp_path: Path) -> None:
    on_disk(tmp_path).save(record(1))
    held.bind(DEVICE)
    versions = on_disk(tmp_path).previous_directory
    versions.rmdir()
    versions.write_text("in the way")
    with pytest.raises(StoreError, match="must be writable"):
        held.adopt(record(2), save=True)
    assert (held.record, held.saved) == (record(1), True)
    assert on_disk(tmp_path).load() == record(1)
    assert changes == ["change"]


def test_revert_of_a_saved_record_takes_the_version_before(held: CalibrationInForce, tmp_path: Path) -> None:
    held.bind(DEVICE)
    for day in (1, 2, 3):
        held.adopt(record(day), save=True)
    assert held.revert() == f"reverted from {record(3).record_id} to {record(2).record_id}"
    assert held.record == on_disk(tmp_path).load() == record(2)
    held.revert()
    assert held.record == on_disk(tmp_path).load() == record(1)
    with pytest.raises(StoreError, match="there is none"):
        held.revert()
    assert held.record == record(1)


def test_revert_of_an_unsaved_record_takes_the_stored_one(held: CalibrationInForce, tmp_path: Path) -> None:
    held.bind(DEVICE)
    held.adopt(record(1), save=True)
    held.adopt(record(2), save=False)
    held.revert()
    assert (held.record, held.saved) == (record(1), True)


def test_an_unsaved_first_record_has_nothing_to_revert_to(held: CalibrationInForce) -> None:
    held.bind(DEVICE)
    held.adopt(record(1), save=False)
    with pytest.raises(StoreError, match="must exist, but"):
        held.revert()
    assert held.record == record(1)


def test_a_torn_file_falls_back_and_a_revert_repairs_it(held: CalibrationInForce, tmp_path: Path) -> None:
    store = on_disk(tmp_path)
    store.save(record(1))
    store.save(record(2))
    store.path.write_text("torn")
    held.bind(DEVICE)
    assert held.record == record(1)
    assert f"The last good record, {record(1).record_id}, is used instead" in held.problem
    assert held.revert() == f"put {record(1).record_id} in force, in place of what could not be read"
    assert (held.problem, store.load()) == ("", record(1))


def test_a_bad_url_is_a_problem_and_not_a_crash(changes: list[str]) -> None:
    in_force = CalibrationInForce("http://example.org/record.yaml", lambda: changes.append("change"))
    in_force.bind(DEVICE)
    assert "must be file:// or package://" in in_force.problem
    assert in_force.store is None
    assert changes == ["change"]
