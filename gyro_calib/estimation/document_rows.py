"""Lines of the data table as the model of document 000 takes them, and where the resonances were while each was recorded."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .sideband_table import SidebandRow

__all__ = ["ResonanceTrack", "Rows", "line_amplitudes"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Rows:
    """Lines that the model predicts, one entry per recording and signed frequency, shape (n,) or (n, 2).

    Parameters
    ----------
    nu : ndarray
        Signed, 0 at the carrier [rad/s].
    stretch : ndarray
        nu (omega/omega0 + nu/(2 omega0)) [rad/s].
    damping : ndarray
        (omega + nu)/omega0.
    offset : ndarray, shape (n, 2)
        m_a as far as it does not depend on the parameters [rad/s].
    link : ndarray, shape (n, 2, loops)
        Its dependence on m of the oscillator of each loop recording.
    acting, recorded : ndarray, shape (n, 2), complex
        Drive as the resonator gets it, and as recorded [V].
    pick : ndarray, shape (n, 2), complex
        Measured [V].
    body : ndarray, shape (n, bodies), float
        Volts of the body excitation, in the column of its frequency.
    cube : ndarray, shape (n, 2), complex
        What a stiffening multiplies [V^3]: side bands of |p|^2 p on the oscillator's axis; with loops off, p times the excess of its square
        over the oscillator's.
    """

    nu: FloatArray
    stretch: FloatArray
    damping: FloatArray
    offset: FloatArray
    link: FloatArray
    acting: ComplexArray
    recorded: ComplexArray
    pick: ComplexArray
    body: FloatArray
    cube: ComplexArray


class ResonanceTrack:
    """The resonances over time, from the reference frequency of the loop recordings: a level per axis and a common slow drift."""

    def __init__(self, loops: list[SidebandRow], oscillator: NDArray[np.int_], omega0: float) -> None:
        times = np.array([r.time_s for r in loops])
        self._middle, self._half = float(times.mean()), max(float(np.ptp(times)) / 2.0, 1.0)
        self._order = min(3, max(0, times.size // 3 - 1))
        design = np.hstack([oscillator[:, None] == np.arange(2), self._drift(times)]).astype(float)
        self._design, self._solve = design, np.linalg.pinv(design)
        self._distance = np.array([(r.omega_rad_s**2 - omega0**2) / (2.0 * omega0) for r in loops])

    def _drift(self, times: FloatArray) -> FloatArray:
        x = (np.atleast_1d(times) - self._middle) / self._half
        return np.column_stack([x**k for k in range(1, self._order + 1)]) if self._order else np.zeros((x.size, 0))

    def scatter(self, m: FloatArray) -> float:
        """Standard deviation of the recordings about the track, given m of their oscillators."""
        seen = self._distance - m
        left = seen - self._design @ (self._solve @ seen)
        return float(np.sqrt(left @ left / max(1, left.size - self._design.shape[1])))

    def at(self, time_s: float) -> tuple[FloatArray, FloatArray]:
        """``(omega0^2 - omega_a^2)/(2 omega0)`` of x and y at a time: constant (2,), and factor of the oscillators' m (2, loops)."""
        drift = np.tile(self._drift(np.array([time_s])), (2, 1))
        weights = np.hstack([np.eye(2), drift]) @ self._solve
        return -(weights @ self._distance), weights


def line_amplitudes(row: SidebandRow, nus: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Pick-offs and recorded drives of one recording at signed frequencies, each shape (k, 2)."""
    sign = (nus < 0.0).astype(int)
    carrier = nus == 0.0
    side = np.isclose(np.abs(nus), row.nu_rad_s, rtol=1e-9, atol=0.0) & ~carrier
    pick, drive = np.empty((nus.size, 2), dtype=complex), np.empty((nus.size, 2), dtype=complex)
    quiet = ~(carrier | side)
    if np.any(quiet):
        place = np.minimum(np.searchsorted(row.quiet_hz, np.abs(nus[quiet]) / (2.0 * math.pi) - 1e-9), row.quiet_hz.size - 1)
        pick[quiet], drive[quiet] = row.quiet_pick[place, sign[quiet]], row.quiet_drive[place, sign[quiet]]
    pick[carrier], drive[carrier] = row.carrier_pick, row.carrier_drive
    pick[side], drive[side] = row.pick[sign[side]], row.drive[sign[side]]
    return pick, drive
