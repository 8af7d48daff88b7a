"""Angle-dependent drift of a whole-angle gyro: rate against azimuth, measured and predicted, and the drive compensation that takes it away.

At rest the wave precesses by ``n_perp (Re A + i G C h) n`` with h = u_amp/a (theory.md Eq. 6): the damping's anisotropy turns it with 4
theta, the
forcer's errors with 4 theta and with a constant, both by way of the same drive. Compensating the forcers alone (document 004, Eq. 36)
leaves the
damping's part; choosing C such that ``i G C h = -Re A`` for one h makes the amplitude drive replace what the damping takes, in every
direction:
nothing is left to turn the wave, and the amplitude drive does not depend on the azimuth any more. The frequency split turns the wave only
through a residual quadrature, or through a phase error of the drive; the second is in the prediction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import CalibrationRefused
from ..recording.recording import Recording
from .drive_chain import DriveChain
from .precession import azimuth_fit

__all__ = ["AngleDrift", "damping_pattern", "measured_drift"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class AngleDrift:
    """Rate error against azimuth: ``mean + cos cos 4 theta + sin sin 4 theta``.

    Parameters
    ----------
    harmonics : ndarray, shape (3,)
        mean, cos, sin of the rate ``-2 theta'/kappa`` [rad/s].
    covariance : ndarray, shape (3, 3)
    """

    harmonics: FloatArray
    covariance: FloatArray

    @property
    def amplitude_rad_s(self) -> float:
        """Half of the peak-to-peak drift over the azimuth [rad/s]."""
        return math.hypot(float(self.harmonics[1]), float(self.harmonics[2]))

    def at(self, theta_rad: FloatArray) -> FloatArray:
        """Rate error at each azimuth [rad/s]."""
        mean, cos, sin = self.harmonics
        return np.asarray(mean + cos * np.cos(4.0 * theta_rad) + sin * np.sin(4.0 * theta_rad))


def measured_drift(forward: Recording, backward: Recording, kappa: float) -> AngleDrift:
    """Drift from virtual precession of both senses: what their precession rates have in common, a constant input rate included.

    Parameters
    ----------
    forward, backward : Recording
        Opposite volts, each over a period of 4 theta or more.
    kappa : float
        Angular gain.

    Raises
    ------
    CalibrationRefused
        Volts that are not opposite, or a wave that turned by less than a period.
    """
    plus, minus = azimuth_fit(forward), azimuth_fit(backward)
    if abs(plus.volts + minus.volts) > 1e-6 * abs(plus.volts):
        raise CalibrationRefused(
            f"Virtual precession must be of opposite volts, but got {plus.volts:g} V and {minus.volts:g} V. Record a pair of both senses."
        )
    return AngleDrift(-(plus.coefficients + minus.coefficients) / kappa, (plus.covariance + minus.covariance) / kappa**2)


def damping_pattern(A_at_rest: ComplexArray) -> DriveChain:
    """What the amplitude drive must do in every direction to give back what the damping takes there: the symmetric part of Re A over its
    xx element, in the form of document 004's Eq. 8.

    The antisymmetric part is left out: it turns the wave by the same everywhere, which is the rate's and the bias's business.

    Parameters
    ----------
    A_at_rest : ndarray, shape (2, 2), complex
        Slow flow without input rate [1/s].
    """
    damping = A_at_rest.real / A_at_rest[0, 0].real
    return DriveChain(float(damping[1, 1]) - 1.0, math.atan(0.5 * float(damping[0, 1] + damping[1, 0])), 0.0)
