"""The least that a node can do with a rate: rate_raw in, the same rate out, in plain rclpy. What corrector_vs_relay compares with.

python -m relay_node --ros-args -p output:=imu       a sensor_msgs/Imu, as imu_corrector publishes; "twist": the message as it came
"""

from __future__ import annotations

import sys
from typing import Any

from geometry_msgs.msg import TwistStamped
from rclpy.node import Node
from sensor_msgs.msg import Imu

from gyro_calib.nodes.runtime import SENSOR_PUB_QOS, SENSOR_SUB_QOS, run_node


class Relay(Node):
    """Passes each sample on."""

    def __init__(self) -> None:
        super().__init__("relay")
        imu = self.declare_parameter("output", "imu").value == "imu"
        self._message = Imu()
        self._output = self.create_publisher(Imu if imu else TwistStamped, "imu/data_raw", SENSOR_PUB_QOS)
        self.create_subscription(TwistStamped, "rate_raw", self._as_imu if imu else self._output.publish, SENSOR_SUB_QOS)

    def _as_imu(self, message: Any) -> None:
        self._message.header = message.header
        self._message.angular_velocity.z = message.twist.angular.z
        self._output.publish(self._message)


def main() -> int:
    """Run until told to stop."""
    return run_node(Relay)


if __name__ == "__main__":
    sys.exit(main())
