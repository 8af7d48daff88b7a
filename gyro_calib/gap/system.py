"""The campaign's equations weighed with their noise, and their least-squares solution with priors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from .column import Column
from .evidence import CHANNELS, CampaignEvidence, RecordingEvidence
from .factored import factored
from .noise_law import NoiseLaw

__all__ = ["NoiseByRole", "Solution", "Whitener", "solve", "with_priors"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: (role, channel) -> density
NoiseByRole = Mapping[tuple[str, str], NoiseLaw]


@dataclass(frozen=True)
class Stack:
    """Columns side by side, a matrix for each recording: made once where the same columns are fitted at many noises."""

    columns: tuple[Column, ...]

    @cached_property
    def signal(self) -> list[ComplexArray]:
        """At the signal's lines, shape (m, k) each."""
        return [np.stack(of_all, axis=1) for of_all in zip(*(c.signal for c in self.columns), strict=True)]

    @cached_property
    def quiet(self) -> list[ComplexArray]:
        """At quiet lines."""
        return [np.stack(of_all, axis=1) for of_all in zip(*(c.quiet for c in self.columns), strict=True)]


@dataclass(frozen=True)
class Whitener:
    """Turns complex equations into real ones of unit noise: by recording the real parts, then the imaginary ones, along then across."""

    factors: tuple[tuple[FloatArray, FloatArray], ...]
    #: columns that were whitened before: the same effects are screened again and again
    _known: dict[int, tuple[Column, FloatArray]] = field(default_factory=dict, repr=False, compare=False)

    @cached_property
    def _inverses(self) -> list[tuple[FloatArray, FloatArray]]:
        return [(_inverse(re), _inverse(im)) for re, im in self.factors]

    @classmethod
    def of(cls, evidence: CampaignEvidence, noise: NoiseByRole, excess: Mapping[tuple[int, str], float] | None = None) -> Whitener:
        """Cholesky factors of the covariance of each recording's equations; ``excess``: by how much the noise of a recording's channel is
        larger than that of its kind.
        """
        more = excess or {}
        factors = []
        for r in evidence:
            pair = []
            for part in range(2):
                sides = []
                for channel in (CHANNELS[2 * side + part] for side in range(2)):
                    covariance = noise[r.noise_key(channel)].covariance(r.lines(channel), r.grams)
                    own = more.get((r.index, channel), 1.0) * _own_mean_apart(r, channel, covariance)
                    own[np.diag_indices_from(own)] *= 1.0 + 1e-12
                    sides.append(np.linalg.cholesky(own))
                pair.append(scipy.linalg.block_diag(*sides))
            factors.append((pair[0], pair[1]))
        return cls(tuple(factors))

    def channel(self, recording: int, part: int, side: int) -> FloatArray:
        """Factor of one channel of a recording: real or imaginary ``part``, along or across."""
        whole = self.factors[recording][part]
        count = len(whole) // 2
        rows = slice(side * count, (side + 1) * count)
        return whole[rows, rows]

    def rows(self, by_recording: Sequence[ComplexArray]) -> FloatArray:
        """Whitened real rows of vectors (m,) or matrices (m, k), recordings one below the other."""
        parts = []
        for (re, im), x in zip(self._inverses, by_recording, strict=True):
            parts += [re @ x.real, im @ x.imag]
        return np.concatenate(parts)

    def design(self, columns: Sequence[Column], count: int) -> FloatArray:
        """Whitened design, shape (rows, columns)."""
        fresh = [c for c in columns if id(c) not in self._known]
        if fresh:
            block = self.rows([np.stack([c.signal[k] for c in fresh], axis=1) for k in range(count)])
            self._known.update({id(c): (c, column) for c, column in zip(fresh, block.T.copy(), strict=True)})
        return np.stack([self._known[id(c)][1] for c in columns]).T


@dataclass(frozen=True)
class Solution:
    """A weighted least-squares solution.

    Parameters
    ----------
    columns : tuple of Column
    values : ndarray, shape (k,)
    covariance : ndarray, shape (k, k)
    residual : ndarray, shape (n,)
        Whitened, priors left out.
    chi2 : float
        With the priors.
    basis : ndarray, shape (n, k)
        Orthonormal columns (with priors: less than orthonormal): what the solution can follow. Leverages are its squared row sums.
    """

    columns: tuple[Column, ...]
    values: FloatArray
    covariance: FloatArray
    residual: FloatArray
    chi2: float
    basis: FloatArray

    def by_name(self) -> dict[str, float]:
        """Values by name."""
        return {c.name: float(v) for c, v in zip(self.columns, self.values, strict=True)}


def _inverse(factor: FloatArray) -> FloatArray:
    """Of a lower triangle."""
    return np.asarray(scipy.linalg.lapack.dtrtri(factor, lower=1)[0])


def _own_mean_apart(r: RecordingEvidence, channel: str, covariance: FloatArray) -> FloatArray:
    """Covariance of a channel's equations, a frequency's mean apart: what it is beyond the recording's own is no line's."""
    lines = r.lines(channel)
    if channel != "frequency" or not r.is_wave or not lines.is_mean.any():
        return covariance
    return np.where(lines.is_mean[:, None] == lines.is_mean, covariance, 0.0)


def with_priors(columns: Sequence[Column], design: FloatArray) -> FloatArray:
    """The design with a row for each finite prior below it: a size of zero, seen with the prior's standard deviation."""
    prior = np.array([c.prior_sd for c in columns])
    held = np.isfinite(prior)
    rows = np.zeros((int(held.sum()), len(columns)))
    rows[np.arange(rows.shape[0]), np.flatnonzero(held)] = 1.0 / prior[held]
    return np.vstack([design, rows])


def solve(columns: Sequence[Column], design: FloatArray, target: FloatArray) -> Solution:
    """Least squares with the columns' priors; directions that nothing tells are left at zero."""
    full = with_priors(columns, design)
    basis, factor = factored(full, target.size)
    whole = np.concatenate([target, np.zeros(full.shape[0] - target.size)])
    values = factor @ (basis.T @ whole)
    left = whole - full @ values
    return Solution(tuple(columns), values, factor @ factor.T, left[: target.size], float(left @ left), basis[: target.size])
