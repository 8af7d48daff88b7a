"""Records, run states and self-checks as standard messages, and a record back from its message. Every key names its unit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import TwistWithCovarianceStamped, Vector3Stamped
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from ..calibration.document import dump_record, parse_record
from ..calibration.record import CalibrationRecord
from ..errors import StoreError
from ..quantity import Quantity
from .run_manager import RunState, RunStatus
from .self_checks import SelfCheck

__all__ = [
    "CALIBRATION_NAME",
    "RECORD_KEY",
    "bias_message",
    "calibration_message",
    "compensation_message",
    "flatten_record",
    "key_values",
    "record_from_calibration",
    "scale_factor_message",
    "self_test_response",
    "status_message",
    "status_values",
]

#: ``name`` of the status that carries a record
CALIBRATION_NAME = "calibration"
#: key whose value is the whole document, as stored
RECORD_KEY = "record_yaml"

#: index of (angular z, angular z) in a 6x6 row-major covariance
_ANGULAR_Z_VARIANCE = 35

_LEVELS = {RunState.FAILED: DiagnosticStatus.ERROR, RunState.CANCELLED: DiagnosticStatus.WARN}


def key_values(values: Mapping[str, object]) -> list[KeyValue]:
    """``values`` as texts; floats to 9 digits, which is below every sd."""
    return [KeyValue(key=key, value=f"{value:.9g}" if isinstance(value, float) else str(value)) for key, value in values.items()]


def bias_message(record: CalibrationRecord, stamp: Time, frame_id: str) -> TwistWithCovarianceStamped:
    """Bias of ``rate_raw``: ``angular.z`` [rad/s] and its variance at ``covariance[35]``; nothing is said of the other five axes."""
    message = TwistWithCovarianceStamped()
    message.header.stamp, message.header.frame_id = stamp, frame_id
    message.twist.twist.angular.z = float(record.bias.value)
    message.twist.covariance[_ANGULAR_Z_VARIANCE] = float(record.bias.sd**2)
    return message


def scale_factor_message(record: CalibrationRecord, stamp: Time, frame_id: str) -> Vector3Stamped:
    """``z``: K of ``rate_raw`` [1]; ``x``, ``y``: V per rad/s with that axis as the oscillator, NaN where not found; sd in ``~/status``."""
    message = Vector3Stamped()
    message.header.stamp, message.header.frame_id = stamp, frame_id
    message.vector.z = float(record.scale_factor.value)
    for axis in ("x", "y"):
        found = record.scale_factor_by_axis.get(axis)
        setattr(message.vector, axis, math.nan if found is None else float(found.value))
    return message


def compensation_message(record: CalibrationRecord) -> Float64MultiArray:
    """Drive compensation, 2x2 row-major: rows are the drives (u_x, u_y) that leave, columns the ones that were asked for."""
    message = Float64MultiArray()
    message.layout.dim = [MultiArrayDimension(label="drive_out", size=2, stride=4), MultiArrayDimension(label="drive_in", size=2, stride=2)]
    message.data = list(record.compensation)
    return message


def flatten_record(record: CalibrationRecord) -> dict[str, object]:
    """Every value of a record under one flat key that ends in its unit."""
    flat: dict[str, object] = {}
    for key in ("record_id", "device_id", "created_utc", "method", "mode", "schema_version"):
        flat[key] = getattr(record, key)
    for key in ("bias", "scale_factor", "rate_noise_density", "rate", "temperature_degc"):
        flat |= _quantity(key.removesuffix("_degc"), getattr(record, key))
    flat["bias_scale_covariance [rad/s]"] = float(record.bias_scale_covariance)
    for key in ("bias_by_axis", "scale_factor_by_axis"):
        for axis, found in getattr(record, key).items():
            flat |= _quantity(f"{key.removesuffix('_by_axis')}.{axis}", found)
    flat["compensation [1]"] = ", ".join(f"{c:.9g}" for c in record.compensation)
    if record.compensation_covariance:
        flat["compensation.sd [1]"] = ", ".join(f"{math.sqrt(c):.3g}" for c in record.compensation_covariance[::5])
    for name, found in record.parameters.items():
        flat |= _quantity(f"parameters.{name}", found)
    for group in ("operating_point", "validity"):
        flat |= {f"{group}.{_with_unit(name)}": float(value) for name, value in getattr(record, group).items()}
    flat["condition_number [1]"] = float(record.condition_number)
    flat["not_observable"] = ", ".join(record.not_observable)
    flat["warnings"] = "; ".join(record.warnings)
    flat |= {f"provenance.{_with_unit(name)}": value for name, value in record.provenance.items()}
    return flat


def calibration_message(record: CalibrationRecord | None, stamp: Time, *, device_id: str = "", reason: str = "") -> DiagnosticArray:
    """The whole record for a consumer; without one, a status of level WARN that says why (``reason``)."""
    status = DiagnosticStatus(name=CALIBRATION_NAME)
    if record is None:
        status.level, status.hardware_id, status.message = DiagnosticStatus.WARN, device_id, reason or "not calibrated"
    else:
        status.level, status.hardware_id, status.message = DiagnosticStatus.OK, record.device_id, record.record_id
        status.values = key_values({**flatten_record(record), RECORD_KEY: dump_record(record)})
    return _array(stamp, [status])


def record_from_calibration(message: DiagnosticArray, *, device_id: str | None = None) -> CalibrationRecord | None:
    """The record inside a ``~/calibration`` message, verified; ``None`` when the message says that there is none.

    Raises
    ------
    StoreError
        The document is missing, torn, of another schema, or of another device than ``device_id``.
    """
    for status in message.status:
        if status.name != CALIBRATION_NAME:
            continue
        if status.level != DiagnosticStatus.OK:
            return None
        documents = [pair.value for pair in status.values if pair.key == RECORD_KEY]
        if len(documents) != 1:
            raise StoreError(f"Calibration message must hold one {RECORD_KEY}, but got {len(documents)}. Use a matching gyro_calib.")
        return parse_record(documents[0], device_id=device_id, source="Calibration message")
    raise StoreError(
        f"Calibration message must hold a status named {CALIBRATION_NAME!r}, but got none. Subscribe to gyro_calibration/calibration."
    )


def status_message(
    status: RunStatus, *, name: str, device_id: str, facts: Mapping[str, object], in_force: str, problem: str
) -> DiagnosticStatus:
    """State of the node for ``~/status`` and ``/diagnostics``.

    Parameters
    ----------
    status : RunStatus
        The present or last run.
    name, device_id : str
        Name of the status and identity of the gyro ("" when unknown).
    facts : mapping
        Further key values: what is in force, state of the stream, ….
    in_force : str
        Id of the record in force, "" for none.
    problem : str
        What is wrong outside a run (no stream, a refused record), "" for nothing.
    """
    sentences = [status.message]
    level = _LEVELS.get(status.state, DiagnosticStatus.WARN if status.attention else DiagnosticStatus.OK)
    if status.state in _LEVELS:
        verb = "failed" if status.state is RunState.FAILED else "cancelled"
        sentences = [
            f"run {status.run_id} {verb}: {status.message}",
            f"Calibration {in_force} stays in force." if in_force else "No calibration is in force.",
        ]
    if problem:
        sentences.append(problem)
        level = max(level, DiagnosticStatus.WARN)
    text = " ".join(sentences)
    message = DiagnosticStatus(level=level, name=name, hardware_id=device_id, message=text)
    message.values = key_values({**status_values(status), "message": text, **facts})
    return message


def status_values(status: RunStatus) -> dict[str, object]:
    """``run``, ``state``, ``fraction``, ``eta_s``, ``message``, then each result under its name and unit, then the facts."""
    values: dict[str, object] = {
        "run": status.run_id,
        "state": status.state.value,
        "fraction": round(status.fraction, 4),
        "eta_s": round(status.eta_s, 1) if math.isfinite(status.eta_s) else "unknown",
        "message": status.message,
    }
    for name, found in status.results.items():
        values |= _quantity(name, found)
    return {**values, **status.facts}


def self_test_response(response: Any, device_id: str, checks: Iterable[SelfCheck]) -> Any:
    """Fill a ``SelfTest`` response: ``passed`` is a byte, one status per check; a check that failed is an ERROR with its remedy."""
    response.id = device_id
    response.status = []
    passed = True
    for check in checks:
        passed = passed and check.passed
        level = DiagnosticStatus.OK if check.passed else DiagnosticStatus.ERROR
        if check.passed and check.warning:
            level = DiagnosticStatus.WARN
        status = DiagnosticStatus(level=level, name=check.name, message=check.message, hardware_id=device_id)
        status.values = key_values(check.values)
        response.status.append(status)
    response.passed = b"\x01" if passed else b"\x00"
    return response


def _quantity(name: str, found: Quantity) -> dict[str, float]:
    return {f"{name} [{found.unit}]": float(found.value), f"{name}.sd [{found.unit}]": float(found.sd)}


#: suffixes of names and the units that they stand for
_SUFFIXES = {"_degc": "degC", "_rad_s": "rad/s", "_hz": "Hz", "_s": "s", "_v": "V"}


def _with_unit(name: str) -> str:
    for suffix, unit in _SUFFIXES.items():
        if name.lower().endswith(suffix):
            return f"{name[: -len(suffix)]} [{unit}]"
    return name


def _array(stamp: Time, statuses: Iterable[Any]) -> DiagnosticArray:
    message = DiagnosticArray(status=list(statuses))
    message.header.stamp = stamp
    return message
