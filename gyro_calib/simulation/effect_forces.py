"""Forces and voltages of the effects at one instant: what the carrier meets sample by sample."""

from __future__ import annotations

import math

from ..jit import kernel
from .effect_layout import (
    E_CLIP,
    E_CLOSED,
    E_CROSS,
    E_CUBIC_X,
    E_CUBIC_Y,
    E_DEAD,
    E_DRAG,
    E_DRIVEN_PUMP,
    E_FRICTION,
    E_FRICTION_X,
    E_FRICTION_Y,
    E_HOLD,
    E_PUMP,
    E_STEP,
    E_VELOCITY,
    E_VELOCITY_X,
    E_VELOCITY_XXYY,
    E_VELOCITY_XY,
    E_VELOCITY_Y,
    E_VELOCITY_YX,
)

__all__ = ["bends_drive", "drive_stage", "friction_direction", "opposes_motion", "pump_stiffness", "velocity_force"]


@kernel
def friction_direction(vx, vy, ax, ay):  # type: ignore[no-untyped-def]
    """Mean of v/|v| while v runs straight from ``v - a/2`` to ``v + a/2``: a sampled sign would beat with the sampling.

    A sign function has harmonics far above the sampling rate; taken at the samples alone they fold onto the carrier, some per cent of the
    friction, with a phase that slides as slowly as the samples slide over the cycle.
    """
    a = math.sqrt(ax * ax + ay * ay)
    if a == 0.0:
        speed = math.sqrt(vx * vx + vy * vy)
        return (vx / speed, vy / speed) if speed > 0.0 else (0.0, 0.0)
    ex, ey = ax / a, ay / a
    middle = vx * ex + vy * ey
    hx, hy = vx - middle * ex, vy - middle * ey
    h = math.sqrt(hx * hx + hy * hy)
    s0, s1 = middle - 0.5 * a, middle + 0.5 * a
    along = (math.sqrt(s1 * s1 + h * h) - math.sqrt(s0 * s0 + h * h)) / a
    across = (math.asinh(s1 / h) - math.asinh(s0 / h)) / a if h > 1e-9 * a else 0.0
    return ex * along + hx * across, ey * along + hy * across


@kernel
def opposes_motion(effect):  # type: ignore[no-untyped-def]
    """Whether :func:`velocity_force` is any."""
    alike, by_axis = effect[E_VELOCITY] != 0.0 or effect[E_DRAG] != 0.0, effect[E_VELOCITY_X] != 0.0 or effect[E_VELOCITY_Y] != 0.0
    turned = effect[E_VELOCITY_XY] != 0.0 or effect[E_VELOCITY_YX] != 0.0 or effect[E_VELOCITY_XXYY] != 0.0
    dry = effect[E_FRICTION] != 0.0 or effect[E_FRICTION_X] != 0.0 or effect[E_FRICTION_Y] != 0.0
    return alike or by_axis or turned or dry


@kernel
def bends_drive(effect):  # type: ignore[no-untyped-def]
    """Whether :func:`drive_stage` changes anything."""
    cubic = effect[E_CUBIC_X] != 0.0 or effect[E_CUBIC_Y] != 0.0 or effect[E_CROSS] != 0.0
    return cubic or effect[E_CLIP] < math.inf or effect[E_DEAD] > 0.0 or effect[E_STEP] > 0.0


@kernel
def velocity_force(vx, vy, ax, ay, effect):  # type: ignore[no-untyped-def]
    """Force per mass that opposes the motion [m/s^2].

    Parameters
    ----------
    vx, vy : float
        Velocity [m/s].
    ax, ay : float
        Its change over a sample [m/s].
    effect : ndarray, shape (N_EFFECT,)
    """
    square = vx * vx + vy * vy
    same = effect[E_VELOCITY] * square
    if effect[E_DRAG] != 0.0:
        same += effect[E_DRAG] * math.sqrt(square)
    xy, yx, both = effect[E_VELOCITY_XY], effect[E_VELOCITY_YX], effect[E_VELOCITY_XXYY]
    fx = -(same + effect[E_VELOCITY_X] * vx * vx + both * vy * vy) * vx - (3.0 * xy * vx * vx + yx * vy * vy) * vy
    fy = -(same + effect[E_VELOCITY_Y] * vy * vy + both * vx * vx) * vy - (xy * vx * vx + 3.0 * yx * vy * vy) * vx
    if effect[E_FRICTION] != 0.0:
        nx, ny = friction_direction(vx, vy, ax, ay)
        # the mean over a sample lowers the fundamental as a hold does
        scale = effect[E_FRICTION] / effect[E_HOLD]
        fx -= scale * nx
        fy -= scale * ny
    if effect[E_FRICTION_X] != 0.0:
        fx -= effect[E_FRICTION_X] / effect[E_HOLD] * friction_direction(vx, 0.0, ax, 0.0)[0]
    if effect[E_FRICTION_Y] != 0.0:
        fy -= effect[E_FRICTION_Y] / effect[E_HOLD] * friction_direction(vy, 0.0, ay, 0.0)[0]
    return fx, fy


@kernel
def _bent(v, cubic, effect):  # type: ignore[no-untyped-def]
    """One drive voltage through converter, dead zone and curvature."""
    step, dead = effect[E_STEP], effect[E_DEAD]
    if step > 0.0:
        v = step * math.floor(v / step + 0.5)
    if dead > 0.0:
        v = v - dead if v > dead else v + dead if v < -dead else 0.0
    return v + cubic * v * v * v


@kernel
def drive_stage(vx, vy, effect):  # type: ignore[no-untyped-def]
    """Voltages that act for the commanded carrier voltages of one sample: step, dead zone, curvature, leakage across, clip."""
    wx, wy = _bent(vx, effect[E_CUBIC_X], effect), _bent(vy, effect[E_CUBIC_Y], effect)
    cross = effect[E_CROSS]
    if cross != 0.0:
        wx, wy = wx + cross * vy * vy * vy, wy + cross * vx * vx * vx
    limit = effect[E_CLIP]
    return min(max(wx, -limit), limit), min(max(wy, -limit), limit)


@kernel
def pump_stiffness(effect, x, y, vx, vy, c, s, uxc, uxs, uyc, uys):  # type: ignore[no-untyped-def]
    """Stiffness at twice the reference over the coming control period: cos and sin of x, of y [1/s^2].

    The amplitude loop commands what of the drives u goes along the velocity, ``Re[(i z)^H u] / |z|``; with the loops off nothing.
    """
    command = 0.0
    zxc, zxs, zyc, zys = x * c - vx * s, -x * s - vx * c, y * c - vy * s, -y * s - vy * c
    size = math.sqrt((zxc * zxc + zxs * zxs) + (zyc * zyc + zys * zys))
    if effect[E_CLOSED] > 0.0 and size > 0.0:
        command = ((zxc * uxs - zxs * uxc) + (zyc * uys - zys * uyc)) / size
    return (
        effect[E_PUMP] + command * effect[E_DRIVEN_PUMP],
        effect[E_PUMP + 1] + command * effect[E_DRIVEN_PUMP + 1],
        effect[E_PUMP + 2] + command * effect[E_DRIVEN_PUMP + 2],
        effect[E_PUMP + 3] + command * effect[E_DRIVEN_PUMP + 3],
    )
