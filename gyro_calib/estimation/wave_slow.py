"""Flicker of forces that do not follow the wave: one process over the whole campaign, seen from the frame of every recording.

Stray volts of the drives flicker. Within a recording that is noise at low lines; between recordings their means differ, the less the closer
they lie in time. Left out, or taken for independent of one another, it costs a fifth of what the recordings say, and the standard
deviations are no longer those of the scatter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..recording.recording import Recording
from .wave_projection import WaveProjected, in_wave_frame, slow_waves

__all__ = ["slow_forces"]

FloatArray = NDArray[np.float64]
#: points of a recording at which its slow waves are correlated with those of the others
_POINTS = 64
#: shortest correlation time [s], ratio of one to the next, longest over the campaign
_SHORTEST_S, _RATIO, _LONGEST = 0.25, 4.0, 4.0
#: variance of a source over the largest, below which it is left out
_LEAST = 1e-9


def slow_forces(recordings: Sequence[Recording], projected: Sequence[WaveProjected]) -> list[FloatArray]:
    """Factor L of the covariance ``L L^T`` that flicker of density ``1/f`` [1/Hz, two-sided] gives to the equations of each recording.

    A sum of Ornstein-Uhlenbeck processes whose correlation times are spread evenly in the logarithm; what is slower than the campaign is a
    constant, which is an unknown of its own. The same in real and imaginary parts and on both axes, independent of one another.

    Parameters
    ----------
    recordings : sequence of Recording
    projected : sequence of WaveProjected
        At the lines of interest, shape (2 m,) each.

    Returns
    -------
    list of ndarray, shape (2 m, q)
        Zero for open drive.
    """
    seen = [i for i, r in enumerate(recordings) if in_wave_frame(r)]
    if not seen:
        return [np.zeros((p.lhs.size, 0)) for p in projected]
    times, waves = zip(*(_sampled(recordings[i]) for i in seen), strict=True)
    time = np.concatenate(times)
    kernel = _flicker(np.abs(time[:, None] - time[None, :]), float(np.ptp(time)))
    # between the coefficients of all slow waves of all recordings
    ends = np.cumsum([0, *(len(t) for t in times)])
    between = np.block(
        [[a.T @ kernel[ends[i] : ends[i + 1], ends[j] : ends[j + 1]] @ b for j, b in enumerate(waves)] for i, a in enumerate(waves)]
    )
    values, vectors = np.linalg.eigh(between)
    kept = values > _LEAST * values[-1]
    factor = np.split(vectors[:, kept] * np.sqrt(values[kept]), len(seen))
    count = factor[0].shape[1]
    slow = [np.zeros((p.lhs.size, 2 * count)) for p in projected]
    for i, own in zip(seen, factor, strict=True):
        both = projected[i].slow.reshape(projected[i].lhs.size, 2, -1)
        slow[i] = np.concatenate([both[:, 0] @ own, both[:, 1] @ own], axis=1)
    return slow


def _sampled(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Times [s] of a few points, and the slow waves there times the time between points, so that products of them are integrals."""
    rows = len(recording)
    pick = np.linspace(0, rows - 1, min(_POINTS, rows)).round().astype(int)
    return recording.t[pick], slow_waves(recording)[0][pick] * recording.duration_s / pick.size


def _flicker(apart_s: FloatArray, span_s: float) -> FloatArray:
    """Autocovariance of flicker of unit two-sided coefficient, within a few decades below the span."""
    count = 1 + math.ceil(math.log(_LONGEST * max(span_s, 1.0) / _SHORTEST_S, _RATIO))
    total = np.zeros_like(apart_s)
    for k in range(count):
        total += np.exp(-apart_s / (_SHORTEST_S * _RATIO**k))
    # a sum of variances s^2 in ratio r has the two-sided density s^2 / (2 f ln r)
    return 2.0 * math.log(_RATIO) * total
