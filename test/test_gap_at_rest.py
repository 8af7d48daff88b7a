"""What only turned recordings show must have to do with rate: a table does things besides its log."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np

from gyro_calib.device import draw_unit, load_device
from gyro_calib.effects import EFFECTS
from gyro_calib.experiments import SimulatedInstrument, gap_ftr_plan, run_plan
from gyro_calib.gap.model import CampaignModel, look_at
from gyro_calib.gap.preflight import usable
from gyro_calib.gap.screen import Screened
from gyro_calib.gap.select import seen_at_rest, select_effects
from gyro_calib.recording.columns import COLUMNS
from gyro_calib.recording.recording import Campaign, Recording
from gyro_calib.simulation import GyroSimulator

DRIVES = [COLUMNS.index(f"x_drive_{part}") for part in "cs"]


@cache
def on_a_table(**damping: float) -> Campaign:
    """A campaign with rate steps, of a healthy ring or of one whose damping grows with amplitude."""
    device = draw_unit(load_device("ring_15k"), 5)
    device = replace(device, effects={"nonlinear_damping": dict(damping)} if damping else {})
    instrument = SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(3), fidelity="carrier"), 2e-5)
    return run_plan(instrument, gap_ftr_plan(device.factory(), quality="quick", abilities=("applied_rate",)))


def turned(recording: Recording) -> bool:
    return "applied_rate" in recording.extras


def drive_logged_too_large(recording: Recording) -> Recording:
    """3 % too large on x."""
    rows = recording.data.copy()
    rows[:, DRIVES] *= 1.03
    return replace(recording, data=rows)


def looked_at(campaign: Campaign) -> CampaignModel:
    f = campaign.factory
    return look_at(usable(campaign), math.pi * f["nominal_f0_hz"] / f["nominal_q"], f["angular_gain_kappa"])


def loudest(model: CampaignModel, name: str) -> Screened:
    found = [s for c in model.candidates[name] if (s := model.screener.screen(c)) is not None]
    return max(found, key=lambda s: s.log_evidence)


def test_an_effect_of_all_recordings_counts_without_the_turned_ones() -> None:
    model = looked_at(on_a_table(c=3e-4))
    whole = loudest(model, "nonlinear_damping")
    still = model.at_rest(whole, ())
    assert still is not None
    assert 0.5 * whole.gain < still.gain < whole.gain
    assert seen_at_rest(model, [whole], whole)


def test_what_only_the_table_shows_is_no_effect_of_a_device_at_rest() -> None:
    healthy = on_a_table()
    assert any(turned(r) for r in healthy)
    model = looked_at(replace(healthy, recordings=tuple(drive_logged_too_large(r) if turned(r) else r for r in healthy)))
    shown = loudest(model, "angular_gain_error")
    assert shown.log_evidence > 20.0
    assert seen_at_rest(model, [shown], shown)
    # the same signal under the name of an effect that would be there at rest too
    at_rest = replace(shown, candidate=replace(shown.candidate, name="nonlinear_damping"))
    assert not seen_at_rest(model, [at_rest], at_rest)
    assert all("rate" in EFFECTS[e.name].needs for e in select_effects(model).effects)
