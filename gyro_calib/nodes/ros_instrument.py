"""A gyro reached through its topics and parameters only: the live :class:`gyro_calib.experiments.instrument.Instrument`."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from std_msgs.msg import Float64MultiArray

from ..errors import DataError, ExperimentAborted
from ..recording.command import Command
from ..recording.integrity import validate
from ..recording.recording import Recording
from .blocks import rows_from_block
from .command_parameters import COMMAND_NAMES
from .gyro_client import GyroClient, parse_facts
from .row_window import LostRows, RowWindow
from .runtime import SENSOR_SUB_QOS
from .stream import BlockStream

__all__ = ["RosInstrument"]

FloatArray = NDArray[np.float64]
#: how often a waiting thread looks whether it was cancelled [s]
_LOOK_S = 0.1
#: how long a gyro whose stream has stopped is tried again, when its run puts it back [s]
_FAREWELL_S = 1.0
#: relative difference between a commanded number and the one in force: a driver may round
_ROUNDING = 1e-6
_FACTS = ("device_id", "factory", "sample_rate_hz")


class RosInstrument:
    """Commands and records a gyro over ROS.

    Its methods block and belong in a worker thread; the executor of ``node`` serves the callbacks in another. One run at a time.

    Parameters
    ----------
    node : rclpy.node.Node
        Node that carries subscription and clients.
    gyro, channels : str
        Name of the gyro's node and of its block topic, relative to the namespace of ``node``.
    expected_device_id : str, optional
        Refuse any other unit.
    stall_s : float
        Steady time without a block after which the stream counts as stopped [s].
    service_s : float
        Steady time that the gyro has to answer a service call [s].
    retries : int
        How often a recording that lost rows is made again.
    cancelled : callable
        Asked while recording; True ends it. :meth:`configure` does not ask, so that a cancelled run can put its gyro back.
    notice : callable
        Hears in a sentence what was mended on the way.
    """

    def __init__(
        self,
        node: Any,
        *,
        gyro: str = "gyro_sim",
        channels: str = "channels",
        expected_device_id: str | None = None,
        stall_s: float = 5.0,
        service_s: float = 10.0,
        retries: int = 2,
        cancelled: Callable[[], bool] = lambda: False,
        notice: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.cancelled = cancelled
        self.notice = notice
        self._expected = expected_device_id
        self._stall_s = stall_s
        self._retries = retries
        self._client = GyroClient(node, gyro, timeout_s=service_s)
        self._stream = BlockStream()
        self._facts: tuple[str, dict[str, Any], float] | None = None
        self._lost = False
        self._command = Command()
        self._segment: int | None = None
        self._first_s: float | None = None
        self._carry: list[FloatArray] = []
        self._window: RowWindow | None = None
        self._subscription = node.create_subscription(Float64MultiArray, channels, self._take_block, SENSOR_SUB_QOS)
        self._topic = self._subscription.topic_name

    # -- identity ---------------------------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Read who the gyro is and what is in force, and wait for its first block.

        Raises
        ------
        ExperimentAborted
            No gyro, or no stream.
        DataError
            Another unit than the expected one, or unusable parameters.
        """
        self._facts, self._lost = None, False
        facts = parse_facts(self._client.get(_FACTS))
        if self._expected is not None and facts[0] != self._expected:
            raise DataError(f"Gyro must be {self._expected!r}, but got {facts[0]!r}. Select its own record, or connect the right unit.")
        self._command = Command.from_parameters(self._client.get(COMMAND_NAMES))
        self._segment, self._first_s, self._carry = None, None, []
        self._wait_for_row()
        self._facts = facts

    @property
    def device_id(self) -> str:
        """Identity of the unit; connects if that was not done."""
        return self._known()[0]

    @property
    def factory(self) -> dict[str, Any]:
        """Factory data of the unit; connects if that was not done."""
        return self._known()[1]

    @property
    def sample_rate_hz(self) -> float:
        """Rows per second of device time [Hz]; connects if that was not done."""
        return self._known()[2]

    @property
    def command(self) -> Command:
        """What is in force as far as it is known here: as read on connecting, or as set since; connects if that was not done."""
        self._known()
        return self._command

    @property
    def latest_row(self) -> FloatArray | None:
        """Newest row of the stream, shape (12,); None before the first. Never waits."""
        return self._stream.latest

    @property
    def recorded_fraction(self) -> float:
        """How much of the present recording is there, 0 to 1. Never waits."""
        return 0.0 if self._window is None else self._window.fraction

    # -- the instrument -----------------------------------------------------------------------------------------------------------

    def configure(self, command: Command) -> None:
        """Put ``command`` in force; returns when its segment has begun.

        Raises
        ------
        ExperimentAborted
            The gyro does not answer, its stream stopped, or somebody else commands it too.
        DataError
            It refuses the command, or has become another unit.
        """
        self._known()
        before = int(self._wait_for_row()[1])
        self._client.set(command.to_parameters(), timeout_s=_FAREWELL_S if self._lost else None)
        self._carry = self._wait_for_segment(before)
        self._command = self._command_in_force(command, _ROUNDING)

    def record(self, duration_s: float, *, settle_s: float = 0.0, label: str = "") -> Recording:
        """Record ``duration_s`` after ``settle_s`` of device time counted from the last command's first row.

        A recording that lost rows is made again under the same command, ``retries`` times at most; ``notice`` is told.

        Raises
        ------
        ExperimentAborted
            The stream stopped, the run was cancelled, or somebody else commanded the gyro.
        DataError
            Not finite, repeated or out-of-order rows, lost rows every time, a damaged channel, or another unit.
        """
        device_id, factory, rate_hz = self._known()
        wanted = round(duration_s * rate_hz)
        if wanted < 2:
            raise DataError(f"Argument duration_s must be at least {2.0 / rate_hz:g} s (2 rows), but got {duration_s!r}.")
        if self._segment is None:
            self._segment = int(self._wait_for_row()[1])
        for attempt in range(self._retries + 1):
            try:
                rows = self._collect(wanted, settle_s, label)
                break
            except LostRows as error:
                if attempt == self._retries:
                    raise
                self.notice(f"Recording {label!r} is made again ({attempt + 1} of {self._retries}): {error}")
        self._command_in_force(self._command, 0.0)
        extras = {"settle_s": settle_s, "attempts": attempt + 1}
        if "dac_zero_order_hold_s" in factory:
            extras["dac_zero_order_hold_s"] = factory["dac_zero_order_hold_s"]
        recording = Recording(device_id, rows, self._command, rate_hz, label, extras)
        validate(recording, factory)
        return recording

    # -- inside ---------------------------------------------------------------------------------------------------------------------

    def _known(self) -> tuple[str, dict[str, Any], float]:
        if self._facts is None:
            self.connect()
        assert self._facts is not None
        return self._facts

    def _take_block(self, message: Any) -> None:
        """Callback of the executor's thread."""
        try:
            self._stream.put(rows_from_block(message))
        except DataError as error:
            self._stream.put(error)

    def _collect(self, wanted: int, settle_s: float, label: str) -> FloatArray:
        assert self._segment is not None
        blocks, self._carry = self._carry, []
        if not blocks:
            # not the first attempt under this command: what waits may be old and have gaps
            self._stream.clear()
        window = self._window = RowWindow(self._segment, wanted, self.sample_rate_hz, settle_s, self._first_s)
        since = time.monotonic()
        while True:
            for block in blocks:
                window.add(block)
                self._first_s = window.first_s
                if window.full:
                    return window.rows()
            if self.cancelled():
                raise ExperimentAborted(f"Run was cancelled while recording {label!r}.")
            self._check_alive(since)
            blocks = self._stream.take(_LOOK_S)

    def _wait_for_row(self) -> FloatArray:
        """Newest row of a stream that is alive; what waited before is forgotten, errors too."""
        self._stream.clear()
        since = time.monotonic()
        while (row := self._stream.latest) is None or self._stream.silence_s(0.0) > self._patience_s:
            self._check_alive(since)
            self._stream.take(_LOOK_S)
        self._lost = False
        return row

    def _wait_for_segment(self, before: int) -> list[FloatArray]:
        """Wait for the first row of a segment after ``before``; returns its block and those that came with it."""
        since = time.monotonic()
        while True:
            blocks = self._stream.take(_LOOK_S)
            for place, block in enumerate(blocks):
                new = block[block[:, 1] > before]
                if len(new):
                    self._segment, self._first_s = int(new[0, 1]), float(new[0, 0])
                    return blocks[place:]
            self._check_alive(since)
            if time.monotonic() - since > 2.0 * self._stall_s:
                raise ExperimentAborted(
                    f"Column segment must increase when a command takes effect, but stayed {before} for {2.0 * self._stall_s:g} s. "
                    "Check that the driver counts commands."
                )

    @property
    def _patience_s(self) -> float:
        return min(_FAREWELL_S, self._stall_s) if self._lost else self._stall_s

    def _check_alive(self, since_s: float) -> None:
        if self._stream.silence_s(since_s) > self._patience_s:
            self._lost = True
            raise ExperimentAborted(
                f"Stream {self._topic} must deliver blocks, but none came for {self._stall_s:g} s. "
                "Check that the gyro runs, is not paused, and publishes in this namespace; then start the run again."
            )

    def _command_in_force(self, expected: Command, tolerance: float) -> Command:
        """The command that the driver says is in force: that which is expected, on the same unit."""
        values = self._client.get(("device_id", *COMMAND_NAMES))
        known = self._known()[0]
        if values["device_id"] != known:
            raise DataError(
                f"Gyro must stay {known!r} during a run, but is now {values['device_id']!r}. Start the run again with one unit."
            )
        command = Command.from_parameters({name: values[name] for name in COMMAND_NAMES})
        found, wanted = command.to_parameters(), expected.to_parameters()
        changed = [name for name in COMMAND_NAMES if not _same(found[name], wanted[name], tolerance)]
        if changed:
            raise ExperimentAborted(
                f"Command must stay in force during a run, but got {', '.join(f'{name} = {found[name]!r}' for name in changed)}. "
                "Somebody else commands the gyro: stop that, and start the run again."
            )
        return command


def _same(found: Any, wanted: Any, tolerance: float) -> bool:
    if isinstance(wanted, list):
        return len(found) == len(wanted) and all(_same(f, w, tolerance) for f, w in zip(found, wanted, strict=True))
    if isinstance(wanted, float):
        return math.isclose(found, wanted, rel_tol=tolerance, abs_tol=tolerance * 1e-6)
    return bool(found == wanted)
