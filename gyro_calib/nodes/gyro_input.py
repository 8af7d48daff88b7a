"""One gyro as ``imu_corrector`` sees it: its raw rate, temperature, parameters, and the calibration meant for it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timezone
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import qos_profile_parameter_events
from sensor_msgs.msg import Temperature

from ..calibration import RecordMissingError, RecordStore, read_record, resolve_url
from ..errors import StoreError
from .calibration_messages import record_from_calibration
from .correction_state import CorrectionState
from .runtime import LATCHED_QOS, SENSOR_SUB_QOS
from .stamps import Sample, SampleClock

__all__ = ["GyroInput", "InputNames"]

#: what names of correcting nodes contain
_CORRECTOR = "imu_corrector"
#: how rmw calls the node of a publisher whose participant has not told its nodes yet
_NAME_UNKNOWN = "_NODE_NAME_UNKNOWN_"
#: how long a publisher may stay without a name; one that is not of ROS has none [s]
_GRACE_S = 2.0
#: how often its name is looked up meanwhile [s]
_RECHECK_S = 0.02
#: parameters of a gyro's driver that say who it is, whether a record applies, and how far it can measure
_FACTS = ("device_id", "mode", "compensation", "excitation.kind", "factory", "setpoint.amplitude_v")
#: those that move the wave; whatever it does until it stands again is no rate
_COMMANDS = frozenset({"mode", "excitation.kind", "setpoint.amplitude_v"})
#: how often a driver that does not say who it is is asked
_ASKS = 5
#: how long after a command the loops may swing a rate beyond the range that nobody turned [s]
_SETTLES_S = 5.0
#: value of record_urls that asks for no file
_NO_FILE = "none"


@dataclass(frozen=True)
class InputNames:
    """Where one gyro and its calibration are.

    Parameters
    ----------
    prefix : str
        Namespace of the gyro, relative to that of the corrector; "" for the same.
    gyro_node, calibration_node : str
        Names of the driver's and the calibration's node in it.
    record_url : str
        Stored record: a URL, "" for the default place of the device, "none" for no file. A published record supersedes it.
    """

    prefix: str = ""
    gyro_node: str = "gyro_sim"
    calibration_node: str = "gyro_calibration"
    record_url: str = ""

    def relative(self, name: str) -> str:
        """``name`` in the namespace of the gyro."""
        return f"{self.prefix.rstrip('/')}/{name}" if self.prefix else name


class GyroInput:
    """Subscribes to one gyro, keeps its :class:`CorrectionState`, and hands corrected samples on.

    Parameters
    ----------
    node : Node
        The node that subscribes.
    names : InputNames
        Where the gyro and its calibration are.
    state : CorrectionState
        Decides what is applied.
    on_sample : callable
        Gets each corrected :data:`Sample`.
    on_change : callable
        Called after the decision was taken anew.
    on_jump : callable
        Called when the time of the gyro went back.
    fixed_rate_hz : float
        Sample rate [Hz]; 0 measures it.
    """

    def __init__(
        self,
        node: Node,
        names: InputNames,
        state: CorrectionState,
        *,
        on_sample: Callable[[Sample], None],
        on_change: Callable[[], None],
        on_jump: Callable[[], None],
        fixed_rate_hz: float = 0.0,
    ) -> None:
        self.names, self.state, self.clock = names, state, SampleClock()
        self.received = self.not_finite = self.saturated = 0
        self._node, self._on_sample, self._on_change, self._on_jump = node, on_sample, on_change, on_jump
        self._fixed_rate_hz = fixed_rate_hz
        self._next_estimate, self._jumps, self._received_seen = 2, 0, 0
        #: whether a rate beyond the range came between the last two ticks
        self.saturating, self._saturated_seen = False, 0
        self._commanded_s = -math.inf
        self._last_arrival_s = math.nan
        self._publishers: frozenset[bytes] | None = None
        self._asks_left, self._pending = _ASKS, list[Any]()
        self._checked_s, self._unknown_since_s = -math.inf, math.nan
        self._file_done = names.record_url == _NO_FILE
        if fixed_rate_hz:
            state.sample_rate_hz = fixed_rate_hz
        self._gyro_name = node.resolve_topic_name(names.relative(names.gyro_node), only_expand=True)
        self._client = node.create_client(GetParameters, names.relative(f"{names.gyro_node}/get_parameters"))
        self._subscribe()
        self._load_file()
        self.refresh()

    def _subscribe(self) -> None:
        node, relative = self._node, self.names.relative
        matched = SubscriptionEventCallbacks(matched=lambda _: self.check_publishers())
        rate = node.create_subscription(TwistStamped, relative("rate_raw"), self._rate, SENSOR_SUB_QOS, event_callbacks=matched)
        #: full name of the raw rate after remapping
        self.topic: str = rate.topic_name
        calibration = relative(f"{self.names.calibration_node}/calibration")
        node.create_subscription(Temperature, relative("temperature"), self._temperature, SENSOR_SUB_QOS)
        node.create_subscription(DiagnosticArray, calibration, self._calibration, LATCHED_QOS)
        node.create_subscription(ParameterEvent, "/parameter_events", self._parameter_event, qos_profile_parameter_events)

    # --- a thousand times a second -------------------------------------------------------------------------------------------

    def _rate(self, message: Any) -> None:
        header, raw = message.header, message.twist.angular.z
        stamp_ns = header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
        self.received += 1
        if self._publishers is None and not self._publishers_known():
            return
        clock, state = self.clock, self.state
        if not clock.accept(stamp_ns):
            return
        if clock.jumps != self._jumps:
            self._jumps = clock.jumps
            self._on_jump()
        if clock.count == self._next_estimate:
            self._next_estimate = 20 if self._next_estimate == 2 else 0
            self._use_measured_rate()
        if not abs(raw) < state.range_rad_s:
            if math.isfinite(raw):
                self.saturated += 1
            else:
                self.not_finite += 1
            return
        if state.publishing:
            rate = (raw - state.bias) * state.gain
            self._on_sample((stamp_ns, rate, state.c0 + rate * (state.c1 + state.c2 * rate), header))

    def _use_measured_rate(self) -> None:
        """The variance goes with the sample rate: looked at after 2 and 20 samples, then with every tick."""
        measured = self.clock.rate_hz()
        # small changes are let be: the variance is not known better
        if measured and not self._fixed_rate_hz and abs(measured - self.state.sample_rate_hz) > 0.02 * self.state.sample_rate_hz:
            self.state.sample_rate_hz = measured
            self.refresh()

    def _publishers_known(self) -> bool:
        """Samples arrive before the name of their publisher does: until then it may be a corrector, and they are not used."""
        now = time.monotonic()
        if now - self._checked_s > _RECHECK_S:
            self._checked_s = now
            self.check_publishers()
        return self._publishers is not None

    # --- once a second or less -----------------------------------------------------------------------------------------------

    def tick(self) -> None:
        """See to what no message announces: the sample rate, other publishers, the identity of the gyro, the age of the record."""
        settled = time.monotonic() - self._commanded_s > _SETTLES_S
        self.saturating, self._saturated_seen = settled and self.saturated > self._saturated_seen, self.saturated
        if self.received != self._received_seen:
            self._received_seen, self._last_arrival_s = self.received, time.monotonic()
        self._use_measured_rate()
        self.clock.restart_window()
        self.check_publishers()
        if not self.state.reported_device:
            self._ask()
        self._load_file()
        self.refresh()

    def refresh(self) -> None:
        """Decide anew what is applied."""
        self.state.refresh(datetime.now(timezone.utc))
        self._on_change()

    @property
    def silent_s(self) -> float:
        """Seconds since samples last came, to the tick; NaN before the first."""
        return time.monotonic() - self._last_arrival_s

    def check_publishers(self) -> None:
        """Refuse a rate that another corrector publishes; ask anew who the gyro is when its publisher changed."""
        found = self._node.get_publishers_info_by_topic(self.topic)
        upstream = tuple(sorted({f"{p.node_namespace.rstrip('/')}/{p.node_name}" for p in found if _CORRECTOR in p.node_name}))
        publishers = frozenset(bytes(p.endpoint_gid) for p in found)
        if found and all(p.node_name != _NAME_UNKNOWN for p in found):
            self._unknown_since_s = math.nan
        elif math.isnan(self._unknown_since_s):
            self._unknown_since_s = time.monotonic()
        if time.monotonic() - self._unknown_since_s < _GRACE_S:
            self._publishers = None
        elif publishers != self._publishers:
            self._publishers = publishers
            self._asks_left = _ASKS
            self._ask()
        if upstream != self.state.upstream:
            self.state.upstream = upstream
            self.refresh()

    def _ask(self) -> None:
        """Ask the driver for each fact by itself: one that it does not have would spoil the answer to all."""
        if self._asks_left == 0 or not self._client.service_is_ready():
            return
        self._asks_left -= 1
        for future in self._pending:
            self._client.remove_pending_request(future)
        self._pending = [self._client.call_async(GetParameters.Request(names=[name])) for name in _FACTS]
        for name, future in zip(_FACTS, self._pending, strict=True):
            future.add_done_callback(partial(self._answer, name))

    def _answer(self, name: str, future: Any) -> None:
        response = future.result() if future.exception() is None and not future.cancelled() else None
        if response is not None and len(response.values) == 1:
            self._learn({name: parameter_value_to_python(response.values[0])})

    def _parameter_event(self, message: Any) -> None:
        if message.node == self._gyro_name:
            if not _COMMANDS.isdisjoint(p.name for p in message.changed_parameters):
                self._commanded_s = time.monotonic()
            self._learn({p.name: parameter_value_to_python(p.value) for p in (*message.new_parameters, *message.changed_parameters)})

    def _learn(self, facts: dict[str, Any]) -> None:
        """Take what the driver says of itself; other parameters are none of our business."""
        state = self.state
        if isinstance(facts.get("mode"), str):
            state.mode = facts["mode"]
        if isinstance(facts.get("excitation.kind"), str):
            state.excitation = facts["excitation.kind"]
        if facts.get("compensation") is not None and len(facts["compensation"]) == 4:
            state.compensation = tuple(facts["compensation"])
        state.learn_range(facts.get("factory"), facts.get("setpoint.amplitude_v"))
        if isinstance(facts.get("device_id"), str) and facts["device_id"]:
            state.identify(facts["device_id"])
            self._load_file()
        if not facts.keys().isdisjoint(_FACTS):
            self.refresh()

    def _temperature(self, message: Any) -> None:
        self.state.temperature_degc = message.temperature

    # --- records ---------------------------------------------------------------------------------------------------------------

    def _calibration(self, message: Any) -> None:
        try:
            record = record_from_calibration(message)
        except StoreError as error:
            self.state.refusal = str(error)
        else:
            if record is not None:
                self._file_done = True
                self.state.offer(record, "Published calibration")
        self.refresh()

    def _load_file(self) -> None:
        """Load the stored record once the device is known, or at once when its file is named; a published one makes it unnecessary."""
        device_id, url = self.state.device_id, self.names.record_url
        if self._file_done or not (device_id or url):
            return
        try:
            if device_id:
                loaded = RecordStore(url, device_id).load_last_good()
                accepted = self.state.offer(loaded.record, "Stored calibration")
                self.state.note = loaded.problem if accepted else ""
            else:
                self.state.offer(read_record(resolve_url(url, "")), "Stored calibration")
        except RecordMissingError as error:
            self.state.refusal = str(error) if url else ""  # nobody promised that there is one in the default place
            return  # and it may come
        except StoreError as error:
            self.state.refusal = str(error)
        self._file_done = True
