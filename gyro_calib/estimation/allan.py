"""Allan deviation of a rate with confidence intervals, and the noise coefficients behind it with honest standard deviations.

The closed forms of :mod:`gyro_calib.estimation.power_law` give the equivalent degrees of freedom (confidence intervals) and the full
covariance of the curve, with which Q^2, N^2, B^2, K^2 are fitted by generalised least squares.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg, optimize, stats

from ..errors import DataError
from ..quantity import Quantity
from .power_law import COEFFICIENT_UNITS, AllanCovariance, model_variance

__all__ = ["AllanAnalysis", "AllanCurve", "allan_variance", "analyse_allan", "averaging_factors"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_MIN_SAMPLES = 16
#: averaging times of a fit: four coefficients and one to check them
_MIN_TAUS = 5
#: a misfit that chance makes less often than this counts as the filter's; dropping a point in vain costs little, keeping one that is shaped
#: moves every coefficient
_LEAST_PROBABLE = 0.3


@dataclass(frozen=True)
class AllanCurve:
    """Overlapping Allan deviation.

    Parameters
    ----------
    tau_s : ndarray, shape (k,)
        Averaging times [s].
    deviation : ndarray, shape (k,)
        Allan deviation [rad/s].
    lower, upper : ndarray, shape (k,)
        Confidence interval of the true deviation [rad/s], chi-square with ``edf``.
    edf : ndarray, shape (k,)
        Equivalent degrees of freedom for the fitted mix of noises.
    confidence : float
        Probability that the interval holds the true value.
    """

    tau_s: FloatArray
    deviation: FloatArray
    lower: FloatArray
    upper: FloatArray
    edf: FloatArray
    confidence: float

    def minimum(self) -> tuple[float, Quantity]:
        """``(tau_s, deviation)`` where the curve is lowest, the deviation with its standard deviation [rad/s]."""
        k = int(np.argmin(self.deviation))
        value = float(self.deviation[k])
        return float(self.tau_s[k]), Quantity(value, value / math.sqrt(2.0 * float(self.edf[k])), "rad/s")


@dataclass(frozen=True)
class AllanAnalysis:
    """Curve, coefficients and verdict.

    Parameters
    ----------
    curve : AllanCurve
        What was measured.
    coefficients : mapping of str to Quantity
        ``angle_noise``, ``angle_random_walk``, ``bias_instability``, ``rate_random_walk``; value and sd in SI units.
    upper_limits : mapping of str to float
        95 % upper limit of each coefficient, same units; the statement to use for one that is in ``not_observable``.
    not_observable : tuple of str
        Coefficients whose square is below 1.96 of its standard deviation.
    chi_square_per_dof : float
        Misfit of the model, 1 when it holds.
    min_tau_s : float
        Shortest averaging time that the fit used [s]; below it the model does not hold, nor the intervals that rest on it.
    duration_s, sample_rate_hz : float
        Of the data.
    """

    curve: AllanCurve
    coefficients: Mapping[str, Quantity]
    upper_limits: Mapping[str, float]
    not_observable: tuple[str, ...]
    chi_square_per_dof: float
    min_tau_s: float
    duration_s: float
    sample_rate_hz: float

    def model_deviation(self, tau_s: ArrayLike) -> FloatArray:
        """Allan deviation of the fitted model at ``tau_s`` [rad/s], same shape."""
        squares = np.array([self.coefficients[name].value ** 2 for name in COEFFICIENT_UNITS])
        return np.sqrt(model_variance(tau_s) @ squares)


def averaging_factors(samples: int, points_per_octave: int = 2) -> IntArray:
    """Logarithmic averaging factors m from 1 to a third of the data, without repeats, shape (k,)."""
    top = max(1, samples // 3)
    count = int(points_per_octave * math.log2(top)) + 1
    return np.unique(np.round(2.0 ** (np.arange(count) / points_per_octave)).astype(np.int64))


def allan_variance(rate_rad_s: ArrayLike, sample_rate_hz: float, factors: ArrayLike) -> FloatArray:
    """Overlapping Allan variance (IEEE Std 952, annex C; NIST SP 1065, Eq. 11).

    Parameters
    ----------
    rate_rad_s : array_like, shape (n,)
        Rate, uniformly sampled [rad/s].
    sample_rate_hz : float
        Samples per second.
    factors : array_like of int, shape (k,)
        Averaging factors m; ``tau = m / sample_rate_hz``; ``2 m <= n``.

    Returns
    -------
    ndarray, shape (k,)
        Allan variance [(rad/s)^2].

    Raises
    ------
    DataError
        A sample that is not finite, or data too short for a factor.
    """
    rate = _checked_rate(rate_rad_s, sample_rate_hz)
    # the mean cancels in every difference; without it the cumulative sum keeps its digits
    angle = np.concatenate([[0.0], np.cumsum(rate - rate.mean())])
    result = []
    for m in np.asarray(factors, dtype=np.int64):
        if m < 1 or 2 * m > rate.size:
            raise DataError(f"Averaging factor must be in 1…{rate.size // 2} for {rate.size} samples, but got {int(m)}. Record longer.")
        z = angle[2 * m :] - 2.0 * angle[m:-m] + angle[: -2 * m]
        result.append(float(z @ z) / (2.0 * z.size * float(m) ** 2))
    return np.array(result)


def analyse_allan(
    rate_rad_s: ArrayLike, sample_rate_hz: float, *, min_tau_s: float | None = None, confidence: float = 0.95, points_per_octave: int = 2
) -> AllanAnalysis:
    """Allan deviation with confidence intervals and the four noise coefficients with covariance.

    Parameters
    ----------
    rate_rad_s : array_like, shape (n,)
        Rate at rest or at constant input, uniformly sampled [rad/s]; 16 or more samples.
    sample_rate_hz : float
        Samples per second.
    min_tau_s : float, optional
        Shortest averaging time that the fit uses [s]. Loop bandwidth and output filter shape the short end of the curve, which no power law
        follows; by default the fit begins where the curve follows the model. Shorter times stay in the curve.
    confidence : float
        Probability of the intervals, in (0, 1).
    points_per_octave : int
        Density of averaging times.

    Returns
    -------
    AllanAnalysis
        Curve, coefficients, upper limits.

    Raises
    ------
    DataError
        Rate not finite, constant, or too short; sample rate or confidence out of range.
    """
    rate = _checked_rate(rate_rad_s, sample_rate_hz)
    if not 0.0 < confidence < 1.0:
        raise DataError(f"Argument confidence must be between 0 and 1, but got {confidence!r}.")
    factors = averaging_factors(rate.size, points_per_octave)
    tau = factors / sample_rate_hz
    variance = allan_variance(rate, sample_rate_hz, factors)
    if not np.all(variance > 0.0):
        raise DataError("Rate must vary from sample to sample, but got a constant one. Is the channel connected?")
    noise = AllanCovariance(factors, rate.size, sample_rate_hz)
    first = _first_used(tau, min_tau_s)
    fit = _fit_squares(variance, tau, noise, first)
    if min_tau_s is None:
        fit = _fit_where_it_holds(variance, tau, noise, fit)
    squares, covariance = fit.squares, fit.covariance
    edf = np.maximum(2.0 * (model_variance(tau) @ squares) ** 2 / np.diag(noise(squares)), 1.0)
    tail = 0.5 * (1.0 - confidence)
    curve = AllanCurve(
        tau_s=tau,
        deviation=np.sqrt(variance),
        lower=np.sqrt(variance * edf / stats.chi2.ppf(1.0 - tail, edf)),
        upper=np.sqrt(variance * edf / stats.chi2.ppf(tail, edf)),
        edf=edf,
        confidence=confidence,
    )
    sd = np.sqrt(np.diag(covariance))
    names = tuple(COEFFICIENT_UNITS)
    return AllanAnalysis(
        curve=curve,
        coefficients={name: _root(squares[k], sd[k], unit) for k, (name, unit) in enumerate(COEFFICIENT_UNITS.items())},
        upper_limits={name: math.sqrt(squares[k] + 1.644854 * sd[k]) for k, name in enumerate(names)},
        not_observable=tuple(name for k, name in enumerate(names) if squares[k] < 1.959964 * sd[k]),
        chi_square_per_dof=fit.chi_square / fit.dof,
        min_tau_s=float(tau[fit.first]),
        duration_s=rate.size / sample_rate_hz,
        sample_rate_hz=float(sample_rate_hz),
    )


@dataclass(frozen=True)
class _Fit:
    """Squares of the coefficients with covariance, misfit, and the index of the first averaging time used."""

    squares: FloatArray
    covariance: FloatArray
    chi_square: float
    dof: int
    first: int


def _first_used(tau: FloatArray, min_tau_s: float | None) -> int:
    """Index of the first averaging time of the fit."""
    first = int(np.searchsorted(tau, min_tau_s or 0.0))
    if tau.size - first < _MIN_TAUS:
        raise DataError(
            f"Rate must cover at least {_MIN_TAUS} averaging times above {min_tau_s or 0.0:g} s, but got {tau.size - first}. Record longer."
        )
    return first


def _fit_where_it_holds(variance: FloatArray, tau: FloatArray, noise: AllanCovariance, whole: _Fit) -> _Fit:
    """Drop short averaging times until noise of the model explains the misfit; if it never does, the best there is."""
    fits = [whole]
    while stats.chi2.sf(fits[-1].chi_square, fits[-1].dof) < _LEAST_PROBABLE and tau.size - fits[-1].first > _MIN_TAUS:
        fits.append(_fit_squares(variance, tau, noise, fits[-1].first + 1))
    return min(fits, key=lambda fit: fit.chi_square / fit.dof)


def _fit_squares(variance: FloatArray, tau: FloatArray, noise: AllanCovariance, first: int) -> _Fit:
    """Non-negative generalised least squares of the four squares; the covariance belongs to the current mix, so iterate."""
    used, variance = slice(first, None), variance[first:]
    columns = model_variance(tau[first:])
    scale = 1.0 / columns.max(axis=0) * variance.max()
    squares = _nnls(columns * scale / variance[:, None], np.ones_like(variance)) * scale
    for _ in range(12):
        weights = np.linalg.cholesky(_regular(noise(squares, used)))
        white = linalg.solve_triangular(weights, columns * scale, lower=True)
        target = linalg.solve_triangular(weights, variance, lower=True)
        previous, squares = squares, _nnls(white, target) * scale
        if np.allclose(squares, previous, rtol=1e-4, atol=0.0):
            break
    # Unconstrained covariance: a coefficient at its bound 0 still says how large it could have been.
    covariance = np.linalg.pinv(white.T @ white, hermitian=True) * np.outer(scale, scale)
    residual = target - white @ (squares / scale)
    dof = max(1, variance.size - int(np.count_nonzero(squares)))
    return _Fit(squares, covariance, float(residual @ residual), dof, first)


def _nnls(matrix: FloatArray, target: FloatArray) -> FloatArray:
    """Non-negative least squares with columns scaled to unit length."""
    length = np.linalg.norm(matrix, axis=0)
    solution, _ = optimize.nnls(matrix / length, target)
    return np.asarray(solution / length)


def _regular(covariance: FloatArray) -> FloatArray:
    """Correlations near 1 between close averaging times leave eigenvalues near zero: 1e-6 of the variances keeps Cholesky safe."""
    return covariance + np.diag(1e-6 * np.diag(covariance))


def _root(square: float, sd: float, unit: str) -> Quantity:
    """Coefficient from its square; near zero the delta method fails and the root of the sd is the scale of the uncertainty."""
    value = math.sqrt(square)
    return Quantity(value, min(sd / (2.0 * value), math.sqrt(sd)) if value > 0.0 else math.sqrt(sd), unit)


def _checked_rate(rate_rad_s: ArrayLike, sample_rate_hz: float) -> FloatArray:
    """Validated rate as a float array."""
    rate = np.asarray(rate_rad_s, dtype=np.float64)
    if not (math.isfinite(sample_rate_hz) and sample_rate_hz > 0.0):
        raise DataError(f"Argument sample_rate_hz must be > 0, but got {sample_rate_hz!r}.")
    if rate.ndim != 1 or rate.size < _MIN_SAMPLES:
        raise DataError(f"Rate must be one column of {_MIN_SAMPLES} or more samples, but got shape {rate.shape}. Record longer.")
    bad = np.flatnonzero(~np.isfinite(rate))
    if bad.size:
        raise DataError(f"Rate must be finite, but sample {int(bad[0])} is {float(rate[bad[0]])}. Cut it out of the recording.")
    return rate
