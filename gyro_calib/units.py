"""Display units. Inside the package everything is SI."""

from __future__ import annotations

import math

__all__ = ["DEG_H", "EARTH_RATE_RAD_S", "PPM", "deg_h", "deg_rth", "ppm"]

#: one degree per hour in rad/s
DEG_H = math.pi / 180.0 / 3600.0
#: one part per million
PPM = 1e-6
#: sidereal rotation of the earth [rad/s] (15.041 deg/h)
EARTH_RATE_RAD_S = 7.292115e-5


def deg_h(rate_rad_s: float) -> float:
    """Angular rate [rad/s] in deg/h."""
    return rate_rad_s / DEG_H


def deg_rth(arw_rad_rts: float) -> float:
    """Angle random walk [rad/sqrt(s)] in deg/sqrt(h)."""
    return math.degrees(arw_rad_rts) * 60.0


def ppm(ratio: float) -> float:
    """Dimensionless ratio in parts per million."""
    return ratio / PPM
