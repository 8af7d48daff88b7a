"""The part that all runs share: a plan is recorded, its progress told, its file kept, and the gyro is back in its mission in the end."""

from __future__ import annotations

import contextlib
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..calibration.compensation_rounds import Leg
from ..errors import GyroCalibError
from ..experiments import Instrument, Plan, Progress, compensation_in_force, run_plan
from ..recording.command import Command
from ..recording.hdf5 import write_campaign_h5
from ..recording.recording import Campaign, Recording
from .run_manager import Outcome, RunHandle

__all__ = ["RecordingRun"]


class RecordingRun(ABC):
    """A run that records a plan; what becomes of the recordings is the deriving class's.

    Parameters
    ----------
    instrument : Instrument
        The gyro.
    plan : Plan
        Recorded with the compensation that the gyro has.
    artifacts : Path, optional
        Folder in which ``<run id>/campaign.h5`` keeps the recordings; None keeps none.
    """

    def __init__(self, instrument: Instrument, plan: Plan, artifacts: Path | None = None) -> None:
        self._instrument = _Watched(instrument)
        self._plan, self._artifacts = plan, artifacts
        self._leg = Leg(1, plan, 0.0, plan.duration_s)
        self._run: RunHandle | None = None
        self._progress: Progress | None = None
        self._started_s = self._fraction = 0.0
        self._last_round = ""

    @abstractmethod
    def __call__(self, run: RunHandle) -> Outcome:
        """Carry the run out."""

    def heartbeat(self, recorded_fraction: float) -> None:
        """Report the progress inside a step; ``recorded_fraction`` is what the instrument has of the present recording, 0 to 1."""
        run, now, plan = self._run, self._progress, self._leg.plan
        if run is None or now is None or not self._instrument.recording:
            return
        step = plan.steps[now.step_index]
        fraction = self._leg.fraction(now.fraction + recorded_fraction * step.duration_s / plan.duration_s)
        elapsed_s = time.monotonic() - self._started_s
        self._tell(run, fraction, elapsed_s * (1.0 - fraction) / fraction if fraction > 0 else math.nan, now)

    def _tell(self, run: RunHandle, fraction: float, eta_s: float, progress: Progress) -> None:
        # two threads tell: a heartbeat that comes late must not turn the progress back
        self._fraction = fraction = max(fraction, self._fraction)
        step = f"step {progress.step_index + 1} of {progress.steps}: {progress.step_label}"
        # the last call comes when all is recorded
        message = step if progress.step_label else "recordings complete"
        # the topic keeps its last message only: what a round found is said as long as the next one takes
        run.progress(fraction, eta_s, f"round {self._leg.number}, {message}; {self._last_round}" if self._last_round else message)

    def _told(self, leg: Leg, progress: Progress) -> None:
        self._progress = progress
        assert self._run is not None
        fraction = leg.fraction(progress.fraction)
        elapsed_s = time.monotonic() - self._started_s
        self._tell(self._run, fraction, elapsed_s * (1.0 - fraction) / fraction if fraction > 0 else math.nan, progress)

    @contextlib.contextmanager
    def _recording(self, run: RunHandle, rest: Command) -> Iterator[None]:
        """Progress is told meanwhile; in the end the gyro is in its mission, or that is said."""
        self._run, self._started_s = run, time.monotonic()
        try:
            yield
        finally:
            self._run = None
            if not self._instrument.rests_in(rest):
                run.note(f"The gyro may not be back in its mission command ({rest.mode}): set its parameters, or restart its driver.")

    def _record(self, run: RunHandle, rest: Command) -> Campaign:
        plan = self._plan.with_compensation(rest.compensation)
        with self._recording(run, rest):
            return run_plan(self._instrument, plan, on_progress=lambda p: self._told(self._leg, p), cancelled=run.cancelled)

    def _write(self, run: RunHandle, campaign: Campaign) -> None:
        """Keep the recordings as a file, whatever comes of the estimate; a disk that refuses does not end the run."""
        if self._artifacts is None:
            return
        try:
            folder = self._artifacts / run.run_id
            folder.mkdir(parents=True, exist_ok=True)
            write_campaign_h5(folder / "campaign.h5", campaign)
        except (OSError, GyroCalibError) as error:
            run.note(f"The recordings could not be written: {error}.")


class _Watched:
    """An instrument that remembers whether its last command was taken."""

    def __init__(self, instrument: Instrument) -> None:
        self._instrument = instrument
        self._touched = False
        self._taken: Command | None = None
        self.recording = False

    def rests_in(self, command: Command) -> bool:
        """Whether the gyro is as it was found, or ``command`` is the last that it took."""
        return not self._touched or self._taken == command

    @property
    def device_id(self) -> str:
        return self._instrument.device_id

    @property
    def factory(self) -> dict[str, Any]:
        return self._instrument.factory

    @property
    def abilities(self) -> frozenset[str]:
        return frozenset(getattr(self._instrument, "abilities", ()))

    @property
    def command(self) -> Command:
        return Command(compensation=compensation_in_force(self._instrument))

    def configure(self, command: Command) -> None:
        self._touched, self._taken = True, None
        self._instrument.configure(command)
        self._taken = command

    def record(self, duration_s: float, **options: Any) -> Recording:
        self.recording = True
        try:
            return self._instrument.record(duration_s, **options)
        finally:
            self.recording = False
