"""What a drive compensation leaves over, and the next one: the drive chain as identified, with its covariance.

Recorded drives are those that act, behind the compensation C; so every identification finds the chain D of the unit itself (document 004,
Eq. 8, as the controller sees it), and what the controller is left with is ``D C``. The document's aim is ``D C = 1`` up to a common gain.
With the damping's own pattern as the aim, ``D C = T``, the amplitude drive gives back in every direction what the damping takes there, and
the uneven damping turns a free wave no more (:mod:`.angle_drift`). What is left over is ``R = D C T^-1`` either way.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag

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
    aim : DriveChain
        T, what a compensation is to make of it, in the form of Eq. 8; nothing but a gain by default.
    aim_covariance : ndarray, shape (3, 3)
        Of the three of ``aim``; zero where it is settled.
    """

    chain: DriveChain
    covariance: FloatArray
    aim: DriveChain = field(default_factory=lambda: DriveChain(0.0, 0.0, 0.0))
    aim_covariance: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))

    @property
    def vector(self) -> FloatArray:
        """dG, 2 delta, 2 lambda, shape (3,)."""
        return np.array([self.chain.delta_g, self.chain.two_delta, self.chain.two_lambda])

    @property
    def sd(self) -> FloatArray:
        """Standard deviations, shape (3,)."""
        return np.sqrt(np.diag(self.covariance))

    def aimed_at(self, aim: DriveChain) -> IdentifiedChain:
        """The same with an aim that is settled."""
        return replace(self, aim=aim, aim_covariance=np.zeros((3, 3)))

    def behind(self, compensation: ArrayLike) -> IdentifiedChain:
        """R = D C T^-1: what is left over with a compensation (4 numbers, row-major) in force."""
        matrix = np.reshape(np.asarray(compensation, dtype=np.float64), (2, 2))

        def left(both: FloatArray) -> FloatArray:
            aim = np.linalg.inv(DriveChain(*both[3:]).matrix)
            chain = drive_chain_of((DriveChain(*both[:3]).matrix @ matrix @ aim).astype(np.complex128))
            return np.array([chain.delta_g, chain.two_delta, chain.two_lambda])

        return IdentifiedChain(DriveChain(*map(float, left(self._both))), self._spread(left))

    def compensation(self) -> tuple[float, float, float, float]:
        """The matrix that makes the aim of this chain (document 004, Eq. 36), row-major.

        Raises
        ------
        CalibrationRefused
            A chain that cannot be inverted.
        """
        return tuple(float(c) for c in _matrix(self._both))  # type: ignore[return-value]

    def compensation_covariance(self) -> FloatArray:
        """Covariance of the elements of :meth:`compensation`, row-major, shape (4, 4)."""
        return self._spread(_matrix)

    @property
    def _both(self) -> FloatArray:
        return np.concatenate([self.vector, [self.aim.delta_g, self.aim.two_delta, self.aim.two_lambda]])

    def _spread(self, function: Callable[[FloatArray], FloatArray]) -> FloatArray:
        """Covariance of a function of the chain's three numbers and the aim's three."""
        slope = _slope(function, self._both)
        return np.asarray(slope @ block_diag(self.covariance, self.aim_covariance) @ slope.T)

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


def _matrix(both: FloatArray) -> FloatArray:
    return np.asarray((compensation_matrix(DriveChain(*both[:3])) @ DriveChain(*both[3:]).matrix).ravel())


def _slope(function: Callable[[FloatArray], Sequence[float] | FloatArray], at: FloatArray) -> FloatArray:
    """Jacobian by central differences; everything here is of order one and smooth."""
    steps = 1e-6 * np.eye(at.size)
    return np.column_stack([(np.asarray(function(at + h)) - np.asarray(function(at - h))) / 2e-6 for h in steps])
