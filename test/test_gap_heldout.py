"""Halves of a campaign: one size for all experiments, or another in each."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from gyro_calib.gap.columns import Column
from gyro_calib.gap.heldout import _Part, halves, halves_disagree
from gyro_calib.gap.model import CampaignModel
from gyro_calib.gap.screen import Candidate
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
