r"""From rates about one to three sense axes to an angular velocity vector and its covariance.

Gyro i measures :math:`\omega_i = a_i\cdot\omega`. With the unit vectors as rows of :math:`A`, the angular velocity is
:math:`M\,(\omega_i)`, :math:`M = A^+`, with covariance :math:`M\,\mathrm{diag}(\sigma_i^2)\,M^T + \sigma_u^2\,(I - M A)`:
what no gyro senses is reported as zero with the large variance :math:`\sigma_u^2`. For three orthogonal axes this is a rotation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import DataError

__all__ = ["SenseAxes"]


class SenseAxes:
    """Directions of the sense axes in the frame of the output.

    Parameters
    ----------
    axes : array_like, shape (n, 3), n = 1, 2, 3
        Sense axis of each gyro; normalised here.
    unsensed_sd_rad_s : float
        Standard deviation reported along directions that no gyro senses [rad/s].

    Raises
    ------
    DataError
        Wrong shape, a zero or non-finite axis, or axes that do not span as many directions as there are gyros (condition > 100).
    """

    def __init__(self, axes: ArrayLike, unsensed_sd_rad_s: float = 1000.0) -> None:
        matrix = np.array(axes, dtype=np.float64)
        if matrix.ndim != 2 or matrix.shape[1] != 3 or not 1 <= matrix.shape[0] <= 3:
            raise DataError(f"Sense axes must have shape (1 to 3, 3), but got {matrix.shape}. Give three numbers for each gyro.")
        norms = np.linalg.norm(matrix, axis=1)
        if not (np.isfinite(norms).all() and (norms > 0.0).all()):
            raise DataError(f"Sense axes must be finite and not zero, but got {matrix.tolist()}.")
        if not (np.isfinite(unsensed_sd_rad_s) and unsensed_sd_rad_s > 0.0):
            raise DataError(f"Argument unsensed_sd_rad_s must be > 0, but got {unsensed_sd_rad_s!r}.")
        matrix = (matrix / norms[:, None]).astype(np.float64)
        condition = float(np.linalg.cond(matrix))
        if condition > 100.0:
            raise DataError(f"Sense axes must point in different directions, but got condition {condition:.3g}: {matrix.tolist()}.")
        inverse = np.linalg.pinv(matrix)
        #: unit sense axes, shape (n, 3)
        self.matrix: NDArray[np.float64] = matrix
        #: from rates to angular velocity, shape (3, n)
        self.inverse: NDArray[np.float64] = inverse.astype(np.float64)
        #: covariance for unit variance of gyro i, row-major, shape (n, 9)
        self.unit_covariances: NDArray[np.float64] = np.stack([np.outer(c, c).ravel() for c in inverse.T])
        #: covariance of what is not sensed, row-major, shape (9,)
        self.unsensed_covariance: NDArray[np.float64] = (unsensed_sd_rad_s**2 * (np.eye(3) - inverse @ matrix)).ravel()
        self.unsensed_covariance[np.abs(self.unsensed_covariance) < 1e-9 * unsensed_sd_rad_s**2] = 0.0
        for array in (self.matrix, self.inverse, self.unit_covariances, self.unsensed_covariance):
            array.setflags(write=False)

    def __len__(self) -> int:
        return int(self.matrix.shape[0])

    def angular_velocity(self, rates_rad_s: ArrayLike) -> NDArray[np.float64]:
        """Angular velocity [rad/s], shape (3,), from the rates about the axes, shape (n,)."""
        return self.inverse @ np.asarray(rates_rad_s, dtype=np.float64)

    def covariance(self, variances: ArrayLike) -> NDArray[np.float64]:
        """Covariance [(rad/s)**2], shape (3, 3), from the variances of the rates, shape (n,)."""
        return (np.asarray(variances, dtype=np.float64) @ self.unit_covariances + self.unsensed_covariance).reshape(3, 3)
