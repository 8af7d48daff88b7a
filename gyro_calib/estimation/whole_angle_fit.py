"""Identify the slow flow of a whole-angle gyro from all recordings at once: A, G, E in one linear regression.

While the wave precesses, pick-offs and drives sweep every direction, so one weighted least squares on the projected slow flow
(:mod:`.wave_projection`) finds all of A and all of G: free runs (damping and stiffness), virtual precession of both senses and several
volts
(G across the wave; exact trigonometry, and the recorded u_amp(theta) and u_quad(theta), are in the drive columns), ring-down and ring-up (G
along the wave), stiffness steps, force-to-rebalance stretches, open drive off resonance (E). What acted is what stands in the drive
columns,
so the latency of the loops drops out; a record that is itself late by a sample of the converters shows as a lag and is taken out.

A constant rate and a forcer rotation 2 lambda are both a constant precession under a steady amplitude drive, and at another amplitude they
still are: u_amp/a = 1/(g tau) whatever a. What tells them apart is in the same regression: u_amp(theta) under virtual precession (k_va of
document 004, Eq. 30, has 2 lambda in it, no rate) and ring-down against ring-up (the drive turns its sign, the rate does not).

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
from .linear_fit import LinearFit
from .slow_flow_data import TEMPERATURE_WINDOW_K
from .slow_flow_estimate import SlowFlowEstimate, SlowFlowParameters, TableRow
from .wave_data import Excess, Noise, WaveData
from .wave_layout import Layout
from .wave_projection import in_wave_frame
from .wave_terms import TERMS, Term

__all__ = ["WholeAngleEstimate", "fit_wave_data", "fit_whole_angle", "usable_wave_recordings", "without_needless_lag"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

MODES = ("whole_angle", "ring_down", "ring_up", "stiffness", "ftr_x", "ftr_y")
_ROUNDS = 5
#: samples of the converters from which on a record of the drives counts as late
_LATE = 0.75
#: relative spread of the squared amplitude (or drive) from which on cubic terms show; chance of taking one up for nothing
_AMPLITUDE_SPREAD, _CHANCE = 0.3, 1e-5
#: beyond this condition number a cubic term cannot be told from the rest
_WORST_CONDITION = 1e7


@dataclass(frozen=True)
class WholeAngleEstimate:
    """What whole-angle recordings say of the slow flow.

    Parameters
    ----------
    flow : SlowFlowEstimate
        A (constant input rate included), G, E; its covariance, its noise by (channel, label, ""), its table.
    rate_response : ndarray, shape (2, 2), complex, or None
        dA/dOmega, when a rate was applied.
    covariance : ndarray, shape (n, n)
        Of :meth:`vector`.
    drive_lag_s : float
        How much later the drive acts than it is recorded, as the pick-offs show it [s]; 0 when the data exclude one.
    terms : mapping of str to complex
        Cubic coefficients that were needed, see :mod:`.wave_terms`.
    terms_sd : mapping of str to tuple of 2 float
        Standard deviations of their real and imaginary parts.
    term_gains : mapping of str to float
        Chi-square that each kind of term took away.
    wander_rad_s : float
        How the resonance moves between recordings.
    """

    flow: SlowFlowEstimate
    rate_response: ComplexArray | None
    covariance: FloatArray
    drive_lag_s: float = 0.0
    terms: Mapping[str, complex] = field(default_factory=dict)
    terms_sd: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    term_gains: Mapping[str, float] = field(default_factory=dict)
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
    return fit_wave_data(without_needless_lag(WaveData.of(recordings, decay_rate, drive_amplitude_v)), terms)


def fit_wave_data(data: WaveData, terms: tuple[str, ...] | None = None) -> WholeAngleEstimate:
    """:func:`fit_whole_angle` of recordings that are projected already, and rid of a lag that they exclude."""
    if terms is not None:
        return _estimate(_fit(data, tuple(t for t in TERMS if t.name in terms)), {})
    return _selected(data)


def without_needless_lag(data: WaveData) -> WaveData:
    """The same without a lag of the drives, where the data exclude one sample of the converters and ask for none.

    A record is late by samples or not at all (what looks like a part of one is something else, seen in switched drives); a lag left free in
    vain turns the drives of a turning wave, and takes half of what is known of 2 delta and of the damping. Multiplexed electronics always
    have one: each drive acts in its own slot, a slot after its pick-off was read, so that a driven wave moves in steps and a reading lies
    late on its step by one control period (left out: -25e-6 in 2 lambda at 2 deg/s).
    """
    sample_s = max((float(r.extras.get("dac_zero_order_hold_s", 0.0) or 0.0) for r in data.recordings), default=0.0)
    if not data.base.lagging:
        return data
    fit = _fit(data, ())
    place = fit.layout.lag
    gain = float(np.abs(np.diag(_estimate(fit, {}).flow.values.G)).mean())
    rows = np.arange(2 * place.start, 2 * place.stop)
    information = np.linalg.inv(fit.solution.covariance[np.ix_(rows, rows)])
    values = np.ascontiguousarray(fit.solution.coefficients[place]).view(np.float64)
    spread = float(np.sqrt(np.diag(fit.solution.covariance))[rows][::2].max()) / gain
    late = abs(float(values[0])) / gain > _LATE * sample_s and float(values @ information @ values) > float(chdtri(values.size, _CHANCE))
    # without open drive it passes for feedthrough: then only one that is there for certain
    if late or (data.base.has_feedthrough and spread > sample_s / 3.0):
        return data
    return replace(data, base=replace(data.base, lagging=False))


@dataclass(frozen=True)
class _Fit:
    """A solution with the noise it was weighed with, and the data with the wander that it shows."""

    data: WaveData
    layout: Layout
    solution: LinearFit
    noise: Noise
    excess: Excess
    flicker: float


def _fit(data: WaveData, terms: tuple[Term, ...]) -> _Fit:
    """Fit with the noise measured along the way: on quiet lines first, then how much more there is where the signal is."""
    layout = replace(data.base, terms=terms)
    noise: Noise = {}
    excess: Excess = {}
    flicker = 0.0
    solution = data.solve(layout, noise, excess, None)
    for _ in range(_ROUNDS):
        # from too little trust to more: a recording that looks quiet by chance must not pull the fit onto itself
        data = data.with_wander(solution)
        noise = data.noise(layout, solution, (noise, excess))
        excess = data.excess(noise, solution)
        flicker = data.flicker(noise, excess, solution, flicker)
        solution = data.solve(layout, noise, excess, solution, flicker)
    return _Fit(data, layout, solution, noise, excess, flicker)


def _selected(data: WaveData) -> WholeAngleEstimate:
    """Take up the kind of term that removes most chi-square as long as that is beyond chance."""
    best = _fit(data, ())
    gains: dict[str, float] = {}
    candidates = [t for t in TERMS if _may_show(data, t)]
    while candidates:
        rough = {term.name: _gain(best, term, best) for term in candidates}
        term = max(candidates, key=lambda t: rough[t.name] - _limit(t))
        if rough[term.name] <= _limit(term):
            break
        rich = _fit(data, (*best.layout.terms, term))
        # again with the noise of the richer fit: the poorer one's misfit leaks into its own noise
        gain = _gain(best, term, rich)
        if gain <= _limit(term):
            break
        best, gains[term.name] = rich, gain
        candidates.remove(term)
    return _estimate(best, gains)


def _limit(term: Term) -> float:
    """Chi-square that a term takes away by chance once in 1/_CHANCE campaigns."""
    return float(chdtri(2 * len(term.coefficients), _CHANCE))


def _gain(fit: _Fit, term: Term, weights: _Fit) -> float:
    """Chi-square that a further term takes away, weighed as in ``weights``; nothing where it cannot be told from the rest."""
    data, layout = weights.data, replace(fit.layout, terms=(*fit.layout.terms, term))
    try:
        poor = data.solve(fit.layout, weights.noise, weights.excess, fit.solution, weights.flicker)
        before = _with_room(fit.solution, len(term.coefficients))
        rich = data.solve(layout, weights.noise, weights.excess, before, weights.flicker)
    except CalibrationRefused:
        return 0.0
    return poor.chi2 - rich.chi2 if rich.condition_number < _WORST_CONDITION else 0.0


def _with_room(solution: LinearFit, more: int) -> LinearFit:
    """The solution of a poorer fit in the layout of a richer one: what it did not know is zero."""
    return replace(solution, coefficients=np.concatenate([solution.coefficients, np.zeros(more, dtype=complex)]))


def _may_show(data: WaveData, term: Term) -> bool:
    """Whether what the term is cubic in was varied, over the recordings or within one."""
    squares: list[float] = []
    for r in data.recordings:
        if in_wave_frame(r):
            volts = np.sum(np.abs(r.drive if term.name == "drive_cubic" else r.pick) ** 2, axis=1)
            squares += [float(q) for q in np.quantile(volts, [0.05, 0.95])]
    return max(squares) > (1.0 + _AMPLITUDE_SPREAD) * min(squares)


def _estimate(fit: _Fit, gains: Mapping[str, float]) -> WholeAngleEstimate:
    """Package a fit."""
    data, layout, coefficients = fit.data, fit.layout, fit.solution.coefficients
    size, own = 4 * layout.per_axis, layout.rate_response
    keep = np.concatenate([np.arange(size), np.arange(2 * own.start, 2 * own.stop)]).astype(int)
    covariance = fit.solution.covariance[np.ix_(keep, keep)]
    deviations = np.sqrt(np.diag(fit.solution.covariance)).reshape(-1, 2)
    terms: dict[str, complex] = {}
    terms_sd: dict[str, tuple[float, float]] = {}
    for term in layout.terms:
        for name, c, (re, im) in zip(
            term.coefficients, coefficients[layout.term(term.name)], deviations[layout.term(term.name)], strict=True
        ):
            terms[name], terms_sd[name] = complex(c), (float(re), float(im))
    flow = _flow(fit, covariance[:size, :size])
    return WholeAngleEstimate(
        flow=flow,
        rate_response=coefficients[own].reshape(2, 2) if layout.turned else None,
        covariance=covariance,
        drive_lag_s=-float(coefficients[layout.lag].real.mean() / np.abs(np.diag(flow.values.G)).mean()) if layout.lagging else 0.0,
        terms=terms,
        terms_sd=terms_sd,
        term_gains=dict(gains),
        wander_rad_s=data.wander,
    )


def _flow(fit: _Fit, covariance: FloatArray) -> SlowFlowEstimate:
    """The part that other experiments have too, in their form."""
    data, solution = fit.data, fit.solution
    scores = data.scores(data.quiet_noise(fit.layout, solution), solution)
    # the frequency of a wave holds the wander of its resonance, which is nobody's misfit
    judged = [score for (i, channel), score in scores.items() if channel != "frequency" or not in_wave_frame(data.recordings[i])]
    spare = solution.dof / max(sum(count for _, count in scores.values()), 1)
    temperatures = np.array([r.temperature_degc.mean() for r in data.recordings])
    flow = SlowFlowEstimate(
        values=SlowFlowParameters(*(np.zeros((2, 2), dtype=complex) for _ in range(5))),
        covariance=covariance,
        has_feedthrough=fit.layout.has_feedthrough,
        has_cubic=False,
        cubic_gain=0.0,
        omega0_rad_s=data.omega0,
        temperature_degc=float(temperatures.mean()),
        temperature_sd_k=float(temperatures.std()),
        chi2=sum(squares for squares, _ in judged),
        dof=max(1, round(spare * sum(count for _, count in judged))),
        condition_number=solution.condition_number,
        noise={(channel, data.recordings[i].label, ""): model for (i, channel), model in fit.noise.items()},
        table=tuple(_table_row(fit, i) for i in range(len(data.recordings))),
    )
    block = np.ascontiguousarray(solution.coefficients[: 2 * fit.layout.per_axis])
    return replace(flow, values=flow.unpack(block.view(np.float64)))


def _table_row(fit: _Fit, index: int) -> TableRow:
    """Volts and residual of a recording's mean, along and across the wave (with loops off: x and y)."""
    data = fit.data
    p, r = data.signal[index], data.recordings[index]
    sd, left = data.deviations(index, fit.noise, fit.excess), fit.solution.residuals[index]
    pick, drive = (np.trace(q, axis1=1, axis2=2) for q in (p.pick, p.drive))
    first, second = 0, p.lhs.size // 2

    def spread(i: int) -> float:
        return math.sqrt(0.5 * (sd[i].real ** 2 + sd[i].imag ** 2))

    return TableRow(
        label=r.label,
        axis=r.command.oscillator_axis or "",
        frequency_hz=float(p.frequency_hz[0]),
        pick=(complex(pick[first]), complex(pick[second])),
        drive=(complex(drive[first]), complex(drive[second])),
        residual=(complex(left[first]), complex(left[second])),
        sd=(spread(first), spread(second)),
    )
