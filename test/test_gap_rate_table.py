"""A table that is later than its log: the log is mended, and what is left of its steps does not hide what depends on rate."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from table_samples import looked_at, loudest, on_a_table, table_model

from gyro_calib.device import draw_unit, load_device
from gyro_calib.gap import rate_table
from gyro_calib.gap.diagnose import diagnose
from gyro_calib.gap.linear_device import reaction_of
from gyro_calib.gap.model import CampaignModel
from gyro_calib.gap.patch import constant_rate, patched_device
from gyro_calib.gap.rate_table import gain_as_read, rate_columns, said_late, shifted
from gyro_calib.gap.relinearise import relinearised
from gyro_calib.gap.select import select_effects
from gyro_calib.recording.applied_rate import applied_rate, is_turned
from gyro_calib.recording.recording import Recording
from gyro_calib.trial.injected import with_columns
from gyro_calib.trial.plans import campaign_plan
from gyro_calib.trial.plant import record_unit
from gyro_calib.trial.units import draw_trial_unit

#: how late the table is, by recording [s]
LATE_S = {"table_x": 0.061, "table_y": 0.024}


def logged_early(recording: Recording) -> Recording:
    """The log of a table that turned later than it says."""
    words = recording.extras["applied_rate"]
    times = [words["t_s"][0], *(t - LATE_S[recording.label] for t in words["t_s"][1:])]
    return replace(recording, extras={**recording.extras, "applied_rate": {**words, "t_s": times}})


@cache
def model(late: bool) -> CampaignModel:
    campaign = on_a_table()
    recordings = tuple(logged_early(r) if late and is_turned(r) else r for r in campaign)
    return looked_at(replace(campaign, recordings=recordings))


def test_the_log_is_mended_by_recording() -> None:
    truth = {r.label: applied_rate(r)[0] for r in on_a_table() if is_turned(r)}
    assert truth.keys() == LATE_S.keys()
    for r in model(late=True).evidence:
        if r.recording.label in truth:
            # the angle between the two courses, over the largest rate: a time
            row_s = 1.0 / r.recording.sample_rate_hz
            apart = (
                np.abs(np.cumsum(applied_rate(r.recording)[0] - truth[r.recording.label])) * row_s / np.abs(truth[r.recording.label]).max()
            )
            assert np.median(apart[apart > 0.1 * apart.max()]) < 1e-3


@pytest.mark.parametrize(("length_s", "counted"), [(0.02, True), (0.06, True), (0.1, True), (0.5, False)])
def test_steps_that_a_motor_rounds_are_steps_and_a_course_is_none(length_s: float, counted: bool) -> None:
    """One of 15 ms takes 0.11 s of a thinned log: not counted as steps, a hemisphere on it had a quadrature by the square of the rate."""
    evidence = model(late=True).evidence
    logs = {r.label: shifted(r, 0.0, length_s) for r in on_a_table() if is_turned(r)}
    on_table = {r.index: logs[r.recording.label] for r in evidence if is_turned(r.recording)}
    steps = [c for c in rate_columns(evidence.replaced(on_table)) if c.name.startswith("table_step_")]
    # two edges for each ramp, two phases for each step
    ramps = sum(len(r.extras["applied_rate"]["t_s"]) // 2 for r in on_table.values())
    assert len(steps) == 2 * ramps * counted


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rate_asymmetry", "centrifugal_stiffness"])
def test_what_depends_on_rate_is_as_certain_as_with_a_right_log(name: str) -> None:
    # alike on both axes, where that is another variant
    late, right = (m.screener.screen(m.candidates[name][0]) for m in (model(late=True), model(late=False)))
    assert late is not None
    assert right is not None
    (of_late,), (of_right,) = ([sd for _, sd in s.sizes().values()] for s in (late, right))
    assert of_late < 1.3 * of_right


def test_a_factory_that_errs_in_its_angular_gain_hides_nothing_that_depends_on_rate() -> None:
    """Of a plant by another hand it erred by 1.3 %: the floor of what was turned was 33 times too loud, and no asymmetry was seen."""
    campaign = on_a_table()
    kappa = campaign.factory["angular_gain_kappa"]
    wrong = looked_at(replace(campaign, factory={**campaign.factory, "angular_gain_kappa": 1.013 * kappa}))
    (of_wrong,), (of_right,) = ([sd for _, sd in loudest(m, "rate_asymmetry").sizes().values()] for m in (wrong, table_model()))
    assert of_wrong < 1.5 * of_right
    ((told, sd),) = loudest(wrong, "angular_gain_error").sizes().values()
    assert abs(told - (1.0 / 1.013 - 1.0)) < 4.0 * sd


def test_a_feedthrough_does_not_turn_and_hides_nothing_either() -> None:
    """E is known from the open drives: with four free entries of a turned one an asymmetry has thirteen times this (1.7e-4)."""
    ((_, sd),) = loudest(model(late=False), "rate_asymmetry").sizes().values()
    assert sd < 3e-5


def test_a_table_that_is_too_late_for_its_motor_is_told() -> None:
    (told,) = said_late(model(late=True).evidence, model(late=True).late_s)
    assert "'table_x' turned 61 ms later" in told
    assert said_late(model(late=False).evidence, model(late=False).late_s) == []


@pytest.mark.parametrize("late_s", [0.03, -0.03])
def test_a_log_of_many_small_steps_stays_in_order(late_s: float) -> None:
    (recording,) = [r for r in on_a_table() if r.label == "table_x"]
    t = np.arange(0.0, recording.duration_s, 0.01)
    dense = replace(recording, extras={**recording.extras, "applied_rate": {"t_s": list(t), "deg_s": list(50.0 * np.sin(t))}})
    mended = shifted(dense, late_s, 0.025)
    rate, _ = applied_rate(mended)
    row_s = 1.0 / recording.sample_rate_hz
    logged = np.deg2rad(50.0 * np.sin(np.arange(len(rate)) * row_s - late_s))
    np.testing.assert_allclose(rate[50:-50], logged[50:-50], atol=1.5e-2)


@pytest.mark.slow
def test_a_servo_that_takes_its_steps_early_or_late_is_no_gain_of_the_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    """By 0.1 ms, each step by itself; a hemisphere was said to have a gain of 1.7 % and a curvature that undoes it at the table's rate."""
    unit, rng = draw_trial_unit("hemisphere", 79, 1), np.random.default_rng(1)
    campaign = record_unit(unit, campaign_plan("hemisphere", unit.device.factory(), rng, "quick"), {}, rng)
    jitter = np.random.default_rng(0)
    recordings = []
    for r in campaign:
        if is_turned(r):
            words = r.extras["applied_rate"]
            times = [words["t_s"][0], *(t + 1e-4 * jitter.standard_normal() for t in words["t_s"][1:])]
            r = replace(r, extras={**r.extras, "applied_rate": {**words, "t_s": times}})
        recordings.append(r)
    spoilt = replace(campaign, recordings=tuple(recordings))
    model = looked_at(spoilt)
    assert select_effects(model).effects == ()
    monkeypatch.setattr(rate_table, "_SERVO_S", 0.0)
    assert looked_at(spoilt).screener.chi2 > model.screener.chi2 + 25.0


@pytest.mark.parametrize(
    ("mismatch", "mixed", "rotated", "phase_rad"),
    [(0.06, 0.05, 0.05, 0.0), (-0.05, -0.035, 0.044, 0.0), (0.0, 0.0, 0.03, 0.0), (0.3, 0.1, -0.2, 0.0), (0.02, 0.01, -0.01, 0.22)],
)
def test_pickoffs_askew_read_another_angular_gain(mismatch: float, mixed: float, rotated: float, phase_rad: float) -> None:
    """What a table shows of them in the symmetric part of P J P^-1 says how much its antisymmetric part is more than one, or less."""
    pick = np.diag([1.0, np.exp(1j * phase_rad)]) @ np.array([[1.0, mixed - rotated], [mixed + rotated, 1.0 + mismatch]])
    response = 0.57 * pick @ np.array([[0.0, 1.0], [-1.0, 0.0]]) @ np.linalg.inv(pick)
    symmetric = {"mismatch": 0.5 * (response[0, 1] + response[1, 0]), "skew": 0.5 * (response[0, 0] - response[1, 1])}
    values = {f"rate_{n}_{part}": getattr(x, of) for n, x in symmetric.items() for part, of in (("re", "real"), ("im", "imag"))}
    assert gain_as_read(0.57, values) == pytest.approx((0.5 * (response[0, 1] - response[1, 0])).real, rel=1e-12)
    assert gain_as_read(0.57, {}) == 0.57
    read = gain_as_read(0.57, values)
    # whose imaginary part, of a phase and a mismatch, is not in what is known
    np.testing.assert_allclose(-read * reaction_of(values, read), response, atol=1e-12 + 1.5 * abs(phase_rad * mismatch))
    np.testing.assert_array_equal(reaction_of({}, 0.57), [[0.0, -1.0], [1.0, 0.0]])


def test_steps_of_a_table_do_to_the_volts_what_a_rate_does() -> None:
    """Of pick-offs that are not alike the lag, the rounding and the carrier's phase, too; the response to rate is what is sought."""
    model = table_model()
    reaction = np.array([[0.03j, -1.0 - 0.2j], [1.0 - 0.2j, -0.03j]])
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]], dtype=complex)
    unlike, plain, rest = (
        {c.name: c for c in rate_columns(model.evidence, replace(model.linear, reaction=of))}
        for of in (reaction, quarter, reaction - quarter)
    )
    assert unlike.keys() == plain.keys()
    steps = {n for n in plain if n.startswith(("table_lag", "table_step", "table_blur", "table_skew", "table_tails", "table_fifth"))}
    assert len(steps) > 10
    for name in plain:
        more = [rest[name].signal[k] if name in steps else 0.0 for k in range(len(model.evidence))]
        for one, other, added in zip(unlike[name].signal, plain[name].signal, more, strict=True):
            np.testing.assert_allclose(one, other + added, atol=1e-9 * max(float(np.abs(other).max(initial=0.0)), 1e-300))
        assert name not in steps or any(np.any(np.abs(x) > 0.0) for x in rest[name].signal)


@pytest.mark.slow
def test_channels_that_are_read_in_turns_read_nothing_by_the_square_of_the_rate() -> None:
    """Of a wave that turns, 0.3 rad of the carrier apart: the recorder's filter, told by a quarter turn, was that of 54 in chi-square."""
    unit, rng = draw_trial_unit("hemisphere", 8601, 35), np.random.default_rng(12)
    plan = campaign_plan("hemisphere", unit.device.factory(), rng, "standard")
    model = looked_at(record_unit(unit, plan, {"multiplexing_skew": {"tau": 6.4e-6}}, rng))
    own = loudest(model, "multiplexing_skew")
    beside = model.screener_with(relinearised(model, [own.candidate]))
    forms = [c for a, c in model.bank if a.form == "Omega^2 x" and a.location == "pick-off" and not c.setting]
    assert len(forms) >= 2
    assert all(found.gain < 15.0 for found in beside.screened(forms))


@pytest.mark.slow
def test_a_pickoff_that_is_sampled_in_its_turn_is_named_and_patched() -> None:
    """By the response to rate alone; what simulates it reads as late, with the phases that the recordings have."""
    late_s = 2e-6
    campaign = on_a_table("multiplexing_skew", tau=late_s)
    found = diagnose(campaign)
    assert [e.name for e in found.effects] == ["multiplexing_skew"]
    tau = found.effects[0].parameters["tau"]
    # what a healthy unit's phases are uncertain by: 0.01 rad of 15 kHz
    assert abs(tau.value - late_s) < 3.0 * tau.sd
    assert 5e-8 < tau.sd < 2e-7
    assert found.estimate is not None
    device = patched_device(load_device("ring_15k"), found)
    flow = device.slow_flow(constant_rate(device, found), found.estimate.temperature_degc, found.estimate.omega0_rad_s)
    np.testing.assert_allclose(flow.A, found.estimate.A, atol=1e-6 * np.abs(found.estimate.A).max())
    np.testing.assert_allclose(flow.G, found.estimate.G, rtol=1e-6)
    unit = replace(draw_unit(load_device("ring_15k"), 5), effects={"multiplexing_skew": {"tau": late_s}})
    seen, true = (np.angle(d.pickoff_matrix()[1, 1] / d.pickoff_matrix()[0, 0]) for d in (device, unit))
    assert seen == pytest.approx(true, abs=0.5 * abs(true) ** 3)  # the form has its tangent as itself


def test_a_wave_that_grows_as_the_rule_of_a_plant_has_it_is_healthy() -> None:
    """The forward rule on a Coriolis force lets it grow by ``Omega^2`` times a step."""
    healthy = table_model()
    (kicked,) = (c for c in healthy.nuisances if c.name == "rate_kicked")
    assert kicked.prior_sd == pytest.approx(2e-5)
    growing = with_columns(healthy, [(kicked, 1.5 * kicked.prior_sd)])
    assert not select_effects(growing).effects
    assert select_effects(growing).stranger is None


@pytest.mark.slow
def test_a_patched_device_keeps_the_angular_gain_of_its_resonator() -> None:
    """Its pick-offs are askew as those that were seen: as they read it, it would be counted twice."""
    campaign = on_a_table()
    kappa = float(campaign.factory["angular_gain_kappa"])
    found = diagnose(campaign)
    assert found.estimate is not None
    assert found.estimate.angular_gain == kappa
    assert looked_at(campaign).linear.angular_gain > kappa
