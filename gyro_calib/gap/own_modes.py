"""A resonance that is not the gyro's and answers its drives: where it may lie, and what the pick-offs read of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from .parts import Linear, Part, Setting, one_axis
from .signals import Signals

__all__ = ["mode_parts", "modes"]

ComplexArray = NDArray[np.complex128]


def modes(signals: list[Signals]) -> list[Setting]:
    """Distances from the carrier and widths to try."""
    distances = np.array([1.0, 2.0, 4.0, 8.0, 14.0, 18.0, 22.0, 30.0, 45.0, 56.0, 64.0, 90.0, 150.0])
    return [{"separation_hz": float(f), "half_width_hz": w} for f in (*-distances, *distances) for w in (0.5, 3.0)]


def mode_parts(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    """Resonances of their own, which follow the temperature as the gyro's does; an open drive has held them in their steady state."""
    pole = 2.0 * np.pi * complex(-setting["half_width_hz"], setting["separation_hz"])
    behind = s.detuning_rad_s - d.moved(s).imag
    if s.recording.command.mode == "loops_off":
        answers = s.drive / (1j * behind - pole)[:, None]
    else:
        # in the frame that the resonance turns with, where the pole stands still
        turn = np.exp(1j * np.cumsum(behind) * s.row_s)[:, None]
        answers = _driven(s.drive * turn, pole, s.row_s) / turn
    # a displacement is a quarter of a cycle behind a force that meets its resonance
    of_drive = {b: -1j * np.stack([answers[:, k]] * 2, axis=1) for k, b in enumerate("xy")}
    return [Part(f"gain_{a}{b}", "output", one_axis(answer, k)) for k, a in enumerate("xy") for b, answer in of_drive.items()]


def _driven(force: ComplexArray, pole: complex, row_s: float) -> ComplexArray:
    """q of ``q' = pole q + force``, the force straight between its rows, begun at the steady state."""
    z = pole * row_s
    grown = np.exp(z)
    first, second = (grown - 1.0) / z, (grown - 1.0 - z) / z**2
    start = -force[:1] / pole - row_s * second * force[:1]
    out, _ = lfilter(row_s * np.array([second, first - second]), [1.0, -grown], force, axis=0, zi=start)
    return np.asarray(out)
