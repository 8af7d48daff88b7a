"""A whole-angle gyro in ROS, end to end: runs, drive compensation, the record, and the corrected rate. Real nodes, over topics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from calibration_rig import CalibrationClient, Rig, record_file, store_record
from geometry_msgs.msg import TwistStamped
from rclpy.parameter import Parameter
from ros_helpers import FakeGyro, RosSession, overrides, wait_for
from sensor_msgs.msg import Imu
from wave_samples import left_behind, unbalanced_hrg

from gyro_calib.calibration import RecordStore, dump_record
from gyro_calib.device.io import dump_device
from gyro_calib.nodes.calibration_node import CalibrationNode
from gyro_calib.nodes.gyro_sim_node import make_simulator
from gyro_calib.nodes.imu_corrector_node import ImuCorrector
from gyro_calib.recording.command import Command
from gyro_calib.simulation.truth import truth_of

pytestmark = pytest.mark.ros

DEVICE = "hrg_low_q"
IDENTITY = (1.0, 0.0, 0.0, 1.0)
MATRIX = (0.9995, -0.0263, 0.0189, 1.0272)
RATE_RAD_S = 2e-3
SPEED = 100.0


def make_gyro(ros: RosSession, folder: Path, **parameters: Any) -> FakeGyro:
    """The slow flow of a hemisphere whose forcers are unbalanced, in its mission."""
    file = folder / "hrg_low_q.yaml"
    dump_device(unbalanced_hrg(), file)
    settings = {"device": str(file), "seed": -1, "fidelity": "slow_flow", "mode": "whole_angle", "constant_rate_rad_s": RATE_RAD_S}
    # few messages at this pace: it is their content that counts
    pace = {"block_duration_s": 0.5, "rate_raw_hz": 5.0}
    gyro: FakeGyro = ros.add(FakeGyro(make_simulator, **{**settings, "realtime_factor": SPEED, **pace, **parameters}))
    return gyro


def set_gyro(gyro: FakeGyro, **values: Any) -> None:
    gyro.set_parameters_atomically([Parameter(name, value=value) for name, value in values.items()])


def test_virtual_precession_compensates_the_drives_and_its_record_corrects_the_rate(ros: RosSession, tmp_path: Path) -> None:
    rig = Rig(ros, make_gyro(ros, tmp_path))
    corrector = ros.add(ImuCorrector(parameter_overrides=overrides({"uncalibrated_policy": "pass"})))
    assert rig.gyro_command.compensation == IDENTITY
    run_id = rig.run("run_virtual_precession")
    assert rig.wait_end(run_id, 120.0) == "done", rig.text

    # stored, published, and in force in the gyro
    record = RecordStore(None, DEVICE).load()
    rig.wait_record(record)
    assert record_file(DEVICE).read_text() == dump_record(record)
    assert (record.mode, record.method, record.provenance["run_id"]) == ("whole_angle", "virtual_precession", run_id)
    assert list(rig.compensation.wait()[-1].data) == list(record.compensation)
    assert len(record.compensation_covariance) == 16
    wait_for(lambda: rig.gyro_command == replace(Command("whole_angle"), compensation=record.compensation), 10.0, "mission, compensated")
    # every round was told, the last one at its noise
    told = [m.message for m in rig.status.messages if m.message.startswith("round 2, ")]
    found = left_behind(unbalanced_hrg())[0]
    assert all(f"round 1: residual delta_g {found:.2e}" in text for text in told)
    assert len(told) > 5
    assert float(rig.values["round_1.residual_delta_g [1]"]) == pytest.approx(found, abs=1e-5)
    assert "at its noise" in rig.text
    assert abs(float(rig.values["residual_delta_g [1]"])) < 1e-5

    # the truth, which only the test knows: before, after
    device = unbalanced_hrg()
    raw = truth_of(device, Command("whole_angle"), RATE_RAD_S)
    compensated = truth_of(device, rig.gyro_command, RATE_RAD_S)
    assert abs(raw.bias_rad_s) > 3e-3
    assert abs(compensated.bias_rad_s) < 1e-3 * abs(raw.bias_rad_s)
    assert abs(record.bias.value - compensated.bias_rad_s) < 5.0 * record.bias.sd
    assert abs(record.scale_factor.value - compensated.scale_factor) < 5.0 * record.scale_factor.sd

    # the corrector applies it to the whole-angle rate, as to any
    (state,) = [gyro.state for gyro in corrector._gyros]
    wait_for(lambda: state.corrected and state.record == record, 20.0, "the corrector's record")
    corrected = ros.listen(rig.node, Imu, "imu/data_raw")
    messages = corrected.wait(300)[100:]
    after = float(np.mean([m.angular_velocity.z for m in messages]))
    assert abs(after - RATE_RAD_S) < 0.05 * abs(raw.bias_rad_s)
    assert 0.0 < messages[-1].angular_velocity_covariance[8] < 1e-2
    # uncorrected and uncompensated, the same base reads this
    set_gyro(rig.gyro, compensation=list(IDENTITY))
    wait_for(lambda: not state.corrected, 20.0, "the corrector's refusal of a record of another compensation")
    rates = ros.listen(rig.node, TwistStamped, "rate_raw")
    before = float(np.mean([m.twist.angular.z for m in rates.wait(300)[100:]]))
    # the bias depends on the azimuth: what a few seconds of a turning wave see is a part of its mean
    assert abs(before - RATE_RAD_S) > 0.25 * abs(raw.bias_rad_s)


def test_a_scale_factor_run_renews_that_alone(ros: RosSession, tmp_path: Path) -> None:
    previous = store_record(DEVICE, mode="whole_angle", method="virtual_precession", compensation=MATRIX, bias_scale_covariance=0.0)
    rig = Rig(ros, make_gyro(ros, tmp_path))
    # the gyro came up without its compensation and is given it
    wait_for(lambda: rig.gyro_command.compensation == MATRIX, 20.0, "the compensation of the record in force")
    run_id = rig.run("run_scale_factor")
    assert rig.wait_end(run_id, 120.0) == "done", rig.text
    record = RecordStore(None, DEVICE).load()
    rig.wait_record(record)
    assert record.record_id != previous.record_id
    for name in ("bias", "bias_by_axis", "rate", "compensation", "rate_noise_density"):
        assert getattr(record, name) == getattr(previous, name), name
    truth = truth_of(unbalanced_hrg(), rig.gyro_command, RATE_RAD_S)
    assert abs(record.scale_factor.value - truth.scale_factor) < 5.0 * record.scale_factor.sd
    assert record.scale_factor.sd < 1e-4
    assert set(record.scale_factor_by_axis) == {"x", "y"}
    assert record.axis_scale_covariance is not None
    assert rig.gyro_command == Command("whole_angle", compensation=MATRIX)


def test_self_calibrate_does_what_the_mode_needs_and_a_cancel_restores_the_compensation(ros: RosSession, tmp_path: Path) -> None:
    rig = Rig(ros, make_gyro(ros, tmp_path, compensation=[1.0, -0.02, 0.01, 1.01]))
    before = rig.gyro_command
    response = rig.call("run_sideband")
    assert not response.success
    assert "must be ftr" in response.message
    rig.gyro.when(lambda rows: rig.gyro_command.compensation != before.compensation, lambda: rig.calibrator._runs.cancel("enough") and None)
    run_id = rig.run("self_calibrate")
    assert rig.wait_end(run_id, 120.0) == "cancelled", rig.text
    steps = " ".join(message.message for message in rig.status.messages)
    for label in ("body_", "ring_down_x", "ring_up_y", "stiffness_x_0", "vir_p_0", "vir_n_0"):
        assert label in steps, label
    assert "side_" not in steps
    assert float(rig.values["round_1.residual_delta_g [1]"]) == pytest.approx(-0.018, abs=2e-3)
    wait_for(lambda: rig.gyro_command == before, 10.0, "the compensation that the gyro had")
    assert rig.published_record is None
    assert "may not be back" not in rig.text


def test_a_force_rebalance_gyro_refuses_whole_angle_runs(ros: RosSession) -> None:
    rig = Rig(ros)
    for service in ("run_virtual_precession", "run_scale_factor"):
        response = rig.call(service)
        assert not response.success
        assert "must be whole_angle for this run" in response.message
        assert "Call self_calibrate" in response.message


def test_a_revert_takes_the_earlier_compensation_back_into_the_gyro(ros: RosSession, tmp_path: Path) -> None:
    first = store_record(DEVICE, mode="whole_angle", compensation=MATRIX)
    second = store_record(DEVICE, mode="whole_angle", compensation=(1.0, -0.02, 0.01, 1.01), created_utc="2026-03-02T12:00:00Z")
    rig = Rig(ros, make_gyro(ros, tmp_path, realtime_factor=5.0))
    wait_for(lambda: rig.gyro_command.compensation == second.compensation, 20.0, "the compensation in force")
    assert rig.call("revert").success
    wait_for(lambda: rig.gyro_command.compensation == first.compensation, 20.0, "the earlier compensation")
    # somebody else's matrix is reported, and let be
    set_gyro(rig.gyro, compensation=[1.0, 0.0, 0.0, 1.0])
    wait_for(lambda: rig.gyro_command.compensation == IDENTITY, 20.0, "the matrix of somebody else")
    rig.wait_text("Drive compensation must be")
    assert rig.gyro_command.compensation == IDENTITY


def test_a_compensation_is_left_to_others_on_request(ros: RosSession, tmp_path: Path) -> None:
    store_record(DEVICE, mode="whole_angle", compensation=MATRIX)
    gyro = make_gyro(ros, tmp_path, realtime_factor=5.0)
    client = CalibrationClient(ros)
    ros.add(CalibrationNode(parameter_overrides=overrides({"apply_compensation": False})))
    client.wait_ready(DEVICE)
    client.wait_text("Drive compensation must be")
    assert gyro._sim.command.compensation == IDENTITY
