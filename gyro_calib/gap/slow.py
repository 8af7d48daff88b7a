"""What moves slower than a recording: drives' stray volts and gains, the floors of rate and resonance, as slow cosines of flicker's sizes.

A 1/f floor does not end at the length of a record: the means of records that follow one another err alike, and a campaign of some minutes
sees it as a drift. Treated as independent from record to record it is taken for an effect of time. Half cosines ``cos(pi k t/T)`` of the
campaign's time T with variances ``s^2/k`` are a flicker noise to that order; the size s of each family is measured by the likelihood of its
coefficients (:mod:`.sizes`).

What is faster than those cosines and slower than a record stands in the noise of the records' means, where the wave rests. One that turns
past the electrodes meets it at its turning line instead: there each record has a drift of its own besides.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .column import Column
from .columns import part_columns
from .evidence import CampaignEvidence, RecordingEvidence
from .parts import SPLIT, Linear, Part

__all__ = ["MOST_WANDER", "drift_family", "slow_drifts"]

ComplexArray = NDArray[np.complex128]
#: half cosines of the campaign's time; families that stand still in the case, which a wave may turn past
_COSINES, _OF_CASE = 8, ("strayc", "strays", "gain", "phase")
#: how much larger cosines may be than the flicker that is measured
_ABOVE = 2.0
#: how far a resonance wanders between records at most, over its frequency: its millikelvins, which take minutes
MOST_WANDER = 5e-7


def _parts(r: RecordingEvidence, linear: Linear) -> list[Part]:
    """What drifts, one unit of it: stray volts of each drive by phase, relative gains, phases, rate, damping, frequency, split."""
    s = r.signals
    closed = complex(r.is_wave)
    unit = np.full((len(s.time_s), 2), closed)
    motion = s.pick - s.drive @ linear.E.T
    across = -closed * linear.reacting(motion)
    axes: list[ComplexArray] = [np.array([1.0 + 0j, 0.0]), np.array([0.0 + 0j, 1.0])]
    parts = []
    for axis, name in zip(axes, "xy", strict=True):
        parts += [Part(f"stray{phase}.{name}", "drive", factor * unit * axis) for phase, factor in (("c", 1.0), ("s", 1j))]
        parts += [Part(f"{what}.{name}", "drive", factor * s.drive * axis) for what, factor in (("gain", 1.0 + 0j), ("phase", 1j))]
    parts += [Part("rate.z", "flow", across), Part("damping.z", "flow", -motion), Part("frequency.z", "flow", 1j * closed * motion)]
    return parts + [Part(f"split.{name}", "flow", 1j * closed * (motion @ shape)) for name, shape in zip("cs", SPLIT, strict=True)]


def slow_drifts(evidence: CampaignEvidence, linear: Linear, flicker: float = 0.0, *, every: bool = False) -> list[Column]:
    """Slow cosines of everything that drifts, as large as they may be at most; named ``drift.family.axis.k``.

    And what stands still in the case in each recording whose wave turns past it: ``drift.family.axis.of_index``; gains and phases that
    flicker in every one. A pick-off's phase is one of its drive, the other way round.

    Parameters
    ----------
    evidence : CampaignEvidence
    linear : Linear
    flicker : float
        Density at 1 Hz of gains that flicker more than healthy ones [1/sqrt(Hz)]: their half cosines have variances of its square over k.
    every : bool
        Each recording's own also where the wave stands: what a floor, or a loop that locks anew, does from one to the next.
    """
    base = part_columns(evidence, [_parts(r, linear) for r in evidence], linear)
    times = np.array([float(r.signals.time_s.mean()) for r in evidence])
    phase = np.pi * (times - times.min()) / max(float(np.ptp(times)), 1.0)
    volts = float(np.median([np.sqrt(np.mean(np.sum(np.abs(r.signals.drive) ** 2, axis=1))) for r in evidence if r.is_wave]))
    flicker_of = {"gain": flicker, "phase": math.sqrt(max(evidence.phase_floors))}
    healthy = evidence.healthy
    largest = dict.fromkeys(("strayc", "strays"), healthy.stray_drift * volts)
    largest |= {
        "gain": max(healthy.gain_drift, _ABOVE * flicker_of["gain"]),
        "phase": max(healthy.phase_drift, _ABOVE * flicker_of["phase"]),
        "rate": healthy.rate_drift * evidence.decay_rate,
        "damping": healthy.damping_drift * evidence.decay_rate,
        "split": healthy.split_drift * evidence.decay_rate,
        "frequency": MOST_WANDER * evidence.omega0_rad_s,
    }
    columns = []
    for column in base:
        family = column.name.split(".")[0]
        for k in range(1, _COSINES + 1):
            shape = np.cos(k * phase)
            signal, quiet = (tuple(float(c) * v for c, v in zip(shape, of, strict=True)) for of in (column.signal, column.quiet))
            columns.append(Column(f"drift.{column.name}.{k}", signal, quiet, largest[family] / np.sqrt(k)))
        if family in _OF_CASE:
            columns += _of_recordings(evidence, column, largest[family], every=every or flicker_of.get(family, 0.0) > 0.0)
    return [c for c in columns if any(np.any(v) for v in c.signal)]


def _of_recordings(evidence: CampaignEvidence, column: Column, size: float, *, every: bool) -> list[Column]:
    """What a family does in each recording whose wave turns, or in ``every`` one: of the sum of 1/k, half of that between its cosines and
    the recording."""
    span_s = max(float(r.signals.time_s[-1]) for r in evidence) - min(float(r.signals.time_s[0]) for r in evidence)
    columns = []
    for k, r in enumerate(evidence):
        faster = 2.0 * span_s / (_COSINES * r.recording.duration_s)
        if (every or (r.is_wave and r.is_turning)) and faster > 1.0:
            signal, quiet = (tuple(v if j == k else np.zeros_like(v) for j, v in enumerate(of)) for of in (column.signal, column.quiet))
            columns.append(Column(f"drift.{column.name}.of_{r.index}", signal, quiet, size * math.sqrt(0.5 * math.log(faster))))
    return columns


def drift_family(c: Column) -> str:
    """Family of a drift, or "" of what is none: both axes of a kind drift alike."""
    return c.name.split(".")[1] if c.name.startswith("drift.") else ""
