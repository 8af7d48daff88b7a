"""Everything that can end a run, with real nodes: the status says why and what to do, and the previous calibration stays.

Each test ends in :func:`untouched`: the record in force is the one from before, its file has the same bytes, and the gyro is back in its
mission where it can be reached.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from calibration_rig import DEVICE, CalibrationClient, Rig, record_file, store_record
from rclpy.parameter import Parameter
from ros_helpers import FakeGyro, PlainSimulator, RosSession, overrides, wait_for
from std_msgs.msg import Float64MultiArray

from gyro_calib.calibration import CalibrationRecord, RecordStore
from gyro_calib.nodes import calibration_runs, recording_run
from gyro_calib.nodes.calibration_messages import record_from_calibration
from gyro_calib.nodes.calibration_node import CalibrationNode
from gyro_calib.nodes.gyro_sim_node import make_simulator
from gyro_calib.nodes.runtime import SENSOR_PUB_QOS
from gyro_calib.recording.command import Command

pytestmark = pytest.mark.ros

MISSION = Command()


@pytest.fixture
def previous(ros_environment: Path) -> CalibrationRecord:
    """A calibration from an earlier day, on disk."""
    return store_record()


@pytest.fixture
def rig(previous: CalibrationRecord, ros: RosSession) -> Rig:
    return Rig(ros)


def untouched(client: CalibrationClient, previous: CalibrationRecord, content: bytes) -> None:
    """The previous calibration is in force, published and on disk, as it was."""
    assert client.values["calibration"] == previous.record_id
    client.wait_record(previous)
    assert client.bias.wait()[-1].twist.twist.angular.z == previous.bias.value
    assert record_file(previous.device_id).read_bytes() == content
    assert RecordStore(None, previous.device_id).load() == previous
    in_between = [record_from_calibration(message) for message in client.calibration.messages]
    assert all(record == previous for record in in_between if record is not None), "nothing else may have been in force in between"


def drop_every_fourth_block(gyro: FakeGyro) -> None:
    for count in range(2000):
        if count % 4 == 0:
            gyro.drop_block()
        else:
            gyro._add(lambda rows: [rows])


def somebody_else_commands(gyro: FakeGyro) -> None:
    gyro.set_parameters([Parameter("setpoint.amplitude_v", value=0.9)])


@pytest.mark.parametrize(
    ("fault", "reason", "remedy"),
    [
        pytest.param(FakeGyro.stop_stream, "must deliver blocks, but none came for 1.5 s", "Check that the gyro runs", id="stream stops"),
        pytest.param(lambda gyro: gyro.spoil(4), "y_pick_c of the live block must be finite, but got nan", "sample 3", id="NaN"),
        pytest.param(FakeGyro.repeat_block, "a block is repeated or out of order", "", id="repeated block"),
        pytest.param(drop_every_fourth_block, "samples are missing", "", id="missing blocks"),
        pytest.param(
            lambda gyro: gyro.ramp_temperature(1.0), "Temperature must stay within 2 K", "raise temperature_limit_k", id="temperature"
        ),
        pytest.param(lambda gyro: gyro.move_base(0.05), "Base must stay within", "Hold the gyro still", id="base moves"),
        pytest.param(lambda gyro: gyro.become("ring_15k-0099"), "but is now 'ring_15k-0099'", "Start the run again", id="another device"),
        pytest.param(somebody_else_commands, "Somebody else commands the gyro", "stop that", id="somebody else commands"),
    ],
)
def test_a_spoiled_run_fails_with_reason_and_remedy(
    rig: Rig, previous: CalibrationRecord, fault: Callable[[FakeGyro], None], reason: str, remedy: str
) -> None:
    content = record_file().read_bytes()
    rig.gyro.during_segment(1, lambda: fault(rig.gyro), after_s=6.0)
    run_id = rig.run("run_sideband")
    assert rig.wait_end(run_id) == "failed"
    assert reason in rig.text
    assert remedy in rig.text
    assert rig.text.startswith(f"run {run_id} failed: ")
    assert f"Calibration {previous.record_id} stays in force." in rig.text
    assert rig.status.messages[-1].level == b"\x02"
    untouched(rig, previous, content)
    if fault is not FakeGyro.stop_stream:
        wait_for(lambda: rig.gyro_command == MISSION, 10.0, "the gyro back in its mission")


def test_another_device_is_noticed_long_before_the_step_ends(ros: RosSession) -> None:
    previous = store_record("plain-0001")
    rig = Rig(ros, ros.add(FakeGyro(PlainSimulator(), realtime_factor=1.0)), plan_quality="fine")
    rig.wait_record(previous)
    step_s = 60.0  # of a static stretch of this quality
    rig.gyro.during_segment(1, lambda: rig.gyro.become("plain-0002"), after_s=0.5)
    began_s = rig.gyro._sim.time_s
    assert rig.wait_end(rig.run("run_sideband")) == "failed"
    assert "but is now 'plain-0002'" in rig.text
    assert rig.gyro._sim.time_s - began_s < 0.5 * step_s
    untouched(rig, previous, record_file("plain-0001").read_bytes())


def test_a_stopped_stream_says_that_the_gyro_may_not_be_back_and_the_next_run_is_refused(rig: Rig, previous: CalibrationRecord) -> None:
    content = record_file().read_bytes()
    rig.gyro.during_segment(2, rig.gyro.stop_stream, after_s=1.0)
    assert rig.wait_end(rig.run("run_sideband")) == "failed"
    assert "The gyro may not be back in its mission command (ftr_x)" in rig.text
    response = rig.call("run_sideband")
    assert not response.success
    assert "must deliver blocks, but none came for" in response.message
    rig.wait_value("stream", "silent")
    untouched(rig, previous, content)
    rig.gyro.resume_stream()
    rig.wait_value("stream", "alive")
    run_id = rig.run("run_sideband")
    rig.call("cancel")
    assert rig.wait_end(run_id) == "cancelled"


def test_cancel_while_recording_puts_the_gyro_back(rig: Rig, previous: CalibrationRecord) -> None:
    content = record_file().read_bytes()
    reached = threading.Event()
    # the second step: loops off, open drive
    rig.gyro.during_segment(2, reached.set, after_s=0.5)
    run_id = rig.run("run_feedthrough")
    assert reached.wait(30.0)
    assert rig.gyro_command.mode == "loops_off"
    response = rig.call("cancel")
    assert response.success
    assert run_id in response.message
    assert rig.wait_end(run_id) == "cancelled"
    assert rig.gyro_command == MISSION
    assert "cancelled on request" in rig.text
    assert rig.status.messages[-1].level == b"\x01"
    untouched(rig, previous, content)
    again = rig.call("cancel")
    assert not again.success
    assert "no run is in progress" in again.message


def test_cancel_at_once_after_the_request(rig: Rig, previous: CalibrationRecord) -> None:
    content = record_file().read_bytes()
    run_id = rig.run("self_calibrate")
    assert rig.call("cancel").success
    assert rig.wait_end(run_id) == "cancelled"
    untouched(rig, previous, content)
    assert rig.gyro_command == MISSION


def instant_recordings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs whose recordings take no time; only what comes after them is looked at."""
    real = recording_run.run_plan

    def short(instrument, plan, **options):  # type: ignore[no-untyped-def]
        return real(instrument, replace(plan, steps=(replace(plan.steps[0], duration_s=1.0),)), **options)

    monkeypatch.setattr(recording_run, "run_plan", short)


def test_cancel_while_estimating(rig: Rig, previous: CalibrationRecord, monkeypatch: pytest.MonkeyPatch) -> None:
    content = record_file().read_bytes()
    instant_recordings(monkeypatch)
    estimating, go = threading.Event(), threading.Event()

    def slow(campaign, on_progress, **_):  # type: ignore[no-untyped-def]
        estimating.set()
        go.wait(30.0)
        on_progress(0.5)
        raise AssertionError("the estimate must not go on")

    monkeypatch.setattr(calibration_runs, "calibrate", slow)
    run_id = rig.run("run_sideband")
    assert estimating.wait(30.0)
    rig.wait_value("state", "estimating")
    assert rig.call("cancel").success
    go.set()
    assert rig.wait_end(run_id) == "cancelled"
    untouched(rig, previous, content)


def test_a_second_run_is_refused_and_the_first_goes_on(rig: Rig, previous: CalibrationRecord) -> None:
    content = record_file().read_bytes()
    first = rig.run("self_calibrate")
    for name in ("self_calibrate", "run_sideband", "revert"):
        response = rig.call(name)
        assert not response.success
        assert first in response.message
    assert rig.values["run"] == first
    assert rig.values["state"] in ("accepted", "running")
    rig.call("cancel")
    assert rig.wait_end(first) == "cancelled"
    untouched(rig, previous, content)


def test_a_refused_estimate_keeps_the_previous_calibration(ros: RosSession) -> None:
    simulator = PlainSimulator()
    del simulator.factory["angular_gain_kappa"]
    previous = store_record("plain-0001")
    content = record_file("plain-0001").read_bytes()
    rig = Rig(ros, ros.add(FakeGyro(simulator, realtime_factor=0.0, max_realtime_factor=150.0)))
    assert rig.wait_end(rig.run("run_sideband")) == "failed"
    assert "angular_gain_kappa" in rig.text
    assert "take it from the factory" in rig.text
    untouched(rig, previous, content)


def test_a_save_that_fails_ends_the_run_and_nothing_changes(rig: Rig, previous: CalibrationRecord) -> None:
    content = record_file().read_bytes()
    # where previous versions go there is a file: the store cannot keep the present record, so it must not replace it
    versions = RecordStore(None, DEVICE).previous_directory
    for entry in versions.iterdir():
        entry.unlink()
    versions.rmdir()
    versions.write_text("in the way")
    assert rig.wait_end(rig.run("self_calibrate")) == "failed"
    assert "must be writable" in rig.text
    assert "the previous record is untouched" in rig.text
    untouched(rig, previous, content)


def test_an_unexpected_device_is_refused_and_the_expected_ones_calibration_stays(ros: RosSession, previous: CalibrationRecord) -> None:
    content = record_file().read_bytes()
    rig = Rig(ros, ros.add(FakeGyro(PlainSimulator())), wait=False, device_id=DEVICE)
    rig.wait_text(f"must be device '{DEVICE}', but is 'plain-0001'")
    response = rig.call("self_calibrate")
    assert not response.success
    assert "Connect the right one or correct the parameter device_id" in response.message
    wait_for(lambda: not rig.calibrated, 10.0, "not calibrated for this gyro")
    rig.wait_record(previous)
    assert record_file().read_bytes() == content
    assert rig.self_test()["device"].level == b"\x02"


def test_another_gyro_after_the_run_gets_its_own_calibration(rig: Rig, previous: CalibrationRecord) -> None:
    other = store_record("ring_15k-0099")
    rig.gyro.become("ring_15k-0099")
    rig.wait_value("calibration", other.record_id)
    rig.wait_value("device_id", "ring_15k-0099")
    wait_for(lambda: rig.calibrated, 10.0, "is_calibrated")
    assert RecordStore(None, DEVICE).load() == previous


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        pytest.param(lambda data: data[: len(data) // 2], "torn", id="torn"),
        pytest.param(lambda data: data.replace(b"ring_15k-0007", b"ring_15k-0008"), "torn or was edited", id="edited"),
        pytest.param(lambda data: b"\x00" * 200, "torn", id="zeros"),
        pytest.param(lambda data: b"a: stranger's file\n", "another program's file", id="foreign format"),
    ],
)
def test_a_damaged_record_is_refused_and_the_last_good_one_used(
    ros: RosSession, previous: CalibrationRecord, damage: Callable[[bytes], bytes], reason: str
) -> None:
    newer = store_record(created_utc="2026-03-02T12:00:00Z")
    path = record_file()
    damaged = damage(path.read_bytes())
    path.write_bytes(damaged)
    rig = Rig(ros)
    rig.wait_value("calibration", previous.record_id)
    assert newer.record_id != previous.record_id
    assert reason in rig.text
    assert f"The last good record, {previous.record_id}, is used instead" in rig.text
    assert path.read_bytes() == damaged, "the evidence stays until the next save"
    checks = rig.self_test()
    assert checks["record"].level == b"\x02"
    assert checks["passed"] == b"\x00"


def test_a_damaged_record_without_a_previous_one_leaves_the_gyro_uncalibrated(ros: RosSession, previous: CalibrationRecord) -> None:
    record_file().write_bytes(b"half a rec")
    rig = Rig(ros)
    rig.wait_text("Call self_calibrate")
    wait_for(lambda: "torn" in rig.calibration.wait()[-1].status[0].message, 10.0, "the reason on ~/calibration")
    assert rig.published_record is None
    assert not rig.calibrated
    assert rig.bias.messages == []


def test_a_record_of_another_device_is_refused(ros: RosSession, tmp_path: Path) -> None:
    path = tmp_path / "shared.yaml"
    RecordStore(path, "ring_15k-0001").save(store_record("ring_15k-0001"))
    content = path.read_bytes()
    rig = Rig(ros, record_url=f"file://{path}")
    rig.wait_text(f"must belong to device '{DEVICE}', but got a record of 'ring_15k-0001'")
    assert rig.published_record is None
    assert not rig.calibrated
    assert path.read_bytes() == content


def test_two_calibration_nodes_on_one_gyro_are_refused(ros: RosSession, rig: Rig) -> None:
    second = ros.add(CalibrationNode())
    own = ("gyro_calibration", "/")
    wait_for(lambda: rig.calibrator.get_node_names_and_namespaces().count(own) == 2, 10.0, "both nodes")
    response = rig.call("self_calibrate")
    assert not response.success
    assert "but 2 are named /gyro_calibration" in response.message
    assert not second._runs.busy
    assert not rig.calibrator._runs.busy


def test_two_gyros_on_one_topic_are_refused(ros: RosSession, rig: Rig) -> None:
    ros.node("second_gyro").create_publisher(Float64MultiArray, "/channels", SENSOR_PUB_QOS)
    wait_for(lambda: rig.calibrator.count_publishers("/channels") == 2, 10.0, "both publishers")
    response = rig.call("self_calibrate")
    assert not response.success
    assert "One gyro must publish /channels, but 2 do" in response.message


def test_a_gyro_process_that_dies_ends_the_run(ros: RosSession, previous: CalibrationRecord, spawn_node) -> None:  # type: ignore[no-untyped-def]
    content = record_file().read_bytes()
    gyro = spawn_node("gyro_sim_node", parameters={"fidelity": "slow_flow", "seed": 7, "realtime_factor": 20.0})
    client = CalibrationClient(ros)
    ros.add(CalibrationNode(parameter_overrides=overrides({"plan_quality": "quick", "stream_timeout_s": 1.5})))
    client.wait_ready()
    run_id = client.run("self_calibrate")
    client.wait_value("state", "running")
    gyro.kill()
    assert client.wait_end(run_id) == "failed"
    assert "Check that" in client.text
    assert "The gyro may not be back in its mission command" in client.text
    untouched(client, previous, content)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda n: n.name)
def test_a_signal_during_a_run_puts_the_gyro_back_and_exits_cleanly(
    ros: RosSession, previous: CalibrationRecord, spawn_node, number: signal.Signals
) -> None:  # type: ignore[no-untyped-def]
    content = record_file().read_bytes()
    gyro = ros.add(FakeGyro(make_simulator, fidelity="slow_flow", seed=7, realtime_factor=20.0))
    process = spawn_node("calibration_node", parameters={"plan_quality": "quick"})
    client = CalibrationClient(ros)
    client.wait_ready()
    run_id = client.run("self_calibrate")
    wait_for(lambda: gyro._sim.command.mode == "loops_off", 30.0, "loops off")
    process.signal(number)
    process.signal(number)  # a launcher and the terminal both send one
    assert process.wait_exit() == 0, str(process)
    assert gyro._sim.command == MISSION
    assert f"run {run_id} cancelled: cancelled: the calibration node is shutting down" in process.output
    assert "may not be back" not in process.output
    assert "Traceback" not in process.output
    assert record_file().read_bytes() == content


KILLED_WHILE_SAVING = '''
"""The calibration node, killed as by a power cut at the moment when the new record is to replace the old one."""
import os, signal
from gyro_calib.calibration import files, store
real = os.replace

def cut(source, target):
    if str(target).endswith("ring_15k-0007.yaml") and ".previous" not in str(target):
        os.kill(os.getpid(), signal.SIGKILL)
    real(source, target)

files.os.replace = cut
from gyro_calib.nodes.calibration_node import main
main()
'''


def test_a_node_killed_while_saving_leaves_the_previous_calibration(
    ros: RosSession, previous: CalibrationRecord, spawn_node, tmp_path: Path
) -> None:  # type: ignore[no-untyped-def]
    content = record_file().read_bytes()
    package = tmp_path / "crash"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "node.py").write_text(KILLED_WHILE_SAVING)
    ros.add(FakeGyro(make_simulator, fidelity="slow_flow", seed=7, realtime_factor=40.0))
    process = spawn_node("crash.node", parameters={"plan_quality": "quick"})
    client = CalibrationClient(ros)
    client.wait_ready()
    client.run("self_calibrate")
    assert process.wait_exit() == -signal.SIGKILL, str(process)
    assert record_file().read_bytes() == content
    assert any(entry.name.endswith("-tmp") for entry in os.scandir(record_file().parent)), "it died in the middle of the save"
    # and the next node takes it up
    client.status.messages.clear()
    ros.add(CalibrationNode())
    client.wait_value("calibration", previous.record_id)
    assert RecordStore(None, DEVICE).load() == previous
