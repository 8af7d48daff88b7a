"""Whole-angle recordings made ready for the regression: projected, weighed with the noise that they themselves show."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..recording.applied_rate import is_turned
from ..recording.recording import Recording
from .linear_fit import Equation, LinearFit, NoiseModel, fit_axis, fit_noise, fit_noises
from .wave_layout import Layout
from .wave_lines import quiet_lines, role_of, signal_lines
from .wave_projection import CHANNELS, Products, WaveProjected, in_wave_frame
from .wave_slow import slow_forces
from .wave_terms import derived_signals, plain_signals, warm_signals

__all__ = ["Excess", "Noise", "WaveData"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: noise of a recording (its index) in a channel
Noise = dict[tuple[int, str], NoiseModel]
Excess = dict[tuple[int, str], float]
#: lines [Hz], slopes of the test functions there [Hz], squared residuals
Samples = tuple[FloatArray, FloatArray, FloatArray]
_FLAT = NoiseModel((1.0, 0.0, 0.0), 1.0)
#: noise before it is known: what matters is that the resonance wanders by far more than the rest is uncertain
_UNKNOWN = {"frequency": NoiseModel((1e6, 0.0, 0.0), 1.0)}
#: least noise of a role over what all recordings have in common
_COMMON = 0.3
#: variance of the means of records some ten of their lengths apart over the coefficient of flicker: 2 ln 10
_BETWEEN = 4.6
#: below this span the resonance is not regressed on temperature [K]; how far it wanders at least [rad/s]
_TEMPERATURE_SPAN_K, _LEAST_WANDER_RAD_S = 0.1, 1e-7
#: an equation of which the fit leaves less of its noise than this says nothing of it
_LEAST_SHARE = 0.2
#: wander of the gain before a fit has shown it, relative
_GAIN_WANDER, _LEAST_GAIN_WANDER = 1e-6, 1e-9
#: relative change of a gain over that of the frequency, when the same temperature moves both: some 1e-4 and 1e-4 per kelvin
_GAIN_OVER_FREQUENCY = 3.0
#: recordings that show how it wanders
_LEAST_RECORDINGS = 4


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
    gain_wander : float
        How the gain of the drives does, relative: their temperature, their supply.
    base : Layout
        Unknowns without cubic terms.
    signal, quiet : list of WaveProjected
    slow : list of ndarray, shape (2 m, q)
        What unit sources of flicker that all recordings share add to a recording's equations at its signal lines, see :func:`.slow_forces`.
    """

    recordings: list[Recording]
    omega0: float
    wander: float
    gain_wander: float
    base: Layout
    signal: list[WaveProjected]
    quiet: list[WaveProjected]
    slow: list[FloatArray]

    @classmethod
    def of(cls, recordings: list[Recording], decay_rate: float, drive_amplitude_v: float | None) -> WaveData:
        """Project every recording; see :func:`.whole_angle_fit.fit_whole_angle` for the arguments."""
        closed = [r for r in recordings if in_wave_frame(r)]
        omega0 = float(np.mean([r.ref_omega_rad_s.mean() for r in closed]))
        slope, middle, wander = _resonance_motion(closed)
        signal, quiet = [], []
        mean_degc = float(np.mean([r.temperature_degc.mean() for r in recordings]))
        for r in recordings:
            products = Products(
                r,
                omega0,
                decay_rate,
                slope * (r.temperature_degc - middle),
                plain=plain_signals() | warm_signals(r.temperature_degc - mean_degc, 1.0 / r.sample_rate_hz),
                derived=derived_signals(),
                drive_scale=None if drive_amplitude_v is None else np.linalg.norm(r.pick, axis=1) / drive_amplitude_v,
            )
            lines = signal_lines(r, products.speed_rad_s)
            signal.append(products.project(lines))
            quiet.append(products.project(quiet_lines(r, max(lines), products.speed_rad_s)))
        layout = Layout.of(recordings, omega0, _farthest(signal))
        return cls(recordings, omega0, wander, _GAIN_WANDER, layout, signal, quiet, slow_forces(recordings, signal))

    def subset(self, indices: list[int]) -> WaveData:
        """The same for some of the recordings; whether the drives are late is a property of the device that all of them told."""
        recordings = [self.recordings[i] for i in indices]
        signal, quiet = ([projected[i] for i in indices] for projected in (self.signal, self.quiet))
        layout, slow = Layout.of(recordings, self.omega0, _farthest(signal)), [self.slow[i] for i in indices]
        if not self.base.lagging:
            layout = replace(layout, lagging=False)
        return WaveData(recordings, self.omega0, self.wander, self.gain_wander, layout, signal, quiet, slow)

    def with_wander(self, solution: LinearFit) -> WaveData:
        """The same with the wander that a fit shows: what it leaves to each closed-loop recording, over the number of those that say
        anything beyond the wander it assumed (MacKay's fixed point of the evidence).

        The frequencies themselves would show what drives them too (stiffness control, the split along the azimuth), and an open drive's
        distance from resonance, with it the feedthrough, would seem unknown.
        """
        own = np.array([d[[0, 2]] for d, r in zip(solution.detunings, self.recordings, strict=True) if in_wave_frame(r)])
        if len(own) < _LEAST_RECORDINGS:
            return self
        assumed = np.array([self.wander, self.gain_wander])
        told = np.sum(np.maximum(1.0 - (own[:, :, 1] / assumed) ** 2, 0.0), axis=0)
        factor = np.sqrt(np.sum((own[:, :, 0] / assumed) ** 2, axis=0) / np.maximum(told, 1e-3))
        wander, gain = (float(v) for v in assumed * np.clip(factor, 0.1, 3.0))
        # a few recordings cannot show a wander of the gain that matters: what moves the resonance is taken to move the gain, too
        least = max(_LEAST_GAIN_WANDER, _GAIN_OVER_FREQUENCY * wander / self.omega0)
        return replace(self, wander=max(wander, _LEAST_WANDER_RAD_S), gain_wander=max(gain, least))

    def solve(self, layout: Layout, noise: Noise, excess: Excess, last: LinearFit | None, flicker: float = 0.0) -> LinearFit:
        """Weighted least squares; A, G and E of a round before (``last``) enter the small corrections, ``flicker`` is by how much the force
        that does not follow the wave flickers: density ``flicker / f`` [V^2/s^2].
        """
        equations = []
        spread = np.array([self.wander, self.wander, self.gain_wander])
        before = None if last is None else last.coefficients
        for i, (p, r) in enumerate(zip(self.signal, self.recordings, strict=True)):
            sd = self.deviations(i, noise, excess)
            equations.append(
                Equation(
                    lhs=p.lhs,
                    regressors=layout.regressors(p, r, before),
                    gram=p.gram,
                    sd_re=sd.real,
                    sd_im=sd.imag,
                    # every resonance is its own, near that of the others; the wave's also moves steadily, and its drives' gain wanders
                    detuning=np.column_stack([p.resonance, layout.pushed(p, before)]) if in_wave_frame(r) else p.resonance[:, :1],
                    detuning_sd=spread if in_wave_frame(r) else self.wander,
                    covariance=self.covariance(i, noise, excess),
                    shared=math.sqrt(flicker) * self.slow[i] if flicker > 0.0 else None,
                )
            )
        return fit_axis(equations)

    def without_flicker(self, index: int, solution: LinearFit) -> ComplexArray:
        """Residuals less the flicker that they most probably hold."""
        left = solution.residuals[index]
        return left - solution.shared[index] if solution.shared else left

    def flicker(self, noise: Noise, excess: Excess, solution: LinearFit, last: float) -> float:
        """Flicker of forces that do not follow the wave: by how much their means differ between recordings, beyond their noise [V^2/s^2].

        Read from what the fit leaves of waves that turned by more than half a turn of psi: only there does it not pass for damping. A few
        means say little of their spread: one standard deviation of it is added. That is where to start from: with it in the covariance,
        the solution says itself by how much it was off.
        """
        if solution.shared:
            return last * float(np.clip(solution.shared_growth, 0.3, 3.0))
        squares, chance = [], []
        for i, (p, left) in enumerate(zip(self.signal, solution.residuals, strict=True)):
            if p.turn_rad < math.pi or not in_wave_frame(self.recordings[i]):
                continue
            sd = self.deviations(i, noise, excess)
            design = np.hstack([p.constant, 1j * p.constant])
            rows = np.vstack([design.real / sd.real[:, None], design.imag / sd.imag[:, None]])
            values = np.concatenate([left.real / sd.real, left.imag / sd.imag])
            inverse = np.linalg.inv(rows.T @ rows)
            found = inverse @ (rows.T @ values)
            squares += list(found**2)
            chance += list(np.diag(inverse))
        if not squares:
            return 0.0
        # the fit has taken the four means of all recordings out
        spread, noise_part = float(np.sum(squares)) / max(len(squares) - 4, 1), float(np.mean(chance))
        return (max(spread - noise_part, 0.0) + max(spread, noise_part) * math.sqrt(2.0 / len(squares))) / _BETWEEN

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
                density = model.density(p.frequency_hz[place], p.slope_hz[place])
                parts.append(np.sqrt(density * excess.get((index, channel), 1.0)))
            sd[place] = parts[0] + 1j * parts[1]
        return sd

    def covariance(self, index: int, noise: Noise, excess: Mapping[tuple[int, str], float]) -> tuple[FloatArray, FloatArray]:
        """Covariance of the real parts of a recording's equations, and of their imaginary ones.

        Pick-off noise enters by the slopes of the test functions: at the carrier line that is the rise of the window, which smoother sums
        of several lines avoid. Counted by the frequency of the line alone, it would cost most of what a short recording says.
        """
        p = self.signal[index]
        half = p.lhs.size // 2
        parts = []
        for k in range(2):
            flat, steep = np.empty(2 * half), np.empty(2 * half)
            for side in range(2):
                place, channel = slice(side * half, (side + 1) * half), CHANNELS[2 * side + k]
                model, more = noise.get((index, channel), _UNKNOWN.get(channel, _FLAT)), excess.get((index, channel), 1.0)
                flat[place] = np.sqrt(model.density(p.frequency_hz[place], np.zeros(half)) * more)
                steep[place] = math.sqrt(model.coefficients[2] * more) / (2.0 * math.pi)
            parts.append(p.gram * np.outer(flat, flat) + p.slope_gram * np.outer(steep, steep))
        return parts[0], parts[1]

    def quiet_noise(self, layout: Layout, solution: LinearFit, wanted: Callable[[Recording], bool] = lambda r: True) -> Noise:
        """Noise of each recording and channel at its quiet lines alone: what the signal's lines are judged by."""
        noise: Noise = {}
        for i, (lines, slopes, left) in enumerate(self._quiet_residuals(layout, solution)):
            if not wanted(self.recordings[i]):
                continue
            lowest = 0.3 / self.recordings[i].duration_s
            squares = np.stack([_part(left, k) for k in range(len(CHANNELS))]) ** 2
            for channel, model in zip(CHANNELS, fit_noises(lines, squares, lowest, slopes), strict=True):
                # what grows with frequency at the quiet lines hides what does not: as much may be there as they would not have shown
                floor = _COMMON * model.coefficients[2] * float(lines.min()) ** 2
                noise[i, channel] = replace(model, coefficients=(max(model.coefficients[0], floor), *model.coefficients[1:]))
        return noise

    def noise(self, layout: Layout, solution: LinearFit, weights: tuple[Noise, Excess]) -> Noise:
        """Noise that the fit is weighed with: of all recordings of one role together, what the fit leaves at the signal's lines included.

        Only so are the low lines seen, where the force noise lies under the pick-off's at every quiet line. Together, and not far below
        what all closed-loop recordings have in common, because a recording that looked quiet there by chance would pull the fit onto
        itself, look quieter still, and so on. The flicker that ``weights`` already allow for is taken out.
        """
        samples, quiet = self._samples(layout, solution, weights), self.quiet_noise(layout, solution, is_turned)
        longest: dict[str, float] = {}
        for r in self.recordings:
            longest[role_of(r)] = max(longest.get(role_of(r), 0.0), r.duration_s)
        found: Noise = {}
        for channel in CHANNELS:
            waves = [i for i, r in enumerate(self.recordings) if in_wave_frame(r)]
            common = _pooled([samples[i, channel] for i in waves], max(longest.values())) if waves else None
            roles = {
                role: _pooled([samples[i, channel] for i, r in enumerate(self.recordings) if role_of(r) == role], length)
                for role, length in longest.items()
            }
            for i, r in enumerate(self.recordings):
                if is_turned(r):
                    # a table's course is never quite what it is said to be: what the quiet lines leave counts at all lines
                    found[i, channel] = quiet[i, channel]
                    continue
                found[i, channel] = _not_below(roles[role_of(r)], common) if common and in_wave_frame(r) else roles[role_of(r)]
        return found

    def _samples(self, layout: Layout, solution: LinearFit, weights: tuple[Noise, Excess]) -> dict[tuple[int, str], Samples]:
        """Lines, slopes and squared residuals of each recording and channel."""
        quiet = self._quiet_residuals(layout, solution)
        samples = {}
        for i, (p, r) in enumerate(zip(self.signal, self.recordings, strict=True)):
            lines, slopes, left = quiet[i]
            own = p.frequency_hz[: p.lhs.size // 2]
            low = own > 0.7 / r.duration_s
            clean = self.without_flicker(i, solution)
            sd = self.deviations(i, weights[0], weights[1])
            for k, channel in enumerate(CHANNELS):
                # the lowest lines determine the unknowns, so that little of their noise is left to see
                share = 1.0 - _part(solution.explained[i], k) / _part(sd, k) ** 2
                seen = low & (share > _LEAST_SHARE)
                f = np.concatenate([lines, own[seen]])
                steep = np.concatenate([slopes, p.slope_hz[: own.size][seen]])
                squares = np.concatenate([_part(left, k) ** 2, _part(clean, k)[seen] ** 2 / share[seen]])
                samples[i, channel] = (f, steep, squares)
        return samples

    def _quiet_residuals(self, layout: Layout, solution: LinearFit) -> list[tuple[FloatArray, FloatArray, ComplexArray]]:
        """Lines, slopes there, and what the model leaves, by recording."""
        return [
            (
                p.frequency_hz[: p.lhs.size // 2],
                p.slope_hz[: p.lhs.size // 2],
                p.lhs - layout.regressors(p, r, solution.coefficients) @ solution.coefficients,
            )
            for p, r in zip(self.quiet, self.recordings, strict=True)
        ]

    def scores(self, noise: Noise, solution: LinearFit) -> dict[tuple[int, str], tuple[float, int]]:
        """Sum of the squared residuals at a recording's signal lines over their measured noise, and their number, by channel."""
        total = {}
        for i in range(len(self.recordings)):
            left = self.without_flicker(i, solution)
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


def _farthest(signal: list[WaveProjected]) -> float:
    return max((p.turn_rad for p in signal), default=0.0)


def _pooled(samples: list[Samples], longest_s: float) -> NoiseModel:
    """One noise model of several recordings."""
    lines, slopes, squares = (np.concatenate([s[k] for s in samples]) for k in range(3))
    return fit_noise(lines, squares, 0.3 / longest_s, slopes)


def _not_below(model: NoiseModel, common: NoiseModel) -> NoiseModel:
    """A role's noise with its force noise and flicker not far below the common ones."""
    white, flicker, pickoff = model.coefficients
    return replace(
        model,
        coefficients=(max(white, _COMMON * common.coefficients[0]), max(flicker, _COMMON * common.coefficients[1]), pickoff),
        walk=max(model.walk, _COMMON * common.walk),
    )


def _part(values: ComplexArray, channel: int) -> FloatArray:
    """One channel's share of the equations of a recording."""
    half = values.size // 2
    own = values[(channel // 2) * half : (channel // 2 + 1) * half]
    return np.asarray(own.real if channel % 2 == 0 else own.imag)


def _resonance_motion(closed: list[Recording]) -> tuple[float, float, float]:
    """Slope of the resonance with temperature [rad/s/K] (zero when it hardly moved), mean temperature, wander that is left [rad/s]."""
    closed = [r for r in closed if r.command.mode != "stiffness"] or closed
    temperature = np.array([r.temperature_degc.mean() for r in closed])
    omega = np.array([r.ref_omega_rad_s.mean() for r in closed])
    middle, slope = float(temperature.mean()), 0.0
    if np.ptp(temperature) >= _TEMPERATURE_SPAN_K:
        slope = float(np.polyfit(temperature - middle, omega, 1)[0])
    left = omega - omega.mean() - slope * (temperature - middle)
    return slope, middle, max(float(np.std(left)), _LEAST_WANDER_RAD_S)
