"""How large random nuisances are, family by family: by the likelihood of their coefficients in a fit that allowed for more.

A family is what is alike by nature: the distances of the resonance in all records, the slow cosines of both drives' gains. Its coefficients
are independent with a common share of their priors; what the data say of them is the fit's posterior less those priors, and the share is
what makes them likeliest. A mean of squares would not do: coefficients that are told badly would count as large.

A fit that held every effect at once tells the coefficients badly; one that held those of time only tells them well, but what it lacks may
pass for them. Either errs upwards only: of two such measurements the smaller is the better one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from .column import Column
from .system import Solution

__all__ = ["Family", "gained_by_resizing", "gained_by_sizing", "log_evidence", "measured_shares", "what_data_say", "with_shares"]

FloatArray = NDArray[np.float64]
#: family of a column; "" for none
Family = Callable[[Column], str]
_SIZES = np.concatenate([[1e-4], np.geomspace(1e-3, 1.0, 25)])
_ROUNDS, _FIRST = 4, 0.03
#: what rounding leaves of a variance over its prior; a frequency known to 1e-7 rad/s of 1e-2 has 1e-10
_ROUNDING = 1e-17
#: by how much a measured share may be too small
_MOST_TOO_SMALL = 4.0


def measured_shares(solution: Solution, family: Family) -> dict[str, float]:
    """Size of each family as a share of its columns' priors, at most one: about the likeliest, with how well that is known.

    Parameters
    ----------
    solution : Solution
        Of a fit that held the families' columns at their largest.
    family : callable
        Family of a column, or "".
    """
    families, data, told = _told(solution, family)
    sizes = _likeliest(families, data, told, dict.fromkeys(families, _FIRST))
    return {name: _expected(_scores(data, told, families, sizes, name)) for name in sizes}


def gained_by_resizing(solution: Solution, family: Family, shares: Mapping[str, float]) -> float:
    """Log likelihood that families of these shares gain by being as large as this fit makes likeliest, but no larger than may be.

    A share is known from a dozen coefficients or more. The most that one was found too small by is three (trial 2101/48); with families
    nine and four times as large as measured a hemisphere's floors explained the drift of one drive's gain, 258 of log evidence, by 264.

    Parameters
    ----------
    solution : Solution
        Of a fit that held the families' columns at their largest.
    family : callable
        Family of a column, or "".
    shares : mapping
        Size of each family as a share of its columns' priors.
    """
    families, data, told = _told(solution, family)
    if not families:
        return 0.0
    largest = {name: _MOST_TOO_SMALL * share for name, share in shares.items()}
    likeliest = _likeliest(families, data, told, dict(shares), largest)
    return max(_likelihood(data, told, families, likeliest) - _likelihood(data, told, families, shares), 0.0)


def gained_by_sizing(solution: Solution, family: Family) -> float:
    """Log likelihood that families gain by being as large as this fit makes likeliest, over being nothing.

    Parameters
    ----------
    solution : Solution
        Of a fit that held the families' columns at their largest.
    family : callable
        Family of a column, or "".
    """
    families, data, told = _told(solution, family)
    return _likelihood(data, told, families, _likeliest(families, data, told, dict.fromkeys(families, _FIRST))) if families else 0.0


def _told(solution: Solution, family: Family) -> tuple[list[str], FloatArray, FloatArray]:
    """Families of the coefficients, and what the data alone say of these: their precision and information, in units of the priors."""
    places = [k for k, c in enumerate(solution.columns) if family(c)]
    return [family(solution.columns[k]) for k in places], *what_data_say(solution, places)


def what_data_say(solution: Solution, places: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    """Precision and information of coefficients by the data alone, in units of the priors that they had in a fit.

    Parameters
    ----------
    solution : Solution
    places : sequence of int
        Of the coefficients, which have a prior each.

    Returns
    -------
    precision : ndarray, shape (k, k)
    information : ndarray, shape (k,)
    """
    prior = np.array([solution.columns[k].prior_sd for k in places])
    covariance = solution.covariance[np.ix_(places, places)] / np.outer(prior, prior)
    # what the data alone say is the posterior less the prior
    known, axes = np.linalg.eigh(covariance)
    posterior = np.asarray((axes / np.maximum(known, _ROUNDING)) @ axes.T)
    w, v = np.linalg.eigh(posterior - np.eye(prior.size))
    data = np.asarray((v * np.maximum(w, 0.0)) @ v.T)
    return data, np.asarray(posterior @ (solution.values[list(places)] / prior))


def _likeliest(
    families: Sequence[str], data: FloatArray, told: FloatArray, sizes: dict[str, float], largest: Mapping[str, float] | None = None
) -> dict[str, float]:
    """Sizes of most likelihood, none above its ``largest``."""
    for _ in range(_ROUNDS):
        for name in sizes:
            scores = _scores(data, told, families, sizes, name)
            if largest is not None:
                scores = np.where(max(largest[name], _SIZES[0]) >= _SIZES, scores, -np.inf)
            sizes[name] = float(_SIZES[int(np.argmax(scores))])
    return sizes


def with_shares(columns: Sequence[Column], family: Family, shares: Mapping[str, float]) -> list[Column]:
    """The same columns, those of a family at its measured size."""
    return [replace(c, prior_sd=c.prior_sd * shares[name]) if (name := family(c)) in shares else c for c in columns]


def _scores(data: FloatArray, told: FloatArray, families: Sequence[str], sizes: Mapping[str, float], family: str) -> FloatArray:
    """Log likelihoods of all sizes of one family beside the others at theirs, which are integrated over first: see :func:`_likelihood`."""
    own = np.array([f == family for f in families])
    sd = np.array([sizes[f] for f in families if f != family])
    lower = np.linalg.cholesky(np.eye(sd.size) + sd[:, None] * data[np.ix_(~own, ~own)] * sd[None, :])
    reduced = np.linalg.solve(lower, np.column_stack([sd[:, None] * data[np.ix_(~own, own)], sd * told[~own]]))
    cross, others = reduced[:, :-1], reduced[:, -1]
    w, v = np.linalg.eigh(data[np.ix_(own, own)] - cross.T @ cross)
    squares, w = ((told[own] - cross.T @ others) @ v) ** 2, np.maximum(w, 0.0)
    variance = _SIZES[:, None] ** 2
    beside = 0.5 * float(others @ others) - float(np.sum(np.log(np.diag(lower))))
    return np.asarray(beside + 0.5 * np.sum(variance * squares / (1.0 + variance * w) - np.log1p(variance * w), axis=1))


def _expected(scores: FloatArray) -> float:
    """Root of the expected square: a size that may well be larger than the likeliest would pass for an effect."""
    weight = np.exp(scores - scores.max())
    return float(np.sqrt(weight @ _SIZES**2 / weight.sum()))


def _likelihood(data: FloatArray, told: FloatArray, families: Sequence[str], sizes: Mapping[str, float]) -> float:
    """Log likelihood of the coefficients, marginalised: prior variances s^2, precision and information of the data."""
    return log_evidence(data, told, np.array([sizes[f] for f in families]))


def log_evidence(data: FloatArray, told: FloatArray, sd: FloatArray) -> float:
    """Of coefficients with independent priors about zero, over that of none of them.

    Parameters
    ----------
    data, told : ndarray
        Precision and information by the data alone, of :func:`what_data_say`.
    sd : ndarray, shape (k,)
        Of the priors.
    """
    inner = np.eye(sd.size) + sd[:, None] * data * sd[None, :]
    factor = cho_factor(inner, lower=True)
    scaled = sd * told
    return 0.5 * float(scaled @ cho_solve(factor, scaled)) - float(np.sum(np.log(np.diag(factor[0]))))
