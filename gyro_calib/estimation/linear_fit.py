"""Weighted linear least squares of the projected slow flow: A, G~, E and the body response, one complex equation per axis.

Noise is measured, not assumed: the residual of the same recordings at neighbouring lines, where nothing was commanded, gives its density as
``c_0 + c_1 / f + c_2 f^2`` (force noise, flicker, pick-off noise), separately for the in-phase and the 90-degree part.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.linalg.lapack import dtrtri

from ..errors import CalibrationRefused

__all__ = ["AXES", "Equation", "LinearFit", "NoiseModel", "fit_axis", "fit_noise", "fit_noises"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
AXES = ("x", "y")
#: what a further noise term must gain beyond the information criterion, twice the log likelihood: strong evidence
_EXTRA_TERM = 6.0
#: which of white noise, flicker, pick-off noise and a random walk a density may hold; rounds of reweighting; what keeps terms that are
#: alike from being singular
_DENSITIES, _REWEIGHTED, _RIDGE = ((0,), (0, 1), (0, 2), (0, 3), (0, 1, 2), (0, 2, 3)), 12, 1e-12


def _subsets() -> tuple[NDArray[np.intp], NDArray[np.bool_], FloatArray, NDArray[np.bool_]]:
    """Every subset of each density's terms: of which density, what is in it, the diagonal that leaves the rest at zero; whose each is."""
    pairs = [(k, s) for k, terms in enumerate(_DENSITIES) for count in range(len(terms)) for s in combinations(terms, count + 1)]
    inside = np.array([[term in subset for term in range(4)] for _, subset in pairs])
    of = np.array([k for k, _ in pairs])
    return of, inside, np.where(inside, _RIDGE, 1.0)[:, :, None] * np.eye(4), of == np.arange(len(_DENSITIES))[:, None]


_SUBSETS = _subsets()


@dataclass(frozen=True)
class NoiseModel:
    """Two-sided density ``c_0 + c_1/f + c_2 f^2 + walk/f^2`` of the residual [V^2/s^2/Hz], constant below ``lowest_hz``.

    ``carrier`` is what recordings differ by from one another beyond that, at the carrier line itself (wander slower than a record).
    """

    coefficients: tuple[float, float, float]
    lowest_hz: float
    carrier: float = 0.0
    walk: float = 0.0

    def density(self, frequency_hz: FloatArray, slope_hz: FloatArray | None = None) -> FloatArray:
        """Density at each frequency, shape as the argument; ``slope_hz``: see :func:`fit_noise`."""
        f = np.maximum(np.abs(frequency_hz), self.lowest_hz)
        c = self.coefficients
        smooth = c[0] + c[1] / f + c[2] * (f if slope_hz is None else slope_hz) ** 2 + self.walk / f**2
        return np.asarray(smooth + self.carrier * (np.asarray(frequency_hz) == 0.0))


def fit_noise(frequency_hz: FloatArray, squares: FloatArray, lowest_hz: float, slope_hz: FloatArray | None = None) -> NoiseModel:
    """Fit the density to squared residual projections (each chi-square with one degree of freedom), non-negative coefficients.

    A flicker, random-walk (a resonance that wanders) or pick-off term is kept only when the data ask for it (Bayesian information
    criterion on the Whittle likelihood): a term that only chance put there would be carried by 1/f to the carrier line and cost most of
    its weight. ``lowest_hz`` is where flicker is cut off: the effective frequency of the carrier line of a record, about a third of its
    1/duration. ``slope_hz`` is the rms slope of each test function over 2 pi, which is what pick-off noise enters with: near the carrier
    the ends of the window make it far larger than the line.
    """
    (model,) = fit_noises(frequency_hz, squares[None], lowest_hz, slope_hz)
    return model


def fit_noises(frequency_hz: FloatArray, squares: FloatArray, lowest_hz: float, slope_hz: FloatArray | None = None) -> list[NoiseModel]:
    """:func:`fit_noise` of several channels at the same lines, ``squares`` of shape (channels, lines)."""
    f = np.maximum(np.abs(frequency_hz), lowest_hz)
    basis = np.column_stack([np.ones_like(f), 1.0 / f, (f if slope_hz is None else slope_hz) ** 2, 1.0 / f**2])
    fitted = _whittle_fits(basis, squares)
    expected = np.maximum(fitted @ basis.T, 1e-300)
    price = np.array([len(terms) for terms in _DENSITIES]) * (np.log(squares.shape[1]) + _EXTRA_TERM)
    scores = np.sum(np.log(expected) + squares[:, None] / expected, axis=2) + price
    best = fitted[np.arange(len(fitted)), np.argmin(scores, axis=1)]
    return [NoiseModel((white, flicker, pickoff), lowest_hz, walk=walk) for white, flicker, pickoff, walk in best.tolist()]


def _whittle_fits(basis: FloatArray, squares: FloatArray) -> FloatArray:
    """Non-negative coefficients of every channel and density, shape (channels, densities, 4).

    By reweighted least squares, whose fixed point maximises the Whittle likelihood.
    """
    scale, mean = basis.max(axis=0), np.maximum(squares.mean(axis=1), 1e-300)[:, None]
    basis, squares = basis / scale, squares / mean
    products = (basis[:, :, None] * basis[:, None, :]).reshape(len(basis), -1)
    expected = np.ones((len(squares), len(_DENSITIES), squares.shape[1]))
    for _ in range(_REWEIGHTED):
        weight = expected**-2.0
        gram = (weight @ products).reshape(*weight.shape[:2], 4, 4)
        coefficients = _non_negative(gram, (weight * squares[:, None]) @ basis)
        expected = np.maximum(coefficients @ basis.T, 1e-4)
    return np.asarray(coefficients * mean[..., None] / scale)


def _non_negative(gram: FloatArray, moments: FloatArray) -> FloatArray:
    """Non-negative least squares of every density: of all its terms' subsets that one whose free solution is positive and explains most."""
    size = np.sqrt(np.diagonal(gram, axis1=2, axis2=3))
    gram, moments = gram / (size[..., :, None] * size[..., None, :]), moments / size
    of, inside, alone, own = _SUBSETS
    right = np.where(inside, moments[:, of], 0.0)
    solved = np.linalg.solve(np.where(inside[:, :, None] & inside[:, None, :], gram[:, of], 0.0) + alone, right[..., None])[..., 0]
    explained = np.where((solved >= 0.0).all(axis=2), np.sum(solved * right, axis=2), -np.inf)
    best = np.argmax(np.where(own, explained[:, None], -np.inf), axis=2)
    return np.asarray(np.maximum(np.take_along_axis(solved, best[..., None], axis=1), 0.0) / size)


@dataclass(frozen=True)
class Equation:
    """The equations of one recording for one axis.

    Parameters
    ----------
    lhs : ndarray, shape (m,), complex
    regressors : ndarray, shape (m, k), complex
        Columns in the order of the coefficients' names.
    gram : ndarray, shape (m, m)
    sd_re, sd_im : ndarray, shape (m,)
        Noise of real and imaginary part of each equation.
    detuning : ndarray, shape (m, k), complex, or None
        Regressors of this recording's own resonance shift (``i lambda p``): constant and steady when the axis oscillates, constant in open
        drive. A column times -i is a real unknown of the recording of any kind.
    detuning_sd : float or ndarray, shape (k,)
        How large the shift may be [rad/s]; infinite where the recording itself determines it.
    covariance : tuple of 2 ndarray, shape (m, m), or None
        Of the noise of real and of imaginary parts, where ``gram`` and their deviations do not say all of it.
    shared : ndarray, shape (m, q), or None
        What sources of unit variance that all recordings share (independent ones for real and imaginary parts) add to the noise.
    """

    lhs: ComplexArray
    regressors: ComplexArray
    gram: FloatArray
    sd_re: FloatArray
    sd_im: FloatArray
    detuning: ComplexArray | None = None
    detuning_sd: float | FloatArray = float("inf")
    covariance: tuple[FloatArray, FloatArray] | None = None
    shared: FloatArray | None = None


@dataclass(frozen=True)
class LinearFit:
    """Estimate of one axis.

    Parameters
    ----------
    coefficients : ndarray, shape (k,), complex
    covariance : ndarray, shape (2k, 2k)
        Of (Re c_0, Im c_0, Re c_1, …).
    chi2, dof : float, int
        Weighted residual and its degrees of freedom.
    condition_number : float
        Of the column-scaled weighted design matrix.
    residuals : tuple of ndarray, complex
        Per recording, unweighted.
    detunings : tuple of ndarray, shape (k, 2)
        Per recording, its own resonance shift [rad/s] and the standard deviation of it; empty where none was sought.
    explained : tuple of ndarray, complex
        Per recording, variance of what the fit took out of each equation's real part, and (as imaginary part) of its imaginary one: its
        residual has that much less than its noise.
    shared : tuple of ndarray, complex
        Per recording, what the sources that all share most probably add to its equations; empty without such sources.
    shared_growth : float
        Variance that these sources show over the one that was assumed (MacKay's fixed point of the evidence).
    """

    coefficients: ComplexArray
    covariance: FloatArray
    chi2: float
    dof: int
    condition_number: float
    residuals: tuple[ComplexArray, ...]
    detunings: tuple[FloatArray, ...] = ()
    explained: tuple[ComplexArray, ...] = ()
    shared: tuple[ComplexArray, ...] = ()
    shared_growth: float = 1.0


@dataclass(frozen=True)
class _Whitener:
    """Inverse Cholesky factors of the covariance of real (or imaginary) parts: of every recording, or of all together."""

    blocks: list[FloatArray]

    def __call__(self, rows: FloatArray) -> FloatArray:
        ends = np.cumsum([len(b) for b in self.blocks])[:-1]
        return np.concatenate([b @ part for b, part in zip(self.blocks, np.split(rows, ends), strict=True)])

    @classmethod
    def of(cls, equations: list[Equation], imaginary: bool, factor: FloatArray) -> _Whitener:
        covariances = []
        for e in equations:
            sd = e.sd_im if imaginary else e.sd_re
            covariances.append(e.gram * np.outer(sd, sd) if e.covariance is None else e.covariance[int(imaginary)])
        if factor.shape[1] > 0:
            covariances = [block_diag(*covariances) + factor @ factor.T]
        return cls([np.asarray(dtrtri(np.linalg.cholesky(c), lower=1)[0]) for c in covariances])


def _shared_factor(equations: list[Equation]) -> FloatArray:
    """What unit sources that the recordings share add to all equations, shape (equations, q)."""
    count = max((e.shared.shape[1] for e in equations if e.shared is not None), default=0)
    return np.vstack([np.zeros((e.lhs.size, count)) if e.shared is None else e.shared for e in equations])


def fit_axis(equations: list[Equation], prior_sd: FloatArray | None = None) -> LinearFit:
    """Solve all equations of one axis.

    Parameters
    ----------
    equations : list of Equation
    prior_sd : ndarray, shape (2k,), optional
        How far the real unknowns (Re c_0, Im c_0, Re c_1, …) may be from zero; infinite: not known beforehand.

    Raises
    ------
    CalibrationRefused
        Fewer equations than unknowns, or a singular design.
    """
    count = equations[0].regressors.shape[1]
    own = [0 if e.detuning is None else e.detuning.shape[1] for e in equations]
    first = np.concatenate([[0], np.cumsum(own)])
    unknowns = 2 * count + int(first[-1])
    designs, targets = [], []
    plain: tuple[list[FloatArray], list[FloatArray]] = ([], [])
    if prior_sd is not None and np.isfinite(prior_sd).any():
        known = np.isfinite(prior_sd)
        designs.append(np.hstack([np.diag(1.0 / prior_sd), np.zeros((2 * count, unknowns - 2 * count))])[known])
        targets.append(np.zeros(int(known.sum())))
    for i, e in enumerate(equations):
        re, im = e.regressors.real, e.regressors.imag
        shift_re, shift_im = np.zeros((e.lhs.size, int(first[-1]))), np.zeros((e.lhs.size, int(first[-1])))
        if e.detuning is not None:
            place = slice(int(first[i]), int(first[i + 1]))
            shift_re[:, place], shift_im[:, place] = -e.detuning.imag, e.detuning.real
            spread = np.broadcast_to(np.asarray(e.detuning_sd, dtype=float), own[i])
            known = np.isfinite(spread)
            if known.any():
                prior = np.zeros((own[i], unknowns))
                prior[:, 2 * count + place.start : 2 * count + place.stop] = np.diag(1.0 / spread)
                designs.append(prior[known])
                targets.append(np.zeros(int(known.sum())))
        top = np.empty((e.lhs.size, 2 * count))
        bottom = np.empty_like(top)
        top[:, 0::2], top[:, 1::2] = re, -im
        bottom[:, 0::2], bottom[:, 1::2] = im, re
        plain[0].append(np.hstack([top, shift_re]))
        plain[1].append(np.hstack([bottom, shift_im]))
    lhs, factor = np.concatenate([e.lhs for e in equations]), _shared_factor(equations)
    whiteners = [_Whitener.of(equations, imaginary, factor) for imaginary in (False, True)]
    for white, part, value in zip(whiteners, plain, (lhs.real, lhs.imag), strict=True):
        designs.append(white(np.vstack(part)))
        targets.append(white(value))
    design, target = np.vstack(designs), np.concatenate(targets)
    used = np.linalg.norm(design, axis=0)
    if design.shape[0] < unknowns or np.any(used == 0.0):
        raise CalibrationRefused(
            f"Recordings must give at least {unknowns} independent equations, but got {design.shape[0]} "
            f"({int(np.sum(used == 0.0))} unknowns never excited). Record side bands on both axes, feedthrough and body excitation."
        )
    scaled = design / used
    u, s, vt = np.linalg.svd(scaled, full_matrices=False)
    if s[-1] < 1e-13 * s[0]:
        raise CalibrationRefused(f"Design must be of full rank, but got condition number {s[0] / max(s[-1], 1e-300):.3g}.")
    solution = (vt.T @ ((u.T @ target) / s)) / used
    covariance = (vt.T / s**2) @ vt / np.outer(used, used)
    residual = target - design @ solution
    coefficients = solution[0 : 2 * count : 2] + 1j * solution[1 : 2 * count : 2]
    both = np.column_stack([solution, np.sqrt(np.diag(covariance))])
    taken = [[np.einsum("jk,kl,jl->j", d, covariance, d) for d in part] for part in plain]
    shared, growth = _shared(equations, factor, whiteners, residual, u)
    raw = []
    for i, e in enumerate(equations):
        left = e.lhs - e.regressors @ coefficients
        if e.detuning is not None:
            left = left - 1j * e.detuning @ solution[2 * count + int(first[i]) : 2 * count + int(first[i + 1])]
        raw.append(left)
    return LinearFit(
        coefficients=coefficients,
        covariance=covariance[: 2 * count, : 2 * count],
        chi2=float(residual @ residual),
        dof=design.shape[0] - unknowns,
        condition_number=float(s[0] / s[-1]),
        residuals=tuple(raw),
        explained=tuple(re + 1j * im for re, im in zip(*taken, strict=True)),
        shared=shared,
        shared_growth=growth,
        detunings=tuple(both[2 * count + int(a) : 2 * count + int(a) + k] for a, k in zip(first, own, strict=False)),
    )


def _shared(
    equations: list[Equation], factor: FloatArray, whiteners: list[_Whitener], residual: FloatArray, basis: FloatArray
) -> tuple[tuple[ComplexArray, ...], float]:
    """What shared sources most probably add to each recording, and the variance that they show over one.

    ``residual`` and ``basis`` (an orthonormal basis of the design's range) are of the whitened equations, which come last in it.
    """
    count = factor.shape[0]
    if factor.shape[1] == 0:
        return (), 1.0
    added, squares, told = [], 0.0, 0.0
    for k, white in enumerate(whiteners):
        place = slice(residual.size - (2 - k) * count, residual.size - (1 - k) * count)
        seen = white(factor)
        sources = seen.T @ residual[place]
        added.append(factor @ sources)
        squares += float(sources @ sources)
        told += float(np.sum(seen**2) - np.sum((basis[place].T @ seen) ** 2))
    ends = np.cumsum([e.lhs.size for e in equations])[:-1]
    return tuple(np.split(added[0] + 1j * added[1], ends)), squares / max(told, 1e-300)
