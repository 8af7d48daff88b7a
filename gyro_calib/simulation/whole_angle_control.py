"""The whole-angle loops: amplitude, quadrature and frequency from E, Q, L, M; the azimuth of the wave is free (theory.md section 3).

The pick-offs are ``p = e^{i delta} (a n - i q n_perp)`` with ``n = (cos psi, sin psi)``, ``psi = 2 theta``. In envelopes ``c + i s`` the
document 004, Eqs. 2-3, reads ``E = |x|^2 + |y|^2``, ``Q = 2 (y_c x_s - x_c y_s)``, ``L = 2 (x_c x_s + y_c y_s)``,
``M = x_c^2 - x_s^2 + y_c^2 - y_s^2`` (its sine channels are minus ours). With ``G ~ -i g`` a drive ``i v n`` raises the amplitude,
``i v n_perp`` turns the wave, ``v n_perp`` raises q.
"""

from __future__ import annotations

import math

from ..jit import kernel
from .control_layout import (
    MODE_RING_DOWN,
    MODE_RING_UP,
    P_AMPLITUDE,
    P_CONSTANT,
    P_FULL_SCALE,
    P_GAIN,
    P_HELD_Q,
    P_LATE,
    P_MODE,
    P_PERIOD,
    P_PRECESSION,
    P_QUAD_KI,
    P_QUAD_KP,
    P_THRESHOLD,
    S_LATE,
    S_LEG,
    S_QUAD,
    S_WAVE,
    SEEN,
    clip,
    hold_amplitude,
    lock_frequency,
)

__all__ = ["whole_angle_step"]


@kernel
def _ring_drive(state, param, a):  # type: ignore[no-untyped-def]
    """Amplitude drive of a ring-down or ring-up: CA times the amplitude until the leg ends, then the loop holds what was reached."""
    up = int(param[P_MODE]) == MODE_RING_UP
    target = param[P_AMPLITUDE] * (1.0 if up else param[P_THRESHOLD])
    if (up and a >= target) or (not up and a <= target):
        state[S_LEG] = 1.0
    if state[S_LEG] > 0.0:
        return hold_amplitude(state, param, target - a)
    return clip(param[P_GAIN] * (param[P_AMPLITUDE] if param[P_CONSTANT] > 0.0 else a), param[P_FULL_SCALE])


@kernel
def _direction(state, param):  # type: ignore[no-untyped-def]
    """Unit vector along which the drives take the wave to be: where it is, or where it was."""
    nx, ny, keep = state[S_WAVE], state[S_WAVE + 1], param[P_LATE]
    if keep > 0.0 and state[S_LATE] * nx + state[S_LATE + 1] * ny > 0.0:
        nx, ny = nx + keep * (state[S_LATE] - nx), ny + keep * (state[S_LATE + 1] - ny)
        long = math.sqrt(nx * nx + ny * ny)
        nx, ny = nx / long, ny / long
    state[S_LATE], state[S_LATE + 1] = nx, ny
    return nx, ny


@kernel
def whole_angle_step(state, param, xc, xs, yc, ys):  # type: ignore[no-untyped-def]
    """Advance the whole-angle loops by one control period, in place.

    Parameters
    ----------
    state, param : ndarray
        As in :func:`.control.control_step`.
    xc, xs, yc, ys : float
        Demodulated pick-offs of the period that ended [V].

    Returns
    -------
    tuple of 4 float
        x_c, x_s, y_c, y_s of the drive before stiffness control and compensation [V].
    """
    amplitude, full = param[P_AMPLITUDE], param[P_FULL_SCALE]
    energy = xc * xc + xs * xs + yc * yc + ys * ys
    cross = 2.0 * (yc * xs - xc * ys)
    plus, minus = math.sqrt(max(energy + cross, 0.0)), math.sqrt(max(energy - cross, 0.0))
    a, q = 0.5 * (plus + minus), 0.5 * (plus - minus)
    error = 0.0
    if energy > SEEN * amplitude * amplitude:
        error = 0.5 * math.atan2(2.0 * (xc * xs + yc * ys), xc * xc - xs * xs + yc * yc - ys * ys)
        c, s = math.cos(error), math.sin(error)
        state[S_WAVE], state[S_WAVE + 1] = (xc * c + xs * s) / a, (yc * c + ys * s) / a
    else:  # no wave to see: build one up where the last was
        q = 0.0
    nx, ny = _direction(state, param)
    lock_frequency(state, param, error)
    if int(param[P_MODE]) == MODE_RING_DOWN or int(param[P_MODE]) == MODE_RING_UP:
        along = _ring_drive(state, param, a)
    else:
        along = hold_amplitude(state, param, amplitude - a)
    q -= param[P_HELD_Q] * amplitude
    push = param[P_QUAD_KP] * q + state[S_QUAD]
    if abs(push) < full:
        state[S_QUAD] += param[P_QUAD_KI] * q * param[P_PERIOD]
    push = -clip(push, full)
    turn = param[P_PRECESSION]
    return -push * ny, along * nx - turn * ny, push * nx, along * ny + turn * nx
