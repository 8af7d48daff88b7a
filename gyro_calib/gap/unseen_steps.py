"""Steps of the drives' converter that no raw sample shows: a grid of their sizes, asked where something without a name is there.

What rounding takes from a carrier changes its sign with every step of the amplitude (:mod:`.coarse_drive`), so that of a drive of a dozen
steps the size of one is told to some thousandths, and nothing that bends gently imitates it.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from .coarse_drive import NAME, SHARE, rounded, with_steps
from .columns import forms_columns
from .model import CampaignModel
from .parts import Form, Linear, Part, Setting
from .screen import Candidate, Screened
from .select import Selection
from .signals import Signals
from .spectral_effects import SpectralEffects
from .strangers import MARGIN

__all__ = ["with_unseen_steps"]

FloatArray = NDArray[np.float64]
#: steps over the largest drive that holds a wave: fewer are a dead zone, of more the grid would be too fine
_MOST, _LEAST = 1.0 / 3.0, 1.0 / 60.0
#: phase 2 pi A/q of the series from one size to the next [rad]; noise beside the drive at which sizes are looked for, then tried [steps]
_PHASE, _LOOKED, _NOISE = 0.5, 0.15, (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4)
#: places of the series' table over a step, and how many steps it holds
_PER_STEP, _STEPS = 120, 200
#: sizes about the best: how many, how far, over it, and how much nearer in a second round
_TRIED, _WIDEST, _NARROWED = 9, 0.02, 0.2
#: scatter of a drive over its mean up to which it stays
_STAYS = 0.2
#: what the noise that is not known does to a size, sd over it: 13.55 mV came out as 13.49 at one and as 13.54 at another
_SD = 3e-3


def with_unseen_steps(beside: SpectralEffects, model: CampaignModel, selection: Selection, left_out: Collection[str]) -> SpectralEffects:
    """The findings beside the fit with steps of the drives' converter, if they say more than all that a selection with a stranger says.

    Parameters
    ----------
    beside : SpectralEffects
    model : CampaignModel
    selection : Selection
    left_out : collection of str
        Effects that the registry does not hold.
    """
    if selection.stranger is None or NAME in left_out or any(e.name == NAME for e in beside.effects):
        return beside
    said = selection.chi2_before - selection.chi2_after + selection.stranger.screened.gain
    found = _found(model, said)
    if found is None:
        return beside
    best, sd_v = found
    return with_steps(beside, model.linear, (best.candidate.setting["step"], sd_v), best.gain)


def _found(model: CampaignModel, said: float) -> tuple[Screened, float] | None:
    """The likeliest size and its sd [V], if what it does is as large as steps make it at some noise; ``said``: chi-square to beat."""
    largest_v = max((_held_v(r.signals) for r in model.evidence if r.is_wave), default=0.0)
    if largest_v <= 0.0:
        return None
    sizes = _sizes(largest_v)
    tried, table = len(sizes) * len(_NOISE), _table(_LOOKED)
    found = _screened(model, sizes, table, tried)
    best = max(found, key=lambda s: s.gain, default=None)
    if best is None or not 0.0 < _share(best) < SHARE[1]:
        return None
    for half in (_WIDEST, _NARROWED * _WIDEST):
        middle = best.candidate.setting["step"]
        found = _screened(model, list(middle * (1.0 + np.linspace(-half, half, _TRIED))), table, tried)
        best = max(found, key=lambda s: s.gain)
    size = best.candidate.setting["step"]
    if min(best.log_evidence, 0.5 * (best.gain - said)) < MARGIN:
        return None
    shares = [_share(s) for noise in _NOISE for s in _screened(model, [size], _table(noise), tried)]
    return (best, size * math.hypot(_SD, _sd(found, best))) if any(SHARE[0] < share < SHARE[1] for share in shares) else None


def _held_v(s: Signals) -> float:
    """The larger drive of those that stay as large throughout; one that swings passes all its steps, whatever their size."""
    size = np.abs(s.drive)
    return float(np.max(np.where(size.std(axis=0) < _STAYS * size.mean(axis=0), size.max(axis=0), 0.0)))


def _sd(found: Sequence[Screened], best: Screened) -> float:
    """Of a size, over it, from how the chi-square falls about it."""
    away = [(abs(s.candidate.setting["step"] / best.candidate.setting["step"] - 1.0), best.gain - s.gain) for s in found if s is not best]
    return float(np.median([apart / math.sqrt(max(less, 1e-9)) for apart, less in away]))


def _screened(model: CampaignModel, sizes: Sequence[float], table: FloatArray, choices: int) -> list[Screened]:
    form = _form(table)
    columns = forms_columns(model.evidence, [(form, {"step": q}) for q in sizes], model.linear)
    return model.screener.screened(
        Candidate(NAME, {"step": float(q)}, tuple(made), np.ones(1), choices) for q, made in zip(sizes, columns, strict=True)
    )


def _share(s: Screened) -> float:
    return s.sizes()["share"][0]


def _sizes(largest_v: float) -> list[float]:
    sizes = [_LEAST * largest_v]
    while sizes[-1] < _MOST * largest_v:
        sizes.append(sizes[-1] * (1.0 + _PHASE * sizes[-1] / (2.0 * math.pi * largest_v)))
    return sizes


def _table(noise_steps: float) -> FloatArray:
    """Fundamental of the error over the step, for amplitudes in steps."""
    return rounded(np.arange(_PER_STEP * _STEPS) / _PER_STEP, 1.0, noise_steps)


def _form(table: FloatArray) -> Form:
    def parts(s: Signals, d: Linear, setting: Setting) -> list[Part]:
        step_v, size = setting["step"], s.once("size of drives", None, lambda: np.abs(s.drive))
        error = step_v * np.interp(_PER_STEP / step_v * size, np.arange(table.size), table, right=0.0) / np.maximum(size, math.ulp(1.0))
        return [Part("share", "drive", np.asarray(error * s.drive))]

    return Form(parts)
