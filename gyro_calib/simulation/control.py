"""The control law of one step: PLL, amplitude loop, two-quadrature rebalance, open drive. One source for both simulators.

Envelopes relative to the phase reference; ``p' = ... + G u`` with ``G ~ -i g``: ``u = i v`` along the oscillator raises its amplitude, and
``u = -i k p / g`` on the closed axis gives ``p' = -k p``.
"""

from __future__ import annotations

import math

from ..jit import kernel

MODE_FTR_X, MODE_FTR_Y, MODE_LOOPS_OFF = 0, 1, 2
EXC_NONE, EXC_AMPLITUDE, EXC_FREQUENCY, EXC_SECONDARY, EXC_DRIVE, EXC_BODY = 0, 1, 2, 3, 4, 5

# state: 0 phase, 1 omega, 2 PLL integral [rad/s], 3 amplitude integral [V], 4-5 rebalance integral c, s [V], 6 time [s],
#        7-10 drive command x_c, x_s, y_c, y_s [V], 11 body force volts
S_PHASE, S_OMEGA, S_PLL, S_AMP, S_REB_C, S_REB_S, S_TIME, S_DRIVE, S_BODY = 0, 1, 2, 3, 4, 5, 6, 7, 11
N_STATE = 12
# parameters: mode, set points and excitation, then omega nominal, loop gains, DAC full scale, compensation (4), control period
P_MODE, P_AMPLITUDE, P_EXCITATION, P_FREQUENCY, P_INDEX, P_VOLTS, P_AXIS, P_OMEGA = 0, 1, 2, 3, 4, 5, 6, 7
P_PLL_KP, P_PLL_KI, P_AMP_KP, P_AMP_KI, P_REB_KP, P_REB_KI, P_FULL_SCALE, P_COMP, P_PERIOD = 8, 9, 10, 11, 12, 13, 14, 15, 19
N_PARAM = 20


@kernel
def _clip(value, limit):  # type: ignore[no-untyped-def]
    return min(max(value, -limit), limit)


@kernel
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
    period = param[P_PERIOD]
    full = param[P_FULL_SCALE]
    excitation = int(param[P_EXCITATION])
    t = state[S_TIME]
    state[S_BODY] = 0.0
    uxc = uxs = uyc = uys = 0.0
    if mode == MODE_LOOPS_OFF:
        state[S_OMEGA] = 2.0 * math.pi * param[P_FREQUENCY]
        if excitation == EXC_DRIVE:
            if int(param[P_AXIS]) == 0:
                uxc = param[P_VOLTS]
            else:
                uyc = param[P_VOLTS]
        elif excitation == EXC_BODY:
            state[S_BODY] = param[P_VOLTS]
    else:
        if mode == MODE_FTR_X:
            oc, os, cc, cs = xc, xs, yc, ys
        else:
            oc, os, cc, cs = yc, ys, xc, xs
        wave = math.sin(2.0 * math.pi * param[P_FREQUENCY] * t) if EXC_AMPLITUDE <= excitation <= EXC_SECONDARY else 0.0
        target = param[P_AMPLITUDE]
        if excitation == EXC_AMPLITUDE:
            target *= 1.0 + param[P_INDEX] * wave
        # the phase of a small oscillation is noise: hold the frequency until the amplitude has grown
        error = math.atan2(os, oc) if oc * oc + os * os > 0.04 * param[P_AMPLITUDE] * param[P_AMPLITUDE] else 0.0
        if excitation == EXC_FREQUENCY:
            error -= param[P_INDEX] * wave
        state[S_PLL] = _clip(state[S_PLL] + param[P_PLL_KI] * error * period, 0.01 * param[P_OMEGA])
        state[S_OMEGA] = param[P_OMEGA] + state[S_PLL] + param[P_PLL_KP] * error
        # amplitude: drive along +i
        lack = target - oc
        along = param[P_AMP_KP] * lack + state[S_AMP]
        if abs(along) < full:
            state[S_AMP] += param[P_AMP_KI] * lack * period
        along = _clip(along, full)
        # rebalance of both quadratures; secondary modulation asks for a small known motion of the closed axis
        if excitation == EXC_SECONDARY:
            cc -= param[P_AMPLITUDE] * param[P_INDEX] * wave
        re = param[P_REB_KP] * cc + state[S_REB_C]
        im = param[P_REB_KP] * cs + state[S_REB_S]
        if abs(re) < full and abs(im) < full:
            state[S_REB_C] += param[P_REB_KI] * cc * period
            state[S_REB_S] += param[P_REB_KI] * cs * period
        # u = -i (re + i im) = im - i re
        bc = _clip(im, full)
        bs = _clip(-re, full)
        if mode == MODE_FTR_X:
            uxc, uxs, uyc, uys = 0.0, along, bc, bs
        else:
            uxc, uxs, uyc, uys = bc, bs, 0.0, along
    state[S_DRIVE] = param[P_COMP] * uxc + param[P_COMP + 1] * uyc
    state[S_DRIVE + 1] = param[P_COMP] * uxs + param[P_COMP + 1] * uys
    state[S_DRIVE + 2] = param[P_COMP + 2] * uxc + param[P_COMP + 3] * uyc
    state[S_DRIVE + 3] = param[P_COMP + 2] * uxs + param[P_COMP + 3] * uys
    state[S_TIME] = t + period
