"""Collect the raw and the calibrated rate of a gyro for a while of device time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import GyroCalibError
from .ros_client import RosClient

__all__ = ["CapturedRate", "RateCapture"]


@dataclass(frozen=True)
class CapturedRate:
    """``time_s`` (stamps) and ``rate_rad_s``, shape (n,)."""

    time_s: NDArray[np.float64]
    rate_rad_s: NDArray[np.float64]


class RateCapture:
    """Listens to ``rate_raw`` and ``imu/data_raw`` from its making on.

    Parameters
    ----------
    client : RosClient
        Whose node listens.
    """

    def __init__(self, client: RosClient) -> None:
        from geometry_msgs.msg import TwistStamped
        from sensor_msgs.msg import Imu

        from ..nodes.runtime import SENSOR_SUB_QOS

        self._client = client
        self._raw: list[tuple[float, float]] = []
        self._calibrated: list[tuple[float, float]] = []
        self._subscriptions = [
            client.node.create_subscription(TwistStamped, "rate_raw", self._on_raw, SENSOR_SUB_QOS),
            client.node.create_subscription(Imu, "imu/data_raw", self._on_imu, SENSOR_SUB_QOS),
        ]

    def collect(
        self, duration_s: float, on_progress: Callable[[float], None], still_there: Callable[[], None], *, silence_s: float = 30.0
    ) -> tuple[CapturedRate, CapturedRate]:
        """Forget what came so far, collect ``duration_s`` of device time and stop listening; returns (raw, calibrated).

        Raises
        ------
        GyroCalibError
            A topic stays silent for ``silence_s`` of wall time.
        """
        self._raw.clear()
        self._calibrated.clear()
        while (share := min(map(_span, (self._raw, self._calibrated))) / duration_s) < 1.0:
            self._wait_for_news(silence_s)
            still_there()
            on_progress(share)
        for subscription in self._subscriptions:
            self._client.node.destroy_subscription(subscription)
        return _captured(self._raw), _captured(self._calibrated)

    def _wait_for_news(self, silence_s: float) -> None:
        raw, calibrated = len(self._raw), len(self._calibrated)
        if not self._client.spin_until(lambda: len(self._raw) > raw and len(self._calibrated) > calibrated, silence_s):
            raise GyroCalibError(f"rate_raw and imu/data_raw must both be published, but one is silent for {silence_s:g} s. See the log.")

    def _on_raw(self, message: Any) -> None:
        self._raw.append((_seconds(message), message.twist.angular.z))

    def _on_imu(self, message: Any) -> None:
        self._calibrated.append((_seconds(message), message.angular_velocity.z))


def _seconds(message: Any) -> float:
    return float(message.header.stamp.sec) + 1e-9 * float(message.header.stamp.nanosec)


def _span(samples: list[tuple[float, float]]) -> float:
    return samples[-1][0] - samples[0][0] if samples else 0.0


def _captured(samples: list[tuple[float, float]]) -> CapturedRate:
    data = np.array(samples, dtype=float)
    return CapturedRate(data[:, 0], data[:, 1])
