"""What drifts slower than a record, and where the resonance lies while it is read: two things that passed for effects."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from unittest import mock

import numpy as np
import pytest

from gyro_calib.device import draw_unit, load_device
from gyro_calib.experiments import SimulatedInstrument, gap_ftr_plan, gap_whole_angle_plan, run_plan
from gyro_calib.gap.column import Column
from gyro_calib.gap.floors import beat_their_floors, hidden_by_floors, louder_floors
from gyro_calib.gap.model import CampaignModel, look_at
from gyro_calib.gap.one_recording import told_by_several
from gyro_calib.gap.relinearise import relinearised
from gyro_calib.gap.screen import Screener
from gyro_calib.gap.select import select_effects
from gyro_calib.gap.sizes import _SIZES, _likelihood, _scores, gained_by_resizing, gained_by_sizing, measured_shares, with_shares
from gyro_calib.gap.slow import drift_family, slow_drifts
from gyro_calib.gap.system import Solution
from gyro_calib.recording.recording import Campaign
from gyro_calib.simulation import GyroSimulator
from gyro_calib.trial.injected import with_columns
from gyro_calib.trial.plans import campaign_plan
from gyro_calib.trial.plant import record_unit
from gyro_calib.trial.trial import _look
from gyro_calib.trial.units import draw_trial_unit


def solution(sizes: dict[str, float], rng: np.random.Generator) -> Solution:
    """Coefficients as a fit gives them that allows for drifts of unit size: flicker of the sizes that are given, known to a hundredth."""
    columns, values = [], []
    for family, size in sizes.items():
        for axis in "xy":
            for k in range(1, 9):
                columns.append(Column(f"drift.{family}.{axis}.{k}", (), (), 1.0 / math.sqrt(k)))
                values.append(size / math.sqrt(k) * rng.standard_normal() + 0.01 * rng.standard_normal())
    covariance = np.diag(np.full(len(columns), 1e-4))
    return Solution(tuple(columns), np.array(values), covariance, np.zeros(1), 0.0, np.zeros((1, 1)))


def test_the_size_of_a_drift_is_measured_family_by_family() -> None:
    truth = {"gain": 0.2, "strayc": 0.03}
    found = [measured_shares(solution(truth, np.random.default_rng(seed)), drift_family) for seed in range(40)]
    for family, size in truth.items():
        # sixteen coefficients tell a size to a fifth
        assert np.exp(np.mean([math.log(f[family]) for f in found])) == pytest.approx(size, rel=0.25)


def test_what_does_not_drift_is_not_allowed_to() -> None:
    found = [measured_shares(solution({"gain": 0.0}, np.random.default_rng(seed)), drift_family)["gain"] for seed in range(20)]
    assert np.median(found) < 0.01
    columns = solution({"gain": 0.0}, np.random.default_rng(0)).columns
    assert all(c.prior_sd < 0.01 for c in with_shares(columns, drift_family, {"gain": float(np.median(found))}))


def test_a_size_is_measured_through_coefficients_that_are_badly_told() -> None:
    """Fifty wanders of 0.01, each told to 0.1: their mean square says 0.1, and a prior of that size would hide a shift of 0.05."""
    rng = np.random.default_rng(7)
    columns = [Column(f"shift_{k}", (), (), 1.0) for k in range(50)]
    told_sd = np.where(np.arange(50) < 25, 0.1, 0.004)
    values = 0.01 * rng.standard_normal(50) + told_sd * rng.standard_normal(50)
    found = Solution(tuple(columns), values, np.diag(told_sd**2), np.zeros(1), 0.0, np.zeros((1, 1)))
    assert measured_shares(found, lambda c: c.name.split("_")[0])["shift"] == pytest.approx(0.01, rel=0.3)


def test_what_sizing_gains_is_right_of_what_is_known_to_a_millionth() -> None:
    """Distances of a resonance without a wander of its own: each told to 5e-6 of its prior, but for what a drift makes of all of them.

    A hundredth of that variance more, against rounding, was 50 000 in log likelihood: a Duffing of 9000 was a heat of the wave.
    """
    rng = np.random.default_rng(3)
    noise, size, common = 5e-6, 0.01, np.ones(30) / math.sqrt(30.0)
    told = size * rng.standard_normal(30) + noise * rng.standard_normal(30)
    # as the data tell them: nothing of their mean
    data = (np.eye(30) - np.outer(common, common)) / noise**2
    covariance = np.linalg.inv(data + np.eye(30))
    columns = tuple(Column(f"shift_{k}", (), (), 1.0) for k in range(30))
    found = Solution(columns, covariance @ (data @ told), covariance, np.zeros(1), 0.0, np.zeros((1, 1)))
    apart = told - common * (common @ told)
    variance = noise**2 + _SIZES**2
    each = 0.5 * (apart @ apart) * (1.0 / noise**2 - 1.0 / variance) - 0.5 * 29 * np.log(variance / noise**2)
    assert gained_by_sizing(found, lambda c: c.name.split("_")[0]) == pytest.approx(float(each.max()), rel=2e-6)


def test_a_louder_floor_is_as_good_as_a_line_of_its_own_kind_but_no_better_than_a_drift() -> None:
    """Sixteen coefficients three times as large are a floor of that size; where two move alone it pays for the fourteen others."""
    small = 0.02
    gained, paid = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        gained.append(gained_by_resizing(solution({"gain": 3.0 * small}, rng), drift_family, {"gain": small}))
        still = solution({"gain": small}, rng)
        assert gained_by_resizing(still, drift_family, {"gain": small}) < 8.0
        values = still.values.copy()
        first = [k for k, c in enumerate(still.columns) if c.name.endswith(".1")]
        values[first] = 12.0 * math.hypot(small, 0.01)
        line = 0.5 * len(first) * 12.0**2
        paid.append(line - gained_by_resizing(replace(still, values=values), drift_family, {"gain": small}))
    # 16/2 (r - 1 - ln r) for variances r times as large, about five with what each is told to
    assert np.median(gained) > 12.0
    assert min(paid) > 10.0


def test_a_floor_is_not_ten_times_what_it_was_measured_to_be() -> None:
    """A drift of one drive's gain passed for floors nine and four times as large, the drift of none."""
    capped, free = [], []
    for seed in range(10):
        found = solution({"gain": 0.05}, np.random.default_rng(seed))
        capped.append(gained_by_resizing(found, drift_family, {"gain": 0.005}))
        with mock.patch("gyro_calib.gap.sizes._MOST_TOO_SMALL", math.inf):
            free.append(gained_by_resizing(found, drift_family, {"gain": 0.005}))
    assert np.all(np.array(capped) > 0.0)
    assert np.median(np.array(capped) / free) < 0.8


@pytest.mark.slow
def test_a_wave_that_turns_meets_what_stands_still_in_the_case() -> None:
    """1/f volts of the drives: in turned records they are at the turning line, where no repeat of a mean tells how large they are."""
    base = draw_unit(load_device("hrg_hardware"), 5)
    device = replace(base, noise=replace(base.noise, drive_flicker_v=3e-6))
    instrument = SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(3), fidelity="carrier"), 2e-5)
    campaign = run_plan(instrument, gap_whole_angle_plan(device.factory(), quality="quick"))
    f = campaign.factory
    model = look_at(list(campaign), math.pi * f["nominal_f0_hz"] / f["nominal_q"], f["angular_gain_kappa"])
    turned = {r.index for r in model.evidence if r.is_wave and r.signal.turn_rad > math.pi}
    own = [c for c in model.nuisances if ".of_" in c.name]
    assert turned
    assert {int(c.name.rpartition("_")[2]) for c in own} == turned
    assert {drift_family(c) for c in own} == {"strayc", "strays", "gain", "phase"}
    # each concerns its recording alone
    for c in own:
        assert [k for k, v in enumerate(c.signal) if np.any(v)] == [int(c.name.rpartition("_")[2])]
    largest = max(abs(model.base.by_name()[c.name]) / c.prior_sd for c in own if drift_family(c) == "strays")
    assert 1.0 < largest < 4.0


@pytest.mark.slow
def test_a_pickoff_gain_that_follows_the_temperature_is_read_at_the_resonance_of_the_moment() -> None:
    """Its share is multiplied by all of the detuning: with the slope alone chi-square was a hundred times its degrees of freedom."""
    truth = {"g_x": 2.0e-3, "g_y": -1.0e-3}
    base = draw_unit(load_device("ring_15k"), 5)
    device = replace(base, effects={"thermal_pickoff_gain": truth}, pickoff=replace(base.pickoff, gain_tempco_per_k=0.0))
    instrument = SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(3), fidelity="carrier"), 2e-5)
    campaign = run_plan(instrument, gap_ftr_plan(device.factory(), quality="quick", abilities=SimulatedInstrument.abilities))
    factory = campaign.factory
    model = look_at(list(campaign), math.pi * factory["nominal_f0_hz"] / factory["nominal_q"], factory["angular_gain_kappa"])
    chosen = relinearised(model, [model.candidates["thermal_pickoff_gain"][0]])
    fit = model.fitted(chosen)
    assert fit.chi2 < 1.3 * fit.residual.size
    for name, value in truth.items():
        k = next(k for k, c in enumerate(fit.columns) if c.name == f"thermal_pickoff_gain.{name}")
        assert fit.values[k] == pytest.approx(value, abs=4.0 * math.sqrt(fit.covariance[k, k]) + 0.02 * abs(value))


@pytest.mark.slow
def test_a_wander_that_takes_minutes_is_no_course_of_the_frequency() -> None:
    """Shifts of records alone, each by itself, leave what a trial's ring does with its millikelvins to whatever goes with time."""
    unit, rng = draw_trial_unit("ring", 3701, 14), np.random.default_rng(1)
    model = _look(record_unit(unit, campaign_plan("ring", unit.device.factory(), rng, "quick"), {}, rng))
    slow = [c for c in model.nuisances if drift_family(c) == "frequency"]
    values = np.array([model.base.by_name()[c.name] for c in slow])
    assert len(slow) == 8
    assert 0.2 < np.sqrt(np.mean((values / [c.prior_sd for c in slow]) ** 2)) < 2.0
    without = Screener(model.whitener, [c for c in model.nuisances if c not in slow], model.target)
    assert without.chi2 > model.screener.chi2 + 10.0
    for name in ("frequency_ageing", "thermal_lag", "charge_accumulation"):
        assert max(s.log_evidence for s in model.screener.screened(model.candidates[name])) < 5.0


def with_quadrature_floor(campaign: Campaign, model: CampaignModel, size: float) -> Campaign:
    """The recordings of a device whose split has a 1/f floor, of so much of the decay: its drives hold less against it."""
    rng, k = np.random.default_rng(0), np.arange(1, 9)
    sizes = size * model.evidence.decay_rate * rng.standard_normal((2, k.size)) / np.sqrt(k)
    start = min(r.t[0] for r in campaign)
    span_s, inverse = max(r.t[-1] for r in campaign) - start, np.linalg.inv(model.linear.G).T
    out = []
    for r in campaign:
        along, across = sizes @ np.cos(k[:, None] * np.pi * (r.t - start) / span_s)
        x = r.pick - r.drive @ model.linear.E.T
        volts = 1j * (along[:, None] * x * [1, -1] + across[:, None] * x[:, ::-1]) @ inverse
        data = r.data.copy()
        data[:, 6:10:2] -= volts.real
        data[:, 7:11:2] -= volts.imag
        out.append(r if r.command.mode == "loops_off" else replace(r, data=data))
    return replace(campaign, recordings=tuple(out))


@cache
def floored() -> CampaignModel:
    """Of a healthy hemisphere."""
    unit, rng = draw_trial_unit("hemisphere", 79, 1), np.random.default_rng(1)
    campaign = record_unit(unit, campaign_plan("hemisphere", unit.device.factory(), rng, "quick"), {}, rng)
    return _look(with_quadrature_floor(campaign, _look(campaign), 1e-5))


@pytest.mark.slow
def test_a_floor_of_the_quadrature_is_no_charge_that_leaks() -> None:
    """Without a family of its own it was a charge of log evidence 37, and twice as large something that goes to and fro every 177 s."""
    model = floored()
    selection = select_effects(model)
    assert selection.effects == ()
    assert selection.stranger is None
    slow = [c for c in model.nuisances if drift_family(c) == "split"]
    assert max(abs(model.base.by_name()[c.name]) / c.prior_sd for c in slow) > 1.0


@pytest.mark.slow
def test_what_goes_with_time_must_beat_larger_floors() -> None:
    """A healthy unit's floors are as large as they are; told to be a third of it, what they do would be an effect's."""
    model = floored()
    hushed = replace(
        model, nuisances=tuple(replace(c, prior_sd=c.prior_sd / 3.0) if drift_family(c) == "split" else c for c in model.nuisances)
    )
    drift = next(s for s in model.screener.screened(model.candidates["split_drift"]))
    other = next(s for s in model.screener.screened(model.candidates["duffing"]))
    least, most = louder_floors(model, []), louder_floors(hushed, [])
    assert least + 1.0 < most
    # what larger floors gain beside it as well is no reason against it
    enough = most - louder_floors(hushed, [drift.candidate]) + 6.0
    assert enough < most
    for evidence, beats in ((enough - 1.0, False), (enough + 1.0, True)):
        assert beat_their_floors(hushed, [replace(drift, log_evidence=evidence)]) is beats
    assert beat_their_floors(hushed, [replace(other, log_evidence=0.0)])


@pytest.mark.slow
def test_a_damping_that_grows_is_no_floor_of_damping_that_it_has_made_itself() -> None:
    """Floors as large as all of it seems where nothing else is allowed for leave less than counts."""
    model = floored()
    drifts = [c for c in slow_drifts(model.evidence, model.linear) if drift_family(c)]
    largest = {c.name: c for c in drifts}
    held = [largest.get(c.name, c) if drift_family(c) == "damping" else c for c in model.nuisances]
    tried = [c for name in ("nonlinear_damping", "quadratic_damping", "duffing", "drive_sag") for c in model.candidates[name]]
    assert hidden_by_floors(tried, model.whitener, model.target, held, drifts) == []
    growing = model.candidates["nonlinear_damping"][0]
    known = np.linalg.norm(Screener(model.whitener, model.nuisances, model.target).projected(growing.columns)[0])

    def grown(ratio: float) -> CampaignModel:
        return with_columns(model, [(growing.columns[0], ratio / float(known)), *((c, 0.0) for c in growing.columns[1:])])

    small, large = grown(8.0).target, grown(60.0).target
    hidden = Screener(model.whitener, held, small).screen(growing)
    assert hidden is not None
    assert hidden.log_evidence < 12.0
    found = hidden_by_floors(tried, model.whitener, small, held, drifts)
    assert [c.name for c in found] in (["nonlinear_damping"], ["quadratic_damping"])
    # what floors leave to be seen needs no other floors
    assert hidden_by_floors(tried, model.whitener, large, held, drifts) == []


@pytest.mark.slow
def test_what_one_recording_alone_tells_is_no_drift_and_no_mode() -> None:
    """A first record whose quadrature is another looks like a charge that is soon there; a stiffness that drifts is told by all."""
    unit, rng = draw_trial_unit("ring", 3701, 14), np.random.default_rng(2)
    model = _look(record_unit(unit, campaign_plan("ring", unit.device.factory(), rng, "quick"), {}, rng))
    charge, drift = model.candidates["charge_accumulation"][0], model.candidates["split_drift"][0]
    first = next(k for k, r in enumerate(model.evidence) if r.is_wave)
    column = next(c for c in drift.columns if np.any(c.signal[first]))
    once = replace(column, signal=tuple(v if k == first else 0.0 * v for k, v in enumerate(column.signal)))
    # and a mode of one wave, which may be its noise, like a mode of all of them
    mode = next(c for c in model.candidates["spurious_mode"] if c.setting["separation_hz"] == 2.0)
    rings = mode.columns[0]
    waves = [k for k, r in enumerate(model.evidence) if r.is_wave]
    loudest = max(waves, key=lambda k: float(np.linalg.norm(rings.signal[k])))
    alone = replace(rings, signal=tuple(v if k == loudest else 0.0 * v for k, v in enumerate(rings.signal)))
    for added, candidate, several in ((once, charge, False), (column, drift, True), (alone, mode, False), (rings, mode, True)):
        size = 15.0 / float(np.linalg.norm(model.screener.projected([added])[0]))
        strange = with_columns(model, [(added, size)])
        found = strange.screener.screen(candidate)
        assert found is not None
        assert found.gain > 25.0
        assert told_by_several(strange, found, []) is several


@pytest.mark.parametrize("families", ["a", "abab" * 6, "abc" * 30])
def test_likelihoods_of_all_sizes_at_once_are_those_of_each(families: str) -> None:
    rng = np.random.default_rng(len(families))
    told = rng.normal(size=(len(families), 2 * len(families))) * 10.0 ** rng.uniform(-1.0, 1.5, (len(families), 1))
    data, information = told @ told.T, rng.normal(size=len(families)) * np.linalg.norm(told, axis=1)
    sizes = {name: float(10.0 ** rng.uniform(-2.0, 0.0)) for name in set(families)}
    for name in sizes:
        each = [_likelihood(data, information, list(families), {**sizes, name: float(s)}) for s in _SIZES]
        assert _scores(data, information, list(families), sizes, name) == pytest.approx(each, abs=1e-6)
