"""Effects with a memory, once per control period: lags and slow parts of drive and pick-off, relaxing stiffness."""

from __future__ import annotations

import math

from ..jit import kernel
from .effect_layout import (
    E_DELAY_X,
    E_DELAY_Y,
    E_LAG_KEEP,
    E_LAG_MEAN,
    E_LATE_X,
    E_LATE_Y,
    E_NOMINAL,
    E_OUT_KEEP,
    E_OUT_SLOW,
    E_OUT_SLOW_KEEP,
    E_PERIOD,
    E_PHASE_X,
    E_PHASE_Y,
    E_RELAX,
    E_RELAX_KEEP,
    E_SAG,
    E_SKEW_KEEP,
    E_SKEW_LEAD,
    E_SLOW,
    E_SLOW_KEEP,
    E_SLOW_MEAN,
    M_EARLY,
    M_LAG,
    M_LAST,
    M_MOTION,
    M_OUT_LAG,
    M_OUT_SLOW,
    M_SKEW,
    M_SLOW,
    M_SOON,
)

__all__ = ["drive_phasors", "pick_phasors", "relaxing_force"]


@kernel
def _drive_with_memory(memory, effect, k, u):  # type: ignore[no-untyped-def]
    """Mean over the coming control period of one quadrature of the drive that is held at ``u``, lagged and with its slow part."""
    lagged, slow = memory[M_LAG + k], memory[M_SLOW + k]
    mean = u + (lagged - u) * effect[E_LAG_MEAN]
    memory[M_LAG + k] = u + (lagged - u) * effect[E_LAG_KEEP]
    memory[M_SLOW + k] = mean + (slow - mean) * effect[E_SLOW_KEEP]
    return mean + effect[E_SLOW] * (mean + (slow - mean) * effect[E_SLOW_MEAN])


@kernel
def _delayed(memory, effect, place, share, omega, c, s):  # type: ignore[no-untyped-def]
    """An envelope whose carrier is late by a share of the control period: itself, and its phase away from the nominal frequency."""
    lc, ls = c + share * (memory[place] - c), s + share * (memory[place + 1] - s)
    memory[place], memory[place + 1] = c, s
    angle = -share * effect[E_PERIOD] * (omega - effect[E_NOMINAL])
    turn_c, turn_s = math.cos(angle), math.sin(angle)
    return lc * turn_c - ls * turn_s, lc * turn_s + ls * turn_c


@kernel
def drive_phasors(memory, effect, omega, gain_x, gain_y, uxc, uxs, uyc, uys):  # type: ignore[no-untyped-def]
    """Drive phasors of the coming control period from the commanded ones [V]: sag, phase with amplitude; slots; delay, lag, memory.

    What takes its time comes behind the slots (``gain_x``, ``gain_y``: volts in the present one over the commanded): the mean of a frame
    is then late by just that, whichever slot a command changes before.
    """
    xx, yy = uxc * uxc + uxs * uxs, uyc * uyc + uys * uys
    factor = 1.0 + effect[E_SAG] * (xx + yy)
    ax, ay = effect[E_PHASE_X] * xx, effect[E_PHASE_Y] * yy
    cx, sx, cy, sy = factor * math.cos(ax), factor * math.sin(ax), factor * math.cos(ay), factor * math.sin(ay)
    uxc, uxs = gain_x * (cx * uxc - sx * uxs), gain_x * (sx * uxc + cx * uxs)
    uyc, uys = gain_y * (cy * uyc - sy * uys), gain_y * (sy * uyc + cy * uys)
    if effect[E_LATE_X] != 0.0 or effect[E_LATE_Y] != 0.0:
        uxc, uxs = _delayed(memory, effect, M_SOON, effect[E_LATE_X], omega, uxc, uxs)
        uyc, uys = _delayed(memory, effect, M_SOON + 2, effect[E_LATE_Y], omega, uyc, uys)
    uxc, uxs = _drive_with_memory(memory, effect, 0, uxc), _drive_with_memory(memory, effect, 1, uxs)
    uyc, uys = _drive_with_memory(memory, effect, 2, uyc), _drive_with_memory(memory, effect, 3, uys)
    return uxc, uxs, uyc, uys


@kernel
def relaxing_force(memory, effect, x, y, vx, vy, c, s):  # type: ignore[no-untyped-def]
    """Force phasors per mass of the relaxing stiffness over the coming control period [m/s^2]: x_c, x_s, y_c, y_s.

    The displacement's envelope is ``(x - i x'/w) e^{-i phi}``; ``F = -2 w c (z_lp - z)`` gives ``p' = i c (p_lp - p)``.
    """
    strength, keep = effect[E_RELAX], effect[E_RELAX_KEEP]
    zxc, zxs, zyc, zys = x * c - vx * s, -x * s - vx * c, y * c - vy * s, -y * s - vy * c
    dxc, dxs = memory[M_MOTION] - zxc, memory[M_MOTION + 1] - zxs
    dyc, dys = memory[M_MOTION + 2] - zyc, memory[M_MOTION + 3] - zys
    memory[M_MOTION], memory[M_MOTION + 1] = zxc + keep * dxc, zxs + keep * dxs
    memory[M_MOTION + 2], memory[M_MOTION + 3] = zyc + keep * dyc, zys + keep * dys
    return -strength * dxc, -strength * dxs, -strength * dyc, -strength * dys


@kernel
def _pick_with_memory(memory, effect, k, v):  # type: ignore[no-untyped-def]
    """One quadrature of a demodulated pick-off, lagged and with its slow part."""
    v = v + (memory[M_OUT_LAG + k] - v) * effect[E_OUT_KEEP]
    memory[M_OUT_LAG + k] = v
    slow = v + (memory[M_OUT_SLOW + k] - v) * effect[E_OUT_SLOW_KEEP]
    memory[M_OUT_SLOW + k] = slow
    return v + effect[E_OUT_SLOW] * slow


@kernel
def _skewed(memory, effect, k, v):  # type: ignore[no-untyped-def]
    """One quadrature of y as it appears later (a low-pass of that delay) or earlier (extrapolated)."""
    late = v + (memory[M_SKEW + k] - v) * effect[E_SKEW_KEEP]
    early = v + effect[E_SKEW_LEAD] * (v - memory[M_LAST + k])
    memory[M_SKEW + k], memory[M_LAST + k] = late, v
    return early if effect[E_SKEW_LEAD] > 0.0 else late


@kernel
def pick_phasors(memory, effect, omega, xc, xs, yc, ys):  # type: ignore[no-untyped-def]
    """Demodulated pick-offs of a control period as the electronics give them [V]: delay, lag, memory, skew of y."""
    if effect[E_DELAY_X] != 0.0 or effect[E_DELAY_Y] != 0.0:
        xc, xs = _delayed(memory, effect, M_EARLY, effect[E_DELAY_X], omega, xc, xs)
        yc, ys = _delayed(memory, effect, M_EARLY + 2, effect[E_DELAY_Y], omega, yc, ys)
    xc, xs = _pick_with_memory(memory, effect, 0, xc), _pick_with_memory(memory, effect, 1, xs)
    yc, ys = _pick_with_memory(memory, effect, 2, yc), _pick_with_memory(memory, effect, 3, ys)
    return xc, xs, _skewed(memory, effect, 0, yc), _skewed(memory, effect, 1, ys)
