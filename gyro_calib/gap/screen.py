"""How much of the gap each effect explains that no nuisance does: projected screening, with evidence.

For whitened columns S of an effect and the nuisances' orthonormal basis Q (their priors included as rows), S~ = (I - Q Q^T) S is what the
nuisances cannot imitate, and T = |U^T e|^2 with U = orth(S~) the chi-square it takes away. With a Gaussian prior of covariance L the
evidence against none has the closed form ``ln B = b^T (F + L^-1)^-1 b / 2 - ln det(1 + L F) / 2``, b = S~^T e, F = S~^T S~. L is that of
the registry's typical sizes times a common factor that nobody knows, from 1 down to where nothing of it shows: one device has an effect a
thousand times smaller than another, but not one of its gains without the others. So the factor is paid for once, not by every size.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .column import Column
from .factored import factored
from .parts import Setting
from .system import Whitener, with_priors

__all__ = ["Candidate", "Screened", "Screener", "worth"]

FloatArray = NDArray[np.float64]
#: singular values below this share of the column's norm are directions that the nuisances imitate; of an effect that a healthy device has
#: as well, and that is larger than a healthy device has it, the nuisance is the effect itself and imitates it but for its prior
_ABSORBED, _ABSORBED_BY_ITSELF = 1e-4, 1e-6
#: effects that are nuisances of another name; others bear that of the effect
_HEALTHY = {
    "rate_mismatch_im": "multiplexing_skew",
    "rate_anti_re": "angular_gain_error",
    "rate_per_k": "thermal_bias",
    "frequency_per_k2": "thermal_frequency_curvature",
    "damping_per_k2": "thermal_damping_curvature",
}
#: log of a direction's prior range over its standard deviation: sizes of thirty standard deviations are no surprise
_PRICE = 3.4
#: factors of the prior's variances that are tried, from one to the next
_FACTOR = 10.0**-0.5


def worth(gain: float, directions: int, choices: int) -> float:
    """Log evidence with the same price for every direction: an unnamed term has no usual size from which its prior could be had.

    Parameters
    ----------
    gain : float
        Chi-square that it takes away.
    directions : int
        In which it does.
    choices : int
        How many of its kind were tried.
    """
    return 0.5 * gain - _PRICE * directions - math.log(choices)


@dataclass(frozen=True)
class Candidate:
    """An effect at one setting of its non-linear parameters.

    Parameters
    ----------
    name : str
    setting : mapping
    columns : tuple of Column
    prior_sd : ndarray, shape (k,)
    choices : int
        Settings that the effect was tried at: what the search costs.
    """

    name: str
    setting: Setting
    columns: tuple[Column, ...]
    prior_sd: FloatArray
    choices: int = 1


@dataclass(frozen=True)
class Screened:
    """What a candidate explains.

    Parameters
    ----------
    candidate : Candidate
    gain : float
        Chi-square that it takes away.
    rank : int
        Independent directions that the nuisances leave of it and in which it may be larger than the noise.
    log_evidence : float
        Against none, the search over settings paid for.
    values, sd : ndarray, shape (k,)
        Estimated size.
    absorbed : float
        Share of the columns' norm that the nuisances imitate.
    directions : ndarray, shape (n, rank)
        Orthonormal: what it looks like in the data.
    """

    candidate: Candidate
    gain: float
    rank: int
    log_evidence: float
    values: FloatArray
    sd: FloatArray
    absorbed: float
    directions: FloatArray = field(repr=False)

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.candidate.name

    def sizes(self) -> dict[str, tuple[float, float]]:
        """Value and sd of every parameter."""
        return {c.name: (float(v), float(s)) for c, v, s in zip(self.candidate.columns, self.values, self.sd, strict=True)}


class Screener:
    """Screens candidates against one set of nuisances.

    Parameters
    ----------
    whitener : Whitener
    nuisances : sequence of Column
    target : sequence of ndarray, complex
        Left-hand sides by recording, turned.

    Attributes
    ----------
    basis : ndarray, shape (n, r)
        Orthonormal: what the nuisances imitate, rows of their priors below the equations'.
    left : ndarray, shape (n,)
        What they leave.
    rows : int
        Equations.
    chi2 : float
    dof : int
    """

    def __init__(self, whitener: Whitener, nuisances: Sequence[Column], target: Sequence[NDArray[np.complex128]]) -> None:
        self._whitener, self._count = whitener, len(target)
        self._healthy = {_HEALTHY.get(c.name, c.name.split(".")[0]) for c in nuisances}
        design = whitener.design(nuisances, self._count)
        full = with_priors(nuisances, design)
        self.basis = factored(full, design.shape[0])[0]
        self._pad = full.shape[0] - design.shape[0]
        self.rows = design.shape[0]
        whole = np.concatenate([whitener.rows(target), np.zeros(self._pad)])
        self.left = whole - self.imitated(whole)
        self.chi2 = float(self.left @ self.left)
        self.dof = self.rows + self._pad - self.basis.shape[1]

    def projected(self, columns: Sequence[Column]) -> tuple[FloatArray, FloatArray]:
        """Whitened columns with the nuisances taken out, and their norms before."""
        raw = self._whitener.design(columns, self._count)
        return self.cleaned(raw), np.linalg.norm(raw, axis=0)

    def imitated(self, whole: FloatArray) -> FloatArray:
        """What the nuisances make of equations with their priors below, shape (n,)."""
        return np.asarray(self.basis @ (self.basis.T @ whole))

    def cleaned(self, whitened: FloatArray) -> FloatArray:
        """Whitened columns, shape (rows, k), with the nuisances taken out: rows of their priors added."""
        left = -self.basis @ (self.basis[: self.rows].T @ whitened)
        left[: self.rows] += whitened
        return np.asarray(left)

    def screen(self, candidate: Candidate) -> Screened | None:
        """What a candidate explains; nothing when no recording holds it or the nuisances imitate all of it."""
        return self._judged(candidate, *self.projected(candidate.columns))

    def taken(self, found: Screened) -> float:
        """Chi-square that a candidate of a size that was found elsewhere takes away; below zero where it does not belong."""
        clean, _ = self.projected(found.candidate.columns)
        rest = self.left - clean @ found.values
        return self.chi2 - float(rest @ rest)

    def screened(self, candidates: Iterable[Candidate]) -> list[Screened]:
        """What each of many explains, without those that explain nothing: in one product, which takes a fraction of the time."""
        of_all = list(candidates)
        if not of_all:
            return []
        clean, norms = self.projected([column for c in of_all for column in c.columns])
        ends = np.cumsum([len(c.columns) for c in of_all])[:-1]
        parts = zip(of_all, np.split(clean, ends, axis=1), np.split(norms, ends), strict=True)
        return [found for each in parts if (found := self._judged(*each)) is not None]

    def _judged(self, candidate: Candidate, clean: FloatArray, norms: FloatArray) -> Screened | None:
        used = norms > 0.0
        if not used.any():
            return None
        scale = np.where(used, norms, 1.0)
        u, s, vt = np.linalg.svd(clean / scale, full_matrices=False)
        kept = s > (_ABSORBED_BY_ITSELF if candidate.name in self._healthy else _ABSORBED)
        absorbed = 1.0 - float(np.min(np.linalg.norm(clean[:, used], axis=0) / norms[used]))
        if not kept.any():
            return None
        u, s, vt = u[:, kept], s[kept], vt[kept]
        inside = u.T @ self.left
        values = vt.T @ (inside / s) / scale
        sd = np.sqrt(np.sum((vt.T / s) ** 2, axis=1)) / scale
        # in the directions that the nuisances leave: prior variances of what they hold, and the data there
        told = (s[:, None] * vt) * (scale * candidate.prior_sd)
        variances, axes = np.linalg.eigh(told @ told.T)
        variances = np.maximum(variances, 0.0)
        log_evidence = _log_evidence(variances, (axes.T @ inside) ** 2) - math.log(candidate.choices)
        return Screened(candidate, float(inside @ inside), max(int((variances > 1.0).sum()), 1), log_evidence, values, sd, absorbed, u)


def _log_evidence(variances: FloatArray, squares: FloatArray) -> float:
    """Against none, of what is there in independent directions, with prior variances up to these: the mean over their common factor."""
    count = 1 + int(math.log(max(float(variances.max()), 1.0)) / -math.log(_FACTOR))
    tried = variances * _FACTOR ** np.arange(count)[:, None]
    each = 0.5 * np.sum(tried / (1.0 + tried) * squares - np.log1p(tried), axis=1)
    most = float(each.max())
    return most + math.log(float(np.mean(np.exp(each - most))))
