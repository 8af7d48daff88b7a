"""The slow-flow kernel: theory.md Eq. 3 advanced over each control period, under the same loops and filters as the carrier.

``p' = (A - i delta) p + G u + f`` with ``delta = omega - omega0`` constant over a control period T, so ``p1 = p + phi1(X) (X p + T G u)``
with ``X = T (A - i delta)``; the steady state is exact whatever the approximation of phi1. Here ``phi1(M - i theta) = phi1(-i theta) +
phi1'(-i theta) M`` with ``M = T A``, ``theta = T delta`` and series in theta: ``|M|^2 / 6`` and ``theta^5 / 720`` of the step are left out.
"""

from __future__ import annotations

import math

import numpy as np

from ..device.averaging import averaged_force
from ..device.electronics import SLOTS
from ..jit import kernel
from .carrier import emit_row
from .control import control_step
from .control_layout import S_BODY, S_DRIVE, S_OMEGA, S_SLOT, middle_motion
from .effect_envelope import bent_drive, bent_pickoff, effect_rate
from .multiplex import READ_X, READ_Y, hold_columns, slot_gains

__all__ = ["FLOW_COLUMNS", "slow_flow_rows"]

#: T A (re, im of xx, xy, yx, yy), T G (likewise), T times the response to one volt of body excitation (re, im of x, y), omega0 [rad/s],
#: sd of the force noise per period on each quadrature [V]
FLOW_COLUMNS = 22


@kernel
def _nonlinear_step(pxr, pxi, pyr, pyi, omega, period, pick, unpick, nonlinear):  # type: ignore[no-untyped-def]
    """What the averaged nonlinear forces add to ``T dp/dt`` [V]: re, im of x, y."""
    px, py = complex(pxr, pxi), complex(pyr, pyi)
    fx, fy = averaged_force(unpick[0, 0] * px + unpick[0, 1] * py, unpick[1, 0] * px + unpick[1, 1] * py, omega, nonlinear)
    rx = 0.5j / omega * period * (pick[0, 0] * fx + pick[0, 1] * fy)
    ry = 0.5j / omega * period * (pick[1, 0] * fx + pick[1, 1] * fy)
    return rx.real, rx.imag, ry.real, ry.imag


@kernel
def _effect_step(pxr, pxi, pyr, pyi, period, pick, unpick, per_volt, envelope):  # type: ignore[no-untyped-def]
    """What damping, friction and pump add to ``T dp/dt`` (complex, V): in the axes of the motion, as at the carrier."""
    px, py = complex(pxr, pxi) / per_volt, complex(pyr, pyi) / per_volt
    rx, ry = effect_rate(unpick[0, 0] * px + unpick[0, 1] * py, unpick[1, 0] * px + unpick[1, 1] * py, envelope)
    scale = period * per_volt
    return scale * (pick[0, 0] * rx + pick[0, 1] * ry), scale * (pick[1, 0] * rx + pick[1, 1] * ry)


@kernel
def _motion(pxr, pxi, pyr, pyi, unpick):  # type: ignore[no-untyped-def]
    """Amplitude of the motion [m] of pick-off envelopes [V]."""
    px, py = complex(pxr, pxi), complex(pyr, pyi)
    zx, zy = unpick[0, 0] * px + unpick[0, 1] * py, unpick[1, 0] * px + unpick[1, 1] * py
    return math.sqrt((zx.real * zx.real + zx.imag * zx.imag) + (zy.real * zy.real + zy.imag * zy.imag))


@kernel
def slow_flow_rows(  # type: ignore[no-untyped-def]
    p, loop, param, means, row_acc, shares, row_w, table, place, coriolis, rate, stray, pick, unpick, nonlinear, feed, const, noise, out,
    envelope,
):  # fmt: skip
    """Simulate ``out.shape[0]`` rows, in place.

    Parameters
    ----------
    p : ndarray, shape (4,)
        Pick-off envelopes without feedthrough, relative to the phase reference: re, im of x, y [V].
    loop, param : ndarray
        State and parameters of :func:`.control.control_step`.
    means : ndarray, shape (2, 4)
        Mean pick-off with feedthrough of the last two control periods, newest first; multiplexed, what is held of it [V].
    row_acc, shares, row_w
        Filter state, share of each control period in the converter filter, shape (3,), and weights as in :func:`.carrier.emit_row`.
    table : ndarray, shape (nodes, FLOW_COLUMNS)
        The flow without rotation over temperature, two nodes or more.
    place : ndarray, shape (rows,)
        Where each row lies between the nodes, 0 to nodes - 1.
    coriolis : ndarray, shape (8,)
        T dA/dOmega.
    rate : ndarray, shape (rows,)
        Input rate [rad/s].
    stray : ndarray, shape (rows, 4), or (0, 4) for none
        Drive that reaches the electrodes besides the command [V]: re, im of x, y.
    pick, unpick : ndarray, shape (2, 2), complex
        P [V/m] and its inverse, for the nonlinear forces.
    nonlinear : ndarray, shape (8,)
        As :func:`gyro_calib.device.averaging.instant_force` takes them [1/(m^2 s^2)], the sixth [1/(m^2 s)].
    feed : ndarray, shape (8,)
        E: re, im of xx, xy, yx, yy.
    const : ndarray, shape (9,)
        Control period [s], sd of the pick-off noise per period [V], 1 when there are nonlinear forces, place of a reading in its period (0
        to 1), 1 when multiplexed, factor of the drive per metre of motion or 0 for none [1/m], 1 when there is stray drive, 1 when effects
        bend drive, pick-off or motion, motion per volt of the x pick-off [m/V].
    noise : ndarray, shape (8 rows controls,), float32
        Standard normals: force on x, y, then pick-off noise of x, y, each re, im.
    out : ndarray, shape (rows, 9)
        As in :func:`.carrier.carrier_rows`.
    envelope : ndarray
        Of :func:`.effect_envelope.envelope_constants`.
    """
    controls = row_w.shape[2]
    period, pick_noise, curved = const[0], const[1], const[2] > 0.0
    late, early, multiplexed, per_metre = const[3], 1.0 - const[3], const[4] > 0.0, const[5]
    strayed, bent, per_volt, due = const[6] > 0.0, const[7] > 0.0, const[8], True
    altered = multiplexed or per_metre > 0.0 or strayed or bent
    sh0, sh1, sh2 = shares[0], shares[1], shares[2]
    e0, e1, e2, e3, e4, e5, e6, e7 = feed[0], feed[1], feed[2], feed[3], feed[4], feed[5], feed[6], feed[7]
    steps = np.empty((controls, 9))
    f = np.empty(FLOW_COLUMNS)
    pxr, pxi, pyr, pyi = p[0], p[1], p[2], p[3]
    # converter filter: means one period ago, two periods ago
    m1xr, m1xi, m1yr, m1yi = means[0, 0], means[0, 1], means[0, 2], means[0, 3]
    m2xr, m2xi, m2yr, m2yi = means[1, 0], means[1, 1], means[1, 2], means[1, 3]
    n = 0
    for row in range(out.shape[0]):
        node = min(int(place[row]), table.shape[0] - 2)
        share = place[row] - node
        for q in range(FLOW_COLUMNS):
            f[q] = table[node, q] + share * (table[node + 1, q] - table[node, q])
        for q in range(8):
            f[q] += rate[row] * coriolis[q]
        a0, a1, a2, a3, a4, a5, a6, a7 = f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7]
        g0, g1, g2, g3, g4, g5, g6, g7 = f[8], f[9], f[10], f[11], f[12], f[13], f[14], f[15]
        omega0, kick = f[20], f[21]
        for step in range(controls):
            omega = loop[S_OMEGA]
            uxr, uxi, uyr, uyi = loop[S_DRIVE], loop[S_DRIVE + 1], loop[S_DRIVE + 2], loop[S_DRIVE + 3]
            push = loop[S_BODY]
            dxr, dxi, dyr, dyi = uxr, uxi, uyr, uyi
            if altered:
                gx, gy = slot_gains(loop) if multiplexed else (1.0, 1.0)
                if per_metre > 0.0:
                    factor = per_metre * middle_motion(loop, _motion(pxr, pxi, pyr, pyi, unpick))
                    gx, gy = gx * factor, gy * factor
                if bent:
                    wx, wy = bent_drive(complex(uxr, uxi), complex(uyr, uyi), envelope)
                    dxr, dxi, dyr, dyi = wx.real, wx.imag, wy.real, wy.imag
                dxr, dxi, dyr, dyi = gx * dxr, gx * dxi, gy * dyr, gy * dyi
                if strayed:
                    dxr, dxi, dyr, dyi = dxr + stray[row, 0], dxi + stray[row, 1], dyr + stray[row, 2], dyi + stray[row, 3]
            th = (omega - omega0) * period
            th2 = th * th
            # s = phi1(-i theta), d = phi1'(-i theta)
            sr, si = 1.0 - th2 * (1.0 / 6.0 - th2 * (1.0 / 120.0)), -th * (0.5 - th2 * (1.0 / 24.0))
            dr, di = 0.5 - th2 * (1.0 / 8.0 - th2 * (1.0 / 144.0)), -th * (1.0 / 3.0 - th2 * (1.0 / 30.0))
            rxr = (a0 * pxr - (a1 - th) * pxi) + (a2 * pyr - a3 * pyi) + (f[16] * push + ((g0 * dxr - g1 * dxi) + (g2 * dyr - g3 * dyi)))
            rxi = (a0 * pxi + (a1 - th) * pxr) + (a2 * pyi + a3 * pyr) + (f[17] * push + ((g0 * dxi + g1 * dxr) + (g2 * dyi + g3 * dyr)))
            ryr = (a6 * pyr - (a7 - th) * pyi) + (a4 * pxr - a5 * pxi) + (f[18] * push + ((g4 * dxr - g5 * dxi) + (g6 * dyr - g7 * dyi)))
            ryi = (a6 * pyi + (a7 - th) * pyr) + (a4 * pxi + a5 * pxr) + (f[19] * push + ((g4 * dxi + g5 * dxr) + (g6 * dyi + g7 * dyr)))
            if curved:
                b0, b1, b2, b3 = _nonlinear_step(pxr, pxi, pyr, pyi, omega, period, pick, unpick, nonlinear)
                rxr, rxi, ryr, ryi = rxr + b0, rxi + b1, ryr + b2, ryi + b3
            if bent:
                wx, wy = _effect_step(pxr, pxi, pyr, pyi, period, pick, unpick, per_volt, envelope)
                rxr, rxi, ryr, ryi = rxr + wx.real, rxi + wx.imag, ryr + wy.real, ryi + wy.imag
            bxr, bxi = (a0 * rxr - a1 * rxi) + (a2 * ryr - a3 * ryi), (a0 * rxi + a1 * rxr) + (a2 * ryi + a3 * ryr)
            byr, byi = (a4 * rxr - a5 * rxi) + (a6 * ryr - a7 * ryi), (a4 * rxi + a5 * rxr) + (a6 * ryi + a7 * ryr)
            qxr = (pxr + kick * noise[n]) + ((sr * rxr - si * rxi) + (dr * bxr - di * bxi))
            qxi = (pxi + kick * noise[n + 1]) + ((sr * rxi + si * rxr) + (dr * bxi + di * bxr))
            qyr = (pyr + kick * noise[n + 2]) + ((sr * ryr - si * ryi) + (dr * byr - di * byi))
            qyi = (pyi + kick * noise[n + 3]) + ((sr * ryi + si * ryr) + (dr * byi + di * byr))
            mxr = (early * pxr + late * qxr) + (((e0 * uxr - e1 * uxi) + (e2 * uyr - e3 * uyi)) + pick_noise * noise[n + 4])
            mxi = (early * pxi + late * qxi) + (((e0 * uxi + e1 * uxr) + (e2 * uyi + e3 * uyr)) + pick_noise * noise[n + 5])
            myr = (early * pyr + late * qyr) + (((e4 * uxr - e5 * uxi) + (e6 * uyr - e7 * uyi)) + pick_noise * noise[n + 6])
            myi = (early * pyi + late * qyi) + (((e4 * uxi + e5 * uxr) + (e6 * uyi + e7 * uyr)) + pick_noise * noise[n + 7])
            pxr, pxi, pyr, pyi = qxr, qxi, qyr, qyi
            if bent:
                wx, wy = bent_pickoff(complex(mxr, mxi), complex(myr, myi), envelope)
                mxr, mxi, myr, myi = wx.real, wx.imag, wy.real, wy.imag
            if multiplexed:
                slot = int(loop[S_SLOT])
                if slot != READ_X:
                    mxr, mxi = m1xr, m1xi
                if slot != READ_Y:
                    myr, myi = m1yr, m1yi
                due = slot == READ_Y
            vxr, vxi = sh0 * mxr + (sh1 * m1xr + sh2 * m2xr), sh0 * mxi + (sh1 * m1xi + sh2 * m2xi)
            vyr, vyi = sh0 * myr + (sh1 * m1yr + sh2 * m2yr), sh0 * myi + (sh1 * m1yi + sh2 * m2yi)
            s = steps[step]
            s[0], s[1], s[2], s[3] = vxr, vxi, vyr, vyi
            s[4], s[5], s[6], s[7], s[8] = uxr, uxi, uyr, uyi, omega
            if multiplexed:
                hold_columns(loop, 2.0 - late, s)
                loop[S_SLOT] = (loop[S_SLOT] + 1.0) % SLOTS
            m2xr, m2xi, m2yr, m2yi, m1xr, m1xi, m1yr, m1yi = m1xr, m1xi, m1yr, m1yi, mxr, mxi, myr, myi
            if due:
                control_step(loop, param, vxr, vxi, vyr, vyi)
            n += 8
        emit_row(steps, row_w, row_acc, out[row])
    p[0], p[1], p[2], p[3] = pxr, pxi, pyr, pyi
    means[0, 0], means[0, 1], means[0, 2], means[0, 3] = m1xr, m1xi, m1yr, m1yi
    means[1, 0], means[1, 1], means[1, 2], means[1, 3] = m2xr, m2xi, m2yr, m2yi
