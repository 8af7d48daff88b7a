"""The drive chain of document 004, Eq. 8, in the recorded matrix G: what is seen of it, what is the chain's own, what undoes it.

    [F_X; F_Y] = k [[1, tan 2 delta - tan 2 lambda], [tan 2 delta + tan 2 lambda, 1 + dG]] [u_X; u_Y]                                (8)

G = -(i/2w) P B is the product of drive and pick-off chain. Three combinations of it are observable from the recordings alone and are all
that the controller needs, because it lives in pick-off volts too: ``seen``. The physical chain B = P^-1 G needs the pick-off frame: the
ratio r
(factory's drive-gain ratio, reciprocity, or a real rotation) for dG, the non-orthogonality n (reciprocity or a real rotation) for 2
delta. The
rotation rho of the pick-offs in the body is a choice of axes and no recording sees it: 2 lambda is physical only as far as rho is known.
Crosstalk of the electronics adds to the couplings with any phase. Its part in quadrature shows; the part in phase cannot be told from
the angles
of the forcers (document 004 counts it into 2 delta), so it is allowed for at the size of the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import CalibrationRefused
from .separation import PickoffFrame

__all__ = ["DriveChain", "compensation_matrix", "coupling_in_quadrature", "drive_chain_of", "iterated_compensation", "physical_gain"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class DriveChain:
    """dG [1], 2 delta [rad], 2 lambda [rad] of Eq. 8."""

    delta_g: float
    two_delta: float
    two_lambda: float

    @property
    def matrix(self) -> FloatArray:
        """Eq. 8 without its gain, shape (2, 2)."""
        a, b = math.tan(self.two_delta), math.tan(self.two_lambda)
        return np.array([[1.0, a - b], [a + b, 1.0 + self.delta_g]])


def drive_chain_of(gain: ComplexArray) -> DriveChain:
    """dG, 2 delta, 2 lambda of a gain matrix: magnitudes on the diagonal, the coupling in phase with it off the diagonal."""
    ratio = gain / gain[0, 0]
    xy, yx = float(ratio[0, 1].real), float(ratio[1, 0].real)
    return DriveChain(abs(ratio[1, 1]) - 1.0, math.atan(0.5 * (yx + xy)), math.atan(0.5 * (yx - xy)))


def coupling_in_quadrature(gain: ComplexArray) -> float:
    """Root mean square of the couplings' part in quadrature with the gain of the drive that they come from."""
    own = np.diag(gain) / np.abs(np.diag(gain)) * abs(gain[0, 0])
    return float(np.sqrt(0.5 * ((gain[0, 1] / own[1]).imag ** 2 + (gain[1, 0] / own[0]).imag ** 2)))


def physical_gain(G: ComplexArray, frame: PickoffFrame, rotation_rad: float) -> ComplexArray:
    """B up to a common factor: G freed of the pick-offs' ratio, non-orthogonality, phase and rotation."""
    n = 0.5 * frame.skew
    pick = np.array([[1.0, n - rotation_rad], [n + rotation_rad, frame.ratio]])
    return np.asarray(np.linalg.solve(pick, G * np.array([[1.0], [np.exp(-1j * frame.phase_rad)]])))


def compensation_matrix(chain: DriveChain) -> FloatArray:
    """Inverse of Eq. 8 (document 004, Eq. 36), shape (2, 2): what the controller applies to (u_X, u_Y).

    Raises
    ------
    CalibrationRefused
        A chain that cannot be inverted.
    """
    matrix = chain.matrix
    if abs(np.linalg.det(matrix)) < 0.1:
        raise CalibrationRefused(f"Drive chain must be invertible, but got {chain}. Look at its wiring before compensating it.")
    return np.asarray(np.linalg.inv(matrix))


def iterated_compensation(in_force: FloatArray | tuple[float, float, float, float], residual: DriveChain) -> FloatArray:
    """The next compensation, from the one in force and the chain that was identified with it in force.

    Force = D C_old u = R u with R the identified residual; D C_new = 1 needs C_new = C_old R^-1.

    Parameters
    ----------
    in_force : array_like, 4 numbers
        C_old, row-major.
    residual : DriveChain
        R, as seen from before C_old.
    """
    return np.asarray(np.reshape(np.asarray(in_force, dtype=np.float64), (2, 2)) @ compensation_matrix(residual))
