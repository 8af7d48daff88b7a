"""What healthy units of a fleet have in common: how large the coefficients of one are, from the diagnoses of several.

Each unit tells its coefficients with a covariance, about zero by a prior of the size that any device has. The likelihood that stands behind
that, with a prior of another size in its place, is the evidence of that size: a Gaussian integral in closed form, of all coefficients of a
unit at once, for those that only their sum or product tells (a drive's gain and a pick-off's) say nothing of either by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize

from .healthy import FIELD_OF, HealthySpread
from .system import Solution

__all__ = ["FEWEST_UNITS", "Coefficients", "FleetSize", "coefficients_of", "fleet_sizes", "fleet_spread"]

FloatArray = NDArray[np.float64]

#: units from which on a fleet is one
FEWEST_UNITS = 3
#: smallest and largest size asked for, over that of any device
_LEAST, _MOST = 1e-3, 10.0
#: twice the log likelihood from the best size to the bound that nineteen of twenty fleets keep
_BOUND = 2.7055


@dataclass(frozen=True)
class Coefficients:
    """Coefficients of one unit, each over the size that a healthy device was believed to have.

    Parameters
    ----------
    names : tuple of str
        Of the columns.
    sizes : tuple of str
        The field of :class:`.healthy.HealthySpread` that each is of.
    values : ndarray, shape (k,)
    covariance : ndarray, shape (k, k)
        With that prior, which is one.

    Raises
    ------
    ValueError
        Shapes that differ.
    """

    names: tuple[str, ...]
    sizes: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        k = len(self.names)
        if len(self.sizes) != k or self.values.shape != (k,) or self.covariance.shape != (k, k):
            raise ValueError(f"coefficients must be {k} of each, but got {len(self.sizes)}, {self.values.shape}, {self.covariance.shape}.")

    def information(self) -> tuple[FloatArray, FloatArray]:
        """What the recordings alone say: their information matrix and vector, the prior taken out."""
        inverse = np.linalg.inv(self.covariance)
        values, vectors = np.linalg.eigh((inverse + inverse.T) / 2.0 - np.eye(len(self.names)))
        told = values > 1e-9
        kept = (vectors * np.where(told, values, 0.0)) @ vectors.T
        return kept, vectors[:, told] @ (vectors[:, told].T @ (inverse @ self.values))


@dataclass(frozen=True)
class FleetSize:
    """How large a coefficient is on units of a fleet.

    Parameters
    ----------
    name : str
        Of :class:`.healthy.HealthySpread`.
    likeliest, bound : float
        Standard deviation about zero, and the size that it does not exceed in nineteen of twenty fleets.
    usual : float
        Of any device.
    """

    name: str
    likeliest: float
    bound: float
    usual: float

    @property
    def is_told(self) -> bool:
        """Whether the fleet says more than what is believed of any device."""
        return self.bound < self.usual or self.likeliest > self.usual


def coefficients_of(solution: Solution, healthy: HealthySpread) -> Coefficients:
    """Those of a fit that have a prior of a healthy device's size.

    Parameters
    ----------
    solution : Solution
    healthy : HealthySpread
        Whose sizes stand in its priors.
    """
    field_of = [_field_of(c.name) for c in solution.columns]
    places = [k for k, (c, name) in enumerate(zip(solution.columns, field_of, strict=True)) if name and np.isfinite(c.prior_sd)]
    usual = HealthySpread()
    # about the usual sizes, whichever stood in the fit
    scale = np.array([getattr(usual, field_of[k]) / getattr(healthy, field_of[k]) * solution.columns[k].prior_sd for k in places])
    return Coefficients(
        tuple(solution.columns[k].name for k in places),
        tuple(field_of[k] for k in places),
        solution.values[places] / scale,
        solution.covariance[np.ix_(places, places)] / np.outer(scale, scale),
    )


def fleet_sizes(units: Sequence[Coefficients]) -> tuple[FleetSize, ...]:
    """How large each kind of coefficient is, by all units.

    Parameters
    ----------
    units : sequence of Coefficients
        Of healthy devices.

    Raises
    ------
    ValueError
        Fewer than three units, or none that tells a coefficient.
    """
    if len(units) < FEWEST_UNITS:
        raise ValueError(f"a fleet must be {FEWEST_UNITS} units or more, but got {len(units)}.")
    names = [f.name for f in fields(HealthySpread) if any(f.name in unit.sizes for unit in units)]
    if not names:
        raise ValueError("none of the units tells a coefficient: each needs a recording in which the temperature moves.")
    told = [(_places(unit, names), *unit.information()) for unit in units]

    def missed(logs: FloatArray) -> float:
        return -sum(_log_evidence(np.exp(logs[places]), matrix, vector) for places, matrix, vector in told)

    low, high = np.log(_LEAST), np.log(_MOST)
    best = minimize(missed, np.full(len(names), np.log(0.3)), method="L-BFGS-B", bounds=[(low, high)] * len(names))
    usual = HealthySpread()
    return tuple(
        FleetSize(
            name,
            float(np.exp(best.x[k])) * getattr(usual, name),
            float(np.exp(_bound_of(missed, best.x, k, high))) * getattr(usual, name),
            getattr(usual, name),
        )
        for k, name in enumerate(names)
    )


def fleet_spread(sizes: Sequence[FleetSize]) -> HealthySpread:
    """What a healthy device of the fleet has: the bounds that the fleet tells, else the usual sizes."""
    return HealthySpread(**{size.name: size.bound for size in sizes if size.is_told})


def _field_of(column: str) -> str:
    """The size that a column's prior is of; "" for none."""
    return next((name for begins, name in FIELD_OF.items() if column.startswith(begins)), "")


def _places(unit: Coefficients, names: Sequence[str]) -> NDArray[np.int_]:
    return np.array([names.index(size) for size in unit.sizes], dtype=int)


def _log_evidence(sizes: FloatArray, matrix: FloatArray, vector: FloatArray) -> float:
    """Of priors of these sizes, by what the recordings alone say, but for a constant."""
    scaled = np.eye(sizes.size) + sizes[:, None] * matrix * sizes[None, :]
    factor = np.linalg.cholesky((scaled + scaled.T) / 2.0)
    reached = np.linalg.solve(factor, sizes * vector)
    return float(0.5 * reached @ reached - np.log(np.diag(factor)).sum())


def _bound_of(missed, best: FloatArray, k: int, high: float) -> float:  # type: ignore[no-untyped-def]
    """Where one size, the others as they are likeliest, is as unlikely as the bound is."""

    def beyond(log_size: float) -> float:
        moved = best.copy()
        moved[k] = log_size
        return 2.0 * (missed(moved) - missed(best)) - _BOUND

    return high if beyond(high) < 0.0 else float(brentq(beyond, best[k], high, xtol=1e-3))
