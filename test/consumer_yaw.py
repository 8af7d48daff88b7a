"""A stranger's program: integrates yaw from standard messages only. It knows nothing of gyro_calib, and must not.

python consumer_yaw.py --imu /gyro/imu/data_raw --rate-raw /gyro/rate_raw --seconds 600
prints JSON: yaw from sensor_msgs/Imu and from geometry_msgs/TwistStamped over the same stretch of message time.
"""

import argparse
import json
import math
import sys
import time

import rclpy
from geometry_msgs.msg import TwistStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu


class Yaw:
    """Sum of rate times the time since the sample before."""

    def __init__(self):
        self.first_s = self.last_s = None
        self.angle_rad = 0.0
        self.samples = 0

    def add(self, stamp, rate_rad_s, start_s, end_s):
        """Take one sample if it lies in the stretch."""
        now_s = stamp.sec + 1e-9 * stamp.nanosec
        if start_s is None or now_s < start_s or now_s > end_s:
            return
        if self.last_s is None:
            self.first_s = now_s
        else:
            self.angle_rad += rate_rad_s * (now_s - self.last_s)
        self.last_s = now_s
        self.samples += 1

    def report(self):
        """Plain numbers."""
        duration_s = self.last_s - self.first_s
        return {"yaw_deg": math.degrees(self.angle_rad), "duration_s": duration_s, "samples": self.samples}


def main():
    """Integrate and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--imu", default="/gyro/imu/data_raw")
    parser.add_argument("--rate-raw", default="/gyro/rate_raw")
    parser.add_argument("--seconds", type=float, default=600.0, help="stretch of message time")
    parser.add_argument("--patience", type=float, default=60.0, help="wall time without a message that ends it")
    arguments = parser.parse_args()

    rclpy.init()
    node = rclpy.create_node("yaw_consumer")
    quality = QoSProfile(depth=5000, reliability=ReliabilityPolicy.BEST_EFFORT)
    yaw = {"imu": Yaw(), "rate_raw": Yaw()}
    stretch = {"start": None, "end": None, "heard": time.monotonic()}
    orientation = []

    def on_imu(message):
        stretch["heard"] = time.monotonic()
        if stretch["start"] is None and yaw["rate_raw"].last_s is None:
            # begin a little later, when both streams are certainly there
            stretch["start"] = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec + 1.0
            stretch["end"] = stretch["start"] + arguments.seconds
        orientation.append(message.orientation_covariance[0])
        yaw["imu"].add(message.header.stamp, message.angular_velocity.z, stretch["start"], stretch["end"])
        stretch["now"] = message.header.stamp.sec

    def on_rate(message):
        yaw["rate_raw"].add(message.header.stamp, message.twist.angular.z, stretch["start"], stretch["end"])

    node.create_subscription(TwistStamped, arguments.rate_raw, on_rate, quality)
    node.create_subscription(Imu, arguments.imu, on_imu, quality)
    executor = rclpy.executors.SingleThreadedExecutor()
    executor.add_node(node)
    while stretch["end"] is None or stretch["now"] <= stretch["end"] + 1.0:
        executor.spin_once(timeout_sec=0.1)
        if time.monotonic() - stretch["heard"] > arguments.patience:
            print(f"no message on {arguments.imu} for {arguments.patience:g} s", file=sys.stderr)
            return 1
    print(json.dumps({name: one.report() for name, one in yaw.items()} | {"orientation_covariance_0": max(orientation)}))
    node.destroy_node()
    rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
