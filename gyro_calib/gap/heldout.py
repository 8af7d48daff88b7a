"""How far the gap shrinks on experiments that the effect's size was not found on.

The recordings are halved by experiment, each half predicted from the other. For a linear model with Gaussian noise the chi-square of one
half given the other is chi-square(both) - chi-square(other), nuisances and their priors included: no direction that only the held-out half
can tell (its own resonance shifts, a temperature that only it visited) counts as misfit.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from ..recording.applied_rate import is_turned
from .columns import Column
from .model import CampaignModel
from .saturated import effect_columns
from .screen import Candidate, Screener
from .system import Whitener, solve

__all__ = ["Shrinkage", "halves", "halves_disagree", "shrinkage"]

#: chance that halves of one device disagree by more
_BY_CHANCE = 1e-3


@dataclass(frozen=True)
class Shrinkage:
    """Gap on unseen experiments.

    Parameters
    ----------
    before, after : float
        Chi-square of unseen experiments without and with the effects, over their degrees of freedom.
    dof : int
    closed, closed_sd : float
        1 - (chi2_after - dof)/(chi2_before - dof), and its standard deviation.
    labels : tuple of str
        Experiments that were held out and hold a gap.
    rate_before, rate_after : float
        Rate that their means leave unexplained, root mean square [rad/s].
    """

    before: float
    after: float
    dof: int
    closed: float
    closed_sd: float
    labels: tuple[str, ...]
    rate_before: float = 0.0
    rate_after: float = 0.0

    @property
    def rms_before(self) -> float:
        """Root mean square over the noise."""
        return math.sqrt(max(self.before, 0.0))

    @property
    def rms_after(self) -> float:
        """Root mean square over the noise."""
        return math.sqrt(max(self.after, 0.0))


def halves(model: CampaignModel) -> tuple[list[int], list[int]]:
    """Two halves of the recordings, every role and amplitude in both as far as it was recorded twice."""
    alike: dict[tuple[str, float], list[int]] = defaultdict(list)
    for k, r in enumerate(model.evidence):
        alike[r.role, round(r.recording.command.setpoints.amplitude_v, 6)].append(k)
    sides: tuple[list[int], list[int]] = ([], [])
    turn = 0
    for members in alike.values():
        for k in members:
            sides[turn % 2].append(k)
            turn += 1
    return sorted(sides[0]), sorted(sides[1])


def shrinkage(model: CampaignModel, chosen: Sequence[Candidate]) -> Shrinkage:
    """Predict each half from the other, without and with the effects."""
    whole = _Part(model, range(len(model.evidence)))
    # what a half cannot tell it must not guess at: a size is believed to be of the order that all experiments say
    order = np.abs(whole.told(chosen)[0]) if chosen else None
    before = after = 0.0
    dof = 0
    gains: list[_Unseen] = []
    for train in halves(model):
        part = _Part(model, train)
        sizes = part.told(chosen, order)[0]
        plain_whole, plain_part = whole.chi_square(chosen, None), part.chi_square(chosen, None)
        rich_whole, rich_part = whole.chi_square(chosen, sizes), part.chi_square(chosen, sizes)
        before += plain_whole[0] - plain_part[0]
        after += rich_whole[0] - rich_part[0]
        dof += plain_whole[1] - plain_part[1]
        gains += whole.improved(chosen, sizes, train)
    gap = before - dof
    closed = 1.0 - (after - dof) / gap if gap > 0.0 else 0.0
    sd = math.sqrt(2.0 * dof + 4.0 * max(after - dof, 0.0)) / gap if gap > 0.0 else math.inf
    labels = tuple(u.label for u in sorted(gains, key=lambda u: -u.gain)[:8] if u.gain > 0.0)
    rates = [
        math.sqrt(float(np.mean([rate**2 for rate in side]))) if side else 0.0
        for side in ([u.before for u in gains if u.has_rate], [u.after for u in gains if u.has_rate])
    ]
    return Shrinkage(before / max(dof, 1), after / max(dof, 1), dof, closed, sd, labels, rates[0], rates[1])


def halves_disagree(model: CampaignModel, chosen: Sequence[Candidate]) -> bool:
    """Whether the sizes that each half tells differ by more than their uncertainty: then the form is not that of what is there."""
    (one, one_var), (other, other_var) = (_Part(model, train).told(chosen) for train in halves(model))
    variance = one_var + other_var
    told = np.diag(variance) > 0.0
    scale = np.sqrt(np.diag(variance)[told])
    values, axes = np.linalg.eigh(variance[np.ix_(told, told)] / np.outer(scale, scale))
    kept = values > 1e-6 * values[-1]
    apart = (axes.T @ ((one - other)[told] / scale))[kept] ** 2 / values[kept]
    return bool(chi2.sf(float(np.sum(apart)), int(kept.sum())) < _BY_CHANCE)


@dataclass(frozen=True)
class _Unseen:
    """What the effects do for an unseen recording: chi-square, and the rate that its mean leaves unexplained [rad/s]."""

    label: str
    gain: float
    before: float
    after: float
    has_rate: bool


class _Part:
    """Some recordings of a campaign with its nuisances."""

    def __init__(self, model: CampaignModel, indices: Sequence[int]) -> None:
        self.model, self.indices = model, list(indices)
        self.whitener = Whitener(tuple(model.whitener.factors[k] for k in self.indices))
        self.nuisances = [self._kept(c) for c in model.nuisances]
        self.target = [model.target[k] for k in self.indices]

    def _kept(self, c: Column) -> Column:
        return Column(c.name, tuple(c.signal[k] for k in self.indices), (), c.prior_sd)

    def told(self, chosen: Sequence[Candidate], order: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Sizes of the effects as these recordings say, and their covariance; ``order``: sd that they are believed to have beforehand."""
        effects = [self._kept(c) for c in effect_columns(chosen)]
        if order is not None:
            effects = [replace(c, prior_sd=min(c.prior_sd, max(float(sd), 1e-300))) for c, sd in zip(effects, order, strict=True)]
        columns = [*self.nuisances, *effects]
        solution = solve(columns, self.whitener.design(columns, len(self.indices)), self.whitener.rows(self.target))
        first = len(self.nuisances)
        return solution.values[first:], solution.covariance[first:, first:]

    def _less(self, chosen: Sequence[Candidate], sizes: np.ndarray | None) -> list[np.ndarray]:
        if sizes is None:
            return self.target
        columns = effect_columns(chosen)
        return [
            t - sum(size * c.signal[k] for size, c in zip(sizes, columns, strict=True))
            for k, t in zip(self.indices, self.target, strict=True)
        ]

    def chi_square(self, chosen: Sequence[Candidate], sizes: np.ndarray | None) -> tuple[float, int]:
        """Chi-square of the nuisances' fit with the effects at given sizes, and its degrees of freedom."""
        screener = Screener(self.whitener, self.nuisances, self._less(chosen, sizes))
        return screener.chi2, screener.dof

    def improved(self, chosen: Sequence[Candidate], sizes: np.ndarray, train: Sequence[int]) -> list[_Unseen]:
        """What the effects, of a size that others told, do for each unseen recording."""
        plain = Screener(self.whitener, self.nuisances, self.target).left
        rich = Screener(self.whitener, self.nuisances, self._less(chosen, sizes)).left
        out, first = [], 0
        for k, r in enumerate(self.model.evidence):
            rows = slice(first, first + 2 * r.signal.lhs.size)
            first += 2 * r.signal.lhs.size
            if k in train:
                continue
            before, after = (self._rate(k, left[rows]) for left in (plain, rich))
            gain = float(plain[rows] @ plain[rows] - rich[rows] @ rich[rows])
            steady = r.is_wave and not r.is_warming and not is_turned(r.recording)
            out.append(_Unseen(r.recording.label, gain, before, after, steady))
        return out

    def _rate(self, k: int, left: np.ndarray) -> float:
        """Rate that would explain the residual of a recording's mean across the wave."""
        r = self.model.evidence.recordings[k]
        size = r.signal.lhs.size
        across = float((self.whitener.factors[k][0] @ left[:size])[size // 2])
        amplitude = float(np.sqrt(np.mean(np.sum(np.abs(r.signals.pick) ** 2, axis=1))))
        return across / (self.model.linear.angular_gain * max(amplitude, 1e-9) * math.sqrt(r.recording.duration_s))
