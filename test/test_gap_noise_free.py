"""What the diagnosis gets wrong by itself: a campaign without noise, weighed with the noise of one that has it, leaves next to nothing."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import gyro_calib.gap.model as gap_model
from gyro_calib.experiments import SimulatedInstrument, run_plan
from gyro_calib.gap.model import CampaignModel, look_at
from gyro_calib.gap.preflight import usable
from gyro_calib.gap.saturated import effect_columns
from gyro_calib.gap.screen import Screener
from gyro_calib.recording.recording import Campaign
from gyro_calib.simulation import GyroSimulator
from gyro_calib.trial.plans import campaign_plan
from gyro_calib.trial.plant import record_unit, with_effects
from gyro_calib.trial.units import Unit, draw_trial_unit

QUALITY = "standard"
pytestmark = pytest.mark.slow


def looked_at(campaign: Campaign) -> CampaignModel:
    f = campaign.factory
    return look_at(usable(campaign), math.pi * f["nominal_f0_hz"] / f["nominal_q"], f["angular_gain_kappa"])


def without_noise(unit: Unit, effects: dict[str, dict[str, float]]) -> Campaign:
    """The same campaign of a unit whose channels, drives, temperature and converters are without noise and steps."""
    device = replace(
        unit.device,
        environment=replace(unit.device.environment, wander_k=0.0),
        electronics=replace(unit.device.electronics, adc_bits=0, dac_bits=0),
    )
    simulator = GyroSimulator(with_effects(device, effects), rng=np.random.default_rng(0), fidelity="carrier", noisy=False)
    instrument = SimulatedInstrument(simulator, unit.rate_rad_s, sense_axis=unit.sense_axis)
    return run_plan(instrument, campaign_plan(unit.kind, unit.device.factory(), np.random.default_rng(1), QUALITY))


def left(
    monkeypatch: pytest.MonkeyPatch, kind: str, effects: dict[str, dict[str, float]] | None = None, *, known: bool = False
) -> tuple[float, int]:
    """Chi-square of the nuisances' fit, with the effects if they are ``known``, and its degrees of freedom."""
    unit = draw_trial_unit(kind, 79, 1)
    rng = np.random.default_rng(1)
    noisy = looked_at(record_unit(unit, campaign_plan(kind, unit.device.factory(), rng, QUALITY), {}, rng))
    monkeypatch.setattr(gap_model, "measured_noise", lambda *_: (noisy.noise, {}))
    quiet = looked_at(without_noise(unit, effects or {}))
    prior = {c.name: c.prior_sd for c in noisy.nuisances}
    nuisances = [replace(c, prior_sd=prior.get(c.name, c.prior_sd)) for c in quiet.nuisances]
    named = effect_columns([c for name in effects or {} for c in quiet.candidates[name][-1:]]) if known else []
    screener = Screener(quiet.whitener, [*nuisances, *named], quiet.target)
    return screener.chi2, screener.dof


@pytest.mark.parametrize(("kind", "share"), [("ring", 0.01), ("hemisphere", 0.05)])
def test_a_healthy_unit_without_noise_leaves_next_to_nothing(monkeypatch: pytest.MonkeyPatch, kind: str, share: float) -> None:
    chi2, dof = left(monkeypatch, kind)
    assert chi2 < share * dof


def test_an_effect_without_noise_leaves_what_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """So that the test above can fail."""
    chi2, dof = left(monkeypatch, "ring", {"nonlinear_damping": {"c": 1e-4}})
    assert chi2 > 0.5 * dof


def test_what_passed_for_a_feedthrough_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reference in a pick-off: the first fit takes it for part of E, and a temperature's column with that E in it does not forget."""
    effect = {"pickoff_interference": {"v_xc": 1e-6, "v_xs": -5e-6, "v_yc": 2e-6, "v_ys": -2.8e-5}}
    chi2, dof = left(monkeypatch, "hemisphere", effect, known=True)
    assert chi2 < 0.06 * dof


def test_a_resonance_that_ages_takes_nothing_off_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its force is one on the motion, and the column of E had already taken off what feeds through at the distance that it makes."""
    chi2, dof = left(monkeypatch, "hemisphere", {"frequency_ageing": {"k": -1e-4}}, known=True)
    assert chi2 < 0.06 * dof
