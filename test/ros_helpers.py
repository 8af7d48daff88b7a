"""Nodes inside the test's process: a session that serves them, listeners, and a gyro whose stream can be spoiled."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import rclpy
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from ros_processes import NodeProcess, wait_for

from gyro_calib.nodes.gyro_sim_node import GyroSimNode
from gyro_calib.nodes.runtime import SENSOR_SUB_QOS, make_executor, spin
from gyro_calib.recording.command import Command

__all__ = ["FakeGyro", "Listener", "NodeProcess", "PlainSimulator", "RosSession", "wait_for"]

FloatArray = NDArray[np.float64]


class RosSession:
    """rclpy in this process: every node made through it is served by one thread, and destroyed in the end."""

    def __enter__(self) -> RosSession:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._nodes: list[Node] = []
        self._done = Future()
        self.executor = make_executor()
        self._thread = threading.Thread(target=spin, args=(self.executor, self._done), name="spin")
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set_result(None)
        self._thread.join(30.0)
        for node in self._nodes:
            self.executor.remove_node(node)
            node.destroy_node()
        self.executor.shutdown()
        rclpy.try_shutdown()

    def add(self, node: Node) -> Any:
        """Serve ``node``."""
        self._nodes.append(node)
        self.executor.add_node(node)
        return node

    def node(self, name: str = "tester", namespace: str = "/", **parameters: Any) -> Any:
        """A plain node."""
        return self.add(Node(name, namespace=namespace, parameter_overrides=overrides(parameters)))

    def listen(self, node: Node, kind: type[Any], topic: str, qos: Any = SENSOR_SUB_QOS) -> Listener:
        """Keep the messages of a topic."""
        return Listener(node, kind, topic, qos)

    def call(self, node: Node, kind: type[Any], service: str, request: Any = None, timeout_s: float = 30.0) -> Any:
        """Call a service of another node and return its response."""
        client = node.create_client(kind, service)
        wait_for(client.service_is_ready, timeout_s, f"service {service}")
        future = client.call_async(kind.Request() if request is None else request)
        wait_for(future.done, timeout_s, f"the answer of {service}")
        return future.result()


class Listener:
    """Messages of one topic, in order."""

    def __init__(self, node: Node, kind: type[Any], topic: str, qos: Any) -> None:
        self.messages: list[Any] = []
        self._subscription = node.create_subscription(kind, topic, self.messages.append, qos)

    @property
    def connected(self) -> bool:
        """Whether a publisher has been found."""
        return bool(self._subscription.get_publisher_count())

    def wait(self, count: int = 1, timeout_s: float = 30.0) -> list[Any]:
        """Wait until there are ``count`` messages; returns all."""
        wait_for(lambda: len(self.messages) >= count, timeout_s, f"{count} messages of {self._subscription.topic_name}")
        return self.messages


def overrides(parameters: Mapping[str, Any]) -> list[Parameter]:
    """Parameter overrides of a node."""
    return [Parameter(name, value=value) for name, value in parameters.items()]


class PlainSimulator:
    """The simplest gyro with the interface of ``GyroSimulator``: a rate channel that is exact, a little noise, no physics."""

    device_id = "plain-0001"
    sample_rate_hz = 500.0
    modes = ("ftr_x", "ftr_y", "loops_off")

    def __init__(self, bias_rad_s: float = 2e-3) -> None:
        self.command = Command()
        self.factory = {
            "kind": "ring",
            "angular_gain_kappa": 0.8,
            "nominal_f0_hz": 15_000.0,
            "nominal_q": 30_000.0,
            "adc_full_scale_V": 2.5,
            "dac_full_scale_V": 5.0,
            "nominal_scale_factor_v_per_rad_s": {"x": 0.7, "y": -0.7},
            "nominal_amplitude_v": 1.0,
        }
        self.bias_rad_s = bias_rad_s
        self.temperature_degc = 25.0
        self._rows = 0
        self._segment = 0
        self._noise = np.random.default_rng(1)

    @property
    def time_s(self) -> float:
        return self._rows / self.sample_rate_hz

    def configure(self, command: Command) -> int:
        self.command = command
        self._segment += 1
        return self._segment

    def advance(self, duration_s: float, rate_rad_s: Any = 0.0) -> FloatArray:
        count = round(duration_s * self.sample_rate_hz)
        rows = 1e-6 * self._noise.standard_normal((count, 12))
        rows[:, 0] = np.arange(self._rows + 1, self._rows + count + 1) / self.sample_rate_hz
        rows[:, 1] = self._segment
        axis = self.command.oscillator_axis
        if axis is not None:
            amplitude = self.command.setpoints.amplitude_v
            rows[:, {"x": 2, "y": 4}[axis]] += amplitude
            rows[:, {"x": 7, "y": 9}[axis]] += 0.5
            nominal = self.factory["nominal_scale_factor_v_per_rad_s"][axis]  # type: ignore[index]
            rows[:, {"x": 9, "y": 7}[axis]] += nominal * amplitude * (np.asarray(rate_rad_s) + self.bias_rad_s)
        rows[:, 10] = 15_000.0
        rows[:, 11] = self.temperature_degc
        self._rows += count
        return rows


class FakeGyro(GyroSimNode):
    """A gyro's driver in this process whose stream can be spoiled. Fast: 20 times real time unless told otherwise.

    Parameters
    ----------
    simulator : object, optional
        Default a :class:`PlainSimulator`; ``gyro_calib.nodes.gyro_sim_node.make_simulator`` gives the real one.
    namespace : str
        ROS namespace.
    **parameters
        Of ``gyro_sim``.
    """

    def __init__(self, simulator: Any = None, *, namespace: str = "/", **parameters: Any) -> None:
        self._lock = threading.Lock()
        self._faults: list[Callable[[FloatArray], list[FloatArray]]] = []
        self._watches: list[tuple[Callable[[FloatArray], bool], Callable[[], None]]] = []
        self._silent = False
        self._ramp_k_per_s, self._ramp_from_s = 0.0, None
        make = simulator if callable(simulator) else lambda settings: simulator or PlainSimulator()
        parameters = {"realtime_factor": 20.0, **parameters}
        modes = None if callable(simulator) else PlainSimulator.modes
        super().__init__(simulator=make, modes=modes, namespace=namespace, parameter_overrides=overrides(parameters))

    # -- faults, all from the next block on -----------------------------------------------------------------------------------

    def stop_stream(self) -> None:
        """Publish no more blocks."""
        self._silent = True

    def resume_stream(self) -> None:
        """Publish again."""
        self._silent = False

    def spoil(self, column: int, value: float = np.nan, row: int = 3) -> None:
        """One number of the next block becomes ``value``."""

        def fault(rows: FloatArray) -> list[FloatArray]:
            rows = rows.copy()
            rows[row, column] = value
            return [rows]

        self._add(fault)

    def repeat_block(self) -> None:
        """Publish the next block twice."""
        self._add(lambda rows: [rows, rows])

    def drop_block(self, count: int = 1) -> None:
        """Lose the next ``count`` blocks."""
        for _ in range(count):
            self._add(lambda rows: [])

    def swap_blocks(self) -> None:
        """Publish the next two blocks in the wrong order."""
        held: list[FloatArray] = []
        self._add(lambda rows: held.append(rows) or [])
        self._add(lambda rows: [rows, held[0]])

    def become(self, device_id: str) -> None:
        """Another unit is connected: the read-only parameter changes."""
        self._parameters["device_id"] = Parameter("device_id", value=device_id)

    def ramp_temperature(self, k_per_s: float) -> None:
        """The temperature column drifts."""
        self._ramp_k_per_s = k_per_s

    def move_base(self, rate_rad_s: float) -> None:
        """The gyro turns."""
        self._constant_rate = rate_rad_s

    def when(self, condition: Callable[[FloatArray], bool], action: Callable[[], None]) -> None:
        """Call ``action`` once, before the first block for which ``condition(rows)`` holds is published."""
        with self._lock:
            self._watches.append((condition, action))

    def during_segment(self, segment: int, action: Callable[[], None], after_s: float = 0.0) -> None:
        """Call ``action`` once, ``after_s`` of device time into a segment."""
        first: list[float] = []

        def reached(rows: FloatArray) -> bool:
            mine = rows[rows[:, 1] == segment]
            if len(mine) and not first:
                first.append(float(mine[0, 0]))
            return bool(first) and rows[-1, 0] >= first[0] + after_s

        self.when(reached, action)

    # -- inside -------------------------------------------------------------------------------------------------------------------

    def _add(self, fault: Callable[[FloatArray], list[FloatArray]]) -> None:
        with self._lock:
            self._faults.append(fault)

    def publish_block(self, rows: FloatArray) -> None:
        with self._lock:
            due = [watch for watch in self._watches if watch[0](rows)]
            self._watches = [watch for watch in self._watches if watch not in due]
        for _, action in due:
            action()
        rows = self._ramped(rows)
        with self._lock:
            fault = self._faults.pop(0) if self._faults else None
        for block in [rows] if fault is None else fault(rows):
            if not self._silent:
                super().publish_block(block)

    def _ramped(self, rows: FloatArray) -> FloatArray:
        if not self._ramp_k_per_s:
            return rows
        if self._ramp_from_s is None:
            self._ramp_from_s = float(rows[0, 0])
        rows = rows.copy()
        rows[:, 11] += self._ramp_k_per_s * (rows[:, 0] - self._ramp_from_s)
        return rows
