"""Peers that die by kill -9, hang, and come back; company that a calibration node must not have: all nodes are processes of their own."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from calibration_rig import DEVICE, CalibrationClient, record_file, store_record
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from ros_helpers import NodeProcess, RosSession, wait_for
from ros_isolation import discovery_profile
from sensor_msgs.msg import Imu

from gyro_calib.calibration import RecordStore
from gyro_calib.device import draw_unit, load_device
from gyro_calib.nodes.runtime import LATCHED_QOS
from gyro_calib.recording.command import Command
from gyro_calib.simulation.truth import truth_of
from gyro_calib.units import deg_h, ppm

pytestmark = pytest.mark.ros

GYRO = {"fidelity": "slow_flow", "seed": 7, "realtime_factor": 40.0}
CALIBRATION = {"plan_quality": "quick", "stream_timeout_s": 1.5}


def right(record: Any) -> None:
    """A record is that of unit 7, within five of its standard deviations."""
    truth = truth_of(draw_unit(load_device("ring_15k"), 7), Command(), 0.0)
    assert abs(record.bias.value - truth.bias_rad_s) < 5.0 * record.bias.sd
    assert deg_h(record.bias.sd) < 10.0
    assert abs(ppm(record.scale_factor.value / truth.scale_factor - 1.0)) < 5.0 * ppm(record.scale_factor.sd)


def gyro_mode(client: CalibrationClient) -> str:
    """What the gyro's driver says of its mode."""
    future = AsyncParameterClient(client.node, "gyro_sim").get_parameters(["mode"])
    wait_for(future.done, 20.0, "the gyro's mode")
    return str(future.result().values[0].string_value)


def stays(client: CalibrationClient, previous: Any, content: bytes) -> None:
    """The calibration from before is in force and on disk, byte for byte."""
    client.wait_value("calibration", previous.record_id)
    client.wait_record(previous)
    assert record_file().read_bytes() == content


def test_gyro_and_calibration_are_killed_in_turn_and_come_back(
    ros: RosSession, spawn_node: Callable[..., NodeProcess], tmp_path: Path
) -> None:
    """Each dies in the middle of a run; after each, the last calibration is in force; in the end a run succeeds without anybody's help."""
    previous = store_record()
    content = record_file().read_bytes()
    client = CalibrationClient(ros)
    profile = tmp_path / "short_lease.xml"
    profile.write_text(discovery_profile(lease_s=5))
    soon_forgotten = {"FASTDDS_DEFAULT_PROFILES_FILE": str(profile), "FASTRTPS_DEFAULT_PROFILES_FILE": str(profile)}

    def forgotten(name: str) -> None:
        """Whoever died still counts as company until discovery forgets it."""
        wait_for(lambda: client.node.get_node_names().count(name) == 1, 60.0, f"the dead {name} forgotten")

    gyro = spawn_node("gyro_sim_node", parameters=GYRO, environment=soon_forgotten)
    node = spawn_node("calibration_node", parameters=CALIBRATION, environment=soon_forgotten)
    client.wait_ready()

    # the gyro dies: the run fails and says so
    run_id = client.run()
    client.wait_value("state", "running")
    gyro.kill()
    assert client.wait_end(run_id) == "failed"
    assert "Check that" in client.text
    assert f"Calibration {previous.record_id} stays in force" in client.text
    stays(client, previous, content)
    spawn_node("gyro_sim_node", parameters=GYRO)
    forgotten("gyro_sim")
    client.wait_value("stream", "alive")

    # the calibration node dies and leaves the gyro in the middle of an experiment: its successor says that, with the record in force
    wait_for(lambda: client.call("self_calibrate").success, 30.0, "a run with the new gyro")
    wait_for(lambda: gyro_mode(client) == "loops_off", 30.0, "loops off")
    node.kill()
    client.status.messages.clear()
    client.calibration.messages.clear()
    spawn_node("calibration_node", parameters=CALIBRATION)
    client.wait_text("The gyro is left in loops_off", 60.0)
    stays(client, previous, content)
    forgotten("gyro_calibration")
    run_id = client.run()
    assert client.wait_end(run_id) == "done", client.text
    assert gyro_mode(client) == "ftr_x"
    record = RecordStore(None, DEVICE).load()
    assert record.record_id != previous.record_id
    right(record)


def test_a_gyro_that_hangs_and_comes_back(ros: RosSession, spawn_node: Callable[..., NodeProcess], ros_environment: Path) -> None:
    """SIGSTOP is a cable that is pulled: no more messages, no goodbye. Run and rate end with a reason, and go on when it is back."""
    previous = store_record()
    content = record_file().read_bytes()
    client = CalibrationClient(ros)
    imu = ros.listen(client.node, Imu, "imu/data_raw")
    status = ros.listen(client.node, DiagnosticStatus, "imu_corrector/status", LATCHED_QOS)
    gyro = spawn_node("gyro_sim_node", parameters=GYRO)
    spawn_node("calibration_node", parameters=CALIBRATION)
    spawn_node("imu_corrector_node", parameters={"stream_timeout_s": 1.0})
    client.wait_ready()
    imu.wait(10)
    run_id = client.run("run_sideband")
    client.wait_value("state", "running")
    gyro.signal(signal.SIGSTOP)
    try:
        assert client.wait_end(run_id) == "failed"
        # in a recording, or in the command before it
        assert "must deliver blocks, but none came for 1.5 s" in client.text or "Gyro must answer" in client.text
        assert "Check that" in client.text
        stays(client, previous, content)
        wait_for(lambda: "No rate on /rate_raw for more than 1 s" in status.messages[-1].message, 20.0, "the corrector's error")
    finally:
        gyro.signal(signal.SIGCONT)
    client.wait_value("stream", "alive")
    before = len(imu.messages)
    wait_for(lambda: len(imu.messages) > before + 20, 30.0, "rates again")
    wait_for(lambda: client.call("run_sideband").success, 30.0, "a run is accepted again")
    client.call("cancel")


@pytest.mark.parametrize("known", [True, False], ids=["known to each other", "both at once"])
def test_two_calibration_nodes_of_different_names(
    ros: RosSession, spawn_node: Callable[..., NodeProcess], known: bool, ros_environment: Path
) -> None:
    """Neither begins beside the other; and if both began before they could know, no wrong calibration comes of it."""
    previous = store_record()
    content = record_file().read_bytes()
    spawn_node("gyro_sim_node", parameters=GYRO)
    clients = []
    for name in ("gyro_calibration", "another"):
        spawn_node("calibration_node" if known else "blind.node", parameters=CALIBRATION, remap={"__node": name})
        clients.append(CalibrationClient(ros, name=name))
    for client in clients:
        client.wait_ready()
    if known:
        for client, other in zip(clients, ("another", "gyro_calibration"), strict=True):
            wait_for(lambda c=client: not c.call("self_calibrate").success, 20.0, "the other is known")
            assert f"One node must calibrate a gyro, but /{other} can too" in client.call("self_calibrate").message
        for client in clients:
            client.call("cancel")
            stays(client, previous, content)
        return
    runs = [client.run() for client in clients]
    ends = [client.wait_end(run) for client, run in zip(clients, runs, strict=True)]
    assert "failed" in ends
    for client, end in zip(clients, ends, strict=True):
        if end == "failed":
            assert "Somebody else commands the gyro" in client.text or "Segment must stay" in client.text
    found = RecordStore(None, DEVICE).load()
    if "done" in ends:
        right(found)
    else:
        assert record_file().read_bytes() == content
    wait_for(lambda: gyro_mode(clients[0]) == "ftr_x", 20.0, "the gyro back in its mission")


BLIND = """
from gyro_calib.nodes import calibration_node
calibration_node.refuse_company = lambda node, channels: None
calibration_node.main()
"""


@pytest.fixture(autouse=True)
def _blind_node(tmp_path: Path) -> None:
    """A calibration node that discovery has told nothing yet."""
    (tmp_path / "blind").mkdir()
    (tmp_path / "blind" / "__init__.py").write_text("")
    (tmp_path / "blind" / "node.py").write_text(BLIND)


@pytest.mark.slow
def test_parameters_changed_during_a_run_count_for_the_next(ros: RosSession, spawn_node: Callable[..., NodeProcess]) -> None:
    """Those of the calibration node; a run goes on as it began, and is stored as it was said when it began."""
    previous = store_record()
    spawn_node("gyro_sim_node", parameters=GYRO)
    spawn_node("calibration_node", parameters=CALIBRATION)
    client = CalibrationClient(ros)
    client.wait_ready()
    run_id = client.run()
    client.wait_value("state", "running")
    setter = AsyncParameterClient(client.node, "gyro_calibration")
    changes = {"plan_quality": "fine", "temperature_limit_k": 0.01, "base_rate_limit_rad_s": 1e-6, "autosave": False}
    future = setter.set_parameters([Parameter(name, value=value) for name, value in changes.items()])
    wait_for(future.done, 20.0, "the parameters")
    assert all(result.successful for result in future.result().results)
    assert client.wait_end(run_id) == "done", client.text
    assert client.values["saved"] == "True"
    record = RecordStore(None, DEVICE).load()
    assert record.record_id == client.values["calibration"] != previous.record_id
    right(record)
    run_id = client.run()
    assert client.wait_end(run_id) == "failed"
    assert "must stay within" in client.text
