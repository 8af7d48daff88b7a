"""The force-to-rebalance operating point: drives and frequency that hold one axis at amplitude and the other at zero."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import DeviceError

__all__ = ["OperatingPoint", "ftr_operating_point"]

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class OperatingPoint:
    """Steady state of a force-rebalance gyro.

    Parameters
    ----------
    drive : ndarray, shape (2,), complex
        Drive envelopes [V].
    pick : ndarray, shape (2,), complex
        Pick-off envelopes without feedthrough [V].
    detuning_rad_s : float
        Reference frequency minus the frequency about which A is written [rad/s].
    rate_channel_v : float
        Rebalance drive in phase with velocity [V].
    """

    drive: ComplexArray
    pick: ComplexArray
    detuning_rad_s: float
    rate_channel_v: float


def ftr_operating_point(
    A: ComplexArray,
    G: ComplexArray,
    E: ComplexArray,
    amplitude_v: float,
    oscillator: str,
    *,
    volts: ComplexArray | None = None,
    extra: Callable[[ComplexArray], ComplexArray] | None = None,
) -> OperatingPoint:
    """Solve ``(A - i delta) p + G u + N(p) = 0`` with ``V = p + E u``, V real on the oscillator and zero on the closed axis.

    The oscillator's drive has no component in phase with its displacement (the PLL sees to it), which fixes ``delta``.

    Parameters
    ----------
    A, G, E : ndarray, shape (2, 2), complex
        Slow flow.
    amplitude_v : float
        Pick-off amplitude of the oscillator, feedthrough included [V].
    oscillator : {"x", "y"}
        Oscillating axis.
    volts : ndarray, shape (2,), complex, optional
        Where the loops hold the pick-offs [V] (default: the oscillator at ``amplitude_v``, the closed axis at zero).
    extra : callable, optional
        N(p) [V/s] of the envelopes, shape (2,) -> (2,).

    Raises
    ------
    DeviceError
        No steady state was found (drive chain singular, or far off resonance).
    """
    osc = {"x": 0, "y": 1}[oscillator]
    if volts is None:
        volts = np.zeros(2, dtype=complex)
        volts[osc] = amplitude_v
    delta = float(A[osc, osc].imag)
    pick: ComplexArray = np.array(volts, dtype=np.complex128)
    drive: ComplexArray = np.zeros(2, dtype=np.complex128)
    eye = np.eye(2)
    for _ in range(60):
        dynamics = A - 1j * delta * eye
        force = np.zeros(2, dtype=complex) if extra is None else extra(pick)
        effective = G - dynamics @ E
        drive = np.asarray(np.linalg.solve(effective, -dynamics @ volts - force), dtype=np.complex128)
        slope = np.linalg.solve(effective, 1j * (volts - E @ drive))
        step = -drive[osc].real / slope[osc].real
        delta += step
        pick = np.asarray(volts - E @ drive, dtype=np.complex128)
        if abs(step) < 1e-12 * max(1.0, abs(delta)):
            break
    else:
        raise DeviceError(f"Operating point must converge, but got a last frequency step of {step:.3g} rad/s. Check the drive chain.")
    return OperatingPoint(drive, pick, delta, float(drive[1 - osc].imag))
