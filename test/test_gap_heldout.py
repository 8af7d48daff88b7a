"""Unseen experiments: recordings foretold by the others, one size for all of them or another in each."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from gyro_calib.gap.column import Column
from gyro_calib.gap.diagnose import _not_of_its_form
from gyro_calib.gap.heldout import Shrinkage, _closed, _Unseen, halves, halves_disagree, shrinkage, shrinkage_of_halves
from gyro_calib.gap.model import CampaignModel
from gyro_calib.gap.screen import Candidate, Screener
from gyro_calib.gap.select import Selection
from gyro_calib.gap.system import Whitener, solve

ROWS, COUNT, WANDER = 20, 8, 2.0


def toy(sizes: np.ndarray, seed: int, share: float = 1.0, shown: int = COUNT) -> tuple[CampaignModel, Candidate]:
    """Recordings of a constant and an effect, whose size may be another in each, and whose form only the first are believed to show.

    Each has a wander, smaller than its prior by ``share``.
    """
    rng = np.random.default_rng(seed)
    shapes = [np.linspace(-1.0, 1.0, ROWS) ** (1 + k % 3) for k in range(COUNT)]
    noise = rng.standard_normal((COUNT, ROWS)) + 1j * rng.standard_normal((COUNT, ROWS))
    recording = SimpleNamespace(
        command=SimpleNamespace(setpoints=SimpleNamespace(amplitude_v=1.0), excitation=SimpleNamespace(kind="none")),
        label="one",
        duration_s=1.0,
        truth=None,
        rate_rad_s=None,
    )
    signals = SimpleNamespace(pick=np.ones((4, 2), dtype=complex))
    signal = SimpleNamespace(lhs=np.zeros(ROWS, dtype=complex))
    evidence = [
        SimpleNamespace(role="ftr_x", recording=recording, signal=signal, signals=signals, is_wave=False, is_warming=False) for _ in shapes
    ]
    wander = np.sin(np.arange(ROWS)) + 0j
    nuisances = (
        Column("one", tuple(np.ones(ROWS, dtype=complex) for _ in shapes), (), math.inf),
        *(Column(f"wander_{k}", tuple(wander * (j == k) for j in range(COUNT)), (), WANDER) for k in range(COUNT)),
    )
    whitener = Whitener(tuple((np.eye(ROWS), np.eye(ROWS)) for _ in shapes))
    drawn = share * WANDER * rng.standard_normal(COUNT)
    target = [s * x + n + w * wander for s, x, n, w in zip(sizes, shapes, noise, drawn, strict=True)]
    linear = SimpleNamespace(angular_gain=0.4)
    model = fitted_with(SimpleNamespace(evidence=evidence, linear=linear, whitener=whitener, target=target), nuisances)
    effect = Candidate(
        "drive_nonlinearity",
        {},
        (Column("d_x", tuple((k < shown) * x.astype(complex) for k, x in enumerate(shapes)), ()),),
        np.array([10.0]),
    )
    return model, effect


def fitted_with(parts: object, nuisances: tuple[Column, ...]) -> CampaignModel:
    """A campaign with other nuisances."""
    model = SimpleNamespace(**{**vars(parts), "nuisances": nuisances})
    model.screener = Screener(model.whitener, nuisances, model.target)
    model.fitted = partial(CampaignModel.fitted, cast(CampaignModel, model))
    model.base = model.fitted([])
    return cast(CampaignModel, model)


def foretold(model: CampaignModel, columns: list[Column], k: int) -> float:
    """Chi-square of a recording, given the others, by two fits."""

    def left(members: list[int]) -> float:
        kept = [Column(c.name, tuple(c.signal[j] for j in members), (), c.prior_sd) for c in columns]
        kept = [c for c in kept if any(np.abs(x).max() > 0.0 for x in c.signal)]
        factors = tuple(model.whitener.factors[j] for j in members)
        return Screener(Whitener(factors), kept, [model.target[j] for j in members]).chi2

    return left(list(range(COUNT))) - left([j for j in range(COUNT) if j != k])


@pytest.mark.parametrize("k", [0, 5])
def test_one_factorisation_foretells_what_two_fits_do(k: int) -> None:
    model, _ = toy(np.full(COUNT, 3.0), k)
    missed = _Unseen(model, []).held_out([k]).missed
    assert missed @ missed == pytest.approx(foretold(model, list(model.nuisances), k), rel=1e-9)


def test_sizes_that_the_others_tell_are_those_of_a_fit_without_the_recording() -> None:
    model, effect = toy(np.arange(COUNT) + 1.0, 2)
    members = list(range(1, COUNT))
    columns = [Column("d", tuple(effect.columns[0].signal[j] for j in members), (), float(effect.prior_sd[0]))]
    columns += [Column(c.name, tuple(c.signal[j] for j in members), (), c.prior_sd) for c in model.nuisances]
    columns = [c for c in columns if any(np.abs(x).max() > 0.0 for x in c.signal)]
    whitener = Whitener(tuple(model.whitener.factors[j] for j in members))
    fit = solve(columns, whitener.design(columns, len(members)), whitener.rows([model.target[j] for j in members]))
    unseen = _Unseen(model, [effect])
    sizes, covariance = unseen.told(unseen.held_out([0]))
    assert sizes[0] / math.sqrt(covariance[0, 0]) == pytest.approx(fit.values[0] / math.sqrt(fit.covariance[0, 0]), rel=1e-9)


@pytest.mark.parametrize("share", [1.0, 0.0])
def test_a_healthy_device_is_foretold_to_its_noise(share: float) -> None:
    """Whether its constants are as large as they may be or not: where they are not, less than one for every figure is expected."""
    found = [shrinkage(toy(np.zeros(COUNT), seed, share)[0], []) for seed in range(60)]
    assert float(np.mean([s.before for s in found])) == pytest.approx(1.0, abs=0.02)
    assert all(s.closed == 0.0 and s.after == s.before for s in found)


@pytest.mark.parametrize("told", [shrinkage, shrinkage_of_halves])
def test_an_effect_of_one_size_closes_the_gap(told: Callable[[CampaignModel, list[Candidate]], Shrinkage]) -> None:
    found = [told(*listed(toy(np.full(COUNT, 1.0), seed))) for seed in range(30)]
    assert all(s.after < s.before and s.closed <= 1.0 for s in found)
    assert float(np.mean([s.closed for s in found])) > 0.8
    assert min((s.closed - 1.0) / s.closed_sd for s in found) > -4.0
    # the others tell it well
    assert float(np.mean([s.told for s in found])) == pytest.approx(float(np.mean([s.closed for s in found])), abs=0.1)
    assert min((s.told - 1.0) / s.told_sd for s in found) > -4.0


def test_an_effect_of_another_size_in_each_recording_does_not() -> None:
    found = [shrinkage(*listed(toy(3.0 * np.array([1, 1, -1, -1, 1, 1, -1, -1]), seed))) for seed in range(10)]
    assert all(s.closed < 0.2 for s in found)


def test_what_a_healthy_device_has_as_well_is_its_nuisance_no_longer() -> None:
    """A nuisance of the effect's own kind would take the gap of every recording at the cost of its prior alone."""
    model, effect = toy(np.full(COUNT, 3.0), 4)
    own = Column("drive_nonlinearity.d_x", effect.columns[0].signal, (), 0.1)
    without, beside = shrinkage(model, [effect]), shrinkage(fitted_with(model, (*model.nuisances, own)), [effect])
    assert (beside.before, beside.after) == pytest.approx((without.before, without.after))


@pytest.mark.parametrize(("prior_sd", "closes"), [(0.1, True), (10.0, False)])
def test_nor_is_one_that_without_the_effect_is_far_beyond_a_healthy_device_s(prior_sd: float, closes: bool) -> None:
    """Of any name; one that is as large as it may be is a nuisance, and the effect then closes nothing that it does not."""
    model, effect = toy(np.full(COUNT, 3.0), 4)
    alike = Column("rate_mismatch_im", effect.columns[0].signal, (), prior_sd)
    beside = shrinkage(fitted_with(model, (*model.nuisances, alike)), [effect])
    without = shrinkage(model, [effect])
    if closes:
        assert (beside.before, beside.after) == pytest.approx((without.before, without.after), rel=0.01)
        assert beside.closed > 0.95
    else:
        assert beside.before < 1.2 < without.before


def test_what_only_a_recording_itself_tells_is_not_foretold() -> None:
    """With a nuisance for every equation of each recording nothing is missed, and no noise is expected either."""
    model, effect = toy(np.full(COUNT, 3.0), 1)
    zero = np.zeros(ROWS, dtype=complex)
    own = tuple(
        Column(f"own_{k}_{j}_{f}", tuple(f * np.eye(ROWS)[j] if i == k else zero for i in range(COUNT)), (), math.inf)
        for k in range(COUNT)
        for j in range(ROWS)
        for f in (1.0 + 0j, 1j)
    )
    shrunk = shrinkage(fitted_with(model, own), [effect])
    assert shrunk.dof == 0
    assert (shrunk.before, shrunk.after, shrunk.closed) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


def test_a_noise_that_is_believed_too_large_hides_no_wrong_size() -> None:
    """Of 100 that are there, an effect of twice the size takes none away; chi-square is 300 below its expectation."""
    closed, _ = _closed(gain=0.0, foretold=400.0, left=100.0 - 300.0, noise=1300.0)
    assert closed == 0.0
    assert _closed(gain=400.0, foretold=400.0, left=-300.0, noise=1300.0)[0] == 1.0
    assert _closed(gain=300.0, foretold=400.0, left=100.0, noise=1300.0)[0] == pytest.approx(0.75)


def listed(of: tuple[CampaignModel, Candidate]) -> tuple[CampaignModel, list[Candidate]]:
    return of[0], [of[1]]


def test_both_halves_hold_an_open_drive_of_each_axis_at_two_distances() -> None:
    """As a file has them: x and y by turns, so that one half had all of x and the other all of y."""
    model, _ = toy(np.zeros(COUNT), 0)
    for k, r in enumerate(model.evidence):
        excitation = SimpleNamespace(kind="drive", axis="xy"[k % 2])
        command = SimpleNamespace(setpoints=SimpleNamespace(amplitude_v=0.0), excitation=excitation)
        r.role, r.recording = f"open at {15000 + 20 * (k // 2)} Hz", SimpleNamespace(command=command)  # type: ignore[misc,assignment]
    for half in halves(model):
        assert sorted("xy"[k % 2] for k in half) == ["x", "x", "y", "y"]


def test_halves_of_one_size_disagree_by_chance_alone() -> None:
    found = [halves_disagree(model, [effect]) for model, effect in (toy(np.full(COUNT, 3.0), seed) for seed in range(200))]
    assert sum(found) <= 2  # 0.2 are expected


@pytest.mark.parametrize("seed", range(3))
def test_halves_of_different_sizes_disagree(seed: int) -> None:
    sides = halves(toy(np.zeros(COUNT), 0)[0])
    sizes = np.zeros(COUNT)
    sizes[sides[0]] = 4.0
    model, effect = toy(sizes, seed)
    assert halves_disagree(model, [effect])


@pytest.mark.parametrize("seed", range(3))
def test_a_half_that_does_not_show_an_effect_does_not_disagree(seed: int) -> None:
    """It was surprised by a size of four times what is believed: a rate's asymmetry that the one recording on a table shows."""
    model, effect = toy(np.array([45.0, *np.zeros(COUNT - 1)]), seed, shown=1)
    assert not halves_disagree(model, [effect])


def test_others_do_not_guess_at_a_size_that_they_cannot_tell() -> None:
    """Beforehand a size is of the order that all experiments say: no matter where it is well told, all where it is not."""
    spread: dict[tuple[bool, bool], float] = {}
    for alone in (False, True):
        found: dict[bool, list[float]] = {}
        for seed in range(100):
            model, effect = toy(np.full(COUNT, 2.0) * (np.arange(COUNT) == 0 if alone else 1.0), seed)
            if alone:
                shown = tuple((1.0 if k == 0 else 0.01) * x for k, x in enumerate(effect.columns[0].signal))
                effect = Candidate(effect.name, {}, (Column("d_x", shown, ()),), effect.prior_sd)
            unseen = _Unseen(model, [effect])
            out = unseen.held_out([0])
            for order in (None, unseen._order):
                found.setdefault(order is not None, []).append(float(unseen.told(out, order)[0][0]))
        spread |= {(alone, known): float(np.std(values)) for known, values in found.items()}
    assert spread[False, True] == pytest.approx(spread[False, False], rel=0.1)
    assert spread[True, True] < 0.5 * spread[True, False]


@pytest.mark.parametrize(
    ("closed", "left", "unknown"),
    [(0.95, 1300.0, False), (0.95, 1800.0, False), (0.31, 1300.0, False), (0.31, 1800.0, True), (-0.2, 1800.0, True)],
)
def test_what_leaves_most_of_unseen_experiments_is_not_of_its_form(closed: float, left: float, unknown: bool) -> None:
    """Effects that cancel explain what they are fitted to: unseen experiments, and what is left of all, tell."""
    model, effect = toy(np.full(COUNT, 3.0), 0)
    found = SimpleNamespace(name=effect.name, candidate=effect, gain=900.0)
    selection = SimpleNamespace(effects=(found,), chi2_after=left, dof=1300)
    shrunk = Shrinkage(before=3.0, after=3.0 - 2.0 * closed, dof=1300, closed=closed, closed_sd=0.03)
    said = _not_of_its_form(model, cast(Selection, selection), shrunk)
    assert (said is not None) == unknown
    if said is not None:
        assert (said.nearest, said.depends_on) == ("drive_nonlinearity", "experiment")


@pytest.mark.parametrize(
    ("surprise", "closed", "dof", "more"),
    [(1.51, 0.955, 1300, True), (0.96, 0.12, 1300, False), (3.1, 0.996, 1300, False), (1.5, 0.8, 40, False)],
)
def test_effects_that_imitate_what_none_of_them_is_leave_more_than_noise(surprise: float, closed: float, dof: int, more: bool) -> None:
    """Three, of a warming front end; but what one recording alone tells is foretold by no others, and first order leaves a share."""
    assert Shrinkage(9.0, 2.0, dof, closed, 0.001, surprise=surprise).leaves_more is more


def test_an_effect_that_one_recording_alone_tells_surprises_nobody() -> None:
    """The others foretell nothing of it, so all of it is left there, and they leave its size open; one that they know does surprise."""
    once = np.zeros(COUNT)
    once[0] = 40.0
    model, effect = toy(once, 0, shown=1)
    told = shrinkage(model, [effect])
    assert told.after > 2.0
    assert told.surprise < 1.3
    assert told.told_sd > 0.5  # of nothing that is foretold no share is closed
    model, effect = toy(once, 0)
    assert shrinkage(model, [effect]).surprise > 2.0


def test_what_one_recording_alone_tells_leaves_the_share_of_what_the_others_tell() -> None:
    """An effect that all show, and one of a warm recording: 20 % of a gap of which the others told all that they could."""
    model, effect = toy(np.full(COUNT, 3.0), 1)
    course = np.cos(1.7 * np.arange(ROWS)) + 0j
    warm = Column("c", tuple(course * (k == 0) for k in range(COUNT)), ())
    own = Candidate("thermal_damping_lag", {}, (warm,), np.array([10.0]))
    heated = [t + 30.0 * x for t, x in zip(model.target, warm.signal, strict=True)]
    parts = SimpleNamespace(evidence=model.evidence, linear=model.linear, whitener=model.whitener, target=heated)
    shrunk = shrinkage(fitted_with(parts, model.nuisances), [effect, own])
    assert shrunk.closed < 0.6
    assert shrunk.told > 0.9
    assert shrunk.told_sd < 0.1
    assert shrunk.rms_surprise < 1.2 < math.sqrt(shrunk.after)
