"""Non-negative sizes of densities by the Whittle likelihood: least squares, reweighted until they stay.

The fixed point of non-negative least squares with the weights of what they say maximises the likelihood of squares that are chi-square
each. A diagnosis asks that ten thousand times of at most three densities, so that for these non-negative least squares are written out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

__all__ = ["likeliest", "likeliest_of_each"]

FloatArray = NDArray[np.float64]
Sizes = tuple[float, ...]
#: rounds of the reweighted fit, by how much it may still change, and least density over the mean square
_MOST_ROUNDS, _SETTLED, _LEAST = 15, 1e-4, 1e-6
#: least density of a device without noise: the square of its inverse, added up, is a number
_NOTHING = 1e-140
#: squared sine between two columns from which on they are one
_ALIKE = 1e-12
#: of three columns
_PAIRS = ((0, 1), (0, 2), (1, 2))


def likeliest(basis: FloatArray, squares: FloatArray, known: FloatArray | float = 0.0) -> FloatArray:
    """Non-negative sizes of any number of densities.

    Parameters
    ----------
    basis : ndarray, shape (n, k)
        Densities of unit size.
    squares : ndarray, shape (n,)
        Each of its density times a chi-square with one degree of freedom.
    known : ndarray, shape (n,), optional
        Density that is there besides.

    Returns
    -------
    ndarray, shape (k,)
    """
    size = np.maximum(basis.mean(axis=0), 1e-300)
    scaled, mean = basis / size, float(squares.mean())
    expected = np.full(squares.size, max(mean, _NOTHING))
    found = np.zeros(basis.shape[1])
    for _ in range(_MOST_ROUNDS):
        before = found
        found = _nonnegative(scaled / expected[:, None], (squares - known) / expected)
        if np.all(np.abs(found - before) <= _SETTLED * (before + found.max(initial=0.0))):
            break
        expected = np.maximum(scaled @ found + known, _LEAST * mean + _NOTHING)
    return np.asarray(found / size)


def likeliest_of_each(models: Sequence[tuple[int, ...]], basis: FloatArray, squares: FloatArray, known: FloatArray) -> FloatArray:
    """Non-negative sizes of a few densities in each of several models.

    Parameters
    ----------
    models : sequence of tuple of int
        Columns that each may have, three at most.
    basis : ndarray, shape (n, k)
    squares : ndarray, shape (n,)
    known : ndarray, shape (n,)
        Density that is there besides.

    Returns
    -------
    ndarray, shape (models, k)
    """
    size = np.maximum(basis.mean(axis=0), 1e-300)
    scaled, mean = np.ascontiguousarray((basis / size).T), float(squares.mean())
    found = np.zeros((len(models), basis.shape[1]))
    for k, model in enumerate(models):
        found[k, list(model)] = _settled(scaled[list(model)], squares - known, mean, known)
    return np.asarray(found / size)


def _nonnegative(basis: FloatArray, target: FloatArray) -> FloatArray:
    """Non-negative least squares of many rows: by their products, unless these are singular."""
    try:
        lower = np.linalg.cholesky(basis.T @ basis)
    except np.linalg.LinAlgError:
        return np.asarray(nnls(basis, target)[0])
    return np.asarray(nnls(lower.T, np.linalg.solve(lower, basis.T @ target))[0])


def _settled(densities: FloatArray, beside: FloatArray, mean: float, known: FloatArray) -> Sizes:
    """Sizes of at most three densities, shape (k, n), beside one that is known."""
    expected: FloatArray | float = max(mean, _NOTHING)
    found: Sizes = (0.0,) * len(densities)
    for _ in range(_MOST_ROUNDS):
        before = found
        weighted = densities / expected
        found = _fewest((weighted @ weighted.T).tolist(), (weighted @ (beside / expected)).tolist())
        largest = max(found)
        if all(abs(x - was) <= _SETTLED * (was + largest) for x, was in zip(found, before, strict=True)):
            break
        expected = np.maximum(np.array(found) @ densities + known, _LEAST * mean + _NOTHING)
    return found


def _fewest(products: list[list[float]], towards: list[float]) -> Sizes:
    """Non-negative least squares of at most three columns, by their products and theirs with the target.

    Least squares of all columns are the best where none is negative; else one column at least has none.
    """
    norm = [math.sqrt(max(products[k][k], 1e-300)) for k in range(len(towards))]
    asked = [t / n for t, n in zip(towards, norm, strict=True)]
    if len(norm) == 1:
        return (max(asked[0], 0.0) / norm[0],)
    if len(norm) == 2:
        x, y = _of_two(products[0][1] / (norm[0] * norm[1]), asked[0], asked[1])
        return x / norm[0], y / norm[1]
    x, y, z = _of_three(*(products[i][j] / (norm[i] * norm[j]) for i, j in _PAIRS), *asked)
    return x / norm[0], y / norm[1], z / norm[2]


def _of_three(a: float, b: float, c: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Of three columns of unit norm, by cofactors; a, b, c: products of the first and second, first and third, second and third."""
    whole = 1.0 + 2.0 * a * b * c - a * a - b * b - c * c
    if whole > _ALIKE:
        p = (1.0 - c * c) * x + (b * c - a) * y + (a * c - b) * z
        q = (b * c - a) * x + (1.0 - b * b) * y + (a * b - c) * z
        r = (a * c - b) * x + (a * b - c) * y + (1.0 - a * a) * z
        if min(p, q, r) >= 0.0:
            return p / whole, q / whole, r / whole
    first, second, third = _of_two(a, x, y), _of_two(b, x, z), _of_two(c, y, z)
    choices = (
        (first[0] * x + first[1] * y, (first[0], first[1], 0.0)),
        (second[0] * x + second[1] * z, (second[0], 0.0, second[1])),
        (third[0] * y + third[1] * z, (0.0, third[0], third[1])),
    )
    return max(choices)[1]


def _of_two(a: float, x: float, y: float) -> tuple[float, float]:
    """Of two columns of unit norm whose product is a."""
    left = 1.0 - a * a
    if left > _ALIKE and x >= a * y and y >= a * x:
        return (x - a * y) / left, (y - a * x) / left
    return (max(x, 0.0), 0.0) if x >= y else (0.0, max(y, 0.0))
