"""gyro_sim: topics and parameters of a gyro's driver; the node's logic in this process, the real simulator in one of its own."""

from __future__ import annotations

import json
import re
import signal
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from geometry_msgs.msg import TwistStamped
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParametersAtomically
from rclpy.exceptions import InvalidParameterValueException
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from ros_helpers import FakeGyro, PlainSimulator, RosSession, overrides, wait_for
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Temperature
from std_msgs.msg import Float64MultiArray

from gyro_calib.device import draw_unit, load_device
from gyro_calib.errors import DataError, GyroCalibError
from gyro_calib.nodes.blocks import block_columns, rows_from_block
from gyro_calib.nodes.command_parameters import COMMAND_NAMES, CommandLimits, check_command
from gyro_calib.nodes.gyro_sim_node import GyroSimNode, make_simulator
from gyro_calib.nodes.ros_instrument import RosInstrument
from gyro_calib.nodes.runtime import SENSOR_PUB_QOS
from gyro_calib.recording.columns import COLUMNS
from gyro_calib.recording.command import Command, Excitation, Setpoints
from gyro_calib.simulation import GyroSimulator

pytestmark = pytest.mark.ros


def seconds(stamp: Any) -> float:
    return stamp.sec + 1e-9 * stamp.nanosec


def mean_rate(messages: list[Any]) -> float:
    return float(np.mean([m.twist.angular.z for m in messages]))


def set_atomically(ros: RosSession, node: Any, gyro: str, **values: Any) -> Any:
    parameters = [Parameter(name.replace("__", "."), value=value).to_parameter_msg() for name, value in values.items()]
    request = SetParametersAtomically.Request(parameters=parameters)
    return ros.call(node, SetParametersAtomically, f"{gyro}/set_parameters_atomically", request).result


def twist(rate_rad_s: float, stamp: Any = None, axis: str = "z") -> TwistStamped:
    message = TwistStamped()
    setattr(message.twist.angular, axis, rate_rad_s)
    if stamp is not None:
        message.header.stamp = stamp
    return message


# -- in this process: the node's logic, on the simplest gyro -----------------------------------------------------------------------


def test_topics_have_the_contract_s_names_types_and_qos(ros: RosSession) -> None:
    ros.add(FakeGyro(namespace="/robot/left", frame_id="left_gyro"))
    node = ros.node()
    for topic, kind in (
        ("channels", "std_msgs/msg/Float64MultiArray"),
        ("rate_raw", "geometry_msgs/msg/TwistStamped"),
        ("temperature", "sensor_msgs/msg/Temperature"),
    ):
        (info,) = wait_for(lambda topic=topic: node.get_publishers_info_by_topic(f"/robot/left/{topic}"), what=topic)
        assert (info.node_name, info.topic_type) == ("gyro_sim", kind)
        assert info.qos_profile.reliability == ReliabilityPolicy.RELIABLE
        assert info.qos_profile.durability == DurabilityPolicy.VOLATILE
    (info,) = wait_for(lambda: node.get_subscriptions_info_by_topic("/robot/left/true_rate"), what="true_rate")
    assert info.topic_type == "geometry_msgs/msg/TwistStamped"
    assert info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    rate = ros.listen(node, TwistStamped, "/robot/left/rate_raw").wait()[0]
    temperature = ros.listen(node, Temperature, "/robot/left/temperature").wait()[0]
    assert rate.header.frame_id == temperature.header.frame_id == "left_gyro"
    assert temperature.temperature == 25.0


def test_blocks_follow_each_other_and_stamps_are_device_time_on_the_clock(ros: RosSession) -> None:
    node = ros.node()
    channels, clock, rates = (
        ros.listen(node, k, t) for k, t in ((Float64MultiArray, "channels"), (Clock, "/clock"), (TwistStamped, "rate_raw"))
    )
    gyro = ros.add(FakeGyro(clock_epoch_s=7.0, rate_raw_hz=50.0, constant_rate_rad_s=0.25))
    blocks = [rows_from_block(m) for m in channels.wait(12)]
    assert block_columns(channels.messages[0]) == COLUMNS
    assert {len(b) for b in blocks} == {50}
    t = np.concatenate(blocks)[:, 0]
    np.testing.assert_allclose(np.diff(t), 0.002, atol=1e-9)
    ticks = [seconds(m.clock) for m in clock.messages]
    np.testing.assert_allclose(np.diff(ticks), 0.1, atol=1e-9)
    # a rate is the mean of ten rows, stamped at their middle
    assert rates.wait(50)
    stamps = np.array([seconds(m.header.stamp) for m in rates.messages])
    np.testing.assert_allclose(np.diff(stamps), 0.02, atol=1e-9)
    np.testing.assert_allclose((stamps[0] - 7.0 - 0.011) / 0.02, round((stamps[0] - 7.0 - 0.011) / 0.02), atol=1e-6)
    assert mean_rate(rates.messages) == pytest.approx(0.25 + 2e-3, abs=1e-5)
    assert gyro._sim.time_s + 7.0 >= ticks[-1] - 1e-9


def test_one_atomic_set_is_one_segment(ros: RosSession) -> None:
    gyro = ros.add(FakeGyro())
    node = ros.node()
    channels = ros.listen(node, Float64MultiArray, "channels")
    channels.wait()
    command = Command("ftr_y", Excitation("amplitude_modulation", 0.7, 0.05))
    request = {name.replace(".", "__"): value for name, value in command.to_parameters().items()}
    assert set_atomically(ros, node, "gyro_sim", **request).successful
    wait_for(lambda: gyro._sim.command == command, what="the command")
    # the same once more is a new segment too: whoever waits for it is not left waiting
    assert set_atomically(ros, node, "gyro_sim", **request).successful
    assert set_atomically(ros, node, "gyro_sim", constant_rate_rad_s=0.1).successful
    wait_for(lambda: rows_from_block(channels.messages[-1])[-1, 1] == 2.0, what="segment 2")
    segments = np.concatenate([rows_from_block(m) for m in channels.messages])[:, 1]
    assert set(np.diff(segments)) == {0.0, 1.0}
    assert segments[-1] == 2.0


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"mode": "spin"}, "must be one of ftr_x, .*but got 'spin'"),
        ({"mode": "whole_angle"}, "Parameter mode must be one of ftr_x, ftr_y, loops_off, but got 'whole_angle'"),
        ({"excitation__kind": "shout"}, "must be one of none, amplitude_modulation"),
        ({"excitation__index": 1.5}, "out of range Min: 0.0, Max: 1.0"),
        ({"excitation__frequency_hz": -1.0}, "out of range Min: 0.0"),
        ({"excitation__frequency_hz": float("nan")}, "out of range .*value: nan"),
        ({"compensation": [1.0, float("nan"), 0.0, 1.0]}, "must be 4 finite numbers"),
        ({"excitation__kind": "amplitude_modulation", "excitation__frequency_hz": 300.0}, "must be in 0 to 250 Hz"),
        ({"excitation__kind": "drive", "excitation__volts": 1.0}, "mode must be loops_off .*one atomic call"),
        ({"excitation__kind": "frequency_modulation", "mode": "loops_off"}, "one with a closed loop .*but got 'loops_off'"),
        ({"excitation__axis": "z"}, "must be 'x', 'y' or 'both'"),
        ({"setpoint__amplitude_v": 0.0}, "out of range Min: 0.001, Max: 2.5"),
        ({"excitation__volts": 6.0}, "out of range Min: 0.0, Max: 5.0"),
        ({"compensation": [1.0, 0.0, 0.0]}, "must be 4 finite numbers"),
        ({"compensation": [1.0, 0.0, 0.0, 3.0]}, "elements in -2 to 2"),
        ({"device_id": "mine"}, "read-only"),
        ({"constant_rate_rad_s": 1e3}, "out of range Min: -100"),
        ({"mode": "ftr_y", "excitation__index": 2.0}, "out of range"),
    ],
)
def test_a_bad_value_is_refused_with_its_range_and_nothing_changes(ros: RosSession, values: dict[str, Any], reason: str) -> None:
    gyro = ros.add(FakeGyro())
    before = gyro.get_parameters(list(COMMAND_NAMES))
    result = gyro.set_parameters_atomically([Parameter(name.replace("__", "."), value=value) for name, value in values.items()])
    assert not result.successful
    assert re.search(reason, result.reason), result.reason
    assert [p.value for p in gyro.get_parameters(list(COMMAND_NAMES))] == [p.value for p in before]
    assert gyro._commands.empty()
    assert gyro._sim._segment == 0


@pytest.mark.parametrize(
    ("command", "text"),
    [
        (Command("ring_up"), r"amplitude_gain_v_per_v must be > 0 in mode ring_up, but got 0\.0"),
        (Command("ring_down", setpoints=Setpoints(amplitude_gain_v_per_v=1.0)), r"must be <= 0 in mode ring_down, but got 1\.0"),
        (Command("whole_angle", Excitation("amplitude_modulation", 1.0, 0.1)), "kind must be none in mode whole_angle"),
    ],
)
def test_a_free_wave_is_not_told_what_its_loops_cannot_do(command: Command, text: str) -> None:
    limits = CommandLimits(("whole_angle", "ring_down", "ring_up"), 5.0, 2.5, 1e4, 50.0)
    check_command(Command("ring_down"), limits)
    with pytest.raises(DataError, match=text):
        check_command(command, limits)


def test_every_parameter_says_what_it_is_and_in_which_unit(ros: RosSession) -> None:
    gyro = FakeGyro()
    ros.add(gyro)
    own = [n for n in gyro._parameters if n not in ("use_sim_time", "start_type_description_service")]
    assert set(COMMAND_NAMES) | {"device", "seed", "device_id", "factory", "sample_rate_hz"} <= set(own)
    response = ros.call(ros.node(), DescribeParameters, "gyro_sim/describe_parameters", DescribeParameters.Request(names=own))
    for descriptor in response.descriptors:
        assert len(descriptor.description) > 15, descriptor.name
        if descriptor.type == Parameter.Type.DOUBLE.value:
            assert "[" in descriptor.description, descriptor.name
            assert descriptor.read_only or descriptor.floating_point_range, descriptor.name
    values = ros.call(
        ros.node("other"), GetParameters, "gyro_sim/get_parameters", GetParameters.Request(names=["factory", "sample_rate_hz"])
    ).values
    assert json.loads(values[0].string_value) == PlainSimulator().factory
    assert values[1].double_value == 500.0


def test_a_command_of_the_start_up_file_is_the_first_segment_and_facts_cannot_be_overridden(ros: RosSession) -> None:
    gyro = ros.add(FakeGyro(mode="ftr_y", device_id="mine", sample_rate_hz=1.0))
    wait_for(lambda: gyro._sim.command == Command("ftr_y"), what="the command")
    assert gyro._sim._segment == 1
    assert gyro.get_parameter("device_id").value == "plain-0001"
    assert gyro.get_parameter("sample_rate_hz").value == 500.0


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"mode": "spin"}, "Mode must be one of"),
        ({"gyro_axis": "w"}, "gyro_axis must be x, y or z, but got 'w'"),
        ({"use_sim_time": True}, "use_sim_time must be false for realtime_factor 20"),
        ({"fidelity": "guess"}, "fidelity must be 'carrier' or 'slow_flow', but got 'guess'"),
        ({"block_duration_s": 0.0}, "block_duration_s out of range Min: 0.001"),
    ],
)
def test_a_start_that_cannot_work_is_refused(ros: RosSession, parameters: dict[str, Any], text: str) -> None:
    with pytest.raises((GyroCalibError, InvalidParameterValueException), match=text):
        FakeGyro(make_simulator, **parameters)


def test_modes_without_a_rate_channel_publish_none(ros: RosSession) -> None:
    gyro = ros.add(FakeGyro())
    node = ros.node()
    channels, rates = ros.listen(node, Float64MultiArray, "channels"), ros.listen(node, TwistStamped, "rate_raw")
    rates.wait(20)
    gyro.set_parameters_atomically([Parameter("mode", value="loops_off"), Parameter("setpoint.amplitude_v", value=0.5)])
    wait_for(lambda: rows_from_block(channels.messages[-1])[0, 1] == 1.0, what="segment 1")
    time.sleep(0.2)
    count, blocks = len(rates.messages), len(channels.messages)
    channels.wait(blocks + 10)
    assert len(rates.messages) == count
    gyro.set_parameters([Parameter("mode", value="ftr_y")])
    rates.wait(count + 20)
    # at half the amplitude the volts per rate are half: firmware knows
    assert mean_rate(rates.messages[count:]) == pytest.approx(2e-3, abs=1e-5)


@pytest.mark.parametrize("axis", ["x", "z"])
def test_the_true_rate_is_felt_about_the_gyro_s_axis_until_the_next(ros: RosSession, axis: str) -> None:
    gyro = ros.add(FakeGyro(gyro_axis=axis, constant_rate_rad_s=0.01))
    node = ros.node()
    rates = ros.listen(node, TwistStamped, "rate_raw")
    publisher = node.create_publisher(TwistStamped, "true_rate", 10)
    wait_for(lambda: publisher.get_subscription_count() and rates.connected, what="discovery")

    def settled(rate: float) -> bool:
        return len(rates.messages) > 10 and abs(mean_rate(rates.messages[-10:]) - rate - 0.01 - 2e-3) < 1e-5

    publisher.publish(twist(0.5, axis=axis))
    wait_for(lambda: settled(0.5), what="0.5 rad/s")
    count = len(rates.messages)
    for bad in (float("nan"), float("inf"), 1e6):
        publisher.publish(twist(bad, axis=axis))
    rates.wait(count + 400)
    assert settled(0.5)
    assert max(m.twist.angular.z for m in rates.messages) < 0.6
    publisher.publish(twist(0.7, axis="y"))
    wait_for(lambda: settled(0.0), what="the other component")
    assert gyro.exit_code == 0


def test_a_true_rate_holds_from_its_stamp(ros: RosSession) -> None:
    """The base simulator is the clock; the gyro follows it and feels each rate from the row of its stamp on."""
    node = ros.node()
    clock = node.create_publisher(Clock, "/clock", SENSOR_PUB_QOS)
    base = node.create_publisher(TwistStamped, "true_rate", SENSOR_PUB_QOS)
    channels = ros.listen(node, Float64MultiArray, "channels")
    gyro = ros.add(
        GyroSimNode(
            simulator=lambda settings: PlainSimulator(), parameter_overrides=overrides({"realtime_factor": 1.0, "use_sim_time": True})
        )
    )
    wait_for(lambda: clock.get_subscription_count() and base.get_subscription_count() and channels.connected, what="discovery")
    # no clock, no time
    time.sleep(0.3)
    assert gyro._sim.time_s == 0.0

    def tick(time_s: float) -> None:
        message = Clock()
        message.clock.sec, message.clock.nanosec = int(time_s), round((time_s % 1.0) * 1e9)
        clock.publish(message)

    tick(100.0)
    wait_for(lambda: gyro._sim.time_s > 0.0, what="the first step")
    epoch = 100.0 - gyro._sim.time_s
    stamp = gyro.get_clock().now().to_msg()
    stamp.nanosec = 53_000_000
    base.publish(twist(0.5, stamp))
    wait_for(lambda: gyro._input._pending, what="the rate")
    for n in range(1, 31):
        tick(100.0 + 0.01 * n)
        wait_for(lambda n=n: gyro._sim.time_s >= 0.01 * n, what=f"{0.01 * n} s")
    # it follows the clock, not the wall
    time.sleep(0.2)
    assert gyro._sim.time_s == pytest.approx(0.31, abs=0.0101)
    channels.wait(3)
    rows = np.concatenate([rows_from_block(m) for m in channels.messages])
    felt = rows[:, 9] / 0.7 > 0.25
    assert rows[np.argmax(felt), 0] + epoch == pytest.approx(100.053, abs=0.0021)
    assert felt[np.argmax(felt) :].all()


def test_in_real_time_stamps_are_the_wall_clock(ros: RosSession) -> None:
    node = ros.node()
    rates = ros.listen(node, TwistStamped, "rate_raw")
    gyro = ros.add(FakeGyro(realtime_factor=1.0))
    rates.wait(100)
    assert "/clock" not in {publisher.topic_name for publisher in gyro.publishers}
    stamps = np.array([seconds(m.header.stamp) for m in rates.messages])
    np.testing.assert_allclose(np.diff(stamps), 0.01, atol=1e-6)
    # a loaded machine may be late, never early
    late_s = time.time() - stamps[-1]
    assert 0.0 < late_s < 5.0
    assert gyro._step_rows == 5


def test_the_bound_of_a_free_run_holds(ros: RosSession) -> None:
    gyro = ros.add(FakeGyro(realtime_factor=0.0, max_realtime_factor=10.0))
    began, from_s = time.monotonic(), gyro._sim.time_s
    wait_for(lambda: gyro._sim.time_s > from_s + 8.0, what="8 s of device time")
    # half a second of a stall may be made up; without the bound it is hundreds of times real time
    assert 10.0 * (time.monotonic() - began + 0.5) + 0.1 >= 8.0


def test_a_simulation_that_fails_ends_the_node_and_says_why(ros: RosSession) -> None:
    simulator = PlainSimulator()
    gyro = ros.add(FakeGyro(simulator))
    simulator.advance = lambda duration_s, rate_rad_s=0.0: 1 / 0  # type: ignore[method-assign]
    wait_for(lambda: gyro.exit_code == 1, what="the failure")
    wait_for(lambda: not gyro.context.ok(), what="the shutdown")


# -- as a process: the real simulator ------------------------------------------------------------------------------------------------


def test_process_at_full_speed_on_the_carrier(ros: RosSession, spawn_node: Callable[..., Any]) -> None:
    rate = 0.02
    process = spawn_node("gyro_sim_node", namespace="/g", parameters={"seed": 3, "realtime_factor": 0.0, "constant_rate_rad_s": rate})
    process.wait_output("ring_15k-0003 (carrier): 500 rows/s in blocks of 50, rate_raw at 100 Hz")
    node = ros.node(namespace="/g")
    rates = ros.listen(node, TwistStamped, "rate_raw")
    rates.wait(500)
    truth = GyroSimulator(draw_unit(load_device("ring_15k"), 3), rng=np.random.default_rng(0)).truth(rate)
    # the hidden truth of the unit that device and seed name: 5 s of data, noise 2e-6 rad/s of their mean
    assert mean_rate(rates.messages[:500]) == pytest.approx(truth.scale_factor * rate + truth.bias_rad_s, abs=2e-5)
    # parameter services answer although the simulation takes all it can get
    began = time.monotonic()
    for _ in range(10):
        ros.call(node, GetParameters, "gyro_sim/get_parameters", GetParameters.Request(names=["device_id"]))
    assert time.monotonic() - began < 5.0
    # a live recording of it: the side band is there, on the axis that was asked for
    instrument = RosInstrument(node)
    instrument.configure(Command("ftr_y", Excitation("amplitude_modulation", 5.0, 0.1)))
    recording = instrument.record(2.0, settle_s=3.0, label="side_y")
    assert recording.device_id == "ring_15k-0003"
    wave = np.exp(-2j * np.pi * 5.0 * recording.t)
    depth = 2.0 * np.abs(np.mean(wave * (recording.column("y_pick_c") - recording.column("y_pick_c").mean())))
    assert 0.05 < depth < 0.15
    assert np.abs(recording.column("x_pick_c")).max() < 0.01
    process.signal(signal.SIGINT)
    process.signal(signal.SIGINT)
    assert process.wait_exit() == 0, str(process)
    assert "Traceback" not in process.output


def test_process_refuses_a_bad_start_in_one_line(spawn_node: Callable[..., Any]) -> None:
    process = spawn_node("gyro_sim_node", parameters={"device": "ring_99k"})
    assert process.wait_exit() == 1
    assert "ring_99k" in process.output
    assert len(process.output.splitlines()) == 1


def test_process_killed_and_started_again_publishes(ros: RosSession, spawn_node: Callable[..., Any]) -> None:
    rates = ros.listen(ros.node(), TwistStamped, "rate_raw")
    for _ in range(2):
        rates.messages.clear()
        process = spawn_node("gyro_sim_node", parameters={"fidelity": "slow_flow"})
        rates.wait(20)
        process.kill()


def test_process_ends_on_sigterm(spawn_node: Callable[..., Any]) -> None:
    process = spawn_node("gyro_sim_node", parameters={"fidelity": "slow_flow"})
    process.wait_output("(slow_flow): 500 rows/s")
    process.signal(signal.SIGTERM)
    assert process.wait_exit() == 0, str(process)
