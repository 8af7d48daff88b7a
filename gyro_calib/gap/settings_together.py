"""Settings of several effects at once: what lags in the drives and what lags in the pick-offs are hardly told apart but by their times.

Along such a valley a search that moves one setting at a time stands still: two lags of a hemisphere stayed 24 above its floor in
chi-square. Marquardt's steps move all of them: how the fitted effects change with the log of a setting is one more column of the equations,
and what it comes to is the step. The same columns say how well the settings and the sizes are known together. And a time that was found
before what comes with an effect was there (a gradient of temperature damps as well as splits) is not the best beside that: 5.1 s of 5.9.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .candidates import candidate_at
from .column import Column
from .model import CampaignModel
from .parts import REST, SKEW
from .screen import Candidate
from .system import Solution, solve

__all__ = ["Place", "is_accompanied", "places_of", "settled_together", "with_slopes"]

#: settings that a fit is smooth in; a level is not, between the amplitudes that were recorded
_SMOOTH = ("tau", "separation_hz", "half_width_hz")
#: its time times its share is what the data know of it
_NOT_SMOOTH = {"thermal_lag"}
#: step of the difference in the log of a setting, and the largest step of one round
_STEP, _LARGEST = 0.02, 0.7
_ROUNDS, _DAMPINGS = 20, (0.0, 0.03, 0.3, 3.0, 30.0)
#: fall of chi-square that is worth another round
_FALL = 0.01

#: an effect's place among those chosen, and the name of a setting
Place = tuple[int, str]


def places_of(chosen: Sequence[Candidate]) -> list[Place]:
    """Settings that hold one another, those of two effects and more; or the size of what comes with an effect; none if neither is there."""
    found = [(k, key) for k, c in enumerate(chosen) if c.name not in _NOT_SMOOTH for key in _SMOOTH if c.setting.get(key)]
    return found if len({k for k, _ in found}) > 1 or any(is_accompanied(chosen[k]) for k, _ in found) else []


def is_accompanied(candidate: Candidate) -> bool:
    """Whether an effect is held with what comes with it, of a size of its own."""
    return any(c.name.startswith(SKEW) and not c.name.startswith(REST) for c in candidate.columns)


def settled_together(model: CampaignModel, chosen: Sequence[Candidate]) -> list[Candidate]:
    """The same effects at the settings that explain most together.

    Parameters
    ----------
    model : CampaignModel
    chosen : sequence of Candidate
        Near their best settings.

    Returns
    -------
    list of Candidate
        As they came where :func:`places_of` finds none.
    """
    here = list(chosen)
    places = places_of(here)
    if not places:
        return here
    fit = model.fitted(here)
    for _ in range(_ROUNDS):
        found = with_slopes(model, here, places, fit)
        mine = slice(len(fit.columns), None)
        curvature = np.linalg.pinv(found.covariance[mine, mine])
        for damping in _DAMPINGS:
            step = np.linalg.solve(curvature + damping * np.diag(np.diag(curvature)), curvature @ found.values[mine])
            tried = _moved(model, here, places, np.clip(step, -_LARGEST, _LARGEST))
            better = model.fitted(tried)
            if better.chi2 < fit.chi2:
                break
        else:
            return here
        fall, here, fit = fit.chi2 - better.chi2, tried, better
        if fall < _FALL:
            break
    return here


def with_slopes(model: CampaignModel, chosen: Sequence[Candidate], places: Sequence[Place], fit: Solution) -> Solution:
    """A fit with how its effects change with the log of each setting as further columns, the last ones in the order of ``places``."""
    sizes = fit.by_name()
    columns = [*fit.columns, *(_slope(model, chosen[k], key, sizes) for k, key in places)]
    return solve(columns, model.whitener.design(columns, len(model.evidence)), model.whitener.rows(model.target))


def _slope(model: CampaignModel, candidate: Candidate, key: str, sizes: dict[str, float]) -> Column:
    """What the effect of the fitted size changes by when the log of a setting grows by one."""
    fore, back = (_at(model, candidate, key, sign * _STEP) for sign in (1.0, -1.0))
    pairs = [(a, b, sizes[f"{candidate.name}.{a.name}"] / (2.0 * _STEP)) for a, b in zip(fore.columns, back.columns, strict=True)]
    signal, quiet = (
        tuple(sum(s * (getattr(a, of)[r] - getattr(b, of)[r]) for a, b, s in pairs) for r in range(len(model.evidence)))
        for of in ("signal", "quiet")
    )
    return Column(f"{candidate.name}.{key} log", signal, quiet)


def _moved(model: CampaignModel, chosen: Sequence[Candidate], places: Sequence[Place], step: np.ndarray) -> list[Candidate]:
    moved = list(chosen)
    for (k, key), by in zip(places, step, strict=True):
        moved[k] = _at(model, moved[k], key, float(by))
    return moved


def _at(model: CampaignModel, candidate: Candidate, key: str, log_step: float) -> Candidate:
    """An effect whose setting is another by that in its log."""
    setting = {**candidate.setting, key: float(candidate.setting[key]) * float(np.exp(log_step))}
    if is_accompanied(candidate):
        again = candidate_at(model.evidence, model.linear, candidate.name, setting, candidate.choices, {})
    else:
        again = model.candidate(candidate.name, setting)
    return replace(again, prior_sd=candidate.prior_sd)
