"""A ring's campaign with a rate table, and a look at it."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np

from gyro_calib.device import draw_unit, load_device
from gyro_calib.experiments import SimulatedInstrument, gap_ftr_plan, run_plan
from gyro_calib.gap.model import CampaignModel, look_at
from gyro_calib.gap.preflight import usable
from gyro_calib.gap.screen import Screened
from gyro_calib.recording.recording import Campaign
from gyro_calib.simulation import GyroSimulator

__all__ = ["looked_at", "loudest", "on_a_table", "table_model"]


@cache
def on_a_table(effect: str = "", **sizes: float) -> Campaign:
    """A campaign with rate steps, of a healthy ring or of one with an effect."""
    device = draw_unit(load_device("ring_15k"), 5)
    device = replace(device, effects={effect: dict(sizes)} if effect else {})
    instrument = SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(3), fidelity="carrier"), 2e-5)
    return run_plan(instrument, gap_ftr_plan(device.factory(), quality="quick", abilities=("applied_rate",)))


def looked_at(campaign: Campaign) -> CampaignModel:
    """Its model."""
    f = campaign.factory
    return look_at(usable(campaign), math.pi * f["nominal_f0_hz"] / f["nominal_q"], f["angular_gain_kappa"])


@cache
def table_model() -> CampaignModel:
    """Of the healthy ring's; looked at once in a file."""
    return looked_at(on_a_table())


def loudest(model: CampaignModel, name: str) -> Screened:
    """An effect at its best setting."""
    found = model.screener.screened(model.candidates[name])
    return max(found, key=lambda s: s.log_evidence)
