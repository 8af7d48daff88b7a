"""Records and states as messages, and the record back: nothing lost, every number with its unit."""

from __future__ import annotations

import math
import re

import pytest

pytest.importorskip("rclpy")

from builtin_interfaces.msg import Time
from calibration_samples import make_record
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from diagnostic_msgs.srv import SelfTest
from rclpy.serialization import deserialize_message, serialize_message

from gyro_calib.calibration import dump_record
from gyro_calib.errors import StoreError
from gyro_calib.nodes.calibration_messages import (
    bias_message,
    calibration_message,
    compensation_message,
    flatten_record,
    record_from_calibration,
    scale_factor_message,
    self_test_response,
    status_message,
)
from gyro_calib.nodes.run_manager import RunState, RunStatus
from gyro_calib.nodes.self_checks import SelfCheck
from gyro_calib.quantity import Quantity

pytestmark = pytest.mark.ros
STAMP = Time(sec=12, nanosec=34)


@pytest.fixture
def record():
    return make_record(condition_number=120.0)


def over_the_wire(message):
    return deserialize_message(serialize_message(message), type(message))


def values(status: DiagnosticStatus) -> dict[str, str]:
    return {pair.key: pair.value for pair in status.values}


def test_a_record_survives_its_message(record) -> None:
    message = over_the_wire(calibration_message(record, STAMP))
    assert record_from_calibration(message) == record
    assert record_from_calibration(message, device_id=record.device_id) == record
    (status,) = message.status
    assert (status.name, status.hardware_id, status.message) == ("calibration", record.device_id, record.record_id)
    assert status.level == DiagnosticStatus.OK
    assert values(status)["record_yaml"] == dump_record(record)
    assert message.header.stamp == STAMP


def test_a_record_of_another_device_is_refused_by_its_reader(record) -> None:
    with pytest.raises(StoreError, match="must belong to device 'other'"):
        record_from_calibration(calibration_message(record, STAMP), device_id="other")


def test_no_record_is_a_warning_with_the_reason() -> None:
    message = over_the_wire(calibration_message(None, STAMP, device_id="ring_15k-0007", reason="torn"))
    assert record_from_calibration(message) is None
    assert (message.status[0].level, message.status[0].message) == (DiagnosticStatus.WARN, "torn")
    assert message.status[0].hardware_id == "ring_15k-0007"


@pytest.mark.parametrize(
    ("statuses", "text"),
    [
        ([], "must hold a status named 'calibration', but got none"),
        ([DiagnosticStatus(name="calibration")], "must hold one record_yaml, but got 0"),
        ([DiagnosticStatus(name="calibration", values=[KeyValue(key="record_yaml", value="torn")])], "Calibration message must be"),
    ],
)
def test_a_message_that_is_not_one_is_refused(statuses: list[DiagnosticStatus], text: str) -> None:
    with pytest.raises(StoreError, match=re.escape(text)):
        record_from_calibration(DiagnosticArray(status=statuses))


def test_every_number_of_a_flat_record_names_its_unit(record) -> None:
    flat = flatten_record(record)
    without = [key for key, value in flat.items() if isinstance(value, float) and not re.search(r" \[[^\]]+\]$", key)]
    assert without == []
    assert flat["bias [rad/s]"] == record.bias.value
    assert flat["bias.sd [rad/s]"] == record.bias.sd
    assert flat["scale_factor.x [V/(rad/s)]"] == 0.51
    assert flat["temperature [degC]"] == 25.0
    assert flat["operating_point.ref_freq [Hz]"] == 15000.25
    assert flat["validity.max_age [s]"] == 86400.0
    assert flat["validity.temperature_min [degC]"] == 20.0
    assert flat["parameters.A_yx_re [1/s]"] == -0.0131
    assert flat["not_observable"] == "pickoff_phase"
    assert flat["provenance.run_id"] == "run-1"


def test_bias_carries_value_and_variance(record) -> None:
    message = over_the_wire(bias_message(record, STAMP, "gyro"))
    assert message.twist.twist.angular.z == record.bias.value
    assert message.twist.covariance[35] == record.bias.sd**2
    assert sum(map(abs, message.twist.covariance)) == record.bias.sd**2
    assert message.header.frame_id == "gyro"


def test_scale_factor_has_k_in_z_and_volts_in_x_and_y(record) -> None:
    vector = over_the_wire(scale_factor_message(record, STAMP, "gyro")).vector
    assert vector.z == 1.03
    assert vector.x == 0.51
    assert math.isnan(vector.y), "not found is not zero"


def test_compensation_is_two_by_two_row_major() -> None:
    message = over_the_wire(compensation_message(make_record(compensation=(1.0, 0.1, 0.2, 0.9))))
    assert list(message.data) == [1.0, 0.1, 0.2, 0.9]
    assert [(d.size, d.stride) for d in message.layout.dim] == [(2, 4), (2, 2)]


def status(state: RunState, **changes: object) -> RunStatus:
    return RunStatus(run_id="run-1", name="self_calibrate", state=state, message="step 3", **changes)  # type: ignore[arg-type]


def message_of(run: RunStatus, *, in_force: str = "", problem: str = "") -> DiagnosticStatus:
    return over_the_wire(status_message(run, name="n", device_id="d", facts={"stream": "alive"}, in_force=in_force, problem=problem))


@pytest.mark.parametrize(
    ("state", "problem", "level"),
    [
        (RunState.IDLE, "", DiagnosticStatus.OK),
        (RunState.RUNNING, "", DiagnosticStatus.OK),
        (RunState.DONE, "", DiagnosticStatus.OK),
        (RunState.DONE, "no stream", DiagnosticStatus.WARN),
        (RunState.CANCELLED, "", DiagnosticStatus.WARN),
        (RunState.FAILED, "", DiagnosticStatus.ERROR),
        (RunState.FAILED, "no stream", DiagnosticStatus.ERROR),
    ],
)
def test_the_level_says_how_bad_it_is(state: RunState, problem: str, level: bytes) -> None:
    assert message_of(status(state), problem=problem).level == level


def test_a_failure_names_its_run_and_what_stays_in_force() -> None:
    failed = status(RunState.FAILED)
    assert message_of(failed, in_force="rec-1").message == "run run-1 failed: step 3 Calibration rec-1 stays in force."
    assert message_of(failed).message == "run run-1 failed: step 3 No calibration is in force."
    assert message_of(status(RunState.CANCELLED), in_force="rec-1").message.startswith("run run-1 cancelled: step 3")
    assert values(message_of(failed, in_force="rec-1"))["message"] == message_of(failed, in_force="rec-1").message


def test_status_has_its_keys_and_results_with_units() -> None:
    results = {"bias": Quantity(12.5, 0.25, "deg/h")}
    found = values(message_of(status(RunState.RUNNING, fraction=0.25, eta_s=12.34, results=results)))
    assert list(found)[:5] == ["run", "state", "fraction", "eta_s", "message"]
    assert (found["run"], found["state"], found["fraction"], found["eta_s"]) == ("run-1", "running", "0.25", "12.3")
    assert (found["bias [deg/h]"], found["bias.sd [deg/h]"]) == ("12.5", "0.25")
    assert found["stream"] == "alive"
    assert values(message_of(status(RunState.RUNNING)))["eta_s"] == "unknown"


def test_a_self_test_passes_only_if_every_check_does() -> None:
    checks = [SelfCheck("a", True, "fine"), SelfCheck("b", True, "mind", warning=True)]
    passed = over_the_wire(self_test_response(SelfTest.Response(), "d", checks))
    assert (passed.passed, passed.id) == (b"\x01", "d")
    assert [s.level for s in passed.status] == [DiagnosticStatus.OK, DiagnosticStatus.WARN]
    failed = over_the_wire(self_test_response(SelfTest.Response(), "d", [*checks, SelfCheck("c", False, "bad", {"x [V]": 1.5})]))
    assert failed.passed == b"\x00"
    assert failed.status[2].level == DiagnosticStatus.ERROR
    assert values(failed.status[2]) == {"x [V]": "1.5"}
