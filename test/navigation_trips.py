"""Trips of a wheeled robot whose truth is known, driven through a real corrector and a stranger's EKF, and how honest the EKF is.

A trip begins at a known pose; the robot drives on with a slow turn. Its gyro is wrong by a draw of what its record leaves unsure, or is a
simulated gyro with the record of its own calibration. No topic carries the truth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistStamped
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_processes import wait_for

from gyro_calib.calibration import CalibrationRecord
from gyro_calib.nodes.calibration_messages import calibration_message
from gyro_calib.nodes.runtime import LATCHED_QOS

__all__ = ["Claims", "Trip", "TripDriver", "draw_motion", "draw_raw_rate", "nees"]

FloatArray = NDArray[np.float64]
#: steps of the truth within a sample
_FINE = 20
#: samples sent before the filter's answer is waited for
_BURST = 100
#: how long an answer may take before the trip is sent again [s], and how often it is sent
_ANSWER_S = 15.0
_ATTEMPTS = 4
#: of a 6x6 covariance: rows and columns x, y, yaw
_POSE = np.ix_([0, 1, 5], [0, 1, 5])
SPEED_WALK = 1e-4
SPEED_VARIANCE = 2.5e-3


@dataclass(frozen=True)
class Trip:
    """What the robot did, n samples.

    Parameters
    ----------
    times_s : ndarray, shape (n,)
        From the start [s], evenly spaced, the first one 0.
    rate_rad_s : ndarray, shape (n,)
        True rate about the vertical [rad/s].
    pose : ndarray, shape (n, 3)
        True x, y, yaw [m, m, rad].
    speed_m_s : ndarray, shape (n,)
        Speed that the wheels measure [m/s], with the variance :data:`SPEED_VARIANCE`.
    """

    times_s: FloatArray
    rate_rad_s: FloatArray
    pose: FloatArray
    speed_m_s: FloatArray


@dataclass(frozen=True)
class Claims:
    """What the EKF said of a trip, n samples: pose (n, 3) with covariance (n, 3, 3), rate (n,) with variance (n,)."""

    pose: FloatArray
    covariance: FloatArray
    rate_rad_s: FloatArray
    rate_variance: FloatArray


def draw_motion(rng: np.random.Generator, duration_s: float, rate_hz: float, turn_rad_s: float = 0.1) -> Trip:
    """A trip at about 0.5 m/s, turning at 0.7 to 1.3 times ``turn_rad_s``; the speed walks at random as the EKF supposes."""
    count = round(duration_s * rate_hz)
    fine = np.arange(count * _FINE + 1) / (rate_hz * _FINE)
    wave = 2.0 * np.pi / duration_s
    rate = turn_rad_s * (1.0 + 0.3 * np.sin(wave * fine))
    yaw = turn_rad_s * (fine + 0.3 / wave * (1.0 - np.cos(wave * fine)))
    step_s = fine[1]
    speed = 0.5 + np.cumsum(np.sqrt(SPEED_WALK * step_s) * rng.standard_normal(fine.size))
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    path = np.cumsum(speed[:-1, None] * step_s * np.column_stack((np.cos(middle), np.sin(middle))), axis=0)
    pose = np.column_stack((np.vstack(([0.0, 0.0], path)), yaw))
    measured = speed[::_FINE] + np.sqrt(SPEED_VARIANCE) * rng.standard_normal(count + 1)
    return Trip(fine[::_FINE], rate[::_FINE], pose[::_FINE], measured)


def draw_raw_rate(rng: np.random.Generator, record: CalibrationRecord, trip: Trip) -> FloatArray:
    """Raw rate (n,) [rad/s] of a gyro whose bias and scale factor are off the record's by a draw of their covariance."""
    off = record.bias_scale_covariance
    bias, scale = rng.multivariate_normal(
        [record.bias.value, record.scale_factor.value], [[record.bias.sd**2, off], [off, record.scale_factor.sd**2]]
    )
    noise = record.rate_noise_density.value * np.sqrt(0.5 / trip.times_s[1])
    return np.asarray(scale * trip.rate_rad_s + bias + noise * rng.standard_normal(trip.times_s.size))


def nees(trip: Trip, claims: Claims, k: int) -> dict[str, float]:
    """Normalised errors squared at sample ``k``: of the rate and the yaw, which are 1 in the mean for honest claims, and of the pose, 3."""
    error = claims.pose[k] - trip.pose[k]
    error[2] = np.angle(np.exp(1j * error[2]))
    covariance = claims.covariance[k]
    return {
        "rate": float((claims.rate_rad_s[k] - trip.rate_rad_s[k]) ** 2 / claims.rate_variance[k]),
        "yaw": float(error[2] ** 2 / covariance[2, 2]),
        "pose": float(error @ np.linalg.solve(covariance, error)),
    }


class TripDriver:
    """Plays the gyro's driver and the wheels, and listens to the EKF; the corrector and the EKF are processes of their own.

    Parameters
    ----------
    node : Node
        Served by somebody else's thread; publishes ``rate_raw``, a record, ``wheels/odom`` and ``set_pose``, hears ``odometry/filtered``.
    corrector : str
        Full name of the corrector's node.
    wait : callable
        ``wait(condition, timeout_s, what)``.
    """

    def __init__(self, node: Node, corrector: str, wait: Callable[..., Any] = wait_for) -> None:
        quality = QoSProfile(depth=2000, reliability=ReliabilityPolicy.RELIABLE)
        self._node, self._wait = node, wait
        self._rate = node.create_publisher(TwistStamped, "rate_raw", quality)
        self._wheels = node.create_publisher(Odometry, "wheels/odom", quality)
        self._pose = node.create_publisher(PoseWithCovarianceStamped, "set_pose", quality)
        self._record = node.create_publisher(DiagnosticArray, "gyro_calibration/calibration", LATCHED_QOS)
        self._status: list[str] = []
        node.create_subscription(Odometry, "odometry/filtered", self._hear, quality)
        node.create_subscription(DiagnosticStatus, f"{corrector}/status", lambda m: self._status.append(m.message), LATCHED_QOS)
        self._parameters = node.create_client(SetParameters, f"{corrector}/set_parameters")
        self._heard: dict[int, Any] = {}
        self._last_ns = 0
        self._now_ns = 1_000_000_000_000

    def ready(self) -> bool:
        """Whether everybody has found everybody."""
        publishers = (self._rate, self._wheels, self._pose, self._record)
        return all(publisher.get_subscription_count() for publisher in publishers) and self._parameters.service_is_ready()

    def set(self, **parameters: Any) -> None:
        """Set parameters of the corrector; they are in force when it has answered."""
        wanted = [Parameter(name, value=value).to_parameter_msg() for name, value in parameters.items()]
        future = self._parameters.call_async(SetParameters.Request(parameters=wanted))
        self._wait(future.done, 30.0, "the corrector's parameters")
        assert all(result.successful for result in future.result().results), future.result()

    def calibrate(self, record: CalibrationRecord) -> None:
        """Publish a record; the corrector has it in force afterwards."""
        self._record.publish(calibration_message(record, self._node.get_clock().now().to_msg()))
        self._wait(lambda: bool(self._status) and f"Corrected by {record.record_id}" in self._status[-1], 30.0, "the record in force")

    def drive(self, trip: Trip, raw_rad_s: Sequence[float] | FloatArray) -> Claims:
        """Send a trip, no faster than the EKF follows; returns what the EKF said. Every sample comes through, or the trip is sent again.

        To be found is not to have found: a filter that has not matched this listener yet answers to nobody. And the corrector hears its raw
        rates at best effort. What an earlier attempt left on its way is older than the pose that begins the next one, and the EKF drops it.
        """
        for attempt in range(_ATTEMPTS):
            try:
                heard = self._attempt(trip, raw_rad_s)
            except AssertionError:
                if attempt == _ATTEMPTS - 1:
                    raise
                continue
            if heard is not None:
                return Claims(*(np.array(column) for column in zip(*heard, strict=True)))
        raise AssertionError(f"samples were lost in each of {_ATTEMPTS} attempts at a trip")

    def _attempt(self, trip: Trip, raw_rad_s: Sequence[float] | FloatArray) -> list[Any] | None:
        """What the EKF said to each sample, None if one was lost; AssertionError where no answer came."""
        self._heard.clear()
        self._now_ns += 10_000_000_000
        stamps = [self._now_ns + round(1e9 * float(time)) for time in trip.times_s]
        self._now_ns = stamps[-1]
        start = PoseWithCovarianceStamped()
        _stamp(start, stamps[0])
        start.pose.pose.orientation.w = 1.0
        self._pose.publish(start)
        self._wait(lambda: self._last_ns == stamps[0], _ANSWER_S, "the EKF's start")
        for first in range(0, len(stamps), _BURST):
            chosen = range(first, min(first + _BURST, len(stamps)))
            for k in chosen:
                self._send_speed(stamps[k], float(trip.speed_m_s[k]))
            for k in chosen:
                self._send_rate(stamps[k], float(raw_rad_s[k]))
            self._wait(lambda last=stamps[chosen[-1]]: self._last_ns >= last, _ANSWER_S, f"the EKF's answer to sample {chosen[-1]}")
        return [self._heard[stamp] for stamp in stamps] if self._heard.keys() >= set(stamps) else None

    def _send_speed(self, stamp_ns: int, speed_m_s: float) -> None:
        message = Odometry()
        _stamp(message, stamp_ns)
        message.child_frame_id = "base_link"
        message.twist.twist.linear.x = speed_m_s
        message.twist.covariance[0] = SPEED_VARIANCE
        self._wheels.publish(message)

    def _send_rate(self, stamp_ns: int, raw_rad_s: float) -> None:
        message = TwistStamped()
        _stamp(message, stamp_ns)
        message.header.frame_id = "gyro"
        message.twist.angular.z = raw_rad_s
        self._rate.publish(message)

    def _hear(self, message: Any) -> None:
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        pose, twist = message.pose.pose, message.twist
        yaw = 2.0 * np.arctan2(pose.orientation.z, pose.orientation.w)
        covariance = np.reshape(message.pose.covariance, (6, 6))[_POSE]
        said = ((pose.position.x, pose.position.y, yaw), covariance, twist.twist.angular.z, twist.covariance[35])
        self._heard[stamp] = said
        self._last_ns = stamp


def _stamp(message: Any, stamp_ns: int) -> None:
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
