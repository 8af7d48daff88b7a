"""Halves of a campaign: one size for all experiments, or another in each."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from gyro_calib.gap.columns import Column
from gyro_calib.gap.diagnose import _not_of_its_form, _probabilities
from gyro_calib.gap.heldout import Shrinkage, _Part, halves, halves_disagree
from gyro_calib.gap.model import CampaignModel
from gyro_calib.gap.screen import Candidate
from gyro_calib.gap.select import Selection
from gyro_calib.gap.spectral_effects import SpectralEffects
from gyro_calib.gap.system import Whitener

ROWS, COUNT = 20, 8


def toy(sizes: np.ndarray, seed: int) -> tuple[CampaignModel, Candidate]:
    """Recordings of a constant and an effect, whose size may be another in each."""
    rng = np.random.default_rng(seed)
    shapes = [np.linspace(-1.0, 1.0, ROWS) ** (1 + k % 3) for k in range(COUNT)]
    noise = rng.standard_normal((COUNT, ROWS)) + 1j * rng.standard_normal((COUNT, ROWS))
    setpoints = SimpleNamespace(amplitude_v=1.0)
    recording = SimpleNamespace(command=SimpleNamespace(setpoints=setpoints))
    one = Column("one", tuple(np.ones(ROWS, dtype=complex) for _ in shapes), (), math.inf)
    model = SimpleNamespace(
        evidence=[SimpleNamespace(role="ftr_x", recording=recording) for _ in shapes],
        whitener=Whitener(tuple((np.eye(ROWS), np.eye(ROWS)) for _ in shapes)),
        nuisances=(one,),
        target=[s * x + n for s, x, n in zip(sizes, shapes, noise, strict=True)],
    )
    effect = Candidate("drive_nonlinearity", {}, (Column("d_x", tuple(x.astype(complex) for x in shapes), ()),), np.array([10.0]))
    return cast(CampaignModel, model), effect


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


def test_a_half_does_not_guess_at_a_size_that_it_cannot_tell() -> None:
    """Beforehand a size is of the order that all experiments say: no matter where it is well told, all where it is not."""
    found: dict[tuple[str, bool], list[float]] = {}
    for seed in range(100):
        model, strong = toy(np.full(COUNT, 2.0), seed)
        weak = Candidate(strong.name, {}, (Column("d_x", tuple(0.03 * x for x in strong.columns[0].signal), ()),), strong.prior_sd)
        part = _Part(model, halves(model)[0])
        for name, candidate in (("strong", strong), ("weak", weak)):
            for order in (None, np.array([2.0])):
                found.setdefault((name, order is not None), []).append(float(part.told([candidate], order)[0][0]))
    spread = {key: float(np.std(values)) for key, values in found.items()}
    assert spread["strong", True] == pytest.approx(spread["strong", False], rel=0.1)
    assert spread["weak", True] < 0.5 * spread["weak", False]


@pytest.mark.parametrize(
    ("closed", "left", "unknown"),
    [(0.95, 1300.0, False), (0.95, 1800.0, False), (0.31, 1300.0, False), (0.31, 1800.0, True), (-0.2, 1800.0, True)],
)
def test_what_leaves_most_of_unseen_experiments_is_not_of_its_form(closed: float, left: float, unknown: bool) -> None:
    """Effects that cancel explain what they are fitted to: unseen experiments, and what is left of all, tell."""
    model, effect = toy(np.full(COUNT, 3.0), 0)
    found = SimpleNamespace(name=effect.name, candidate=effect, gain=900.0)
    selection = SimpleNamespace(effects=(found,), chi2_after=left, dof=1300)
    shrunk = Shrinkage(before=3.0, after=3.0 - 2.0 * closed, dof=1300, closed=closed, closed_sd=0.03, labels=())
    said = _not_of_its_form(model, cast(Selection, selection), shrunk)
    assert (said is not None) == unknown
    if said is not None:
        assert (said.nearest, said.depends_on) == ("drive_nonlinearity", "experiment")


def test_none_is_believed_no_more_than_trials_allow() -> None:
    """Of what is there a sixth is not seen: no campaign makes a healthy device certain."""
    nothing = SimpleNamespace(effects=(), probabilities=(), screened={"duffing": SimpleNamespace(log_evidence=-9.0)})
    doubtful = SimpleNamespace(effects=(), probabilities=(), screened={"duffing": SimpleNamespace(log_evidence=7.0)})
    beside = SpectralEffects((), (), None, 0.0)
    (sure, unnamed), (unsure, _) = (_probabilities(cast(Selection, s), beside, None) for s in (nothing, doubtful))
    assert 0.8 < sure < 0.87
    assert 0.05 < unnamed < 1.0 - sure
    assert unsure < 0.3
