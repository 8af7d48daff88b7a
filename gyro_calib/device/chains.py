"""Drive chain B, pick-off chain P and feedthrough E: what stands between volts and motion (theory.md Eqs. 1, 2, 8)."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .checks import require_finite, require_non_negative, require_positive

__all__ = ["DriveChain", "Feedthrough", "PickoffChain"]

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class DriveChain:
    """Volts to force per modal mass.

    ``B = gain [[1, tan 2delta - tan 2lambda], [tan 2delta + tan 2lambda, 1 + Delta G]]`` (theory.md Eq. 8), each element with its
    phase: ``phase_x_rad`` and ``phase_y_rad`` of the two drive channels, plus the phase of each coupling.

    Parameters
    ----------
    gain_m_s2_per_v : float
        Force per modal mass and volt of the x drive [m/s^2/V].
    gain_mismatch, two_delta_rad, two_lambda_rad : float
        Delta G, 2 delta, 2 lambda of document 004.
    phase_x_rad, phase_y_rad : float
        Phase of each channel; positive leads.
    coupling_phase_xy_rad, coupling_phase_yx_rad : float
        Extra phase of the couplings y -> x and x -> y.
    gain_tempco_per_k : float
        Relative change of both gains per kelvin.
    at_twice_frequency : bool
        The drives are applied at twice the vibration's frequency: the electrostatic pressure modulates the stiffness and the force is the
        command times the motion (document 003, Eqs. 14-15). The gains above hold at the nominal amplitude; nothing feeds through at the
        frequency of the vibration.
    """

    gain_m_s2_per_v: float
    gain_mismatch: float = 0.0
    two_delta_rad: float = 0.0
    two_lambda_rad: float = 0.0
    phase_x_rad: float = 0.0
    phase_y_rad: float = 0.0
    coupling_phase_xy_rad: float = 0.0
    coupling_phase_yx_rad: float = 0.0
    gain_tempco_per_k: float = 0.0
    at_twice_frequency: bool = False

    def __post_init__(self) -> None:
        require_finite(self)
        require_positive(self, "gain_m_s2_per_v")

    def matrix(self, temperature_rise_k: float = 0.0) -> ComplexArray:
        """B [m/s^2/V], shape (2, 2), complex."""
        delta, lam = math.tan(self.two_delta_rad), math.tan(self.two_lambda_rad)
        ex, ey = cmath.exp(1j * self.phase_x_rad), cmath.exp(1j * self.phase_y_rad)
        cxy, cyx = cmath.exp(1j * self.coupling_phase_xy_rad), cmath.exp(1j * self.coupling_phase_yx_rad)
        shape = np.array([[ex, (delta - lam) * ey * cxy], [(delta + lam) * ex * cyx, (1.0 + self.gain_mismatch) * ey]])
        return np.asarray(self.gain_m_s2_per_v * (1.0 + self.gain_tempco_per_k * temperature_rise_k) * shape, dtype=complex)


@dataclass(frozen=True)
class PickoffChain:
    """Displacement to volts: ``P = gain [[1, n - rho], [n + rho, 1 + mismatch]]``, rows with the phase of their channel.

    Parameters
    ----------
    gain_v_per_m : float
        x pick-off gain [V/m].
    gain_mismatch : float
        r - 1, relative excess of the y gain.
    non_orthogonality_rad, rotation_rad : float
        n and rho.
    phase_x_rad, phase_y_rad : float
        Phase of each channel; positive leads.
    gain_tempco_per_k : float
        Relative change of both gains per kelvin.
    cubic_per_v2 : float
        Pick-off nonlinearity: ``V (1 + cubic_per_v2 V^2)`` on each channel [1/V^2].
    gap_amplitude_v : float
        Volts that the linear x pick-off would give at a displacement of the whole gap, ``gain d``; 0: linear. A capacitance ~ 1/(d - z)
        less its value at rest gives ``V = V_lin / (1 - V_lin / V_gap)``: lines at 2 and 3 times the carrier, each by the same factor q
        below the one before, with ``a/d = 2 q/(1 + q^2)`` (document 000, Trusov-Shkel).
    gap_mismatch : float
        Relative excess of the y gap; with equal gaps the y pick-off has ``V_gap,y = r V_gap,x``.
    """

    gain_v_per_m: float
    gain_mismatch: float = 0.0
    non_orthogonality_rad: float = 0.0
    rotation_rad: float = 0.0
    phase_x_rad: float = 0.0
    phase_y_rad: float = 0.0
    gain_tempco_per_k: float = 0.0
    cubic_per_v2: float = 0.0
    gap_amplitude_v: float = 0.0
    gap_mismatch: float = 0.0

    def __post_init__(self) -> None:
        require_finite(self)
        require_positive(self, "gain_v_per_m")
        require_non_negative(self, "gap_amplitude_v")

    @property
    def per_gap_v(self) -> tuple[float, float]:
        """One over the gap of x and of y in volts of their pick-offs [1/V]; zeros for a linear pick-off."""
        if self.gap_amplitude_v == 0.0:
            return 0.0, 0.0
        return 1.0 / self.gap_amplitude_v, 1.0 / (self.gap_amplitude_v * (1.0 + self.gain_mismatch) * (1.0 + self.gap_mismatch))

    def matrix(self, temperature_rise_k: float = 0.0) -> ComplexArray:
        """P [V/m], shape (2, 2), complex."""
        n, rho = self.non_orthogonality_rad, self.rotation_rad
        shape = np.array([[1.0, n - rho], [n + rho, 1.0 + self.gain_mismatch]])
        phases = np.array([[cmath.exp(1j * self.phase_x_rad)], [cmath.exp(1j * self.phase_y_rad)]])
        return self.gain_v_per_m * (1.0 + self.gain_tempco_per_k * temperature_rise_k) * phases * shape


@dataclass(frozen=True)
class Feedthrough:
    """Direct coupling of drive into pick-off, ``V = P z + E v``: E complex, dimensionless, each element real (re) and 90-degree (im).

    Parameters
    ----------
    xx_re, xx_im, xy_re, xy_im, yx_re, yx_im, yy_re, yy_im : float
        Of the x pick-off from the x drive, of the x pick-off from the y drive, and so on [1].
    """

    xx_re: float = 0.0
    xx_im: float = 0.0
    xy_re: float = 0.0
    xy_im: float = 0.0
    yx_re: float = 0.0
    yx_im: float = 0.0
    yy_re: float = 0.0
    yy_im: float = 0.0

    def __post_init__(self) -> None:
        require_finite(self)

    def matrix(self) -> ComplexArray:
        """E, shape (2, 2), complex."""
        return np.array(
            [[self.xx_re + 1j * self.xx_im, self.xy_re + 1j * self.xy_im], [self.yx_re + 1j * self.yx_im, self.yy_re + 1j * self.yy_im]]
        )
