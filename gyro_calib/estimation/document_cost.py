"""Costs of document 000, Eq. 19: which lines are compared, as what, with which weights.

A cost is a real-linear map of the errors of the positions (measured minus estimated), the same for errors and for their derivatives.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import CalibrationRefused
from .document_model import DocumentModel
from .document_rows import Rows
from .levenberg import Model
from .sideband_table import SidebandRow
from .transfer_functions import from_signs, pairs_of_runs

__all__ = ["Deviations", "Lines", "cost_model", "noise_columns", "positions", "transfer_functions", "whitened"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
IntArray = NDArray[np.int_]
#: fewer periods of a side band in a recording are not told from a slow drift
_FEWEST_PERIODS = 1.9
#: errors (n, 2, k) of the positions to real residuals (m, k)
Map = Callable[[ComplexArray], FloatArray]


@dataclass(frozen=True)
class Lines:
    """The lines that are compared.

    Parameters
    ----------
    rows : Rows
        +nu and -nu of every loop recording with side bands, then the carriers.
    sides : list of SidebandRow
        Recordings of the side bands: entry i has rows 2 i (+nu) and 2 i + 1 (-nu).
    carriers : list of SidebandRow
        Recordings of the carriers, in the order of the remaining rows.
    """

    rows: Rows
    sides: list[SidebandRow]
    carriers: list[SidebandRow]

    @classmethod
    def of(cls, model: DocumentModel, *, with_carrier: bool) -> Lines:
        """Side bands of the loop recordings that hold enough periods, carriers of the open ones, and of the loop recordings when asked."""
        sides = [r for r in model.loops if r.frequency_hz * r.duration_s > _FEWEST_PERIODS]
        carriers = [r for r in model.table if r.kind in ("drive", "body") or (with_carrier and r.axis)]
        nus = [np.array([r.nu_rad_s, -r.nu_rad_s]) for r in sides] + [np.zeros(1) for _ in carriers]
        return cls(model.rows(sides + carriers, nus), sides, carriers)


@dataclass(frozen=True)
class Deviations:
    """Standard deviations of the equation errors [V/s].

    Parameters
    ----------
    sides : ndarray, shape (sides, 2, 2)
        (recording, axis, part): each of real and imaginary part of the amplitude of the c and of the s column.
    carriers : ndarray, shape (carriers, 2, 2)
        (recording, axis, part): real and imaginary part; infinite where the carrier is not compared.
    resonance : float
        Of the resonances in one recording about their track, common to both axes [rad/s].
    """

    sides: FloatArray
    carriers: FloatArray
    resonance: float


def cost_model(model: DocumentModel, lines: Lines, residuals: Map) -> Model:
    """Residual and Jacobian of a map."""

    def evaluate(theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        error, slope = model.error(theta, lines.rows)
        return residuals(error[:, :, None])[:, 0], residuals(slope)

    return evaluate


def positions(lines: Lines) -> Map:
    """Positions as they are, all weights alike [V]."""

    def residuals(error: ComplexArray) -> FloatArray:
        flat = error.reshape(-1, error.shape[2])
        return np.concatenate([flat.real, flat.imag])

    return residuals


def whitened(model: DocumentModel, lines: Lines, theta: FloatArray, sd: Deviations) -> Map:
    """Positions weighed by noise: through M they become equation errors, whose parts are independent but for the resonance.

    The c and the s column of a channel have noise of their own (an oscillator's phase is noisier than its amplitude); so has each axis.
    A resonance that is off its track by ``d`` makes the error ``i d p`` in all lines of its recording: the weights allow for one each.
    """
    M = model.dynamics(theta, lines.rows)

    def independent(error: ComplexArray) -> list[FloatArray]:
        sides, carriers = _equation_parts(M @ error, len(lines.sides))
        return [sides / sd.sides.repeat(2, axis=2).reshape(-1, 8, 1), carriers / sd.carriers.reshape(-1, 4, 1)]

    together = [_rank_one(d[:, :, 0]) for d in independent(_resonance_error(model, lines, theta, sd))]

    def residuals(error: ComplexArray) -> FloatArray:
        parts = [
            part - direction[:, :, None] * np.einsum("ri,rik->rk", direction, part)[:, None, :]
            for part, direction in zip(independent(error), together, strict=True)
        ]
        return np.concatenate([part.reshape(-1, error.shape[2]) for part in parts])

    return residuals


def transfer_functions(lines: Lines, scale: FloatArray | None = None) -> Map:
    """Solutions of the 4x4 systems (Eqs. 17, 18) for measured minus estimated positions, open recordings as positions.

    Parameters
    ----------
    lines : Lines
        Without carriers of loop recordings.
    scale : ndarray, shape (m,), optional
        Standard deviation of every residual (default: all alike).

    Raises
    ------
    CalibrationRefused
        No pair of a direct and a swapped run.
    """
    runs = pairs_of_runs(lines.sides)
    if not runs:
        raise CalibrationRefused("Transfer functions need the same side band with x and with y as the oscillator, but got no such pair.")
    place = {id(r): 2 * i for i, r in enumerate(lines.sides)}
    first = np.array([[place[id(direct)], place[id(swapped)]] for direct, swapped in runs])
    inverse = [np.linalg.inv(lines.rows.acting[first + sign]) for sign in (0, 1)]
    count = 2 * len(lines.sides)

    def residuals(error: ComplexArray) -> FloatArray:
        signs = [np.einsum("nij,njak->nika", inverse[s], error[first + s]) for s in (0, 1)]
        sine, cosine = from_signs(signs[0], signs[1])
        solved = np.stack([sine, cosine]).swapaxes(3, 4).reshape(-1, error.shape[2])
        carrier = error[count:].reshape(-1, error.shape[2])
        stacked = np.concatenate([solved.real, solved.imag, carrier.real, carrier.imag])
        return stacked if scale is None else stacked / scale[:, None]

    return residuals


def noise_columns(model: DocumentModel, lines: Lines, theta: FloatArray, sd: Deviations) -> ComplexArray:
    """Position errors that independent unit noises make, (n, 2, noises): their map is a square root of the covariance of its residuals."""
    inverse = np.linalg.inv(model.dynamics(theta, lines.rows))
    sides, carriers = len(lines.sides), len(lines.carriers)
    force = np.zeros((lines.rows.nu.size, 2, 8 * sides + 4 * carriers), dtype=complex)
    column = 0
    for i in range(sides):
        for axis in range(2):
            for part, turn in ((0, 1.0), (1, 1j)):
                for unit in (1.0, 1j):
                    amplitude = sd.sides[i, axis, part] * unit
                    force[2 * i, axis, column] = turn * amplitude
                    force[2 * i + 1, axis, column] = turn * np.conj(amplitude)
                    column += 1
    finite = np.where(np.isfinite(sd.carriers), sd.carriers, 0.0)
    for i in range(carriers):
        for axis in range(2):
            for part, unit in ((0, 1.0), (1, 1j)):
                force[2 * sides + i, axis, column] = unit * finite[i, axis, part]
                column += 1
    own = np.zeros((lines.rows.nu.size, 1, sides + carriers))
    own[np.arange(2 * sides), 0, np.arange(2 * sides) // 2] = 1.0
    own[np.arange(2 * sides, lines.rows.nu.size), 0, np.arange(sides, sides + carriers)] = 1.0
    return np.concatenate([inverse @ force, own * _resonance_error(model, lines, theta, sd)], axis=2)


def _resonance_error(model: DocumentModel, lines: Lines, theta: FloatArray, sd: Deviations) -> ComplexArray:
    """Position errors when the resonances are off their track by one standard deviation, (n, 2, 1); an oscillator has none, it follows."""
    M = model.dynamics(theta, lines.rows)
    force = 1j * sd.resonance * model.positions(theta, lines.rows)
    for place, row in enumerate([r for r in lines.sides for _ in range(2)] + lines.carriers):
        if row.axis:
            force[place, "xy".index(row.axis)] = 0.0
    return np.asarray(np.linalg.inv(M) @ force[:, :, None])


def _rank_one(direction: FloatArray) -> FloatArray:
    """Vectors e, (r, m), such that I - e e^T is the inverse square root of I + d d^T for directions d, (r, m)."""
    square = np.sum(direction**2, axis=1, keepdims=True)
    shrink = 1.0 - 1.0 / np.sqrt(1.0 + square)
    return np.asarray(direction * np.sqrt(shrink / np.maximum(square, 1e-300)))


def _equation_parts(force: ComplexArray, sides: int) -> tuple[FloatArray, FloatArray]:
    """Real parts of equation errors (n, 2, k): sides (recordings, 8, k) as (axis, c or s, re or im), carriers (recordings, 4, k)."""
    plus, minus = force[: 2 * sides : 2], force[1 : 2 * sides : 2].conj()
    columns = np.stack([0.5 * (plus + minus), -0.5j * (plus - minus)], axis=2)
    carriers = force[2 * sides :]
    return (
        np.stack([columns.real, columns.imag], axis=3).reshape(sides, 8, force.shape[2]),
        np.stack([carriers.real, carriers.imag], axis=2).reshape(len(carriers), 4, force.shape[2]),
    )
