"""A gyro on a spring: its rate rings after each step of the table, which the log does not hold."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from table_samples import on_a_table

from gyro_calib.device import draw_unit, load_device
from gyro_calib.experiments import SimulatedInstrument, gap_ftr_plan, run_plan
from gyro_calib.gap import diagnose
from gyro_calib.gap.device_fit import first_linear, fitted_device
from gyro_calib.gap.evidence import CampaignEvidence
from gyro_calib.gap.preflight import usable
from gyro_calib.gap.ringing import Ringing, find_ringing
from gyro_calib.recording.applied_rate import is_turned
from gyro_calib.recording.recording import Campaign, Recording
from gyro_calib.simulation import GyroSimulator

ROW_S = 2e-3


Response = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def course(words: Mapping[str, Any], response: Response) -> dict[str, Any]:
    """The rate of a gyro that follows the table's steps by this response to one of unit size, sampled."""
    times, rates = np.array(words["t_s"]), np.radians(words["deg_s"])
    t = np.arange(0.0, 60.0, ROW_S)
    rate = np.interp(t, [times[0]], [rates[0]])
    for begun, step in zip(times[1:], np.diff(rates), strict=True):
        since = np.maximum(t - begun, 0.0)
        rate = rate + step * np.where(t >= begun, response(since), 0.0)
    return {"kind": "linear samples", "t_s": t.tolist(), "rad_s": rate.tolist()}


def spring(frequency_hz: float, cycles: float, share: float = 0.03) -> Response:
    """Part of each step comes by way of a spring that rings."""
    return lambda t: np.asarray(1.0 - share * np.exp(-t * frequency_hz / cycles) * np.cos(2.0 * math.pi * frequency_hz * t))


def on_a_mount(response: Response) -> Campaign:
    """The healthy ring's campaign with turned recordings of another rate than their log says."""
    device = draw_unit(load_device("ring_15k"), 5)
    plan = gap_ftr_plan(device.factory(), quality="quick", abilities=("applied_rate",))
    turned = {s.label: s for s in plan.steps if s.applied_rate}
    instrument = SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(3), fidelity="slow_flow"), 2e-5)
    moved = tuple(replace(s, applied_rate=course(s.applied_rate, response)) if s.applied_rate else s for s in plan.steps)
    campaign = run_plan(instrument, replace(plan, steps=moved))
    logged = [replace(r, extras={**r.extras, "applied_rate": turned[r.label].applied_rate}) if r.label in turned else r for r in campaign]
    return replace(campaign, recordings=tuple(logged))


def rings(campaign: Campaign) -> Ringing | None:
    """What rings in a campaign whose linear device is fitted."""
    f = campaign.factory
    evidence = CampaignEvidence.of(usable(campaign), math.pi * f["nominal_f0_hz"] / f["nominal_q"])
    wander, most = 5e-8 * evidence.omega0_rad_s, 5e-7 * evidence.omega0_rad_s
    linear, *_ = first_linear(evidence, f["angular_gain_kappa"], wander)
    fitted = fitted_device(evidence, linear, f["angular_gain_kappa"], wander, most)
    return find_ringing(fitted.evidence, fitted.linear)


def test_a_mount_that_rings_is_found_with_its_frequency_and_share() -> None:
    found = rings(on_a_mount(spring(5.0, 3.0)))
    assert found is not None
    assert found.frequency_hz == pytest.approx(5.0, rel=0.03)
    assert found.share == pytest.approx(0.03, rel=0.3)
    said = found.unknown()
    assert (said.location, said.depends_on) == ("environment", "rate")
    assert "of each step of the table that rings at" in said.form


@pytest.mark.slow
def test_a_diagnosis_says_that_it_rings() -> None:
    found = diagnose(on_a_mount(spring(5.0, 3.0)))
    assert found.verdict == "unknown"
    assert found.unknown is not None
    assert "rings at" in found.unknown.form
    assert (found.unknown.location, found.unknown.nearest) == ("environment", "base_sway")


def test_a_table_that_does_as_its_log_says_does_not_ring() -> None:
    campaign = on_a_table()
    assert sum(is_turned(r) for r in campaign) == 2
    assert rings(campaign) is None


def test_a_course_that_is_none_of_steps_says_nothing() -> None:
    """A log of an encoder's own samples, noise and all: a campaign of a twenty-eighth plant."""

    def sampled(r: Recording) -> Recording:
        words = r.extras["applied_rate"]
        seen = course(words, np.ones_like)
        noisy = np.array(seen["rad_s"]) + 1e-5 * np.random.default_rng(1).standard_normal(len(seen["rad_s"]))
        return replace(r, extras={**r.extras, "applied_rate": {**seen, "rad_s": noisy.tolist()}})

    campaign = on_a_table()
    assert rings(replace(campaign, recordings=tuple(sampled(r) if is_turned(r) else r for r in campaign))) is None


@pytest.mark.parametrize("tau_s", [0.03, 0.25])
def test_a_motor_that_creeps_to_its_speed_does_not_ring(tau_s: float) -> None:
    assert rings(on_a_mount(lambda t: 1.0 - 0.03 * np.exp(-t / tau_s))) is None
