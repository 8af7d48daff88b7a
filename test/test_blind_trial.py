"""Blind trials: what is drawn, how it is sealed, and the arithmetic of gates, reliability and baselines on verdicts made by hand."""

from __future__ import annotations

import json
import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from test_gap_memory import chain

from gyro_calib.cli.main import main
from gyro_calib.effects import EFFECTS, checked_sizes
from gyro_calib.errors import DataError
from gyro_calib.experiments.plan import Plan
from gyro_calib.gap.forms import FORMS
from gyro_calib.jit import COMPILED
from gyro_calib.trial import run, scores
from gyro_calib.trial.baselines import BASELINES, lasso
from gyro_calib.trial.intervals import Share
from gyro_calib.trial.labels import LADDER, STRATA, Label, Seal, draw_trials, reported_name, trial_effects
from gyro_calib.trial.plans import POOR, campaign_plan, poor_plan
from gyro_calib.trial.plant import record_unit, with_effects
from gyro_calib.trial.run import TrialLog
from gyro_calib.trial.sizing import _linear_parameters
from gyro_calib.trial.trial import Outcome, Prepared, run_trial
from gyro_calib.trial.units import draw_trial_unit
from gyro_calib.trial.verdicts import Found, Verdict

DAMPING = {"nonlinear_damping": {"c": 0.02}}


def label(number: int = 0, stratum: str = "one", effects: dict[str, dict[str, float]] | None = None, snr: float = 12.0, **more) -> Label:
    effects = DAMPING if effects is None else effects
    return Label(number, stratum, "ring", effects, (snr,) * len(effects), **more)


def found(
    name: str, group: tuple[str, ...] = (), gain: float = 100.0, probability: float = 0.99, **parameters: tuple[float, float]
) -> Found:
    return Found(reported_name(name), name, (reported_name(name), *group), probability, parameters, gain)


def outcome(truth: Label, verdict: Verdict, baselines: dict[str, str | None] | None = None) -> Outcome:
    return Outcome(truth, "n", Seal.of(truth, "n"), verdict, baselines or {})


def gate(outcomes: list[Outcome], name: str) -> scores.TrialGate:
    (one,) = [g for g in scores.gates(outcomes) if g.name.startswith(name)]
    return one


# -- sealing ---------------------------------------------------------------------------------------------------------------------------


def test_seal_opens_to_its_own_label_only() -> None:
    true = label()
    seal = Seal.of(true, "salt")
    seal.check(true, "salt")
    for other, nonce in ((true, "other"), (label(effects={"duffing": {"k": 0.1}}), "salt"), (replace(true, without=("duffing",)), "salt")):
        with pytest.raises(DataError, match="must have the hash"):
            seal.check(other, nonce)


def test_log_refuses_what_was_not_sealed_and_a_second_seal(tmp_path) -> None:
    path = tmp_path / "trials.log"
    log = TrialLog(path)
    true = outcome(label(3), Verdict("none"))
    log.seal(3, true.seal.sha256)
    assert "damping" not in path.read_text()
    with pytest.raises(DataError, match="sealed once"):
        log.seal(3, true.seal.sha256)
    with pytest.raises(DataError, match="seal in the log"):
        log.open(outcome(label(4), Verdict("none")))
    with pytest.raises(DataError, match="must have the hash"):
        log.open(replace(true, label=label(3, effects={"duffing": {"k": 0.1}})))
    log.open(true)
    assert [line.split()[0] for line in path.read_text().splitlines()] == ["sealed", "opened"]


# -- drawing ---------------------------------------------------------------------------------------------------------------------------


def test_trials_are_drawn_in_their_shares_and_again_by_seed() -> None:
    trials = draw_trials(48, 5)
    assert trials == draw_trials(48, 5)
    assert Counter(t.stratum for t in trials) == {name: 4 * share for name, share in STRATA.items()}
    assert all(t.kind == ("ring", "hemisphere")[t.number % 2] for t in trials)
    assert {t.snr[0] for t in trials if t.stratum == "one"} == set(LADDER)
    assert {t.poor for t in trials if t.stratum == "poor"} <= set(POOR)
    assert [t.order for t in trials] != [t.order for t in draw_trials(48, 6)]
    # every effect comes first once before any comes again
    first = [t.order[0] for t in draw_trials(400, 5, ["one"]) if t.kind == "ring"]
    names = trial_effects("force-rebalance")
    assert sorted(first[: len(names)]) == sorted(names)
    with pytest.raises(DataError, match="strata"):
        draw_trials(2, 0, ["cleaan"])


def test_trials_may_be_as_loud_as_a_real_device() -> None:
    trials = draw_trials(48, 5, ladder=(100.0, 300.0))
    assert {s for t in trials for s in t.snr} == {100.0, 300.0}
    assert all(t.snr for t in trials if t.stratum != "clean")
    assert [(t.stratum, t.order) for t in trials] == [(t.stratum, t.order) for t in draw_trials(48, 5)]
    # of effects that are not known the faintest is left out, unless it is all there is
    assert {t.snr for t in trials if t.stratum == "removed"} == {(300.0,)}
    assert {t.snr for t in draw_trials(48, 5, ladder=(100.0,)) if t.stratum == "removed"} == {(100.0,)}
    for ladder in ((), (4.0, 6.0), (0.0, 20.0), (math.nan, 20.0)):
        with pytest.raises(DataError, match="ladder"):
            draw_trials(2, 0, ladder=ladder)


@pytest.mark.parametrize("kind", ["ring", "hemisphere"])
def test_units_differ_and_are_healthy(kind: str) -> None:
    units = [draw_trial_unit(kind, 1, k) for k in range(6)]
    assert units[2] == draw_trial_unit(kind, 1, 2)
    assert len({u.device.resonator.frequency_split_hz for u in units}) == 6
    for u in units:
        # coefficients of healthy devices lie well below what the catalogue calls typical of the effect
        for name, sizes in u.device.effects.items():
            assert all(abs(v) < EFFECTS[name].parameter(p).typical for p, v in sizes.items())
        steps = campaign_plan(kind, u.device.factory(), np.random.default_rng(0)).steps
        assert 20 <= len(steps) <= 70


def test_effects_add_to_the_healthy_coefficients() -> None:
    device = draw_trial_unit("ring", 1, 0).device
    before = device.effects["thermal_drive_gain"]["g_x"]
    after = with_effects(device, {"thermal_drive_gain": {"g_x": 1e-3, "g_y": 0.0}, "duffing": {"k": 0.1}}).effects
    assert after["thermal_drive_gain"]["g_x"] == pytest.approx(before + 1e-3)
    assert after["duffing"] == checked_sizes({"duffing": {"k": 0.1}})["duffing"]


@pytest.mark.parametrize("kind", ["ring", "hemisphere"])
def test_poor_plans_lack_what_they_say(kind: str) -> None:
    unit = draw_trial_unit(kind, 1, 0)
    plan = campaign_plan(kind, unit.device.factory(), np.random.default_rng(0))
    amplitude = unit.device.factory_data.nominal_amplitude_v

    def poor(how: str) -> Plan:
        return poor_plan(plan, how, unit.mode, amplitude)

    assert all(s.temperature_degc is None for s in poor("no temperature run").steps)
    assert any(s.temperature_degc is not None for s in plan.steps)
    closed = [s for s in poor("one amplitude").steps if s.command.mode in ("ftr_x", "ftr_y", "whole_angle") and s.label != "locate"]
    assert {s.command.setpoints.amplitude_v for s in closed} == {amplitude}
    assert 4 <= len(poor("few recordings").steps) <= 8


def test_what_a_form_has_as_a_setting_is_not_drawn_as_a_size() -> None:
    signals = chain()
    for name, form in FORMS.items():
        settings = {key for setting in form.settings(signals) for key in setting} & {p.name for p in EFFECTS[name].parameters}
        if "level" not in settings and name != "thermal_lag":  # tried as its own size, and at times
            assert not settings & set(_linear_parameters(name)), name


# -- gates -----------------------------------------------------------------------------------------------------------------------------


def test_intervals_of_a_share() -> None:
    none_of_60 = Share(0, 60)
    assert none_of_60.clopper_pearson == pytest.approx((0.0, 1.0 - 0.025 ** (1 / 60)))
    assert none_of_60.upper == pytest.approx(1.0 - 0.05 ** (1 / 60))
    assert Share(0, 58).upper > 0.05 > Share(0, 59).upper
    # Wilson 1927 for 8 of 10
    assert Share(8, 10).wilson == pytest.approx((0.4902, 0.9433), abs=1e-4)
    assert Share(8, 10).clopper_pearson == pytest.approx((0.4439, 0.9748), abs=1e-4)
    assert Share(5, 5).clopper_pearson[1] == 1.0


def test_detection_and_naming_count_from_a_ratio_of_eight() -> None:
    right, wrong = Verdict("effects", (found("nonlinear_damping", c=(0.021, 0.001)),)), Verdict("effects", (found("duffing"),))
    outcomes = [outcome(label(snr=s), v) for s, v in ((8.0, right), (20.0, wrong), (40.0, Verdict("unknown")), (4.0, Verdict("none")))]
    assert gate(outcomes, "detection").value == 1.0
    assert gate(outcomes, "group").value == pytest.approx(1 / 3)
    assert gate(outcomes, "group").passed is False
    assert gate(outcomes, "false unknowns").value == pytest.approx(1 / 4)
    assert gate(outcomes, "two effects").passed is None
    assert [row["count"] for row in scores.by_severity(outcomes)] == [1, 0, 1, 0, 1, 1]
    assert [row["count"] for row in scores.by_severity(outcomes, (8.0, 100.0))] == [1, 0]


def test_the_first_group_may_name_the_truth_second() -> None:
    grouped = Verdict("effects", (found("quadratic_damping", ("nonlinear_damping",)),))
    behind = Verdict("effects", (found("duffing", gain=500.0), found("nonlinear_damping")))
    outcomes = [outcome(label(), grouped), outcome(label(), behind)]
    assert gate(outcomes, "group").value == 0.5
    assert gate(outcomes, "set covers").value == 1.0
    assert gate(outcomes, "mean size").value == 2.0
    assert gate(outcomes, "mean size").passed is False


def test_alarms_are_held_against_their_upper_bound() -> None:
    clean = [outcome(label(k, "clean", {}), Verdict("none")) for k in range(60)]
    assert gate(clean, "false alarms").passed is True
    assert gate(clean[:30], "false alarms").passed is False
    assert gate([*clean, outcome(label(60, "clean", {}), Verdict("unknown"))], "false alarms").passed is False


def test_pairs_must_be_exact() -> None:
    both = {"nonlinear_damping": {"c": 0.02}, "duffing_axes": {"k_x": 0.1, "k_y": 0.0}}
    named = found("nonlinear_damping"), found("duffing_axes")
    assert named[1].name == "duffing"
    verdicts = [
        Verdict("effects", named),
        Verdict("effects", named[::-1]),
        Verdict("effects", named[:1]),
        Verdict("effects", (*named, found("relaxation"))),
    ]
    outcomes = [outcome(label(k, "two", both), v) for k, v in enumerate(verdicts)]
    assert gate(outcomes, "two effects").value == 0.5


def test_intervals_of_sizes_and_shrinkage() -> None:
    def one(value: float, before: float, after: float) -> Outcome:
        gap, gain = max(before**2 - 1.0, 0.0), before**2 - after**2
        closed = gain / gap if gap else 0.0
        sizes = found("nonlinear_damping", c=(value, 0.001))
        verdict = Verdict("effects", (sizes,), rms_before=before, rms_after=after, closed=closed, closed_sd=0.1)
        return outcome(label(), verdict)

    outcomes = [one(0.0215, 2.0, 1.0), one(0.0225, 3.0, 1.3), one(0.02, 1.0, 1.01)]
    assert gate(outcomes, "95 %").value == pytest.approx(2 / 3)
    # the gaps of 3 and 8 closed by 3 and 9 - 1.69; a gap that was none has no weight
    assert gate(outcomes, "closed").value == pytest.approx((3.0 + 7.31) / 11.0)
    assert gate(outcomes, "RMS").value == pytest.approx(2 / 3)
    assert gate(outcomes, "added effect").value == pytest.approx(1 / 3)


def test_poor_plans_fail_by_a_false_name_only() -> None:
    said = [
        Verdict("not_testable"),
        Verdict("none"),
        Verdict("effects", (found("nonlinear_damping"),)),
        Verdict("effects", (found("duffing"),)),
    ]
    assert gate([outcome(label(stratum="poor"), v) for v in said], "poor plans").value == 0.75


def test_confusion_and_reliability() -> None:
    right, wrong = (Verdict("effects", (found(name, probability=0.97),)) for name in ("nonlinear_damping", "duffing"))
    outcomes = [
        outcome(label(), right),
        outcome(label(), wrong),
        outcome(label(stratum="clean", effects={}), Verdict("none", probability_none=0.93)),
        outcome(label(stratum="removed"), Verdict("unknown", probability_unknown=0.9)),
    ]
    table = scores.confusion(outcomes)
    assert table == {"none": {"none": 1}, "nonlinear_damping": {"nonlinear_damping": 1, "duffing": 1}, "removed": {"unknown": 1}}
    rows = {(r["from"], r["to"]): r for r in scores.reliability(outcomes)}
    assert (rows[0.95, 0.99]["count"], rows[0.95, 0.99]["right"]) == (2, 1)
    assert (rows[0.9, 0.95]["count"], rows[0.9, 0.95]["right"]) == (2, 2)


def test_baselines_are_scored_on_the_same_trials() -> None:
    says = dict.fromkeys(BASELINES, "quadratic_damping") | {"lasso": None}
    like = {"nonlinear_damping": {"quadratic_damping": 3.0}}
    right = Verdict("effects", (found("nonlinear_damping"),))
    outcomes = [outcome(label(like=like), right, says), outcome(label(), right, says), outcome(label(), right)]
    outcomes.append(outcome(label(stratum="clean", effects={}), Verdict("none"), says))
    rows = {r["name"]: r for r in scores.baseline_rows(outcomes)}
    assert (rows["diagnosis"]["strong"], rows["diagnosis"]["first"], rows["diagnosis"]["false_alarms"]) == (2, 2, 0)
    # right where nothing tells the two apart, wrong where the data do
    assert (rows["naive correlation"]["first"], rows["naive correlation"]["false_alarms"]) == (1, 1)
    assert (rows["lasso"]["detected"], rows["lasso"]["false_alarms"]) == (0, 0)


def test_lasso_is_at_its_optimum() -> None:
    rng = np.random.default_rng(3)
    design = rng.standard_normal((200, 30))
    design[:, 5] = design[:, 4] + 0.3 * design[:, 5]
    design /= np.linalg.norm(design, axis=0)
    truth = np.zeros(30)
    truth[[4, 17]] = 12.0, -9.0
    target, penalty = design @ truth + rng.standard_normal(200), 3.0
    x = lasso(design, target, penalty)
    pull = design.T @ (target - design @ x)
    active = x != 0.0
    assert set(np.flatnonzero(active)) >= {4, 17}
    np.testing.assert_allclose(pull[active], penalty * np.sign(x[active]), atol=1e-4)
    assert np.all(np.abs(pull[~active]) <= penalty + 1e-4)


# -- one trial, end to end ---------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.skipif(not COMPILED, reason="numba is not installed or switched off")
def test_a_small_trial_from_the_carrier_to_the_verdict() -> None:
    unit = draw_trial_unit("ring", 7, 0)
    plan = campaign_plan("ring", unit.device.factory(), np.random.default_rng(7), "quick")
    kept = [s for s in plan.steps if s.label.startswith(("side", "static", "locate", "feed"))]
    effects = {"nonlinear_damping": {"c": 0.03}}
    campaign = record_unit(unit, replace(plan, steps=tuple(kept)), effects, np.random.default_rng(8))
    true = Label(0, "one", "ring", effects, (40.0,))
    done = run_trial(Prepared(true, "n", Seal.of(true, "n"), campaign), baselines=True)
    done.seal.check(done.label, done.nonce)
    assert scores.is_top(done), done.verdict
    assert set(done.baselines) == set(BASELINES)


# -- what a person gets ------------------------------------------------------------------------------------------------------------------


def test_figures_reach_the_reader(tmp_path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    says = dict.fromkeys(BASELINES, "duffing")
    verdict = Verdict("effects", (found("nonlinear_damping", c=(0.02, 0.001)),), rms_before=2.0, closed_sd=0.05)
    outcomes = (outcome(label(), verdict, says), outcome(label(1, "clean", {}), Verdict("none", probability_none=0.9), says))
    result = run.BlindTrials(
        outcomes, tuple(scores.gates(list(outcomes))), 4, "quick", 2.0, "2026-01-01T00:00:00+00:00", {2: "DataError: no"}
    )
    monkeypatch.setattr(run, "run_blind_trials", lambda *args, **options: result)
    file = tmp_path / "trials.json"
    # one clean trial bounds nothing: a gate fails
    assert main(["blind-trial", "--trials", "3", "--json", str(file)]) == 1
    shown = capsys.readouterr()
    assert all(word in shown.out for word in ("detection", "false alarms", "FAIL", "no trials", "naive correlation", "nonlinear_damping"))
    assert "trial 2 could not be recorded: DataError: no" in shown.err
    document = json.loads(file.read_text())
    assert document["seed"] == 4
    assert document["trials"][0]["label"]["effects"] == DAMPING
    assert {g["name"] for g in document["gates"]} == {g.name for g in result.gates}


def test_picture_of_trials(tmp_path) -> None:
    pytest.importorskip("matplotlib")
    from gyro_calib.report.theme import save_figure
    from gyro_calib.report.trial_figures import draw_trials as draw

    outcomes = (outcome(label(), Verdict("effects", (found("nonlinear_damping"),))), outcome(label(1, "clean", {}), Verdict("none")))
    result = run.BlindTrials(outcomes, tuple(scores.gates(list(outcomes))), 4, "quick", 2.0, "2026-01-01T00:00:00+00:00", {})
    save_figure(draw(result), tmp_path / "trials.png")
    assert (tmp_path / "trials.png").stat().st_size > 5000


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_trial_that_cannot_be_recorded_is_told(jobs: int) -> None:
    done: list[int] = []
    result = run.run_blind_trials(4, 0, strata=["clean"], jobs=jobs, quality="endless", on_done=lambda k, of: done.append(k))
    assert sorted(result.broken) == [0, 1, 2, 3]
    assert all("quality" in reason for reason in result.broken.values())
    assert (result.passed, done) == (False, [1, 2, 3, 4])
