"""What every node needs: quality of service, a spin that works, parameter descriptors, a clean end."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from ..errors import GyroCalibError

try:
    from rclpy.experimental.events_executor import EventsExecutor
except ImportError:  # an rclpy without it
    EventsExecutor = None

__all__ = ["LATCHED_QOS", "SENSOR_PUB_QOS", "SENSOR_SUB_QOS", "close_on_signal", "describe", "make_executor", "run_node", "spin"]

#: sensor topics, publishing side: whoever asks for reliability gets it
SENSOR_PUB_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=200, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE
)
#: sensor topics, subscribing side: matches every publisher; deep, because a depth of 10 drops at 1 kHz
SENSOR_SUB_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE
)
#: state: the last value reaches whoever joins late
LATCHED_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)

#: how long one turn of the spin may take to notice that the context has been shut down [s]
_TURN_S = 0.5


def describe(
    description: str, *, lo: float | None = None, hi: float | None = None, step: float | None = None, read_only: bool = False
) -> ParameterDescriptor:
    """Descriptor of a parameter.

    Parameters
    ----------
    description : str
        What it is, with its unit in brackets.
    lo, hi : float or int, optional
        Range; both or neither. Two ``int`` describe an integer parameter, anything else a floating-point one.
    step : float or int, optional
        Step of the range; none means any value (integers: 1).
    read_only : bool
        Only overrides at start-up may set it.

    Raises
    ------
    ValueError
        Only one end of the range, or a range upside down.
    """
    descriptor = ParameterDescriptor(description=description, read_only=read_only)
    if lo is None and hi is None:
        return descriptor
    if lo is None or hi is None or not lo <= hi:
        raise ValueError(f"Arguments lo and hi must both be given, lo <= hi, but got {lo!r} and {hi!r}.")
    if isinstance(lo, int) and isinstance(hi, int):
        descriptor.integer_range = [IntegerRange(from_value=lo, to_value=hi, step=int(step or 1))]
    else:
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(lo), to_value=float(hi), step=float(step or 0.0))]
    return descriptor


def make_executor() -> Any:
    """The events executor where rclpy has it (half the CPU, no loss at 1 kHz), else the single-threaded one."""
    return SingleThreadedExecutor() if EventsExecutor is None else EventsExecutor()


def spin(executor: Any, until: Future | None = None) -> None:
    """Serve callbacks until ``until`` is done or the context is shut down.

    The events executor's own ``spin()`` serves nothing in some releases; waiting for a future, even one that never comes, does. An
    exception of a callback ends the spin, unless it only says that the context has just been shut down under the callback.
    """
    future = Future() if until is None else until
    while rclpy.ok() and not future.done():
        try:
            executor.spin_until_future_complete(future, timeout_sec=_TURN_S)
        except (RuntimeError, ExternalShutdownException):
            if rclpy.ok():
                raise


def run_node(make_node: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Initialise, make the node, serve it until SIGINT, SIGTERM or a shutdown, and take it down.

    A signal ends the spin after the callback it falls into. rclpy's own handlers would shut the context down under that callback, and
    Python's would throw KeyboardInterrupt into it: the executor then reports a fatal exception where nothing is wrong.

    Parameters
    ----------
    make_node : callable
        Makes the node; a :class:`~gyro_calib.errors.GyroCalibError` or a refused parameter is reported in one line.
        ``destroy_node()`` of the node must stop whatever threads it has.
    args : sequence of str, optional
        Command line without the program's name; default ``sys.argv[1:]``.

    Returns
    -------
    int
        0 after an orderly end, 1 when the node could not be made; otherwise the node's attribute ``exit_code`` if it has one.
    """
    rclpy.init(args=None if args is None else ["", *args], signal_handler_options=SignalHandlerOptions.NO)
    # while the node is made nobody serves it: stop there and then
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    node: Node | None = None
    executor: Any = None
    code = 0
    quiet = Future()
    try:
        node = make_node()
        close_on_signal(lambda: None, quiet)
        executor = make_executor()
        executor.add_node(node)
        spin(executor, quiet)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (GyroCalibError, rclpy.exceptions.InvalidParameterTypeException, rclpy.exceptions.InvalidParameterValueException) as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
        code = 1
    finally:
        _take_down(node, executor)
    return code or int(getattr(node, "exit_code", 0))


def _take_down(node: Node | None, executor: Any) -> None:
    """Destroy once; a second SIGINT (one from the terminal's group, one from a launcher) must not interrupt it."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        if executor is not None:
            if node is not None:
                executor.remove_node(node)
            executor.shutdown()
    finally:
        try:
            if node is not None:
                node.destroy_node()
        finally:
            rclpy.try_shutdown()


def close_on_signal(close: Callable[[], None], quiet: Future) -> None:
    """On SIGINT or SIGTERM call ``close`` in another thread, callbacks still served, then finish ``quiet``; later ones change nothing."""
    ending = threading.Event()

    def work() -> None:
        close()
        quiet.set_result(None)

    def end(*_: object) -> None:
        if not ending.is_set():
            ending.set()
            threading.Thread(target=work, name="close", daemon=True).start()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
