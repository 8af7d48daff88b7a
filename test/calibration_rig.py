"""A gyro that can be spoiled, the calibration node beside it, and somebody who calls and listens: all real nodes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from calibration_samples import make_record
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from diagnostic_msgs.srv import SelfTest
from geometry_msgs.msg import TwistWithCovarianceStamped, Vector3Stamped
from ros_helpers import FakeGyro, Listener, RosSession, overrides, wait_for
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import Trigger

from gyro_calib.calibration import CalibrationRecord, RecordStore
from gyro_calib.nodes.calibration_messages import record_from_calibration
from gyro_calib.nodes.calibration_node import CalibrationNode
from gyro_calib.nodes.gyro_sim_node import make_simulator
from gyro_calib.nodes.runtime import LATCHED_QOS
from gyro_calib.recording.command import Command

__all__ = ["DEVICE", "CalibrationClient", "Rig", "store_record"]

#: the unit that seed 7 draws
DEVICE = "ring_15k-0007"
SPEED = 40.0


def store_record(device_id: str = DEVICE, **changes: Any) -> CalibrationRecord:
    """Put a record into the default store of a device, as an earlier run would have."""
    record = make_record(device_id, **{"condition_number": 120.0, **changes})
    RecordStore(None, device_id).save(record)
    return record


class CalibrationClient:
    """Calls the services of a calibration node and hears its latched topics."""

    def __init__(self, ros: RosSession, namespace: str = "/", name: str = "gyro_calibration") -> None:
        self.ros, self.name = ros, name
        self.node = ros.node("operator", namespace)
        self.status = self._listen(DiagnosticStatus, "status")
        self.calibration = self._listen(DiagnosticArray, "calibration")
        self.bias = self._listen(TwistWithCovarianceStamped, "bias")
        self.scale_factor = self._listen(Vector3Stamped, "scale_factor")
        self.compensation = self._listen(Float64MultiArray, "compensation")
        self.is_calibrated = self._listen(Bool, "is_calibrated")

    def _listen(self, kind: type[Any], topic: str) -> Listener:
        return self.ros.listen(self.node, kind, f"{self.name}/{topic}", LATCHED_QOS)

    def call(self, name: str) -> Any:
        """Call a Trigger service."""
        return self.ros.call(self.node, Trigger, f"{self.name}/{name}")

    def self_test(self) -> dict[str, Any]:
        """Verdict (``"passed"``), id (``"id"``) and the status of each check by its name."""
        response = self.ros.call(self.node, SelfTest, f"{self.name}/self_test")
        return {"passed": response.passed, "id": response.id, **{s.name: s for s in response.status}}

    @property
    def values(self) -> dict[str, str]:
        """Key values of the latest status."""
        return {pair.key: pair.value for pair in self.status.messages[-1].values} if self.status.messages else {}

    @property
    def text(self) -> str:
        """Message of the latest status."""
        return self.status.messages[-1].message if self.status.messages else ""

    @property
    def published_record(self) -> CalibrationRecord | None:
        """What ``~/calibration`` says is in force; waits for its first message."""
        return record_from_calibration(self.calibration.wait()[-1])

    @property
    def calibrated(self) -> bool:
        """What ``~/is_calibrated`` says; waits for its first message."""
        return bool(self.is_calibrated.wait()[-1].data)

    def wait_record(self, record: CalibrationRecord | None) -> None:
        """Wait until ``record`` is published as the one in force."""
        wait_for(lambda: self.published_record == record, 20.0, f"{record.record_id if record else None} on ~/calibration")

    def wait_value(self, key: str, value: str, timeout_s: float = 30.0) -> None:
        """Wait for a key value of the status."""
        wait_for(lambda: self.values.get(key) == value, timeout_s, f"{key} = {value}, status: {self.text}")

    def wait_text(self, text: str, timeout_s: float = 30.0) -> None:
        """Wait for a text in the message of the status."""
        wait_for(lambda: text in self.text, timeout_s, f"{text!r} in the status")

    def wait_ready(self, device_id: str = DEVICE) -> None:
        """Wait until the node knows its gyro and hears its stream."""
        self.wait_value("device_id", device_id)
        self.wait_value("stream", "alive")

    def run(self, name: str = "self_calibrate") -> str:
        """Start a run that must be accepted; returns its id."""
        response = self.call(name)
        assert response.success, response.message
        assert response.message.startswith("accepted run "), response.message
        return response.message.split()[2]

    def wait_end(self, run_id: str, timeout_s: float = 60.0) -> str:
        """Wait for the end of a run; returns its state."""

        def ended() -> bool:
            values = self.values
            return values.get("run") == run_id and values.get("state") in ("done", "failed", "cancelled")

        wait_for(ended, timeout_s, f"the end of {run_id}")
        return self.values["state"]


class Rig(CalibrationClient):
    """Gyro, calibration node and client in one process, the stream alive and the device known.

    Parameters
    ----------
    ros : RosSession
        Serves them.
    gyro : FakeGyro, optional
        Default: the slow flow of unit 7, at 40 times real time.
    wait : bool
        Wait until the node knows its gyro.
    **parameters
        Of the calibration node.
    """

    def __init__(self, ros: RosSession, gyro: FakeGyro | None = None, *, wait: bool = True, **parameters: Any) -> None:
        super().__init__(ros)
        self.gyro = gyro or ros.add(FakeGyro(make_simulator, fidelity="slow_flow", seed=7, realtime_factor=SPEED))
        settings = {"plan_quality": "quick", "stream_timeout_s": 1.5, **parameters}
        self.calibrator = ros.add(CalibrationNode(parameter_overrides=overrides(settings)))
        if wait:
            self.wait_ready(self.gyro._sim.device_id)

    @property
    def gyro_command(self) -> Command:
        """What the gyro really does."""
        return self.gyro._sim.command


def record_file(device_id: str = DEVICE) -> Path:
    """Where the record of a device is by default."""
    return RecordStore(None, device_id).path
