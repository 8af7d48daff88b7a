"""Four ways that people name an effect without projecting, evidence or ambiguity groups, on the same data: what the diagnosis must beat.

Each says one name, or none, from the whitened equations of the campaign and the columns of the same registry.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from ..gap.model import CampaignModel

__all__ = ["BASELINES", "lasso", "run_baselines"]

FloatArray = NDArray[np.float64]
#: by name, in the order of gap.md
BASELINES = ("largest residual", "naive correlation", "free everything", "lasso")
#: chance of a false alarm that each is set to, Bonferroni over what it looks at
_ALARM = 0.05
#: settings of a gridded effect that a baseline tries
_SETTINGS = 6
_SWEEPS, _TOLERANCE = 300, 1e-6


def run_baselines(model: CampaignModel) -> dict[str, str | None]:
    """Name that each baseline says, None for no effect."""
    names, columns = [], []
    for name, candidates in model.candidates.items():
        for candidate in candidates[:: max(1, len(candidates) // _SETTINGS)]:
            for column in candidate.columns:
                if any(np.any(v) for v in column.signal):
                    names.append(name)
                    columns.append(column)
    raw = model.whitener.design(columns, len(model.evidence))
    clean, _ = model.screener.projected(columns)
    return {
        "largest residual": _largest_residual(model.base.residual, raw, names),
        "naive correlation": _naive_correlation(model.base.residual, raw, names),
        "free everything": _free_everything(model, clean, names),
        "lasso": _lasso_name(clean, model.screener.left, names),
    }


def _threshold(count: int) -> float:
    return float(norm.isf(0.5 * _ALARM / count))


def _largest_residual(residual: FloatArray, raw: FloatArray, names: list[str]) -> str | None:
    """The effect that is largest, for its norm, where the residual is."""
    row = int(np.argmax(np.abs(residual)))
    if abs(residual[row]) < _threshold(residual.size):
        return None
    return names[int(np.argmax(np.abs(raw[row]) / np.linalg.norm(raw, axis=0)))]


def _naive_correlation(residual: FloatArray, raw: FloatArray, names: list[str]) -> str | None:
    """The effect whose columns, as they are, go best with the residual."""
    score = np.abs(raw.T @ residual) / np.linalg.norm(raw, axis=0)
    best = int(np.argmax(score))
    return names[best] if score[best] > _threshold(len(names)) else None


def _free_everything(model: CampaignModel, clean: FloatArray, names: list[str]) -> str | None:
    """Every parameter at once; the one furthest from zero in its standard deviations."""
    norms = np.linalg.norm(clean, axis=0)
    used = norms > 1e-9 * norms.max()
    u, s, vt = np.linalg.svd(clean[:, used] / norms[used], full_matrices=False)
    kept = s > 1e-8 * s[0]
    values = vt[kept].T @ ((u[:, kept].T @ model.screener.left) / s[kept])
    sd = np.sqrt(np.sum((vt[kept].T / s[kept]) ** 2, axis=1))
    score = np.abs(values) / sd
    best = int(np.argmax(score))
    return [n for n, keep in zip(names, used, strict=True) if keep][best] if score[best] > _threshold(len(names)) else None


def _lasso_name(clean: FloatArray, left: FloatArray, names: list[str]) -> str | None:
    norms = np.linalg.norm(clean, axis=0)
    used = norms > 1e-9 * norms.max()
    # noise is of unit variance, columns of unit norm: the usual penalty for as many columns
    values = lasso(clean[:, used] / norms[used], left, float(np.sqrt(2.0 * np.log(max(int(used.sum()), 2)))))
    if not np.any(values):
        return None
    return [n for n, keep in zip(names, used, strict=True) if keep][int(np.argmax(np.abs(values)))]


def lasso(design: FloatArray, target: FloatArray, penalty: float) -> FloatArray:
    """Minimise ``|target - design x|^2 / 2 + penalty |x|_1`` by coordinate descent.

    Parameters
    ----------
    design : ndarray, shape (n, k)
        Columns of unit norm.
    target : ndarray, shape (n,)
    penalty : float

    Returns
    -------
    ndarray, shape (k,)
    """
    gram, against = design.T @ design, design.T @ target
    x = np.zeros(design.shape[1])
    gradient = against.copy()
    for _ in range(_SWEEPS):
        largest = 0.0
        for k in range(x.size):
            reach = gradient[k] + gram[k, k] * x[k]
            new = np.sign(reach) * max(abs(reach) - penalty, 0.0) / gram[k, k]
            if (step := new - x[k]) != 0.0:
                gradient -= gram[:, k] * step
                x[k] = new
                largest = max(largest, abs(step))
        if largest < _TOLERANCE:
            break
    return x
