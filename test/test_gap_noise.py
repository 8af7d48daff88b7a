"""Noise that the diagnosis believes: of a ring-down as of any other record, and never explained by a filter that says nothing."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from unittest import mock

import numpy as np
import pytest
from numpy.typing import NDArray
from quick_looks import healthy, look_of, looked_at

from gyro_calib.gap import diagnose
from gyro_calib.gap.column import Column
from gyro_calib.gap.columns import form_columns
from gyro_calib.gap.evidence import MEAN_LINE, STEADY, WARMING
from gyro_calib.gap.forms import FORMS
from gyro_calib.gap.linear_device import quiet_target_of, target_of
from gyro_calib.gap.model import CampaignModel, _wander_of_means, look_at
from gyro_calib.gap.noise import _from_residuals, _parts, _solved, _squares, _tamed, _wandering_all_the_same, measured_noise, plain_noise
from gyro_calib.gap.noise_law import PICKOFF, WHITE, NoiseLaw
from gyro_calib.gap.parts import SKEW
from gyro_calib.gap.preflight import usable
from gyro_calib.gap.saturated import saturated_columns
from gyro_calib.gap.screen import Screened
from gyro_calib.gap.select import _alike, _best_refined, _between_settings, _with_unlike_pickoffs, best_of_each, select_effects
from gyro_calib.gap.strangers import MARGIN, bank_terms, worth_of
from gyro_calib.gap.system import Stack
from gyro_calib.gap.thermometer import OWN
from gyro_calib.recording.recording import Recording
from gyro_calib.trial.plans import campaign_plan
from gyro_calib.trial.plant import record_unit
from gyro_calib.trial.units import draw_trial_unit

#: by how much a gain scatters from recording to recording
SCATTER = 2e-5


def by_time(model: CampaignModel, name: str) -> dict[float, NDArray[np.float64]]:
    """What is left of an effect beside the nuisances, by its time constant; a longer memory holds what was before its recording, too."""
    times = {float(c.setting.get("tau", 0.0)): c for c in model.candidates[name]}
    return {tau: model.screener.projected(c.columns)[0][:, 0] for tau, c in times.items() if 0.1 < tau < 1.0 or tau == 0.0}


@pytest.mark.slow
def test_one_filter_of_drive_and_pickoff_is_no_signal() -> None:
    """A memory of the pick-offs against the same of the drives: what is left of both is far below either, where no table turns the wave."""
    model = healthy("hemisphere")
    for name, twin in (("pickoff_memory", "drive_memory"), ("pickoff_lag", "drive_lag")):
        of_pick, of_drive = (by_time(model, n) for n in (name, twin))
        shared = of_pick.keys() & of_drive.keys()
        assert shared
        for setting in shared:
            one, other = of_pick[setting], of_drive[setting]
            assert one @ other > 0.95 * np.linalg.norm(one) * np.linalg.norm(other)


@pytest.mark.slow
@pytest.mark.parametrize(("apart", "alike"), [(30.0, True), (60.0, False)])
def test_a_lag_of_the_drives_is_told_from_one_of_the_pickoffs_by_much_only(apart: float, alike: bool) -> None:
    """A pick-off's is made of recorded volts, noise and all."""
    model = healthy("hemisphere")
    drive, pick = (model.screener.projected(model.candidates[n][0].columns)[0][:, 0] for n in ("drive_lag", "pickoff_lag"))
    drive, pick = drive / np.linalg.norm(drive), pick / np.linalg.norm(pick)
    screener = copy.copy(model.screener)
    screener.left = np.sqrt(apart / (1.0 - (drive @ pick) ** 2)) * drive
    with mock.patch.object(CampaignModel, "screener_with", return_value=screener):
        group = _alike(model, [model.candidates["drive_lag"][0]], 0)
    assert group[0] == "drive_lag"
    assert ("pickoff_lag" in group) is alike


@pytest.mark.slow
def test_of_twins_the_noise_is_measured_beside_one() -> None:
    model = healthy("ring")
    names = {c.name.split(".")[0] for c in saturated_columns(model.evidence, model.linear, [], model.candidates, [])}
    assert {"drive_memory", "drive_lag"} <= names
    assert not {"pickoff_memory", "pickoff_lag"} & names
    alone = {n: c for n, c in model.candidates.items() if n not in ("drive_memory", "drive_lag")}
    names = {c.name.split(".")[0] for c in saturated_columns(model.evidence, model.linear, [], alone, [])}
    assert {"pickoff_memory", "pickoff_lag"} <= names


def test_no_kind_of_record_is_silenced_before_it_was_heard() -> None:
    quiet, loud = NoiseLaw((1e-13, 0.0, 3e-12, 0.0)), NoiseLaw((1e-9, 2e-14, 4e-9, 1e-15), mean=1e-12)
    noise = {("free", "precession"): quiet, ("free", "quadrature"): quiet, ("ring", "amplitude"): loud, ("open at 9 Hz", "amplitude"): loud}
    tamed = _tamed(noise, {"free", "ring"})
    assert tamed["free", "precession"] == quiet
    assert tamed["open at 9 Hz", "amplitude"] == loud
    np.testing.assert_allclose(tamed["ring", "amplitude"].coefficients, (1e-12, 2e-14, 3e-11, 1e-15))
    assert tamed["ring", "amplitude"].mean == loud.mean


@pytest.mark.slow
def test_the_pickoffs_of_a_hemisphere_are_as_quiet_in_a_ring_down() -> None:
    """One pair of pick-offs: their noise does not depend on what the wave does. It was taken for a thousand times as much."""
    noise = healthy("hemisphere").noise
    kinds = [noise[role, "amplitude"].coefficients[PICKOFF] for role in ("ring", "free", "precession")]
    assert max(kinds) < 10.0 * min(kinds)


@pytest.mark.slow
def test_a_small_device_s_effect_has_its_name() -> None:
    """Of a hemisphere's Duffing the prior, which is that of rings, is so wide that little evidence is left: it was called unknown."""
    unit, rng = draw_trial_unit("hemisphere", 79, 1), np.random.default_rng(1)
    sizes = {"duffing_axes": {"k_x": -1.9e-6, "k_y": -1.6e-6}}
    campaign = record_unit(unit, campaign_plan("hemisphere", unit.device.factory(), rng, "quick"), sizes, rng)
    found = diagnose(campaign)
    assert [e.name for e in found.effects] == ["duffing"]
    for name, size in sizes["duffing_axes"].items():
        value = found.effects[0].parameters[name]
        assert abs(value.value - size) < 4.0 * value.sd


@pytest.mark.slow
def test_a_hemisphere_s_duffing_is_known_by_its_pickoffs_phases() -> None:
    """Its frequency hides in the wander; what is left of k f(p) through unlike phases is k times their difference, and tells far more."""
    unit, rng = draw_trial_unit("hemisphere", 1301, 1), np.random.default_rng(1)
    campaign = record_unit(unit, campaign_plan("hemisphere", unit.device.factory(), rng, "quick"), {"duffing": {"k": 0.005}}, rng)
    f = campaign.factory
    model = look_at(usable(campaign), math.pi * f["nominal_f0_hz"] / f["nominal_q"], f["angular_gain_kappa"])
    plain = model.screener.screen(model.candidates["duffing"][0])
    assert plain is not None
    told = _with_unlike_pickoffs(model, model.screener, plain)
    assert told is not None
    assert told.log_evidence > plain.log_evidence + 25.0
    chain = unit.device.pickoff
    value, sd = told.sizes()[f"{SKEW}_phase"]
    assert abs(value - 0.005 * (chain.phase_y_rad - chain.phase_x_rad)) < 4.0 * sd
    assert abs(value) > 6.0 * sd
    tried = model.screener.screened(cs[0] for cs in model.candidates.values())
    first = sorted(tried, key=lambda s: -s.log_evidence)
    assert _best_refined(model, [], first).name == "duffing"


@pytest.mark.slow
def test_a_resonance_that_wanders_does_so_while_it_is_warmed_and_from_record_to_record() -> None:
    """A thermometer's drift stood in the walk of the frequency's noise, and a healthy ring aged by five standard deviations."""
    model = healthy("ring")
    steady, warming = NoiseLaw((1.0, 2.0, 3.0, 4.0), mean=5.0), NoiseLaw((9.0, 0.0, 0.0, 7.0))
    assert _wandering_all_the_same({STEADY: steady, WARMING: warming})[WARMING] == NoiseLaw((9.0, 2.0, 0.0, 7.0), mean=5.0)
    assert _wandering_all_the_same({STEADY: steady}) == {STEADY: steady}
    wander = _wander_of_means(model.evidence, model.noise)
    assert wander > 0.0
    span = max(float(r.signals.time_s.mean()) for r in model.evidence) - min(float(r.signals.time_s.mean()) for r in model.evidence)
    ageing = next(c.prior_sd for c in model.nuisances if c.name == "frequency_ageing.k")
    assert ageing >= 2.9 * wander / span
    lines = model.evidence.recordings[0].lines("amplitude")
    np.testing.assert_allclose(steady.slow(lines), lines.basis()[:, [1, 3]] @ [2.0, 4.0] + 5.0 * lines.scale * lines.is_mean)


@pytest.mark.slow
def test_a_gain_follows_the_millikelvins_that_no_thermometer_reads() -> None:
    """By as much as it follows the thermometer when that is warmed: the resonance says how warm it was, on the carrier."""
    unit, rng = draw_trial_unit("hemisphere", 79, 1), np.random.default_rng(1)
    pickoff, environment = (replace(unit.device.pickoff, gain_tempco_per_k=3e-4), replace(unit.device.environment, wander_k=5e-3))
    unit = replace(unit, device=replace(unit.device, pickoff=pickoff, environment=environment))
    fit = look_of(record_unit(unit, campaign_plan(unit.kind, unit.device.factory(), rng, "quick"), {}, rng)).base
    (own,) = (k for k, c in enumerate(fit.columns) if c.name == OWN)
    sd = float(np.sqrt(fit.covariance[own, own]))
    assert sd < 0.3
    assert abs(fit.values[own] - 1.0) < 3.0 * sd


def test_an_effect_may_count_between_two_settings_alone() -> None:
    """A mode at 1.4 Hz, tried at 1 and 2 Hz; where nothing nearly counts nothing is tried again."""
    model = healthy("ring")
    columns = form_columns(model.evidence, FORMS["spurious_mode"], model.linear, {"separation_hz": 1.4, "half_width_hz": 1.2})
    clean, _ = model.screener.projected(columns)
    signal = clean @ (1.0 / np.linalg.norm(clean, axis=0))

    def best(snr: float) -> tuple[list[Screened], list[Screened]]:
        screener = copy.copy(model.screener)
        screener.left = snr * signal / np.linalg.norm(signal)
        ranked = best_of_each(screener, {"spurious_mode": model.candidates["spurious_mode"]})
        return ranked, _between_settings(replace(model, screener=screener), ranked)

    (grid,), (between,) = best(7.4)
    assert grid.log_evidence < MARGIN < between.log_evidence
    assert between.candidate.setting["separation_hz"] == pytest.approx(1.4, rel=0.1)
    faint, same = best(5.0)
    assert faint == same


def test_noise_is_not_explained_away() -> None:
    """Columns that hold the noise itself, as a loop's own law does: what is believed stays near what a model without effects leaves."""
    model = healthy("ring")
    e, gain = model.evidence, model.linear.angular_gain
    plain = list(model.nuisances)
    base = model.base.values
    target = [t - np.stack([c.signal[k] for c in plain], axis=1) @ base for k, t in enumerate(target_of(e, gain))]
    quiet = [t - np.stack([c.quiet[k] for c in plain], axis=1) @ base for k, t in enumerate(quiet_target_of(e, gain))]
    spies = [
        Column(f"spy_{k}", tuple(t * (j == k) for j, t in enumerate(target)), tuple(t * (j == k) for j, t in enumerate(quiet)), 10.0)
        for k, r in enumerate(e)
        if r.role in ("ftr_x", "ftr_y")
    ]
    told, _ = measured_noise(e, [*plain, *spies], plain, gain, plain_noise(e, plain, gain))
    honest, _ = measured_noise(e, plain, plain, gain)
    fooled, _ = measured_noise(e, [*plain, *spies], plain, gain)
    for channel in ("precession", "quadrature"):
        levels = [noise["ftr_x", channel].coefficients[WHITE] for noise in (fooled, told, honest)]
        assert levels[0] < 1e-3 * levels[2]
        assert levels[1] > 0.2 * levels[2]


def test_a_limiter_that_could_swallow_a_drive_may_take_but_a_share_of_it() -> None:
    """The rebalance of a still gyro is smaller than many a dead zone on the grid: with all of it gone the loop would be open."""
    model = healthy("ring")
    tried = {name: model.candidates[name] for name in ("drive_dead_zone", "drive_saturation")}
    priors = {c.name: c.prior_sd for c in saturated_columns(model.evidence, model.linear, [], tried, [])}
    assert 0.0 < priors["drive_dead_zone.share"] < 0.05
    assert all(sd <= 1.0 for sd in priors.values())


@pytest.mark.slow
def test_what_has_no_name_is_no_noise() -> None:
    """A stiffness that follows the drives, not in the registry: its record's noise is believed to be what it is without the effect."""
    quiet = healthy("hemisphere")
    strange = looked_at("hemisphere", {"drive_stiffness": {"k_x": 5e-5, "k_y": 4e-5}}, without=("drive_stiffness",))
    assert strange.screener.chi2 > quiet.screener.chi2 + 200.0
    for channel in ("amplitude", "precession", "quadrature"):
        lines = next(r.lines(channel) for r in quiet.evidence if r.role == "precession")
        before, after = (m.noise["precession", channel].density(lines).mean() for m in (quiet, strange))
        assert after < 3.0 * before


def test_drives_add_to_a_wave_that_decays_what_they_add_to_one_that_is_held() -> None:
    """Of a hemisphere's two rises of 26 s four slow lines told the white term: a tenth of it, and 6 sd of flicker went to and fro there."""
    model = healthy("hemisphere")
    stack, kappa = Stack(tuple(model.nuisances)), model.linear.angular_gain
    quiet, solution = quiet_target_of(model.evidence, kappa), _solved(model.evidence, stack, model.noise, target_of(model.evidence, kappa))
    basis, squares = _squares(model.evidence, stack, solution, model.noise, quiet)
    for key in (falling := [("ring", c) for c in ("amplitude", "precession", "quadrature")]):
        basis[key], squares[key] = 9 * basis[key], [1e-6 * found for found in 9 * squares[key]]
    with mock.patch("gyro_calib.gap.noise._squares", return_value=(basis, squares)):
        laws = _from_residuals(model.evidence, stack, solution, model.noise, quiet)
    for role, channel in falling:
        told, held = laws[role, channel].coefficients, laws["precession", channel].coefficients
        assert (*told[:2], told[PICKOFF] < 1e-3 * held[PICKOFF]) == (0.5 * held[0], 0.5 * held[1], True)


def test_where_there_are_no_equations_for_all_those_are_held_that_show() -> None:
    model = healthy("ring")
    many, one = [c for _, c in model.bank if not c.setting], model.bank[0][1].name
    equations = sum(2 * r.signal.lhs.size for r in model.evidence)
    held = saturated_columns(model.evidence, model.linear, model.nuisances[: equations // 4], {}, 3 * many, {one})
    names = {c.name.split(".")[0] for c in held[equations // 4 :]}
    assert names == {one}
    assert one not in {c.name.split(".")[0] for c in saturated_columns(model.evidence, model.linear, held, {}, 3 * many)[len(held) :]}


@pytest.mark.slow
def test_what_lags_behind_the_temperature_is_no_drift_of_two_recordings() -> None:
    """A split that lags, not in the registry: phases of the drives that wander by themselves were believed to be ten times as large."""
    lags = {"thermal_split_lag": {"k_c": -2e-6, "k_s": 1e-6, "tau": 9.0}}
    named = looked_at("hemisphere", lags)
    strange = looked_at("hemisphere", lags, without=("thermal_split_lag",))
    assert strange.screener.chi2 > 0.8 * named.screener.chi2
    assert max(worth_of(s) for s, a in bank_terms(strange, strange.screener) if a.depends_on == "temperature") > 2.0 * MARGIN


@pytest.mark.slow
def test_a_gradient_that_splits_and_damps_is_one_effect() -> None:
    """A plant's had the name of a drive's gain that lags; as two effects each had the other's share of the evidence against it."""
    tau = {"tau": 8.0}
    both = looked_at("ring", {"thermal_split_lag": {"k_c": 1.5e-4, "k_s": -1.5e-4, **tau}, "thermal_damping_lag": {"c": 1.5e-4, **tau}})
    assert [e.name for e in select_effects(both).effects] == ["thermal_split_lag"]


def test_a_record_has_one_frequency_of_its_own_and_no_second_one() -> None:
    """Where a resonance lay is a nuisance whose size is measured: the mean's line holds no walk beside it, and no other line's noise."""
    model = healthy("ring")
    for r, (real, imaginary) in zip(model.evidence, model.whitener.factors, strict=True):
        lines = r.lines("frequency")
        if not r.is_wave or not lines.is_mean.any():
            continue
        (mean,) = np.flatnonzero(lines.is_mean)
        noise = imaginary @ imaginary.T
        others = np.arange(noise.shape[0]) != mean
        assert np.all(noise[mean, others] == 0.0)
        assert np.any((real @ real.T)[mean, others] != 0.0)
        carried_on = replace(lines, frequency_hz=np.where(lines.is_mean, MEAN_LINE / r.recording.duration_s, lines.frequency_hz))
        law = model.noise[r.noise_key("frequency")]
        assert law.slow(lines)[mean] <= 0.05 * law.slow(carried_on)[mean]


@pytest.mark.slow
def test_a_walk_of_a_wave_that_turns_is_correlated_as_one_that_stands() -> None:
    """A clean hemisphere's table records held a centrifugal stiffness of 45 in chi-square by the correlations of white noise."""
    rng, worst = np.random.default_rng(9), 0.0
    for r in healthy("hemisphere").evidence:
        lines = r.lines("frequency")
        if not r.is_wave or r.is_warming or not lines.is_mean.any():
            continue
        s = r.signals
        walk = 2.0 * np.pi * np.cumsum(rng.standard_normal((600, len(s.time_s))), axis=1) * np.sqrt(s.row_s)
        walk -= walk.mean(axis=1, keepdims=True)
        projected = r.turn * r.signal_forms.plain([1j * w[:, None] * s.pick for w in walk])
        seen = projected[: len(lines.frequency_hz)].imag[~lines.is_mean]
        law = NoiseLaw((1e-6, 0.0, 0.0, 1.0))
        told = law.covariance(lines, r.grams)[np.ix_(~lines.is_mean, ~lines.is_mean)]
        whitened = np.linalg.solve(np.linalg.cholesky(told), seen)
        assert np.mean(whitened**2) == pytest.approx(1.0, abs=0.1)
        believed = law.covariance(replace(lines, walk_s2=None), r.grams)[np.ix_(~lines.is_mean, ~lines.is_mean)]
        worst = max(worst, float(np.mean(np.linalg.solve(np.linalg.cholesky(believed), seen) ** 2, axis=1).max()))
    assert worst > 3.0


@pytest.mark.slow
def test_a_gain_that_is_another_in_each_recording_is_noise_of_its_means() -> None:
    rng = np.random.default_rng(3)
    unit, planned = draw_trial_unit("ring", 79, 1), np.random.default_rng(1)
    campaign = record_unit(unit, campaign_plan("ring", unit.device.factory(), planned, "quick"), {}, planned)
    scattered = look_of(replace(campaign, recordings=tuple(with_drive(r, "y", 1.0 + SCATTER * rng.standard_normal()) for r in campaign)))
    key = ("ftr_y", "amplitude")
    assert scattered.noise[key].mean > 2.0 * scattered.noise[key].coefficients[WHITE]
    assert scattered.noise["ftr_x", "amplitude"].mean < 0.2 * scattered.noise[key].mean
    # the means are as loud as they are believed to be, and nothing is named
    squares, free = means_left(scattered, key)
    assert squares < free + 4.0 * math.sqrt(2.0 * free)
    assert select_effects(scattered).effects == ()


def with_drive(recording: Recording, axis: str, factor: float) -> Recording:
    data = recording.data.copy()
    first = 6 if axis == "x" else 8
    data[:, first : first + 2] *= factor
    return replace(recording, data=data)


def means_left(model: CampaignModel, key: tuple[str, str]) -> tuple[float, float]:
    """Squares of a kind's means in units of their noise, and what is expected of them."""
    freedom = 1.0 - np.sum(model.base.basis**2, axis=1)
    squares = free = 0.0
    for _, r, _, _, channel, rows in _parts(model.evidence):
        if r.noise_key(channel) == key:
            means = r.lines(channel).is_mean
            squares += float(np.sum(model.base.residual[rows][means] ** 2))
            free += float(np.sum(freedom[rows][means]))
    return squares, free


@pytest.mark.slow
def test_an_effect_that_is_left_alone_must_count_by_itself() -> None:
    model = healthy("hemisphere")
    best = best_of_each(model.screener, model.candidates)[0]
    assert best.log_evidence < MARGIN
    with mock.patch("gyro_calib.gap.select._pair", return_value=[best.candidate]):
        assert select_effects(model).effects == ()
