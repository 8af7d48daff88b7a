"""Density of a channel's noise on the test functions of one recording: white, flicker, random walk, pick-off noise and gains through L.

White noise of the pick-offs enters through the derivative of the test function, so its variance is the integral of phi'^2, known for each
function; ``f^2`` would be right for an endless window, and short records are far from that. What wanders with the resonance is relative to
the amplitude; what the pick-off adds is not.

A pick-off's gain with a 1/f floor is another matter: through L its density rises with f, and it is heard as far as its axis moves. The
practice devices' y read-out has one and their x read-out none, so that a wave on x is ten times as quiet as one on y and one that turns
is quiet twice in a turn. Taken for white, that floor hides what is small and slow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import zip_longest
from typing import NamedTuple, TypeVar

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from .whittle import likeliest, likeliest_of_each

__all__ = [
    "IN_PHASE",
    "PICKOFF",
    "WHITE",
    "Grams",
    "Lines",
    "NoiseLaw",
    "beside_floors",
    "fit_law",
    "floors_heard",
    "gain_floors",
    "without_outliers",
]

FloatArray = NDArray[np.float64]
Key = TypeVar("Key")
#: what a further term must gain beyond the information criterion, twice the log likelihood: strong evidence
_EXTRA_TERM = 6.0
#: neighbours whose median tells what is an outlier; cap over their mean; median of chi-square with one degree of freedom
_NEIGHBOURS, _CAP, _MEDIAN = 41, 9.0, 0.455
#: noise of its own that a kind has beside a floor of gains, over the median kind's
_OWN_SHARE = 0.3
#: places of two terms among the coefficients
WHITE, PICKOFF = 0, 2
#: terms of a basis that hears no floors, and with those of one kind on both axes, as a wave's channel does
_PLAIN_TERMS, _OF_WAVES = 4, 6
#: a wave's channels that hear the pick-offs' gains; the others hear their phases
IN_PHASE = ("amplitude", "precession")
_TERMS = ((0,), (0, 1), (0, 2), (0, 3), (0, 1, 2), (0, 2, 3))
_FAST_TERMS = ((0,), (0, 2))


@dataclass(frozen=True)
class Lines:
    """The test functions of a recording's channel.

    Parameters
    ----------
    frequency_hz : ndarray, shape (m,)
        Effective one where flicker and walk are cut off (a mean's is about a third of one over its record).
    slope_hz2 : ndarray, shape (m,)
        Integral of phi'^2 over (2 pi)^2.
    scale : float
        Squared amplitude that white, flicker and walk are relative to.
    is_mean : ndarray of bool, shape (m,)
    walk_s2 : ndarray, shape (m,), optional
        What a walk of density 1/f^2 comes to on each but a mean [s^2]; left out: that of endless windows.
    floors : ndarray, shape (2, m, m) or (4, m, m), optional
        Covariance that gains of the x and of the y pick-off, or their phases, or first those and then these bring, each with a floor of
        density 1/f [V^2/s]; left out: not heard.
    """

    frequency_hz: FloatArray
    slope_hz2: FloatArray
    scale: float
    is_mean: NDArray[np.bool_]
    walk_s2: FloatArray | None = None
    floors: FloatArray | None = None

    def basis(self) -> FloatArray:
        """Densities of the terms, shape (m, 4): white, flicker, pick-off, walk; or (m, 6) and (m, 8), with floors of x and y."""
        return self._basis

    @cached_property
    def _basis(self) -> FloatArray:
        f = self.frequency_hz
        walk = f**-2.0 if self.walk_s2 is None else np.where(self.is_mean, f**-2.0, self.walk_s2)
        heard = () if self.floors is None else np.diagonal(self.floors, axis1=1, axis2=2)
        return np.column_stack([np.full(f.size, self.scale), self.scale / f, self.slope_hz2, self.scale * walk, *heard])


class Grams(NamedTuple):
    """Inner products of test functions, shape (m, m) each: theirs, and what a walk of density 1/f^2 brings [s^2]."""

    value: FloatArray
    walk: FloatArray


@dataclass(frozen=True)
class NoiseLaw:
    """Coefficients of white, flicker, pick-off, walk; ``mean``: what repeated records differ by at their mean beyond that; ``floors``: of
    both pick-offs at 1 Hz, of their gains [1/Hz] or phases [rad^2/Hz], or of both, as :class:`Lines` hears them.
    """

    coefficients: tuple[float, float, float, float]
    mean: float = 0.0
    floors: tuple[float, ...] = (0.0, 0.0)

    def density(self, lines: Lines) -> FloatArray:
        """Density on each test function."""
        basis = lines.basis()
        known = np.array((*self.coefficients, *self.floors, 0.0, 0.0))[: basis.shape[1]]
        return np.asarray(basis @ known + self.mean * lines.scale * lines.is_mean)

    def covariance(self, lines: Lines, grams: Grams) -> FloatArray:
        """Covariance, shape (m, m): of a walk and of floors as ``lines`` know it, of all else correlated as white noise is."""
        if lines.floors is not None and any(self.floors):
            rest = replace(self, floors=(0.0, 0.0)).covariance(replace(lines, floors=None), grams)
            return np.asarray(rest + np.tensordot(np.array(self.floors), lines.floors[: len(self.floors)], axes=1))
        densities = self.density(lines)
        if lines.walk_s2 is None:
            sd = np.sqrt(densities)
            return np.asarray(np.outer(sd, sd) * grams.value)
        white, flicker, pickoff, walk = self.coefficients
        wide, steep = lines.frequency_hz**-0.5, np.sqrt(lines.slope_hz2)
        alike = lines.scale * (white + flicker * np.outer(wide, wide)) + pickoff * np.outer(steep, steep)
        total = alike * grams.value + walk * lines.scale * grams.walk
        total[np.diag_indices_from(total)] = densities
        return np.asarray(total)

    @property
    def slow_part(self) -> NoiseLaw:
        """What of the noise goes on from record to record: flicker, walk, and what means differ by."""
        _, flicker, _, walk = self.coefficients
        return replace(self, coefficients=(0.0, flicker, 0.0, walk), floors=(0.0, 0.0))

    def slow(self, lines: Lines) -> FloatArray:
        """Density of the slow part."""
        return self.slow_part.density(lines)

    def times(self, factor: float) -> NoiseLaw:
        """The law of a noise that is so much larger in power."""
        white, flicker, pickoff, walk = (factor * c for c in self.coefficients)
        return NoiseLaw((white, flicker, pickoff, walk), factor * self.mean, self._floors_times(factor))

    def floor(self, share: float) -> NoiseLaw:
        """A share of what is not slow: neither flicker nor walk, which an effect looks like."""
        white, _, pickoff, _ = self.coefficients
        return NoiseLaw((share * white, 0.0, share * pickoff, 0.0), floors=self._floors_times(share))

    def _floors_times(self, factor: float) -> tuple[float, ...]:
        return tuple(factor * floor for floor in self.floors)

    def at_most(self, term: int, limit: float) -> NoiseLaw:
        """The law with one of its terms no larger than that."""
        white, flicker, pickoff, walk = (min(c, limit) if k == term else c for k, c in enumerate(self.coefficients))
        return replace(self, coefficients=(white, flicker, pickoff, walk))

    def of_drives(self) -> NoiseLaw:
        """What drives add, whatever the wave does."""
        white, flicker, _, _ = self.coefficients
        return NoiseLaw((white, flicker, 0.0, 0.0))

    def not_below(self, other: NoiseLaw) -> NoiseLaw:
        """Term by term the larger one."""
        white, flicker, pickoff, walk = (max(a, b) for a, b in zip(self.coefficients, other.coefficients, strict=True))
        floors = tuple(max(a, b) for a, b in zip_longest(self.floors, other.floors, fillvalue=0.0))
        return NoiseLaw((white, flicker, pickoff, walk), max(self.mean, other.mean), floors)


def fit_law(
    basis: FloatArray, squares: FloatArray, *, slow: bool = True, capped: bool = True, floors: tuple[float, ...] = (0.0, 0.0)
) -> NoiseLaw:
    """Non-negative coefficients by the Whittle likelihood; a term beyond white is kept only when the data ask for it.

    Parameters
    ----------
    basis : ndarray, shape (n, 4), (n, 6) or (n, 8)
        From :meth:`Lines.basis`.
    squares : ndarray, shape (n,)
        Squared projections, each chi-square with one degree of freedom.
    slow : bool
        Whether there may be flicker and walk.
    capped : bool
        Whether what is far above its neighbours' median is an outlier; the end of a steep spectrum is, too.
    floors : tuple of float
        Of the pick-offs, known.
    """
    known = basis[:, _PLAIN_TERMS:] @ np.array((*floors, 0.0, 0.0))[: basis.shape[1] - _PLAIN_TERMS]
    if capped:
        # records on an axis whose gain has no floor are no measure of the others
        loud = 1.0 + known / max(float(np.median(squares)), 1e-300)
        squares = loud * without_outliers(basis[:, 2], squares / loud)
    models = _TERMS if slow else _FAST_TERMS
    found = likeliest_of_each(models, basis[:, :4], squares, known)
    scores = [_surprise(known + basis[:, :4] @ x, squares) for x in found]
    best = found[np.argmin([s + len(terms) * (np.log(squares.size) + _EXTRA_TERM) for s, terms in zip(scores, models, strict=True)])]
    white, flicker, pickoff, walk = map(float, best)
    return NoiseLaw((white, flicker, pickoff, walk), floors=floors)


def floors_heard(
    basis: Mapping[tuple[str, str], Sequence[FloatArray]],
    squares: Mapping[tuple[str, str], Sequence[FloatArray]],
    phases: tuple[float, float],
) -> dict[tuple[str, str], tuple[float, ...]]:
    """Floors of every kind of recording and channel, as it hears them: gains, phases, or first those and then these.

    Parameters
    ----------
    basis, squares : mapping
        By role and channel, see :func:`gain_floors`.
    phases : tuple of float
        Of both pick-offs' phases [rad^2/Hz].
    """
    waves = [key for key, of_key in basis.items() if of_key[0].shape[1] == _OF_WAVES]
    in_phase = [key for key in waves if key[1] in IN_PHASE]
    gains = gain_floors([(basis[key], squares[key]) for key in in_phase])
    return {**dict.fromkeys(basis, (*gains, *phases)), **dict.fromkeys(waves, phases), **dict.fromkeys(in_phase, gains)}


def gain_floors(kinds: Sequence[tuple[Sequence[FloatArray], Sequence[FloatArray]]]) -> tuple[float, float]:
    """Floors of both pick-offs' gains [1/Hz], of one size in all kinds of recordings, each with its own white and pick-off noise.

    Parameters
    ----------
    kinds : sequence of (sequence of ndarray, sequence of ndarray)
        Of each recording the basis, shape (n, 6), and the squares, shape (n,).
    """
    if not kinds:
        return 0.0, 0.0
    parts = [part for bases, found in kinds for part in zip(bases, found, strict=True)]
    squares = np.concatenate([without_outliers(basis[:, 2], found) for basis, found in parts if found.size])
    whole = [np.concatenate(bases) for bases, _ in kinds]
    own, heard = scipy.linalg.block_diag(*(basis[:, [WHITE, PICKOFF]] for basis in whole)), np.concatenate(whole)[:, 4:]
    best, best_score = np.zeros(2), np.inf
    for axes in ((), (0,), (1,), (0, 1)):
        columns = np.hstack([own, heard[:, axes]])
        found = likeliest(columns, squares)
        score = _surprise(columns @ found, squares) + len(axes) * (np.log(squares.size) + _EXTRA_TERM)
        if score < best_score:
            best, best_score = np.zeros(2), score
            best[list(axes)] = found[own.shape[1] :]
    return float(best[0]), float(best[1])


def beside_floors(laws: Mapping[Key, NoiseLaw]) -> dict[Key, NoiseLaw]:
    """Laws of kinds beside floors: each with white and pick-off noise of its own, at least a share of the median kind's.

    A floor alone leaves directions without noise, a fit that meets them is wrong by anything, and the next one finds no floor.
    """
    out = dict(laws)
    for term in (WHITE, PICKOFF):
        sizes = [law.coefficients[term] for law in laws.values() if any(law.floors) and law.coefficients[term] > 0.0]
        least = _OWN_SHARE * float(np.median(sizes)) if sizes else 0.0
        own = NoiseLaw((least, 0.0, 0.0, 0.0) if term == WHITE else (0.0, 0.0, least, 0.0))
        out = {key: law.not_below(own) if any(law.floors) else law for key, law in out.items()}
    return out


def _surprise(expected: FloatArray, squares: FloatArray) -> float:
    """Twice the negative log likelihood, but for a constant."""
    expected = np.maximum(expected, 1e-300)
    return float(np.sum(np.log(expected) + squares / expected))


def without_outliers(order: FloatArray, squares: FloatArray) -> FloatArray:
    """Squares no larger than what noise of the neighbours' median gives once in some thousand: a stranger is not their noise."""
    place = np.argsort(order, kind="stable")
    sorted_squares = squares[place]
    width = min(_NEIGHBOURS, squares.size)
    windows = np.lib.stride_tricks.sliding_window_view(sorted_squares, width)
    medians = np.median(windows, axis=1)
    nearest = np.clip(np.arange(squares.size) - width // 2, 0, medians.size - 1)
    capped = np.empty_like(squares)
    capped[place] = np.minimum(sorted_squares, _CAP * medians[nearest] / _MEDIAN)
    return capped
