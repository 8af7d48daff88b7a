"""What a drive compensation leaves over, and the next one: the drive chain as identified, with its covariance.

Recorded drives are those that act, behind the compensation C; so every identification finds the chain D of the unit itself (document 004,
Eq. 8, as the controller sees it), and what the controller is left with is ``R = D C``. ``R = 1`` up to a common gain is the aim.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..quantity import Quantity
from .drive_chain import DriveChain, compensation_matrix, drive_chain_of

__all__ = ["CHAIN_NAMES", "IdentifiedChain"]

FloatArray = NDArray[np.float64]
#: names of the three errors, in the order of covariances, with their units
CHAIN_NAMES = {"delta_g": "1", "two_delta": "rad", "two_lambda": "rad"}


@dataclass(frozen=True)
class IdentifiedChain:
    """A drive chain as the controller sees it.

    Parameters
    ----------
    chain : DriveChain
        dG [1], 2 delta, 2 lambda [rad].
    covariance : ndarray, shape (3, 3)
        Of the three.
    """

    chain: DriveChain
    covariance: FloatArray

    @property
    def vector(self) -> FloatArray:
        """dG, 2 delta, 2 lambda, shape (3,)."""
        return np.array([self.chain.delta_g, self.chain.two_delta, self.chain.two_lambda])

    @property
    def sd(self) -> FloatArray:
        """Standard deviations, shape (3,)."""
        return np.sqrt(np.diag(self.covariance))

    def behind(self, compensation: ArrayLike) -> IdentifiedChain:
        """R = D C: what is left with a compensation (4 numbers, row-major) in force."""
        matrix = np.reshape(np.asarray(compensation, dtype=np.float64), (2, 2))

        def left(vector: FloatArray) -> FloatArray:
            chain = drive_chain_of((DriveChain(*vector).matrix @ matrix).astype(np.complex128))
            return np.array([chain.delta_g, chain.two_delta, chain.two_lambda])

        slope = _slope(left, self.vector)
        return IdentifiedChain(DriveChain(*map(float, left(self.vector))), slope @ self.covariance @ slope.T)

    def compensation(self) -> tuple[float, float, float, float]:
        """The matrix that undoes this chain (document 004, Eq. 36), row-major.

        Raises
        ------
        CalibrationRefused
            A chain that cannot be inverted.
        """
        return tuple(float(c) for c in compensation_matrix(self.chain).ravel())  # type: ignore[return-value]

    def compensation_covariance(self) -> FloatArray:
        """Covariance of the elements of :meth:`compensation`, row-major, shape (4, 4)."""
        slope = _slope(lambda vector: compensation_matrix(DriveChain(*vector)).ravel(), self.vector)
        return np.asarray(slope @ self.covariance @ slope.T)

    def quantities(self, prefix: str = "") -> dict[str, Quantity]:
        """The three with standard deviation, by name."""
        return {
            prefix + name: Quantity(float(value), float(sd), unit)
            for (name, unit), value, sd in zip(CHAIN_NAMES.items(), self.vector, self.sd, strict=True)
        }

    def chi_square(self, more: FloatArray | None = None) -> float:
        """Squares over their covariance (and ``more``), 3 degrees of freedom: how far from a perfect chain in units of noise."""
        covariance = self.covariance if more is None else self.covariance + more
        return float(self.vector @ np.linalg.solve(covariance, self.vector)) if covariance.any() else math.inf


def _slope(function: Callable[[FloatArray], Sequence[float] | FloatArray], at: FloatArray) -> FloatArray:
    """Jacobian by central differences; everything here is of order one and smooth."""
    steps = 1e-6 * np.eye(at.size)
    return np.column_stack([(np.asarray(function(at + h)) - np.asarray(function(at - h))) / 2e-6 for h in steps])
