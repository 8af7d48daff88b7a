"""What healthy units of a fleet have in common: how large the coefficients of one are, from the diagnoses of several.

Each unit tells its coefficients with a covariance, about zero by a prior of the size that any device has. The likelihood that stands behind
that, with a prior of another size in its place, is the evidence of that size: a Gaussian integral in closed form, of all coefficients of a
unit at once, for those that only their sum or product tells (a drive's gain and a pick-off's) say nothing of either by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize

from ..errors import DataError
from .healthy import HealthySpread, size_of
from .sizes import log_evidence, what_data_say
from .system import Solution

__all__ = ["FEWEST_UNITS", "Coefficients", "FleetSize", "coefficients_of", "fleet_sizes", "fleet_spread"]

FloatArray = NDArray[np.float64]

#: units from which on a fleet is one
FEWEST_UNITS = 3
#: smallest and largest size asked for, and where the search begins, over that of any device
_LEAST, _MOST, _START = 1e-3, 10.0, 0.3
#: twice the log likelihood from the best size to the bound that nineteen of twenty fleets keep
_BOUND = 2.7055


@dataclass(frozen=True)
class Coefficients:
    """What recordings of one unit say of its coefficients, each over the size that any device may have.

    Parameters
    ----------
    names : tuple of str
        Of the columns.
    sizes : tuple of str
        The field of :class:`.healthy.HealthySpread` that each is of.
    precision : ndarray, shape (k, k)
        Of all at once, no prior in it.
    information : ndarray, shape (k,)
        Precision times the likeliest coefficients.

    Raises
    ------
    ValueError
        Shapes that differ.
    """

    names: tuple[str, ...]
    sizes: tuple[str, ...]
    precision: FloatArray
    information: FloatArray

    def __post_init__(self) -> None:
        k = len(self.names)
        if len(self.sizes) != k or self.information.shape != (k,) or self.precision.shape != (k, k):
            shapes = f"{len(self.sizes)}, {self.precision.shape}, {self.information.shape}"
            raise ValueError(f"coefficients must be {k} of each, but got {shapes}.")


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


def coefficients_of(solution: Solution, healthy: HealthySpread, largest: Mapping[str, float]) -> Coefficients:
    """Those of a fit that have a prior of a healthy device's size.

    Parameters
    ----------
    solution : Solution
    healthy : HealthySpread
        Whose sizes stand in its priors.
    largest : mapping
        Priors of drifts at those sizes, by column: a fit has them as small as they are.
    """
    columns, usual = solution.columns, HealthySpread()
    places = [k for k, c in enumerate(columns) if size_of(c.name) and np.isfinite(c.prior_sd)]
    names, sizes = tuple(columns[k].name for k in places), tuple(size_of(columns[k].name) for k in places)
    precision, information = what_data_say(solution, places)
    # in units of any device's size
    prior = [columns[k].prior_sd for k in places]
    by = [largest.get(n, p) * getattr(usual, s) / getattr(healthy, s) / p for n, s, p in zip(names, sizes, prior, strict=True)]
    return Coefficients(names, sizes, precision * np.outer(by, by), information * np.array(by))


def fleet_sizes(units: Sequence[Coefficients]) -> tuple[FleetSize, ...]:
    """How large each kind of coefficient is, by all units.

    Parameters
    ----------
    units : sequence of Coefficients
        Of healthy devices.

    Raises
    ------
    DataError
        Fewer than three units, or none that tells a coefficient.
    """
    if len(units) < FEWEST_UNITS:
        raise DataError(f"A fleet must be {FEWEST_UNITS} units or more, but got {len(units)}. Record more of them.")
    names = [f.name for f in fields(HealthySpread) if any(f.name in unit.sizes for unit in units)]
    if not names:
        raise DataError("A fleet must tell a coefficient, but none of its units does. Record each while the temperature moves.")
    told = [(_places(unit, names), unit) for unit in units]

    def missed(logs: FloatArray) -> tuple[float, FloatArray]:
        """Log evidence of all units and its slopes, sign changed."""
        value, slopes = 0.0, np.zeros(len(names))
        for places, unit in told:
            found, by_coefficient = _evidence(unit, np.exp(logs[places]))
            value += found
            np.add.at(slopes, places, by_coefficient)
        return -value, -slopes

    low, high = np.log(_LEAST), np.log(_MOST)
    start = np.full(len(names), np.log(_START))
    best = minimize(missed, start, jac=True, method="L-BFGS-B", bounds=[(low, high)] * len(names))
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


def _places(unit: Coefficients, names: Sequence[str]) -> NDArray[np.int_]:
    return np.array([names.index(size) for size in unit.sizes], dtype=int)


def _evidence(unit: Coefficients, sd: FloatArray) -> tuple[float, FloatArray]:
    """Log evidence of priors of these sizes, and its slope by the logarithm of each: how much its coefficient's square is above that."""
    scaled = sd[:, None] * unit.precision * sd[None, :]
    posterior = np.linalg.inv(np.eye(sd.size) + scaled)
    values = posterior @ (sd * unit.information)
    return log_evidence(unit.precision, unit.information, sd), np.diag(posterior) + values**2 - 1.0


def _bound_of(missed: Callable[[FloatArray], tuple[float, FloatArray]], best: FloatArray, k: int, high: float) -> float:
    """Where one size, the others as they are likeliest, is as unlikely as the bound is."""

    def beyond(log_size: float) -> float:
        moved = best.copy()
        moved[k] = log_size
        return 2.0 * (missed(moved)[0] - missed(best)[0]) - _BOUND

    return high if beyond(high) < 0.0 else float(brentq(beyond, best[k], high, xtol=1e-3))
