"""The slow-flow kernel: theory.md Eq. 3 advanced exactly over each control period, under the same loops and filters as the carrier.

``p' = (A - i delta) p + G u + f`` with ``delta = omega - omega0`` constant over a control period.
"""

from __future__ import annotations

import numpy as np

from ..device.averaging import averaged_force
from .carrier import emit_row
from .control import S_BODY, S_DRIVE, S_OMEGA, control_step
from ..jit import kernel

__all__ = ["slow_flow_rows"]


@kernel
def slow_flow_rows(  # type: ignore[no-untyped-def]
    p, loop, param, means, held, row_acc, shares, row_w, a, g, body, pick, unpick, nonlinear, feed, omega0, const, noise, out
):
    """Simulate ``out.shape[0]`` rows, in place.

    Parameters
    ----------
    p : ndarray, shape (2,), complex
        Pick-off envelopes without feedthrough, relative to the phase reference [V].
    loop, param : ndarray
        State and parameters of :func:`.control.control_step`.
    means : ndarray, shape (3, 2), complex
        Mean pick-off with feedthrough of the last three control periods [V].
    held : ndarray, shape (3, 5)
        Drive envelopes and reference frequency of the last three control periods.
    row_acc, shares, row_w
        Filter state, share of each control period in the converter filter, shape (3,), and row weights.
    a, g : ndarray, shape (rows, 2, 2), complex
        A and G of each row [1/s], [1/s/V].
    body : ndarray, shape (rows, 2), complex
        Response of the envelopes to one volt of body excitation [1/s].
    pick, unpick : ndarray, shape (2, 2), complex
        P [V/m] and its inverse, for the nonlinear forces.
    nonlinear : ndarray, shape (6,)
        ``Nonlinearity.coefficients``.
    feed : ndarray, shape (2, 2), complex
        E.
    omega0 : ndarray, shape (rows,)
        Frequency about which A is written [rad/s].
    const : ndarray, shape (4,)
        Control period [s], sd of the force noise per period on each quadrature [V], sd of the pick-off noise per period [V],
        1 when there are nonlinear forces.
    noise : ndarray, shape (controls, 8), float32
        Standard normals.
    out : ndarray, shape (rows, 9)
        As in :func:`.carrier.carrier_rows`.
    """
    controls = row_w.shape[1]
    period, kick, pick_noise = const[0], const[1], const[2]
    sums = np.zeros(9)
    n = 0
    px, py = p[0], p[1]
    for row in range(out.shape[0]):
        a00, a01, a10, a11 = a[row, 0, 0], a[row, 0, 1], a[row, 1, 0], a[row, 1, 1]
        for step in range(controls):
            omega = loop[S_OMEGA]
            ux = complex(loop[S_DRIVE], loop[S_DRIVE + 1])
            uy = complex(loop[S_DRIVE + 2], loop[S_DRIVE + 3])
            lag = 1j * (omega - omega0[row])
            # X = (A - i delta + N) period; p1 = p + phi1(X) period (dp/dt), phi1 = I + X/2 + X^2/6 + X^3/24
            x00 = (a00 - lag) * period
            x01 = a01 * period
            x10 = a10 * period
            x11 = (a11 - lag) * period
            rx = x00 * px + x01 * py + (g[row, 0, 0] * ux + g[row, 0, 1] * uy + body[row, 0] * loop[S_BODY]) * period
            ry = x10 * px + x11 * py + (g[row, 1, 0] * ux + g[row, 1, 1] * uy + body[row, 1] * loop[S_BODY]) * period
            if const[3] > 0.0:
                zx, zy = unpick[0, 0] * px + unpick[0, 1] * py, unpick[1, 0] * px + unpick[1, 1] * py
                fx, fy = averaged_force(zx, zy, omega, nonlinear)
                rx += 0.5j / omega * period * (pick[0, 0] * fx + pick[0, 1] * fy)
                ry += 0.5j / omega * period * (pick[1, 0] * fx + pick[1, 1] * fy)
            bx, by = x00 * rx + x01 * ry, x10 * rx + x11 * ry
            cx, cy = x00 * bx + x01 * by, x10 * bx + x11 * by
            dx, dy = x00 * cx + x01 * cy, x10 * cx + x11 * cy
            qx = px + rx + bx / 2.0 + cx / 6.0 + dx / 24.0 + kick * complex(noise[n, 0], noise[n, 1])
            qy = py + ry + by / 2.0 + cy / 6.0 + dy / 24.0 + kick * complex(noise[n, 2], noise[n, 3])
            for q in range(2):
                means[2, q] = means[1, q]
                means[1, q] = means[0, q]
            means[0, 0] = 0.5 * (px + qx) + feed[0, 0] * ux + feed[0, 1] * uy + pick_noise * complex(noise[n, 4], noise[n, 5])
            means[0, 1] = 0.5 * (py + qy) + feed[1, 0] * ux + feed[1, 1] * uy + pick_noise * complex(noise[n, 6], noise[n, 7])
            px, py = qx, qy
            for q in range(5):
                held[2, q] = held[1, q]
                held[1, q] = held[0, q]
            for q in range(4):
                held[0, q] = loop[S_DRIVE + q]
            held[0, 4] = omega
            vx = shares[0] * means[0, 0] + shares[1] * means[1, 0] + shares[2] * means[2, 0]
            vy = shares[0] * means[0, 1] + shares[1] * means[1, 1] + shares[2] * means[2, 1]
            sums[0], sums[1], sums[2], sums[3] = vx.real, vx.imag, vy.real, vy.imag
            for q in range(5):
                sums[4 + q] = shares[0] * held[0, q] + shares[1] * held[1, q] + shares[2] * held[2, q]
            emit_row(row_acc, sums, row_w, step, step == controls - 1, out[row])
            control_step(loop, param, sums[0], sums[1], sums[2], sums[3])
            n += 1
    p[0], p[1] = px, py
