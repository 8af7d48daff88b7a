"""The run that diagnoses the gap: the campaign is recorded, diagnosed, kept as JSON and page; the calibration in force stays."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..calibration import FactoryStore, with_factory_record
from ..calibration.compensation_rounds import Leg
from ..calibration.files import locked_directory, make_directory, replace_text
from ..errors import ExperimentAborted, GyroCalibError
from ..experiments import Instrument, Plan, compensation_in_force
from ..quantity import Quantity
from ..recording.recording import Campaign
from .recording_run import RecordingRun
from .run_manager import Outcome, RunHandle

if TYPE_CHECKING:
    from ..gap import Diagnosis
    from ..gap.fleet_file import Fleet

__all__ = ["GapRun", "fleet_of_kind"]

#: wait for another writer beside the records [s]
_LOCK_TIMEOUT_S = 10.0
#: how long a diagnosis takes beside the recordings, about; shares the run's progress out [s]
_DIAGNOSIS_S = 60.0


class GapRun(RecordingRun):
    """The work of ``diagnose_gap``.

    Parameters
    ----------
    instrument : Instrument
        The gyro.
    plan : Plan
        Of :mod:`gyro_calib.experiments.gap_plans`.
    beside : Path
        The file of the gyro's records; ``<stem>.gap.json`` and ``<stem>.gap.html`` are written beside it, the last diagnosis only.
    artifacts : Path, optional
        As of :class:`.recording_run.RecordingRun`.
    fleet : Fleet, optional
        What healthy units of this kind have.
    """

    def __init__(
        self, instrument: Instrument, plan: Plan, *, beside: Path, artifacts: Path | None = None, fleet: Fleet | None = None
    ) -> None:
        super().__init__(instrument, plan, artifacts)
        self._fleet = fleet
        self._leg = Leg(1, plan, 0.0, plan.duration_s + _DIAGNOSIS_S)
        self._beside = beside

    def __call__(self, run: RunHandle) -> Outcome:
        """Record, diagnose, keep; nothing that the gyro or its corrector use is changed."""
        rest = replace(self._plan.final, compensation=compensation_in_force(self._instrument))
        campaign = self._record(run, rest)
        self._write(run, campaign)
        diagnosis = _diagnosed(run, campaign, self._fleet, self._leg.fraction(1.0))
        run.commit()
        for sentence in self._plan.left_out:
            run.note(sentence)
        facts = {**_facts(diagnosis), **self._kept(run, diagnosis)}
        return Outcome(f"{diagnosis.verdict}: {diagnosis.summary}", _results(diagnosis), facts, diagnosis.verdict != "none")

    def _kept(self, run: RunHandle, diagnosis: Diagnosis) -> dict[str, str]:
        """Paths of what was written; a disk or a missing plotting library that refuses does not take the verdict away."""
        written: dict[str, str] = {}
        path = self._beside.with_suffix(".gap.json")
        try:
            make_directory(path.parent)
            with locked_directory(path.parent, _LOCK_TIMEOUT_S):
                replace_text(path, json.dumps(diagnosis.to_json(), indent=2, allow_nan=False, ensure_ascii=False) + "\n")
            written["gap.json"] = str(path)
            from ..report.gap_page import write_gap_page

            page = self._beside.with_suffix(".gap.html")
            write_gap_page(page, diagnosis)
            written["gap.html"] = str(page)
        except (OSError, ImportError, ValueError, GyroCalibError) as error:
            run.note(f"The diagnosis could not be written in full: {error}.")
        return written


def fleet_of_kind(path: str, factory: Mapping[str, Any]) -> Fleet | None:
    """The fleet of a file, which must be of the gyro's kind; None without a file.

    Raises
    ------
    DataError
        The file is none, or of another kind of gyro.
    """
    if not path:
        return None
    from ..gap.fleet_file import read_fleet  # with the registry behind it, which takes a moment to load

    fleet = read_fleet(Path(path).expanduser())
    fleet.check_kind(factory)
    return fleet


def _diagnosed(run: RunHandle, campaign: Campaign, fleet: Fleet | None, recorded: float) -> Diagnosis:
    """The diagnosis, which takes the run from the part ``recorded`` to its end."""
    from ..gap import diagnose  # takes a moment to load, and no other run needs it
    from ..gap.provenance import with_provenance

    started_s = time.monotonic()

    def told(fraction: float, what: str) -> None:
        if run.cancelled():
            raise ExperimentAborted("Run was cancelled during the diagnosis.")
        eta_s = (time.monotonic() - started_s) * (1.0 - fraction) / fraction if fraction > 0.0 else _DIAGNOSIS_S
        message = f"diagnosing {len(campaign)} recordings, {fraction:.0%}: {what}"
        run.estimating(message, fraction=recorded + (1.0 - recorded) * fraction, eta_s=eta_s)

    told(0.0, "reading")
    factory = FactoryStore(None, campaign.device_id).load()
    healthy = fleet.healthy if fleet else None
    return with_provenance(diagnose(with_factory_record(campaign, factory), healthy=healthy, on_progress=told), fleet=fleet)


def _facts(diagnosis: Diagnosis) -> dict[str, str]:
    """Verdict and names, one key each."""
    facts = {"verdict": diagnosis.verdict}
    for number, effect in enumerate(diagnosis.effects, 1):
        facts[f"effect_{number}"] = effect.name
        facts[f"effect_{number}.group"] = ", ".join(effect.group)
        facts[f"effect_{number}.probability"] = f"{effect.probability:.3f}"
    if diagnosis.unknown is not None:
        facts |= {f"unknown.{key}": str(getattr(diagnosis.unknown, key) or "none") for key in ("location", "form", "nearest")}
    if "fleet" in diagnosis.provenance:
        facts["fleet"] = diagnosis.provenance["fleet"]["name"]
    facts["not_testable"] = ", ".join(diagnosis.not_testable)
    facts["next_experiment"] = diagnosis.next_experiment.description
    if diagnosis.warnings:
        facts["warnings"] = "; ".join(diagnosis.warnings)
    return facts


def _results(diagnosis: Diagnosis) -> dict[str, Quantity]:
    """Numbers with their units: sizes of the effects, and how far the gap shrinks on unseen experiments."""
    found = {f"{effect.name}.{name}": size for effect in diagnosis.effects for name, size in effect.parameters.items()}
    gap = diagnosis.gap
    found |= {
        "gap.rms_over_noise.before": Quantity(gap.rms_before, 0.0, "1"),
        "gap.rms_over_noise.after": Quantity(gap.rms_after, 0.0, "1"),
        "gap.closed_fraction": gap.closed_fraction,
    }
    if "bias" not in gap.untold():
        found |= {"gap.bias.before": gap.bias_before, "gap.bias.after": gap.bias_after}
    if "scale" not in gap.untold():
        found |= {"gap.scale_factor.before": gap.scale_before, "gap.scale_factor.after": gap.scale_after}
    return {name: quantity for name, quantity in found.items() if math.isfinite(quantity.value)}
