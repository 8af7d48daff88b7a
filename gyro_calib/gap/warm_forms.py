"""Forms of what follows the temperature, with what comes along beyond first order: a thermometer is late, and a phase turns.

Of a damping that bends by ``c T^2`` a thermometer that is late by ``tau`` leaves ``2 c tau T dT/dt``, which is what a pick-off's gain of
``-c tau T^2`` does while it changes: 19 ms of a simulated ring were such a gain, 60 in chi-square beside 146. And a phase ``phi`` takes
``phi^2/2`` of what it turns: of 0.4 mrad/K of a hemisphere's pick-offs that was their gain by the square of the temperature, of 58.
"""

from __future__ import annotations

import numpy as np

from .parts import SKEW, UNEQUAL, Linear, Part, Setting, beside, one_axis, read_at_once, velocity
from .signals import Signals

__all__ = ["bent_damping", "turned_drive", "turned_reading"]

#: by how much a thermometer is late that nobody blames, sd [s]
_LATE_S = 0.1
#: half of a phase per kelvin, sd [rad/K]: times that phase it is what a reading or a drive is shorter by, per square kelvin
_HALF_PER_K = 1e-3


def bent_damping(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    """What is unequal of the damping bends with it."""
    lossy = -0.5 * (d.A + d.A.T).real
    mean = 0.5 * float(np.trace(lossy))
    unequal = lossy - mean * np.eye(2)
    # a pump may undo all of it but what is unequal
    unequal /= max(mean, 2.0 * float(np.abs(unequal).max()), np.finfo(float).tiny)
    damped = velocity(s, d) @ (np.eye(2) + unequal)
    squared = s.temperature_k**2
    late = _LATE_S * np.gradient(squared, s.row_s)
    return [Part("c", "flow", -squared[:, None] * damped), beside("late", "flow", late[:, None] * damped)]


def turned_drive(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    """Phases of the drives, each shorter by half its phase's square."""
    warm = s.temperature_k[:, None] * s.drive
    shorter = -_HALF_PER_K * s.temperature_k[:, None] * warm
    return [
        *(Part(f"g_{n}", "drive", one_axis(1j * warm, k)) for k, n in enumerate("xy")),
        *(beside(f"shorter_{n}", "drive", one_axis(shorter, k)) for k, n in enumerate("xy")),
    ]


def turned_reading(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    """Phases of the pick-offs, each shorter by half its phase's square."""
    t = s.temperature_k[:, None]
    return [
        *(read_at_once(f"g_{n}", s, d, lambda v, k=k: one_axis(1j * t * v, k)) for k, n in enumerate("xy")),  # type: ignore[misc]
        *(
            read_at_once(f"{SKEW}_shorter_{n}", s, d, lambda v, k=k: one_axis(-_HALF_PER_K / UNEQUAL * t**2 * v, k))  # type: ignore[misc]
            for k, n in enumerate("xy")
        ),
    ]
