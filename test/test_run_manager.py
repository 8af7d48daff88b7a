"""The run state machine, without ROS: order of states, one run at a time, cancel and abort at every moment, work that breaks."""

from __future__ import annotations

import math
import threading

import pytest

from gyro_calib.errors import CalibrationRefused, DataError, ExperimentAborted
from gyro_calib.nodes.run_manager import Outcome, RunHandle, RunManager, RunState, RunStatus
from gyro_calib.quantity import Quantity

PATIENCE_S = 20.0


class Log:
    """Every status the manager tells, and its crash reports."""

    def __init__(self) -> None:
        self.seen: list[RunStatus] = []
        self.crashes: list[str] = []

    def states(self) -> list[str]:
        """States in order, without repeats in a row."""
        names = [s.state.value for s in self.seen]
        return [n for i, n in enumerate(names) if i == 0 or names[i - 1] != n]


class Gate:
    """Work that stops where a test wants it to, and obeys a cancel there."""

    def __init__(self, *, then: Exception | None = None) -> None:
        self.reached = threading.Event()
        self.go = threading.Event()
        self.then = then

    def hold(self, run: RunHandle) -> None:
        """Block until released or cancelled."""
        self.reached.set()
        while not self.go.wait(0.005):
            if run.cancelled():
                raise ExperimentAborted("stopped inside the work")

    def __call__(self, run: RunHandle) -> Outcome:
        run.progress(0.25, 12.0, "step one")
        self.hold(run)
        if self.then is not None:
            raise self.then
        return Outcome("found it", {"bias": Quantity(1.0, 0.1, "rad/s")})


@pytest.fixture
def log() -> Log:
    return Log()


@pytest.fixture
def manager(log: Log):
    runs = RunManager(log.seen.append, log.crashes.append)
    yield runs
    assert runs.close(PATIENCE_S), "a run was left hanging"


def test_idle_before_the_first_run(manager: RunManager, log: Log) -> None:
    assert manager.status.state is RunState.IDLE
    assert math.isnan(manager.status.eta_s)
    assert not manager.busy
    assert log.seen == []


def test_a_run_passes_through_its_states_in_order(manager: RunManager, log: Log) -> None:
    def work(run: RunHandle) -> Outcome:
        run.progress(0.5, 3.0, "half way")
        run.estimating("estimating")
        run.commit()
        return Outcome("bias found", {"bias": Quantity(2.0, 0.5, "rad/s")})

    reply = manager.request("self_calibrate", work)
    assert reply.accepted
    assert reply.message == f"accepted run {reply.run_id}"
    assert manager.wait(PATIENCE_S)
    assert log.states() == ["accepted", "running", "estimating", "done"]
    assert {s.run_id for s in log.seen} == {reply.run_id}
    last = manager.status
    assert (last.fraction, last.eta_s, last.message) == (1.0, 0.0, "bias found")
    assert last.results["bias"] == Quantity(2.0, 0.5, "rad/s")


def test_the_answer_comes_before_the_work_is_done(manager: RunManager) -> None:
    gate = Gate()
    reply = manager.request("run_sideband", gate)
    assert reply.accepted
    assert manager.busy
    gate.go.set()
    assert manager.wait(PATIENCE_S)
    assert manager.status.state is RunState.DONE


def test_a_second_request_is_refused_and_names_the_run_in_progress(manager: RunManager) -> None:
    gate = Gate()
    first = manager.request("run_sideband", gate)
    assert gate.reached.wait(PATIENCE_S)
    second = manager.request("self_calibrate", Gate())
    assert not second.accepted
    assert first.run_id in second.message
    assert "25%" in second.message
    assert manager.status.run_id == first.run_id
    gate.go.set()
    assert manager.wait(PATIENCE_S)
    third = manager.request("self_calibrate", lambda run: Outcome("ok"))
    assert third.accepted
    assert third.run_id != first.run_id


def test_of_many_simultaneous_requests_exactly_one_is_accepted(manager: RunManager) -> None:
    gate, replies, barrier = Gate(), [], threading.Barrier(8)

    def ask() -> None:
        barrier.wait(PATIENCE_S)
        replies.append(manager.request("self_calibrate", gate))

    threads = [threading.Thread(target=ask) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE_S)
    assert [r.accepted for r in replies].count(True) == 1
    assert len(replies) == 8


def test_cancel_ends_as_cancelled_with_its_reason(manager: RunManager, log: Log) -> None:
    gate = Gate()
    manager.request("self_calibrate", gate)
    assert gate.reached.wait(PATIENCE_S)
    reply = manager.cancel("cancelled on request")
    assert reply.accepted
    assert manager.wait(PATIENCE_S)
    assert manager.status.state is RunState.CANCELLED
    assert manager.status.message == "cancelled on request"
    assert manager.status.results == {}
    assert "stopping: cancelled on request" in [s.message for s in log.seen]


def test_cancel_without_a_run_is_refused(manager: RunManager) -> None:
    reply = manager.cancel()
    assert not reply.accepted
    assert "no run is in progress" in reply.message
    assert manager.status.state is RunState.IDLE


def test_abort_ends_as_failed_and_the_first_reason_wins(manager: RunManager) -> None:
    gate = Gate()
    manager.request("self_calibrate", gate)
    assert gate.reached.wait(PATIENCE_S)
    assert manager.abort("another device appeared").accepted
    manager.cancel("too late to be the reason")
    assert manager.wait(PATIENCE_S)
    assert manager.status.state is RunState.FAILED
    assert manager.status.message == "another device appeared"


def test_a_cancel_before_the_commit_leaves_no_trace(manager: RunManager) -> None:
    reached, go, traces = threading.Event(), threading.Event(), []

    def work(run: RunHandle) -> Outcome:
        reached.set()
        go.wait(PATIENCE_S)
        run.commit()
        traces.append("stored")
        return Outcome("stored")

    manager.request("self_calibrate", work)
    assert reached.wait(PATIENCE_S)
    assert manager.cancel().accepted
    go.set()
    assert manager.wait(PATIENCE_S)
    assert traces == []
    assert manager.status.state is RunState.CANCELLED


def test_a_cancel_after_the_commit_is_refused(manager: RunManager) -> None:
    committed, go = threading.Event(), threading.Event()

    def work(run: RunHandle) -> Outcome:
        run.commit()
        committed.set()
        go.wait(PATIENCE_S)
        return Outcome("stored")

    manager.request("self_calibrate", work)
    assert committed.wait(PATIENCE_S)
    reply = manager.cancel()
    assert not reply.accepted
    assert "too late" in reply.message
    go.set()
    assert manager.wait(PATIENCE_S)
    assert manager.status.state is RunState.DONE


def test_work_that_never_commits_can_be_cancelled_to_its_end(manager: RunManager) -> None:
    reached, go = threading.Event(), threading.Event()

    def work(run: RunHandle) -> Outcome:
        reached.set()
        go.wait(PATIENCE_S)
        return Outcome("nobody wants it any more")

    manager.request("run_feedthrough", work)
    assert reached.wait(PATIENCE_S)
    manager.cancel("changed my mind")
    go.set()
    assert manager.wait(PATIENCE_S)
    assert (manager.status.state, manager.status.message) == (RunState.CANCELLED, "changed my mind")


@pytest.mark.parametrize(
    "error",
    [
        DataError("Stream must have no NaN, but got NaN in x_pick_c. Check the gyro."),
        CalibrationRefused("Condition number must be < 1e6, but got 1e9. Inject a known quadrature."),
        ExperimentAborted("Temperature must stay within 2 K, but got 3 K."),
    ],
    ids=lambda e: type(e).__name__,
)
def test_an_error_of_the_package_becomes_the_message(manager: RunManager, log: Log, error: Exception) -> None:
    gate = Gate(then=error)
    gate.go.set()
    manager.request("self_calibrate", gate)
    assert manager.wait(PATIENCE_S)
    assert manager.status.state is RunState.FAILED
    assert manager.status.message == str(error)
    assert math.isnan(manager.status.eta_s)
    assert log.crashes == []


def test_a_programming_error_is_a_failed_run_with_a_traceback(manager: RunManager, log: Log) -> None:
    gate = Gate(then=ZeroDivisionError("oops"))
    gate.go.set()
    manager.request("self_calibrate", gate)
    assert manager.wait(PATIENCE_S)
    assert manager.status.state is RunState.FAILED
    assert "internal error, ZeroDivisionError: oops" in manager.status.message
    assert "Traceback" in log.crashes[0]
    assert manager.request("self_calibrate", lambda run: Outcome("works again")).accepted


def test_an_error_while_stopping_keeps_the_reason_of_the_stop(manager: RunManager) -> None:
    reached, go = threading.Event(), threading.Event()

    def work(run: RunHandle) -> Outcome:
        reached.set()
        go.wait(PATIENCE_S)
        raise DataError("the stream broke too")

    manager.request("self_calibrate", work)
    assert reached.wait(PATIENCE_S)
    manager.cancel("cancelled on request")
    go.set()
    assert manager.wait(PATIENCE_S)
    assert manager.status.state is RunState.CANCELLED
    assert manager.status.message == "cancelled on request (the stream broke too)"


def test_a_note_ends_up_in_the_last_message(manager: RunManager) -> None:
    def work(run: RunHandle) -> Outcome:
        run.note("The gyro could not be put back into its mission mode.")
        raise DataError("stream stopped.")

    manager.request("self_calibrate", work)
    assert manager.wait(PATIENCE_S)
    assert manager.status.message == "stream stopped. The gyro could not be put back into its mission mode."
    manager.request("self_calibrate", lambda run: Outcome("clean"))
    assert manager.wait(PATIENCE_S)
    assert manager.status.message == "clean", "a note of one run must not reach the next"


def test_progress_after_a_cancel_does_not_hide_it(manager: RunManager, log: Log) -> None:
    reached, go = threading.Event(), threading.Event()

    def work(run: RunHandle) -> Outcome:
        reached.set()
        go.wait(PATIENCE_S)
        run.progress(0.9, 1.0, "still at it")
        run.estimating("still at it")
        raise ExperimentAborted("stopped")

    manager.request("self_calibrate", work)
    assert reached.wait(PATIENCE_S)
    manager.cancel()
    go.set()
    assert manager.wait(PATIENCE_S)
    assert "still at it" not in [s.message for s in log.seen]


@pytest.mark.parametrize(("given", "told"), [(-0.5, 0.0), (0.3, 0.3), (1.5, 1.0)])
def test_the_fraction_stays_between_0_and_1(manager: RunManager, log: Log, given: float, told: float) -> None:
    def work(run: RunHandle) -> Outcome:
        run.progress(given, 1.0, "step")
        return Outcome("ok")

    manager.request("self_calibrate", work)
    assert manager.wait(PATIENCE_S)
    assert [s.fraction for s in log.seen if s.message == "step"] == [told]


def test_close_cancels_and_accepts_nothing_more(log: Log) -> None:
    manager, gate = RunManager(log.seen.append), Gate()
    manager.request("self_calibrate", gate)
    assert gate.reached.wait(PATIENCE_S)
    assert manager.close(PATIENCE_S)
    assert manager.status.state is RunState.CANCELLED
    assert "shutting down" in manager.status.message
    assert not manager.request("self_calibrate", Gate()).accepted


def test_close_does_not_wait_for_ever(log: Log) -> None:
    release = threading.Event()
    manager = RunManager(log.seen.append)

    def deaf(run: RunHandle) -> Outcome:
        release.wait(PATIENCE_S)
        return Outcome("late")

    manager.request("self_calibrate", deaf)
    assert not manager.close(0.05)
    release.set()
    assert manager.wait(PATIENCE_S)
