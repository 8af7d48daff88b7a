"""What each run service does: its plan, and what becomes of the recordings. No ROS here; the gyro is behind the instrument seam.

A run is: plan, recordings, estimate, record, and only then one step that changes anything: the record is stored and put in force, its drive
compensation with it. Whatever goes wrong before leaves the previous calibration, in force and on disk, as it was, and the gyro back in its
mission command with the compensation that it had.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..calibration import FactoryStore, compensate, record_from_result, with_factory_record, with_scale_factor_of
from ..calibration.compensation_rounds import CompensationRound, Leg
from ..calibration.record import CalibrationRecord
from ..errors import DataError, ExperimentAborted, GyroCalibError
from ..estimation import CalibrationResult, calibrate
from ..experiments import (
    Instrument,
    Plan,
    Progress,
    compensation_in_force,
    cubic_plan,
    feedthrough_plan,
    mission_mode,
    run_plan,
    scale_factor_plan,
    self_calibration_plan,
    sideband_plan,
    virtual_precession_plan,
)
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
    verify : callable, optional
        Plan of the further rounds in which a whole-angle gyro's drive compensation is verified and improved; none for a run without.
    missions : str
        Beginning of the mission modes that the run is for: ``"ftr"``, ``"whole_angle"``, ``""`` for any.
    renews_scale_factor : bool
        Only the scale factor of the record in force is renewed, where there is one for the same mode and compensation.
    """

    plan: PlanBuilder
    estimates: bool
    description: str
    verify: PlanBuilder | None = None
    missions: str = ""
    renews_scale_factor: bool = False

    def check(self, factory: Mapping[str, Any]) -> None:
        """Refuse a gyro that the run is not for, before it is touched; DataError with the remedy."""
        mode = mission_mode(factory)
        if not mode.startswith(self.missions):
            raise DataError(
                f"Mission of the gyro must be {self.missions} for this run ({self.description}), but its factory data say {mode}. "
                "Call self_calibrate: it does what the gyro's mode needs."
            )

    def plans(self, factory: Mapping[str, Any], **options: Any) -> tuple[Plan, Plan | None]:
        """Plan of the run, and of its further rounds when the gyro's drives are compensated; ``options`` as of ``plan``."""
        plan = self.plan(factory, **options)
        if self.verify is None or plan.final.mode != "whole_angle":
            return plan, None
        return plan, self.verify(factory, **options)


#: service name -> what it does; a further run is one line
RUNS: dict[str, RunKind] = {
    "self_calibrate": RunKind(self_calibration_plan, True, "all that the gyro's mission mode needs", virtual_precession_plan),
    "run_sideband": RunKind(sideband_plan, True, "side bands on both axes, with the last run_feedthrough", missions="ftr"),
    "run_cubic": RunKind(cubic_plan, True, "side bands at three amplitudes, cubic terms when the data ask for them", missions="ftr"),
    "run_virtual_precession": RunKind(
        virtual_precession_plan, True, "virtual precession, drive compensation", virtual_precession_plan, missions="whole_angle"
    ),
    "run_scale_factor": RunKind(
        scale_factor_plan, True, "ring-down, ring-up, stiffness control", missions="whole_angle", renews_scale_factor=True
    ),
    "run_feedthrough": RunKind(feedthrough_plan, False, "open drive and body excitation off resonance, kept for the runs that follow"),
}


class KeptRecordings:
    """Loops-off recordings of the last ``run_feedthrough``, for the runs that follow on the same device."""

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
        Built by ``kind.plan``; recorded with the compensation that the gyro has.
    kept : KeptRecordings
        Where loops-off recordings wait.
    confirm : callable
        Raises when the gyro is not any more the one that the run began with; asked before the result is put in force.
    adopt : callable of CalibrationRecord
        Stores the record and puts it in force, or raises and changes nothing.
    artifacts : Path, optional
        Folder in which ``<run id>/campaign.h5`` keeps the recordings; None keeps none.
    verify : Plan, optional
        Built by ``kind.verify``, for a whole-angle gyro.
    in_force : callable
        The record in force, for a run that renews a part of it.
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
        verify: Plan | None = None,
        in_force: Callable[[], CalibrationRecord | None] = lambda: None,
    ) -> None:
        self._instrument = _Watched(instrument)
        self._kind, self._plan, self._kept = kind, plan, kept
        self._confirm, self._adopt, self._artifacts = confirm, adopt, artifacts
        self._verify, self._in_force = verify, in_force
        self._leg = Leg(1, plan, 0.0, plan.duration_s)
        self._run: RunHandle | None = None
        self._progress: Progress | None = None
        self._started_s = self._fraction = 0.0
        self._rounds: dict[str, Quantity] = {}
        self._last_round = ""

    def __call__(self, run: RunHandle) -> Outcome:
        """Carry the run out; see :class:`CalibrationRun` for what it changes and when."""
        rest = replace(self._plan.final, compensation=compensation_in_force(self._instrument))
        if not self._kind.estimates:
            campaign = self._record(run, rest)
            self._write(run, campaign)
            run.commit()
            self._kept.keep(campaign)
            return Outcome(f"{len(campaign)} recordings kept for the runs that follow.", _duration(campaign))
        record, mission = self._found(run, rest) if self._verify is None else self._compensated(run, self._verify, rest)
        self._confirm()
        run.commit()
        self._put_in_force(record, mission, rest)
        return Outcome(" ".join(filter(None, [_sentence(record), self._last_round])), {**record_results(record), **self._rounds})

    def heartbeat(self, recorded_fraction: float) -> None:
        """Report the progress inside a step; ``recorded_fraction`` is what the instrument has of the present recording, 0 to 1."""
        run, now, plan = self._run, self._progress, self._leg.plan
        if run is None or now is None or not self._instrument.recording:
            return
        step = plan.steps[now.step_index]
        fraction = self._leg.fraction(now.fraction + recorded_fraction * step.duration_s / plan.duration_s)
        elapsed_s = time.monotonic() - self._started_s
        self._tell(run, fraction, elapsed_s * (1.0 - fraction) / fraction if fraction > 0 else math.nan, now)

    # -- recordings ---------------------------------------------------------------------------------------------------------------

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

    # -- from recordings to a record ------------------------------------------------------------------------------------------------

    def _found(self, run: RunHandle, rest: Command) -> tuple[CalibrationRecord, Command]:
        """One plan, one estimate."""
        campaign = self._kept.before(self._record(run, rest))
        self._write(run, campaign)
        run.estimating(f"estimating from {len(campaign)} recordings")
        record = record_from_result(self._estimate(run, campaign), campaign, run_id=run.run_id, mode=rest.mode)
        if self._kind.renews_scale_factor and (previous := self._in_force()) is not None:
            if (previous.device_id, previous.mode, previous.compensation) == (record.device_id, record.mode, record.compensation):
                return with_scale_factor_of(previous, record), rest
            run.note(f"Record {previous.record_id} is of another mode or drive compensation: all of it was replaced.")
        return record, rest

    def _compensated(self, run: RunHandle, verify: Plan, rest: Command) -> tuple[CalibrationRecord, Command]:
        """Rounds of identification and compensation, then one estimate from all of them."""

        def began(leg: Leg) -> None:
            self._progress, self._leg = None, leg

        def settled(campaign: Campaign) -> None:
            run.estimating(f"estimating from {len(campaign)} recordings of all rounds")

        def identified(done: CompensationRound) -> None:
            self._rounds |= {f"round_{done.number}.residual_{name}": q for name, q in done.residual.quantities().items()}
            self._last_round = str(done)
            run.found(self._rounds, self._last_round)

        def estimated(campaign: Campaign) -> CalibrationResult:
            return self._estimate(run, self._kept.before(campaign))

        with self._recording(run, rest):
            found = compensate(
                self._instrument,
                self._plan,
                verify,
                estimate=estimated,
                on_leg=began,
                on_progress=self._told,
                on_round=identified,
                on_settled=settled,
                cancelled=run.cancelled,
            )
        campaign = self._kept.before(found.campaign)
        self._write(run, campaign)
        provenance = {"compensation_rounds": [done.to_plain() for done in found.rounds]}
        record = record_from_result(found.result, campaign, run_id=run.run_id, mode=rest.mode, provenance=provenance)
        return record, replace(found.mission, compensation=record.compensation)

    def _estimate(self, run: RunHandle, campaign: Campaign) -> CalibrationResult:
        def told(fraction: float) -> None:
            if run.cancelled():
                raise ExperimentAborted("Run was cancelled during the estimate.")

        told(0.0)
        factory = FactoryStore(None, campaign.device_id).load()
        return calibrate(with_factory_record(campaign, factory), on_progress=told, with_convergence=False)

    def _put_in_force(self, record: CalibrationRecord, mission: Command, rest: Command) -> None:
        """The compensation in the gyro and the record in force, or neither."""
        if mission == rest:
            self._adopt(record)
            return
        try:
            self._instrument.configure(mission)
            self._adopt(record)
        except BaseException:
            with contextlib.suppress(GyroCalibError):
                self._instrument.configure(rest)
            raise


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
    def command(self) -> Command:
        return Command(compensation=compensation_in_force(self._instrument))

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
    results |= {name: found for name, found in record.parameters.items() if name.startswith("residual_")}
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
