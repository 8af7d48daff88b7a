"""Envelope forms of drives that are plates with a gap: their volts soften the axis, and their force grows as the gap closes."""

from __future__ import annotations

import numpy as np

from .parts import Linear, Part, Setting, beside, motion, one_axis
from .signals import Signals

__all__ = ["across_gap", "softened"]

#: phase between the drives' volts and the motion that they meet, of converters that hold them [rad]
_HELD_RAD = 0.2


def across_gap(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    """Gain of a drive by the square of the motion of its axis: ``m^2 u`` at the carrier."""
    direct, pumped = np.abs(s.pick) ** 2 * s.drive / 2.0, s.pick**2 * s.drive.conj() / 4.0
    met = [beside(f"met_{n}", "drive", 1j * _HELD_RAD * one_axis(pumped, k)) for k, n in enumerate("xy")]
    return [*(Part(f"d_{n}", "drive", one_axis(direct + pumped, k)) for k, n in enumerate("xy")), *met]


def softened(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    """Stiffness in proportion to the square of the axis' own drive: ``u^2 x`` at the carrier, or by its mean over a cycle alone.

    A bias that is switched, or drives in a bridge, leave no part at twice the frequency. Volts that are held for a sample meet a motion
    that goes on: the drive in the square, or the motion, is half a sample late or is not, as a device has it.
    """
    p = motion(s, d)
    if setting["axes"]:
        return [Part(f"k_{n}", "flow", one_axis(1j * np.abs(s.drive) ** 2 * p, k)) for k, n in enumerate("xy")]
    direct, pumped = 2.0 * np.abs(s.drive) ** 2 * p, s.drive**2 * p.conj()
    late = {"held": -2.0 * pumped, "met": direct - pumped}
    phases = [beside(f"{of}_{n}", "flow", _HELD_RAD * one_axis(x, k)) for of, x in late.items() for k, n in enumerate("xy")]
    return [*(Part(f"k_{n}", "flow", one_axis(1j * (direct + pumped), k)) for k, n in enumerate("xy")), *phases]
