"""A robot simulator drives the simulated gyro: its clock, its angular velocity, a triad of axes, a pause. All in processes of their own."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("rclpy")

from geometry_msgs.msg import TwistStamped
from robot_motion import MOTION, angular_velocity
from ros_helpers import Listener, RosSession, wait_for
from sensor_msgs.msg import Imu
from std_srvs.srv import SetBool

pytestmark = pytest.mark.ros

WORLD_S = 12.0
#: rows: stamp [s], rate [rad/s]
Rates = NDArray[np.float64]


def seconds(message: Any) -> float:
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)


def rates_of(listener: Listener, pick: Callable[[Any], float]) -> Rates:
    return np.array([(seconds(m), pick(m)) for m in list(listener.messages)])


def fit(found: Rates, axis: str, delay_s: float) -> tuple[float, float, float]:
    """Scale factor, bias and rms of what is left of a rate against the motion ``delay_s`` earlier."""
    true = np.array([angular_velocity(axis, time - delay_s) for time in found[:, 0]])
    columns = np.column_stack((true, np.ones_like(true)))
    solution, *_ = np.linalg.lstsq(columns, found[:, 1], rcond=None)
    return float(solution[0]), float(solution[1]), float(np.sqrt(np.mean((found[:, 1] - columns @ solution) ** 2)))


def stands_still(listener: Listener) -> bool:
    """Whether no message comes for a second; three hundred would while the world runs."""
    count = len(listener.messages)
    time.sleep(1.0)
    return len(listener.messages) == count


def test_the_raw_rates_of_a_triad_follow_a_robot_simulator(ros: RosSession, spawn_node: Callable[..., Any]) -> None:
    node = ros.node()
    for seed, axis in enumerate(MOTION):
        spawn_node(
            "gyro_sim_node",
            namespace=f"/robot/gyro_{axis}",
            parameters={"fidelity": "slow_flow", "seed": seed, "use_sim_time": True, "gyro_axis": axis, "frame_id": f"gyro_{axis}"},
            remap={"true_rate": "/true_rate"},
        )
    joined = {"gyros": [f"gyro_{axis}" for axis in MOTION], "device_ids": [""] * 3, "record_urls": [""] * 3, "use_sim_time": True}
    spawn_node("imu_corrector_node", namespace="/robot", parameters={**joined, "frame_id": "imu_link"}, remap={"imu/data_raw": "imu/triad"})
    raw = {axis: ros.listen(node, TwistStamped, f"/robot/gyro_{axis}/rate_raw") for axis in MOTION}
    imu = ros.listen(node, Imu, "/robot/imu/triad")
    # no clock, no time: whoever starts first waits
    wait_for(lambda: all(listener.connected for listener in (*raw.values(), imu)), 90.0, "discovery")
    assert not imu.messages
    spawn_node("robot_motion.py", arguments=["--speed", "3"])
    imu.wait(round(100 * WORLD_S), 90.0)
    scale = {}
    for axis, (size, _) in MOTION.items():
        found = rates_of(raw[axis], lambda m: m.twist.angular.z)
        steps = np.diff(found[:, 0]) / 0.01
        # sensor data are best effort: on a busy machine some are lost on their way, none is at another time
        np.testing.assert_allclose(steps, np.maximum(np.rint(steps), 1.0), atol=1e-4)
        assert np.mean(steps < 1.5) > 0.9
        found = found[found[:, 0] > found[0, 0] + 2.0]  # loops settled
        delays = np.arange(-0.05, 0.1, 0.005)
        left = [fit(found, axis, delay)[2] for delay in delays]
        best = float(delays[int(np.argmin(left))])
        # held for a step of the world, smoothed by the rebalance loop
        assert 0.0 <= best <= 0.03
        scale[axis], bias, rms = fit(found, axis, best)
        assert 0.8 < scale[axis] < 1.2
        assert abs(bias) < 0.05
        assert rms < 0.02 * size
    message = imu.messages[-1]
    assert message.header.frame_id == "imu_link"
    # uncorrected, there is no record: the same rates, joined
    for axis in MOTION:
        found = rates_of(imu, lambda m, axis=axis: getattr(m.angular_velocity, axis))
        assert fit(found[200:], axis, 0.01)[0] == pytest.approx(scale[axis], rel=0.02)
    pause = "/robot_simulator/pause"
    assert ros.call(node, SetBool, pause, SetBool.Request(data=True)).success
    wait_for(lambda: stands_still(imu), 20.0, "the stand-still")
    count = len(imu.messages)
    assert ros.call(node, SetBool, pause, SetBool.Request(data=False)).success
    imu.wait(count + 100, 30.0)
    # the world did not notice the pause, and neither does who integrates
    np.testing.assert_allclose(np.diff(rates_of(imu, seconds)[:, 0]), 0.01, atol=1e-6)
