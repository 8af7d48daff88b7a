"""Effects in their envelope form, first order of averaging: for the slow flow and for the steady state, not for the carrier.

Written in pick-off and drive volts as the catalogue states them, apart from the forces and samples of :mod:`.effect_kernels`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..jit import kernel

__all__ = ["ENVELOPE_EFFECTS", "bent_drive", "bent_pickoff", "effect_rate", "envelope_constants"]

FloatArray = NDArray[np.float64]
# dynamics: nonlinear damping alike, by axis [1/s/V^2], drag [1/s/V], friction [V/s], pump [1/s]; drive: constant force [V], cubic and phase
# by axis, sag, across [1/V^2], clip, dead zone [V]; pick-off: cubic and phase by axis, across [1/V^2], interference, clip [V]
_DAMPING, _DAMPING_X, _DAMPING_Y, _DRAG, _FRICTION = 0, 1, 2, 3, 4
_FORCE, _CUBIC_X, _CUBIC_Y, _PHASE_X, _PHASE_Y, _SAG, _CROSS, _CLIP, _DEAD = 7, 11, 12, 13, 14, 15, 16, 17, 18
_READ_X, _READ_Y, _TURN_X, _TURN_Y, _READ_CROSS, _STRAY, _READ_CLIP = 19, 20, 21, 22, 23, 24, 28
_FRICTION_X, _FRICTION_Y, _PUMP_X, _PUMP_Y, _CURL = 29, 30, 31, 33, 35
_DAMPING_XY, _DAMPING_YX, _DAMPING_XXYY = 36, 37, 38
_COUNT = 39
_PLACES: dict[str, dict[str, int]] = {
    "nonlinear_damping": {"c": _DAMPING},
    "nonlinear_damping_axes": {
        "c_x": _DAMPING_X,
        "c_y": _DAMPING_Y,
        "c_xy": _DAMPING_XY,
        "c_yx": _DAMPING_YX,
        "c_xxyy": _DAMPING_XXYY,
    },
    "quadratic_damping": {"c": _DRAG},
    "coulomb_friction": {"c": _FRICTION},
    "coulomb_friction_axes": {"c_x": _FRICTION_X, "c_y": _FRICTION_Y},
    "circulatory_stiffness": {"k": _CURL},
    "parametric_pump": {},
    "parametric_pump_axes": {},
    "constant_force": {"f_xc": _FORCE, "f_xs": _FORCE + 1, "f_yc": _FORCE + 2, "f_ys": _FORCE + 3},
    "drive_nonlinearity": {"d_x": _CUBIC_X, "d_y": _CUBIC_Y},
    "drive_amplitude_phase": {"d_x": _PHASE_X, "d_y": _PHASE_Y},
    "drive_sag": {"d": _SAG},
    "drive_cross_nonlinearity": {"d": _CROSS},
    "drive_saturation": {"level": _CLIP},
    "drive_dead_zone": {"level": _DEAD},
    "pickoff_nonlinearity": {"c_x": _READ_X, "c_y": _READ_Y},
    "pickoff_amplitude_phase": {"c_x": _TURN_X, "c_y": _TURN_Y},
    "pickoff_cross_nonlinearity": {"c": _READ_CROSS},
    "pickoff_interference": {"v_xc": _STRAY, "v_xs": _STRAY + 1, "v_yc": _STRAY + 2, "v_ys": _STRAY + 3},
    "pickoff_saturation": {"level": _READ_CLIP},
}
#: effects that have their envelope form here
ENVELOPE_EFFECTS = frozenset(_PLACES)


def envelope_constants(effects: Mapping[str, Mapping[str, float]]) -> FloatArray:
    """Numbers of the functions below; effects that are not of :data:`ENVELOPE_EFFECTS` are left out."""
    numbers = np.zeros(_COUNT)
    numbers[_CLIP] = numbers[_READ_CLIP] = math.inf
    for name in ENVELOPE_EFFECTS & set(effects):
        for parameter, place in _PLACES[name].items():
            numbers[place] = effects[name][parameter]
    alike, by_axis = effects.get("parametric_pump", {}), effects.get("parametric_pump_axes", {})
    for axis, start in (("x", _PUMP_X), ("y", _PUMP_Y)):
        for k, q in enumerate("cs"):
            numbers[start + k] = alike.get(f"h_{q}", 0.0) + by_axis.get(f"h_{axis}{q}", 0.0)
    return numbers


@kernel
def _clipped(amplitude, level):  # type: ignore[no-untyped-def]
    """Fundamental of a clipped sine over that of the sine."""
    if amplitude <= level:
        return 1.0
    share = level / amplitude
    return 2.0 / math.pi * (math.asin(share) + share * math.sqrt(1.0 - share * share))


@kernel
def effect_rate(px, py, c):  # type: ignore[no-untyped-def]
    """What damping, friction, pump and a circulatory stiffness add to ``p'`` [V/s] at displacement envelopes px, py (complex, V).

    A wave ``p = e^{i delta} (a n - i q n_perp)`` is damped by a force ``|v|^k v`` at a rate for a and 1/(k + 1) times it for a small q
    (k = 2: 1/3, k = 1: 1/2); dry friction (k = -1) damps q ``ln(4 a/q) - 1`` times as much. The part with a is half of
    ``p + (p.p) p* / |p|^2``, that with q half of the difference.
    """
    xx, yy = px.real * px.real + px.imag * px.imag, py.real * py.real + py.imag * py.imag
    square, dot = xx + yy, px * px + py * py
    straight, curled = 2.0 / 3.0 * c[_DAMPING] * square, c[_DAMPING] / 3.0 * dot
    size = math.sqrt(square)
    if size > 0.0:
        long, short = 0.5 * (square + abs(dot)), 0.5 * (square - abs(dot))
        dry = c[_FRICTION] / size
        more = dry * (0.5 * math.log(16.0 * long / short) - 1.0) if short > 1e-14 * long else dry
        along, across = c[_DRAG] * size + dry, 0.5 * c[_DRAG] * size + more
        straight += 0.5 * (along + across)
        curled += 0.5 * (along - across) * dot / square
    pump_x, pump_y = complex(c[_PUMP_X], c[_PUMP_X + 1]) - curled, complex(c[_PUMP_Y], c[_PUMP_Y + 1]) - curled
    dry_x = c[_FRICTION_X] / math.sqrt(xx) if xx > 0.0 else 0.0
    dry_y = c[_FRICTION_Y] / math.sqrt(yy) if yy > 0.0 else 0.0
    rx = pump_x * px.conjugate() - (straight + c[_DAMPING_X] * xx + dry_x) * px - complex(0.0, c[_CURL]) * py
    ry = pump_y * py.conjugate() - (straight + c[_DAMPING_Y] * yy + dry_y) * py + complex(0.0, c[_CURL]) * px
    rx -= c[_DAMPING_YX] * yy * py + c[_DAMPING_XY] * (2.0 * xx * py + px * px * py.conjugate())
    ry -= c[_DAMPING_XY] * xx * px + c[_DAMPING_YX] * (2.0 * yy * px + py * py * px.conjugate())
    both = c[_DAMPING_XXYY] / 3.0
    rx -= both * (2.0 * yy * px + py * py * px.conjugate())
    ry -= both * (2.0 * xx * py + px * px * py.conjugate())
    return rx, ry


@kernel
def bent_drive(ux, uy, c):  # type: ignore[no-untyped-def]
    """Drive envelopes that act for the commanded ones (complex, V), with the constant force."""
    xx, yy = ux.real * ux.real + ux.imag * ux.imag, uy.real * uy.real + uy.imag * uy.imag
    sag = 1.0 + c[_SAG] * (xx + yy)
    ax, ay = c[_PHASE_X] * xx, c[_PHASE_Y] * yy
    vx, vy = ux * complex(sag * math.cos(ax), sag * math.sin(ax)), uy * complex(sag * math.cos(ay), sag * math.sin(ay))
    xx, yy = xx * sag * sag, yy * sag * sag
    # a dead zone leaves what a clip at its level takes away
    left_x, left_y = 1.0, 1.0
    if c[_DEAD] > 0.0:
        left_x, left_y = 1.0 - _clipped(math.sqrt(xx), c[_DEAD]), 1.0 - _clipped(math.sqrt(yy), c[_DEAD])
    wx = (left_x + c[_CUBIC_X] * xx) * vx + c[_CROSS] * yy * vy
    wy = (left_y + c[_CUBIC_Y] * yy) * vy + c[_CROSS] * xx * vx
    wx, wy = wx * _clipped(abs(wx), c[_CLIP]), wy * _clipped(abs(wy), c[_CLIP])
    return wx + complex(c[_FORCE], c[_FORCE + 1]), wy + complex(c[_FORCE + 2], c[_FORCE + 3])


@kernel
def bent_pickoff(vx, vy, c):  # type: ignore[no-untyped-def]
    """Pick-off envelopes as they are read for those that the motion makes (complex, V)."""
    vx, vy = vx + complex(c[_STRAY], c[_STRAY + 1]), vy + complex(c[_STRAY + 2], c[_STRAY + 3])
    xx, yy = vx.real * vx.real + vx.imag * vx.imag, vy.real * vy.real + vy.imag * vy.imag
    wx = vx * complex(1.0 + c[_READ_X] * xx, c[_TURN_X] * xx) + c[_READ_CROSS] * yy * vy
    wy = vy * complex(1.0 + c[_READ_Y] * yy, c[_TURN_Y] * yy) + c[_READ_CROSS] * xx * vx
    return wx * _clipped(abs(wx), c[_READ_CLIP]), wy * _clipped(abs(wy), c[_READ_CLIP])
