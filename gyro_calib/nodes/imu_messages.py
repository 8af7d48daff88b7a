"""Samples of one to three gyros into sensor_msgs/Imu; one message, filled again and again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from sensor_msgs.msg import Imu

from ..calibration import SenseAxes
from .stamps import Sample

__all__ = ["ImuFiller"]


class ImuFiller:
    """Fills one preallocated message; publish it before filling it again.

    ``orientation_covariance[0]`` is -1 (no orientation, REP 145), and so is ``linear_acceleration_covariance[0]`` without an accelerometer.

    Parameters
    ----------
    axes : SenseAxes
        Sense axis of each gyro in the frame of the output.
    frame_id : str
        Frame of the output; "" for that of the first gyro.
    accel_max_age_s : float
        Largest difference of stamps between rate and acceleration [s].
    """

    def __init__(self, axes: SenseAxes, frame_id: str = "", accel_max_age_s: float = 0.1) -> None:
        self.message = Imu()
        self.message.orientation_covariance[0] = -1.0
        self.message.linear_acceleration_covariance[0] = -1.0
        self._frame_id = frame_id
        # Python floats: three products of them cost less than one call of numpy
        self._rows = [tuple(float(m) for m in row) for row in axes.inverse]
        self._unit = np.array(axes.unit_covariances)
        self._unsensed = np.array(axes.unsensed_covariance)
        self._variances = np.zeros(len(axes))
        self._covariance = self.message.angular_velocity_covariance
        self.accel_max_age_s = accel_max_age_s
        self._accel: Any = None
        self._accel_ns = 0
        self._accel_given: Imu | None = None
        #: frame of an acceleration that was left out because it is not that of the output; "" when none was
        self.accel_frame_refused = ""

    def set_acceleration(self, message: Any) -> None:
        """Take the newest acceleration; it goes out with rates of about the same time."""
        stamp = message.header.stamp
        self._accel, self._accel_ns = message, stamp.sec * 1_000_000_000 + stamp.nanosec

    def fill(self, samples: Sequence[Sample]) -> Imu:
        """Return the message of one sample of each gyro; stamp and frame are those of the first one."""
        stamp_ns, rate, variance, header = samples[0]
        message, covariance = self.message, self._covariance
        velocity = message.angular_velocity
        (x, y, z) = self._rows
        if len(samples) == 1:
            velocity.x, velocity.y, velocity.z = x[0] * rate, y[0] * rate, z[0] * rate
            np.multiply(self._unit[0], variance, out=covariance)
        else:
            rates = [sample[1] for sample in samples]
            velocity.x = sum(map(_product, x, rates))
            velocity.y = sum(map(_product, y, rates))
            velocity.z = sum(map(_product, z, rates))
            for i, sample in enumerate(samples):
                self._variances[i] = sample[2]
            np.dot(self._variances, self._unit, out=covariance)
        np.add(covariance, self._unsensed, out=covariance)
        if self._frame_id:
            header.frame_id = self._frame_id
        message.header = header
        if self._accel is not None:
            self._fill_acceleration(self._accel, stamp_ns, header.frame_id)
        return message

    def _fill_acceleration(self, newest: Any, stamp_ns: int, frame_id: str) -> None:
        accel = newest
        same_frame = accel.header.frame_id in ("", frame_id)
        self.accel_frame_refused = "" if same_frame else accel.header.frame_id
        if not same_frame or abs(stamp_ns - self._accel_ns) > self.accel_max_age_s * 1e9:
            accel = None
        if accel is self._accel_given:
            return
        self._accel_given = accel
        given = self.message.linear_acceleration
        if accel is None:
            given.x = given.y = given.z = 0.0
            self.message.linear_acceleration_covariance[:] = 0.0
            self.message.linear_acceleration_covariance[0] = -1.0
        else:
            given.x, given.y, given.z = accel.linear_acceleration.x, accel.linear_acceleration.y, accel.linear_acceleration.z
            self.message.linear_acceleration_covariance[:] = accel.linear_acceleration_covariance


def _product(a: float, b: float) -> float:
    return a * b
