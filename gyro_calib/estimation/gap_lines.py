"""Harmonics of a pick-off's carrier, and what they are for a gap (derived in :mod:`.trusov_shkel`)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import CalibrationRefused
from ..quantity import Quantity
from ..recording.demodulate import reference_phase
from ..recording.recording import Recording

__all__ = ["GapLines", "amplitude_in_gaps", "measure_lines", "ratio_of_lines"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
_HARMONICS = 4
#: segments whose scatter gives the noise
_SEGMENTS = 16
_LEAST_SAMPLES = 256


def ratio_of_lines(principal_over_gap: FloatArray) -> FloatArray:
    """q of ``H1/V_gap = 2 q (1 + q^2) / (1 - q^2)``, odd in its argument, by Newton's method; shape as the argument."""
    h = np.asarray(principal_over_gap, dtype=float)
    q = 0.5 * h / np.sqrt(1.0 + h * h)
    for _ in range(20):
        value = 2.0 * q * (1.0 + q * q) / (1.0 - q * q) - h
        slope = 2.0 * (1.0 + 4.0 * q * q - q**4) / (1.0 - q * q) ** 2
        q = np.clip(q - value / slope, -0.999, 0.999)
    return np.asarray(q)


def amplitude_in_gaps(q: FloatArray | float) -> FloatArray:
    """s = a/d = 2 q / (1 + q^2)."""
    return np.asarray(2.0 * np.abs(q) / (1.0 + np.square(q)))


@dataclass(frozen=True)
class GapLines:
    """Lines of one recording: principal [V], second and third over it (real: in the phase of the gap's), phase excess; with their sd."""

    principal: float
    second: Quantity
    third: Quantity
    excess: Quantity


def measure_lines(recording: Recording, axis: str, factory: Mapping[str, Any], feedthrough: ComplexArray | None) -> GapLines:
    """Measure the lines of one axis in a raw block by linear least squares on the harmonics of the phase reference.

    Raises
    ------
    CalibrationRefused
        The block is too short.
    DataError
        It cannot be demodulated.
    """
    assert recording.raw is not None
    phase, sound = reference_phase(recording, factory=factory)
    volts, phase = recording.raw[f"{axis}_pick"][sound], phase[sound]
    length = volts.size // _SEGMENTS
    if length < _LEAST_SAMPLES:
        raise CalibrationRefused(
            f"Raw block of {recording.label!r} must hold {_SEGMENTS * _LEAST_SAMPLES} samples where the reference is sound, but got "
            f"{volts.size}. Record longer."
        )
    parts = np.array([_amplitudes(volts[i * length : (i + 1) * length], phase[i * length : (i + 1) * length]) for i in range(_SEGMENTS)])
    if feedthrough is not None and len(recording):
        row = "xy".index(axis)
        parts[:, 0] -= feedthrough[row] @ recording.drive.mean(axis=0)
    unit = parts[:, 0] / np.abs(parts[:, 0])
    second = parts[:, 1] / unit**2 / np.abs(parts[:, 0])
    third = (parts[:, 2] / unit**3 / np.abs(parts[:, 0])).real
    turn = second.imag / max(abs(float(second.real.mean())), 1e-300) * math.copysign(1.0, float(second.real.mean()))
    return GapLines(float(np.abs(parts[:, 0]).mean()), _mean(second.real, "1"), _mean(third, "1"), _mean(turn, "rad"))


def _mean(values: FloatArray, unit: str) -> Quantity:
    return Quantity(float(values.mean()), float(values.std(ddof=1)) / math.sqrt(values.size), unit)


def _amplitudes(volts: FloatArray, phase: FloatArray) -> ComplexArray:
    """Complex amplitudes of the harmonics 1 to 4 of one segment, a constant taken along; linear least squares."""
    angles = np.arange(1, _HARMONICS + 1)[:, None] * phase
    design = np.vstack([np.ones_like(phase), np.cos(angles), -np.sin(angles)]).T
    solution = np.linalg.solve(design.T @ design, design.T @ volts)
    return np.asarray(solution[1 : _HARMONICS + 1] + 1j * solution[_HARMONICS + 1 :])
