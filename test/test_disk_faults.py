"""Real disks that refuse: full, limited, read-only. What was stored stays, what could not be written is said and leaves nothing behind."""

from __future__ import annotations

import os
import resource
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from calibration_samples import make_record
from recording_samples import make_campaign
from small_disk import NO_SMALL_DISK, mount_small_disk, remount_read_only

from gyro_calib.calibration import CalibrationRecord, RecordStore, dump_record
from gyro_calib.device import dump_device, load_device
from gyro_calib.errors import DataError, DeviceError, StoreError
from gyro_calib.quantity import Quantity
from gyro_calib.recording import write_campaign_bag, write_campaign_h5

DEVICE = "ring_15k-0007"


def numbered(i: int) -> CalibrationRecord:
    return make_record(DEVICE, bias=Quantity(1e-6 * i, 1e-7, "rad/s"), bias_scale_covariance=0.0, condition_number=120.0)


def in_child(work: Callable[[], None], log: Path) -> None:
    """Carry ``work`` out in a forked process: its limits and mounts are its own. What fails there fails here."""
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            work()
            code = 0
        except BaseException:
            log.write_text(traceback.format_exc())
        finally:
            os._exit(code)
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    if code == NO_SMALL_DISK:
        pytest.skip("this kernel lets nobody mount a disk of his own")
    assert code == 0, log.read_text() if log.exists() else f"exit code {code}"


def refused(work: Callable[[], Any], kind: type[Exception], text: str) -> None:
    with pytest.raises(kind, match=text):
        work()


def fill(folder: Path) -> Path:
    """Write until nothing more fits."""
    ballast = folder / "ballast"
    with ballast.open("wb", buffering=0) as file:
        try:
            while True:
                file.write(b"x" * 512)
        except OSError:
            return ballast


@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_a_process_that_may_write_no_more_keeps_the_old_record(tmp_path: Path, share: float) -> None:
    """RLIMIT_FSIZE: the kernel cuts the write short, then refuses it."""
    store = RecordStore(tmp_path / "gyro.yaml", DEVICE)
    for i in (1, 2):
        store.save(numbered(i))
    size = int(share * len(dump_record(numbered(3))))

    def work() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
        refused(lambda: store.save(numbered(3)), StoreError, "must be writable, but got.*too large.*previous record is untouched")

    in_child(work, tmp_path / "log")
    assert store.load().record_id == numbered(2).record_id
    assert [v.record.record_id for v in store.previous()][-1] == numbered(1).record_id
    assert not list(tmp_path.rglob("*tmp"))
    store.save(numbered(3))


def test_a_disk_that_fills_up_and_is_freed(tmp_path: Path) -> None:
    """Records are saved until the disk is full; the last one saved stays, through every further attempt, and space makes it work again."""
    disk = tmp_path / "disk"
    disk.mkdir()

    def work() -> None:
        mount_small_disk(disk, "64k")
        (disk / "another program's").write_bytes(b"x" * 16_384)
        store = RecordStore(disk / "gyro.yaml", DEVICE, keep=100)
        saved = 0
        for i in range(1, 40):
            try:
                store.save(numbered(i))
            except StoreError as error:
                reason = str(error)
                break
            saved = i
        assert "No space left" in reason
        assert 2 < saved < 39
        fill(disk)
        for i in range(50, 55):
            refused(lambda i=i: store.save(numbered(i)), StoreError, "No space left")
            assert store.load().record_id == numbered(saved).record_id
        assert not list(disk.rglob("*tmp"))
        assert store.revert().record_id == numbered(saved - 1).record_id  # needs no space
        (disk / "another program's").unlink()
        store.save(numbered(60))
        assert store.load().record_id == numbered(60).record_id

    in_child(work, tmp_path / "log")


def test_a_disk_that_turns_read_only(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()

    def work() -> None:
        mount_small_disk(disk, "256k")
        store = RecordStore(disk / "gyro.yaml", DEVICE)
        for i in (1, 2):
            store.save(numbered(i))
        remount_read_only(disk)
        refused(lambda: store.save(numbered(3)), StoreError, "must be writable, but got.*Read-only")
        refused(store.revert, StoreError, "must be writable, but got.*Read-only")
        assert RecordStore(disk / "gyro.yaml", DEVICE).load_last_good().record.record_id == numbered(2).record_id

    in_child(work, tmp_path / "log")


def test_files_that_do_not_fit_are_refused_and_taken_away(tmp_path: Path) -> None:
    """Recordings and device descriptions: no half of one is left under its name."""
    disk = tmp_path / "disk"
    disk.mkdir()
    campaign, device = make_campaign(("ftr_x",), n=3000), load_device("ring_15k")

    def work() -> None:
        mount_small_disk(disk, "96k")
        refused(lambda: write_campaign_h5(disk / "c.h5", campaign), DataError, "must be writable, but got")
        assert list(disk.iterdir()) == []
        refused(lambda: write_campaign_bag(disk / "bag", campaign), DataError, "must be writable, but got")
        assert list(disk.iterdir()) == []
        dump_device(device, disk / "unit.yaml")
        ballast = fill(disk)
        refused(lambda: dump_device(device, disk / "unit.yaml", notes=["n" * 3000]), DeviceError, "No space left")
        assert load_device(disk / "unit.yaml") == device
        assert {p.name for p in disk.iterdir()} == {"unit.yaml", ballast.name}

    in_child(work, tmp_path / "log")


# a program of its own: a namespace is for a process with one thread, which rclpy has not
NODE_ON_A_FULL_DISK = """
import os, sys
from pathlib import Path
from small_disk import mount_small_disk
disk = Path(os.environ["SMALL_DISK"])
mount_small_disk(disk, "16k")
from gyro_calib.calibration import RecordStore
from test_disk_faults import DEVICE, fill, numbered
RecordStore(disk / "gyro.yaml", DEVICE).save(numbered(1))
fill(disk)
from gyro_calib.nodes.calibration_node import main
sys.exit(main())
"""


@pytest.mark.ros
def test_a_run_whose_result_could_not_be_stored_is_refused_before_it_begins(
    ros: Any, spawn_node: Callable[..., Any], tmp_path: Path
) -> None:
    """And with autosave off it may run; the record from before is in force all along."""
    from calibration_rig import CalibrationClient
    from ros_helpers import FakeGyro, wait_for

    from gyro_calib.nodes.gyro_sim_node import make_simulator

    (tmp_path / "disk").mkdir()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "__init__.py").write_text("")
    (tmp_path / "full" / "node.py").write_text(NODE_ON_A_FULL_DISK)
    ros.add(FakeGyro(make_simulator, fidelity="slow_flow", seed=7, realtime_factor=40.0))
    here = str(Path(__file__).parent)
    environment = {"SMALL_DISK": str(tmp_path / "disk"), "PYTHONPATH": os.pathsep.join([here, os.environ.get("PYTHONPATH", "")])}
    settings = {"record_url": str(tmp_path / "disk" / "gyro.yaml"), "plan_quality": "quick"}
    process = spawn_node("full.node", parameters=settings, environment=environment)
    client = CalibrationClient(ros)
    wait_for(lambda: not process.running or client.values.get("stream") == "alive", 60.0, "the node")
    if process.process.poll() == NO_SMALL_DISK:
        pytest.skip("this kernel lets nobody mount a disk of his own")
    client.wait_ready()
    response = client.call("self_calibrate")
    assert not response.success
    assert "No space left" in response.message
    assert "Free space" in response.message
    assert "autosave" in response.message
    assert client.self_test()["store"].level == b"\x02"
    assert client.values["calibration"] == numbered(1).record_id
    client.wait_record(numbered(1))
