"""Layout of the control law's state and parameters, and the loops that all its modes share.

Compiled kernels take these numbers in as constants, and the cache of compiled code follows the files of kernels only: that the shared loops
live here makes this file one of them.
"""

from __future__ import annotations

from ..jit import kernel

__all__ = ["clip", "hold_amplitude", "lock_frequency", "middle_motion"]

MODE_FTR_X, MODE_FTR_Y, MODE_LOOPS_OFF, MODE_WHOLE_ANGLE, MODE_RING_DOWN, MODE_RING_UP = 0, 1, 2, 3, 4, 5
EXC_NONE, EXC_AMPLITUDE, EXC_FREQUENCY, EXC_SECONDARY, EXC_DRIVE, EXC_BODY = 0, 1, 2, 3, 4, 5

# state: 0 phase, 1 omega, 2 PLL integral [rad/s], 3 amplitude integral [V], 4-5 rebalance integral c, s [V], 6 time [s],
#        7-10 drive command x_c, x_s, y_c, y_s [V], 11 body force volts, 12 quadrature integral [V], 13-14 cos and sin of psi = 2 theta,
#        15 whether the leg of a ring-down or ring-up has ended; of the multiplexer: 16 slot, 17-20 drives as last switched on [V], 21-22
#        reference frequency one and two slots ago; 23 motion at the start of the period before [m], 24-25 direction of the drives
S_PHASE, S_OMEGA, S_PLL, S_AMP, S_REB_C, S_REB_S, S_TIME, S_DRIVE, S_BODY = 0, 1, 2, 3, 4, 5, 6, 7, 11
S_QUAD, S_WAVE, S_LEG, S_SLOT, S_HELD, S_PAST, S_MOTION, S_LATE = 12, 13, 15, 16, 17, 21, 23, 24
N_STATE = 26
# parameters: mode, set points and excitation, then omega nominal, loop gains, DAC full scale, compensation (4), control period,
#             whether the closed axis is held; then of the whole-angle modes: quadrature gains, precession [V], CR [V/V], CA [V/V],
#             threshold over the set point, whether CA drives with constant volts; what loops that err hold: quadrature and azimuth
#             over the amplitude; share of its last direction that a late drive keeps
P_MODE, P_AMPLITUDE, P_EXCITATION, P_FREQUENCY, P_INDEX, P_VOLTS, P_AXIS, P_OMEGA = 0, 1, 2, 3, 4, 5, 6, 7
P_PLL_KP, P_PLL_KI, P_AMP_KP, P_AMP_KI, P_REB_KP, P_REB_KI, P_FULL_SCALE, P_COMP, P_PERIOD = 8, 9, 10, 11, 12, 13, 14, 15, 19
P_REBALANCE, P_QUAD_KP, P_QUAD_KI, P_PRECESSION, P_STIFFNESS, P_GAIN, P_THRESHOLD, P_CONSTANT = 20, 21, 22, 23, 24, 25, 26, 27
P_HELD_Q, P_HELD_PSI, P_LATE = 28, 29, 30
N_PARAM = 31

#: square of the amplitude, over that of the set point, below which the phase of an oscillation is noise
SEEN = 0.04


@kernel
def clip(value, limit):  # type: ignore[no-untyped-def]
    """``value`` held within plus and minus ``limit``."""
    return min(max(value, -limit), limit)


@kernel
def lock_frequency(state, param, error):  # type: ignore[no-untyped-def]
    """PLL: reference frequency of the coming period from the phase by which the oscillation leads [rad]."""
    state[S_PLL] = clip(state[S_PLL] + param[P_PLL_KI] * error * param[P_PERIOD], 0.01 * param[P_OMEGA])
    state[S_OMEGA] = param[P_OMEGA] + state[S_PLL] + param[P_PLL_KP] * error


@kernel
def hold_amplitude(state, param, lack):  # type: ignore[no-untyped-def]
    """Amplitude loop: drive in phase with velocity [V] from what the amplitude lacks [V]."""
    along = param[P_AMP_KP] * lack + state[S_AMP]
    if abs(along) < param[P_FULL_SCALE]:
        state[S_AMP] += param[P_AMP_KI] * lack * param[P_PERIOD]
    return clip(along, param[P_FULL_SCALE])


@kernel
def middle_motion(state, motion):  # type: ignore[no-untyped-def]
    """Amplitude of the motion in the middle of the control period that begins [m], from that at its start and one period ago."""
    before = state[S_MOTION] if state[S_MOTION] > 0.0 else motion
    state[S_MOTION] = motion
    return 1.5 * motion - 0.5 * before
