"""From a wanted signal-to-noise ratio to the size of an effect, on a clean campaign of the same unit.

The ratio is ``|(I - Q Q^T) S phi|``: what is left of the effect's whitened columns S at its size phi when the nuisances Q are projected
out, so that ratio^2 is the chi-square that the effect takes away on average. It is linear in the size; the carrier is not, and decides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from ..effects import EFFECTS
from ..gap.column import Column
from ..gap.columns import form_columns
from ..gap.forms import FORMS
from ..gap.model import CampaignModel
from ..gap.parts import REST
from ..gap.screen import Candidate
from .labels import reported_name

__all__ = ["Sized", "imitators", "size_effect"]

FloatArray = NDArray[np.float64]
#: sizes beyond so many times the typical one are no longer the effect that the catalogue means
_MOST_TYPICAL = 10.0
#: share of the damping that may come or go by the temperature or by a pump: a resonator with none does not hold still
_MOST_DAMPING = 0.5
#: an effect whose time is its size
_LAG = "thermal_lag"
#: effects whose time is a setting of their form
_WITH_TIMES = (
    "relaxation",
    "drive_memory",
    "pickoff_memory",
    "charge_accumulation",
    "thermal_frequency_lag",
    "thermal_damping_lag",
    "thermal_damping_anisotropy_lag",
    "thermal_split_lag",
    "thermal_bias_lag",
    "thermal_drive_gain_lag",
    "thermal_pickoff_gain_lag",
)
#: parameters that a form has as a setting are drawn about their typical value, by this factor at most
_SETTING_SPREAD = 2.5
_LEVELS = 24
#: a time far beyond that of the campaign, over the longest of its form's grid
_FAR_BEYOND = 30.0
#: most that a drive may be dead of its own amplitude
_MOST_DEAD = 0.4


@dataclass(frozen=True)
class Sized:
    """An effect at a size.

    Parameters
    ----------
    name : str
        In the registry.
    sizes : mapping
        Parameter -> value.
    signal : ndarray
        Whitened, nuisances projected out.
    """

    name: str
    sizes: Mapping[str, float]
    signal: FloatArray

    @property
    def snr(self) -> float:
        """Effective signal-to-noise ratio."""
        return float(np.linalg.norm(self.signal))


def size_effect(model: CampaignModel, name: str, snr: float, rng: np.random.Generator) -> Sized | None:
    """The effect at a ratio, its direction and what is not linear drawn; None when no fair size reaches it.

    Parameters
    ----------
    model : CampaignModel
        Of a clean campaign of the unit.
    name : str
        Of the registry.
    snr : float
    rng : numpy.random.Generator
    """
    if "level" in {p.name for p in EFFECTS[name].parameters}:
        return _levelled(model, name, snr)
    if name == _LAG:
        return _late(model, snr)
    effect = EFFECTS[name]
    linear = _linear_parameters(name)
    setting = {p.name: _about(p.typical, rng) for p in effect.parameters if p.name not in linear}
    for key in setting:
        if effect.parameter(key).signed and rng.random() < 0.5:
            setting[key] = -setting[key]
    if reported_name(name) != name:
        setting["axes"] = 1.0
    elif FORMS[name].per_axis:
        setting["axes"] = 0.0
    found = form_columns(model.evidence, FORMS[reported_name(name)], model.linear, setting)
    # what no campaign tells from the wander of the resonance has no column, and stays zero
    silent = dict.fromkeys(set(linear) - {c.name for c in found}, 0.0)
    linear = tuple(c.name for c in found if not c.name.startswith(REST))
    columns = _without_rest(found, model.screener.projected(found)[0])
    draw = {p: effect.parameter(p).typical * _share(effect.parameter(p).signed, rng) for p in linear}
    signal = columns @ np.array([draw[p] for p in linear])
    strength = float(np.linalg.norm(signal))
    if not strength > 0.0 or (factor := snr / strength) > _MOST_TYPICAL:
        return None
    sizes = {p: factor * value for p, value in draw.items()} | {k: v for k, v in setting.items() if k != "axes"} | silent
    if any(not effect.parameter(p).lower <= v <= effect.parameter(p).upper for p, v in sizes.items()):
        return None
    return None if _undamped(model, name, [sizes[p] for p in linear]) else Sized(name, sizes, factor * signal)


def _without_rest(found: Sequence[Column], columns: FloatArray) -> FloatArray:
    """An effect's own columns, less what an axis at rest may do of it to either side: shape (n, parameters)."""
    rest = np.array([c.name.startswith(REST) for c in found])
    beside, own = np.linalg.qr(columns[:, rest])[0], columns[:, ~rest]
    return np.asarray(own - beside @ (beside.T @ own))


def _undamped(model: CampaignModel, name: str, sizes: Sequence[float]) -> bool:
    """Whether a coefficient of the damping would leave the warmest recording with next to none, or a pump any."""
    if name.startswith("parametric_pump"):
        return float(np.linalg.norm(sizes)) > _MOST_DAMPING * model.evidence.decay_rate
    if not name.startswith("thermal_damping"):
        return False
    warmest_k = max(float(np.abs(r.signals.temperature_k).max()) for r in model.evidence)
    lever = warmest_k**2 if name.endswith("_curvature") else warmest_k
    return max(map(abs, sizes)) * lever > _MOST_DAMPING * model.evidence.decay_rate


def _levelled(model: CampaignModel, name: str, snr: float) -> Sized | None:
    """A clipping or dead level, from a grid and by bisection between its points: the further it bites, the larger."""
    grid = [s["level"] for s in FORMS[name].settings([r.signals for r in model.evidence]) if "level" in s]
    # a drive that is dead up to its own amplitude moves nothing
    typical = float(np.median([np.abs(r.signals.drive).max() for r in model.evidence]))
    largest = _MOST_DEAD * typical if name == "drive_dead_zone" else max(grid)
    return _by_setting(model, name, "level", np.geomspace(min(grid), largest, _LEVELS), snr)


def _late(model: CampaignModel, snr: float) -> Sized | None:
    """A time of what sets the frequency behind its thermometer: as a rate of change it is healthy, what it makes of corners is not."""
    times = [s["tau"] for s in FORMS[_LAG].settings([r.signals for r in model.evidence])]
    return _by_setting(model, _LAG, "tau", np.geomspace(min(times), max(times), _LEVELS), snr)


def _by_setting(model: CampaignModel, name: str, key: str, grid: FloatArray, snr: float) -> Sized | None:
    """An effect whose one setting is its size."""
    excess = np.array([_excess(float(np.log(value)), model, name, key, snr) for value in grid])
    crossed = np.flatnonzero(excess[:-1] * excess[1:] < 0.0)
    if not crossed.size:
        return None
    # of several the one that bites least: towards large levels for a limit, towards small ones for a dead zone
    k = int(crossed[-1] if excess[0] > excess[-1] else crossed[0])
    ends = np.log(grid[k]), np.log(grid[k + 1])
    value = float(np.exp(brentq(_excess, *ends, args=(model, name, key, snr), xtol=1e-4)))
    signal = _signal_at(model, name, key, value)
    # where amplitudes come in steps so does what is clipped
    return Sized(name, {key: value}, signal) if 0.7 < float(np.linalg.norm(signal)) / snr < 1.4 else None


def _excess(log_value: float, model: CampaignModel, name: str, key: str, snr: float) -> float:
    return float(np.linalg.norm(_signal_at(model, name, key, float(np.exp(log_value))))) - snr


def _signal_at(model: CampaignModel, name: str, key: str, value: float) -> FloatArray:
    columns, _ = model.screener.projected(form_columns(model.evidence, FORMS[name], model.linear, {key: value}))
    return np.asarray(columns[:, 0])


def imitators(model: CampaignModel, sized: Sized, names: Sequence[str] = ()) -> dict[str, float]:
    """Ratio that is left of an effect once another of the registry is fitted in its place, smallest first; of a group, of its settings."""
    left = {}
    for name, candidates in model.candidates.items():
        if name == reported_name(sized.name) or (names and name not in names):
            continue
        left[name] = min(_behind(model, sized.signal, c.columns) for c in (*candidates, *_longer(model, candidates)))
    return dict(sorted(left.items(), key=lambda item: item[1]))


def _longer(model: CampaignModel, candidates: Sequence[Candidate]) -> list[Candidate]:
    """The candidate of the longest time, of a time far beyond it: a diagnosis may find one there, and a charge of hours is a drift."""
    timed = [c for c in candidates if "tau" in c.setting]
    if not timed:
        return []
    longest = max(timed, key=lambda c: c.setting["tau"])
    return [model.candidate(longest.name, {**longest.setting, "tau": _FAR_BEYOND * longest.setting["tau"]})]


def _behind(model: CampaignModel, signal: FloatArray, columns: Sequence[object]) -> float:
    clean, norms = model.screener.projected(columns)  # type: ignore[arg-type]
    used = norms > 0.0
    if not used.any():
        return float(np.linalg.norm(signal))
    u, s, _ = np.linalg.svd(clean[:, used] / norms[used], full_matrices=False)
    basis = u[:, s > 1e-4]
    return float(np.linalg.norm(signal - basis @ (basis.T @ signal)))


def _linear_parameters(name: str) -> tuple[str, ...]:
    """Parameters that the form is linear in."""
    if name == "spurious_mode":
        settings = {"separation_hz", "half_width_hz"}
    elif name in _WITH_TIMES:
        settings = {"tau"}
    else:
        settings = set()
    return tuple(p.name for p in EFFECTS[name].parameters if p.name not in settings)


def _about(typical: float, rng: np.random.Generator) -> float:
    return float(typical * np.exp(rng.uniform(-1.0, 1.0) * np.log(_SETTING_SPREAD)))


def _share(signed: bool, rng: np.random.Generator) -> float:
    size = float(rng.uniform(0.3, 1.0))
    return size if not signed or rng.random() < 0.5 else -size
