"""The latched topics that say which calibration is in force."""

from __future__ import annotations

import threading
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistWithCovarianceStamped, Vector3Stamped
from std_msgs.msg import Bool, Float64MultiArray

from ..calibration.record import CalibrationRecord
from .calibration_messages import bias_message, calibration_message, compensation_message, scale_factor_message
from .runtime import LATCHED_QOS

__all__ = ["CalibrationTopics"]


class CalibrationTopics:
    """Publishers of ``~/bias``, ``~/scale_factor``, ``~/compensation``, ``~/is_calibrated`` and ``~/calibration``.

    Parameters
    ----------
    node : rclpy.node.Node
        Node that publishes.
    frame_id : str
        Frame of the gyro.
    """

    def __init__(self, node: Any, frame_id: str) -> None:
        self._clock, self._frame_id = node.get_clock(), frame_id
        self._lock = threading.Lock()
        self._said: tuple[object, ...] | None = None
        self._bias = node.create_publisher(TwistWithCovarianceStamped, "~/bias", LATCHED_QOS)
        self._scale_factor = node.create_publisher(Vector3Stamped, "~/scale_factor", LATCHED_QOS)
        self._compensation = node.create_publisher(Float64MultiArray, "~/compensation", LATCHED_QOS)
        self._is_calibrated = node.create_publisher(Bool, "~/is_calibrated", LATCHED_QOS)
        self._calibration = node.create_publisher(DiagnosticArray, "~/calibration", LATCHED_QOS)

    def publish(self, record: CalibrationRecord | None, *, device_id: str, is_calibrated: bool, reason: str) -> None:
        """Publish what is in force, unless that is what was said last.

        Parameters
        ----------
        record : CalibrationRecord or None
            What is in force.
        device_id : str
            The gyro, for the message that says that nothing is.
        is_calibrated : bool
            Whether ``record`` is of the gyro that is there.
        reason : str
            Why nothing is in force.
        """
        news = (record, is_calibrated, device_id, reason if record is None else "")
        with self._lock:
            if news == self._said:
                return
            self._said = news
            stamp = self._clock.now().to_msg()
            if record is not None:
                self._bias.publish(bias_message(record, stamp, self._frame_id))
                self._scale_factor.publish(scale_factor_message(record, stamp, self._frame_id))
                self._compensation.publish(compensation_message(record))
            self._calibration.publish(calibration_message(record, stamp, device_id=device_id, reason=reason))
            self._is_calibrated.publish(Bool(data=is_calibrated))
