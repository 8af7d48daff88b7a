"""imu_corrector against a bare rclpy relay: CPU time of a sample, time from a sample to its answer, largest rate without loss.

python benchmarks/corrector_vs_relay.py [--quick] [--json FILE]

Three processes take turns on the same stream of rate_raw: the corrector with a record in force, a relay that copies the rate into a
sensor_msgs/Imu, and one that publishes the very message it took. The gate is on the CPU time of the corrector's process over the first
relay's, all its threads, those of the middleware included: what other processes do on the machine changes it little. Latency is that of a
sample sent when the one before has come back; the largest rate is with 64 samples under way. Both include the driving program.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from common import Options, Outcome, main, ratio, spread
from ros_room import ros_room

from gyro_calib.calibration import CalibrationRecord, RecordStore
from gyro_calib.cli.processes import NODES, NodeGroup, ros_arguments
from gyro_calib.quantity import Quantity
from gyro_calib.study import Gate

HERE = Path(__file__).resolve().parent
LIMIT = 1.3
DEVICE = "bench-1"
#: samples sent and not yet answered, in a flood
UNDER_WAY = 64
RAW_RAD_S, BIAS_RAD_S, SCALE_FACTOR = 0.01, 1e-3, 1.02


def measure(options: Options) -> Outcome:
    """Rounds of each process in turn, after one that nobody counts."""
    try:
        import rclpy  # noqa: F401
    except ImportError:
        return Outcome([], {"skipped": "rclpy is not installed"})
    rounds, samples = (3, 2000) if options.quick else (9, 6000)
    with _session() as lines:
        for line in lines:
            line.flood(1000)
        cpu: dict[str, list[float]] = {line.name: [] for line in lines}
        rate: dict[str, list[float]] = {line.name: [] for line in lines}
        latency: dict[str, list[float]] = {line.name: [] for line in lines}
        for _ in range(rounds):
            for line in lines:
                before = line.cpu_s()
                rate[line.name].append(line.flood(samples))
                cpu[line.name].append((line.cpu_s() - before) / samples)
            for line in lines:
                latency[line.name] += line.ping(samples // 20)
    return Outcome(_gates(cpu, latency, rate))


def _gates(cpu: dict[str, list[float]], latency: dict[str, list[float]], rate: dict[str, list[float]]) -> list[Gate]:
    gates = []
    measured = (("CPU time of a sample", "us", 1e6, cpu), ("latency", "us", 1e6, latency), ("rate", "1/s", 1.0, rate))
    for words, unit, scale, found in measured:
        each = {name: spread(scale * np.array(values), unit) for name, values in found.items()}
        gates += [Gate(f"{words}, {name}", value) for name, value in each.items()]
        for other in ("relay to Imu", "relay"):
            # above 1: the corrector is the slower one
            above, below = ("corrector", other) if words != "rate" else (other, "corrector")
            gated = {"upper": LIMIT} if other == "relay to Imu" and words.startswith("CPU") else {}
            gates.append(Gate(f"{words}, {above} / {below}", ratio(each[above], each[below]), **gated))
        if words == "latency":
            gates += [Gate(f"latency, 99 %, {name}", Quantity(float(np.quantile(v, 0.99)) * 1e6, 0.0, "us")) for name, v in found.items()]
    return gates


@dataclass
class Line:
    """One process with its topics: what goes in at rate_raw comes out at imu/data_raw."""

    name: str
    pid: int
    node: Any
    executor: Any
    publisher: Any
    message: Any

    def __post_init__(self) -> None:
        self.taken = 0
        self.last: Any = None

    def take(self, message: Any) -> None:
        """Count what came back."""
        self.taken += 1
        self.last = message

    def cpu_s(self) -> float:
        """CPU time of the process so far, all threads [s]; to the nanosecond, where its clock ticks are coarse."""
        return sum(int(task.read_text().split()[0]) for task in Path(f"/proc/{self.pid}/task").glob("*/schedstat")) * 1e-9

    def send(self) -> None:
        """Publish one sample with the time of now."""
        now = time.time_ns()
        stamp = self.message.header.stamp
        stamp.sec, stamp.nanosec = divmod(now, 1_000_000_000)
        self.publisher.publish(self.message)

    def flood(self, samples: int) -> float:
        """Samples per second with :data:`UNDER_WAY` under way."""
        first, sent = self.taken, 0
        began = time.perf_counter()
        while self.taken - first < samples:
            while sent < samples and sent - (self.taken - first) < UNDER_WAY:
                self.send()
                sent += 1
            self._serve(f"{samples} samples", began)
        return samples / (time.perf_counter() - began)

    def ping(self, samples: int) -> list[float]:
        """Time from sending a sample to its answer [s], one at a time."""
        found = []
        for _ in range(samples):
            wanted, began = self.taken + 1, time.perf_counter()
            self.send()
            while self.taken < wanted:
                self._serve("a sample", began)
            found.append(time.perf_counter() - began)
        return found

    def connected(self) -> bool:
        """Whether the process hears the driver and the driver the process, and answers."""
        return self.publisher.get_subscription_count() > 0 and self.node.count_publishers(f"{self.node.get_namespace()}/imu/data_raw") > 0

    def _serve(self, what: str, began: float) -> None:
        self.executor.spin_once(timeout_sec=0.1)
        if time.perf_counter() - began > 60.0:
            raise RuntimeError(f"{self.name} must answer {what} within 60 s, but did not.")


@contextmanager
def _session() -> Iterator[list[Line]]:
    """The three processes in a domain of their own, connected and answering."""
    import rclpy

    path = os.pathsep.join(filter(None, (str(HERE), os.environ.get("PYTHONPATH", ""))))
    with ros_room(PYTHONPATH=path) as folder:
        RecordStore(f"{folder}/record.yaml", DEVICE).save(_record())
        corrector = {"device_ids": [DEVICE], "record_urls": [f"{folder}/record.yaml"]}
        modules = {
            "corrector": (NODES["imu_corrector"], corrector),
            "relay to Imu": ("relay_node", {"output": "imu"}),
            "relay": ("relay_node", {"output": "twist"}),
        }
        said: list[str] = []
        rclpy.init(args=[])
        try:
            with NodeGroup({}, lambda name, line: said.append(f"{name}: {line}")) as group:
                lines = []
                for k, (name, (module, parameters)) in enumerate(modules.items()):
                    pid = group.start(name, module, ros_arguments(f"line{k}", parameters))
                    lines.append(_line(name, f"line{k}", pid))
                _connect(lines, said)
                yield lines
                for line in lines:
                    line.node.destroy_node()
        finally:
            rclpy.try_shutdown()


def _line(name: str, namespace: str, pid: int) -> Line:
    from geometry_msgs.msg import TwistStamped
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node
    from sensor_msgs.msg import Imu

    from gyro_calib.nodes.runtime import SENSOR_PUB_QOS, SENSOR_SUB_QOS

    # a driver's node of its own for each: what waits for one process does not wake the others
    node = Node("driver", namespace=namespace)
    message = TwistStamped()
    message.header.frame_id, message.twist.angular.z = "gyro", RAW_RAD_S
    executor = SingleThreadedExecutor()
    line = Line(name, pid, node, executor, node.create_publisher(TwistStamped, "rate_raw", SENSOR_PUB_QOS), message)
    node.create_subscription(TwistStamped if name == "relay" else Imu, "imu/data_raw", line.take, SENSOR_SUB_QOS)
    executor.add_node(node)
    return line


def _connect(lines: list[Line], said: list[str]) -> None:
    deadline = time.monotonic() + 60.0
    for line in lines:
        while not line.connected() or line.taken < 50:
            if line.connected():
                line.send()
            line.executor.spin_once(timeout_sec=0.02)
            if time.monotonic() > deadline:
                raise RuntimeError(f"{line.name} must answer within 60 s, but did not: {said[-3:]}")
    corrected = lines[0].last.angular_velocity.z
    if abs(corrected - (RAW_RAD_S - BIAS_RAD_S) / SCALE_FACTOR) > 1e-12:
        raise RuntimeError(f"The corrector must have its record in force, but answered {corrected} rad/s: {said[-3:]}")


def _record() -> CalibrationRecord:
    return CalibrationRecord(
        record_id="unset",
        device_id=DEVICE,
        created_utc="2026-01-01T00:00:00Z",
        method="sideband",
        mode="ftr_x",
        bias=Quantity(BIAS_RAD_S, 1e-6, "rad/s"),
        scale_factor=Quantity(SCALE_FACTOR, 2e-5, "1"),
        bias_scale_covariance=0.0,
        rate_noise_density=Quantity(2e-5, 1e-7, "rad/s/sqrt(Hz)"),
        rate=Quantity(0.0, 1e-6, "rad/s"),
        temperature_degc=Quantity(25.0, 0.1, "degC"),
    ).with_new_id()


if __name__ == "__main__":
    sys.exit(main("corrector_vs_relay", measure))
