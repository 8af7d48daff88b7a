"""The resonator: two orthogonal modes of a ring, disk or hemisphere, per unit modal mass (theory.md Eq. 1).

``z'' + D z' + 2 kappa Omega J z' + K z + N(z, z') = B v``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import DeviceError
from .checks import require_finite, require_positive

__all__ = ["BOLTZMANN_J_PER_K", "ZERO_CELSIUS_K", "J", "Nonlinearity", "Resonator", "azimuth_matrix"]

FloatArray = NDArray[np.float64]

BOLTZMANN_J_PER_K = 1.380649e-23
ZERO_CELSIUS_K = 273.15
#: Coriolis coupling matrix of theory.md Eq. 1
J: FloatArray = np.array([[0.0, -1.0], [1.0, 0.0]])


def azimuth_matrix(angle_rad: float) -> FloatArray:
    """``R(alpha) = [[cos 4 alpha, sin 4 alpha], [sin 4 alpha, -cos 4 alpha]]`` of theory.md Eq. 1, shape (2, 2)."""
    c, s = math.cos(4.0 * angle_rad), math.sin(4.0 * angle_rad)
    return np.array([[c, s], [s, -c]])


@dataclass(frozen=True)
class Nonlinearity:
    """Cubic restoring and damping forces per modal mass, in displacement units.

    Parameters
    ----------
    cubic_isotropic : float
        ``k3`` of ``k3 |z|^2 z`` [1/(m^2 s^2)] (Duffing).
    cubic_x, cubic_y : float
        ``k3x x^3`` and ``k3y y^3`` [1/(m^2 s^2)].
    cubic_cross_xy, cubic_cross_yx : float
        Force on x ``k y^3`` and on y ``k x^3`` [1/(m^2 s^2)] (document 000, Eqs. 22-23).
    damping_quadratic : float
        ``c3`` of the amplitude-dependent damping ``c3 |z|^2 z'`` [1/(m^2 s)].
    """

    cubic_isotropic: float = 0.0
    cubic_x: float = 0.0
    cubic_y: float = 0.0
    cubic_cross_xy: float = 0.0
    cubic_cross_yx: float = 0.0
    damping_quadratic: float = 0.0

    def __post_init__(self) -> None:
        require_finite(self)

    @property
    def coefficients(self) -> tuple[float, float, float, float, float, float]:
        """The six coefficients in declaration order (what the kernels take)."""
        return (
            self.cubic_isotropic,
            self.cubic_x,
            self.cubic_y,
            self.cubic_cross_xy,
            self.cubic_cross_yx,
            self.damping_quadratic,
        )


@dataclass(frozen=True)
class Resonator:
    """Linear two-mode resonator and how it moves with temperature.

    Parameters
    ----------
    frequency_hz, quality_factor : float
        Mean natural frequency and quality factor at ``reference_temperature_degc``.
    angular_gain : float
        kappa: Coriolis mass over modal mass (4/5 for a thin ring, 0.55-0.6 for a hemisphere).
    modal_mass_kg : float
        Sets the thermomechanical force noise.
    frequency_split_hz, split_azimuth_rad : float
        Delta omega / 2 pi and theta_omega.
    damping_anisotropy, damping_azimuth_rad : float
        Delta(1/tau) over 1/tau, and theta_tau.
    frequency_tempco_per_k : float
        Relative change of frequency per kelvin (silicon: -27e-6).
    quality_exponent : float
        ``Q ~ T^-n`` with T absolute.
    reference_temperature_degc : float
        Temperature of the numbers above.

    Raises
    ------
    DeviceError
        A value that is not finite or not physical.
    """

    frequency_hz: float
    quality_factor: float
    angular_gain: float = 0.8
    modal_mass_kg: float = 1e-8
    frequency_split_hz: float = 0.0
    split_azimuth_rad: float = 0.0
    damping_anisotropy: float = 0.0
    damping_azimuth_rad: float = 0.0
    frequency_tempco_per_k: float = 0.0
    quality_exponent: float = 0.0
    reference_temperature_degc: float = 25.0

    def __post_init__(self) -> None:
        require_finite(self)
        require_positive(self, "frequency_hz", "quality_factor", "angular_gain", "modal_mass_kg")
        if abs(self.damping_anisotropy) >= 2.0:
            raise DeviceError(f"Resonator damping_anisotropy must be below 2 (both modes damped), but got {self.damping_anisotropy!r}.")

    @property
    def omega0_rad_s(self) -> float:
        """Mean natural angular frequency at the reference temperature [rad/s]."""
        return 2.0 * math.pi * self.frequency_hz

    def frequency_at(self, temperature_degc: float) -> float:
        """Mean natural frequency at a temperature [Hz]."""
        return self.frequency_hz * (1.0 + self.frequency_tempco_per_k * (temperature_degc - self.reference_temperature_degc))

    def decay_rate(self, temperature_degc: float | None = None) -> float:
        """Mean amplitude decay rate 1/tau = omega0 / 2Q [1/s]."""
        rate = self.omega0_rad_s / (2.0 * self.quality_factor)
        if temperature_degc is None:
            return rate
        ratio = (temperature_degc + ZERO_CELSIUS_K) / (self.reference_temperature_degc + ZERO_CELSIUS_K)
        return rate * ratio**self.quality_exponent

    def damping_matrix(self, temperature_degc: float | None = None) -> FloatArray:
        """D of theory.md Eq. 1 [1/s], shape (2, 2), symmetric."""
        rate = self.decay_rate(temperature_degc)
        return rate * (2.0 * np.eye(2) + self.damping_anisotropy * azimuth_matrix(self.damping_azimuth_rad))

    def stiffness_matrix(self, temperature_degc: float | None = None) -> FloatArray:
        """K of theory.md Eq. 1 [1/s^2], shape (2, 2), symmetric."""
        t = self.reference_temperature_degc if temperature_degc is None else temperature_degc
        omega = 2.0 * math.pi * self.frequency_at(t)
        split = 2.0 * math.pi * self.frequency_split_hz
        return omega**2 * np.eye(2) + omega * split * azimuth_matrix(self.split_azimuth_rad)

    def thermal_acceleration_psd(self, temperature_degc: float) -> float:
        """Two-sided spectral density of the thermomechanical force per mass, each mode [(m/s^2)^2/Hz]: 2 k_B T omega0/(m Q)."""
        kelvin = temperature_degc + ZERO_CELSIUS_K
        return 2.0 * BOLTZMANN_J_PER_K * kelvin * 2.0 * self.decay_rate(temperature_degc) / self.modal_mass_kg

    def thermomechanical_arw(self, amplitude_m: float, temperature_degc: float) -> float:
        """Angle random walk floor, force to rebalance [rad/sqrt(s)]: (1/(kappa a)) sqrt(k_B T/(m omega Q)) (theory.md section 7).

        Parameters
        ----------
        amplitude_m : float
            a [m].
        temperature_degc : float
            T [degC].
        """
        kelvin = temperature_degc + ZERO_CELSIUS_K
        variance = BOLTZMANN_J_PER_K * kelvin / (self.modal_mass_kg * self.omega0_rad_s * self.quality_factor)
        return math.sqrt(variance) / (self.angular_gain * amplitude_m)
