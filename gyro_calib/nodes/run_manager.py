"""One calibration run at a time: its states, its progress and how it ends. Knows nothing of ROS and nothing of gyros.

``idle -> accepted -> running -> estimating -> done``, and from each of the middle three to ``failed`` or ``cancelled``. The work is done in
a thread of its own, so that a service answers at once; whoever wants to know is told through one callback, in order.
"""

from __future__ import annotations

import enum
import math
import threading
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone

from ..errors import ExperimentAborted, GyroCalibError
from ..quantity import Quantity

__all__ = ["Outcome", "Reply", "RunHandle", "RunManager", "RunState", "RunStatus", "Work"]


class RunState(str, enum.Enum):
    """Where a run is."""

    IDLE = "idle"
    ACCEPTED = "accepted"
    RUNNING = "running"
    ESTIMATING = "estimating"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def busy(self) -> bool:
        """Whether a run in this state still works."""
        return self in (RunState.ACCEPTED, RunState.RUNNING, RunState.ESTIMATING)


@dataclass(frozen=True)
class RunStatus:
    """What is known of the present or the last run.

    Parameters
    ----------
    run_id : str
        Empty before the first run.
    name : str
        What was asked for (``"self_calibrate"``, …).
    state : RunState
        Where the run is.
    fraction : float
        Part done, 0…1.
    eta_s : float
        Wall time left [s]; NaN when unknown.
    message : str
        For people: the present step, the outcome, or the reason and the remedy.
    results : mapping of str to Quantity
        What a finished run found.
    facts : mapping of str to str
        What it found that is no number, and where its files are.
    attention : bool
        What it found should be looked at.
    """

    run_id: str = ""
    name: str = ""
    state: RunState = RunState.IDLE
    fraction: float = 0.0
    eta_s: float = math.nan
    message: str = "no run yet"
    results: Mapping[str, Quantity] = field(default_factory=dict)
    facts: Mapping[str, str] = field(default_factory=dict)
    attention: bool = False


@dataclass(frozen=True)
class Outcome:
    """What a run that succeeded says: a sentence, its results and facts, and whether they should be looked at."""

    message: str
    results: Mapping[str, Quantity] = field(default_factory=dict)
    facts: Mapping[str, str] = field(default_factory=dict)
    attention: bool = False


@dataclass(frozen=True)
class Reply:
    """The answer to a request: accepted or refused, and the sentence that says so."""

    accepted: bool
    message: str
    run_id: str = ""


class RunHandle:
    """What the work sees of its run: where to report, and whether to stop."""

    def __init__(self, manager: RunManager, run_id: str) -> None:
        self._manager = manager
        self.run_id = run_id

    def cancelled(self) -> bool:
        """Whether the work must stop now (somebody cancelled, or a watchdog aborted)."""
        return self._manager._stop.is_set()

    def progress(self, fraction: float, eta_s: float, message: str) -> None:
        """Report the part done [0…1], the wall time left [s] and the present step; too late once the estimate has begun."""
        self._manager._update(RunState.RUNNING, fraction=min(max(fraction, 0.0), 1.0), eta_s=eta_s, message=message)

    def found(self, results: Mapping[str, Quantity], message: str) -> None:
        """Report what is found already; the run goes on."""
        self._manager._update(RunState.RUNNING, message=message, results=dict(results))

    def estimating(self, message: str, *, fraction: float = 1.0, eta_s: float = 0.0) -> None:
        """Say that the recordings are complete and the estimate is being computed; one that takes long says how far the run is."""
        self._manager._update(RunState.ESTIMATING, fraction=min(max(fraction, 0.0), 1.0), eta_s=eta_s, message=message)

    def note(self, text: str) -> None:
        """Add a sentence to the message with which the run will end, however it ends."""
        self._manager._note(text)

    def commit(self) -> None:
        """Point of no return: from here on a cancel is refused; before it, the run leaves no trace.

        Raises
        ------
        ExperimentAborted
            The run was cancelled before.
        """
        self._manager._commit()


Work = Callable[[RunHandle], Outcome]


class RunManager:
    """Runs one piece of work at a time in its own thread.

    Parameters
    ----------
    on_change : callable of RunStatus
        Told of every change, in order, from whatever thread makes it; it must be short and must not call back into the manager.
    on_crash : callable of str, optional
        Told the traceback when the work fails with anything but an error of this package.
    """

    def __init__(self, on_change: Callable[[RunStatus], None], on_crash: Callable[[str], None] | None = None) -> None:
        self._on_change = on_change
        self._on_crash = on_crash or (lambda text: None)
        self._lock = threading.RLock()
        self._stop = threading.Event()
        self._stop_reason = ""
        self._stop_state = RunState.CANCELLED
        self._committed = False
        self._notes: list[str] = []
        self._closed = False
        self._count = 0
        self._thread: threading.Thread | None = None
        self._status = RunStatus()

    @property
    def status(self) -> RunStatus:
        """Snapshot of the present or last run; takes no lock, so that it may be read from anywhere."""
        return self._status

    @property
    def busy(self) -> bool:
        """Whether a run is on its way."""
        return self.status.state.busy

    def refusal(self, name: str) -> Reply | None:
        """Why run ``name`` would be refused now; None if it would be accepted."""
        with self._lock:
            now = self._status
            if self._closed:
                return Reply(False, f"refused {name}: the calibration node is shutting down")
            if not now.state.busy:
                return None
            return Reply(
                False,
                f"refused {name}: run {now.run_id} is in progress ({now.state.value}, {now.fraction:.0%}). "
                "Wait for it to end or cancel it.",
                now.run_id,
            )

    def request(self, name: str, work: Work) -> Reply:
        """Start ``work`` as run ``name``, unless one is on its way; answers at once."""
        with self._lock:
            if (refused := self.refusal(name)) is not None:
                return refused
            self._count += 1
            run_id = f"{name}-{datetime.now(timezone.utc):%Y%m%dT%H%M%SZ}-{self._count}"
            self._stop.clear()
            self._committed = False
            self._notes = []
            self._set(RunStatus(run_id, name, RunState.ACCEPTED, 0.0, math.nan, f"accepted run {run_id}"))
            # A daemon: a run that hangs in a dead driver must not keep the process from exiting.
            self._thread = threading.Thread(target=self._work, args=(RunHandle(self, run_id), work), name=f"run {run_id}", daemon=True)
            self._thread.start()
            return Reply(True, f"accepted run {run_id}", run_id)

    def cancel(self, reason: str = "cancelled on request") -> Reply:
        """Ask the run to stop; it ends as ``cancelled``."""
        return self._end(reason, RunState.CANCELLED)

    def abort(self, reason: str) -> Reply:
        """Stop the run because something is wrong; it ends as ``failed`` with ``reason``."""
        return self._end(reason, RunState.FAILED)

    def wait(self, timeout_s: float) -> bool:
        """Wait for the run to end; whether it has."""
        thread = self._thread
        if thread is not None:
            thread.join(timeout_s)
        return not self.busy

    def close(self, timeout_s: float) -> bool:
        """Cancel what runs, accept nothing more, wait up to ``timeout_s``; whether all is quiet."""
        with self._lock:
            self._closed = True
        self.cancel("cancelled: the calibration node is shutting down")
        return self.wait(timeout_s)

    def _end(self, reason: str, state: RunState) -> Reply:
        with self._lock:
            now = self._status
            if not now.state.busy:
                return Reply(False, "nothing to cancel: no run is in progress", now.run_id)
            if self._committed:
                return Reply(False, f"too late to cancel: run {now.run_id} has its result and is putting it in force", now.run_id)
            if not self._stop.is_set():
                self._stop_reason, self._stop_state = reason, state
                self._stop.set()
                self._set(replace(now, message=f"stopping: {reason}"))
            return Reply(True, f"stopping run {now.run_id}: {self._stop_reason}", now.run_id)

    def _commit(self) -> None:
        with self._lock:
            if self._stop.is_set():
                raise ExperimentAborted(self._stop_reason)
            self._committed = True

    def _note(self, text: str) -> None:
        with self._lock:
            self._notes.append(text)

    def _update(self, state: RunState, **changes: object) -> None:
        with self._lock:
            now = self._status.state
            late = not now.busy or (now is RunState.ESTIMATING and state is RunState.RUNNING)
            # A stop that is on its way keeps its message: "stopping: …" says more than the step it interrupts.
            if not late and not self._stop.is_set():
                self._set(replace(self._status, state=state, **changes))  # type: ignore[arg-type]

    def _set(self, status: RunStatus) -> None:
        self._status = status
        self._on_change(status)

    def _work(self, handle: RunHandle, work: Work) -> None:
        try:
            outcome = work(handle)
            handle.commit()  # work that leaves a trace has committed before; other work can be cancelled to its very end
        except Exception as error:
            self._fail(error)
            return
        found = {"results": outcome.results, "facts": outcome.facts, "attention": outcome.attention}
        self._finish(RunState.DONE, outcome.message, fraction=1.0, eta_s=0.0, **found)

    def _fail(self, error: Exception) -> None:
        known = isinstance(error, GyroCalibError)
        if not known:
            self._on_crash("".join(traceback.format_exception(type(error), error, error.__traceback__)))
        text = str(error) if known else f"internal error, {type(error).__name__}: {error}. Please report it with the log of this node."
        with self._lock:
            if not self._stop.is_set() or self._committed:
                self._finish(RunState.FAILED, text, eta_s=math.nan)
                return
            # Whatever the work stumbled over once it was told to stop, the reason is that it was told to stop.
            reason = self._stop_reason if isinstance(error, ExperimentAborted) else f"{self._stop_reason} ({text})"
            self._finish(self._stop_state, reason, eta_s=math.nan)

    def _finish(self, state: RunState, message: str, **changes: object) -> None:
        with self._lock:
            self._set(replace(self._status, state=state, message=" ".join([message, *self._notes]), **changes))  # type: ignore[arg-type]
