"""Exact propagation of the linear resonator over one converter sample with the drive held (zero-order hold).

State ``z = (x, y, x'/w, y'/w)`` with ``w`` the nominal angular frequency: ``z_n+1 = Phi z_n + Gamma f_n``, ``f`` [m/s^2]. The series
converges to rounding for ``w dt < 1``, so the map has no numerical damping: its determinant is that of the damped system to 1e-15 a step.
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined_kernel, kernel

__all__ = ["MOTION", "TERMS", "exact_propagator", "stiffness_step"]

#: numbers of a motion: x, y, x'/w, y'/w [m], then the stiffness k11, k12, k22 [1/s^2] it was last propagated with; zero: none yet
MOTION = 7

#: terms of the matrix exponential; (w dt)^k / k! < 1e-17 for w dt < 0.8
TERMS = 18


@kernel
def exact_propagator(k11, k12, k22, c11, c12, c21, c22, w, dt, phi, gamma):  # type: ignore[no-untyped-def]
    """Fill ``phi`` (4, 4) and ``gamma`` (4, 2) for stiffness k [1/s^2] and damping-plus-Coriolis c [1/s] over ``dt``."""
    m = np.zeros((4, 4))
    m[0, 2] = w * dt
    m[1, 3] = w * dt
    m[2, 0] = -k11 / w * dt
    m[2, 1] = -k12 / w * dt
    m[3, 0] = -k12 / w * dt
    m[3, 1] = -k22 / w * dt
    m[2, 2] = -c11 * dt
    m[2, 3] = -c12 * dt
    m[3, 2] = -c21 * dt
    m[3, 3] = -c22 * dt
    # term = M^k / k!; phi = sum term_k; integral = dt * sum term_k / (k + 1)
    term = np.zeros((4, 4))
    integral = np.zeros((4, 4))
    for i in range(4):
        for j in range(4):
            term[i, j] = 1.0 if i == j else 0.0
            phi[i, j] = term[i, j]
            integral[i, j] = term[i, j]
    nxt = np.zeros((4, 4))
    for k in range(1, TERMS):
        for i in range(4):
            for j in range(4):
                total = 0.0
                for q in range(4):
                    total += term[i, q] * m[q, j]
                nxt[i, j] = total / k
        for i in range(4):
            for j in range(4):
                term[i, j] = nxt[i, j]
                phi[i, j] += nxt[i, j]
                integral[i, j] += nxt[i, j] / (k + 1)
    for i in range(4):
        gamma[i, 0] = integral[i, 2] * dt / w
        gamma[i, 1] = integral[i, 3] * dt / w


@inlined_kernel
def stiffness_step(z, p, w):  # type: ignore[no-untyped-def]
    """Quarter of a relative change of the stiffness, as a symmetric matrix: d11, d12, d22; ``z`` (MOTION,) keeps the new stiffness.

    A stiffness that follows a temperature does so smoothly: ``x <- (1 - d) x``, ``v <- (1 + d) v`` keeps phase and action as a slow
    change does. Left as it is, a step works on where the carrier happens to be: ``a'/a = (w'/2w)(cos 2 phi - 1)``, and where twice the
    carrier passes a multiple of the rate of steps, cos 2 phi stands still (5000 Hz at 0.35 Hz/s: 4e-5 of amplitude per second).
    """
    d11 = d12 = d22 = 0.0
    if z[4] != 0.0:
        q = 0.25 / (w * w)
        d11, d12, d22 = q * (p[0] - z[4]), q * (p[1] - z[5]), q * (p[2] - z[6])
    z[4], z[5], z[6] = p[0], p[1], p[2]
    return d11, d12, d22
