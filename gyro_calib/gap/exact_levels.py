"""Limits and dead zones of the drive without linearising: the drive that acts in place of the one that is recorded, for every level.

A drive that clips hard bends G so much that a correction of first order about the bent G does not recognise it. Here each level is tried as
what it is, by another drive in the columns of G, and the linear device comes out of the same fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .columns import Column
from .forms import FORMS
from .linear_device import linear_of
from .model import CampaignModel
from .parts import Linear
from .system import solve

__all__ = ["ExactLevel", "best_exact_level"]

ComplexArray = NDArray[np.complex128]
_EFFECTS = ("drive_saturation", "drive_dead_zone")
#: relative steps by which the best level of the grid is refined
_FINER = (0.2, 0.1, 0.1, 0.05, 0.05, 0.025, 0.025, 0.012, 0.006, 0.003)


@dataclass(frozen=True)
class ExactLevel:
    """A level with the linear device about which it was found, and the chi-square that it leaves."""

    name: str
    level: float
    linear: Linear
    chi2: float


def best_exact_level(model: CampaignModel) -> ExactLevel | None:
    """The effect and level that leave least; nothing when no level was tried."""
    found = [_exact(model, name, float(candidate.setting["level"])) for name in _EFFECTS for candidate in model.candidates.get(name, ())]
    if not found:
        return None
    best = min(found, key=lambda e: e.chi2)
    for width in _FINER:
        best = min([best, *(_exact(model, best.name, best.level * factor) for factor in (1.0 - width, 1.0 + width))], key=lambda e: e.chi2)
    return best


def _exact(model: CampaignModel, name: str, level: float) -> ExactLevel:
    extra = _extra_drive(model, name, level)
    columns = [_with(c, extra) for c in model.nuisances]
    count = len(model.evidence)
    solution = solve(columns, model.whitener.design(columns, count), model.whitener.rows(model.target))
    linear = linear_of(model.evidence, solution.by_name(), model.linear.angular_gain)
    return ExactLevel(name, level, linear, solution.chi2)


def _extra_drive(model: CampaignModel, name: str, level: float) -> dict[str, list[ComplexArray]]:
    """What the acting drive adds to the regressors of G, by entry and recording."""
    extra: dict[str, list[ComplexArray]] = {}
    for r in model.evidence:
        change = next(p.signal for p in FORMS[name].parts(r.signals, model.linear, {"level": level}))
        x = np.zeros((change.shape[0], 4, 2), dtype=complex)
        for a in range(2):
            for b in range(2):
                x[:, 2 * a + b, a] = change[:, b]
        for place, column in zip(("xx", "xy", "yx", "yy"), r.signal_forms.plain(x).T, strict=True):
            extra.setdefault(place, []).append(r.turn * column)
    return extra


def _with(c: Column, extra: dict[str, list[ComplexArray]]) -> Column:
    if not c.name.startswith("G_"):
        return c
    _, place, part = c.name.split("_")
    factor = 1.0 if part == "re" else 1j
    return Column(c.name, _summed(c.signal, extra[place], factor), c.quiet, c.prior_sd)


def _summed(base: Sequence[ComplexArray], extra: Sequence[ComplexArray], factor: complex) -> tuple[ComplexArray, ...]:
    return tuple(v + factor * e for v, e in zip(base, extra, strict=True))
