"""Noise of a campaign, measured while everything that could be an effect is allowed for.

If the noise were measured on what the linear model leaves, an effect would raise it and hide. So it is measured on what a saturated model
leaves, one that holds every effect of the registry at once: too rich to name anything, but what it cannot follow is noise. Each residual is
corrected for its leverage. Records of a rarer kind (turned, warming) are not believed to be quieter than those of their mode, and what
repeated records differ by at their mean counts whatever the model says. Quiet lines and signal lines are pooled by role and channel, with a density of white, flicker, random walk and
pick-off terms as far as the data ask for them: a 1/f floor and a resonance that wanders by millikelvins are noise, not effects.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..estimation.linear_fit import NoiseModel, fit_noise
from .columns import Column
from .evidence import CHANNELS, CampaignEvidence, RecordingEvidence
from .nuisance import quiet_target_of, target_of
from .system import NoiseByRole, Solution, Whitener, solve

__all__ = ["first_noise", "measured_noise"]

ComplexArray = NDArray[np.complex128]
_ROUNDS = 5
#: a row of which less than this is left says nothing of the noise
_LEAST_FREEDOM = 0.3
#: differences between repeated records that say how much their means differ by
_FEWEST_REPEATS = 5
#: effective frequency of a record's mean over one by its duration
_MEAN_LINE = 0.3


def first_noise(evidence: CampaignEvidence) -> dict[tuple[str, str], NoiseModel]:
    """Noise before it is known: what matters is that the frequency of a wave wanders by far more than the rest is uncertain."""
    return {
        (r.role, channel): NoiseModel((1e6 if channel == "frequency" and r.is_wave else 1.0, 0.0, 0.0), 1e-2)
        for r in evidence
        for channel in CHANNELS
    }


def measured_noise(evidence: CampaignEvidence, saturated: Sequence[Column], angular_gain: float) -> NoiseByRole:
    """Noise by role and channel, from what the saturated model leaves at quiet and at signal lines."""
    noise: NoiseByRole = first_noise(evidence)
    target, quiet = target_of(evidence, angular_gain), quiet_target_of(evidence, angular_gain)
    for _ in range(_ROUNDS):
        whitener = Whitener.of(evidence, noise)
        solution = solve(saturated, whitener.design(saturated, len(evidence)), whitener.rows(target))
        noise = _from_residuals(evidence, solution, noise, quiet)
    return _with_repeats(evidence, solution, noise, target)


def _with_repeats(evidence: CampaignEvidence, solution: Solution, noise: NoiseByRole, target: Sequence[ComplexArray]) -> NoiseByRole:
    """Noise of the means, raised to what repeated records differ by."""
    groups: dict[tuple[object, ...], list[int]] = defaultdict(list)
    for k, r in enumerate(evidence):
        if r.is_wave and not r.is_warming and "applied_rate" not in r.recording.extras:
            groups[_condition(r)].append(k)
    squares: dict[tuple[str, str], float] = defaultdict(float)
    freedom: dict[tuple[str, str], int] = defaultdict(int)
    left = [t - np.stack([c.signal[k] for c in solution.columns], axis=1) @ solution.values for k, t in enumerate(target)]
    for members in groups.values():
        for part in range(2):
            for side in range(2):
                means = np.array([_mean_line(evidence.recordings[k], left[k], part, side) for k in members])
                key = (evidence.recordings[members[0]].role, CHANNELS[2 * side + part])
                squares[key] += float(np.sum((means - means.mean()) ** 2))
                freedom[key] += len(members) - 1
    raised = dict(noise)
    for key, count in freedom.items():
        if count >= _FEWEST_REPEATS:
            model = noise[key]
            modelled = float(model.density(np.zeros(1))[0])
            if (scatter := squares[key] / count) > modelled:
                raised[key] = replace(model, carrier=scatter - modelled)
    return raised


def _condition(r: RecordingEvidence) -> tuple[object, ...]:
    """Records of one condition repeat one another at their mean: the side band of an excitation does not reach it."""
    setpoints = r.recording.command.setpoints
    azimuth = round(float(np.angle(complex(*np.abs(r.signals.pick[:50]).mean(axis=0)))), 1)
    return (r.role, round(setpoints.amplitude_v, 6), round(setpoints.virtual_precession_v, 6), azimuth, setpoints.rebalance)


def _mean_line(r: RecordingEvidence, left: ComplexArray, part: int, side: int) -> float:
    value = left[side * (left.size // 2)]
    return float(value.real if part == 0 else value.imag)


def _from_residuals(evidence: CampaignEvidence, solution: Solution, noise: NoiseByRole, target: Sequence[ComplexArray]) -> NoiseByRole:
    lines: dict[tuple[str, str], list[NDArray[np.float64]]] = defaultdict(list)
    squares: dict[tuple[str, str], list[NDArray[np.float64]]] = defaultdict(list)
    freedom = np.clip(1.0 - np.sum(solution.basis**2, axis=1), 1e-9, 1.0)
    first = 0
    for k, r in enumerate(evidence):
        half, quiet = r.signal.lhs.size // 2, r.quiet.lhs.size // 2
        left = target[k] - np.stack([c.quiet[k] for c in solution.columns], axis=1) @ solution.values
        lowest = _MEAN_LINE / r.recording.duration_s
        for part in range(2):
            for side in range(2):
                key = (r.role, CHANNELS[2 * side + part])
                rows = slice(first + (2 * part + side) * half, first + (2 * part + side + 1) * half)
                f = r.signal.frequency_hz[:half]
                kept = freedom[rows] > _LEAST_FREEDOM
                lines[key].append(np.maximum(f[kept], lowest))
                squares[key].append((solution.residual[rows] ** 2 * noise[key].density(f) / freedom[rows])[kept])
                values = left[side * quiet : (side + 1) * quiet]
                lines[key].append(r.quiet.frequency_hz[:quiet])
                squares[key].append((values.real if part == 0 else values.imag) ** 2)
        first += 4 * half
    longest: dict[str, float] = defaultdict(float)
    for r in evidence:
        longest[r.role] = max(longest[r.role], r.recording.duration_s)
    found = {key: fit_noise(np.concatenate(lines[key]), np.concatenate(squares[key]), _MEAN_LINE / longest[key[0]]) for key in lines}
    parents = {r.role: r.parent_role for r in evidence}
    return {(role, channel): _not_below(model, found.get((parents[role], channel))) for (role, channel), model in found.items()}


def _not_below(model: NoiseModel, parent: NoiseModel | None) -> NoiseModel:
    if parent is None or parent is model:
        return model
    coefficients = tuple(max(a, b) for a, b in zip(model.coefficients, parent.coefficients, strict=True))
    return replace(model, coefficients=coefficients, walk=max(model.walk, parent.walk))
