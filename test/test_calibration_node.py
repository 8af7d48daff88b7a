"""The calibration node with a gyro that behaves: what a run does, says, stores and publishes; the services around it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from calibration_rig import DEVICE, SPEED, CalibrationClient, Rig, record_file, store_record
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import DescribeParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter
from ros_helpers import FakeGyro, PlainSimulator, RosSession, overrides, wait_for

from gyro_calib.calibration import RecordStore, dump_record
from gyro_calib.device import draw_unit, load_device
from gyro_calib.estimation import calibrate
from gyro_calib.nodes.calibration_node import CalibrationNode
from gyro_calib.nodes.calibration_runs import RUNS
from gyro_calib.recording.command import Command
from gyro_calib.recording.load import load_campaign
from gyro_calib.simulation.truth import truth_of
from gyro_calib.units import deg_h, ppm

pytestmark = pytest.mark.ros

RATE_RAD_S = 2e-4


def states(client: CalibrationClient) -> list[str]:
    """States of the run in order, without repeats in a row."""
    seen = [next(pair.value for pair in message.values if pair.key == "state") for message in client.status.messages]
    return [state for i, state in enumerate(seen) if i == 0 or seen[i - 1] != state]


def test_self_calibration_of_a_simulated_gyro_end_to_end(ros: RosSession, spawn_node: Any) -> None:
    """Three processes: carrier simulator, calibration node, and this one, which knows the truth."""
    simulator = {"fidelity": "carrier", "seed": 7, "realtime_factor": 0.0, "max_realtime_factor": 40.0, "constant_rate_rad_s": RATE_RAD_S}
    spawn_node("gyro_sim_node", parameters=simulator)
    spawn_node("calibration_node", parameters={"plan_quality": "quick", "use_sim_time": True})
    client = CalibrationClient(ros)
    diagnostics = ros.listen(client.node, DiagnosticArray, "/diagnostics")
    client.wait_ready()
    assert not client.calibrated
    assert client.published_record is None
    run_id = client.run("self_calibrate")
    assert client.wait_end(run_id) == "done", client.text
    assert states(client)[-4:] == ["accepted", "running", "estimating", "done"]

    # one record, the same on disk, on every topic and in the status
    record = RecordStore(None, DEVICE).load()
    wait_for(lambda: client.calibrated, 10.0, "is_calibrated")
    client.wait_record(record)
    assert record_file().read_text() == dump_record(record)
    assert record.provenance["run_id"] == run_id
    assert record.mode == "ftr_x"
    bias = client.bias.wait()[-1].twist
    assert bias.twist.angular.z == record.bias.value
    assert bias.covariance[35] == pytest.approx(record.bias.sd**2, rel=1e-12)
    scale = client.scale_factor.wait()[-1].vector
    by_axis = record.scale_factor_by_axis
    assert (scale.x, scale.y, scale.z) == (by_axis["x"].value, by_axis["y"].value, record.scale_factor.value)
    assert list(client.compensation.wait()[-1].data) == [1.0, 0.0, 0.0, 1.0]
    values = client.values
    assert values["calibration"] == record.record_id
    assert values["saved"] == "True"
    assert float(values["bias [deg/h]"]) == pytest.approx(deg_h(record.bias.value), rel=1e-8)
    assert float(values["scale_factor.sd [1]"]) == pytest.approx(record.scale_factor.sd, rel=1e-8)

    # the truth, which only the test knows
    truth = truth_of(draw_unit(load_device("ring_15k"), 7), Command(), RATE_RAD_S)
    assert abs(deg_h(truth.bias_rad_s)) > 100.0
    assert abs(deg_h(record.bias.value - truth.bias_rad_s)) < 10.0
    assert abs(ppm(record.scale_factor.value / truth.scale_factor - 1.0)) < 200.0
    assert abs(record.bias.value - truth.bias_rad_s) < 5.0 * record.bias.sd

    # progress never ran backwards, and the array for monitors came along
    fractions = [float(next(p.value for p in m.values if p.key == "fraction")) for m in client.status.messages]
    assert len({f for f in fractions if 0.0 < f < 1.0}) > 5
    assert fractions == sorted(fractions)
    mine = [status for array in diagnostics.messages for status in array.status if status.name == "gyro_calibration: calibration"]
    assert len(mine) >= 2
    assert mine[-1].hardware_id == DEVICE


def test_a_new_record_is_unsaved_until_it_is_saved_and_can_be_reverted(ros: RosSession) -> None:
    first = store_record()
    rig = Rig(ros, autosave=False)
    rig.wait_value("calibration", first.record_id)
    assert rig.wait_end(rig.run("self_calibrate")) == "done", rig.text
    second = rig.values["calibration"]
    assert second != first.record_id
    assert rig.values["saved"] == "False"
    assert RecordStore(None, DEVICE).load() == first

    # an unsaved one is dropped by a revert
    response = rig.call("revert")
    assert response.success
    assert response.message == f"reverted from {second} to {first.record_id}"
    rig.wait_record(first)

    # a saved one goes back to the previous version, in force and on disk
    assert rig.wait_end(rig.run("self_calibrate")) == "done", rig.text
    third = rig.values["calibration"]
    response = rig.call("save")
    assert response.success
    assert response.message == f"saved {third} to {record_file()}"
    rig.wait_value("saved", "True")
    assert RecordStore(None, DEVICE).load().record_id == third
    assert rig.call("revert").success
    rig.wait_record(first)
    assert RecordStore(None, DEVICE).load() == first
    response = rig.call("revert")
    assert not response.success
    assert "there is none" in response.message
    assert rig.values["calibration"] == first.record_id
    assert rig.published_record == first


def test_recordings_of_run_feedthrough_serve_the_next_run_sideband(ros: RosSession, tmp_path: Path) -> None:
    rig = Rig(ros, artifacts_dir=str(tmp_path / "runs"))
    assert rig.wait_end(rig.run("run_feedthrough")) == "done", rig.text
    assert "kept for the runs that follow" in rig.text
    assert rig.published_record is None, "nothing follows from loops-off records alone"
    run_id = rig.run("run_sideband")
    assert rig.wait_end(run_id) == "done", rig.text
    wait_for(lambda: rig.published_record, 10.0, "the record")
    record = rig.published_record
    assert record is not None
    assert not any("feedthrough E was not measured" in warning for warning in record.warnings)
    assert record.parameters["E_xx_re"].sd > 0.0
    # what was kept on disk gives the same estimate
    again = calibrate(load_campaign(tmp_path / "runs" / run_id / "campaign.h5"), with_convergence=False)
    np.testing.assert_allclose(again.bias["x"].value, record.bias_by_axis["x"].value, rtol=1e-9)


def test_run_sideband_alone_says_what_it_misses(ros: RosSession) -> None:
    rig = Rig(ros)
    assert rig.wait_end(rig.run("run_sideband")) == "done", rig.text
    assert "feedthrough E was not measured" in rig.text


def test_a_restarted_node_has_the_calibration_at_once(ros: RosSession) -> None:
    record = store_record()
    rig = Rig(ros, device_id=DEVICE)
    wait_for(lambda: rig.calibrated, 10.0, "is_calibrated")
    rig.wait_record(record)
    late = CalibrationClient(ros)
    late.wait_value("calibration", record.record_id)
    late.wait_record(record)  # latched: who joins late hears it too
    assert late.bias.wait()[-1].twist.twist.angular.z == record.bias.value


def test_without_a_gyro_the_expected_devices_calibration_is_in_force_and_runs_are_refused(ros: RosSession) -> None:
    record = store_record()
    rig = Rig.__new__(Rig)
    CalibrationClient.__init__(rig, ros)
    ros.add(CalibrationNode(parameter_overrides=overrides({"device_id": DEVICE})))
    rig.wait_value("calibration", record.record_id)
    rig.wait_text("nobody does after 1 s", 20.0)
    response = rig.call("self_calibrate")
    assert not response.success
    assert "Start its driver or gyro_sim in this namespace" in response.message
    checks = rig.self_test()
    assert checks["passed"] == b"\x00"
    assert "No block has arrived" in checks["stream"].message


def test_the_self_test_of_a_good_gyro_passes_and_of_a_detuned_one_says_why(ros: RosSession) -> None:
    simulator = PlainSimulator()
    store_record("plain-0001")
    rig = Rig(ros, ros.add(FakeGyro(simulator)))
    rig.wait_value("calibration", RecordStore(None, "plain-0001").load().record_id)
    wait_for(lambda: rig.calibrator._instrument.recent.rows().shape[0] > 500, 10.0, "a stretch of the stream")
    checks = rig.self_test()
    names = ["stream", "finite", "sample_rate", "temperature", "amplitude", "loops", "device", "store", "record"]
    assert [name for name in checks if name not in ("passed", "id")] == names
    assert [checks[name].level for name in names] == [b"\x00"] * 9, {name: checks[name].message for name in names}
    assert checks["passed"] == b"\x01"
    assert checks["id"] == "plain-0001"
    simulator.temperature_degc = float("inf")
    wait_for(lambda: rig.self_test()["temperature"].level == b"\x02", 20.0, "the thermometer's failure")
    assert rig.self_test()["passed"] == b"\x00"


def test_a_gyro_left_excited_by_somebody_is_reported(ros: RosSession) -> None:
    rig = Rig(ros)
    rig.gyro.set_parameters_atomically(
        [
            Parameter("mode", value="loops_off"),
            Parameter("excitation.kind", value="drive"),
            Parameter("excitation.frequency_hz", value=14e3),
        ]
    )
    rig.wait_text("The gyro is left in loops_off with excitation drive")
    # and a run puts it right
    run_id = rig.run("run_sideband")
    rig.call("cancel")
    rig.wait_end(run_id)
    wait_for(lambda: rig.gyro_command == Command(), 10.0, "mission")


def test_every_service_that_is_offered_works_and_no_other_is_offered(ros: RosSession) -> None:
    rig = Rig(ros)
    offered = dict(rig.calibrator.get_service_names_and_types_by_node("gyro_calibration", "/"))
    own = {name.rsplit("/", 1)[1]: kinds for name, kinds in offered.items() if "/gyro_calibration/" in name and "parameter" not in name}
    own = {name: kinds for name, kinds in own.items() if name not in ("get_type_description",)}
    triggers = {*RUNS, "cancel", "save", "revert"}
    assert own == {**{name: ["std_srvs/srv/Trigger"] for name in triggers}, "self_test": ["diagnostic_msgs/srv/SelfTest"]}
    response = rig.call("save")
    assert not response.success
    assert "none is in force" in response.message


def test_parameters_have_descriptions_units_and_ranges(ros: RosSession) -> None:
    rig = Rig(ros)
    names = ros.call(rig.node, ListParameters, "gyro_calibration/list_parameters").result.names
    own = [name for name in names if not name.startswith(("use_sim_time", "qos_overrides", "start_type_description_service"))]
    request = DescribeParameters.Request(names=own)
    descriptors = {d.name: d for d in ros.call(rig.node, DescribeParameters, "gyro_calibration/describe_parameters", request).descriptors}
    assert {"gyro_node", "record_url", "device_id", "temperature_limit_k", "base_rate_limit_rad_s"} <= set(own)
    assert {"stream_timeout_s", "autosave", "plan_quality", "artifacts_dir"} <= set(own)
    for name, descriptor in descriptors.items():
        assert descriptor.description, name
        if re.search(r"_(k|s)$", name):
            assert descriptor.floating_point_range, name
            assert re.search(r"\[\S+\]", descriptor.description), name
    refused = SetParameters.Request(parameters=[Parameter("plan_quality", value="hasty").to_parameter_msg()])
    (result,) = ros.call(rig.node, SetParameters, "gyro_calibration/set_parameters", refused).results
    assert not result.successful
    assert "quick, standard, fine" in result.reason


def test_limits_count_from_the_next_run_on(ros: RosSession) -> None:
    rig = Rig(ros)
    rig.calibrator.set_parameters([Parameter("temperature_limit_k", value=0.05)])
    rig.gyro.ramp_temperature(0.1)
    assert rig.wait_end(rig.run("run_sideband")) == "failed"
    assert "Temperature must stay within 0.05 K" in rig.text


def test_gyros_in_namespaces_keep_to_themselves(ros: RosSession) -> None:
    clients = []
    for namespace in ("/left", "/right"):
        ros.add(FakeGyro(PlainSimulator(), namespace=namespace, realtime_factor=SPEED))
        settings = {"plan_quality": "quick", "record_url": f"${{ROS_HOME}}{namespace}.yaml"}
        ros.add(CalibrationNode(namespace=namespace, parameter_overrides=overrides(settings)))
        clients.append(CalibrationClient(ros, namespace))
    for client in clients:
        client.wait_ready("plain-0001")
    left, right = clients
    run_id = left.run("self_calibrate")
    assert right.values["state"] == "idle"
    assert right.call("run_sideband").success, "one run per gyro, not per machine"
    for client in clients:
        client.call("cancel")
    assert left.wait_end(run_id) == "cancelled"
