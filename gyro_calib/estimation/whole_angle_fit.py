"""Identify the slow flow of a whole-angle gyro from all recordings at once: A, G, E in one linear regression.

While the wave precesses, pick-offs and drives sweep every direction, so one weighted least squares on the projected slow flow
(:mod:`.wave_projection`) finds all of A and all of G: free runs (damping and stiffness), virtual precession of both senses and several volts
(G across the wave; exact trigonometry, and the recorded u_amp(theta) and u_quad(theta), are in the drive columns), ring-down and ring-up (G
along the wave), stiffness steps, force-to-rebalance stretches, open drive off resonance (E). What acted is what stands in the drive columns,
so the latency of the loops drops out.

A rate table, if one was used, adds the response of A to rate. Cubic terms (:mod:`.wave_terms`) are taken up one kind at a time when they
remove more chi-square than chance does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from ..errors import CalibrationRefused
from ..recording.recording import Campaign, Recording
from .linear_fit import Equation, LinearFit, NoiseModel, fit_axis, fit_noise
from .slow_flow_fit import TEMPERATURE_WINDOW_K, SlowFlowEstimate, SlowFlowParameters, TableRow
from .wave_layout import Layout
from .wave_lines import quiet_lines, role_of, signal_lines
from .wave_projection import CHANNELS, Products, WaveProjected, in_wave_frame
from .wave_terms import TERMS, Term, derived_signals, plain_signals

__all__ = ["WholeAngleEstimate", "fit_whole_angle", "usable_wave_recordings"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Noise = dict[tuple[str, str], NoiseModel]

MODES = ("whole_angle", "ring_down", "ring_up", "stiffness", "ftr_x", "ftr_y")
_ROUNDS = 2
#: below this span the resonance is not regressed on temperature [K]; how far it wanders at least [rad/s]
_TEMPERATURE_SPAN_K, _LEAST_WANDER_RAD_S = 0.1, 1e-3
#: spread of the squared amplitude (or drive) from which on cubic terms show; chance of taking one up for nothing
_AMPLITUDE_SPREAD, _CHANCE = 0.3, 1e-5
#: beyond this condition number a cubic term cannot be told from the rest
_WORST_CONDITION = 1e7


@dataclass(frozen=True)
class WholeAngleEstimate:
    """What whole-angle recordings say of the slow flow.

    Parameters
    ----------
    flow : SlowFlowEstimate
        A (constant input rate included), G, E; its covariance, noise by (channel, role, ""), table.
    rate_response : ndarray, shape (2, 2), complex, or None
        dA/dOmega, when a rate was applied.
    covariance : ndarray, shape (n, n)
        Of :meth:`vector`.
    terms : mapping of str to complex
        Cubic coefficients that were needed, see :mod:`.wave_terms`.
    terms_sd : mapping of str to float
        Their standard deviations (of the larger part).
    term_gains : mapping of str to float
        Chi-square that each kind of term took away.
    excess : mapping of (channel, role) to float
        Noise at the lines of the signal over that of the quiet lines, at least one.
    wander_rad_s : float
        How the resonance moves between recordings.
    """

    flow: SlowFlowEstimate
    rate_response: ComplexArray | None
    covariance: FloatArray
    terms: Mapping[str, complex] = field(default_factory=dict)
    terms_sd: Mapping[str, float] = field(default_factory=dict)
    term_gains: Mapping[str, float] = field(default_factory=dict)
    excess: Mapping[tuple[str, str], float] = field(default_factory=dict)
    wander_rad_s: float = 0.0

    def vector(self) -> FloatArray:
        """The flow's real parameters, then the real and imaginary parts of the response to rate."""
        if self.rate_response is None:
            return self.flow.vector()
        return np.concatenate([self.flow.vector(), np.ascontiguousarray(self.rate_response.ravel()).view(np.float64)])

    def unpack(self, vector: FloatArray) -> tuple[SlowFlowParameters, ComplexArray | None]:
        """Inverse of :meth:`vector`."""
        if self.rate_response is None:
            return self.flow.unpack(vector), None
        return self.flow.unpack(vector[:-8]), np.ascontiguousarray(vector[-8:]).view(np.complex128).reshape(2, 2)


def usable_wave_recordings(campaign: Campaign, window_k: float = TEMPERATURE_WINDOW_K) -> tuple[list[Recording], list[str]]:
    """Recordings that a fit at one temperature and one constant rate may use, and why others are left out."""
    wanted = [r for r in campaign if r.command.mode in MODES or r.command.excitation.kind in ("drive", "body")]
    median = float(np.median([r.temperature_degc.mean() for r in wanted])) if wanted else math.nan
    chosen, skipped = [], []
    for r in wanted:
        temperature = r.temperature_degc
        if abs(temperature.mean() - median) > window_k or np.ptp(temperature) > 2.0 * window_k:
            skipped.append(f"{r.label}: temperature {temperature.min():.2f} to {temperature.max():.2f} degC, median {median:.2f}")
        elif r.command.excitation.kind not in ("none", "amplitude_modulation", "drive", "body"):
            skipped.append(f"{r.label}: excitation {r.command.excitation.kind}")
        else:
            chosen.append(r)
    return chosen, skipped


def fit_whole_angle(
    recordings: list[Recording],
    decay_rate: float,
    *,
    terms: tuple[str, ...] | None = None,
    drive_amplitude_v: float | None = None,
) -> WholeAngleEstimate:
    """Fit A, G, E, the response to an applied rate, and the cubic terms that the data ask for.

    Parameters
    ----------
    recordings : list of Recording
        From :func:`usable_wave_recordings`.
    decay_rate : float
        Rough 1/tau [1/s] (only the small second-order terms use it).
    terms : tuple of str, optional
        Cubic terms to fit, names of :data:`.wave_terms.TERMS`. Default: by test.
    drive_amplitude_v : float, optional
        Drives at twice the frequency (document 003, Eqs. 14-15): a volt acts in proportion to the vibration, and G is its effect at this
        amplitude [V].

    Raises
    ------
    CalibrationRefused
        No whole-angle recording, or recordings that do not excite what must be found.
    """
    if not any(r.command.mode == "whole_angle" for r in recordings):
        raise CalibrationRefused(
            "Recordings must include mode whole_angle, but got "
            f"{', '.join(sorted({r.command.mode for r in recordings})) or 'none'}. Record virtual precession of both senses."
        )
    data = _Data.of(recordings, decay_rate, drive_amplitude_v)
    if terms is not None:
        return data.estimate(data.fit(tuple(t for t in TERMS if t.name in terms)), {})
    return _selected(data)


def _selected(data: _Data) -> WholeAngleEstimate:
    """Take up the kind of term that removes most chi-square as long as that is beyond chance."""
    best = data.fit(())
    chosen: tuple[Term, ...] = ()
    gains: dict[str, float] = {}
    candidates = [t for t in TERMS if data.may_show(t)]
    while candidates:
        trials = []
        for term in candidates:
            try:
                rich = data.fit((*chosen, term))
                # weighed with the noise of the richer fit: the poorer one's misfit leaks into its own noise
                poor = data.solve(data.layout(chosen), rich.noise, rich.excess, best.solution)
            except CalibrationRefused:
                continue
            if rich.solution.condition_number < _WORST_CONDITION:
                limit = float(chdtri(2 * len(term.coefficients), _CHANCE))
                trials.append((poor.chi2 - rich.solution.chi2 - limit, limit, term, rich))
        if not trials:
            break
        margin, limit, term, rich = max(trials, key=lambda trial: trial[0])
        if margin <= 0.0:
            break
        best, chosen = rich, (*chosen, term)
        gains[term.name] = margin + limit
        candidates.remove(term)
    return data.estimate(best, gains)


@dataclass(frozen=True)
class _Fit:
    """A solution with the noise it was weighed with."""

    layout: Layout
    solution: LinearFit
    noise: Noise
    excess: dict[tuple[str, str], float]


@dataclass(frozen=True)
class _Data:
    """Projected recordings at the lines of interest and at quiet ones."""

    recordings: list[Recording]
    omega0: float
    wander: float
    base: Layout
    signal: list[WaveProjected]
    quiet: list[WaveProjected]

    @classmethod
    def of(cls, recordings: list[Recording], decay_rate: float, drive_amplitude_v: float | None) -> _Data:
        closed = [r for r in recordings if in_wave_frame(r)]
        omega0 = float(np.mean([r.ref_omega_rad_s.mean() for r in closed]))
        slope, middle, wander = _resonance_motion(closed)
        signal, quiet = [], []
        for r in recordings:
            scale = None if drive_amplitude_v is None else np.linalg.norm(r.pick, axis=1) / drive_amplitude_v
            shift = slope * (r.temperature_degc - middle)
            products = Products(
                r, omega0, decay_rate, shift, plain=plain_signals(), derived=derived_signals(), drive_scale=scale
            )
            lines = signal_lines(r, products.speed_rad_s)
            signal.append(products.project(lines))
            quiet.append(products.project(quiet_lines(r, max(lines))))
        return cls(recordings, omega0, wander, Layout.of(recordings, omega0), signal, quiet)

    def may_show(self, term: Term) -> bool:
        """Whether what the term is cubic in was varied, over the recordings or within one."""
        over_drive = term.name == "drive_cubic"
        squares = []
        for r in self.recordings:
            if in_wave_frame(r):
                volts = np.sum(np.abs(r.drive if over_drive else r.pick) ** 2, axis=1)
                squares += [float(q) for q in np.quantile(volts, [0.05, 0.95])]
        return max(squares) > (1.0 + _AMPLITUDE_SPREAD) * min(squares)

    def layout(self, terms: tuple[Term, ...]) -> Layout:
        """Layout with these cubic terms."""
        return replace(self.base, terms=terms)

    def fit(self, terms: tuple[Term, ...]) -> _Fit:
        """Fit with the noise measured along the way: on quiet lines first, then how much more there is where the signal is."""
        layout = self.layout(terms)
        noise: Noise = {}
        excess: dict[tuple[str, str], float] = {}
        solution = self.solve(layout, noise, excess, None)
        for _ in range(_ROUNDS):
            noise = self._measured(layout, solution)
            solution = self.solve(layout, noise, {}, solution)
            excess = self._excess(noise, solution)
            solution = self.solve(layout, noise, excess, solution)
        return _Fit(layout, solution, noise, excess)

    def solve(self, layout: Layout, noise: Noise, excess: Mapping[tuple[str, str], float], before: LinearFit | None) -> LinearFit:
        """Weighted least squares; A and E of ``before`` enter the small corrections."""
        equations = []
        for i, (p, r) in enumerate(zip(self.signal, self.recordings, strict=True)):
            sd = self._deviations(r, p, noise, excess)
            equations.append(
                Equation(
                    lhs=p.lhs,
                    regressors=self._regressors(layout, p, r, before),
                    gram=p.gram,
                    sd_re=sd.real,
                    sd_im=sd.imag,
                    # every resonance is its own, near that of the others; the wave's also moves steadily
                    detuning=p.resonance if in_wave_frame(self.recordings[i]) else p.resonance[:, :1],
                    detuning_sd=self.wander,
                )
            )
        return fit_axis(equations)

    def _regressors(self, layout: Layout, p: WaveProjected, r: Recording, before: LinearFit | None) -> ComplexArray:
        zero = np.zeros((2, 2), dtype=complex)
        A, E = (zero, zero) if before is None else layout.flow(before.coefficients)
        return layout.regressors(p, r, A, E)

    def _deviations(
        self, r: Recording, p: WaveProjected, noise: Noise, excess: Mapping[tuple[str, str], float]
    ) -> ComplexArray:
        """Standard deviations of the equations, of the real parts and (as imaginary part) of the imaginary ones."""
        half = p.lhs.size // 2
        sd = np.empty(p.lhs.size, dtype=complex)
        role = role_of(r)
        for k in range(2):
            place = slice(k * half, (k + 1) * half)
            parts = []
            for channel in CHANNELS[2 * k : 2 * k + 2]:
                model = noise.get((channel, role))
                density = np.ones(half) if model is None else model.density(p.frequency_hz[place])
                parts.append(np.sqrt(density * excess.get((channel, role), 1.0)))
            sd[place] = parts[0] + 1j * parts[1]
        return sd

    def _measured(self, layout: Layout, solution: LinearFit) -> Noise:
        """Noise of each role and channel from what the model leaves at its quiet lines."""
        found: dict[tuple[str, str], list[tuple[FloatArray, FloatArray]]] = {}
        longest: dict[str, float] = {}
        for p, r in zip(self.quiet, self.recordings, strict=True):
            left = p.lhs - self._regressors(layout, p, r, solution) @ solution.coefficients
            half, role = p.lhs.size // 2, role_of(r)
            longest[role] = max(longest.get(role, 0.0), r.duration_s)
            for k, channel in enumerate(CHANNELS):
                own = left[(k // 2) * half : (k // 2 + 1) * half]
                squares = (own.real if k % 2 == 0 else own.imag) ** 2
                found.setdefault((channel, role), []).append((p.frequency_hz[:half], squares))
        return {
            (channel, role): fit_noise(np.concatenate([f for f, _ in pairs]), np.concatenate([s for _, s in pairs]), 0.3 / longest[role])
            for (channel, role), pairs in found.items()
        }

    def _scores(self, noise: Noise, solution: LinearFit) -> dict[tuple[str, str], tuple[float, int]]:
        """Sum of the squared, weighed residuals at the signal's lines, and their number, by channel and role."""
        total: dict[tuple[str, str], tuple[float, int]] = {}
        for p, r, left in zip(self.signal, self.recordings, solution.residuals, strict=True):
            sd = self._deviations(r, p, noise, {})
            half = p.lhs.size // 2
            for k, channel in enumerate(CHANNELS):
                own = slice((k // 2) * half, (k // 2 + 1) * half)
                ratio = left[own].real / sd[own].real if k % 2 == 0 else left[own].imag / sd[own].imag
                squares, count = total.get((channel, role_of(r)), (0.0, 0))
                total[channel, role_of(r)] = (squares + float(ratio @ ratio), count + half)
        return total

    def _excess(self, noise: Noise, solution: LinearFit) -> dict[tuple[str, str], float]:
        """How much more noise there is where the signal is than the quiet lines tell, where that is beyond chance."""
        equations = sum(count for _, count in self._scores(noise, solution).values())
        spare = solution.dof / max(equations, 1)
        out = {}
        for key, (squares, count) in self._scores(noise, solution).items():
            ratio = squares / (count * spare)
            out[key] = ratio if ratio > 1.0 + 2.0 * math.sqrt(2.0 / count) else 1.0
        return out

    def estimate(self, fit: _Fit, gains: Mapping[str, float]) -> WholeAngleEstimate:
        """Package a fit."""
        layout, solution = fit.layout, fit.solution
        size, own = 4 * layout.per_axis, layout.rate_response
        keep = np.concatenate([np.arange(size), np.arange(2 * own.start, 2 * own.stop)]).astype(int)
        covariance = solution.covariance[np.ix_(keep, keep)]
        temperatures = np.array([r.temperature_degc.mean() for r in self.recordings])
        scores = self._scores(fit.noise, solution)
        # the frequency of a wave holds the wander of its resonance, which is nobody's misfit
        judged = {key: score for key, score in scores.items() if key[0] != "frequency" or key[1].startswith("open")}
        equations = sum(count for _, count in scores.values())
        blank = SlowFlowParameters(*(np.zeros((2, 2), dtype=complex) for _ in range(5)))
        flow = SlowFlowEstimate(
            values=blank,
            covariance=covariance[:size, :size],
            has_feedthrough=layout.has_feedthrough,
            has_cubic=False,
            cubic_gain=0.0,
            omega0_rad_s=self.omega0,
            temperature_degc=float(temperatures.mean()),
            temperature_sd_k=float(temperatures.std()),
            chi2=sum(squares for squares, _ in judged.values()),
            dof=max(1, round(sum(count for _, count in judged.values()) * solution.dof / max(equations, 1))),
            condition_number=solution.condition_number,
            noise={(channel, role, ""): model for (channel, role), model in fit.noise.items()},
            table=tuple(self._table(fit)),
        )
        flow = replace(flow, values=flow.unpack(solution.coefficients[: 2 * layout.per_axis].view(np.float64)))
        terms, terms_sd = {}, {}
        deviations = np.sqrt(np.diag(solution.covariance)).reshape(-1, 2).max(axis=1)
        for term in layout.terms:
            place = layout.term(term.name)
            terms |= {name: complex(c) for name, c in zip(term.coefficients, solution.coefficients[place], strict=True)}
            terms_sd |= {name: float(s) for name, s in zip(term.coefficients, deviations[place], strict=True)}
        return WholeAngleEstimate(
            flow=flow,
            rate_response=solution.coefficients[own].reshape(2, 2) if layout.turned else None,
            covariance=covariance,
            terms=terms,
            terms_sd=terms_sd,
            term_gains=dict(gains),
            excess=fit.excess,
            wander_rad_s=self.wander,
        )

    def _table(self, fit: _Fit) -> list[TableRow]:
        """One row a recording: volts and residual of its mean, along and across the wave."""
        rows = []
        for p, r, left in zip(self.signal, self.recordings, fit.solution.residuals, strict=True):
            half = p.lhs.size // 2
            pair = (0, half)
            sd = self._deviations(r, p, fit.noise, fit.excess)
            pick, drive = (np.trace(q, axis1=1, axis2=2) for q in (p.pick, p.drive))
            rows.append(
                TableRow(
                    label=r.label,
                    axis=r.command.oscillator_axis or "",
                    frequency_hz=float(p.frequency_hz[0]),
                    pick=(complex(pick[0]), complex(pick[half])),
                    drive=(complex(drive[0]), complex(drive[half])),
                    residual=(complex(left[0]), complex(left[half])),
                    sd=tuple(math.sqrt(0.5 * (sd[i].real ** 2 + sd[i].imag ** 2)) for i in pair),  # type: ignore[arg-type]
                )
            )
        return rows


def _resonance_motion(closed: list[Recording]) -> tuple[float, float, float]:
    """Slope of the resonance with temperature [rad/s/K] (zero when it hardly moved), mean temperature, wander that is left [rad/s]."""
    temperature = np.array([r.temperature_degc.mean() for r in closed])
    omega = np.array([r.ref_omega_rad_s.mean() for r in closed])
    middle, slope = float(temperature.mean()), 0.0
    if np.ptp(temperature) >= _TEMPERATURE_SPAN_K:
        slope = float(np.polyfit(temperature - middle, omega, 1)[0])
    left = omega - omega.mean() - slope * (temperature - middle)
    return slope, middle, max(float(np.std(left)), _LEAST_WANDER_RAD_S)
