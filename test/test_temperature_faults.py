"""A gyro whose temperature runs away at 50 degC an hour, a process of its own: the run that is too long ends, the short one is right, the
record says when it does not hold any more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from calibration_rig import CalibrationClient, record_file, store_record
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from ros_helpers import Listener, RosSession, wait_for
from sensor_msgs.msg import Imu

from gyro_calib.calibration import RecordStore
from gyro_calib.device import Device, draw_unit, dump_device, load_device
from gyro_calib.nodes.runtime import LATCHED_QOS
from gyro_calib.recording.command import Command
from gyro_calib.simulation.truth import truth_of
from gyro_calib.units import DEG_H, deg_h

pytestmark = [pytest.mark.ros, pytest.mark.slow]

RAMP_K_PER_S = 50.0 / 3600.0


#: rms of the bias of drawn rings, per kelvin
BIAS_PER_K = 8.5 * DEG_H


def set_parameters(client: CalibrationClient, node: str, **values: object) -> None:
    future = AsyncParameterClient(client.node, node).set_parameters([Parameter(name, value=value) for name, value in values.items()])
    wait_for(future.done, 20.0, "the parameters")
    assert all(result.successful for result in future.result().results)


def temperature_of(status: Listener) -> float:
    """What the corrector has heard last [degC]."""
    return float(next(pair.value for pair in status.messages[-1].values if pair.key == "temperature_degc"))


@pytest.fixture
def device() -> Device:
    unit = draw_unit(load_device("ring_15k"), 7)
    return replace(unit, environment=replace(unit.environment, temperature_degc=20.0, ramp_k_per_s=RAMP_K_PER_S))


def test_a_drift_of_50_degc_an_hour(ros: RosSession, spawn_node: Callable[..., Any], device: Device, tmp_path: Path) -> None:
    previous = store_record(device.device_id)
    content = record_file(device.device_id).read_bytes()
    dump_device(device, tmp_path / "drifting.yaml")
    client = CalibrationClient(ros)
    imu = ros.listen(client.node, Imu, "imu/data_raw")
    status = ros.listen(client.node, DiagnosticStatus, "imu_corrector/status", LATCHED_QOS)
    pace = {"fidelity": "slow_flow", "realtime_factor": 80.0, "rate_raw_hz": 5.0, "block_duration_s": 0.5}
    spawn_node("gyro_sim_node", parameters={"device": str(tmp_path / "drifting.yaml"), **pace})
    spawn_node("calibration_node", parameters={"plan_quality": "standard"})
    nothing = {"bias_temperature_sd_rad_s_per_k": 0.0, "scale_factor_temperature_sd_per_k": 0.0}
    spawn_node("imu_corrector_node", parameters=nothing)
    client.wait_ready(device.device_id)

    # eight minutes are 6 K: too far
    assert client.wait_end(client.run()) == "failed"
    assert "Temperature must stay within 2 K" in client.text
    assert "raise temperature_limit_k" in client.text
    client.wait_record(previous)
    assert record_file(device.device_id).read_bytes() == content

    # two minutes are less, and what they find holds for the temperature that it was found at
    set_parameters(client, "gyro_calibration", plan_quality="quick", temperature_limit_k=5.0)
    assert client.wait_end(client.run()) == "done", client.text
    record = RecordStore(None, device.device_id).load()
    there = replace(device, environment=replace(device.environment, temperature_degc=record.temperature_degc.value, ramp_k_per_s=0.0))
    truth = truth_of(there, Command(), 0.0)
    assert abs(record.bias.value - truth.bias_rad_s) < 5.0 * record.bias.sd
    assert deg_h(record.bias.sd) < 10.0
    assert abs(record.scale_factor.value - truth.scale_factor) < 5.0 * record.scale_factor.sd

    # on the way it is applied without a word, and with a warning and a wide covariance once its temperatures are left behind
    wait_for(lambda: record.record_id in status.messages[-1].message, 20.0, "the new record in the corrector")
    imu.messages.clear()
    narrow = imu.wait(5)[-1].angular_velocity_covariance[8]
    wait_for(lambda: "Temperature must be" in status.messages[-1].message, 60.0, "the warning")
    assert status.messages[-1].level == b"\x01"
    assert temperature_of(status) == pytest.approx(record.validity["temperature_max_degc"], abs=2.5)
    imu.messages.clear()
    k = record.scale_factor.value
    # ten times the sd of the bias: 99 times its variance more
    wide = imu.wait(20)[-1].angular_velocity_covariance[8] - narrow
    assert wide == pytest.approx(99.0 * (record.bias.sd / k) ** 2, rel=0.05)

    # a factor knows nothing of this gyro; who states how its bias goes with temperature gets a covariance that holds
    sensitivity = {"bias_temperature_sd_rad_s_per_k": BIAS_PER_K, "scale_factor_temperature_sd_per_k": 147e-6}
    set_parameters(client, "imu_corrector", **sensitivity)
    imu.messages.clear()
    constant = imu.wait(200)[-1].angular_velocity_covariance[8] - narrow
    rate = float(np.mean([m.angular_velocity.z for m in imu.messages[-100:]]))
    away_k = temperature_of(status) - record.temperature_degc.value
    assert constant - wide == pytest.approx((BIAS_PER_K * away_k / k) ** 2, rel=0.3)
    assert abs(rate) < 3.0 * constant**0.5
