"""Phases of the pick-offs that flicker: noise of a wave's frequency that rises with f, on the axis that it lies along.

A phase of density ``p^2 / f`` is one of ``(2 pi)^2 p^2 f`` of the frequency. The resonance that wanders falls with f, white noise of the
pick-offs rises with its square; that noise is as large in phase with the wave, where the amplitude's channel measures it, and what the
frequency has of it beyond that is white noise of the phases. A fit of few octaves takes one of these for the other, so that each costs
what a floor costs. Above a tenth of the rows' rate their filter bends all of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .flow_left import FlowLeft
from .noise_law import without_outliers
from .whittle import likeliest

__all__ = ["PHASE_FLICKERS", "phase_floors"]

FloatArray = NDArray[np.float64]
#: density of a phase at 1 Hz from which on it flickers more than a healthy one [rad/sqrt(Hz)]: the practice devices have 5e-6 at most
PHASE_FLICKERS = 1.2e-5
#: bins that are used: from this frequency and this bin on, below the share of the rows' rate, every second one, for a Hann window makes
#: neighbours alike; bins about harmonics of a side band that are its own
_LOWEST_HZ, _LOWEST_BIN, _PASSED, _EVERY, _SKIRT_BINS = 0.5, 3, 0.1, 2, 2.5
#: shortest record [s], fewest bins of all; what a floor must gain beyond the information criterion, twice the log likelihood
_SHORTEST_S, _FEWEST, _EXTRA = 2.0, 60, 6.0
#: what both axes, alike, or one or each by itself has: columns that it is made of
_OF_AXES = tuple(np.array(columns, dtype=float).reshape(-1, 2).T for columns in ((1, 1), (1, 0), (0, 1), (1, 0, 0, 1)))


def phase_floors(flows: Sequence[FlowLeft]) -> tuple[float, float]:
    """Floors of the x and y pick-offs' phases at 1 Hz [rad^2/Hz], 0 for an axis that has no more than a healthy one.

    Parameters
    ----------
    flows : sequence of FlowLeft
        What the linear device leaves of plain records.
    """
    standing = [flow for flow in flows if flow.stands and flow.duration_s >= _SHORTEST_S and flow.amplitude_v > 0.0]
    parts = [_bins(flow) for flow in standing]
    if sum(len(f) for f, _, _, _ in parts) < _FEWEST:
        return 0.0, 0.0
    f, axes = np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])
    along, rising = np.concatenate([p[2] for p in parts]), (2.0 * np.pi * f) ** 2
    volts = np.concatenate([np.full(len(p[0]), flow.amplitude_v) for p, flow in zip(parts, standing, strict=True)])
    white = axes * (rising / volts**2)[:, None]
    in_phase = likeliest(np.column_stack([np.ones_like(f), white]), np.concatenate([p[3] for p in parts]))[1:]
    own, known = np.column_stack([np.ones_like(f), f**-2.0]), white @ in_phase
    best, best_score = np.zeros(2), _surprise(own, along, known, 0)
    for of_phase, is_floor in ((white, False), (axes * (rising / f)[:, None], True)):
        for which in _OF_AXES:
            columns = np.hstack([own, of_phase @ which])
            score = _surprise(columns, along, known, which.shape[1])
            if score < best_score:
                best_score = score
                best = which @ likeliest(columns, along, known)[2:] if is_floor else np.zeros(2)
    best = np.where(best > PHASE_FLICKERS**2, best, 0.0)
    return float(best[0]), float(best[1])


def _bins(flow: FlowLeft) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Frequencies, shares of both axes in the noise there, and one-sided densities of frequency and amplitude [1/s^2/Hz] without lines."""
    n = len(flow.azimuth_rad)
    window = np.hanning(n)
    f = np.asarray(np.fft.rfftfreq(n, flow.row_s), dtype=np.float64)
    used = (f >= _LOWEST_HZ) & (f < _PASSED / flow.row_s)
    if flow.excited_hz > 0.0:
        harmonic = np.round(f / flow.excited_hz) * flow.excited_hz
        used &= np.abs(f - harmonic) * flow.duration_s > _SKIRT_BINS
    used &= (np.arange(f.size) >= _LOWEST_BIN) & (np.arange(f.size) % _EVERY == 0)
    cos2 = float(np.mean(np.cos(flow.azimuth_rad) ** 2))
    shares = np.tile([cos2**2, (1.0 - cos2) ** 2], (int(used.sum()), 1))
    factor = 2.0 * flow.row_s / float(np.sum(window**2))
    found = [factor * np.abs(np.fft.rfft(flow.rate[channel] * window)[used]) ** 2 for channel in ("frequency", "amplitude")]
    frequency, amplitude = (without_outliers(f[used], x) if x.size else x for x in found)
    return f[used], shares, frequency, amplitude


def _surprise(columns: FloatArray, squares: FloatArray, known: FloatArray, of_phase: int) -> float:
    """Twice the negative log likelihood of densities, each the mean of an exponential variable, with what the columns of a phase cost."""
    expected = np.maximum(columns @ likeliest(columns, squares, known) + known, 1e-300)
    return float(2.0 * np.sum(np.log(expected) + squares / expected)) + of_phase * (math.log(squares.size) + _EXTRA)
