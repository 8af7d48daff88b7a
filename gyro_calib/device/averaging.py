"""Nonlinear forces, at the carrier and averaged over a cycle (theory.md Eq. 3, N and its envelope)."""

from __future__ import annotations

from ..jit import kernel

__all__ = ["averaged_force", "instant_force"]


@kernel
def instant_force(x, y, vx, vy, c):  # type: ignore[no-untyped-def]
    """N(z, z') [m/s^2] of displacement [m] and velocity [m/s].

    ``c``, shape (8,): ``Nonlinearity.coefficients`` and those of the potentials ``x^3 y`` and ``x y^3`` [1/(m^2 s^2)].
    """
    square = x * x + y * y
    fx = (c[0] * square + c[1] * x * x) * x + (c[3] + c[7]) * y * y * y + 3.0 * c[6] * x * x * y + c[5] * square * vx
    fy = (c[0] * square + c[2] * y * y) * y + (c[4] + c[6]) * x * x * x + 3.0 * c[7] * x * y * y + c[5] * square * vy
    return fx, fy


@kernel
def averaged_force(x, y, omega, c):  # type: ignore[no-untyped-def]
    """Envelope of N at the carrier, for displacement envelopes x, y (complex, m) at ``omega`` [rad/s].

    From Re products at e^{i phi}: x^3 -> 3/4 |X|^2 X; y^2 x -> 1/2 |Y|^2 X + 1/4 Y^2 X*; x^2 x' -> (i omega/4) |X|^2 X;
    y^2 x' -> (i omega/2) |Y|^2 X - (i omega/4) Y^2 X*. The first agrees with document 000 (Eqs. 25-27: mean of x^3).
    """
    xx = x.real * x.real + x.imag * x.imag
    yy = y.real * y.real + y.imag * y.imag
    xc, yc = x.conjugate(), y.conjugate()
    stiff_x = 0.75 * xx * x + 0.5 * yy * x + 0.25 * y * y * xc
    stiff_y = 0.75 * yy * y + 0.5 * xx * y + 0.25 * x * x * yc
    damp_x = 1j * omega * (0.25 * xx * x + 0.5 * yy * x - 0.25 * y * y * xc)
    damp_y = 1j * omega * (0.25 * yy * y + 0.5 * xx * y - 0.25 * x * x * yc)
    fx = c[0] * stiff_x + c[1] * 0.75 * xx * x + (c[3] + c[7]) * 0.75 * yy * y + c[6] * (1.5 * xx * y + 0.75 * x * x * yc) + c[5] * damp_x
    fy = c[0] * stiff_y + c[2] * 0.75 * yy * y + (c[4] + c[6]) * 0.75 * xx * x + c[7] * (1.5 * yy * x + 0.75 * y * y * xc) + c[5] * damp_y
    return fx, fy
