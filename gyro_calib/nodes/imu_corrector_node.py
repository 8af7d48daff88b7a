"""Node ``imu_corrector``: the raw rates of one to three gyros, calibrated once, as sensor_msgs/Imu.

Subscribes, for each gyro (relative to its namespace): ``rate_raw``, ``temperature``, latched ``gyro_calibration/calibration``, the
parameters of the driver; and ``imu/accel_in`` (sensor_msgs/Imu, optional). Publishes ``imu/data_raw``, latched ``~/status``,
``/diagnostics`` at 1 Hz. Service ``~/enable``. What is applied when is in :mod:`gyro_calib.nodes.correction_state`, what the covariance
means in :mod:`gyro_calib.calibration.errormodel`.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import Imu
from std_srvs.srv import SetBool

from ..units import deg_h, ppm
from .calibration_messages import key_values
from .correction_state import ERROR, WARN, CorrectionState
from .corrector_parameters import check_changes, declare_parameters, input_names, read_settings, sense_axes
from .gyro_input import GyroInput
from .imu_messages import ImuFiller
from .runtime import LATCHED_QOS, SENSOR_PUB_QOS, SENSOR_SUB_QOS, run_node
from .stamps import Sample, StampJoin

__all__ = ["ImuCorrector", "main"]

_LEVELS = (DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR)
_TICK_S = 1.0
#: numbers in a text, such as a temperature: their change alone is no news
_NUMBER = re.compile(r"\d[\d.]*")


class ImuCorrector(Node):
    """See the module text.

    Raises
    ------
    DataError
        Parameters that contradict each other.
    """

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("imu_corrector", **node_arguments)
        declare_parameters(self)
        settings, axes, names = read_settings(self), sense_axes(self), input_names(self)
        self._published, self._ready = 0, False
        #: samples of each gyro since the last tick, and what was published until then
        self._offered, self._published_before, self._unjoined = [0] * len(names), 0, False
        self._said: tuple[int, str, tuple[str, ...]] | None = None
        self._gyros: list[GyroInput] = []
        self._filler = ImuFiller(axes, self._value("frame_id"), self._value("accel_max_age_s"))
        self._join = StampJoin(len(names), self._value("join_tolerance_s"))
        self._output = self.create_publisher(Imu, "imu/data_raw", SENSOR_PUB_QOS)
        self._status = self.create_publisher(DiagnosticStatus, "~/status", LATCHED_QOS)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_subscription(Imu, "imu/accel_in", self._filler.set_acceleration, SENSOR_SUB_QOS)
        for index, (where, device) in enumerate(names):
            on_sample = self._publish_one if len(names) == 1 else partial(self._publish_joined, index)
            self._gyros.append(
                GyroInput(
                    self,
                    where,
                    CorrectionState(settings, device),
                    on_sample=on_sample,
                    on_change=self._on_change,
                    on_jump=self._join.clear,
                    fixed_rate_hz=self._value("sample_rate_hz"),
                )
            )
        self.create_service(SetBool, "~/enable", self._enable)
        self.add_on_set_parameters_callback(check_changes)
        self.add_post_set_parameters_callback(self._use_parameters)
        # a steady clock: with use_sim_time and no /clock the node's own stands still, and that is what is to be reported
        self.create_timer(_TICK_S, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._ready = True
        self._on_change()

    def _value(self, name: str) -> Any:
        return self.get_parameter(name).value

    # --- a thousand times a second ---------------------------------------------------------------------------------------------

    def _publish_one(self, sample: Sample) -> None:
        self._output.publish(self._filler.fill((sample,)))
        self._published += 1

    def _publish_joined(self, index: int, sample: Sample) -> None:
        self._offered[index] += 1
        for samples in self._join.add(index, sample):
            self._output.publish(self._filler.fill(samples))
            self._published += 1

    # --- once a second or less -------------------------------------------------------------------------------------------------

    def _enable(self, request: Any, response: Any) -> Any:
        for gyro in self._gyros:
            gyro.state.enabled = request.data
            gyro.refresh()
        response.success = True
        response.message = "correction on" if request.data else f"correction off: {self._off_means()}"
        self.get_logger().info(response.message)
        return response

    def _off_means(self) -> str:
        hold = self._value("uncalibrated_policy") == "hold"
        return "the output is held" if hold else "raw rates pass with the covariance of an uncalibrated gyro"

    def _use_parameters(self, _: Sequence[Any]) -> None:
        settings = read_settings(self)
        self._join.tolerance_s = self._value("join_tolerance_s")
        self._filler.accel_max_age_s = self._value("accel_max_age_s")
        for gyro in self._gyros:
            gyro.state.settings = settings
            gyro.refresh()

    def _tick(self) -> None:
        for gyro in self._gyros:
            gyro.tick()
        self._watch_join()
        status = self._make_status()
        self._status.publish(status)
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _watch_join(self) -> None:
        """Notice that every gyro has sent since the last tick, and no samples of theirs belong together."""
        unjoined = len(self._gyros) > 1 and min(self._offered) > 0 and self._published == self._published_before
        self._offered, self._published_before = [0] * len(self._gyros), self._published
        if unjoined != self._unjoined:
            self._unjoined = unjoined
            self._on_change()

    def _on_change(self) -> None:
        """Publish the state when its meaning changed; numbers alone wait for the tick."""
        if not self._ready:
            return
        level, text = self._meaning()
        records = tuple(gyro.state.record.record_id for gyro in self._gyros if gyro.state.record is not None)
        meaning = (level, _NUMBER.sub("#", text), records)
        if meaning != self._said:
            self._said = meaning
            self._status.publish(self._make_status())
            self._log(level, text)

    def _log(self, level: int, text: str) -> None:
        # rclpy wants a line of its own for each severity
        if level == ERROR:
            self.get_logger().error(text)
        elif level == WARN:
            self.get_logger().warning(text)
        else:
            self.get_logger().info(text)

    def _meaning(self) -> tuple[int, str]:
        """Level and text of all gyros together."""
        level, texts = 0, []
        for gyro in self._gyros:
            problem = self._stream_problem(gyro)
            gyro_text = " ".join(filter(None, (problem[1], gyro.state.text)))
            level = max(level, gyro.state.level, problem[0])
            texts.append(f"{gyro.names.prefix}: {gyro_text}" if gyro.names.prefix else gyro_text)
        if self._unjoined:
            level = max(level, ERROR)
            texts.append(
                f"Stamps of the gyros must be within {self._join.tolerance_s:g} s of each other, but none are: nothing is published. "
                "Check the clocks of their drivers, or raise join_tolerance_s."
            )
        if self._filler.accel_frame_refused:
            level = max(level, WARN)
            texts.append(f"Acceleration left out: its frame is {self._filler.accel_frame_refused!r}, not that of the output.")
        if self.count_publishers(self._output.topic_name) > 1:
            level = max(level, WARN)
            texts.append(f"Another node publishes {self._output.topic_name} too: one of the two is one too many.")
        return level, " ".join(texts)

    def _stream_problem(self, gyro: GyroInput) -> tuple[int, str]:
        if not gyro.received:
            return WARN, f"Waiting for {gyro.topic}."
        # not a number before the first tick: no problem then
        if gyro.silent_s > self._value("stream_timeout_s"):
            return ERROR, f"No rate on {gyro.topic} for more than {self._value('stream_timeout_s'):g} s: is the gyro running?"
        if gyro.saturating:
            limit = gyro.state.range_rad_s
            return ERROR, f"Rate must stay below {limit:.4g} rad/s, the range of the gyro: samples beyond are left out. Turn slower."
        return 0, ""

    def _make_status(self) -> DiagnosticStatus:
        level, text = self._meaning()
        ids = [gyro.state.device_id for gyro in self._gyros if gyro.state.device_id]
        values: dict[str, object] = {"enabled": self._gyros[0].state.enabled if self._gyros else True}
        values |= {"published": self._published, "unmatched": self._join.unmatched, "covariance_mode": self._value("covariance_mode")}
        for gyro in self._gyros:
            prefix = f"{gyro.names.prefix}/" if gyro.names.prefix else ""
            values |= {f"{prefix}{key}": value for key, value in _facts(gyro).items()}
        name = f"{self.get_fully_qualified_name()[1:]}: correction"
        return DiagnosticStatus(level=_LEVELS[level], name=name, message=text, hardware_id=", ".join(ids), values=key_values(values))


def _facts(gyro: GyroInput) -> dict[str, object]:
    state, record = gyro.state, gyro.state.record
    facts: dict[str, object] = {
        "record_id": record.record_id if record is not None else "",
        "corrected": state.corrected,
        "publishing": state.publishing,
        "device_id": state.device_id,
        "device_verified": bool(state.device_id),
        "received": gyro.received,
        "repeated": gyro.clock.repeated,
        "not_finite": gyro.not_finite,
        "saturated": gyro.saturated,
        "time_restarts": gyro.clock.jumps,
        "sample_rate_hz": state.sample_rate_hz,
    }
    if state.temperature_degc is not None:
        facts["temperature_degc"] = state.temperature_degc
    if record is not None:
        facts |= {
            "record_source": state.source,
            "bias [deg/h]": deg_h(record.bias.value),
            "bias.sd [deg/h]": deg_h(record.bias.sd),
            "scale_factor_error [ppm]": ppm(record.scale_factor.value - 1.0),
            "scale_factor_error.sd [ppm]": ppm(record.scale_factor.sd),
        }
    return facts


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until it is told to stop."""
    return run_node(ImuCorrector, args)


if __name__ == "__main__":
    sys.exit(main())
