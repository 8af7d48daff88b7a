"""Recordings made ready for the slow-flow fit: which may be used, on which lines they are projected, how the resonance moved meanwhile."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..recording.applied_rate import is_turned
from ..recording.recording import Campaign, Recording
from .linear_fit import AXES
from .projection import Projected, project

__all__ = ["SLOPE_WINDOW_K", "TEMPERATURE_WINDOW_K", "CampaignData", "resonance_motion", "role_of", "usable_recordings"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

#: recordings further than this from the median temperature are left out of the fit [K]
TEMPERATURE_WINDOW_K = 0.5
#: the same where the slopes with temperature are fitted: what is not linear in 3 K is below 1e-4 of the damping
SLOPE_WINDOW_K = 3.0
#: resonance wander when no repeated record tells [rad/s]: a millikelvin of silicon at 15 kHz
_WANDER_RAD_S = 2.5e-3
#: below this span the reference frequency is not regressed on temperature [K]
_TEMPERATURE_SPAN_K = 0.1


def usable_recordings(campaign: Campaign, window_k: float = TEMPERATURE_WINDOW_K) -> tuple[list[Recording], list[str]]:
    """Recordings that a fit at one temperature and one constant rate may use, and why others are left out."""
    wanted = [r for r in campaign if r.command.mode in ("ftr_x", "ftr_y") or _is_open(r)]
    skipped = []
    chosen = []
    median = _median_temperature([r for r in wanted if np.ptp(r.temperature_degc) <= 2.0 * window_k] or wanted)
    for r in wanted:
        temperature = r.temperature_degc
        if is_turned(r):
            skipped.append(f"{r.label}: a rate was applied")
        elif abs(temperature.mean() - median) > window_k or np.ptp(temperature) > 2.0 * window_k:
            skipped.append(f"{r.label}: temperature {temperature.min():.2f} to {temperature.max():.2f} degC, median {median:.2f}")
        elif r.command.excitation.kind not in ("none", "amplitude_modulation", "drive", "body"):
            skipped.append(f"{r.label}: excitation {r.command.excitation.kind}")
        else:
            chosen.append(r)
    return chosen, skipped


def _median_temperature(recordings: list[Recording]) -> float:
    """Median over the time recorded, not over the records: many short ones at the beginning of a drift would draw it there."""
    if not recordings:
        return math.nan
    means = np.array([r.temperature_degc.mean() for r in recordings])
    order = np.argsort(means)
    share = np.cumsum(np.array([r.duration_s for r in recordings])[order])
    return float(means[order][np.searchsorted(share, 0.5 * share[-1])])


@dataclass(frozen=True)
class CampaignData:
    """Projected recordings at the lines of interest and at quiet lines.

    ``wander_rad_s``: how the resonance moves between records; ``stiffness_per_k``: how the stiffness moves with temperature, relative, None
    when the temperature moved too little to tell; ``feedthrough_measured``: whether open drive shows E.
    """

    recordings: list[Recording]
    omega0: float
    wander_rad_s: float
    stiffness_per_k: float | None
    feedthrough_measured: bool
    bodies: list[float]
    signal: list[Projected]
    quiet: list[Projected]

    @classmethod
    def of(cls, recordings: list[Recording], decay_rate: float, *, with_quiet: bool = True) -> CampaignData:
        """Project the recordings; without quiet lines, which take most of the time, where the noise is not asked for."""
        omega0 = float(np.mean([r.ref_omega_rad_s.mean() for r in recordings if r.command.oscillator_axis]))
        slope, middle, wander = resonance_motion(recordings)

        def projected(recording: Recording, lines: list[float]) -> Projected:
            warmth = recording.temperature_degc - middle
            return project(recording, lines, omega0, decay_rate, (slope or 0.0) * warmth, warmth)

        return cls(
            recordings=recordings,
            omega0=omega0,
            wander_rad_s=wander,
            stiffness_per_k=None if slope is None else 2.0 * slope / omega0,
            feedthrough_measured=any(r.command.excitation.kind == "drive" for r in recordings),
            bodies=sorted({r.command.excitation.frequency_hz for r in recordings if r.command.excitation.kind == "body"}),
            signal=[projected(r, _lines(r)) for r in recordings],
            quiet=[projected(r, _quiet_lines(r)) for r in recordings] if with_quiet else [],
        )

    def columns(self, projected: list[Projected], *, cubic: bool) -> list[ComplexArray]:
        """Regressors of every recording: V, u, L[u], the body's volts by frequency, |V|^2 V when asked."""
        columns = []
        for p, r in zip(projected, self.recordings, strict=True):
            parts = [p.pick, p.drive, p.drive_rate]
            parts += [(p.body * (r.command.excitation.frequency_hz == f))[:, None] for f in self.bodies]
            if cubic:
                parts.append(p.cubic)
            columns.append(np.hstack(parts))
        return columns


def resonance_motion(recordings: list[Recording]) -> tuple[float | None, float, float]:
    """How the resonance moves, from the closed-loop reference frequencies.

    Returns its slope with temperature [rad/s/K] (None when the temperature hardly moved: then its wander says nothing), the mean
    temperature, and the standard deviation of what the slope does not explain [rad/s]. They bring the loops-off records, whose reference
    does not follow the resonance, to where the resonance was, and say how well.
    """
    loops = [r for r in recordings if r.command.oscillator_axis]
    temperature = np.array([r.temperature_degc.mean() for r in loops])
    middle = float(temperature.mean())
    omega = np.array([r.ref_omega_rad_s.mean() for r in loops])
    # an amplitude of its own shifts the frequency (Duffing): one mean for every axis and amplitude
    groups = sorted({(r.command.oscillator_axis or "", r.command.setpoints.amplitude_v) for r in loops})
    columns = [np.array([(r.command.oscillator_axis, r.command.setpoints.amplitude_v) == g for r in loops], dtype=float) for g in groups]
    if moved := bool(np.ptp(temperature) >= _TEMPERATURE_SPAN_K):
        columns.append(temperature - middle)
    design = np.column_stack(columns)
    solution = np.linalg.lstsq(design, omega, rcond=None)[0]
    left = omega - design @ solution
    spare = len(loops) - design.shape[1]
    wander = math.sqrt(float(left @ left) / spare) if spare > 0 else _WANDER_RAD_S
    return (float(solution[-1]) if moved else None), middle, max(wander, 1e-4)


def _is_open(recording: Recording) -> bool:
    return recording.command.mode == "loops_off" and recording.command.excitation.kind in ("drive", "body")


def role_of(recording: Recording, axis: int, omega0: float) -> str:
    """Recordings of one role share their noise: the pick-off's part of it grows with the distance from resonance."""
    oscillator = recording.command.oscillator_axis
    if oscillator is None:
        return f"open at {abs(recording.command.excitation.frequency_hz - omega0 / (2.0 * math.pi)):.0f} Hz"
    return "oscillator" if oscillator == AXES[axis] else "closed"


def _lines(recording: Recording) -> list[float]:
    excitation = recording.command.excitation
    return [0.0, excitation.frequency_hz] if excitation.kind == "amplitude_modulation" else [0.0]


def _quiet_lines(recording: Recording) -> list[float]:
    """Lines near those of interest where nothing was commanded."""
    step = 1.0 / recording.duration_s
    excitation = recording.command.excitation
    busy = np.arange(1, 6) * excitation.frequency_hz if excitation.kind == "amplitude_modulation" else np.zeros(0)
    top = min(max(4.0, 4.0 * step), 0.2 * recording.sample_rate_hz)
    candidates = np.arange(1.8 * step, top, 1.3 * step)
    free = [f for f in candidates if busy.size == 0 or np.min(np.abs(busy - f)) > 1.7 * step]
    if len(free) > 24:
        free = [free[i] for i in np.unique(np.geomspace(1, len(free), 24).astype(int) - 1)]
    return [float(f) for f in free]
