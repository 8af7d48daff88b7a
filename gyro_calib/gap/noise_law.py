"""Density of a channel's noise on the test functions of one recording: white, flicker, random walk, and pick-off noise through L.

White noise of the pick-offs enters through the derivative of the test function, so its variance is the integral of phi'^2, known for each
function; ``f^2`` would be right for an endless window, and short records are far from that. What wanders with the resonance is relative to
the amplitude; what the pick-off adds is not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

__all__ = ["PICKOFF", "WHITE", "Grams", "Lines", "NoiseLaw", "fit_law"]

FloatArray = NDArray[np.float64]
#: what a further term must gain beyond the information criterion, twice the log likelihood: strong evidence
_EXTRA_TERM = 6.0
#: neighbours whose median tells what is an outlier; cap over their mean; median of chi-square with one degree of freedom
_NEIGHBOURS, _CAP, _MEDIAN = 41, 9.0, 0.455
#: places of two terms among the coefficients
WHITE, PICKOFF = 0, 2
_TERMS = ((0,), (0, 1), (0, 2), (0, 3), (0, 1, 2), (0, 2, 3))
_FAST_TERMS = ((0,), (0, 2))
#: rounds of the reweighted fit, and by how much it may still change
_MOST_ROUNDS, _SETTLED = 15, 1e-4


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
    """

    frequency_hz: FloatArray
    slope_hz2: FloatArray
    scale: float
    is_mean: NDArray[np.bool_]
    walk_s2: FloatArray | None = None

    def basis(self) -> FloatArray:
        """Densities of the four terms, shape (m, 4): white, flicker, pick-off, walk."""
        f = self.frequency_hz
        walk = f**-2.0 if self.walk_s2 is None else np.where(self.is_mean, f**-2.0, self.walk_s2)
        return np.column_stack([np.full(f.size, self.scale), self.scale / f, self.slope_hz2, self.scale * walk])


class Grams(NamedTuple):
    """Inner products of test functions, shape (m, m) each: theirs, and what a walk of density 1/f^2 brings [s^2]."""

    value: FloatArray
    walk: FloatArray


@dataclass(frozen=True)
class NoiseLaw:
    """Coefficients of white, flicker, pick-off, walk; ``mean``: what repeated records differ by at their mean beyond that."""

    coefficients: tuple[float, float, float, float]
    mean: float = 0.0

    def density(self, lines: Lines) -> FloatArray:
        """Density on each test function."""
        return np.asarray(lines.basis() @ np.array(self.coefficients) + self.mean * lines.scale * lines.is_mean)

    def covariance(self, lines: Lines, grams: Grams) -> FloatArray:
        """Covariance, shape (m, m): of a walk that ``lines`` know as ``grams`` has it, of all else correlated as white noise is."""
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
        return replace(self, coefficients=(0.0, flicker, 0.0, walk))

    def slow(self, lines: Lines) -> FloatArray:
        """Density of the slow part."""
        return self.slow_part.density(lines)

    def times(self, factor: float) -> NoiseLaw:
        """The law of a noise that is so much larger in power."""
        white, flicker, pickoff, walk = (factor * c for c in self.coefficients)
        return NoiseLaw((white, flicker, pickoff, walk), factor * self.mean)

    def floor(self, share: float) -> NoiseLaw:
        """A share of what is not slow: neither flicker nor walk, which an effect looks like."""
        white, _, pickoff, _ = self.coefficients
        return NoiseLaw((share * white, 0.0, share * pickoff, 0.0))

    def at_most(self, term: int, limit: float) -> NoiseLaw:
        """The law with one of its terms no larger than that."""
        white, flicker, pickoff, walk = (min(c, limit) if k == term else c for k, c in enumerate(self.coefficients))
        return replace(self, coefficients=(white, flicker, pickoff, walk))

    def not_below(self, other: NoiseLaw) -> NoiseLaw:
        """Term by term the larger one."""
        white, flicker, pickoff, walk = (max(a, b) for a, b in zip(self.coefficients, other.coefficients, strict=True))
        return NoiseLaw((white, flicker, pickoff, walk), max(self.mean, other.mean))


def fit_law(basis: FloatArray, squares: FloatArray, *, slow: bool = True, capped: bool = True) -> NoiseLaw:
    """Non-negative coefficients by the Whittle likelihood; a term beyond white is kept only when the data ask for it.

    Parameters
    ----------
    basis : ndarray, shape (n, 4)
        From :meth:`Lines.basis`.
    squares : ndarray, shape (n,)
        Squared projections, each chi-square with one degree of freedom.
    slow : bool
        Whether there may be flicker and walk.
    capped : bool
        Whether what is far above its neighbours' median is an outlier; the end of a steep spectrum is, too.
    """
    squares = _without_outliers(basis[:, 2], squares) if capped else squares
    best, best_score = np.zeros(4), np.inf
    for terms in _TERMS if slow else _FAST_TERMS:
        coefficients = np.zeros(4)
        coefficients[list(terms)] = _whittle(basis[:, terms], squares)
        expected = np.maximum(basis @ coefficients, 1e-300)
        score = float(np.sum(np.log(expected) + squares / expected)) + len(terms) * (np.log(squares.size) + _EXTRA_TERM)
        if score < best_score:
            best, best_score = coefficients, score
    white, flicker, pickoff, walk = map(float, best)
    return NoiseLaw((white, flicker, pickoff, walk))


def _without_outliers(order: FloatArray, squares: FloatArray) -> FloatArray:
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


def _whittle(basis: FloatArray, squares: FloatArray) -> FloatArray:
    """Reweighted non-negative least squares; the fixed point maximises the likelihood."""
    size = np.maximum(basis.mean(axis=0), 1e-300)
    scaled = basis / size
    expected = np.full(squares.size, max(float(squares.mean()), 1e-300))
    found = np.zeros(basis.shape[1])
    for _ in range(_MOST_ROUNDS):
        before = found
        found, _ = nnls(scaled / expected[:, None], squares / expected)
        if np.all(np.abs(found - before) <= _SETTLED * (before + found.max(initial=0.0))):
            break
        expected = np.maximum(scaled @ found, 1e-6 * float(squares.mean()) + 1e-300)
    return np.asarray(found / size)
