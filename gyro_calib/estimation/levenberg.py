"""Levenberg-Marquardt least squares for problems with their own Jacobian: what the frequency and the time domain share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import CalibrationRefused

__all__ = ["LeastSquares", "levenberg_marquardt"]

FloatArray = NDArray[np.float64]
#: residual (n,) and Jacobian (n, p) at the parameters (p,)
Model = Callable[[FloatArray], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True)
class LeastSquares:
    """Outcome of a fit.

    Parameters
    ----------
    parameters : ndarray, shape (p,)
    cost : float
        Sum of squared residuals.
    covariance : ndarray, shape (p, p)
        Inverse of J^T J (residuals of unit variance).
    condition_number : float
        Of the Jacobian with its columns scaled to unit length.
    iterations : int
        Jacobians evaluated.
    converged : bool
        The last step would have changed the cost by less than the tolerance.
    """

    parameters: FloatArray
    cost: float
    covariance: FloatArray
    condition_number: float
    iterations: int
    converged: bool


def levenberg_marquardt(model: Model, start: FloatArray, *, tolerance: float = 1e-10, limit: int = 60) -> LeastSquares:
    """Minimise the sum of squared residuals.

    Parameters
    ----------
    model : callable
        Residual and Jacobian.
    start : ndarray, shape (p,)
        Where to begin.
    tolerance : float
        Ends when a step promises to lower the cost by less than this share of it (or by less than rounding).
    limit : int
        Largest number of iterations.

    Raises
    ------
    CalibrationRefused
        A parameter has no effect on any residual, or some cannot be told apart.
    """
    here = np.array(start, dtype=float)
    residual, jacobian = model(here)
    cost = first = float(residual @ residual)
    damping, converged, iterations = 1e-3, False, 1
    normal, scale = _normal(jacobian)
    gradient = (jacobian.T @ residual) / scale
    while iterations < limit and not converged and damping < 1e8:
        step = -np.linalg.solve(normal + damping * np.eye(scale.size), gradient)
        promised = -float(step @ (2.0 * gradient + normal @ step))
        nothing_to_gain = promised <= tolerance * cost + 1e-24 * first
        trial = here + step / scale
        new_residual, new_jacobian = model(trial)
        iterations += 1
        new_cost = float(new_residual @ new_residual)
        converged = nothing_to_gain and damping < 1e-2
        if new_cost <= cost:
            here, residual, cost = trial, new_residual, new_cost
            normal, scale = _normal(new_jacobian)
            gradient = (new_jacobian.T @ residual) / scale
            damping = max(0.1 * damping, 1e-12)
        else:
            damping *= 10.0
            converged = nothing_to_gain
    values, vectors = np.linalg.eigh(normal)
    if values[0] < 1e-15 * values[-1]:
        condition = np.sqrt(values[-1] / max(values[0], 1e-300))
        raise CalibrationRefused(
            f"Recordings must tell the parameters apart, but the design has condition number {condition:.2g}. "
            "Record side bands at more frequencies on both axes."
        )
    covariance = (vectors / values) @ vectors.T / np.outer(scale, scale)
    return LeastSquares(here, cost, np.asarray(covariance), float(np.sqrt(values[-1] / values[0])), iterations, converged)


def _normal(jacobian: FloatArray) -> tuple[FloatArray, FloatArray]:
    """J^T J with unit diagonal, and the lengths of the columns."""
    normal = jacobian.T @ jacobian
    scale = np.sqrt(np.diag(normal))
    if not np.all(scale > 0.0):
        raise CalibrationRefused(f"Recordings must excite every parameter, but {int(np.sum(scale == 0.0))} have no effect on them.")
    return np.asarray(normal / np.outer(scale, scale)), scale
