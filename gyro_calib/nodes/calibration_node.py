"""``gyro_calibration``: calibrates the gyro beside it on a service call, and says what is in force.

Reaches the gyro only through its topic ``channels`` and the parameters of its driver. Services (std_srvs/Trigger; the runs are in
:mod:`~gyro_calib.nodes.calibration_runs`) answer at once; progress and outcome are on latched ``~/status`` and on ``/diagnostics`` at 1 Hz.

Latched topics
    ``~/bias`` (TwistWithCovarianceStamped): bias of ``rate_raw``, ``angular.z`` [rad/s], variance ``covariance[35]``.
    ``~/scale_factor`` (Vector3Stamped): ``z`` = K of ``rate_raw`` [1]; ``x``, ``y`` = V per rad/s with x, y as the oscillator.
    ``~/compensation`` (Float64MultiArray): drive compensation, 2x2.
    ``~/is_calibrated`` (Bool): a calibration of the gyro that is there is in force.
    ``~/calibration`` (DiagnosticArray): the whole record; key ``record_yaml`` is the document as stored.
    ``rate = (rate_raw - bias) / K``.
Policy
    The record of a successful run is in force at once, and on disk unless ``autosave`` is false; ``~/save`` stores it, ``~/revert`` takes
    the one before back into force and on disk. A run that ends in any other way changes neither.
    The drive compensation of a record is a parameter of the gyro: a run puts it in force with its record, a revert takes the earlier one
    back, and a gyro that starts without one gets it (``apply_compensation``).
"""

from __future__ import annotations

import math
import sys
import threading
import traceback
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from diagnostic_msgs.srv import SelfTest
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_srvs.srv import Trigger

from ..calibration.record import CalibrationRecord
from ..errors import DataError, GyroCalibError, StoreError
from .calibration_in_force import CalibrationInForce
from .calibration_messages import self_test_response, status_message
from .calibration_parameters import check_parameters, declare_parameters, read_parameters
from .calibration_runs import RUNS, CalibrationRun, KeptRecordings
from .calibration_topics import CalibrationTopics
from .company import refuse_company
from .compensation_keeper import CompensationKeeper
from .gap_run import GapRun, fleet_of_kind
from .gyro_client import GyroClient
from .gyro_watch import GyroFacts, GyroWatch, MonitoredInstrument
from .recording_run import RecordingRun
from .run_manager import Outcome, Reply, RunHandle, RunManager, RunState, RunStatus
from .runtime import LATCHED_QOS, close_on_signal, make_executor, spin
from .self_checks import check_device, check_record, check_store, check_stream

__all__ = ["CalibrationNode", "main"]

_DIAGNOSTICS_S = 1.0
#: progress inside a step is told this often [s]
_HEARTBEAT_S = 0.5
#: a driver that answers later than this is asked again [s]
_WATCH_TIMEOUT_S = 1.0
#: a run that is told to stop puts its gyro back; this is all it gets when the process ends [s]
_CLOSE_S = 15.0


class CalibrationNode(Node):
    """See the module text.

    Raises
    ------
    DataError
        A parameter that is not possible.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("gyro_calibration", **options)
        self._settings = settings = declare_parameters(self)
        self.add_on_set_parameters_callback(check_parameters)
        self._publish_lock = threading.Lock()
        self._said: DiagnosticStatus | None = None
        #: the device whose records are kept, the one that the driver reports, and why that is not the same
        self._bound = self._present = self._refusal = ""
        self._work: RecordingRun | None = None
        self._kept = KeptRecordings()
        self._runs = RunManager(self._on_run, lambda text: self.get_logger().error(text))
        self._in_force = CalibrationInForce(settings.record_url, self._on_calibration)
        self._make_topics()
        self._instrument = MonitoredInstrument(
            self,
            gyro=settings.gyro_node,
            expected_device_id=settings.device_id or None,
            stall_s=settings.stream_timeout_s,
            notice=lambda text: self.get_logger().warning(text),
        )
        self._client = GyroClient(self, settings.gyro_node, timeout_s=_WATCH_TIMEOUT_S)
        self._keeper = CompensationKeeper(self._client.set, lambda text: self._log(RunState.DONE, text))
        self._watch = GyroWatch(self._client.get, self._meet, self._publish_status)
        self._channels = self.resolve_topic_name("channels")
        self._make_services()
        if settings.device_id:
            self._bind(settings.device_id)
        else:
            self._on_calibration()
        self._watch.start()

    def _make_topics(self) -> None:
        self._topics = CalibrationTopics(self, self._settings.frame_id)
        self._status = self.create_publisher(DiagnosticStatus, "~/status", LATCHED_QOS)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        # a steady clock: with use_sim_time and no /clock the node's own stands still, and that is what is to be reported
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_DIAGNOSTICS_S, self._publish_diagnostics, clock=steady)
        self.create_timer(_HEARTBEAT_S, self._heartbeat, clock=steady)

    # -- services: each answers at once ---------------------------------------------------------------------------------------------

    def _make_services(self) -> None:
        actions: dict[str, Callable[[], Reply]] = {name: partial(self._request, name) for name in RUNS}
        actions |= {"cancel": self._runs.cancel, "save": self._save, "revert": self._revert}
        for name, action in actions.items():
            self.create_service(Trigger, f"~/{name}", partial(self._answer, name, action))
        self.create_service(SelfTest, "~/self_test", self._answer_self_test)

    def _answer(self, name: str, action: Callable[[], Reply], _: Any, response: Any) -> Any:
        try:
            reply = action()
        except GyroCalibError as error:
            reply = Reply(False, f"refused {name}: {error}")
        except Exception as error:  # an exception that leaves a callback would end the node, and the run with it
            reply = Reply(
                False, f"refused {name}: internal error, {type(error).__name__}: {error}. Please report it with the log of this node."
            )
            self.get_logger().error(traceback.format_exc())
        self._log(RunState.DONE if reply.accepted else RunState.CANCELLED, reply.message)
        response.success, response.message = reply.accepted, reply.message
        return response

    def _request(self, name: str) -> Reply:
        if (refused := self._runs.refusal(name)) is not None:
            return refused
        facts = self._ready()
        settings = read_parameters(self)
        kind = RUNS[name]
        kind.check(facts.factory)
        if kind.estimates and settings.autosave:
            self._check_disk()
        try:
            plan, verify = kind.plans(facts.factory, quality=settings.plan_quality, limits=settings.limits)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            raise DataError(f"Factory data of the gyro must be usable, but got {facts.factory!r} ({error}). Correct the driver.") from error
        artifacts = Path(settings.artifacts_dir).expanduser() if settings.artifacts_dir else None
        work: RecordingRun
        if kind.diagnoses:
            fleet = fleet_of_kind(settings.fleet, facts.factory)
            work = GapRun(self._instrument, plan, beside=self._in_force.path, artifacts=artifacts, fleet=fleet)
        else:
            work = CalibrationRun(
                self._instrument,
                kind,
                plan,
                kept=self._kept,
                confirm=lambda: self._confirm(facts.device_id),
                adopt=partial(self._in_force.adopt, save=settings.autosave),
                artifacts=artifacts,
                verify=verify,
                in_force=lambda: self._in_force.record,
            )
        reply = self._runs.request(name, partial(self._carry_out, facts.device_id, work))
        if not reply.accepted:
            return reply
        self._work = work
        return Reply(True, f"{reply.message} ({len(plan.steps)} steps, {plan.duration_s:.0f} s of device time)", reply.run_id)

    def _check_disk(self) -> None:
        """Better a refusal now than a result after minutes that cannot be stored."""
        store = self._in_force.store
        if store is not None and not (check := check_store(store)).passed:
            raise StoreError(f"{check.message} Or set autosave false: the result is then in force, but not on disk.")

    def _ready(self) -> GyroFacts:
        """Whether a run could begin now, from what is known without asking."""
        refuse_company(self, self._channels)
        facts, settings = self._watch.facts, self._settings
        if facts is None or self._watch.problem:
            raise DataError(self._watch.problem)
        device = check_device(facts.device_id, settings.device_id)
        if not device.passed:
            raise DataError(device.message)
        if self._instrument.recent.error:
            raise DataError(self._instrument.recent.error)
        if (age_s := self._instrument.recent.age_s) > settings.stream_timeout_s:
            since = f"none came for {age_s:.1f} s" if math.isfinite(age_s) else "none has come"
            raise DataError(f"Stream of the gyro must deliver blocks, but {since}. Check that the gyro runs, then call again.")
        return facts

    def _save(self) -> Reply:
        return Reply(True, self._in_force.save())

    def _revert(self) -> Reply:
        if self._runs.busy:
            raise StoreError(f"Run {self._runs.status.run_id} is in progress. Wait for it to end or cancel it.")
        said = self._in_force.revert()
        self._owe(only_fresh=False)
        return Reply(True, said)

    def _answer_self_test(self, _: Any, response: Any) -> Any:
        facts, recent, store = self._watch.facts, self._instrument.recent, self._in_force.store
        checks = check_stream(
            recent.rows(),
            recent.age_s,
            self._settings.stream_timeout_s,
            sample_rate_hz=facts.sample_rate_hz if facts else None,
            command=facts.command if facts else None,
            problem=recent.error,
        )
        checks.append(check_device(facts.device_id if facts and not self._watch.problem else "", self._settings.device_id))
        if store is not None:
            checks += [check_store(store), check_record(store)]
        return self_test_response(response, facts.device_id if facts else "", checks)

    # -- the run's thread -----------------------------------------------------------------------------------------------------------

    def _carry_out(self, device_id: str, work: RecordingRun, run: RunHandle) -> Outcome:
        self._instrument.cancelled = run.cancelled
        self._instrument.connect()
        _same_device(device_id, self._instrument.device_id)
        return work(run)

    def _confirm(self, device_id: str) -> None:
        """Ask the driver once more who it is, before the result is put in force."""
        _same_device(device_id, GyroFacts.read(self._client.get).device_id)

    # -- the watch's thread -----------------------------------------------------------------------------------------------------------

    def _meet(self, facts: GyroFacts) -> None:
        """The gyro says who it is: load its record, or refuse it; a run with another one ends."""
        device = check_device(facts.device_id, self._settings.device_id)
        self._present, self._refusal = facts.device_id, "" if device.passed else device.message
        if facts.device_id != self._bound and self._runs.busy:
            self._runs.abort(
                f"Gyro must stay {self._bound!r} during a run, but is now {facts.device_id!r}. Start the run again with one unit."
            )
            return  # the run ends first; the next answer of the driver finds it ended
        if device.passed and facts.device_id != self._bound:
            self._bind(facts.device_id)
        else:
            self._on_calibration()
        if self._watch.facts is None or self._watch.problem:
            self._owe(only_fresh=True)
        if device.passed and not self._runs.busy:
            self._keeper.pay(facts.command)

    def _owe(self, *, only_fresh: bool) -> None:
        """The gyro is to have the drive compensation of its record, unless that is left to others."""
        record = self._in_force.record
        if self._calibrated(record) and read_parameters(self).apply_compensation:
            self._keeper.owe(record, only_fresh=only_fresh)

    def _bind(self, device_id: str) -> None:
        self._bound = device_id
        self._in_force.bind(device_id)
        if self._in_force.problem:
            self.get_logger().warning(self._in_force.problem)
        elif (record := self._in_force.record) is not None:
            self.get_logger().info(f"Calibration {record.record_id} is in force.")

    # -- publishing -------------------------------------------------------------------------------------------------------------------

    def _on_run(self, status: RunStatus) -> None:
        if status.run_id and not status.state.busy:
            self._log(status.state, f"run {status.run_id} {status.state.value}: {status.message}")
        self._publish_status()

    def _log(self, state: RunState, text: str) -> None:
        """One line for each severity: rclpy refuses a call site that changes it."""
        if state is RunState.FAILED:
            self.get_logger().error(text)
        elif state is RunState.CANCELLED:
            self.get_logger().warning(text)
        else:
            self.get_logger().info(text)

    def _calibrated(self, record: CalibrationRecord | None) -> bool:
        """Whether ``record`` is of the gyro that is there, or of the expected one while none is."""
        return record is not None and record.device_id == (self._present or self._bound)

    def _on_calibration(self) -> None:
        record, problem = self._in_force.record, self._in_force.problem
        self._topics.publish(record, device_id=self._bound, is_calibrated=self._calibrated(record), reason=problem)
        self._publish_status()

    def _publish_status(self) -> None:
        """Publish the state when it says something new."""
        with self._publish_lock:
            status = self._make_status()
            if status != self._said:
                self._said = status
                self._status.publish(status)

    def _publish_diagnostics(self) -> None:
        self._publish_status()
        array = DiagnosticArray(status=[self._make_status()])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _heartbeat(self) -> None:
        if self._work is not None and self._runs.busy:
            self._work.heartbeat(self._instrument.recorded_fraction)

    def _make_status(self) -> DiagnosticStatus:
        status, record, gyro = self._runs.status, self._in_force.record, self._watch.facts
        silent = self._instrument.recent.age_s > self._settings.stream_timeout_s
        facts: dict[str, object] = {
            "calibration": record.record_id if record is not None else "",
            "is_calibrated": self._calibrated(record),
            "saved": self._in_force.saved,
            # only what runs begin with: who waits for it can call one
            "device_id": gyro.device_id if gyro is not None else "",
            "stream": "silent" if silent else "alive",
        }
        if record is not None:
            facts |= {"in_force.scale_factor.sd [1]": record.scale_factor.sd, "in_force.bias.sd [rad/s]": record.bias.sd}
        return status_message(
            status,
            name=f"{self.get_fully_qualified_name()[1:]}: calibration",
            device_id=self._present or self._bound,
            facts=facts,
            in_force=record.record_id if record is not None else "",
            problem=" ".join(self._problems(status, silent)),
        )

    def _problems(self, status: RunStatus, silent: bool) -> list[str]:
        """What is wrong outside a run; while one is on its way, it says itself what is."""
        found = [self._refusal]
        if not status.state.busy:
            found += [self._in_force.problem, self._watch.problem]
            command = self._watch.facts.command if self._watch.facts is not None else None
            if silent and not self._watch.problem:
                found.append(f"No block came for {self._settings.stream_timeout_s:g} s: check that the gyro runs.")
            elif command is not None and (command.mode == "loops_off" or command.excitation.kind != "none"):
                found.append(
                    f"The gyro is left in {command.mode} with excitation {command.excitation.kind}: run a calibration or set its mode."
                )
            elif command is not None and (record := self._in_force.record) is not None and self._calibrated(record):
                found += self._keeper.problems(record, command)
        return [text for text in found if text]

    # -- the end ----------------------------------------------------------------------------------------------------------------------

    def close(self) -> None:
        """Cancel what runs and wait until the gyro is back in its mission; needs the callbacks of this node still served."""
        self._runs.close(_CLOSE_S)
        self._watch.stop(_WATCH_TIMEOUT_S)

    def destroy_node(self) -> None:
        """End run and watch, then the node."""
        self.close()
        super().destroy_node()


def _same_device(begun: str, found: str) -> None:
    if found != begun:
        raise DataError(f"Gyro must stay {begun!r} during a run, but is now {found!r}. Start the run again with one unit.")


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; a run on its way is cancelled and its gyro put back before the node ends.

    rclpy's own signal handlers would shut the context down at once, and the gyro with it out of reach; hence none of them.
    """
    rclpy.init(args=None if args is None else ["", *args], signal_handler_options=SignalHandlerOptions.NO)
    node: CalibrationNode | None = None
    executor: Any = None
    quiet: Future = Future()
    try:
        node = CalibrationNode()
        executor = make_executor()
        executor.add_node(node)
        close_on_signal(node.close, quiet)
        spin(executor, quiet)
        return 0
    except (GyroCalibError, rclpy.exceptions.InvalidParameterTypeException, rclpy.exceptions.InvalidParameterValueException) as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
        return 1
    finally:
        if node is not None:
            if executor is not None:
                executor.remove_node(node)
            node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
