"""``gyro_sim``: a simulated gyro behind the topics and parameters of a real driver.

Publishes ``channels``, ``rate_raw``, ``temperature`` (and ``/clock`` when it is the source of time); subscribes ``true_rate``.
The simulation runs in a thread of its own, so parameter services answer at once at any pace.

Time
    ``realtime_factor`` 1 follows the node's clock: the wall clock, or with ``use_sim_time`` the ``/clock`` of a robot simulator or of
    another gyro. Any other factor makes this node the source of ``/clock``; 0 is as fast as possible, and ``max_realtime_factor`` bounds
    it so that subscribers keep up. Stamps are device time on that axis; column ``t`` is the device's own clock and starts at zero.
Commands
    One (atomic) set is one segment, also when it changes nothing. It takes effect at the next simulated step, at most one block later.
Input rate
    ``constant_rate_rad_s`` plus component ``gyro_axis`` of ``true_rate``, which holds from its stamp until the next one, or, if
    ``true_rate_timeout_s`` > 0, counts as 0 (with a warning) when nobody renews it for that long. A rate that is not finite is ignored.
"""

from __future__ import annotations

import json
import queue
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from geometry_msgs.msg import TwistStamped
from numpy.typing import NDArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Temperature
from std_msgs.msg import Float64MultiArray

from ..device import draw_unit, load_device
from ..errors import DataError, GyroCalibError
from ..experiments import mission_mode
from ..recording.command import Command
from ..recording.rate import raw_rate
from ..simulation import GyroSimulator
from ..simulation.loops import supported_modes
from .blocks import block_from_rows
from .command_parameters import COMMAND_NAMES, CommandLimits, changed_command, check_command, declare_command, read_command
from .pacing import FollowClock, FreeRun, Pacer
from .rate_input import RateInput
from .runtime import SENSOR_PUB_QOS, SENSOR_SUB_QOS, describe, run_node

__all__ = ["GyroSimNode", "Settings", "main", "make_simulator"]

FloatArray = NDArray[np.float64]
_NS = 1_000_000_000
#: largest input rate that a parameter or a message may ask for [rad/s]
_FASTEST_RAD_S = 100.0


@dataclass(frozen=True)
class Settings:
    """Start-up parameters of the node; the text beside each is in :func:`_declare_settings`."""

    device: str
    seed: int
    fidelity: str
    realtime_factor: float
    max_realtime_factor: float
    block_duration_s: float
    rate_raw_hz: float
    clock_epoch_s: float
    true_rate_timeout_s: float
    frame_id: str
    gyro_axis: str


def make_simulator(settings: Settings) -> GyroSimulator:
    """The unit that ``device`` and ``seed`` name, its kernels compiled before anybody waits for them.

    Raises
    ------
    DeviceError
        No such device, or a fidelity that does not exist.
    """
    device = load_device(settings.device)
    if settings.seed >= 0:
        device = draw_unit(device, settings.seed)
    rng = np.random.default_rng([0x5EED, settings.seed] if settings.seed >= 0 else None)
    GyroSimulator(device, rng=np.random.default_rng(0), fidelity=settings.fidelity).advance(0.01)
    return GyroSimulator(device, rng=rng, fidelity=settings.fidelity)


class GyroSimNode(Node):
    """Node ``gyro_sim``.

    Parameters
    ----------
    simulator : callable
        Makes the simulator (anything with the interface of :class:`~gyro_calib.simulation.GyroSimulator`) from the settings.
    modes : sequence of str
        Modes that the simulator has.
    **options
        Of :class:`rclpy.node.Node`: ``namespace``, ``context``, ``parameter_overrides``, ….
    """

    def __init__(
        self, *, simulator: Callable[[Settings], Any] = make_simulator, modes: Sequence[str] | None = None, **options: Any
    ) -> None:
        super().__init__("gyro_sim", **options)
        self.exit_code = 0
        self._stop = threading.Event()
        self._commands: queue.SimpleQueue[Command] = queue.SimpleQueue()
        self._settings = settings = _declare_settings(self)
        self._constant_rate = float(self.get_parameter("constant_rate_rad_s").value)
        self._sim = sim = simulator(settings)
        self._factory = dict(sim.factory)
        self._declare_facts()
        self._limits = CommandLimits.of(self._factory, sim.sample_rate_hz, modes or supported_modes())
        declare_command(self, self._limits, Command(mission_mode(self._factory)))
        if (command := read_command(self)) != sim.command:
            # a mission that is not the simulator's own, and overrides at start-up, are a first command
            check_command(command, self._limits)
            self._commands.put(command)
        self._input = RateInput(timeout_s=settings.true_rate_timeout_s)
        self._pacer = self._make_pacer()
        self._last_row: FloatArray | None = None
        self._plan_steps()
        self._make_topics()
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._take_parameters)
        self.get_logger().info(
            f"Gyro {sim.device_id} ({settings.fidelity}): {sim.sample_rate_hz:g} rows/s in blocks of {self._block_rows}, "
            f"rate_raw at {sim.sample_rate_hz / self._decimation:g} Hz"
        )
        self._thread = threading.Thread(target=self._run, name="gyro_sim", daemon=True)
        self._thread.start()

    # -- set-up ---------------------------------------------------------------------------------------------------------------

    def _declare_facts(self) -> None:
        """What the unit is; an override of the command line cannot change it."""
        for name, value, text in (
            ("device_id", self._sim.device_id, "Identity of the unit"),
            ("factory", json.dumps(self._factory), "Factory data of the unit, JSON; units in the keys"),
            ("sample_rate_hz", float(self._sim.sample_rate_hz), "Rows of channels per second of device time [Hz]"),
        ):
            self.declare_parameter(name, value, describe(text, read_only=True), ignore_override=True)

    def _make_pacer(self) -> Pacer:
        s = self._settings
        sim_time = bool(self.get_parameter("use_sim_time").value)
        self._owns_clock = s.realtime_factor != 1.0
        if not self._owns_clock:
            return FollowClock(lambda: self.get_clock().now().nanoseconds, self._say_jump, longest_wait_s=0.002 if sim_time else 0.05)
        if sim_time:
            raise DataError(
                f"Parameter use_sim_time must be false for realtime_factor {s.realtime_factor:g}, but got true: this node is then the "
                "source of /clock. Set realtime_factor 1 to follow /clock of another node."
            )
        return FreeRun(s.realtime_factor or s.max_realtime_factor, s.clock_epoch_s)

    def _plan_steps(self) -> None:
        """Rows of a rate sample, of a simulated step, of a block: each a multiple of the one before."""
        per_second = self._sim.sample_rate_hz
        self._decimation = max(1, round(per_second / self._settings.rate_raw_hz))
        self._block_rows = self._decimation * max(1, round(self._settings.block_duration_s * per_second / self._decimation))
        # in real time every rate sample leaves when it is due; a free run saves the calls
        self._step_rows = self._block_rows if self._owns_clock else self._decimation

    def _make_topics(self) -> None:
        self._channels = self.create_publisher(Float64MultiArray, "channels", SENSOR_PUB_QOS)
        self._rate_raw = self.create_publisher(TwistStamped, "rate_raw", SENSOR_PUB_QOS)
        self._temperature = self.create_publisher(Temperature, "temperature", SENSOR_PUB_QOS)
        self._clock_publisher = self.create_publisher(Clock, "/clock", SENSOR_PUB_QOS) if self._owns_clock else None
        self._true_rate = self.create_subscription(TwistStamped, "true_rate", self._take_true_rate, SENSOR_SUB_QOS)
        # filled anew for every message; publishing copies
        self._rate_message, self._temperature_message, self._clock_message = TwistStamped(), Temperature(), Clock()
        self._rate_message.header.frame_id = self._temperature_message.header.frame_id = self._settings.frame_id

    # -- callbacks of the executor's thread --------------------------------------------------------------------------------------

    def _check_parameters(self, parameters: list[Any]) -> SetParametersResult:
        try:
            changed_command(self, parameters, self._limits)
        except GyroCalibError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _take_parameters(self, parameters: list[Any]) -> None:
        names = {parameter.name for parameter in parameters}
        if not names.isdisjoint(COMMAND_NAMES):
            self._commands.put(read_command(self))
        if "constant_rate_rad_s" in names:
            self._constant_rate = float(self.get_parameter("constant_rate_rad_s").value)

    def _take_true_rate(self, message: Any) -> None:
        stamp = message.header.stamp.sec * _NS + message.header.stamp.nanosec
        rate = getattr(message.twist.angular, self._settings.gyro_axis)
        start = self._pacer.stamp_ns(0.0)
        since_start_s = (stamp - start) / _NS if stamp and self._pacer.started else None
        clock_s = -np.inf if self._owns_clock else (self.get_clock().now().nanoseconds - start) / _NS
        if abs(rate) > _FASTEST_RAD_S or not self._input.push(rate, since_start_s, clock_s):
            self.get_logger().warning(
                f"true_rate must be finite and within {_FASTEST_RAD_S:g} rad/s, but got {rate!r}. The one before stays.",
                throttle_duration_sec=5.0,
            )

    def _say_jump(self, lag_s: float) -> None:
        self._input.catch_up()
        if lag_s > 0:
            self.get_logger().warning(
                f"Simulation must keep up with the clock, but lags {lag_s:.1f} s: stamps jump ahead. "
                "Remedy: fidelity slow_flow, numba installed, or another realtime_factor."
            )
        else:
            self.get_logger().warning(f"Clock must not go backwards, but went back {-lag_s:.1f} s: stamps go back with it.")

    # -- the simulation's thread ---------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            block: list[FloatArray] = []
            while not self._stop.is_set():
                if wait_s := self._pacer.wait_s(self._sim.time_s + self._step_rows / self._sim.sample_rate_hz):
                    self._stop.wait(wait_s)
                    continue
                block.append(self.step())
                if sum(map(len, block)) >= self._block_rows:
                    self.publish_block(np.concatenate(block) if len(block) > 1 else block[0])
                    block.clear()
        except Exception as error:
            if self._stop.is_set() or not self.context.ok():
                return  # publishing into a context that has just been shut down
            self.get_logger().fatal(f"Simulation ended: {type(error).__name__}: {error}")
            self.exit_code = 1
            self.context.try_shutdown()

    def step(self) -> FloatArray:
        """Take the waiting commands, simulate one step, publish clock and rate; returns the rows."""
        sim = self._sim
        while not self._commands.empty():
            sim.configure(self._commands.get())
        times = sim.time_s + np.arange(1, self._step_rows + 1) / sim.sample_rate_hz
        rows = sim.advance(self._step_rows / sim.sample_rate_hz, self._constant_rate + self._input.sample(times))
        if self._input.stale:
            self.get_logger().warning("true_rate must be renewed, but nobody does: 0 rad/s until then.", throttle_duration_sec=60.0)
        if self._clock_publisher is not None:
            _set_stamp(self._clock_message.clock, self._pacer.stamp_ns(sim.time_s))
            self._clock_publisher.publish(self._clock_message)
        self.publish_rate(rows, sim.command)
        return rows

    def publish_rate(self, rows: FloatArray, command: Command) -> None:
        """Publish means of ``rate_raw`` over each ``rate_raw_hz`` period, stamped at their centre; nothing in modes without a rate."""
        rates = raw_rate(rows, command, self._factory, before=self._last_row).reshape(-1, self._decimation).mean(axis=1)
        self._last_row = rows[-1]
        times = rows[:, 0].reshape(-1, self._decimation).mean(axis=1)
        for time_s, rate in zip(times.tolist(), rates.tolist(), strict=True):
            if rate == rate:
                _set_stamp(self._rate_message.header.stamp, self._pacer.stamp_ns(time_s))
                self._rate_message.twist.angular.z = rate
                self._rate_raw.publish(self._rate_message)

    def publish_block(self, rows: FloatArray) -> None:
        """Publish one block of rows and the temperature at its end."""
        self._channels.publish(block_from_rows(rows))
        _set_stamp(self._temperature_message.header.stamp, self._pacer.stamp_ns(float(rows[-1, 0])))
        self._temperature_message.temperature = float(rows[-1, 11])
        self._temperature.publish(self._temperature_message)

    def destroy_node(self) -> None:
        """End the simulation's thread, then the node."""
        self._stop.set()
        if (thread := getattr(self, "_thread", None)) is not None:
            thread.join(timeout=10.0)
        super().destroy_node()


def _set_stamp(stamp: Any, time_ns: int) -> None:
    stamp.sec, stamp.nanosec = divmod(time_ns, _NS)


def _declare_settings(node: Any) -> Settings:
    """Declare the start-up parameters and the constant rate; returns the settings."""
    declared = {
        "device": ("ring_15k", "Device description: path of a YAML file, or name of a packaged device"),
        "seed": (-1, "Draws a unit of the design, and its noise; -1: the description itself, other noise every time"),
        "fidelity": ("carrier", "carrier (every converter sample) or slow_flow (averaged, far faster)"),
        "realtime_factor": (1.0, "Device seconds per wall second [1]; 1 follows the node's clock, 0: as fast as possible with /clock"),
        "max_realtime_factor": (0.0, "Bound of realtime_factor 0, so that subscribers keep up [1]; 0: none"),
        "block_duration_s": (0.1, "Device time of a block of channels [s]"),
        "rate_raw_hz": (100.0, "Messages of rate_raw per second of device time [Hz]; each is the mean of whole rows"),
        "clock_epoch_s": (1.0, "ROS time of device time 0 when this node publishes /clock [s]"),
        "true_rate_timeout_s": (0.0, "Device time after which a true_rate that nobody renews counts as 0 [s]; 0: holds for ever"),
        "frame_id": ("gyro", "Frame of the gyro; its z is the sense axis"),
        "gyro_axis": ("z", "Component of true_rate that the gyro feels: x, y or z"),
    }
    ranges = {
        "seed": (-1, 2**31 - 1),
        "realtime_factor": (0.0, 1e4),
        "max_realtime_factor": (0.0, 1e6),
        "block_duration_s": (1e-3, 10.0),
        "rate_raw_hz": (0.1, 1e4),
        "clock_epoch_s": (1e-3, 1e9),
        "true_rate_timeout_s": (0.0, 1e4),
    }
    for name, (default, text) in declared.items():
        lo, hi = ranges.get(name, (None, None))
        descriptor = describe(text, lo=lo, hi=hi, read_only=True)
        # a bare y in a parameter file is a boolean to ROS
        descriptor.dynamic_typing = name == "gyro_axis"
        node.declare_parameter(name, default, descriptor)
    values = {name: node.get_parameter(name).value for name in declared}
    if values["gyro_axis"] is True:
        values["gyro_axis"] = "y"
    settings = Settings(**values)
    if settings.gyro_axis not in ("x", "y", "z"):
        raise DataError(f"Parameter gyro_axis must be x, y or z, but got {settings.gyro_axis!r}.")
    node.declare_parameter(
        "constant_rate_rad_s",
        0.0,
        describe("Constant input rate that nobody is told of, e.g. of the earth [rad/s]", lo=-_FASTEST_RAD_S, hi=_FASTEST_RAD_S),
    )
    return settings


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of ``gyro_sim_node``."""
    return run_node(GyroSimNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
