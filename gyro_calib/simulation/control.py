"""The control law of one step: force to rebalance, whole angle, open drive. One source for both simulators.

Envelopes relative to the phase reference; ``p' = ... + G u`` with ``G ~ -i g``: ``u = i v`` along the oscillator raises its amplitude, and
``u = -i k p / g`` on the closed axis gives ``p' = -k p``.
"""

from __future__ import annotations

import math

from ..jit import inlined_kernel, kernel
from .control_layout import (
    EXC_AMPLITUDE,
    EXC_BODY,
    EXC_DRIVE,
    EXC_FREQUENCY,
    EXC_SECONDARY,
    MODE_FTR_X,
    MODE_LOOPS_OFF,
    MODE_WHOLE_ANGLE,
    P_AMPLITUDE,
    P_AXIS,
    P_COMP,
    P_EXCITATION,
    P_FREQUENCY,
    P_FULL_SCALE,
    P_HELD_PSI,
    P_HELD_Q,
    P_INDEX,
    P_MODE,
    P_PERIOD,
    P_REB_KI,
    P_REB_KP,
    P_REBALANCE,
    P_STIFFNESS,
    P_VOLTS,
    S_BODY,
    S_DRIVE,
    S_OMEGA,
    S_REB_C,
    S_REB_S,
    S_TIME,
    SEEN,
    clip,
    hold_amplitude,
    lock_frequency,
)
from .whole_angle_control import whole_angle_step

__all__ = ["control_step"]


@kernel
def _open_drive(state, param):  # type: ignore[no-untyped-def]
    """Loops off: a drive of fixed volts at a fixed frequency on one axis, or on the body."""
    state[S_OMEGA] = 2.0 * math.pi * param[P_FREQUENCY]
    excitation = int(param[P_EXCITATION])
    if excitation == EXC_BODY:
        state[S_BODY] = param[P_VOLTS]
    volts = param[P_VOLTS] if excitation == EXC_DRIVE else 0.0
    return (volts, 0.0) if int(param[P_AXIS]) == 0 else (0.0, volts)


@inlined_kernel
def _rebalance_step(state, param, oc, os, cc, cs):  # type: ignore[no-untyped-def]
    """Force to rebalance: drive along the oscillator [V, its sine], and both quadratures of the drive of the closed axis [V]."""
    full, period, amplitude = param[P_FULL_SCALE], param[P_PERIOD], param[P_AMPLITUDE]
    excitation = int(param[P_EXCITATION])
    modulated = EXC_AMPLITUDE <= excitation <= EXC_SECONDARY
    wave = math.sin(2.0 * math.pi * param[P_FREQUENCY] * state[S_TIME]) if modulated else 0.0
    target = amplitude
    if excitation == EXC_AMPLITUDE:
        target *= 1.0 + param[P_INDEX] * wave
    # the phase of a small oscillation is noise: hold the frequency until the amplitude has grown
    error = math.atan2(os, oc) if oc * oc + os * os > SEEN * amplitude * amplitude else 0.0
    if excitation == EXC_FREQUENCY:
        error -= param[P_INDEX] * wave
    lock_frequency(state, param, error)
    along = hold_amplitude(state, param, target - oc)
    if param[P_REBALANCE] == 0.0:  # open secondary
        state[S_REB_C] = state[S_REB_S] = 0.0
        return along, 0.0, 0.0
    # secondary modulation asks for a small known motion of the closed axis
    if excitation == EXC_SECONDARY:
        cc -= amplitude * param[P_INDEX] * wave
    # of x the closed axis is n_perp, of y it is -n_perp
    side = 1.0 if int(param[P_MODE]) == MODE_FTR_X else -1.0
    cc, cs = cc - side * param[P_HELD_PSI] * amplitude, cs + side * param[P_HELD_Q] * amplitude
    re = param[P_REB_KP] * cc + state[S_REB_C]
    im = param[P_REB_KP] * cs + state[S_REB_S]
    if abs(re) < full and abs(im) < full:
        state[S_REB_C] += param[P_REB_KI] * cc * period
        state[S_REB_S] += param[P_REB_KI] * cs * period
    # u = -i (re + i im) = im - i re
    return along, clip(im, full), clip(-re, full)


@inlined_kernel
def control_step(state, param, xc, xs, yc, ys):  # type: ignore[no-untyped-def]
    """Advance the loops by one control period, in place.

    Parameters
    ----------
    state : ndarray, shape (N_STATE,)
        Loop state; the drive command of the coming period is left in elements 7-10 [V].
    param : ndarray, shape (N_PARAM,)
        Mode, set points, gains.
    xc, xs, yc, ys : float
        Demodulated pick-offs of the period that ended [V].
    """
    mode = int(param[P_MODE])
    state[S_BODY] = 0.0
    uxc = uxs = uyc = uys = 0.0
    if mode == MODE_LOOPS_OFF:
        uxc, uyc = _open_drive(state, param)
    else:
        if mode >= MODE_WHOLE_ANGLE:
            uxc, uxs, uyc, uys = whole_angle_step(state, param, xc, xs, yc, ys)
        elif mode == MODE_FTR_X:
            uxs, uyc, uys = _rebalance_step(state, param, xc, xs, yc, ys)
        else:
            uys, uxc, uxs = _rebalance_step(state, param, yc, ys, xc, xs)
        stiffness = param[P_STIFFNESS]
        uxc, uxs, uyc, uys = uxc + stiffness * xc, uxs + stiffness * xs, uyc + stiffness * yc, uys + stiffness * ys
    full = param[P_FULL_SCALE]
    state[S_DRIVE] = clip(param[P_COMP] * uxc + param[P_COMP + 1] * uyc, full)
    state[S_DRIVE + 1] = clip(param[P_COMP] * uxs + param[P_COMP + 1] * uys, full)
    state[S_DRIVE + 2] = clip(param[P_COMP + 2] * uxc + param[P_COMP + 3] * uyc, full)
    state[S_DRIVE + 3] = clip(param[P_COMP + 2] * uxs + param[P_COMP + 3] * uys, full)
    state[S_TIME] += param[P_PERIOD]
