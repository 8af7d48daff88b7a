"""One trial: draw and size the effect, record at carrier level, seal the label, diagnose."""

from __future__ import annotations

import math
import secrets
import traceback
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from ..errors import GyroCalibError
from ..gap import diagnose
from ..gap.model import CampaignModel, look_at
from ..gap.preflight import usable
from ..recording.recording import Campaign
from .baselines import run_baselines
from .labels import Label, Seal, Trial, reported_name
from .plans import campaign_plan, poor_plan
from .plant import record_unit, with_effects
from .sizing import Sized, imitators, size_effect
from .units import Unit, draw_trial_unit
from .verdicts import Verdict

__all__ = ["LIKE", "TRIALS_PER_UNIT", "Outcome", "Prepared", "prepare", "run_trial"]

#: trials that one unit serves: the clean campaign that sizes are found on is recorded once for them
TRIALS_PER_UNIT = 6
#: a ratio that is left behind an imitator and below this tells nobody apart (gap.md)
LIKE = 5.0
#: not of multiplexed electronics: what grows with the volts of a drive (higher in their slot than recorded, and no form says by how
#: much), and what feeds through while nothing is read
_NOT_MULTIPLEXED = (
    "thermal_feedthrough",
    "feedthrough_drift",
    "cross_feedthrough_drift",
    "drive_nonlinearity",
    "drive_amplitude_phase",
    "drive_cross_nonlinearity",
    "drive_sag",
    "drive_stiffness",
    "drive_stiffness_mean",
    "drive_saturation",
    "drive_dead_zone",
)
#: effects whose nuisance has another name
_HEALTHY = {"thermal_frequency_curvature", "angular_gain_error"}
#: what drifts in the stratum `drift`, standard deviations: frequency [rad/s^2], damping [1/s^2], temperature [K/s]
_AGEING, _LEAK, _RAMP_K_PER_S = 2e-6, 1e-8, 3e-4


@dataclass(frozen=True)
class Prepared:
    """A campaign with its sealed label.

    Parameters
    ----------
    label : Label
    nonce : str
    seal : Seal
    campaign : Campaign
    """

    label: Label
    nonce: str
    seal: Seal
    campaign: Campaign = field(repr=False)


@dataclass(frozen=True)
class Outcome:
    """A trial that is over.

    Parameters
    ----------
    label : Label
    nonce : str
    seal : Seal
    verdict : Verdict
    baselines : mapping
        Name that each said, None for no effect; empty where they were not asked.
    """

    label: Label
    nonce: str
    seal: Seal
    verdict: Verdict
    baselines: dict[str, str | None] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Plain types."""
        return {
            "seal_sha256": self.seal.sha256,
            "nonce": self.nonce,
            "label": self.label.to_json(),
            "verdict": self.verdict.to_json(),
            "baselines": dict(self.baselines),
        }


def prepare(trial: Trial, seed: int, quality: str = "standard") -> Prepared:
    """Draw the truth of a trial, record its campaign, seal the label.

    Parameters
    ----------
    trial : Trial
    seed : int
        Of the run; with the trial's number it gives the same campaign again.
    quality : {"quick", "standard", "fine"}
        Duration of the campaign.
    """
    unit = _unit(trial, seed)
    rng = np.random.default_rng([0x5EED, seed, trial.number])
    reference = _reference(trial.kind, seed, _unit_number(trial), quality) if trial.snr else None
    sized = _sized(trial, reference, rng, multiplexed=unit.device.multiplexing.enabled) if reference is not None else []
    like = {reported_name(s.name): imitators(reference, s) for s in sized} if reference is not None else {}
    without: tuple[str, ...] = ()
    if trial.stratum == "removed":
        name = reported_name(sized[0].name)
        without = (name, *(other for other, left in like[name].items() if left < LIKE))
    ramp, drifts = 0.0, {}
    shown = {s.name: dict(s.sizes) for s in sized}
    device = unit.device
    if trial.stratum == "drift":
        ramp = float(_RAMP_K_PER_S * rng.standard_normal())
        drifts = {
            "frequency_ageing": {"k": float(_AGEING * rng.standard_normal())},
            "damping_drift": {"c": float(_LEAK * rng.standard_normal())},
        }
        device = with_effects(device, drifts)
    plan = campaign_plan(trial.kind, unit.device.factory(), rng, quality)
    if trial.poor:
        plan = poor_plan(plan, trial.poor, unit.mode, unit.device.factory_data.nominal_amplitude_v)
    label = Label(
        number=trial.number,
        stratum=trial.stratum,
        kind=trial.kind,
        effects=shown,
        snr=tuple(round(s.snr, 6) for s in sized),
        without=without,
        like={name: {k: round(v, 3) for k, v in list(others.items())[:6]} for name, others in like.items()},
        poor=trial.poor,
        ramp_k_per_s=ramp,
        drifts=tuple(drifts),
    )
    nonce = secrets.token_hex(16)
    seal = Seal.of(label, nonce)
    campaign = record_unit(unit.with_device(device), plan, shown, rng, ramp_k_per_s=ramp)
    return Prepared(label, nonce, seal, campaign)


def run_trial(prepared: Prepared, *, baselines: bool = True) -> Outcome:
    """Diagnose a prepared campaign; an error of the diagnosis is its verdict."""
    campaign, label = prepared.campaign, prepared.label
    try:
        verdict = Verdict.of(diagnose(campaign, without=label.without))
    except GyroCalibError as error:
        verdict = Verdict("failed", error=str(error))
    except Exception:
        verdict = Verdict("failed", error=traceback.format_exc(limit=-3))
    said = {}
    if baselines and label.stratum in ("clean", "one", "drift") and verdict.verdict != "failed":
        said = run_baselines(_look(campaign))
    return Outcome(label, prepared.nonce, prepared.seal, verdict, said)


def _unit_number(trial: Trial) -> int:
    return (trial.number // 2) // TRIALS_PER_UNIT


def _unit(trial: Trial, seed: int) -> Unit:
    return draw_trial_unit(trial.kind, seed, _unit_number(trial))


@lru_cache(maxsize=2)
def _reference(kind: str, seed: int, number: int, quality: str) -> CampaignModel:
    """A clean campaign of a unit, which no trial diagnoses: what a size is worth is read from it."""
    unit = draw_trial_unit(kind, seed, number)
    rng = np.random.default_rng([0xC1EA, seed, number, int(kind == "ring")])
    return _look(record_unit(unit, campaign_plan(kind, unit.device.factory(), rng, quality), {}, rng))


def _look(campaign: Campaign) -> CampaignModel:
    f = campaign.factory
    return look_at(usable(campaign), math.pi * f["nominal_f0_hz"] / f["nominal_q"], f["angular_gain_kappa"])


def _sized(trial: Trial, reference: CampaignModel, rng: np.random.Generator, *, multiplexed: bool) -> list[Sized]:
    """The first effects of the trial's order that a fair size gives their ratio, and that not everything imitates."""
    found: list[Sized] = []
    # what a healthy device has as well stays in the model: without its name it is none the less known
    healthy = {c.name.split(".")[0] for c in reference.nuisances} | _HEALTHY if trial.stratum == "removed" else set()
    for name in trial.order:
        if reported_name(name) in healthy:
            continue
        if len(found) == len(trial.snr):
            break
        if any(reported_name(name) == reported_name(s.name) for s in found) or (multiplexed and name in _NOT_MULTIPLEXED):
            continue
        sized = size_effect(reference, name, trial.snr[len(found)], rng)
        if sized is not None and (not found or _apart(reference, found[0], sized)):
            found.append(sized)
    return found


def _apart(reference: CampaignModel, first: Sized, second: Sized) -> bool:
    """Whether two effects can be told from each other at all: a pair that cannot is no pair."""
    return imitators(reference, second, (reported_name(first.name),)).get(reported_name(first.name), math.inf) >= LIKE
