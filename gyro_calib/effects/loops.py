"""Effects of the control loops: what is held is not what was asked for, or not where it is."""

from __future__ import annotations

from ._short import BOTH, WHOLE_ANGLE, positive, signed
from .effect import Effect

__all__ = ["LOOPS"]

LOOPS = (
    Effect(
        "loop_error", "Loops that hold something else than their set points", "electronics", (47,),
        (
            signed("a", "1", 1e-3, 0.2, "amplitude over its set point, less one"),
            signed("q", "1", 1e-3, 0.1, "quadrature that is held, over the amplitude"),
            signed("psi", "rad", 1e-3, 0.1, "modal azimuth from its axis at which force to rebalance holds the wave"),
        ),
        (), BOTH,
        "V = a_set (1 + a) [n(psi) - i q n_perp(psi)] on average where the loops are closed; p' is as ever",
    ),
    Effect(
        "angle_latency", "Drives that follow the azimuth of the wave too late", "electronics", (20,),
        (positive("tau", "s", 1e-3, 0.05, "latency of their direction besides that of the control"),),
        ("azimuth",), WHOLE_ANGLE,
        "u is along and across n(psi - psi' tau): p' is as ever, -psi' tau of the amplitude drive is across the wave",
        ("loop_error",),
    ),
)  # fmt: skip
