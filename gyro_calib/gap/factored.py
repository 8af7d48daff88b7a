"""Orthonormal columns of a design most of whose columns are of one recording alone: these first, recording by recording.

A third to a half of a campaign's columns are a recording's own: where its resonance lay, how its thermometer erred, what its table's
steps left. Such a column has its rows and that of its prior. Taken first, in blocks of tens of rows, they leave a dense matrix of the
others alone, and orthonormal columns cost the square of their number.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

__all__ = ["factored"]

FloatArray = NDArray[np.float64]
Places = NDArray[np.intp]
#: of the largest singular value: what is below is no direction of its own
_ALIKE = 1e-9
#: a column of one recording spans at most this share of the equations; fewest of them that are worth a block
_NARROW, _FEWEST = 0.125, 16


class _Block(NamedTuple):
    """Columns that share rows with no column of another block."""

    rows: Places
    columns: Places


def factored(full: FloatArray, equations: int) -> tuple[FloatArray, FloatArray]:
    """Orthonormal columns (n, r) that span a matrix (n, k), and (k, r) what makes least-squares values of products with them.

    Columns that are nearly others' leave r < k; the values are then the least ones, each in its column's norm.

    Parameters
    ----------
    full : ndarray, shape (n, k)
    equations : int
        Rows before those of the priors, of which each belongs to one column.
    """
    scale = np.linalg.norm(full, axis=0)
    scale[scale == 0.0] = 1.0
    q, r, order = _triangular(full / scale, equations)
    back = np.argsort(order)
    # a triangle costs a third of singular values: these are asked only where columns are nearly alike
    if r.shape[0] == r.shape[1] and scipy.linalg.lapack.dtrcon(r)[0] > _ALIKE:
        return q, scipy.linalg.lapack.dtrtri(r)[0][back] / scale[:, None]
    u, s, vt = np.linalg.svd(r, full_matrices=False)
    kept = s > _ALIKE * s[0]
    return q @ u[:, kept], (vt[kept].T / s[kept])[back] / scale[:, None]


def _triangular(x: FloatArray, equations: int) -> tuple[FloatArray, FloatArray, Places]:
    """Q and R of the columns in some order, and that order."""
    blocks = list(_blocks(x, equations))
    narrow = np.concatenate([np.zeros(0, np.intp), *(block.columns for block in blocks)])
    if len(narrow) < _FEWEST or x.shape[0] < x.shape[1]:
        q, r = scipy.linalg.qr(x, mode="economic", check_finite=False)
        return q, r, np.arange(x.shape[1])
    order = np.concatenate([narrow, np.setdiff1d(np.arange(x.shape[1]), narrow)])
    q, r = np.zeros(x.shape, order="F"), np.zeros((x.shape[1], x.shape[1]), order="F")
    rest, first = x[:, order[len(narrow) :]], 0
    for rows, columns in blocks:
        own = slice(first, first := first + len(columns))
        q[rows, own], r[own, own] = scipy.linalg.qr(x[np.ix_(rows, columns)], mode="economic", check_finite=False)
        part, basis = rest[rows], q[rows, own]
        # once more: what is left of a column that nearly was the recording's own
        for _ in range(2):
            held = basis.T @ part
            part -= basis @ held
            r[own, len(narrow) :] += held
        rest[rows] = part
    q[:, first:], r[first:, first:] = scipy.linalg.qr(rest, mode="economic", overwrite_a=True, check_finite=False)
    return q, r, order


def _blocks(x: FloatArray, equations: int) -> Iterator[_Block]:
    """Narrow columns whose equations overlap, with those equations and their priors."""
    there = x != 0.0
    data = there[:equations]
    some = np.flatnonzero(data.any(axis=0))
    first, last = data[:, some].argmax(axis=0), equations - data[::-1, some].argmax(axis=0)
    narrow = last - first < _NARROW * equations
    columns, first, last = (a[narrow][np.argsort(first[narrow], kind="stable")] for a in (some, first, last))
    reach = np.maximum.accumulate(last)[:-1] if len(last) else last
    for places in np.split(np.arange(len(columns)), np.flatnonzero(first[1:] >= reach) + 1):
        if len(places) == 0:
            continue
        priors = equations + np.flatnonzero(there[equations:, columns[places]].any(axis=1))
        rows = np.concatenate([np.arange(first[places].min(), last[places].max()), priors])
        if len(places) <= len(rows):
            yield _Block(rows, columns[places])
