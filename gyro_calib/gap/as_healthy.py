"""What a device has as any healthy one may: not a gap, but part of why it differs from a simulation of its drawing.

A drive whose gain goes by 2.9e-4/K takes 5 889 in chi-square of a ring, and no campaign says whether its maker calls that healthy: units of
two other plants are so. It enters the fit with a prior (:class:`.healthy.HealthySpread`) and is no effect, but it is said, under the name
that the registry has for it, with its size and what any device may have. A fleet decides (`fleet.py`).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from ..effects import EFFECTS
from ..quantity import Quantity
from .candidates import registry_name
from .column import Column
from .diagnosis import AsHealthy
from .healthy import size_of
from .model import CampaignModel
from .physical import physical
from .saturated import effect_columns
from .screen import Candidate, Screened, Screener
from .sizes import what_data_say
from .strangers import LEAST_GAIN
from .system import Solution, solve

__all__ = ["as_healthy"]

#: effects of the registry that are what a healthy device has as well, by the sizes of :class:`.healthy.HealthySpread` that they are of
_NAMES: Mapping[tuple[str, ...], tuple[str, ...]] = {
    ("gain_per_k", "axis_gain_per_k"): ("thermal_drive_gain", "thermal_pickoff_gain"),
    ("phase_per_k",): ("thermal_drive_phase", "thermal_pickoff_phase"),
    ("damping_per_k", "damping_axis_per_k"): ("thermal_damping_anisotropy", "thermal_bias"),
    ("damping_per_k2",): ("thermal_damping_curvature",),
    ("split_per_k", "split_axis_per_k"): ("thermal_split",),
    ("feedthrough_per_k",): ("thermal_feedthrough",),
    ("drive_lag_s", "envelope_lag_s"): ("drive_lag", "drive_delay"),
    ("sensor_lag_s", "gradient_lag_s"): ("thermal_lag",),
    ("stray_drift",): ("feedthrough_drift", "cross_feedthrough_drift"),
    ("gain_drift",): ("drive_gain_drift", "pickoff_gain_drift"),
    ("phase_drift",): ("drive_phase_drift", "pickoff_phase_drift"),
    ("rate_drift",): ("bias_drift",),
    ("damping_drift",): ("damping_drift",),
    ("split_drift",): ("split_drift",),
}
#: how all of the damping goes with the temperature is no difference between devices: a linear one has it as its frequency has a slope
_OF_ALL = "thermal_damping.c"
#: an effect says what a family is from this share of its chi-square on: a floor is no drift in line with time
_MOST = 0.5
#: a difference is said where it is known this much better than either of the two
_BETTER = 0.3


def as_healthy(model: CampaignModel, chosen: Sequence[Candidate], rich: Solution, without: Collection[str] = ()) -> tuple[AsHealthy, ...]:
    """Effects of the registry that the device has no more of than any healthy one may, the largest first.

    Parameters
    ----------
    model : CampaignModel
    chosen : sequence of Candidate
        Effects that were found: they are none of these.
    rich : Solution
        Fit with them.
    without : collection of str
        Effects that the registry shall not hold.
    """
    own = {c.name for c in chosen}
    places = [
        k
        for k, c in enumerate(rich.columns)
        if size_of(c.name) and c.name != _OF_ALL and np.isfinite(c.prior_sd) and c.name.split(".")[0] not in own
    ]
    if not places:
        return ()
    kinds = [size_of(rich.columns[k].name) for k in places]
    over = np.abs(rich.values[places]) / np.array([rich.columns[k].prior_sd for k in places])
    precision, information = what_data_say(rich, places)
    precision = precision + np.eye(len(places))
    found = []
    for sizes, names in _NAMES.items():
        of_these = np.array([kind in sizes for kind in kinds])
        known = [n for n in names if n in model.candidates and n not in own and n not in without]
        if known and (taken := _taken(precision, information, of_these)) > LEAST_GAIN:
            others = _instead(model, chosen, sizes)
            best = _best(model, others, known)
            if best is not None and best.gain > max(LEAST_GAIN, _MOST * taken):
                usual = {size: getattr(model.evidence.healthy, size) for size in sizes}
                found.append(_said(model, others, best, usual, float(over[of_these].max())))
    return tuple(sorted(found, key=lambda held: -held.gain))


def _taken(precision: np.ndarray, information: np.ndarray, of_these: np.ndarray) -> float:
    """Chi-square that some coefficients take away beside the others, the priors of all in it."""
    if not of_these.any():
        return 0.0

    def best(keep: np.ndarray) -> float:
        if not keep.any():
            return 0.0
        return float(information[keep] @ np.linalg.solve(precision[np.ix_(keep, keep)], information[keep]))

    return best(np.ones(of_these.size, dtype=bool)) - best(~of_these)


def _instead(model: CampaignModel, chosen: Sequence[Candidate], sizes: Collection[str]) -> list[Column]:
    """All nuisances but those of these sizes, and the effects."""
    others = [c for c in model.nuisances if size_of(c.name) not in sizes or c.name == _OF_ALL]
    return [*others, *effect_columns(chosen)]


def _best(model: CampaignModel, others: Sequence[Column], names: Sequence[str]) -> Screened | None:
    """The effect that takes most of what the other columns leave."""
    # in line with time: a bent course, or a walk, follows any floor
    plain = [c for n in names for c in model.candidates[n] if set(c.setting) <= {"tau"}]
    screener = Screener(model.whitener, others, model.target)
    return max((s for s in screener.screened(plain) if physical(s)), key=lambda s: s.gain, default=None)


def _said(model: CampaignModel, others: Sequence[Column], found: Screened, usual: Mapping[str, float], times_usual: float) -> AsHealthy:
    """Sizes of one fit with the effect in place of what healthy devices have."""
    name = registry_name(found.name, found.candidate.setting)
    units = {p.name: p.unit for p in EFFECTS[name].parameters}
    columns = [*others, *effect_columns([found.candidate])]
    fit = solve(columns, model.whitener.design(columns, len(model.evidence)), model.whitener.rows(model.target))
    of_effect = {c.name: len(others) + k for k, c in enumerate(found.candidate.columns)}
    known = {key: k for key, k in of_effect.items() if key in units}
    sizes = {key: Quantity(float(fit.values[k]), math.sqrt(float(fit.covariance[k, k])), units[key]) for key, k in known.items()}
    if (k := of_effect.get("share")) is not None and (tau := found.candidate.setting.get("tau")) is not None:
        # a short lag is known by the product of the time that was tried and its share alone
        sizes["tau"] = Quantity(float(fit.values[k]) * tau, math.sqrt(float(fit.covariance[k, k])) * tau, units["tau"])
    told = _of_both(sizes, fit, known)
    return AsHealthy(name, EFFECTS[name].title, EFFECTS[name].location, sizes, told, found.gain, dict(usual), times_usual)


def _of_both(sizes: Mapping[str, Quantity], fit: Solution, places: Mapping[str, int]) -> dict[str, Quantity]:
    """The difference of two axes where it is told and neither is: all of a drive's gain that both have is a damping."""
    if len(places) != 2 or [name[-2:] for name in places] != ["_x", "_y"]:
        return {}
    (x, i), (y, j) = places.items()
    cov = fit.covariance
    sd = math.sqrt(max(float(cov[i, i] + cov[j, j] - 2.0 * cov[i, j]), 0.0))
    if sd > _BETTER * min(sizes[x].sd, sizes[y].sd):
        return {}
    return {f"{y} - {x}": Quantity(float(fit.values[j] - fit.values[i]), sd, sizes[x].unit)}
