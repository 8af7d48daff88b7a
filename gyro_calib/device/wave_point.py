"""The whole-angle operating point: drives, frequency and precession of a wave that the loops hold at amplitude, at one azimuth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import DeviceError

__all__ = ["WavePoint", "wave_point"]

ComplexArray = NDArray[np.complex128]
FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class WavePoint:
    """Quasi-steady state of a whole-angle gyro (theory.md Eq. 6 with its loops ideal).

    Parameters
    ----------
    theta_rate_rad_s : float
        Precession of the wave as the pick-offs show it [rad/s], mechanical.
    amplitude_drive_v, quadrature_drive_v : float
        u_par_s and u_perp_c in the frame of the wave, before the compensation [V].
    detuning_rad_s : float
        Reference frequency minus the frequency about which A is written [rad/s].
    """

    theta_rate_rad_s: float
    amplitude_drive_v: float
    quadrature_drive_v: float
    detuning_rad_s: float


def wave_point(
    A: ComplexArray,
    G: ComplexArray,
    E: ComplexArray,
    amplitude_v: float,
    azimuth_rad: float,
    *,
    precession_v: float = 0.0,
    stiffness_v_per_v: float = 0.0,
    compensation: FloatArray | None = None,
    latency_s: float = 0.0,
    quadrature: float = 0.0,
    extra: Callable[[ComplexArray], ComplexArray] | None = None,
) -> WavePoint:
    """Solve ``p' = (A - i delta) p + G u + N(p)`` with ``V = p + E u = amplitude (n(psi) - i q n_perp)``, which turns with psi.

    The drive is that of the loops: ``u = C [i u_par_s n + (u_perp_c + i precession) n_perp + CR V]``, its frame late by the latency.

    Parameters
    ----------
    A, G, E : ndarray, shape (2, 2), complex
        Slow flow.
    amplitude_v : float
        Pick-off amplitude of the wave [V].
    azimuth_rad : float
        theta [rad], mechanical, as the pick-offs show it.
    precession_v : float
        Virtual precession drive u_perp_s [V].
    stiffness_v_per_v : float
        CR [V/V].
    compensation : ndarray, shape (2, 2), optional
        C; default: none.
    latency_s : float
        Delay of the drive's frame behind the wave [s].
    quadrature : float
        q, which the loops hold, over the amplitude.
    extra : callable, optional
        N(p) [V/s] of the envelopes, shape (2,) -> (2,).

    Raises
    ------
    DeviceError
        No such state was found (drive chain singular).
    """
    psi = 2.0 * azimuth_rad
    along, across = np.array([np.cos(psi), np.sin(psi)]), np.array([-np.sin(psi), np.cos(psi)])
    turn = np.eye(2) if compensation is None else np.asarray(compensation, dtype=float)
    volts = amplitude_v * (along - 1j * quadrature * across)
    turned = amplitude_v * (across + 1j * quadrature * along)

    def residual(unknowns: FloatArray) -> FloatArray:
        push, pull, detuning, spin = unknowns
        late = spin * latency_s
        n, m = np.cos(late) * along - np.sin(late) * across, np.sin(late) * along + np.cos(late) * across
        drive = turn @ (1j * push * n + (pull + 1j * precession_v) * m + stiffness_v_per_v * volts)
        drift = spin * turn @ (1j * push * m - (pull + 1j * precession_v) * n + stiffness_v_per_v * turned)
        pick = volts - E @ drive
        rest = (A - 1j * detuning * np.eye(2)) @ pick + G @ drive - spin * turned + E @ drift
        if extra is not None:
            rest = rest + extra(np.asarray(pick, dtype=np.complex128))
        flat: FloatArray = np.asarray(rest, dtype=np.complex128).view(np.float64)
        return flat

    gain = float(np.abs(np.diag(G)).mean())
    # drive volts, drive volts, rad/s, rad/s: steps that change the balance alike
    steps = 1e-4 * amplitude_v * np.array([1.0 / gain, 1.0 / gain, 1.0 / amplitude_v, 1.0 / amplitude_v])
    unknowns = np.array([-float((along @ A @ along).real) * amplitude_v / gain, 0.0, float((along @ A @ along).imag), 0.0])
    for _ in range(30):
        slope = np.column_stack([(residual(unknowns + h) - residual(unknowns - h)) / (2.0 * h.sum()) for h in np.diag(steps)])
        change = np.linalg.solve(slope, -residual(unknowns))
        unknowns = unknowns + change
        if np.max(np.abs(change / steps)) < 1e-9:
            return WavePoint(0.5 * float(unknowns[3]), float(unknowns[0]), float(unknowns[1]), float(unknowns[2]))
    raise DeviceError(f"Wave must have a steady state at theta = {azimuth_rad:.3g} rad, but none was found. Check the drive chain.")
