"""What each run service does: its plan, and what becomes of the recordings. No ROS here; the gyro is behind the instrument seam.

A run is: plan, recordings, estimate, record, and only then one step that changes anything: the record is stored and put in force, its drive
compensation with it. Whatever goes wrong before leaves the previous calibration, in force and on disk, as it was, and the gyro back in its
mission command with the compensation that it had.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
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
    compensation_in_force,
    cubic_plan,
    feedthrough_plan,
    gap_plan,
    mission_mode,
    scale_factor_plan,
    self_calibration_plan,
    sideband_plan,
    virtual_precession_plan,
)
from ..quantity import Quantity
from ..recording.command import Command
from ..recording.recording import Campaign
from ..units import DEG_H, deg_h
from .recording_run import RecordingRun
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
    diagnoses : bool
        The recordings are for a diagnosis of the gap (:mod:`.gap_run`); the calibration in force is not touched.
    """

    plan: PlanBuilder
    estimates: bool
    description: str
    verify: PlanBuilder | None = None
    missions: str = ""
    renews_scale_factor: bool = False
    diagnoses: bool = False

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
    "diagnose_gap": RunKind(gap_plan, False, "where and by which effect the gyro differs from its model", diagnoses=True),
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


class CalibrationRun(RecordingRun):
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
        super().__init__(instrument, plan, artifacts)
        self._kind, self._kept = kind, kept
        self._confirm, self._adopt = confirm, adopt
        self._verify, self._in_force = verify, in_force
        self._rounds: dict[str, Quantity] = {}

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
