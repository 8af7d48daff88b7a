"""How far the gap shrinks on experiments that the effect's size was not found on.

Every recording is foretold by all the others, without and with the effects. With e what the nuisances leave of all equations and H = Q Q^T
what they can imitate (their priors are rows as well), a recording G is missed by ``z = (1 - H_GG)^-1/2 e_G``: no direction that only it can
tell (its own resonance shifts, a temperature that only it visited) counts as misfit. What it shows of an effect, ``Z``, is the same of the
effect's columns, and the others say of the size what all say less ``Z^T Z`` and ``Z^T z``: one factorisation for all recordings.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from ..recording.applied_rate import is_turned
from .model import CampaignModel
from .saturated import effect_columns
from .screen import Candidate, Screener
from .strangers import LEAST_GAIN, LEFT_SIGMA

__all__ = ["Shrinkage", "halves", "halves_disagree", "shrinkage", "shrinkage_of_halves"]

FloatArray = NDArray[np.float64]
#: chance that halves of one device disagree by more
_BY_CHANCE = 1e-3
#: share of a direction that the others must leave to it; less is told by a recording alone
_TOLD_BY_ITSELF = 1e-6
#: size of an effect, in units of its column's norm, that is none
_LEAST = 1e-9
#: size over that which all experiments say, sd, of which a half that does not show it knows nothing better
_OPEN = 3.0
#: square of what effects say, over the noise, that is nothing
_FORETOLD = 0.1
#: share of the gap that effects of the right form leave at most, if they leave more than noise: those of 400 times their noise left 0.004
_MOST_LEFT = 0.02


@dataclass(frozen=True)
class Shrinkage:
    """Gap on unseen experiments.

    Parameters
    ----------
    before, after : float
        Chi-square of unseen experiments without and with the effects, over what noise leaves of it.
    dof : int
        Figures that were foretold.
    closed, closed_sd : float
        1 - (after - 1)/(before - 1), and its standard deviation. What is left is no less than nothing, and no less than what is left in
        the direction of the effects: a noise that is believed to be too large hides no wrong size.
    labels : tuple of str
        Experiments that were held out and hold a gap.
    rate_before, rate_after : float
        Rate that their means leave unexplained, root mean square [rad/s].
    surprise : float
        What ``after`` is in units of what the others leave open of the sizes, besides noise: of effects of the right form, one.
    told, told_sd : float
        The closed fraction of what the others tell, and its standard deviation: the one recording that is warmed shows nobody else what
        goes with the temperature, and as all of a gap that is left it made 20 % of 96 beside an effect that all recordings show.
    """

    before: float
    after: float
    dof: int
    closed: float
    closed_sd: float
    labels: tuple[str, ...] = ()
    rate_before: float = 0.0
    rate_after: float = 0.0
    surprise: float = 0.0
    told: float = 0.0
    told_sd: float = 0.0

    @property
    def rms_before(self) -> float:
        """Root mean square over the noise."""
        return math.sqrt(max(self.before, 0.0))

    @property
    def rms_surprise(self) -> float:
        """Root mean square of what the effects leave, over the noise and what the others leave open of their sizes."""
        return math.sqrt(max(self.surprise, 0.0))

    @property
    def leaves_more(self) -> bool:
        """Whether effects leave more than noise does, and more than their first order: three of them imitate much."""
        return self.surprise - 1.0 > LEFT_SIGMA * math.sqrt(2.0 / max(self.dof, 1)) and self.closed < 1.0 - _MOST_LEFT


def halves(model: CampaignModel) -> tuple[list[int], list[int]]:
    """Two halves of the recordings, every role and amplitude, and open drive of every axis, in both as far as it was recorded twice."""
    alike: dict[tuple[str, float], list[int]] = defaultdict(list)
    for k, r in enumerate(model.evidence):
        driven = r.recording.command.excitation
        # each axis at some of its distances: what only a large drive shows is told of both axes by either half
        role = f"open drive of {driven.axis}" if driven.kind == "drive" else r.role
        alike[role, round(r.recording.command.setpoints.amplitude_v, 6)].append(k)
    sides: tuple[list[int], list[int]] = ([], [])
    turn = 0
    for members in alike.values():
        for k in members:
            sides[turn % 2].append(k)
            turn += 1
    return sorted(sides[0]), sorted(sides[1])


def shrinkage(model: CampaignModel, chosen: Sequence[Candidate]) -> Shrinkage:
    """Foretell each recording from all the others, without and with the effects."""
    unseen = _Unseen(model, chosen)
    return unseen.shrinkage([unseen.held_out([k]) for k in range(len(model.evidence))])


def shrinkage_of_halves(model: CampaignModel, chosen: Sequence[Candidate]) -> Shrinkage:
    """Foretell each half of the recordings from the other: harder for what is of another size in each experiment."""
    unseen = _Unseen(model, chosen)
    return unseen.shrinkage([unseen.held_out(half) for half in halves(model)])


def halves_disagree(model: CampaignModel, chosen: Sequence[Candidate]) -> bool:
    """Whether the sizes that each half tells differ by more than their uncertainty: then the form is not that of what is there."""
    unseen = _Unseen(model, chosen)
    (one, one_var), (other, other_var) = (unseen.told(unseen.held_out(half), unseen.open) for half in halves(model))
    variance = one_var + other_var
    told = np.diag(variance) > 0.0
    scale = np.sqrt(np.diag(variance)[told])
    values, axes = np.linalg.eigh(variance[np.ix_(told, told)] / np.outer(scale, scale))
    kept = values > 1e-6 * values[-1]
    apart = (axes.T @ ((one - other)[told] / scale))[kept] ** 2 / values[kept]
    return bool(chi2.sf(float(np.sum(apart)), int(kept.sum())) < _BY_CHANCE)


@dataclass(frozen=True)
class _HeldOut:
    """Recordings as the others foretell them: in units of what these leave open, with unit noise.

    Parameters
    ----------
    members : tuple of int
    missed : ndarray, shape (n,)
        What is there beyond what the others' nuisances say.
    shown : ndarray, shape (n, k)
        What the effects would be there.
    heard : ndarray, shape (n, nuisances)
        What the nuisances would be.
    """

    members: tuple[int, ...]
    missed: FloatArray
    shown: FloatArray
    heard: FloatArray


class _Unseen:
    """A campaign's recordings, foretold by others.

    Parameters
    ----------
    model : CampaignModel
    chosen : sequence of Candidate
        Effects; each size in units of what makes its column a unit vector.
    """

    def __init__(self, model: CampaignModel, chosen: Sequence[Candidate]) -> None:
        self._model, self._recordings, screener = model, tuple(model.evidence), _without_what_they_are(model, chosen)
        self._left, self._basis, self._rows = screener.left, screener.basis, screener.rows
        columns = effect_columns(chosen)
        shown = screener.projected(columns)[0] if columns else np.zeros((self._left.size, 0))
        norms = np.linalg.norm(shown, axis=0)
        scale = np.where(norms > 0.0, norms, 1.0)
        self._shown = shown / scale
        self._precision = (scale * np.array([c.prior_sd for c in columns])) ** -2.0
        self._fisher, self._towards = self._shown.T @ self._shown, self._shown.T @ self._left
        sizes = np.linalg.solve(self._fisher + np.diag(self._precision), self._towards)
        # what others cannot tell they must not guess at: a size is believed to be of the order that all experiments say
        self._order = np.maximum(self._precision, np.maximum(np.abs(sizes), _LEAST) ** -2.0)
        # nor is a half that tells nothing of a size surprised by one larger than it is believed to be
        self.open = np.minimum(self._precision, (_OPEN * np.maximum(np.abs(sizes), _LEAST)) ** -2.0)
        ends = np.cumsum([0, *(2 * r.signal.lhs.size for r in model.evidence)])
        self._places = [slice(a, b) for a, b in itertools.pairwise(ends)]
        # how far off their priors the nuisances are beside the effects: a device's constants need not be as large as they may be
        pads = self._left[self._rows :] - self._shown[self._rows :] @ sizes
        weight = self._basis[self._rows :]
        self._smaller = weight.T @ ((1.0 - pads**2)[:, None] * weight)

    def held_out(self, members: Sequence[int]) -> _HeldOut:
        """Some recordings, as the others foretell them."""
        rows = np.concatenate([np.arange(self._places[k].start, self._places[k].stop) for k in members])
        basis = self._basis[rows]
        open_, axes = np.linalg.eigh(np.eye(rows.size) - basis @ basis.T)
        kept = open_ > _TOLD_BY_ITSELF
        unit = (axes[:, kept] / np.sqrt(open_[kept])).T
        return _HeldOut(tuple(members), unit @ self._left[rows], unit @ self._shown[rows], unit @ basis)

    def told(self, out: _HeldOut, precision: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Sizes as the others tell them, and their covariance; ``precision``: what is known of each beforehand, by default its prior."""
        known = np.diag(self._precision if precision is None else precision)
        covariance = np.linalg.inv(self._fisher - out.shown.T @ out.shown + known)
        return covariance @ (self._towards - out.shown.T @ out.missed), covariance

    def shrinkage(self, parts: Sequence[_HeldOut]) -> Shrinkage:
        """Of all that was held out, part by part."""
        before = gain = noise = foretold = open_ = told_gain = told_foretold = 0.0
        gains: list[_Improved] = []
        for out in parts:
            sizes, covariance = self.told(out, self._order)
            effect = out.shown @ sizes
            # what the others leave open of the sizes is no misfit, as all other directions that only this one tells
            towards = out.shown.T @ np.column_stack([out.missed - effect, effect])
            left_open = towards.T @ np.linalg.solve(np.linalg.inv(covariance) + out.shown.T @ out.shown, towards)
            open_ += float(left_open[0, 0])
            told_foretold += float(effect @ effect - left_open[1, 1])
            told_gain += float(2.0 * (out.missed - effect) @ effect + effect @ effect - 2.0 * left_open[0, 1] - left_open[1, 1])
            gains += self._improved(out, sizes)
            before += float(out.missed @ out.missed)
            gain += float(2.0 * out.missed @ effect - effect @ effect)
            foretold += float(effect @ effect)
            noise += out.missed.size - float(np.sum((out.heard @ self._smaller) * out.heard))
        # of recordings that nothing but themselves tells of there is nothing to foretell
        noise = max(noise, 1.0)
        after = before - gain
        closed, sd = _closed(gain, foretold, after - noise, noise)
        told, told_sd = _closed(told_gain, told_foretold, after - open_ - noise, noise)
        if self._fisher.size:
            told_sd = math.hypot(told_sd, 1.0 / max(told_foretold, _FORETOLD))
        labels = tuple(u.label for u in sorted(gains, key=lambda u: -u.gain)[:8] if u.gain > 0.0)
        rates = [
            math.sqrt(float(np.mean([rate**2 for rate in side]))) if side else 0.0
            for side in ([u.before for u in gains if u.has_rate], [u.after for u in gains if u.has_rate])
        ]
        dof = sum(out.missed.size for out in parts)
        surprise = (after - open_) / noise
        return Shrinkage(before / noise, after / noise, dof, closed, sd, labels, rates[0], rates[1], surprise, told, told_sd)

    def _improved(self, out: _HeldOut, sizes: FloatArray) -> list[_Improved]:
        """What the effects, of a size that others told, do for each recording."""
        improved = []
        for k in out.members:
            r, rows = self._recordings[k], self._places[k]
            plain, rich = self._left[rows], self._left[rows] - self._shown[rows] @ sizes
            steady = r.is_wave and not r.is_warming and not is_turned(r.recording)
            gain = float(plain @ plain - rich @ rich)
            improved.append(_Improved(r.recording.label, gain, self._rate(k, plain), self._rate(k, rich), steady))
        return improved

    def _rate(self, k: int, left: FloatArray) -> float:
        """Rate that would explain the residual of a recording's mean across the wave."""
        r = self._recordings[k]
        size = r.signal.lhs.size
        across = float((self._model.whitener.factors[k][0] @ left[:size])[size // 2])
        amplitude = float(np.sqrt(np.mean(np.sum(np.abs(r.signals.pick) ** 2, axis=1))))
        return across / (self._model.linear.angular_gain * max(amplitude, 1e-9) * math.sqrt(r.recording.duration_s))


def _without_what_they_are(model: CampaignModel, chosen: Sequence[Candidate]) -> Screener:
    """Screens beside the nuisances that are no effect among these: of what a healthy device has as well, the device without it has none.

    Nor do those count as nuisances that would have to be far beyond a healthy device's without the effects and need not be with them: a
    late channel was a crossed rate of 42 sd of what a table's may be, and left no gap on the table itself.
    """
    names = {c.name for c in chosen}
    kept = [c for c in model.nuisances if c.name.split(".")[0] not in names]
    without, with_them = model.base.by_name(), model.fitted(chosen).by_name()
    held = {
        c.name: with_them[c.name]
        for c in kept
        if c.prior_sd > 0.0 and without[c.name] ** 2 - with_them[c.name] ** 2 > LEAST_GAIN * c.prior_sd**2
    }
    if len(kept) == len(model.nuisances) and not held:
        return model.screener
    target = [
        side - sum((held[c.name] * c.signal[k] for c in kept if c.name in held), np.zeros_like(side)) for k, side in enumerate(model.target)
    ]
    return Screener(model.whitener, [c for c in kept if c.name not in held], target)


@dataclass(frozen=True)
class _Improved:
    """What the effects do for an unseen recording: chi-square, and the rate that its mean leaves unexplained [rad/s]."""

    label: str
    gain: float
    before: float
    after: float
    has_rate: bool


def _closed(gain: float, foretold: float, left: float, noise: float) -> tuple[float, float]:
    """Closed fraction of a gap, and its sd.

    Parameters
    ----------
    gain : float
        Chi-square that the effects take away.
    foretold : float
        Square of what they say.
    left : float
        Chi-square that they leave, beyond the noise's.
    noise : float
        The noise's.
    """
    # gain = (2 b - 1) foretold, where what is there in the direction of what they say is b times it, and 1/foretold is the variance of b
    along = (0.5 * (gain / foretold - 1.0)) ** 2 * foretold - 1.0 if foretold > 0.0 else 0.0
    left = max(left, along, 0.0)
    gap = max(gain + left, 1.0)
    return gain / gap, math.hypot(2.0 * left * math.sqrt(foretold), gain * math.sqrt(2.0 * noise)) / gap**2
