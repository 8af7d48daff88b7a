"""What a launch system and an operator do to the nodes: any order of start and stop, late joiners, remaps, signals at bad moments."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from calibration_samples import make_record

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TwistStamped, TwistWithCovarianceStamped, Vector3Stamped
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, ListParameters
from ros_helpers import FakeGyro, NodeProcess, RosSession, wait_for
from ros_processes import ROOT
from sensor_msgs.msg import Imu
from std_msgs.msg import Bool, Float64MultiArray

from gyro_calib.calibration import RecordStore
from gyro_calib.nodes.calibration_messages import record_from_calibration
from gyro_calib.nodes.calibration_node import CalibrationNode
from gyro_calib.nodes.imu_corrector_node import ImuCorrector
from gyro_calib.nodes.runtime import LATCHED_QOS

pytestmark = pytest.mark.ros

RECORD = make_record(validity={})
#: started with these, in any order; the gyro is the clock of the others
PARAMETERS: dict[str, dict[str, Any]] = {
    "gyro_sim_node": {"fidelity": "slow_flow", "seed": 7, "realtime_factor": 5.0},
    "calibration_node": {"use_sim_time": True},
    # no file: the record has to come from the calibration node
    "imu_corrector_node": {"use_sim_time": True, "record_urls": ["none"], "frame_id": "imu_link"},
}
NAMES = {"gyro_sim_node": "gyro_sim", "calibration_node": "gyro_calibration", "imu_corrector_node": "imu_corrector"}
LATCHED = {
    "gyro_calibration/status": DiagnosticStatus,
    "gyro_calibration/bias": TwistWithCovarianceStamped,
    "gyro_calibration/scale_factor": Vector3Stamped,
    "gyro_calibration/compensation": Float64MultiArray,
    "gyro_calibration/is_calibrated": Bool,
    "gyro_calibration/calibration": DiagnosticArray,
    "imu_corrector/status": DiagnosticStatus,
}


@pytest.fixture
def start(spawn_node: Callable[..., Any]) -> Callable[[str], NodeProcess]:
    """Function: one of the nodes as a process in /robot/front, its rates and its Imu remapped."""
    RecordStore(None, RECORD.device_id).save(RECORD)

    def begin(name: str) -> NodeProcess:
        remap = {"imu/data_raw": "/robot/imu/front", "rate_raw": "rate/front"}
        return spawn_node(name, namespace="/robot/front", parameters=PARAMETERS[name], remap=remap)

    return begin


def is_corrected(message: Any, raw: Any) -> bool:
    """Whether an Imu is the raw rate of its own stamp, corrected by :data:`RECORD`."""
    rate = (raw.twist.angular.z - RECORD.bias.value) / RECORD.scale_factor.value
    return abs(message.angular_velocity.z - rate) < 1e-12


@pytest.mark.parametrize(
    ("starts", "stops"),
    [
        (["imu_corrector_node", "calibration_node", "gyro_sim_node"], ["gyro_sim_node", "calibration_node", "imu_corrector_node"]),
        (["calibration_node", "gyro_sim_node", "imu_corrector_node"], ["calibration_node", "imu_corrector_node", "gyro_sim_node"]),
    ],
    ids=["corrector first", "corrector last"],
)
def test_any_order_of_start_and_stop(ros: RosSession, start: Callable[[str], NodeProcess], starts: list[str], stops: list[str]) -> None:
    node = ros.node(namespace="/robot/front")
    imu = ros.listen(node, Imu, "/robot/imu/front")
    raw = ros.listen(node, TwistStamped, "rate/front")
    processes = {}
    for name in starts:
        processes[name] = start(name)
        # each is there before the next one comes, or the order would be left to chance
        wait_for(lambda name=name: (NAMES[name], "/robot/front") in node.get_node_names_and_namespaces(), 60.0, name)

    def corrected() -> bool:
        stamps = {(m.header.stamp.sec, m.header.stamp.nanosec): m for m in list(raw.messages)[-200:]}
        pairs = [(m, stamps.get((m.header.stamp.sec, m.header.stamp.nanosec))) for m in list(imu.messages)[-50:]]
        return sum(other is not None and is_corrected(m, other) for m, other in pairs) >= 20

    wait_for(corrected, 60.0, "corrected rates")
    assert imu.messages[-1].header.frame_id == "imu_link"
    late = {topic: ros.listen(node, kind, topic, LATCHED_QOS) for topic, kind in LATCHED.items()}
    for listener in late.values():
        listener.wait(1, 30.0)
    assert held_record(late["gyro_calibration/calibration"].messages[-1]) == RECORD.record_id
    assert late["gyro_calibration/bias"].messages[-1].twist.twist.angular.z == pytest.approx(RECORD.bias.value)
    assert late["gyro_calibration/is_calibrated"].messages[-1].data
    for name in stops:
        assert processes[name].stop(), processes[name]
        assert processes[name].wait_exit(1.0) == 0
        complaints = re.findall(r".*(?:FATAL|\[ERROR\]|Traceback).*", processes[name].output)
        # who is left may say that its gyro is gone
        assert [line for line in complaints if "is the gyro running?" not in line] == []


def held_record(message: Any) -> str:
    record = record_from_calibration(message)
    assert record is not None
    return record.record_id


def test_nodes_that_are_restarted_find_their_way_back(ros: RosSession, start: Callable[[str], NodeProcess]) -> None:
    """First the corrector, then the calibration, then the gyro is killed and started again; the others stay."""
    node = ros.node(namespace="/robot/front")
    imu = ros.listen(node, Imu, "/robot/imu/front")
    status = ros.listen(node, DiagnosticStatus, "imu_corrector/status", LATCHED_QOS)
    processes = {name: start(name) for name in PARAMETERS}

    def well() -> bool:
        last = status.messages[-1] if status.messages else DiagnosticStatus(level=DiagnosticStatus.STALE)
        return last.level == DiagnosticStatus.OK and RECORD.record_id in last.message

    for name in (None, "imu_corrector_node", "calibration_node", "gyro_sim_node"):
        if name is not None:
            processes[name].kill()
            status.messages.clear()
            processes[name] = start(name)
        wait_for(well, 90.0, f"the corrector's good status after {name}: {[m.message for m in status.messages[-1:]]}")
        imu.wait(len(imu.messages) + 50, 60.0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
def test_a_signal_inside_a_callback_is_no_fatal_error(ros_environment: Path, number: int) -> None:
    """It falls between a callback and its publish: the publish still happens, then the node ends."""
    script = f"""
import os, sys, time
from rclpy.node import Node
from std_msgs.msg import Bool
from gyro_calib.nodes.runtime import run_node

class Interrupted(Node):
    def __init__(self):
        super().__init__("interrupted")
        self.publisher = self.create_publisher(Bool, "alive", 10)
        self.timer = self.create_timer(0.05, self.tick)

    def tick(self):
        self.timer.cancel()
        os.kill(os.getpid(), {int(number)})
        time.sleep(0.2)
        self.publisher.publish(Bool(data=True))
        print("published", flush=True)

sys.exit(run_node(Interrupted, []))
"""
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, timeout=60.0, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "published\n", "")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
def test_a_corrector_at_full_rate_ends_without_a_word(ros: RosSession, spawn_node: Callable[..., Any], number: int) -> None:
    node = ros.node(namespace="/busy")
    publisher = node.create_publisher(TwistStamped, "rate_raw", 10)
    imu = ros.listen(node, Imu, "imu/data_raw")
    corrector = spawn_node("imu_corrector_node", namespace="/busy")
    wait_for(lambda: publisher.get_subscription_count() and imu.connected, 60.0, "discovery")
    message, sent, quiet_after = TwistStamped(), 0, 0
    while corrector.running:
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(1_000_000_000_000 + 1_000_000 * sent, 1_000_000_000)
        publisher.publish(message)
        sent += 1
        if not quiet_after and len(imu.messages) > 200:
            corrector.signal(number)
            quiet_after = sent
        assert sent < 500_000
    assert corrector.wait_exit(1.0) == 0
    assert "FATAL" not in corrector.output
    assert "Traceback" not in corrector.output


@pytest.mark.parametrize("kind", [FakeGyro, CalibrationNode, ImuCorrector], ids=["gyro_sim", "gyro_calibration", "imu_corrector"])
def test_every_number_has_a_range_and_every_parameter_says_what_it_is(ros: RosSession, kind: Any) -> None:
    node = ros.node()
    target = ros.add(kind()).get_name()
    names = ros.call(node, ListParameters, f"{target}/list_parameters").result.names
    own = [n for n in names if not n.startswith(("use_sim_time", "qos_overrides", "start_type_description_service"))]
    assert len(own) > 10
    descriptors = ros.call(node, DescribeParameters, f"{target}/describe_parameters", DescribeParameters.Request(names=own)).descriptors
    for found in descriptors:
        assert len(found.description) > 15, found.name
        if found.type == ParameterType.PARAMETER_DOUBLE:
            assert re.search(r"\[\S[^\]]*\]", found.description), f"{found.name} has no unit"
            # what the unit itself says of its hardware is a fact, not a setting
            assert found.floating_point_range or found.name == "sample_rate_hz", found.name
        if found.type == ParameterType.PARAMETER_INTEGER:
            assert found.integer_range, found.name


def test_y_is_an_axis_in_a_parameter_file_too(ros: RosSession) -> None:
    """ROS reads a bare y as a boolean."""
    assert ros.add(FakeGyro(gyro_axis=True))._settings.gyro_axis == "y"
