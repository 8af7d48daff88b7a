"""Power-law noise of a rate: its Allan variance, and the covariance between Allan variances, in closed form.

The rate noise is a sum of four independent power laws; with the angle ``w`` (integral of the rate) each is known by its generalised
autocovariance ``s(t)`` and gives an Allan variance (IEEE Std 952, annex C; Greenhall & Riley, "Uncertainty of stability variances based on
finite differences", PTTI 2003):

====================  ======================  ==========================  =====================
noise                 coefficient             generalised autocovariance  Allan variance
====================  ======================  ==========================  =====================
white angle noise     Q [rad]                 Q^2 delta(t)                3 Q^2 / tau^2
angle random walk     N [rad/sqrt(s)]         -N^2 abs(t) / 2             N^2 / tau
bias instability      B [rad/s]               B^2 t^2 ln(abs t) / (2 pi)  (2 ln 2 / pi) B^2
rate random walk      K [rad/s/sqrt(s)]       K^2 abs(t)^3 / 12           K^2 tau / 3
====================  ======================  ==========================  =====================

The overlapping estimate at ``tau`` is a mean of squared second differences of ``w``; for Gaussian noise the covariance between the
estimates at two averaging times is a sum of squared cross-covariances of these differences, which ``s(t)`` gives.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["COEFFICIENT_UNITS", "FLICKER_FLOOR", "AllanCovariance", "model_variance"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: names of the coefficients, in the order of every coefficient vector here, with their units
COEFFICIENT_UNITS: dict[str, str] = {
    "angle_noise": "rad",
    "angle_random_walk": "rad/sqrt(s)",
    "bias_instability": "rad/s",
    "rate_random_walk": "rad/s/sqrt(s)",
}
#: Allan deviation of flicker noise over its coefficient B
FLICKER_FLOOR = math.sqrt(2.0 * math.log(2.0) / math.pi)

_SECOND_DIFFERENCE = ((0, 1.0), (1, -2.0), (2, 1.0))
#: below this number of lags a covariance sum takes every one
_LAGS = 512


def model_variance(tau_s: ArrayLike) -> FloatArray:
    """Allan variance per squared coefficient Q^2, N^2, B^2, K^2 at each tau: shape (k, 4), columns as in the module's table."""
    tau = np.atleast_1d(np.asarray(tau_s, dtype=np.float64))
    return np.stack([3.0 / tau**2, 1.0 / tau, np.full_like(tau, FLICKER_FLOOR**2), tau / 3.0], axis=1)


class AllanCovariance:
    """Covariance between overlapping Allan variances at several averaging factors, for Gaussian noise of any mix.

    ``Cov(var_a, var_b) = 2 sum_d n(d) C_ab(d)^2 / (M_a M_b 4 tau_a^2 tau_b^2)`` with ``C_ab(d)`` the covariance of the second differences
    d samples apart and ``n(d)`` the number of such pairs. C is linear in the mix: the covariance is a quadratic form, computed once.

    Parameters
    ----------
    factors : array_like of int, shape (k,)
        Averaging factors.
    samples : int
        Rate samples in the record.
    sample_rate_hz : float
        Samples per second.
    """

    def __init__(self, factors: ArrayLike, samples: int, sample_rate_hz: float) -> None:
        m = np.asarray(factors, dtype=np.int64)
        dt = 1.0 / sample_rate_hz
        self.form = np.empty((m.size, m.size, 4, 4))
        for i, a in enumerate(m):
            for j, b in enumerate(m[: i + 1]):
                counts = samples + 1 - 2 * int(a), samples + 1 - 2 * int(b)
                total = _squared_covariance_sum(int(a), int(b), counts, dt)
                self.form[i, j] = self.form[j, i] = total / (2.0 * counts[0] * counts[1] * (a * dt) ** 2 * (b * dt) ** 2)

    def __call__(self, squares: ArrayLike, used: slice = slice(None)) -> FloatArray:
        """Covariance for the mix Q^2, N^2, B^2, K^2 [(rad/s)^4], shape (k, k), or of the factors in ``used``."""
        mix = np.asarray(squares, dtype=np.float64)
        return np.asarray(mix @ (self.form[used, used] @ mix)[..., None])[..., 0]


def _squared_covariance_sum(a: int, b: int, counts: tuple[int, int], dt: float) -> FloatArray:
    """``sum_d n(d) C_ab(d)^2`` as a quadratic form of the mix, shape (4, 4); lags d: start of b's difference minus start of a's."""
    first, last = -(counts[0] - 1), counts[1] - 1
    # Smooth noises are correlated while the differences overlap, flicker a little beyond: 4 spans hold all but 1e-4.
    reach = 4 * (a + b)
    lags, weights = _lag_grid(max(first, -reach), min(last, reach), a, b)
    smooth = _cross_covariance(lags, a, b, dt)
    form = (smooth * (weights * _pairs(lags, counts))) @ smooth.T
    # White angle noise is correlated only where two of the three points coincide: exact lags.
    spikes = _spikes(a, b)
    exact = np.array([d for d in spikes if -counts[0] < d < counts[1]], dtype=np.int64)
    if exact.size:
        base = _cross_covariance(exact, a, b, dt)
        both = base.copy()
        both[0] = [spikes[int(d)] for d in exact]
        pairs = _pairs(exact, counts)
        form += (both * pairs) @ both.T - (base * pairs) @ base.T
    return form


def _lag_grid(first: int, last: int, a: int, b: int) -> tuple[IntArray, FloatArray]:
    """Lags with summation weights: every one of few, else dense at the kinks of the covariance (points coincide), sparse between."""
    if last - first <= _LAGS:
        lags = np.arange(first, last + 1, dtype=np.int64)
        return lags, np.ones(lags.size)
    steps = np.unique(np.round(1.12 ** np.arange(math.ceil(math.log(last - first) / math.log(1.12)) + 1)).astype(np.int64))
    kinks = np.array([p * a - q * b for p in range(3) for q in range(3)], dtype=np.int64)
    around = kinks[:, None] + np.concatenate([-steps, [0], steps])
    lags = np.unique(np.concatenate([around.ravel(), [first, last]]))
    lags = lags[(lags >= first) & (lags <= last)]
    gaps = np.diff(lags)
    weights = 0.5 * (np.concatenate([[1], gaps]) + np.concatenate([gaps, [1]]))
    return lags, weights


def _cross_covariance(lags: IntArray, a: int, b: int, dt: float) -> FloatArray:
    """Covariance of the second differences of span a and b per squared coefficient, shape (4, lags); zero for white angle noise."""
    result = np.zeros((4, lags.size))
    for p, weight_p in _SECOND_DIFFERENCE:
        for q, weight_q in _SECOND_DIFFERENCE:
            t = np.abs(lags + q * b - p * a) * dt
            log = np.log(np.where(t > 0.0, t, 1.0))
            result[1:] += weight_p * weight_q * np.stack([-0.5 * t, t**2 * log / (2.0 * math.pi), t**3 / 12.0])
    return result


def _spikes(a: int, b: int) -> dict[int, float]:
    """Lags and covariances of white angle noise of unit variance."""
    result: dict[int, float] = {}
    for p, weight_p in _SECOND_DIFFERENCE:
        for q, weight_q in _SECOND_DIFFERENCE:
            lag = p * a - q * b
            result[lag] = result.get(lag, 0.0) + weight_p * weight_q
    return result


def _pairs(lags: IntArray, counts: tuple[int, int]) -> FloatArray:
    """Number of pairs (i, k) with k - i = d, 0 <= i < counts[0], 0 <= k < counts[1]."""
    low = np.maximum(0, -lags)
    high = np.minimum(counts[0], counts[1] - lags)
    return np.maximum(high - low, 0).astype(np.float64)
