"""A stranger's planar EKF: yaw rate from sensor_msgs/Imu, speed from nav_msgs/Odometry. It knows nothing of gyro_calib, and must not.

python consumer_ekf.py --ros-args -r imu:=/gyro/imu/data_raw -r odom:=/wheels/odom

Publishes ``odometry/filtered`` (nav_msgs/Odometry) with every Imu; ``set_pose`` (geometry_msgs/PoseWithCovarianceStamped) starts it anew.
State: x, y, yaw, speed. Like most filters it takes the errors of successive samples as independent, with the variances of the messages.
"""

import contextlib
import math
import sys
from collections import deque

import numpy as np
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu

YAW_RATE = 8  # of the 3x3 covariance of a rate: (z, z)
POSE = (0, 1, 5, 6, 7, 11, 30, 31, 35)  # of a 6x6 covariance: rows and columns x, y, yaw


class PlanarEkf:
    """x, y, yaw [m, m, rad] in the odom frame and the speed along x of the body [m/s], with their covariance."""

    def __init__(self, speed_walk):
        self.speed_walk = speed_walk  # variance that the speed gains a second [(m/s)^2/s]
        self.state = np.zeros(4)
        self.covariance = np.diag([0.0, 0.0, 0.0, 100.0])
        self.time = None
        self.rate = self.rate_variance = 0.0

    def predict(self, time, rate, rate_variance):
        """Move on to ``time`` [s]: the yaw by the mean of this rate and the one before [rad/s]."""
        if self.time is not None:
            dt = time - self.time
            turn = 0.5 * (self.rate + rate) * dt
            x, y, yaw, speed = self.state
            c, s = math.cos(yaw + 0.5 * turn) * dt, math.sin(yaw + 0.5 * turn) * dt
            self.state = np.array([x + speed * c, y + speed * s, yaw + turn, speed])
            step = np.array([[1.0, 0.0, -speed * s, c], [0.0, 1.0, speed * c, s], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
            self.covariance = step @ self.covariance @ step.T
            # half of the turn acts on the way: the derivative of the state by the turn
            by_turn = np.array([-0.5 * speed * s, 0.5 * speed * c, 1.0, 0.0])
            self.covariance += np.outer(by_turn, by_turn) * rate_variance * dt**2
            self.covariance[3, 3] += self.speed_walk * dt
        self.time, self.rate, self.rate_variance = time, rate, rate_variance

    def correct_speed(self, speed, variance):
        """Take a measured speed [m/s] and its variance."""
        gain = self.covariance[:, 3] / (self.covariance[3, 3] + variance)
        self.state = self.state + gain * (speed - self.state[3])
        left = np.eye(4)
        left[:, 3] -= gain
        self.covariance = left @ self.covariance @ left.T + np.outer(gain, gain) * variance


class EkfNode(Node):
    """Messages in, messages out."""

    def __init__(self):
        super().__init__("planar_ekf")
        self.walk = self.declare_parameter("speed_walk", 1e-4).value
        self.ekf = PlanarEkf(self.walk)
        self.speeds = deque()
        self.begin = None
        quality = QoSProfile(depth=2000, reliability=ReliabilityPolicy.RELIABLE)
        self.output = self.create_publisher(Odometry, "odometry/filtered", quality)
        self.create_subscription(Odometry, "odom", self.on_odom, quality)
        self.create_subscription(Imu, "imu", self.on_imu, quality)
        self.create_subscription(PoseWithCovarianceStamped, "set_pose", self.on_pose, quality)

    def on_pose(self, message):
        """Begin again at this pose, without errors but that of the speed; samples of before are not used."""
        self.ekf = PlanarEkf(self.walk)
        pose = message.pose.pose
        self.ekf.state[:3] = pose.position.x, pose.position.y, 2.0 * math.atan2(pose.orientation.z, pose.orientation.w)
        self.begin = seconds(message.header.stamp)
        self.speeds.clear()
        self.publish(message.header.stamp)

    def on_odom(self, message):
        """Keep a speed until the Imu of its time has come."""
        self.speeds.append(message)

    def on_imu(self, message):
        """Predict, then take the speeds measured until then."""
        time = seconds(message.header.stamp)
        if self.begin is None or time < self.begin:
            return
        self.ekf.predict(time, message.angular_velocity.z, message.angular_velocity_covariance[YAW_RATE])
        while self.speeds and seconds(self.speeds[0].header.stamp) <= time:
            speed = self.speeds.popleft()
            if seconds(speed.header.stamp) >= self.begin:
                self.ekf.correct_speed(speed.twist.twist.linear.x, speed.twist.covariance[0])
        self.publish(message.header.stamp)

    def publish(self, stamp):
        """The state as odometry."""
        ekf, message = self.ekf, Odometry()
        message.header.stamp, message.header.frame_id, message.child_frame_id = stamp, "odom", "base_link"
        x, y, yaw, speed = map(float, ekf.state)
        message.pose.pose.position.x, message.pose.pose.position.y = x, y
        message.pose.pose.orientation.z, message.pose.pose.orientation.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
        for place, value in zip(POSE, ekf.covariance[:3, :3].ravel().tolist(), strict=True):
            message.pose.covariance[place] = value
        message.twist.twist.linear.x, message.twist.twist.angular.z = speed, ekf.rate
        message.twist.covariance[0], message.twist.covariance[35] = float(ekf.covariance[3, 3]), ekf.rate_variance
        self.output.publish(message)


def seconds(stamp):
    """Time of a stamp [s]."""
    return stamp.sec + 1e-9 * stamp.nanosec


def main():
    """Run until told to stop."""
    rclpy.init()
    node = EkfNode()
    with contextlib.suppress(KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        rclpy.spin(node)
    node.destroy_node()
    rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
