"""Stiffness that is modulated at twice the reference: by a steady voltage, or by the command of the amplitude loop."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .parts import Linear, Part, Setting, motion, one_axis
from .signals import Signals

__all__ = ["amplitude_command", "driven_pump", "steady_pump"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


def amplitude_command(drive: ComplexArray, moved: ComplexArray) -> FloatArray:
    """Volts of a drive along the velocity of a motion: what the amplitude loop commands, shape (n,).

    A drive u adds ``G u`` to p', G about ``-i`` times a gain: along p if u goes with ``i p``. What precesses the wave, or balances its
    quadrature, is square to that.

    Parameters
    ----------
    drive, moved : ndarray, shape (n, 2), complex
        Envelopes of the drives and of the motion [V].
    """
    along = np.einsum("ij,ij->i", (1j * moved).conj(), drive).real
    return np.asarray(along / np.maximum(np.linalg.norm(moved, axis=1), 1e-12))


def steady_pump(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    """``h p*``, alike on both axes or of each by itself."""
    pumped = motion(s, d).conj()
    if setting["axes"]:
        return _phases(pumped)
    return [Part(f"h_{n}", "flow", f * pumped) for n, f in (("c", 1.0), ("s", 1j))]


def driven_pump(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    """``h U p*``, U the command of the amplitude loop: of an open drive there is none."""
    p = motion(s, d)
    command = amplitude_command(s.drive, p) * (s.recording.command.mode != "loops_off")
    return _phases(command[:, None] * p.conj())


def _phases(x: ComplexArray) -> list[Part]:
    return [Part(f"h_{n}{q}", "flow", f * one_axis(x, k)) for k, n in enumerate("xy") for q, f in (("c", 1.0), ("s", 1j))]
