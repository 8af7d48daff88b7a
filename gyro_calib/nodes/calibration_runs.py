"""What each run service does: its plan, and what becomes of the recordings. No ROS here; the gyro is behind the instrument seam.

A run is: plan, recordings, estimate, record, and only then one step that changes anything: the record is stored and put in force. Whatever
goes wrong before leaves the previous calibration, in force and on disk, as it was, and the gyro back in its mission command.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..calibration import FactoryStore, record_from_result, with_factory_record
from ..calibration.record import CalibrationRecord
from ..errors import ExperimentAborted, GyroCalibError
from ..estimation import calibrate
from ..experiments import Instrument, Plan, Progress, feedthrough_plan, run_plan, self_calibration_plan, sideband_plan
from ..quantity import Quantity
from ..recording.command import Command
from ..recording.hdf5 import write_campaign_h5
from ..recording.recording import Campaign, Recording
from ..units import DEG_H, deg_h
from .run_manager import Outcome, RunHandle

__all__ = ["RUNS", "CalibrationRun", "KeptRecordings", "PlanBuilder", "RunKind", "record_results"]

PlanBuilder = Callable[..., Plan]


@dataclass(frozen=True)
class RunKind:
    """One run service.

    Parameters
    ----------
    plan : callable
        ``plan(factory, quality=…, limits=…) -> Plan``.
    estimates : bool
        Whether a calibration follows from the recordings; otherwise they are kept for the next run that does.
    description : str
        For people.
    """

    plan: PlanBuilder
    estimates: bool
    description: str


#: service name -> what it does; a further run is one line
RUNS: dict[str, RunKind] = {
    "self_calibrate": RunKind(self_calibration_plan, True, "feedthrough, pick-off phase, side bands on both axes"),
    "run_sideband": RunKind(sideband_plan, True, "side bands on both axes, with the loops-off records of the last run_feedthrough"),
    "run_feedthrough": RunKind(feedthrough_plan, False, "open drive and body excitation off resonance, kept for run_sideband"),
}


class KeptRecordings:
    """Loops-off recordings of the last ``run_feedthrough``, for the side-band runs that follow on the same device."""

    def __init__(self) -> None:
        self._campaign: Campaign | None = None

    def keep(self, campaign: Campaign) -> None:
        """Replace what is kept."""
        self._campaign = campaign

    def before(self, campaign: Campaign) -> Campaign:
        """``campaign`` with the kept recordings of the same device in front, unless it has loops-off recordings of its own."""
        kept = self._campaign
        if kept is None or kept.device_id != campaign.device_id or any(r.command.mode == "loops_off" for r in campaign):
            return campaign
        return Campaign(campaign.device_id, (*kept.recordings, *campaign.recordings), campaign.factory)


class CalibrationRun:
    """The work of one run, for :meth:`.run_manager.RunManager.request`.

    Parameters
    ----------
    instrument : Instrument
        The gyro.
    kind : RunKind
        Which run.
    plan : Plan
        Built by ``kind.plan``.
    kept : KeptRecordings
        Where loops-off recordings wait.
    confirm : callable
        Raises when the gyro is not any more the one that the run began with; asked before the result is put in force.
    adopt : callable of CalibrationRecord
        Stores the record and puts it in force, or raises and changes nothing.
    artifacts : Path, optional
        Folder in which ``<run id>/campaign.h5`` keeps the recordings; None keeps none.
    """

    def __init__(
        self,
        instrument: Instrument,
        kind: RunKind,
        plan: Plan,
        *,
        kept: KeptRecordings,
        confirm: Callable[[], None],
        adopt: Callable[[CalibrationRecord], None],
        artifacts: Path | None = None,
    ) -> None:
        self._instrument = _Watched(instrument)
        self._kind, self._plan, self._kept = kind, plan, kept
        self._confirm, self._adopt, self._artifacts = confirm, adopt, artifacts
        self._run: RunHandle | None = None
        self._progress: Progress | None = None
        self._started_s = self._fraction = 0.0

    def __call__(self, run: RunHandle) -> Outcome:
        """Carry the run out; see :class:`CalibrationRun` for what it changes and when."""
        campaign = self._record(run)
        if self._kind.estimates:
            campaign = self._kept.before(campaign)
        self._write(run, campaign)
        if not self._kind.estimates:
            run.commit()
            self._kept.keep(campaign)
            return Outcome(f"{len(campaign)} recordings kept for the next run_sideband.", _duration(campaign))
        record = self._estimate(run, campaign)
        self._confirm()
        run.commit()
        self._adopt(record)
        return Outcome(_sentence(record), record_results(record))

    def heartbeat(self, recorded_fraction: float) -> None:
        """Report the progress inside a step; ``recorded_fraction`` is what the instrument has of the present recording, 0 to 1."""
        run, now = self._run, self._progress
        if run is None or now is None or not self._instrument.recording:
            return
        step = self._plan.steps[now.step_index]
        fraction = min(now.fraction + recorded_fraction * step.duration_s / self._plan.duration_s, 1.0)
        elapsed_s = time.monotonic() - self._started_s
        self._tell(run, fraction, elapsed_s * (1.0 - fraction) / fraction if fraction > 0 else math.nan, now)

    def _tell(self, run: RunHandle, fraction: float, eta_s: float, progress: Progress) -> None:
        # two threads tell: a heartbeat that comes late must not turn the progress back
        self._fraction = fraction = max(fraction, self._fraction)
        step = f"step {progress.step_index + 1} of {progress.steps}: {progress.step_label}"
        # the last call comes when all is recorded
        run.progress(fraction, eta_s, step if progress.step_label else "recordings complete")

    def _record(self, run: RunHandle) -> Campaign:
        self._run, self._started_s = run, time.monotonic()

        def told(progress: Progress) -> None:
            self._progress = progress
            self._tell(run, progress.fraction, progress.eta_s, progress)

        try:
            return run_plan(self._instrument, self._plan, on_progress=told, cancelled=run.cancelled)
        finally:
            self._run = None
            if not self._instrument.rests_in(self._plan.final):
                run.note(
                    f"The gyro may not be back in its mission command ({self._plan.final.mode}): set its parameters, or restart its driver."
                )

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

    def _estimate(self, run: RunHandle, campaign: Campaign) -> CalibrationRecord:
        def told(fraction: float) -> None:
            if run.cancelled():
                raise ExperimentAborted("Run was cancelled during the estimate.")

        run.estimating(f"estimating from {len(campaign)} recordings")
        factory = FactoryStore(None, campaign.device_id).load()
        result = calibrate(with_factory_record(campaign, factory), on_progress=told, with_convergence=False)
        return record_from_result(result, campaign, run_id=run.run_id, mode=self._plan.final.mode)


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

    def configure(self, command: Command) -> None:
        self._touched, self._taken = True, None
        self._instrument.configure(command)
        self._taken = command

    def record(self, duration_s: float, *, settle_s: float = 0.0, label: str = "") -> Recording:
        self.recording = True
        try:
            return self._instrument.record(duration_s, settle_s=settle_s, label=label)
        finally:
            self.recording = False


def record_results(record: CalibrationRecord) -> dict[str, Quantity]:
    """What ``~/status`` says of a record: bias, scale factor, rate, noise, in the units of people and, for bias, SI."""
    results = {
        "bias": record.bias.scaled(1.0 / DEG_H, "deg/h"),
        "scale_factor": record.scale_factor,
        "rate": record.rate.scaled(1.0 / DEG_H, "deg/h"),
        "angle_random_walk": record.rate_noise_density.scaled(math.degrees(1.0) * 60.0 / math.sqrt(2.0), "deg/sqrt(h)"),
        "temperature": record.temperature_degc,
    }
    results |= {f"bias.{axis}": found.scaled(1.0 / DEG_H, "deg/h") for axis, found in record.bias_by_axis.items()}
    results |= {f"scale_factor.{axis}": found for axis, found in record.scale_factor_by_axis.items()}
    return results


def _sentence(record: CalibrationRecord) -> str:
    bias, scale = record.bias, record.scale_factor
    text = (
        f"Calibration {record.record_id}: bias {deg_h(bias.value):.2f} ± {deg_h(bias.sd):.2g} deg/h, "
        f"scale factor {scale.value:.6f} ± {scale.sd * 1e6:.2g} ppm."
    )
    return " ".join([text, *(f"Warning: {warning}." for warning in record.warnings)])


def _duration(campaign: Campaign) -> Mapping[str, Quantity]:
    return {"recorded": Quantity(sum(r.duration_s for r in campaign), 0.0, "s")}
