"""Sizes of an effect as they are told: with what one fit at one setting does not say of their standard deviations.

A setting (a level, a time, a distance) is found by search: its sd is that of the chi-square's parabola about the best one, and the sizes
that follow it are no better known. What a healthy device has of the same form is not told from the effect, and is part of the size.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..effects import EFFECTS
from ..quantity import Quantity
from .candidates import registry_name
from .drifts import walk_sizes
from .model import CampaignModel
from .screen import Screened, Screener
from .settings_together import places_of, with_slopes
from .system import Solution

__all__ = ["told_sizes"]

#: by how much one step of the search for a setting's sd may change it
_LEAST, _MOST = 0.1, 3.0
_STEPS = 3


@dataclass(frozen=True)
class _Settled:
    """Sd of a setting, and by how much the sizes change with it."""

    sd: float
    slopes: Mapping[str, float]


def told_sizes(model: CampaignModel, effects: tuple[Screened, ...], k: int, rich: Solution) -> dict[str, Quantity]:
    """Parameters of one of the effects found, the settings of what is not linear among them.

    Parameters
    ----------
    model : CampaignModel
    effects : tuple of Screened
        All that were found.
    k : int
        Which of them.
    rich : Solution
        Fit with all of them.
    """
    e = effects[k]
    units = {p.name: p.unit for p in EFFECTS[registry_name(e.name, e.candidate.setting)].parameters}
    chosen = [other.candidate for other in effects]
    places = places_of(chosen)
    # settings that hold one another and all sizes: of one fit
    covariance = (with_slopes(model, chosen, places, rich) if places else rich).covariance
    joint = {key: len(rich.columns) + j for j, (place, key) in enumerate(places) if place == k}
    settled = {key: _settled(model, effects, k, key) for key in e.candidate.setting if key in units and key not in joint}
    settled |= {key: _Settled(math.sqrt(covariance[j, j]) * abs(e.candidate.setting[key]), {}) for key, j in joint.items()}
    healthy = {c.name: c.prior_sd for c in model.nuisances if math.isfinite(c.prior_sd)}
    fitted = {c.name: j for j, c in enumerate(rich.columns)}
    told, places_in_fit = {}, {c.name: fitted[f"{e.name}.{c.name}"] for c in e.candidate.columns}
    for column in e.candidate.columns:
        if column.name not in units and column.name != "share":
            continue
        place = places_in_fit[column.name]
        parts = [math.sqrt(float(covariance[place, place])), healthy.get(f"{e.name}.{column.name}", 0.0)]
        if e.name != "thermal_lag":
            parts += [s.slopes.get(column.name, 0.0) * s.sd for s in settled.values()]
        told[column.name] = Quantity(float(rich.values[place]), math.hypot(*parts), units.get(column.name, "1"))
    told |= {key: Quantity(float(e.candidate.setting[key]), s.sd, units[key]) for key, s in settled.items()}
    if "level" in settled and "share" in told:
        told["level"] = _of_all_of_it(model, effects, k, told["level"], told.pop("share"))
    if e.name == "thermal_lag":
        # a short lag is known by the product of the time that was tried and its share alone, and a healthy thermometer has one of its own
        share, tried = told.pop("share"), told["tau"]
        told["tau"] = Quantity(share.value * tried.value, math.hypot(share.sd * tried.value, healthy.get(f"{e.name}.tau", 0.0)), tried.unit)
    every = {name: (float(rich.values[j]), math.sqrt(float(covariance[j, j]))) for name, j in places_in_fit.items()}
    told |= walk_sizes(e.candidate.setting, every, next(iter(units.values())))
    if e.name == "multiplexing_skew":
        told["tau"] = _of_its_tangent(told["tau"], model.evidence.omega0_rad_s)
    return told


def _of_all_of_it(model: CampaignModel, effects: tuple[Screened, ...], k: int, level: Quantity, share: Quantity) -> Quantity:
    """A level by its shape, and by its share being one: a dead zone far below its drive takes as much as its level, whatever its shape."""
    e = effects[k]
    screener = model.screener_with([other.candidate for j, other in enumerate(effects) if j != k])
    step = _LEAST * level.value
    below, above = (_at(model, screener, e, "level", level.value + side * step) for side in (-1.0, 1.0))
    if below is None or above is None or share.sd == 0.0:
        return level
    slope = (above.sizes()["share"][0] - below.sizes()["share"][0]) / (2.0 * step)
    return replace(level, sd=1.0 / math.hypot(1.0 / level.sd, slope / share.sd))


def _of_its_tangent(late: Quantity, omega_rad_s: float) -> Quantity:
    """A time by the tangent of its phase, over the carrier's frequency.

    Rate crosses by ``kappa e^{i phi}``: of that the real part is the angular gain as it is read, and what stands beside is the tangent of
    phi. 4.25 us of a ring of 15 kHz, 0.4 rad, were 4.50.
    """
    tangent = omega_rad_s * late.value
    return Quantity(math.atan(tangent) / omega_rad_s, late.sd / (1.0 + tangent**2), late.unit)


def _settled(model: CampaignModel, effects: tuple[Screened, ...], k: int, key: str) -> _Settled:
    e = effects[k]
    screener = model.screener_with([other.candidate for j, other in enumerate(effects) if j != k])
    here, rough = float(e.candidate.setting[key]), _rough_sd(model, e, key)
    middle = _at(model, screener, e, key, here)
    step, unbent = min(rough, 0.5 * abs(here)), _Settled(rough, {})
    found = unbent
    for _ in range(_STEPS):
        below, above = (_at(model, screener, e, key, here + side * step) for side in (-1.0, 1.0))
        if middle is None or below is None or above is None or step == 0.0:
            return found
        bend = 2.0 * middle.gain - below.gain - above.gain
        if bend <= 0.0:
            # no parabola: a level between the amplitudes that were recorded
            return found
        sd = step * math.sqrt(2.0 / bend)
        if sd > abs(here):
            # nor is one where another setting of another size does as well
            return unbent
        low, high = below.sizes(), above.sizes()
        found = _Settled(sd, {name: (high[name][0] - low[name][0]) / (2.0 * step) for name in high})
        step = float(np.clip(sd, _LEAST * step, min(_MOST * step, 0.5 * abs(here))))
    return found


def _at(model: CampaignModel, screener: Screener, e: Screened, key: str, value: float) -> Screened | None:
    return screener.screen(model.candidate(e.name, {**e.candidate.setting, key: value}))


def _rough_sd(model: CampaignModel, e: Screened, key: str) -> float:
    """Half of the span of the settings of the grid that explain nearly as much."""
    tried = model.grid(e.name, key)
    near = [float(s.candidate.setting[key]) for s in model.screener.screened(tried) if s.log_evidence > e.log_evidence - 2.0]
    grid = sorted({float(c.setting[key]) for c in tried})
    here = float(e.candidate.setting[key])
    beside = sorted(abs(other - here) for other in grid if other != here)
    step = float(np.mean(beside[:2])) if beside else 0.0
    return max(0.5 * (max(near, default=0.0) - min(near, default=0.0)), 0.3 * step)
