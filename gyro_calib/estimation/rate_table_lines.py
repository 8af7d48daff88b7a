"""What of a recording a rate-table fit looks at: its lines, quiet lines for the noise, its role, how its resonance may move."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..recording.applied_rate import is_turned
from ..recording.recording import Recording
from .linear_fit import AXES, NoiseModel, fit_noises
from .projection import Projected

__all__ = ["measured_noise", "quiet_lines_of", "resonance_shift", "role_of", "signal_lines_of", "wander_of"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: highest line of a record whose signals move by themselves (table run, whole angle) [Hz], and most lines of one
_TOP_HZ, _MOST_LINES = 1.5, 16
#: least wander of the resonance from record to record [rad/s]: a millikelvin of silicon at 15 kHz
_WANDER_RAD_S = 2.5e-3


def wander_of(recordings: list[Recording]) -> float:
    """How far the resonance wanders between records [rad/s]: scatter of the reference frequency of equal commands."""
    groups: dict[tuple[str, float], list[float]] = {}
    for r in recordings:
        if r.command.oscillator_axis:
            groups.setdefault((r.command.mode, r.command.setpoints.amplitude_v), []).append(float(r.ref_omega_rad_s.mean()))
    squares = sum(len(g) * float(np.var(g)) for g in groups.values())
    spare = sum(len(g) - 1 for g in groups.values())
    return max(_WANDER_RAD_S, math.sqrt(squares / spare) if spare > 0 else 0.0)


def measured_noise(
    recordings: list[Recording],
    quiet: list[Projected],
    columns: list[ComplexArray],
    roles: list[str],
    axis: int,
    coefficients: ComplexArray,
) -> dict[tuple[str, str], NoiseModel]:
    """Noise of one axis by (role, part), from what the rough ``coefficients`` leave at the ``quiet`` frequencies."""
    models = {}
    for role in set(roles):
        own = [i for i, r in enumerate(roles) if r == role]
        left = np.concatenate([quiet[i].lhs[:, axis] - columns[i] @ coefficients for i in own])
        lines = np.concatenate([quiet[i].frequency_hz for i in own])
        lowest = 0.3 / max(recordings[i].duration_s for i in own)
        models[role, "re"], models[role, "im"] = fit_noises(lines, np.stack([left.real, left.imag]) ** 2, lowest)
    return models


def resonance_shift(p: Projected, role: str, axis: int, wander_rad_s: float) -> tuple[ComplexArray | None, float]:
    """Where p is not held at zero, the resonance of each recording is its own (``i lambda p``): free and moving steadily when a loop
    follows it, within its wander when an open drive stands beside it."""
    if role in ("oscillator", "wave"):
        return np.column_stack([p.pick[:, axis], p.drift[:, axis]]), math.inf
    return (p.pick[:, axis : axis + 1], wander_rad_s) if role.startswith("open") else (None, math.inf)


def role_of(recording: Recording, axis: int, omega0: float) -> str:
    """Recordings of one role share their noise: the pick-off's part of it grows with the distance from resonance."""
    oscillator = recording.command.oscillator_axis
    if oscillator is None:
        distance = abs(recording.command.excitation.frequency_hz - omega0 / (2.0 * math.pi))
        return f"open at {distance:.0f} Hz" if recording.command.mode == "loops_off" else "wave"
    return "oscillator" if oscillator == AXES[axis] else "closed"


def _moves(recording: Recording) -> bool:
    """Whether the signals hold more than what a modulation put there."""
    return is_turned(recording) or recording.command.mode in ("whole_angle", "ring_down", "ring_up", "stiffness")


def signal_lines_of(recording: Recording) -> list[float]:
    """Lines with signal [Hz]: those of a modulation, or a grid where the signals move by themselves."""
    if _moves(recording):
        step = 1.0 / recording.duration_s
        count = min(_MOST_LINES, int(_TOP_HZ / step))
        return [step * k for k in range(count + 1)]
    excitation = recording.command.excitation
    return [0.0, excitation.frequency_hz] if excitation.kind.endswith("modulation") else [0.0]


def quiet_lines_of(recording: Recording) -> list[float]:
    """Lines of which only noise is expected once the model is taken away."""
    step = 1.0 / recording.duration_s
    top = min(max(4.0, 8.0 * step), 0.2 * recording.sample_rate_hz)
    if _moves(recording):
        return [float(f) for f in np.linspace(_TOP_HZ + 2.0 * step, _TOP_HZ + top, 20)]
    candidates = np.geomspace(1.8 * step, top, 24)
    excitation = recording.command.excitation
    if excitation.kind.endswith("modulation"):
        busy = np.arange(1, 8) * excitation.frequency_hz
        candidates = np.array([f for f in candidates if np.min(np.abs(busy - f)) > 1.7 * step])
    return [float(f) for f in candidates]
