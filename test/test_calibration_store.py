"""The store: whatever happens to the process, the disk or the file, a good record comes back or a clear refusal does."""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from calibration_samples import make_record

from gyro_calib.calibration import RecordMissingError, RecordStore, document, dump_record, files
from gyro_calib.calibration.location import default_path, resolve_url
from gyro_calib.errors import StoreError
from gyro_calib.quantity import Quantity

DEVICE = "ring_15k-0007"


def numbered(i: int, device_id: str = DEVICE):
    return make_record(device_id, bias=Quantity(1e-6 * i, 1e-7, "rad/s"), bias_scale_covariance=0.0)


@pytest.fixture
def store(tmp_path: Path) -> RecordStore:
    return RecordStore(tmp_path / "records" / "gyro.yaml", DEVICE, keep=3)


def everything(directory: Path) -> dict[str, bytes]:
    return {str(p.relative_to(directory)): p.read_bytes() for p in directory.rglob("*") if p.is_file()}


# --- the plain way -------------------------------------------------------------------------------------------------------------


def test_saved_record_comes_back(store: RecordStore) -> None:
    with pytest.raises(RecordMissingError, match="must exist"):
        store.load()
    with pytest.raises(RecordMissingError):
        store.load_last_good()
    path = store.save(numbered(1))
    assert path == store.path
    assert store.load().to_dict() == numbered(1).to_dict()
    loaded = store.load_last_good()
    assert not loaded.fell_back
    assert loaded.path == path


def test_previous_versions_are_kept_and_bounded(store: RecordStore) -> None:
    for i in range(1, 7):
        store.save(numbered(i))
    assert [v.record.record_id for v in store.previous()] == [numbered(i).record_id for i in (5, 4, 3)]
    assert sorted(p.name for p in store.previous_directory.iterdir()) == ["0003.yaml", "0004.yaml", "0005.yaml"]


def test_saving_the_same_again_makes_no_version(store: RecordStore) -> None:
    store.save(numbered(1))
    store.save(numbered(1))
    assert store.previous() == []


def test_revert_goes_back_step_by_step(store: RecordStore) -> None:
    for i in (1, 2, 3):
        store.save(numbered(i))
    assert store.revert().record_id == numbered(2).record_id
    assert store.load().record_id == numbered(2).record_id
    assert (store.previous_directory / "reverted.yaml").read_text() == dump_record(numbered(3))
    assert store.revert().record_id == numbered(1).record_id
    with pytest.raises(StoreError, match="must hold a previous version"):
        store.revert()
    assert store.load().record_id == numbered(1).record_id
    store.save(numbered(4))
    assert store.revert().record_id == numbered(1).record_id


def test_revert_passes_over_a_copy_of_the_present_one(store: RecordStore) -> None:
    store.save(numbered(1))
    store.save(numbered(2))
    files.take_copy(store.path, store.previous_directory / "0002.yaml")  # what a writer leaves that dies before the rename
    store.save(numbered(3))
    assert [v.record.record_id for v in store.previous()] == [numbered(2).record_id, numbered(1).record_id]
    store.revert()
    files.take_copy(store.path, store.previous_directory / "0002.yaml")
    assert store.revert().record_id == numbered(1).record_id


def test_symbolic_link_stays_a_link(tmp_path: Path) -> None:
    real = tmp_path / "real" / "gyro.yaml"
    real.parent.mkdir()
    link = tmp_path / "link.yaml"
    link.symlink_to(real)
    RecordStore(link, DEVICE).save(numbered(1))
    assert link.is_symlink()
    assert real.read_text() == dump_record(numbered(1))


def test_without_hard_links_previous_versions_are_copies(store: RecordStore, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EPERM, "no links here")

    monkeypatch.setattr(os, "link", refuse)
    for i in (1, 2):
        store.save(numbered(i))
    assert [v.record.record_id for v in store.previous()] == [numbered(1).record_id]


def test_save_is_durable_in_the_right_order(store: RecordStore, monkeypatch: pytest.MonkeyPatch) -> None:
    store.save(numbered(1))
    calls: list[str] = []

    def traced(name: str, real: Callable, describe: Callable[..., str]) -> Callable:
        def call(*args, **kwargs):
            calls.append(f"{name} {describe(*args)}")
            return real(*args, **kwargs)

        return call

    def kind(fd: int) -> str:
        target = Path(os.readlink(f"/proc/self/fd/{fd}"))
        return "directory" if target.is_dir() else "temporary" if target.name.endswith("tmp") else target.name

    monkeypatch.setattr(os, "fsync", traced("fsync", os.fsync, kind))
    monkeypatch.setattr(os, "replace", traced("replace", os.replace, lambda a, b: Path(b).name))
    store.save(numbered(2))
    assert calls == ["replace 0001.yaml", "fsync directory", "fsync temporary", "replace gyro.yaml", "fsync directory"]


# --- URLs ----------------------------------------------------------------------------------------------------------------------


def test_default_is_under_ros_home(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    assert RecordStore(None, DEVICE).path == tmp_path / "gyro_calib" / f"{DEVICE}.yaml"
    assert resolve_url("", DEVICE) == default_path(DEVICE)
    assert resolve_url("file://${ROS_HOME}/a/${DEVICE}.yaml", DEVICE) == tmp_path / "a" / f"{DEVICE}.yaml"
    monkeypatch.delenv("ROS_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert default_path("x") == tmp_path / "home" / ".ros" / "gyro_calib" / "x.yaml"


def test_device_ids_never_share_or_leave_the_directory(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    paths = [default_path(d) for d in ("a/b", "a_b", "a%2Fb", "../x", "..", "ä b")]
    assert len(set(paths)) == len(paths)
    assert {p.parent for p in paths} == {tmp_path / "gyro_calib"}


def test_urls(tmp_path: Path) -> None:
    assert resolve_url("file:///data/a%20b.yaml", DEVICE) == Path("/data/a b.yaml")
    assert resolve_url(f"file://{tmp_path}", DEVICE) == tmp_path / f"{DEVICE}.yaml"
    assert resolve_url("/not/there/", DEVICE) == Path(f"/not/there/{DEVICE}.yaml")
    for bad, message in [
        ("http://host/a.yaml", "must be file:// or package://"),
        ("file://host/a.yaml", "must name a local absolute file"),
        ("file://a.yaml", "must name a local absolute file"),
        ("package://no_such_package_here/a.yaml", "must name an installed package"),
        ("file://[bad/a.yaml", "must be file:// or package://"),
    ]:
        with pytest.raises(StoreError, match=message):
            resolve_url(bad, DEVICE)


def test_package_url(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("ament_index_python")
    (tmp_path / "share/ament_index/resource_index/packages").mkdir(parents=True)
    (tmp_path / "share/ament_index/resource_index/packages/my_robot").touch()
    (tmp_path / "share/my_robot").mkdir()
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert resolve_url("package://my_robot/cal/gyro.yaml", DEVICE) == tmp_path / "share/my_robot/cal/gyro.yaml"
    for bad in ("package://my_robot/../other/gyro.yaml", "package://my_robot/"):
        with pytest.raises(StoreError, match="inside the package"):
            resolve_url(bad, DEVICE)


# --- bad files -----------------------------------------------------------------------------------------------------------------


def rewritten(change: Callable[[dict], None]) -> str:
    content = yaml.safe_load(dump_record(numbered(2)))
    change(content)
    return yaml.safe_dump(content)


BAD_FILES = {
    "torn": (dump_record(numbered(2))[:400], "torn"),
    "half": (dump_record(numbered(2))[:-200], "torn"),
    "empty": ("", "empty text"),
    "zeros": ("\0" * 4096, "empty text"),
    "not yaml": ("a: [", "must be YAML"),
    "camera_info": ("image_width: 640\ncamera_name: left\n", "another program's file"),
    "list": ("- 1\n- 2\n", "must be a YAML mapping"),
    "newer schema": (rewritten(lambda c: c.update(schema_version=2)), "must have schema_version 1, but got 2"),
    "edited": (rewritten(lambda c: c["record"].update(mode="ftr_y")), "must have the checksum of its content"),
    "no record": (rewritten(lambda c: c.pop("record")), "must have the checksum"),
    "other device": (dump_record(numbered(2, "other")), "must belong to device 'ring_15k-0007', but got a record of 'other'"),
    "too long": ("#" * 1_000_001, "at most 1000000 characters"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_file_is_refused_with_the_reason_and_the_last_good_one_used(store: RecordStore, case: str) -> None:
    text, reason = BAD_FILES[case]
    store.save(numbered(1))
    store.save(numbered(3))
    store.path.write_text(text)
    with pytest.raises(StoreError, match=reason) as refusal:
        store.load()
    assert str(store.path) in str(refusal.value)
    loaded = store.load_last_good()
    assert loaded.fell_back
    assert loaded.record.record_id == numbered(1).record_id
    assert reason in loaded.problem
    assert numbered(1).record_id in loaded.problem


def test_impossible_values_with_a_right_checksum_are_refused(store: RecordStore) -> None:
    content = yaml.safe_load(dump_record(numbered(1)))
    content["record"]["scale_factor"]["value"] = 0.0
    content.pop("checksum_sha256")
    content["checksum_sha256"] = document._checksum(content)
    store.path.parent.mkdir()
    store.path.write_text(yaml.safe_dump(content))
    with pytest.raises(StoreError, match="must hold a valid record, but got: Record scale_factor must not be 0"):
        store.load()


def test_when_nothing_is_good_the_first_reason_is_given(store: RecordStore) -> None:
    store.save(numbered(1))
    store.save(numbered(2))
    for path in (store.path, store.previous_directory / "0001.yaml"):
        path.write_text("torn")
    with pytest.raises(StoreError, match="must be a YAML mapping"):
        store.load_last_good()


def test_saving_over_a_torn_file_keeps_it_apart_from_the_good_ones(store: RecordStore) -> None:
    store.save(numbered(1))
    store.save(numbered(2))
    store.path.write_text("torn")
    store.save(numbered(3))
    assert store.load().record_id == numbered(3).record_id
    assert (store.previous_directory / "rejected.yaml").read_text() == "torn"
    assert store.revert().record_id == numbered(1).record_id


def test_two_devices_cannot_share_a_file(store: RecordStore) -> None:
    store.save(numbered(1))
    before = everything(store.path.parent)
    stranger = RecordStore(store.path, "ring_15k-0008")
    with pytest.raises(StoreError, match=r"must hold records of device 'ring_15k-0008', but holds one of 'ring_15k-0007'"):
        stranger.save(numbered(1, "ring_15k-0008"))
    with pytest.raises(StoreError, match="must get its own records"):
        stranger.save(numbered(1))
    assert everything(store.path.parent) == before


def test_arguments_are_checked(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="device_id must not be empty"):
        RecordStore(tmp_path, "")
    with pytest.raises(StoreError, match="keep must be >= 1"):
        RecordStore(tmp_path, DEVICE, keep=0)


@pytest.mark.parametrize(
    "text",
    ["!!int x", "!!timestamp x", "!!bool x", "a: 2024-99-99", "? [a]\n: 1", "[" * 5000, "{" * 5000, "1" * 5000, "!!python/name:os.system"],
)
def test_nasty_yaml_gives_a_store_error(store: RecordStore, text: str) -> None:
    store.path.parent.mkdir()
    store.path.write_text(text)
    with pytest.raises(StoreError):
        store.load()


# --- bad disks -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["replace", "fsync", "write", "link", "open"])
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EROFS, errno.EIO])
def test_disk_that_refuses_leaves_the_old_record(store: RecordStore, monkeypatch: pytest.MonkeyPatch, name: str, code: int) -> None:
    store.save(numbered(1))
    store.save(numbered(2))
    before = everything(store.path.parent)
    real = getattr(os, name)

    def refuse(*args, **kwargs):
        if name == "open" and not args[1] & os.O_CREAT:
            return real(*args, **kwargs)
        raise OSError(code, os.strerror(code))

    with monkeypatch.context() as patch:
        patch.setattr(os, name, refuse)
        with pytest.raises(StoreError, match="must be writable") as refusal:
            store.save(numbered(3))
    assert os.strerror(code) in str(refusal.value)
    after = everything(store.path.parent)
    assert after["gyro.yaml"] == before["gyro.yaml"]
    assert not [p for p in after if p.endswith("tmp")]
    store.save(numbered(3))
    assert store.load().record_id == numbered(3).record_id


def test_path_below_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(StoreError, match="must be writable"):
        RecordStore(tmp_path / "file" / "deeper" / "gyro.yaml", DEVICE).save(numbered(1))


def test_file_system_without_files_is_refused() -> None:
    below = RecordStore("/proc/gyro_calib/gyro.yaml", DEVICE)
    with pytest.raises(StoreError, match="must be writable"):
        below.save(numbered(1))
    with pytest.raises(StoreError, match="must be writable"):
        below.revert()


def test_directory_in_place_of_the_record_is_refused(tmp_path: Path) -> None:
    store = RecordStore(tmp_path / "gyro.yaml", DEVICE)
    (tmp_path / "gyro.yaml").mkdir()
    with pytest.raises(StoreError, match="must be readable"):
        store.load()
    with pytest.raises(StoreError, match="must be writable"):
        store.save(numbered(1))


# --- several writers; those that die are in test_store_kills.py ---------------------------------------------------------------


def test_lock_of_another_process_times_out(store: RecordStore) -> None:
    store.save(numbered(1))
    hasty = RecordStore(store.path, DEVICE, lock_timeout_s=0.05)
    with files.locked_directory(store.path.parent, 1.0), pytest.raises(StoreError, match="another process held it"):
        hasty.save(numbered(2))
    hasty.save(numbered(2))
    assert store.load().record_id == numbered(2).record_id


def test_concurrent_writers_lose_nothing(tmp_path: Path) -> None:
    path = tmp_path / "gyro.yaml"
    errors: list[BaseException] = []

    def write(first: int) -> None:
        try:
            for i in range(first, first + 5):
                RecordStore(path, DEVICE, keep=100).save(numbered(i))
                RecordStore(path, DEVICE).load()
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=write, args=(100 * n,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert errors == []
    store = RecordStore(path, DEVICE)
    found = {v.record.record_id for v in store.previous()} | {store.load().record_id}
    assert found == {numbered(100 * n + i).record_id for n in range(4) for i in range(5)}
