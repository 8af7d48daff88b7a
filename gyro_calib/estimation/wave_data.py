"""Whole-angle recordings made ready for the regression: projected, weighed with the noise that they themselves show."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..recording.recording import Recording
from .linear_fit import Equation, LinearFit, NoiseModel, fit_axis, fit_noise
from .wave_layout import Layout
from .wave_lines import quiet_lines, signal_lines
from .wave_projection import CHANNELS, Products, WaveProjected, in_wave_frame
from .wave_terms import derived_signals, plain_signals

__all__ = ["Excess", "Noise", "WaveData"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: noise of a recording (its index) in a channel
Noise = dict[tuple[int, str], NoiseModel]
Excess = dict[tuple[int, str], float]
_FLAT = NoiseModel((1.0, 0.0, 0.0), 1.0)
#: noise before it is known: what matters is that the resonance wanders by far more than the rest is uncertain
_UNKNOWN = {"frequency": NoiseModel((1e6, 0.0, 0.0), 1.0)}
#: below this span the resonance is not regressed on temperature [K]; how far it wanders at least [rad/s]
_TEMPERATURE_SPAN_K, _LEAST_WANDER_RAD_S = 0.1, 1e-3


@dataclass(frozen=True)
class _Wander(NoiseModel):
    """A resonance that walks at random: density ``c_0/f^2``, which no quiet line may be taken to end."""

    def density(self, frequency_hz: FloatArray) -> FloatArray:
        return np.asarray(self.coefficients[0] / np.maximum(np.abs(frequency_hz), self.lowest_hz) ** 2)

    @classmethod
    def of(cls, frequency_hz: FloatArray, squares: FloatArray, lowest_hz: float) -> _Wander:
        """Maximum likelihood from squared projections."""
        return cls((float(np.mean(squares * frequency_hz**2)), 0.0, 0.0), lowest_hz)


@dataclass(frozen=True)
class WaveData:
    """Projected recordings at the lines of interest and at quiet ones.

    Parameters
    ----------
    recordings : list of Recording
    omega0 : float
        Mean reference frequency of the closed loops [rad/s].
    wander : float
        How the resonance moves between recordings [rad/s].
    base : Layout
        Unknowns without cubic terms.
    signal, quiet : list of WaveProjected
    """

    recordings: list[Recording]
    omega0: float
    wander: float
    base: Layout
    signal: list[WaveProjected]
    quiet: list[WaveProjected]

    @classmethod
    def of(cls, recordings: list[Recording], decay_rate: float, drive_amplitude_v: float | None) -> WaveData:
        """Project every recording; see :func:`.whole_angle_fit.fit_whole_angle` for the arguments."""
        closed = [r for r in recordings if in_wave_frame(r)]
        omega0 = float(np.mean([r.ref_omega_rad_s.mean() for r in closed]))
        slope, middle, wander = _resonance_motion(closed)
        signal, quiet = [], []
        for r in recordings:
            products = Products(
                r,
                omega0,
                decay_rate,
                slope * (r.temperature_degc - middle),
                plain=plain_signals(),
                derived=derived_signals(),
                drive_scale=None if drive_amplitude_v is None else np.linalg.norm(r.pick, axis=1) / drive_amplitude_v,
            )
            lines = signal_lines(r, products.speed_rad_s)
            signal.append(products.project(lines))
            quiet.append(products.project(quiet_lines(r, max(lines), products.speed_rad_s)))
        return cls(recordings, omega0, wander, Layout.of(recordings, omega0), signal, quiet)

    def subset(self, indices: list[int]) -> WaveData:
        """The same for some of the recordings."""
        recordings = [self.recordings[i] for i in indices]
        signal, quiet = ([projected[i] for i in indices] for projected in (self.signal, self.quiet))
        return WaveData(recordings, self.omega0, self.wander, Layout.of(recordings, self.omega0), signal, quiet)

    def solve(self, layout: Layout, noise: Noise, excess: Excess, before: LinearFit | None) -> LinearFit:
        """Weighted least squares; A and E of ``before`` enter the small corrections."""
        equations = []
        for i, (p, r) in enumerate(zip(self.signal, self.recordings, strict=True)):
            sd = self.deviations(i, noise, excess)
            equations.append(
                Equation(
                    lhs=p.lhs,
                    regressors=_regressors(layout, p, r, before),
                    gram=p.gram,
                    sd_re=sd.real,
                    sd_im=sd.imag,
                    # every resonance is its own, near that of the others; the wave's also moves steadily
                    detuning=p.resonance if in_wave_frame(r) else p.resonance[:, :1],
                    detuning_sd=self.wander,
                )
            )
        return fit_axis(equations)

    def deviations(self, index: int, noise: Noise, excess: Mapping[tuple[int, str], float]) -> ComplexArray:
        """Standard deviations of a recording's equations, of their real parts and (as imaginary part) of their imaginary ones."""
        p = self.signal[index]
        half = p.lhs.size // 2
        sd = np.empty(p.lhs.size, dtype=complex)
        for k in range(2):
            place = slice(k * half, (k + 1) * half)
            parts = []
            for channel in CHANNELS[2 * k : 2 * k + 2]:
                model = noise.get((index, channel), _UNKNOWN.get(channel, _FLAT))
                density = model.density(p.frequency_hz[place])
                parts.append(np.sqrt(density * excess.get((index, channel), 1.0)))
            sd[place] = parts[0] + 1j * parts[1]
        return sd

    def measured(self, layout: Layout, solution: LinearFit) -> Noise:
        """Noise of each recording and channel from what the model leaves at the quiet lines."""
        noise: Noise = {}
        for i, (p, r) in enumerate(zip(self.quiet, self.recordings, strict=True)):
            left = p.lhs - _regressors(layout, p, r, solution) @ solution.coefficients
            half = p.lhs.size // 2
            for k, channel in enumerate(CHANNELS):
                squares, lowest = _part(left, k) ** 2, 0.3 / r.duration_s
                if channel == "frequency" and in_wave_frame(r):
                    noise[i, channel] = _Wander.of(p.frequency_hz[:half], squares, lowest)
                    continue
                model = fit_noise(p.frequency_hz[:half], squares, lowest)
                # what grows with frequency at the quiet lines says nothing below them: there the noise is at least that of the lowest
                floor = model.coefficients[2] * float(p.frequency_hz.min()) ** 2
                noise[i, channel] = replace(model, coefficients=(max(model.coefficients[0], floor), *model.coefficients[1:]))
        return noise

    def scores(self, noise: Noise, solution: LinearFit) -> dict[tuple[int, str], tuple[float, int]]:
        """Sum of the squared residuals at a recording's signal lines over their measured noise, and their number, by channel."""
        total = {}
        for i, left in enumerate(solution.residuals):
            sd = self.deviations(i, noise, {})
            for k, channel in enumerate(CHANNELS):
                ratio = _part(left, k) / _part(sd, k)
                total[i, channel] = (float(ratio @ ratio), ratio.size)
        return total

    def excess(self, noise: Noise, solution: LinearFit) -> Excess:
        """How much more noise there is where the signal is than the quiet lines tell, where that is beyond chance; else one."""
        scores = self.scores(noise, solution)
        spare = solution.dof / max(sum(count for _, count in scores.values()), 1)
        out = {}
        for key, (squares, count) in scores.items():
            ratio = squares / (count * spare)
            out[key] = ratio if ratio > 1.0 + 2.0 * math.sqrt(2.0 / count) else 1.0
        return out


def _part(values: ComplexArray, channel: int) -> FloatArray:
    """One channel's share of the equations of a recording."""
    half = values.size // 2
    own = values[(channel // 2) * half : (channel // 2 + 1) * half]
    return np.asarray(own.real if channel % 2 == 0 else own.imag)


def _regressors(layout: Layout, p: WaveProjected, recording: Recording, before: LinearFit | None) -> ComplexArray:
    return layout.regressors(p, recording, None if before is None else before.coefficients)


def _resonance_motion(closed: list[Recording]) -> tuple[float, float, float]:
    """Slope of the resonance with temperature [rad/s/K] (zero when it hardly moved), mean temperature, wander that is left [rad/s]."""
    temperature = np.array([r.temperature_degc.mean() for r in closed])
    omega = np.array([r.ref_omega_rad_s.mean() for r in closed])
    middle, slope = float(temperature.mean()), 0.0
    if np.ptp(temperature) >= _TEMPERATURE_SPAN_K:
        slope = float(np.polyfit(temperature - middle, omega, 1)[0])
    left = omega - omega.mean() - slope * (temperature - middle)
    return slope, middle, max(float(np.std(left)), _LEAST_WANDER_RAD_S)
