"""Cubic terms that a whole-angle fit takes up when the data ask for them: each linear in its coefficients, with regressors of its own.

An amplitude-dependent pick-off, forcer, stiffness or damping passes for gain and damping errors of the linear model (effects.md rows
4-7, 9,
16); over several amplitudes and all azimuths the terms below tell them apart. V are pick-off volts, u drive volts, by axis k:

* ``pickoff_cubic``: V_k = p_k + c_k |p_k|^2 p_k, so that ``L[V] - c_k L[N_k]`` obeys the linear flow, N_k = |V_k|^2 V_k on axis k [1/V^2];
* ``cubic``: c |V|^2 V of the wave: real part damping, imaginary part stiffness (Duffing), any azimuth [1/(s V^2)];
* ``cubic_axes``, ``cubic_cross``: c_k |V_k|^2 V_k on axis k, and on the other axis (document 000, Eqs. 22-27) [1/(s V^2)];
* ``drive_cubic``: c_k |u_k|^2 u_k on axis k [1/(s V^2)].

Signals are functions of (V, u, applied rate).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["TERMS", "Signal", "Term", "derived_signals", "plain_signals", "warm_signals"]

ComplexArray = NDArray[np.complex128]
FloatArray = NDArray[np.float64]
Signal = Callable[[ComplexArray, ComplexArray, FloatArray], ComplexArray]


def _cube(x: ComplexArray) -> ComplexArray:
    return np.asarray(np.abs(x) ** 2 * x)


def _placed(columns: list[tuple[ComplexArray, int]]) -> ComplexArray:
    """Signals (n, k, 2) that each live on one axis."""
    out = np.zeros((columns[0][0].size, len(columns), 2), dtype=complex)
    for k, (values, axis) in enumerate(columns):
        out[:, k, axis] = values
    return out


def _on_own_axis(x: ComplexArray) -> ComplexArray:
    cube = _cube(x)
    return _placed([(cube[:, 0], 0), (cube[:, 1], 1)])


def _on_every_axis(x: ComplexArray) -> ComplexArray:
    return _axes_apart(_cube(x))


def _axes_apart(x: ComplexArray) -> ComplexArray:
    """(x on x, x on y, y on x, y on y)."""
    return _placed([(x[:, 0], 0), (x[:, 0], 1), (x[:, 1], 0), (x[:, 1], 1)])


def _on_other_axis(x: ComplexArray) -> ComplexArray:
    cube = _cube(x)
    return _placed([(cube[:, 0], 1), (cube[:, 1], 0)])


def _of_the_wave(x: ComplexArray) -> ComplexArray:
    return np.asarray((np.sum(np.abs(x) ** 2, axis=1)[:, None] * x)[:, None, :])


@dataclass(frozen=True)
class Term:
    """One kind of cubic term.

    Parameters
    ----------
    name : str
    unit : str
        Of its coefficients.
    coefficients : tuple of str
        Their names.
    columns : callable
        (projected signals by name, A) -> regressors, shape (equations, coefficients).
    meaning : str
        For people.
    """

    name: str
    unit: str
    coefficients: tuple[str, ...]
    columns: Callable[[Mapping[str, ComplexArray], ComplexArray], ComplexArray]
    meaning: str


def _pickoff_columns(signals: Mapping[str, ComplexArray], A: ComplexArray) -> ComplexArray:
    through, inside = signals["pickoff_cubic_rate"], signals["every_axis"]
    # A acts on N_k as on any displacement: rows (N_x on x, N_x on y, N_y on x, N_y on y)
    acted = np.stack([inside[:, 0] * A[0, 0] + inside[:, 1] * A[1, 0], inside[:, 2] * A[0, 1] + inside[:, 3] * A[1, 1]], axis=1)
    return np.asarray(through - acted)


def _signal(name: str) -> Callable[[Mapping[str, ComplexArray], ComplexArray], ComplexArray]:
    return lambda signals, A: signals[name]


TERMS: tuple[Term, ...] = (
    Term("pickoff_cubic", "1/V^2", ("pickoff_cubic_x", "pickoff_cubic_y"), _pickoff_columns, "a pick-off that is not linear"),
    Term("cubic", "1/(s V^2)", ("cubic_wave",), _signal("wave_cube"), "damping or stiffness that depends on the amplitude"),
    Term("cubic_axes", "1/(s V^2)", ("cubic_xx", "cubic_yy"), _signal("own_axis"), "damping or stiffness cubic along the electrode axes"),
    Term("cubic_cross", "1/(s V^2)", ("cubic_yx", "cubic_xy"), _signal("other_axis"), "cubic cross stiffness or cross damping"),
    Term("drive_cubic", "1/(s V^2)", ("drive_cubic_x", "drive_cubic_y"), _signal("drive_own_axis"), "a forcer that is not linear"),
)


def plain_signals() -> dict[str, Signal]:
    """Signals that enter as they are."""
    return {
        "every_axis": lambda V, u, rate: _on_every_axis(V),
        "rate_every_axis": lambda V, u, rate: rate[:, None, None] * _on_every_axis(V),
        "wave_cube": lambda V, u, rate: _of_the_wave(V),
        "own_axis": lambda V, u, rate: _on_own_axis(V),
        "other_axis": lambda V, u, rate: _on_other_axis(V),
        "drive_own_axis": lambda V, u, rate: _on_own_axis(u),
    }


def warm_signals(rise_k: FloatArray, row_s: float) -> dict[str, Signal]:
    """What a temperature that differs from the campaign's mean by ``rise_k`` [K], shape (n,), does to the motion and to the drives; the
    motion also by its change, for a sensor that is late.
    """
    both = np.column_stack([rise_k, np.gradient(rise_k, row_s)])
    return {
        "warm": lambda V, u, rate: both[:, :, None] * V[:, None, :],
        "warm_drive": lambda V, u, rate: _axes_apart(rise_k[:, None] * u),
    }


def derived_signals() -> dict[str, Signal]:
    """Signals that enter through L."""
    return {"pickoff_cubic_rate": lambda V, u, rate: _on_own_axis(V)}
