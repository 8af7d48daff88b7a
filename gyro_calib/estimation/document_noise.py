"""Noise of the equations of document 000's estimator, measured at frequencies where nothing was commanded."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from .document_cost import Deviations, Lines
from .document_model import DocumentModel
from .linear_fit import AXES, NoiseModel
from .sideband_table import SidebandRow

__all__ = ["Noise", "measure_noise"]

FloatArray = NDArray[np.float64]
PARTS = ("re", "im")
#: quiet frequencies used per recording
_QUIET_LINES = 24
#: smallest density: a noise-free simulation has rounding [V^2/s^2/Hz]
_FLOOR = 1e-30


@dataclass(frozen=True)
class Density:
    """Two-sided density ``c_0 + c_1/f + c_2/f^2 + c_3 f^2`` [V^2/s^2/Hz]: force, flicker, a wandering resonance, pick-off noise."""

    coefficients: FloatArray
    lowest_hz: float

    def at(self, frequency_hz: float) -> float:
        """Value at a frequency."""
        return float(_basis(np.array([max(frequency_hz, self.lowest_hz)]))[0] @ self.coefficients)


@dataclass(frozen=True)
class Noise:
    """Densities of the equation errors.

    Parameters
    ----------
    loops : mapping of (axis, role, part) to Density
        Role ``oscillator`` or ``closed``; part ``re`` in phase with the reference, ``im`` at 90 degrees.
    opened : mapping of (label, axis) to float
        Of each recording with loops off, white [V^2/s^2/Hz].
    resonance : float
        Standard deviation of the resonances of single recordings about their track [rad/s].
    """

    loops: dict[tuple[str, str, str], Density]
    opened: dict[tuple[str, str], float]
    resonance: float

    def by_role(self) -> dict[tuple[str, str, str], NoiseModel]:
        """As the linear fit states it (without the wandering resonance)."""
        return {
            key: NoiseModel((float(d.coefficients[0]), float(d.coefficients[1]), float(d.coefficients[3])), d.lowest_hz)
            for key, d in self.loops.items()
        }

    def deviations(self, lines: Lines) -> Deviations:
        """Standard deviations at the lines that are compared."""
        sides = np.array([[self._of(r, a, r.frequency_hz) for a in AXES] for r in lines.sides]).reshape(-1, 2, 2)
        bandwidth = np.array([r.noise_bandwidth_hz for r in lines.sides]).reshape(-1, 1, 1)
        carriers = np.array([[self._of(r, a, 0.0) for a in AXES] for r in lines.carriers]).reshape(-1, 2, 2)
        carrier_bandwidth = np.array([r.noise_bandwidth_hz for r in lines.carriers]).reshape(-1, 1, 1)
        found = np.sqrt(carriers * carrier_bandwidth)
        for i, r in enumerate(lines.carriers):
            if r.axis:
                # the oscillator's own carrier has told its detuning, and its amplitude moves with the loop
                found[i, AXES.index(r.axis)] = math.inf
        return Deviations(np.sqrt(0.5 * sides * bandwidth), found, self.resonance)

    def _of(self, row: SidebandRow, axis: str, frequency_hz: float) -> list[float]:
        if not row.axis:
            return [self.opened[row.label, axis]] * 2
        role = "oscillator" if row.axis == axis else "closed"
        return [self.loops[axis, role, part].at(frequency_hz) for part in PARTS]


def measure_noise(model: DocumentModel, theta: FloatArray) -> Noise:
    """Densities at the quiet frequencies of every recording, given the parameters."""
    pooled: dict[tuple[str, str, str], list[tuple[FloatArray, FloatArray]]] = {}
    opened: dict[tuple[str, str], float] = {}
    chosen, lines = [], []
    for row in model.table:
        picked = np.unique(np.geomspace(1, row.quiet_hz.size, _QUIET_LINES).astype(int) - 1)
        nus = 2.0 * math.pi * row.quiet_hz[picked]
        chosen.append(row)
        lines.append(np.column_stack([nus, -nus]).ravel())
    force = model.equation_error(theta, model.rows(chosen, lines))
    first = 0
    for row, nus in zip(chosen, lines, strict=True):
        own = force[first : first + nus.size]
        first += nus.size
        plus, minus = own[0::2], own[1::2].conj()
        # (q, axis) amplitudes of the c and s columns; per part, real and imaginary squares of one degree of freedom each
        for part, amplitude in zip(PARTS, (0.5 * (plus + minus), -0.5j * (plus - minus)), strict=True):
            for a, axis in enumerate(AXES):
                squares = 2.0 * np.concatenate([amplitude[:, a].real ** 2, amplitude[:, a].imag ** 2]) / row.noise_bandwidth_hz
                if row.axis:
                    role = "oscillator" if row.axis == axis else "closed"
                    frequencies = np.tile(nus[0::2] / (2.0 * math.pi), 2)
                    pooled.setdefault((axis, role, part), []).append((frequencies, squares))
                else:
                    opened[row.label, axis] = opened.get((row.label, axis), 0.0) + 0.5 * float(squares.mean())
    lowest = 0.3 / max(r.duration_s for r in model.loops)
    loops = {
        key: Density(_fit(np.concatenate([f for f, _ in found]), np.concatenate([s for _, s in found])), lowest)
        for key, found in pooled.items()
    }
    scatter, _ = model.resonance_scatter(theta)
    return Noise(loops, {key: max(value, _FLOOR) for key, value in opened.items()}, scatter)


def _basis(frequency_hz: FloatArray) -> FloatArray:
    f = frequency_hz
    return np.column_stack([np.ones_like(f), 1.0 / f, f**-2.0, f**2])


def _fit(frequency_hz: FloatArray, squares: FloatArray) -> FloatArray:
    """Non-negative coefficients from squared amplitudes, each a chi-square of one degree of freedom times the density."""
    basis = _basis(frequency_hz)
    expected = np.full_like(squares, max(float(np.median(squares)) / 0.455, _FLOOR))
    coefficients = np.array([expected[0], 0.0, 0.0, 0.0])
    for _ in range(8):
        coefficients, _ = nnls(basis / expected[:, None], squares / expected)
        expected = np.maximum(basis @ coefficients, max(1e-3 * float(expected.mean()), _FLOOR))
    return np.asarray(coefficients)
