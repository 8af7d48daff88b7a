"""Limits and dead zones of the drive without linearising: the drive that acts in place of the one that is recorded, for every level.

A drive that clips hard bends G so much that a correction of first order about the bent G does not recognise it. Here each level is tried as
what it is, by another drive in the columns of G, and the linear device comes out of the same fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .column import Column
from .forms import FORMS
from .linear_device import linear_of
from .model import CampaignModel
from .parts import Linear
from .screen import Screener
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
    rest = Screener(model.whitener, [c for c in model.nuisances if not _is_gain(c)], model.target)
    candidates = [(name, c) for name in _EFFECTS for c in model.candidates.get(name, ()) if "level" in c.setting]
    tried = [(name, float(c.setting["level"])) for name, c in candidates]
    if not tried:
        return None
    least, (name, level) = min((_left(model, rest, *at), at) for at in tried)
    for width in _FINER:
        for near in (level * (1.0 - width), level * (1.0 + width)):
            if (left := _left(model, rest, name, near)) < least:
                least, level = left, near
    return _exact(model, name, level)


def _left(model: CampaignModel, rest: Screener, name: str, level: float) -> float:
    """Chi-square that the linear device leaves behind such a drive: all columns but those of G stay as they are."""
    extra = _extra_drive(model, name, level)
    gains, _ = rest.projected([_with(c, extra) for c in model.nuisances if _is_gain(c)])
    values = np.linalg.lstsq(gains, rest.left, rcond=None)[0]
    left = rest.left - gains @ values
    return float(left @ left)


def _exact(model: CampaignModel, name: str, level: float) -> ExactLevel:
    extra = _extra_drive(model, name, level)
    columns = [_with(c, extra) for c in model.nuisances]
    solution = solve(columns, model.whitener.design(columns, len(model.evidence)), model.whitener.rows(model.target))
    linear = linear_of(model.evidence, solution.by_name(), model.linear.angular_gain, model.linear.followed)
    return ExactLevel(name, level, linear, solution.chi2)


def _extra_drive(model: CampaignModel, name: str, level: float) -> dict[str, list[ComplexArray]]:
    """What the acting drive adds to the regressors of G, by entry and recording."""
    extra: dict[str, list[ComplexArray]] = {}
    for r in model.evidence:
        change = next(p.signal for p in FORMS[name].parts(r.signals, model.linear, {"level": level}))
        # entry (a, b) of G takes the drive of axis b to axis a
        entries = [change[:, b, None] * np.eye(2)[a] for a in range(2) for b in range(2)]
        for place, column in zip(("xx", "xy", "yx", "yy"), r.signal_forms.plain(entries).T, strict=True):
            extra.setdefault(place, []).append(r.turn * column)
    return extra


def _is_gain(c: Column) -> bool:
    return c.name.startswith("G_")


def _with(c: Column, extra: dict[str, list[ComplexArray]]) -> Column:
    if not _is_gain(c):
        return c
    _, place, part = c.name.split("_")
    factor = 1.0 if part == "re" else 1j
    return Column(c.name, _summed(c.signal, extra[place], factor), c.quiet, c.prior_sd)


def _summed(base: Sequence[ComplexArray], extra: Sequence[ComplexArray], factor: complex) -> tuple[ComplexArray, ...]:
    return tuple(v + factor * e for v, e in zip(base, extra, strict=True))
