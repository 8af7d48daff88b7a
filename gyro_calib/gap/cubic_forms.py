"""Cubic forces of the motion: of each axis, alike in all directions, and along axes that are turned.

A force that is the gradient of a form of fourth order has five sizes: ``x^4``, ``y^4``, ``x^3 y``, ``x y^3`` and ``x^2 y^2``. Two equal
squares of one axis each are the first two, ``(x^2 + y^2)^2`` the first two and the last, axes at an azimuth of their own all five.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .parts import Part, one_axis

__all__ = ["across_axes", "conjugate_product", "cube", "isotropic_cubic", "of_turned_axes", "square"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


def cube(x: ComplexArray) -> ComplexArray:
    """|x_j|^2 x_j of each axis."""
    return np.asarray(np.abs(x) ** 2 * x)


def square(x: ComplexArray) -> FloatArray:
    """|x|^2 of both axes, shape (n, 1)."""
    return np.asarray(np.sum(np.abs(x) ** 2, axis=1)[:, None])


def conjugate_product(x: ComplexArray) -> ComplexArray:
    """(x . x) x*: what a conservative isotropic cubic force has beside |x|^2 x."""
    return np.asarray(np.sum(x * x, axis=1)[:, None] * x.conj())


def isotropic_cubic(x: ComplexArray) -> ComplexArray:
    """Fundamental of |x|^2 x over that of a cube."""
    return (2.0 * square(x) * x + conjugate_product(x)) / 3.0


def of_turned_axes(letter: str, p: ComplexArray, factor: complex) -> list[Part]:
    """What cubes along axes that are turned have besides those by axis: those across, and of ``x^2 y^2/2``."""
    other = p[:, ::-1]
    both = (2.0 * np.abs(other) ** 2 * p + other**2 * p.conj()) / 3.0
    return [*across_axes(letter, p, factor), Part(f"{letter}_xxyy", "flow", factor * both)]


def across_axes(letter: str, p: ComplexArray, factor: complex) -> list[Part]:
    """Forces of ``x^3 y`` and ``x y^3``, named by who does it to whom."""
    other, cubed = p[:, ::-1], cube(p)[:, ::-1]
    back = 2.0 * np.abs(p) ** 2 * other + p**2 * other.conj()
    return [Part(f"{letter}_{n}", "flow", factor * (one_axis(back, k) + one_axis(cubed, 1 - k))) for k, n in enumerate(("xy", "yx"))]
