"""The diagnoser on campaigns of the carrier simulation (it fits a slow flow), and its parts against closed forms."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gyro_calib.device import Device, draw_unit, load_device
from gyro_calib.effects import EFFECTS
from gyro_calib.experiments import SimulatedInstrument, gap_ftr_plan, run_plan
from gyro_calib.gap import Diagnosis, diagnose
from gyro_calib.gap.drifts import parameter_of
from gyro_calib.gap.evidence import CampaignEvidence
from gyro_calib.gap.forms import FORMS
from gyro_calib.gap.noise_law import Lines, fit_law
from gyro_calib.gap.parts import SKEW, Linear
from gyro_calib.recording.recording import Campaign
from gyro_calib.simulation import GyroSimulator


def unit(seed: int = 5) -> Device:
    return draw_unit(load_device("ring_15k"), seed)


@cache
def campaign(effect: str = "", seed: int = 3, **sizes: float) -> Campaign:
    device = unit() if not effect else replace(unit(), effects={effect: dict(sizes)})
    instrument = SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(seed), fidelity="carrier"), 2e-5)
    return run_plan(instrument, gap_ftr_plan(device.factory(), quality="quick"))


@cache
def damped() -> Diagnosis:
    return diagnose(campaign("nonlinear_damping", c=3e-4))


def test_every_form_is_an_effect_of_the_registry_with_its_parameters() -> None:
    evidence = CampaignEvidence.of(list(campaign())[:3], 1.5)
    linear = Linear(-1.5 * np.eye(2) + 0j, -8j * np.eye(2), np.zeros((2, 2), dtype=complex), 0.8, -2.5)
    signals = evidence.recordings[0].signals
    for name, form in FORMS.items():
        assert name in EFFECTS
        for setting in form.settings([r.signals for r in evidence]):
            effect = EFFECTS[form.per_axis if form.per_axis and setting.get("axes") else name]
            known = {p.name for p in effect.parameters} | {"share"}
            parts = form.parts(signals, linear, setting)
            assert {parameter_of(p.parameter) for p in parts if not p.parameter.startswith(SKEW)} <= known, name
            assert all(p.signal.shape == signals.pick.shape and np.isfinite(p.signal).all() for p in parts), name


def test_thinned_projection_is_the_exact_one() -> None:
    """The forms' projector and the full-rate products see the same slow flow."""
    evidence = CampaignEvidence.of(list(campaign()), 1.5)
    for r in evidence.recordings[:6]:
        s, exact = r.signals, r.signal
        picked = r.signal_forms.plain([s.pick])[:, 0]
        np.testing.assert_allclose(picked, np.einsum("jaa->j", exact.pick), atol=1e-6 * np.abs(exact.pick).max())
        through = r.signal_forms.through_flow([s.pick])[:, 0]
        np.testing.assert_allclose(through, exact.lhs, atol=2e-5 * np.abs(exact.pick).max() * evidence.decay_rate)


@pytest.mark.parametrize("truth", [(2e-9, 0.0, 0.0), (1e-10, 0.0, 3e-9), (1e-10, 4e-9, 0.0)])
def test_noise_law_finds_its_terms_and_is_not_pulled_by_a_stranger(truth: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(1)
    f = np.geomspace(0.03, 8.0, 600)
    lines = Lines(f, f**2 + 0.01, 1.0, np.zeros(f.size, dtype=bool))
    white, flicker, pickoff = truth
    density = lines.basis() @ np.array([white, flicker, pickoff, 0.0])
    squares = density * rng.standard_normal(f.size) ** 2
    squares[100:112] *= 400.0
    found = fit_law(lines.basis(), squares).density(lines)
    assert np.all(np.abs(np.log(found / density)) < np.log(1.8))


def test_a_healthy_unit_has_no_effect() -> None:
    found = diagnose(campaign())
    assert found.verdict == "none"
    assert 0.8 < found.gap.rms_before < 1.2
    assert not found.effects
    assert found.unknown is None


def test_an_effect_is_named_with_its_size_and_closes_the_gap_on_unseen_experiments() -> None:
    found = damped()
    assert found.verdict == "effects"
    (effect,) = found.effects
    assert effect.name == "nonlinear_damping"
    assert effect.location == "dynamics"
    # c_y is in the volts of the y pick-off, c in those of x: the mismatch of the pick-offs, squared
    for size in effect.parameters.values():
        assert abs(size.value - 3e-4) < 4.0 * size.sd + 0.05 * 3e-4
    assert found.gap.closed_fraction.value > 0.9
    assert found.gap.rms_after < 1.2


def test_without_it_in_the_registry_it_is_something_unknown_of_the_right_place() -> None:
    found = diagnose(campaign("nonlinear_damping", c=3e-4), without=("nonlinear_damping", "quadratic_damping", "pickoff_nonlinearity"))
    assert found.verdict == "unknown"
    assert found.unknown is not None
    assert found.unknown.location == "dynamics"
    assert found.unknown.depends_on == "amplitude"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "sizes"), [("drive_nonlinearity", {"d_x": 0.02, "d_y": 0.02}), ("pickoff_nonlinearity", {"c_x": 0.003, "c_y": 0.003})]
)
def test_a_strong_effect_has_its_true_size(effect: str, sizes: dict[str, float]) -> None:
    """Of first order about the fit without it, 0.020 came out as 0.0185."""
    found = diagnose(campaign(effect, **sizes))
    assert [e.name for e in found.effects] == [effect]
    for name, value in found.effects[0].parameters.items():
        assert value.value == pytest.approx(sizes[name], rel=2e-3)


@pytest.mark.slow
def test_a_cube_of_each_axis_as_large_on_both_is_told_by_pickoffs_that_are_not_square() -> None:
    """Of both together it is 2.4 % short, and what is left has the name of a cubic cross stiffness (a sixth plant, 126 in chi-square)."""
    skewed = replace(unit().pickoff, non_orthogonality_rad=0.02, gain_mismatch=0.0)
    device = replace(unit(), pickoff=skewed, effects={"duffing_axes": {"k_x": -0.004, "k_y": -0.004}})
    instrument = SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(3), fidelity="carrier"), 2e-5)
    (found,) = diagnose(run_plan(instrument, gap_ftr_plan(device.factory(), quality="quick"))).effects
    assert found.name == "duffing"
    for name in ("k_x", "k_y"):
        assert abs(found.parameters[name].value + 0.004) < 3.0 * found.parameters[name].sd


def test_json_has_the_keys_of_the_contract() -> None:
    words = json.loads(json.dumps(damped().to_json()))
    assert {"verdict", "effects", "unknown", "map", "gap", "not_testable", "next_experiment"} <= set(words)
    assert {"name", "group", "probability", "parameters", "location"} <= set(words["effects"][0])
    assert {"before", "after", "closed_fraction", "bias", "scale_factor"} <= set(words["gap"])
    assert set(words["map"][0]) >= {"experiment", "channel", "quadrature", "feature", "share", "z"}
    assert sum(cell["share"] for cell in words["map"]) <= 1.0 + 1e-9


def test_shares_of_the_map_are_of_the_whole_gap() -> None:
    assert sum(cell.share for cell in damped().map) == pytest.approx(1.0)
    assert damped().map[0].channel == "amplitude"


def test_progress_never_goes_back() -> None:
    seen: list[float] = []
    report: Callable[[float, str], None] = lambda fraction, text: seen.append(fraction)  # noqa: E731
    diagnose(Campaign(campaign().device_id, campaign().recordings[:10], campaign().factory), on_progress=report)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
