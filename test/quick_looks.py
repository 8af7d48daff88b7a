"""A drawn unit of each kind, recorded by the quick plan and looked at as a diagnosis does."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache

import numpy as np

from gyro_calib.gap.model import CampaignModel, look_at
from gyro_calib.gap.preflight import usable
from gyro_calib.recording.applied_rate import is_turned
from gyro_calib.recording.recording import Campaign
from gyro_calib.trial.plans import campaign_plan
from gyro_calib.trial.plant import record_unit
from gyro_calib.trial.units import draw_trial_unit


def looked_at(kind: str, sizes: Mapping[str, Mapping[str, float]], without: tuple[str, ...] = ()) -> CampaignModel:
    """A unit that no table turns."""
    unit, rng = draw_trial_unit(kind, 79, 1), np.random.default_rng(1)
    return look_of(record_unit(unit, campaign_plan(kind, unit.device.factory(), rng, "quick"), sizes, rng), without)


def look_of(campaign: Campaign, without: tuple[str, ...] = ()) -> CampaignModel:
    f = campaign.factory
    recordings = [r for r in usable(campaign) if not is_turned(r)]
    return look_at(recordings, math.pi * f["nominal_f0_hz"] / f["nominal_q"], f["angular_gain_kappa"], without=without)


@cache
def healthy(kind: str) -> CampaignModel:
    return looked_at(kind, {})
