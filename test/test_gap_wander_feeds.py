"""A slope of the resonance of each record's own, for what feeds through."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from table_samples import looked_at
from test_gap_wander import SIZE_RAD_S, campaign, fit, known, wandering

from gyro_calib.device import draw_unit, load_device
from gyro_calib.experiments import SimulatedInstrument, gap_whole_angle_plan, run_plan
from gyro_calib.gap import device_fit
from gyro_calib.gap.column import Column
from gyro_calib.gap.evidence import CampaignEvidence
from gyro_calib.gap.linear_device import linear_columns
from gyro_calib.gap.parts import Linear
from gyro_calib.gap.preflight import usable
from gyro_calib.gap.wander import tells_its_wander, wander_within
from gyro_calib.gap.wander_feeds import _measured, wander_feeds
from gyro_calib.recording.recording import Campaign
from gyro_calib.simulation import GyroSimulator

WARMING = ("thermal_up", "thermal_down")


@cache
def followed() -> tuple[Linear, list[Column]]:
    evidence, linear = known()
    followed = device_fit.followed_of(evidence, *fit(evidence, linear)).with_wander(wander_within(evidence, linear))
    linear = replace(linear, followed=followed)
    return linear, wander_feeds(evidence, linear)


def test_every_record_that_tells_its_wander_has_a_slope_of_its_own() -> None:
    (evidence, _), (_, columns) = known(), followed()
    indices = [r.index for r in evidence if tells_its_wander(r)]
    assert {c.name for c in columns} == {f"wander_feeds_{i}_{part}" for i in indices for part in ("re", "im")}
    assert len(indices) > len(campaign()[1])
    for c in columns:
        assert [i for i, v in enumerate(c.signal) if np.any(v)] == [int(c.name.split("_")[2])]


def test_a_slope_is_what_the_columns_of_e_have_of_a_resonance_that_slides_further() -> None:
    (evidence, _), (linear, columns) = known(), followed()
    assert linear.followed is not None
    slides = tuple(np.linspace(-1.0, 1.0, len(r.signals.time_s)) for r in evidence)
    further = replace(linear, followed=linear.followed.with_wander(slides))
    before, after = ({c.name: c for c in linear_columns(evidence, d) if c.name.startswith("E_")} for d in (linear, further))
    entries = {f"E_{a}{b}_re": linear.E[i, j] for i, a in enumerate("xy") for j, b in enumerate("xy")}
    by_name = {c.name: c for c in columns}
    for r in evidence:
        if r.recording.label in campaign()[1]:
            moved = sum(e * (after[name].signal[r.index] - before[name].signal[r.index]) for name, e in entries.items())
            found = by_name[f"wander_feeds_{r.index}_re"].signal[r.index]
            assert np.linalg.norm(found - moved) < 1e-9 * np.linalg.norm(moved)
            assert np.linalg.norm(moved) > 0.0


def test_without_a_resonance_that_is_followed_there_is_none() -> None:
    evidence, linear = known()
    assert wander_feeds(evidence, replace(linear, followed=None)) == []


@cache
def warmed() -> Campaign:
    """A hemisphere whose wave precesses by 3.5 V and whose resonance wanders while it warms."""
    device, rng = draw_unit(load_device("hrg_hardware"), 5), np.random.default_rng(3)
    plan = gap_whole_angle_plan(device.factory(), quality="quick", abilities=("temperature",))
    volts = max(s.command.setpoints.virtual_precession_v for s in plan.steps)
    steps = []
    for step in plan.steps:
        of_step = replace(step.command.setpoints, virtual_precession_v=volts)
        steps.append(replace(step, command=replace(step.command, setpoints=of_step)) if step.label in WARMING else step)
    instrument = SimulatedInstrument(GyroSimulator(device, rng=rng, fidelity="slow_flow"), 2e-5)
    recorded = run_plan(instrument, replace(plan, steps=tuple(steps)))
    return replace(recorded, recordings=tuple(wandering(r, 0.3) if r.label in WARMING else r for r in recorded))


def test_what_moved_a_resonance_while_it_warmed_feeds_through_as_the_columns_of_e_have_it() -> None:
    recorded = warmed()
    f = recorded.factory
    evidence = CampaignEvidence.of(usable(recorded), math.pi * f["nominal_f0_hz"] / f["nominal_q"])
    rough, *_ = device_fit.first_linear(evidence, f["angular_gain_kappa"], 5e-8 * evidence.omega0_rad_s)
    linear = replace(rough, followed=device_fit.followed_of(evidence, *fit(evidence, rough)))
    assert linear.followed is not None
    columns = {c.name: c for c in wander_feeds(evidence, linear)}
    warm = [r for r in evidence if r.recording.label in WARMING]
    courses = tuple(_measured(r, linear) if r in warm else np.zeros(len(r.signals.time_s)) for r in evidence)
    further = replace(linear, followed=linear.followed.with_wander(courses))
    before, after = ({c.name: c for c in linear_columns(evidence, d) if c.name.startswith("E_")} for d in (linear, further))
    entries = {f"E_{a}{b}_re": linear.E[i, j] for i, a in enumerate("xy") for j, b in enumerate("xy")}
    for r in warm:
        assert np.ptp(courses[r.index]) > 0.3 * SIZE_RAD_S
        moved = sum(e * (after[name].signal[r.index] - before[name].signal[r.index]) for name, e in entries.items())
        found = columns[f"wander_feeds_{r.index}"].signal[r.index]
        assert np.linalg.norm(found - moved) < 1e-9 * np.linalg.norm(moved)


@pytest.mark.slow
def test_all_of_it_is_a_wander_on_a_healthy_device() -> None:
    model = looked_at(warmed())
    sds = dict(zip((c.name for c in model.base.columns), np.sqrt(np.diag(model.base.covariance)), strict=True))
    values = model.base.by_name()
    for r in model.evidence:
        if r.recording.label in WARMING:
            name = f"wander_feeds_{r.index}"
            assert sds[name] < 0.5
            assert abs(values[name] - 1.0) < 3.0 * sds[name]
