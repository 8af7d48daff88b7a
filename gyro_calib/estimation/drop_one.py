"""Drop-one analysis of a side-band calibration: estimate again without each kind of recording and each source, and see what moves.

A figure whose sd grows when a source is left out is carried by it; a figure that moves by more than the growth of its sd explains is
contradicted by it: the full estimate is the more precise one, so the change has the variance ``sd_without^2 - sd^2`` (Hausman). The noise
is measured anew each time, so a lesser sd without a source is chance, and its difference counts as well.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from ..errors import CalibrationRefused
from ..quantity import Quantity
from ..recording.recording import Campaign, Recording
from .factory_values import angular_gain
from .separation import Priors
from .sideband import FIGURES, SidebandProblem
from .slow_flow_data import SLOPE_WINDOW_K, usable_recordings

__all__ = ["DropOne", "LeftOut", "drop_one"]

_RATIO = "drive_gain_ratio_x_over_y"
#: a change that the sd explains to less than this is rounding [of the full estimate's sd]
_LEAST_CHANGE = 0.05
#: a source is what does not fit when chi-square per degree of freedom falls below this share without it
_MISFIT = 0.5
#: growth of an sd from which on a figure hangs on the source
_FREE = 2.0
_UNITS = {name: "rad/s" if name.startswith(("rate", "bias")) else "V/(rad/s)" for name in FIGURES}


@dataclass(frozen=True)
class LeftOut:
    """The estimate without one source.

    Parameters
    ----------
    source : str
        What was left out.
    change : mapping of str to Quantity
        By figure: how far it moved, with the sd that the move should have by the measured noise.
    growth : mapping of str to float
        By figure: sd without the source over the sd with it.
    chi2_per_dof : float
        Of the fit without the source; NaN when there is none.
    refused : str
        Why there is no estimate without the source; empty when there is one.
    """

    source: str
    change: Mapping[str, Quantity]
    growth: Mapping[str, float]
    chi2_per_dof: float = math.nan
    refused: str = ""

    def to_json(self) -> dict[str, Any]:
        """``{"left_out", "change": {figure: …}, "sd_growth": {figure: …}, "chi2_per_dof", "refused"}``."""
        return {
            "left_out": self.source,
            "change": {name: q.to_json() for name, q in self.change.items()},
            "sd_growth": dict(self.growth),
            "chi2_per_dof": None if self.refused else self.chi2_per_dof,
            "refused": self.refused,
        }


@dataclass(frozen=True)
class DropOne:
    """The full estimate and every one with a source left out.

    Parameters
    ----------
    figures : mapping of str to Quantity
        Rate, bias and scale factors from everything.
    chi2_per_dof : float
        Of the fit to everything.
    left_out : tuple of LeftOut
    """

    figures: Mapping[str, Quantity]
    chi2_per_dof: float
    left_out: tuple[LeftOut, ...]

    def carried_by(self, figure: str) -> LeftOut | None:
        """The source without which the sd of a figure grows most; one without which there is no estimate counts most."""
        best = max(self.left_out, key=lambda d: math.inf if d.refused else d.growth[figure], default=None)
        return best if best is not None and (best.refused or best.growth[figure] > 1.1) else None

    def contradicted_by(self, figure: str, sigmas: float = 3.0) -> tuple[LeftOut, ...]:
        """Sources without which a figure moves by more than ``sigmas`` of what the move should be."""
        return tuple(d for d in self.left_out if not d.refused and abs(d.change[figure].value) > sigmas * d.change[figure].sd)

    @property
    def misfit_of(self) -> LeftOut | None:
        """The source without which the model fits best, where it does not fit with it: then every figure is contradicted by something.

        A source without which figures are hardly determined any more is not it: there the model fits because it is free to.
        """
        still_determined = [d for d in self.left_out if not d.refused and max(d.growth.values()) < _FREE]
        best = min(still_determined, key=lambda d: d.chi2_per_dof, default=None)
        return best if best is not None and best.chi2_per_dof < _MISFIT * self.chi2_per_dof else None

    def to_json(self) -> dict[str, Any]:
        """``{"figures": {…}, "chi2_per_dof", "misfit_of", "left_out": […], "contradictions": {figure: [source]}}``."""
        return {
            "chi2_per_dof": self.chi2_per_dof,
            "misfit_of": None if self.misfit_of is None else self.misfit_of.source,
            "figures": {name: q.to_json() for name, q in self.figures.items()},
            "left_out": [d.to_json() for d in self.left_out],
            "contradictions": {name: [d.source for d in self.contradicted_by(name)] for name in self.figures},
        }


def drop_one(campaign: Campaign, *, priors: Priors | None = None, on_progress: Callable[[float], None] | None = None) -> DropOne:
    """Estimate with everything and without each source in turn.

    Parameters
    ----------
    campaign : Campaign
        As for :func:`.calibrate_sideband`.
    priors : Priors, optional
        What is known of the pick-off chain.
    on_progress : callable, optional
        Called with a fraction 0-1.

    Raises
    ------
    CalibrationRefused
        There is no estimate from everything.
    """
    kappa = angular_gain(campaign.factory)
    priors = priors or Priors()
    recordings, _ = usable_recordings(campaign, SLOPE_WINDOW_K)
    if not recordings:
        raise CalibrationRefused("Campaign must hold force-rebalance recordings (ftr_x and ftr_y), but got none.")
    whole = SidebandProblem(recordings, campaign.factory, kappa, priors)
    full = _Figures.of(whole)
    cubic = whole.fit.has_cubic
    trials: list[tuple[str, Callable[[], SidebandProblem]]] = []
    for source, kept in _record_groups(recordings):
        trials.append((source, lambda kept=kept: SidebandProblem(kept, campaign.factory, kappa, priors, cubic=cubic)))  # type: ignore[misc]
    if whole.drive_ratio is not None:
        factory = {k: v for k, v in campaign.factory.items() if k != _RATIO}
        trials.append(("drive-gain ratio of the factory", lambda: SidebandProblem(recordings, factory, kappa, priors, fit=whole.fit)))
    trials.append(("reciprocity of the stiffness", lambda: _without_reciprocity(recordings, campaign, kappa, priors, whole)))
    if cubic:
        trials.append(("cubic terms", lambda: SidebandProblem(recordings, campaign.factory, kappa, priors, cubic=False)))
    left_out = []
    for done, (source, build) in enumerate(trials):
        try:
            left_out.append(full.compared(source, _Figures.of(build())))
        except CalibrationRefused as error:
            left_out.append(LeftOut(source, {}, {}, refused=str(error)))
        if on_progress is not None:
            on_progress((done + 1) / len(trials))
    return DropOne(full.claimed, full.chi2_per_dof, tuple(left_out))


def _record_groups(recordings: list[Recording]) -> Iterator[tuple[str, list[Recording]]]:
    """Each kind of recording, and what is kept without it."""

    def kind(r: Recording) -> list[str]:
        excitation, axis = r.command.excitation, r.command.oscillator_axis
        if excitation.kind == "drive":
            return ["open drive (feedthrough)"]
        if excitation.kind == "body":
            return ["body excitation"]
        amplitude = f"amplitude {r.command.setpoints.amplitude_v:g} V"
        if excitation.kind == "none":
            return [f"static records, {axis} oscillator", amplitude]
        return [f"side bands, {axis} oscillator", f"side bands at {excitation.frequency_hz:g} Hz", amplitude]

    kinds = [kind(r) for r in recordings]
    for name in dict.fromkeys(name for names in kinds for name in names):
        kept = [r for r, names in zip(recordings, kinds, strict=True) if name not in names]
        if any(r.command.oscillator_axis for r in kept):
            yield name, kept


def _without_reciprocity(
    recordings: list[Recording], campaign: Campaign, kappa: float, priors: Priors, whole: SidebandProblem
) -> SidebandProblem:
    problem = SidebandProblem(recordings, campaign.factory, kappa, priors, fit=whole.fit)
    # so wide that it says nothing
    problem.deviations = replace(problem.deviations, reciprocity=1e6)
    return problem


@dataclass(frozen=True)
class _Figures:
    """Figures with their claimed sd, and the sd that the measured noise alone would give them."""

    claimed: Mapping[str, Quantity]
    bare_sd: Mapping[str, float]
    chi2_per_dof: float

    @classmethod
    def of(cls, problem: SidebandProblem) -> _Figures:
        here, covariance = problem.solve()
        # a misfit widens what is claimed, and would hide the source that makes it
        _, bare = problem.propagate(problem.fit.covariance)
        claimed, bare_sd = {}, {}
        for name in FIGURES:
            k = here.names.index(name)
            claimed[name] = Quantity(float(here.values[k]), math.sqrt(float(covariance[k, k])), _UNITS[name])
            bare_sd[name] = math.sqrt(float(bare[k, k]))
        return cls(claimed, bare_sd, problem.fit.chi2 / max(problem.fit.dof, 1))

    def compared(self, source: str, without: _Figures) -> LeftOut:
        change, growth = {}, {}
        for name, q in self.claimed.items():
            other = without.claimed[name]
            sd, other_sd = self.bare_sd[name], without.bare_sd[name]
            expected = math.sqrt(max(abs(other_sd**2 - sd**2), (_LEAST_CHANGE * sd) ** 2))
            change[name] = Quantity(other.value - q.value, expected, q.unit)
            growth[name] = other.sd / q.sd
        return LeftOut(source, change, growth, without.chi2_per_dof)
