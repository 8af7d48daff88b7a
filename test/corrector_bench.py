"""imu_corrector as a process of its own, stand-ins for gyros and calibrations, and a consumer, in one DDS domain."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from calibration_samples import make_record
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TwistStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from ros_processes import NodeProcess, start_node
from sensor_msgs.msg import Imu, Temperature
from std_srvs.srv import SetBool

from gyro_calib.calibration import CalibrationRecord
from gyro_calib.nodes.calibration_messages import calibration_message
from gyro_calib.nodes.runtime import LATCHED_QOS, SENSOR_PUB_QOS, SENSOR_SUB_QOS
from gyro_calib.quantity import Quantity

__all__ = ["DEVICE", "PERIOD_NS", "WAIT_S", "Bench", "StandIn", "corrected", "numbered", "variance"]

DEVICE = "ring_15k-0007"
WAIT_S = 30.0
PERIOD_NS = 10_000_000


class StandIn:
    """A gyro's driver and its calibration: node gyro_sim with its parameters, rate_raw, temperature, latched calibration."""

    def __init__(self, namespace: str, device_id: str | None = DEVICE, *, name: str = "gyro_sim") -> None:
        self.node = rclpy.create_node(name, namespace=namespace)
        if device_id is not None:
            self.node.declare_parameter("device_id", device_id)
            self.node.declare_parameter("mode", "ftr_x")
            self.node.declare_parameter("excitation.kind", "none")
            self.node.declare_parameter("compensation", [1.0, 0.0, 0.0, 1.0])
        self.raw, self.silent, self.stamp_ns, self.frame = 0.1, False, 1_000_000_000_000, "gyro_frame"
        self._rate = self.node.create_publisher(TwistStamped, "rate_raw", SENSOR_PUB_QOS)
        self._temperature = self.node.create_publisher(Temperature, "temperature", SENSOR_PUB_QOS)
        self._calibration = self.node.create_publisher(DiagnosticArray, "gyro_calibration/calibration", LATCHED_QOS)

    def emit(self) -> None:
        """The next sample."""
        if not self.silent:
            self.stamp_ns += PERIOD_NS
            self.send(self.raw)

    def send(self, raw: float) -> None:
        message = TwistStamped()
        message.header.frame_id = self.frame
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(self.stamp_ns, 1_000_000_000)
        message.twist.angular.z = raw
        self._rate.publish(message)

    def calibrate(self, record: CalibrationRecord | None) -> None:
        self._calibration.publish(calibration_message(record, self.node.get_clock().now().to_msg()))

    def warm(self, temperature_degc: float) -> None:
        self._temperature.publish(Temperature(temperature=temperature_degc))

    def set(self, **parameters: Any) -> None:
        self.node.set_parameters([Parameter(name, value=value) for name, value in parameters.items()])


class Bench:
    """Corrector processes, stand-ins and a consumer, in one DDS domain."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.executor = SingleThreadedExecutor()
        self.gyros: list[StandIn] = []
        self.processes: list[NodeProcess] = []
        self.imu: list[Any] = []
        self.status: list[Any] = []
        self.node = rclpy.create_node("consumer", namespace=f"/{folder.name}")
        self.executor.add_node(self.node)

    def gyro(self, *args: Any, **kwargs: Any) -> StandIn:
        gyro = StandIn(*args, **kwargs)
        self.gyros.append(gyro)
        self.executor.add_node(gyro.node)
        return gyro

    def remove(self, gyro: StandIn) -> None:
        self.gyros.remove(gyro)
        self.executor.remove_node(gyro.node)
        gyro.node.destroy_node()

    def listen(self, namespace: str) -> None:
        self.node.create_subscription(Imu, f"{namespace}/imu/data_raw", self.imu.append, SENSOR_SUB_QOS)
        self.node.create_subscription(DiagnosticStatus, f"{namespace}/imu_corrector/status", self.status.append, LATCHED_QOS)

    @property
    def ros_home(self) -> Path:
        """Where the default store of its processes is."""
        return self.folder / "ros_home"

    def start(self, namespace: str, **parameters: Any) -> NodeProcess:
        """Start imu_corrector with parameters."""
        environment = {"ROS_HOME": str(self.ros_home)}
        process = start_node("imu_corrector_node", folder=self.folder, namespace=namespace, parameters=parameters, environment=environment)
        self.processes.append(process)
        return process

    def spin(self, seconds: float = 0.0) -> None:
        end = time.monotonic() + seconds
        while True:
            for gyro in self.gyros:
                gyro.emit()
            for _ in range(10):
                self.executor.spin_once(timeout_sec=0.001)
            if time.monotonic() >= end:
                return

    def until(self, condition: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + WAIT_S
        while not condition():
            assert time.monotonic() < deadline, f"{what}; status: {self.message!r}; {len(self.imu)} Imu"
            self.spin()

    @property
    def message(self) -> str:
        return self.status[-1].message if self.status else ""

    @property
    def level(self) -> int:
        return self.status[-1].level[0] if self.status else -1

    @property
    def facts(self) -> dict[str, str]:
        return {pair.key: pair.value for pair in self.status[-1].values}

    def until_says(self, text: str) -> None:
        self.until(lambda: text in self.message, f"status must say {text!r}")

    def until_rate(self, z: float) -> Any:
        """Wait for a message of this rate, in this sample's sense and not a leftover."""
        self.imu.clear()
        self.until(lambda: bool(self.imu) and abs(self.imu[-1].angular_velocity.z - z) < 1e-12, f"rate must become {z}")
        return self.imu[-1]

    def call(self, service: str, data: bool) -> Any:
        client = self.node.create_client(SetBool, service)
        self.until(client.service_is_ready, f"service {service} must come")
        future = client.call_async(SetBool.Request(data=data))
        self.until(future.done, f"service {service} must answer")
        self.node.destroy_client(client)
        return future.result()

    def close(self) -> None:
        stopped = [process.stop() for process in self.processes]
        for gyro in list(self.gyros):
            self.remove(gyro)
        self.executor.remove_node(self.node)
        self.node.destroy_node()
        self.executor.shutdown()
        assert all(stopped), f"Nodes must end on SIGINT, but had to be killed: {[str(p) for p in self.processes]}"


def corrected(raw: float, record: CalibrationRecord) -> float:
    return (raw - record.bias.value) / record.scale_factor.value


def numbered(i: int, device_id: str = DEVICE) -> CalibrationRecord:
    return make_record(device_id, bias=Quantity(1e-3 * i, 1e-5, "rad/s"), bias_scale_covariance=0.0, validity={})


def variance(record: CalibrationRecord, rate: float) -> float:
    """Mode total at 100 samples a second, by hand."""
    k = record.scale_factor.value
    constant = record.bias.sd**2 + rate**2 * record.scale_factor.sd**2 + 2.0 * rate * record.bias_scale_covariance
    return (constant + record.rate_noise_density.value**2 * 50.0) / k**2
