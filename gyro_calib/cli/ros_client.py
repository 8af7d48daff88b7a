"""The command line's side of the ROS contract: call a service, follow a run through its latched status."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any

from ..errors import GyroCalibError

__all__ = ["RosClient", "RunFailed", "RunView"]

#: states in which a run has ended
_ENDED = {"done", "failed", "cancelled"}
_DISCOVERY_S = 15.0
_ANSWER_S = 15.0
#: a calibration node that has been invisible for so long will not come back to its run [s]
_GONE_S = 5.0


class RunFailed(GyroCalibError):
    """A run was refused, failed or was cancelled; the text is its reason."""


@dataclass(frozen=True)
class RunView:
    """What ``~/status`` says of a run.

    Parameters
    ----------
    run, state, message : str
        As in the status.
    fraction, eta_s : float
        Part done; time left [s], NaN when unknown.
    values : mapping of str to str
        All key values.
    """

    run: str = ""
    state: str = ""
    message: str = ""
    fraction: float = math.nan
    eta_s: float = math.nan
    values: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, message: Any) -> RunView:
        """Read a diagnostic_msgs/DiagnosticStatus."""
        values = {pair.key: pair.value for pair in message.values}
        return cls(
            run=values.get("run", ""),
            state=values.get("state", ""),
            message=values.get("message", "") or message.message,
            fraction=_number(values.get("fraction")),
            eta_s=_number(values.get("eta_s")),
            values=values,
        )


class RosClient:
    """A short-lived node that calls services and listens; a context manager.

    Parameters
    ----------
    namespace : str
        Namespace of the gyro.
    domain_id : int or None
        ROS domain; None for that of the environment.

    Raises
    ------
    GyroCalibError
        rclpy is not installed.
    """

    def __init__(self, namespace: str, domain_id: int | None = None) -> None:
        try:
            import rclpy
            from rclpy.executors import SingleThreadedExecutor
            from rclpy.signals import SignalHandlerOptions
        except ImportError as error:
            raise GyroCalibError("This command needs ROS 2 (rclpy). Install it with: pip install 'gyro_calib[ros]'.") from error
        from diagnostic_msgs.msg import DiagnosticStatus

        from ..nodes.runtime import LATCHED_QOS, EventsExecutor

        self._context = rclpy.Context()
        # Ctrl-C stays a KeyboardInterrupt of this program
        rclpy.init(args=[], context=self._context, domain_id=domain_id, signal_handler_options=SignalHandlerOptions.NO)
        self._executor = (EventsExecutor or SingleThreadedExecutor)(context=self._context)
        self.node = rclpy.create_node("gyro_calib_cli", namespace="/" + namespace.strip("/"), context=self._context)
        self._executor.add_node(self.node)
        self.latest: RunView | None = None
        self._seen: RunView | None = None
        self.node.create_subscription(DiagnosticStatus, "gyro_calibration/status", self._on_status, LATCHED_QOS)

    def __enter__(self) -> RosClient:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Take the node down."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def spin_until(self, done: Callable[[], bool], timeout_s: float) -> bool:
        """Serve callbacks until ``done()`` or the time is over; whether it was done."""
        from rclpy.task import Future

        never: Future = Future()
        deadline = time.monotonic() + timeout_s
        while not done():
            if time.monotonic() > deadline:
                return False
            self._executor.spin_until_future_complete(never, timeout_sec=0.05)
        return True

    def call(self, kind: Any, name: str, request: Any = None, *, discovery_s: float = _DISCOVERY_S) -> Any:
        """Call a service of the namespace and return its response.

        Raises
        ------
        GyroCalibError
            Nobody offers it, or it does not answer.
        """
        client = self.node.create_client(kind, name)
        if not self.spin_until(client.service_is_ready, discovery_s):
            raise GyroCalibError(
                f"Service {client.service_name} must be offered by a running node, but nobody does. Start the nodes with gyro-calib up, "
                "or check --namespace and ROS_DOMAIN_ID."
            )
        future = client.call_async(kind.Request() if request is None else request)
        if not self.spin_until(future.done, _ANSWER_S):
            raise GyroCalibError(f"Service {client.service_name} must answer within {_ANSWER_S:g} s, but did not. Check its node.")
        self.node.destroy_client(client)
        return future.result()

    def start_run(self, service: str, *, discovery_s: float = _DISCOVERY_S) -> str:
        """Ask for a run; returns what the node says when it accepts.

        Raises
        ------
        RunFailed
            Refused, with the reason.
        """
        from std_srvs.srv import Trigger

        response = self.call(Trigger, f"gyro_calibration/{service}", discovery_s=discovery_s)
        if not response.success:
            raise RunFailed(response.message)
        return str(response.message)

    def follow_run(self, accepted: str, on_view: Callable[[RunView], None], still_there: Callable[[], None] = lambda: None) -> RunView:
        """Wait for the end of the run that ``accepted`` (the answer of :meth:`start_run`) names.

        Parameters
        ----------
        accepted : str
            Holds the run id.
        on_view : callable
            Called with every new state.
        still_there : callable
            Called now and then; raises when waiting is pointless.

        Raises
        ------
        RunFailed
            The run failed or was cancelled, another run took its place, or the calibration node is gone.
        """
        absent_since: float | None = None
        while True:
            view = self._news()
            still_there()
            absent_since = self._check_presence(absent_since)
            if view is None or not view.run or view.run not in accepted:
                continue
            on_view(view)
            if view.state == "done":
                return view
            if view.state in _ENDED:
                raise RunFailed(view.message)

    def _news(self) -> RunView | None:
        """A status that was not looked at yet, or None after a while."""
        if not self.spin_until(lambda: self.latest is not self._seen, 0.5):
            return None
        self._seen = self.latest
        return self._seen

    def _check_presence(self, absent_since: float | None) -> float | None:
        """Since when no calibration node is to be seen, or None."""
        if self.node.count_publishers(self.node.resolve_topic_name("gyro_calibration/status")) > 0:
            return None
        now = time.monotonic()
        if absent_since is not None and now - absent_since > _GONE_S:
            raise RunFailed("The calibration node is gone. Its previous calibration stays; start it again.")
        return now if absent_since is None else absent_since

    def _on_status(self, message: Any) -> None:
        self.latest = RunView.of(message)


def _number(text: str | None) -> float:
    try:
        return float(text) if text is not None else math.nan
    except ValueError:
        return math.nan
