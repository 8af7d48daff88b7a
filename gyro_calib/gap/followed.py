"""Where the resonance lay before anything had a name, and what an effect has to do with that.

The first fits give every recording a distance of its resonance from the reference and a slope of it, and all of them one course with the
temperature. That is where the resonance lay, whatever moved it; the column of E takes off what feeds through there, which does not
resonate. An effect that moves the resonance is therefore in that already: its force is one on the motion ``V - E u``, and would take off
again what feeds through. On a multiplexed hemisphere (E is half a millisecond of the drive) an ageing of 0.06 rad/s was 30 urad of phase of
the drives, twenty times what they are told to. How much of an effect the first fit took for a distance is what it makes of its column.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from .evidence import CampaignEvidence, RecordingEvidence
from .system import Solution, Whitener

__all__ = ["Followed", "course_names", "followed_by", "followed_of", "resonance_courses"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Followed:
    """Distances that a fit found.

    Parameters
    ----------
    rad_s : tuple of ndarray, shape (n,) each
        By recording and row, how far the resonance lay from the frequency of reference.
    names : tuple of str
        The fit's unknowns that say so.
    whitener : Whitener
        Weights of that fit.
    answer : ndarray, shape (names, equations)
        What it makes of weighed equations.
    """

    rad_s: tuple[FloatArray, ...]
    names: tuple[str, ...]
    whitener: Whitener = field(repr=False)
    answer: FloatArray = field(repr=False)

    def with_wander(self, rad_s: Sequence[FloatArray]) -> Followed:
        """The same, with what wandered within recordings besides [rad/s]."""
        return replace(self, rad_s=tuple(a + b for a, b in zip(self.rad_s, rad_s, strict=True)))

    def moved_by(self, signal: Sequence[ComplexArray]) -> dict[str, FloatArray]:
        """What columns at the signal's lines (by recording (m, k), turned) were taken for, shape (k,) by unknown."""
        return dict(zip(self.names, self.answer @ self.whitener.rows(signal), strict=True))


def followed_by(r: RecordingEvidence, values: Mapping[str, float]) -> FloatArray:
    """Distance of the resonance of which these values say all that the first fits know [rad/s], shape (n,)."""
    return np.asarray(sum(values.get(name, 0.0) * course for name, course in resonance_courses(r).items()))


def followed_of(evidence: CampaignEvidence, solution: Solution, whitener: Whitener, design: FloatArray) -> Followed:
    """Of a fit's solution, its weights and its design (equations, unknowns)."""
    known = {name for r in evidence for name in course_names(r)}
    places = [k for k, c in enumerate(solution.columns) if c.name in known]
    values = solution.by_name()
    return Followed(
        tuple(followed_by(r, values) for r in evidence),
        tuple(solution.columns[k].name for k in places),
        whitener,
        solution.covariance[places] @ design.T,
    )


def resonance_courses(r: RecordingEvidence) -> dict[str, FloatArray]:
    """Courses in time that a distance of the resonance has in a recording, by the fit's unknown, shape (n,) each."""
    s = r.signals
    courses = s.temperature_k, s.temperature_k**2, np.ones_like(s.time_s), np.linspace(-1.0, 1.0, len(s.time_s))
    return dict(zip(course_names(r), courses, strict=True))


def course_names(r: RecordingEvidence) -> tuple[str, str, str, str]:
    """The fit's unknowns of these courses."""
    return "frequency_per_k", "frequency_per_k2", f"shift_{r.index}", f"slide_{r.index}"
