"""A robot simulator in small, as Gazebo or Isaac Sim stand to a gyro: it owns /clock and says how its robot turns.

python robot_motion.py --speed 5 --ros-args -r true_rate:=/true_rate

Publishes ``/clock``, ``true_rate`` (geometry_msgs/TwistStamped, angular velocity of the body) and ``odom`` (nav_msgs/Odometry, the truth);
service ``~/pause`` (std_srvs/SetBool) holds the world. The robot drives curves: three angular velocities that differ in phase and period.
"""

import argparse
import math
import sys
import time

import rclpy
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

#: of each axis: angular velocity [rad/s] and period [s]
MOTION = {"x": (0.2, 4.0), "y": (0.3, 7.0), "z": (0.5, 5.0)}
EPOCH_S = 100.0


def angular_velocity(axis, time_s):
    """True rate about an axis of the body [rad/s] at a time of the world [s]."""
    size, period_s = MOTION[axis]
    return size * math.sin(2.0 * math.pi * time_s / period_s)


class World(Node):
    """Steps of 10 ms, ``speed`` times as fast as the wall clock."""

    def __init__(self, speed):
        super().__init__("robot_simulator")
        self.step_s = 0.01
        self.count = 0
        self.running = True
        self.began = time.monotonic()
        self.speed = speed
        quality = QoSProfile(depth=1000)
        self.clock_publisher = self.create_publisher(Clock, "/clock", quality)
        self.rate = self.create_publisher(TwistStamped, "true_rate", quality)
        self.odom = self.create_publisher(Odometry, "odom", quality)
        self.create_service(SetBool, "~/pause", self.pause)

    def pause(self, request, response):
        """Hold the world, or let it go on."""
        self.running = not request.data
        self.began = time.monotonic() - self.count * self.step_s / self.speed
        response.success = True
        return response

    def due(self):
        """Whether the next step may be taken. A world that could not keep up stays late: no simulator makes good for it in one burst."""
        ahead_s = time.monotonic() - self.began - self.count * self.step_s / self.speed
        self.began += max(0.0, ahead_s - self.step_s)
        return self.running and ahead_s >= 0.0

    def step(self):
        """One step of the world: first what the robot does from now on, then the time."""
        now_s = EPOCH_S + self.count * self.step_s
        clock, rate, odom = Clock(), TwistStamped(), Odometry()
        clock.clock.sec, clock.clock.nanosec = divmod(round(now_s * 1e9), 1_000_000_000)
        rate.header.stamp, rate.header.frame_id = clock.clock, "base_link"
        for axis in MOTION:
            setattr(rate.twist.angular, axis, angular_velocity(axis, now_s))
        odom.header.stamp, odom.header.frame_id, odom.child_frame_id = clock.clock, "odom", "base_link"
        odom.twist.twist.angular = rate.twist.angular
        self.rate.publish(rate)
        self.odom.publish(odom)
        self.clock_publisher.publish(clock)
        self.count += 1


def main():
    """Run until told to stop."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--speed", type=float, default=1.0, help="seconds of the world per second")
    arguments = parser.parse_args(rclpy.utilities.remove_ros_args()[1:])
    rclpy.init()
    world = World(arguments.speed)
    executor = rclpy.executors.SingleThreadedExecutor()
    executor.add_node(world)
    try:
        while rclpy.ok():
            executor.spin_once(timeout_sec=0.0 if world.due() else 0.001)
            if world.due():
                world.step()
    except (KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        pass
    return 0


if __name__ == "__main__":
    sys.exit(main())
