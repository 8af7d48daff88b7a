"""What the slow-flow fit gives: values with covariance, the data table, the noise that was found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .linear_fit import NoiseModel

__all__ = ["SlowFlowEstimate", "SlowFlowParameters", "TableRow"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class TableRow:
    """One line of the data table: what was applied and measured at a side band, and what the fit leaves.

    Parameters
    ----------
    label, axis : str
        Recording and its oscillator axis (``""`` with loops off).
    frequency_hz : float
        Side band (0: the carrier).
    pick, drive, residual : tuple of 2 complex
        x, y: projected pick-offs and drives [V sqrt(s)], residual of the slow flow [V/s sqrt(s)].
    sd : tuple of 2 float
        Standard deviation of the residual (mean of real and imaginary part).
    """

    label: str
    axis: str
    frequency_hz: float
    pick: tuple[complex, complex]
    drive: tuple[complex, complex]
    residual: tuple[complex, complex]
    sd: tuple[float, float]


@dataclass(frozen=True)
class SlowFlowParameters:
    """One set of values of the slow flow.

    Parameters
    ----------
    A, G, E : ndarray, shape (2, 2), complex
        [1/s], [1/s], dimensionless.
    body : ndarray, shape (2, k), complex
        Response to one volt of body excitation at each of k frequencies [1/s].
    cubic : ndarray, shape (2, 2), complex
        ``c`` of ``c[:, j] |V_j|^2 V_j`` [1/(s V^2)]; zero when not fitted. Diagonal: imaginary Duffing, real nonlinear damping;
        off the diagonal: cubic cross stiffness and cross damping (document 000, Eqs. 22-27).
    """

    A: ComplexArray
    G: ComplexArray
    E: ComplexArray
    body: ComplexArray
    cubic: ComplexArray


@dataclass(frozen=True)
class SlowFlowEstimate:
    """What the recordings say of the slow flow about ``omega0_rad_s`` at ``temperature_degc``.

    Parameters
    ----------
    values : SlowFlowParameters
        Best estimate; ``A`` includes the constant input rate.
    covariance : ndarray, shape (n, n)
        Of the real parameter vector, see :meth:`vector`.
    has_feedthrough, has_cubic : bool
        E was fitted (otherwise zero); the cubic terms were fitted (otherwise zero).
    cubic_gain : float
        How much chi-square the four cubic terms of both axes take away (0 when they were not tried).
    omega0_rad_s, temperature_degc, temperature_sd_k : float
        Operating point.
    chi2, dof, condition_number : float
        Fit quality, both axes together.
    noise : mapping
        (axis, role, part) -> NoiseModel.
    table : tuple of TableRow
        The data table.
    feedthrough_measured : bool
        Open drive shows E; otherwise it is fitted under a prior about zero.
    """

    values: SlowFlowParameters
    covariance: FloatArray
    has_feedthrough: bool
    has_cubic: bool
    cubic_gain: float
    omega0_rad_s: float
    temperature_degc: float
    temperature_sd_k: float
    chi2: float
    dof: int
    condition_number: float
    noise: dict[tuple[str, str, str], NoiseModel]
    table: tuple[TableRow, ...]
    feedthrough_measured: bool = True

    def vector(self) -> FloatArray:
        """Real parameters per axis: A_ax, A_ay, G~_ax, G~_ay, (E_ax, E_ay), (H_a per body frequency), (c_ax, c_ay), each (re, im)."""
        v = self.values
        parts = [v.A, v.G - v.A @ v.E]
        if self.has_feedthrough:
            parts.append(v.E)
        parts.append(v.body)
        if self.has_cubic:
            parts.append(v.cubic)
        return np.ascontiguousarray(np.hstack(parts)).view(np.float64).ravel()

    def unpack(self, vector: FloatArray) -> SlowFlowParameters:
        """Values of a real parameter vector."""
        parts = np.ascontiguousarray(vector).view(np.complex128).reshape(2, -1)
        A, reduced, rest = parts[:, 0:2], parts[:, 2:4], parts[:, 4:]
        E = cubic = np.zeros((2, 2), dtype=complex)
        if self.has_feedthrough:
            E, rest = rest[:, :2], rest[:, 2:]
        if self.has_cubic:
            rest, cubic = rest[:, :-2], rest[:, -2:]
        return SlowFlowParameters(A, reduced + A @ E, E, rest, cubic)
