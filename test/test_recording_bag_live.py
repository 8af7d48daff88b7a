"""The topics of a running gyro, recorded byte by byte as `ros2 bag record` does, read back as a campaign."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from recording_samples import write_raw_bag

from gyro_calib.recording import Command, Excitation, load_campaign

pytest.importorskip("rosbags")
pytestmark = pytest.mark.ros


def test_running_gyro_is_recorded_and_read_back(ros, tmp_path):
    from rcl_interfaces.msg import ParameterEvent
    from rclpy.parameter import Parameter
    from rclpy.qos import qos_profile_parameter_events
    from ros_helpers import FakeGyro, PlainSimulator, wait_for
    from std_msgs.msg import Float64MultiArray

    from gyro_calib.nodes.runtime import SENSOR_SUB_QOS

    lock, heard = threading.Lock(), []

    def keep(topic, kind):
        def received(data):
            with lock:
                heard.append((topic, kind, bytes(data)))

        return received

    recorder = ros.node("recorder")
    recorder.create_subscription(
        Float64MultiArray, "/left/channels", keep("/left/channels", "std_msgs/msg/Float64MultiArray"), SENSOR_SUB_QOS, raw=True
    )
    keep_event = keep("/parameter_events", "rcl_interfaces/msg/ParameterEvent")
    recorder.create_subscription(ParameterEvent, "/parameter_events", keep_event, qos_profile_parameter_events, raw=True)
    gyro = ros.add(FakeGyro(namespace="/left", block_duration_s=0.05))

    def count(topic):
        with lock:
            return sum(heard_topic == topic for heard_topic, _, _ in heard)

    def heard_on_both():
        gyro.set_parameters([Parameter("constant_rate_rad_s", value=0.0)])
        return count("/left/channels") > 0 and count("/parameter_events") > 0

    # the events of its declarations come before discovery, and the topics are discovered one by one: this bag begins after the driver
    wait_for(heard_on_both, 30.0, "blocks and events of the gyro")
    with lock:
        heard.clear()

    side_band = Command("ftr_y", Excitation("amplitude_modulation", 0.5, 0.1))
    for command in (Command(), side_band, Command("ftr_x")):
        start = count("/left/channels")
        result = gyro.set_parameters_atomically([Parameter(name, value=value) for name, value in command.to_parameters().items()])
        assert result.successful, result.reason
        wait_for(lambda start=start: count("/left/channels") > start + 60, 60.0, "three seconds of blocks")
    with lock:
        path = write_raw_bag(tmp_path / "bag", heard)

    campaign = load_campaign(path, device_id=PlainSimulator.device_id, factory=gyro._factory)
    assert [recording.command for recording in campaign] == [Command(), side_band, Command("ftr_x")]
    assert [recording.column("segment")[0] for recording in campaign] == [1.0, 2.0, 3.0]
    for recording in campaign:
        assert recording.sample_rate_hz == pytest.approx(PlainSimulator.sample_rate_hz)
        np.testing.assert_allclose(np.diff(recording.t), 1.0 / PlainSimulator.sample_rate_hz, rtol=1e-6)
        assert np.abs(recording.column(f"{recording.command.oscillator_axis}_pick_c")).min() > 0.9
