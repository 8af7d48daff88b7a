"""The time slots of single-channel electronics: read x, drive x, read y, drive y, one control period each (document 004 section 2.2)."""

from __future__ import annotations

import math

from ..device.electronics import SLOTS
from ..jit import kernel
from .control_layout import S_DRIVE, S_HELD, S_OMEGA, S_PAST, S_SLOT

__all__ = ["hold_columns", "slot_envelope", "slot_gains"]

READ_X, DRIVE_X, READ_Y, DRIVE_Y = 0, 1, 2, 3


@kernel
def slot_gains(loop):  # type: ignore[no-untyped-def]
    """Volts of the x and of the y drive in the present slot over their commanded means."""
    slot = int(loop[S_SLOT])
    return float(SLOTS) if slot == DRIVE_X else 0.0, float(SLOTS) if slot == DRIVE_Y else 0.0


@kernel
def hold_columns(loop, delay, line):  # type: ignore[no-untyped-def]
    """Fill the drives and the reference frequency of a control step, as late as a pick-off that is held over the frame.

    A reading in the middle of the used part of its slot is held over four slots: late by ``delay`` slots (1 to 2) on average. A drive that
    is held from its own slot on is late as much; the frequency is interpolated between the slots before.
    """
    slot = int(loop[S_SLOT])
    if slot == DRIVE_X:
        loop[S_HELD], loop[S_HELD + 1] = loop[S_DRIVE], loop[S_DRIVE + 1]
    elif slot == DRIVE_Y:
        loop[S_HELD + 2], loop[S_HELD + 3] = loop[S_DRIVE + 2], loop[S_DRIVE + 3]
    for q in range(4):
        line[4 + q] = loop[S_HELD + q]
    line[8] = (2.0 - delay) * loop[S_PAST] + (delay - 1.0) * loop[S_PAST + 1]
    loop[S_PAST], loop[S_PAST + 1] = loop[S_OMEGA], loop[S_PAST]


@kernel
def slot_envelope(products, column, phase, advance, first):  # type: ignore[no-untyped-def]
    """Envelope c, s of one reading: least squares over the samples from ``first`` on, which need not span whole cycles.

    Parameters
    ----------
    products : ndarray, shape (samples, 4)
        2 V cos phi and -2 V sin phi of each channel [V].
    column : int
        0: x, 2: y.
    phase, advance : float
        Reference phase of sample 0 and its step [rad].
    first : int
        Samples to leave out.
    """
    cc = cs = ss = vc = vs = 0.0
    for j in range(first, products.shape[0]):
        c, s = math.cos(phase + advance * j), -math.sin(phase + advance * j)
        cc, cs, ss = cc + c * c, cs + c * s, ss + s * s
        vc, vs = vc + 0.5 * products[j, column], vs + 0.5 * products[j, column + 1]
    scale = 1.0 / (cc * ss - cs * cs)
    return (ss * vc - cs * vs) * scale, (cc * vs - cs * vc) * scale
