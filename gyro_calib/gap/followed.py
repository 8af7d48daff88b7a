"""Where the resonance lay before anything had a name, and what an effect has to do with that.

The first fits give every recording a distance of its resonance from the reference and a slope of it, and all of them one course with the
temperature. That is where the resonance lay, whatever moved it; the column of E takes off what feeds through there, which does not
resonate. An effect that moves the resonance is therefore in that already: its force is one on the motion ``V - E u``, and would take off
again what feeds through. On a multiplexed hemisphere (E is half a millisecond of the drive) an ageing of 0.06 rad/s was 30 urad of phase of
the drives, twenty times what they are told to. How much of an effect the first fit took for a distance is what it makes of its column.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .evidence import CampaignEvidence, RecordingEvidence
from .parts import Linear
from .signals import Projector

if TYPE_CHECKING:
    from .system import Solution, Whitener

__all__ = ["Followed", "followed_by", "followed_of", "with_what_feeds"]

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

    def moved_by(self, signal: Sequence[ComplexArray]) -> dict[str, float]:
        """What a column at the signal's lines (by recording, turned) was taken for, by unknown."""
        return dict(zip(self.names, (self.answer @ self.whitener.rows(signal)).tolist(), strict=True))


def followed_by(r: RecordingEvidence, values: Mapping[str, float]) -> FloatArray:
    """Distance of the resonance of which these values say all that the first fits know [rad/s], shape (n,)."""
    return np.asarray(sum(values.get(name, 0.0) * course for name, course in _courses(r).items()))


def followed_of(evidence: CampaignEvidence, solution: Solution, whitener: Whitener, design: FloatArray) -> Followed:
    """Of a fit's solution, its weights and its design (equations, unknowns)."""
    known = {name for r in evidence for name in _courses(r)}
    places = [k for k, c in enumerate(solution.columns) if c.name in known]
    values = solution.by_name()
    return Followed(
        tuple(followed_by(r, values) for r in evidence),
        tuple(solution.columns[k].name for k in places),
        whitener,
        solution.covariance[places] @ design.T,
    )


def with_what_feeds(
    evidence: CampaignEvidence, linear: Linear, signal: Sequence[ComplexArray], quiet: Sequence[ComplexArray]
) -> tuple[tuple[ComplexArray, ...], tuple[ComplexArray, ...]]:
    """An effect's column with what feeds through where it moved the resonance; as it is where nothing is known of that.

    Parameters
    ----------
    evidence : CampaignEvidence
    linear : Linear
    signal, quiet : sequence of ndarray, complex
        By recording, turned by the wave's phase, with the force on the motion.
    """
    if linear.followed is None:
        return tuple(signal), tuple(quiet)
    moved = linear.followed.moved_by(signal)
    sizes = [np.array([moved.get(name, 0.0) for name in _courses(r)]) for r in evidence]
    return (
        tuple(x + _fed(r, r.signal_forms, linear) @ size for r, x, size in zip(evidence, signal, sizes, strict=True)),
        tuple(x + _fed(r, r.quiet_forms, linear) @ size for r, x, size in zip(evidence, quiet, sizes, strict=True)),
    )


def _courses(r: RecordingEvidence) -> dict[str, FloatArray]:
    """Courses in time that a distance of the resonance has in a recording, by the fit's unknown, shape (n,) each."""
    s = r.signals
    return {
        "frequency_per_k": s.temperature_k,
        "frequency_per_k2": s.temperature_k**2,
        f"shift_{r.index}": np.ones_like(s.time_s),
        f"slide_{r.index}": np.linspace(-1.0, 1.0, len(s.time_s)),
    }


def _fed(r: RecordingEvidence, projector: Projector, linear: Linear) -> ComplexArray:
    """Projections of ``i c E u``, c each course, turned by the wave's phase, shape (equations, courses)."""

    def made() -> ComplexArray:
        fed = 1j * (r.signals.drive @ linear.E.T)
        return np.asarray(r.turn * projector.plain([course[:, None] * fed for course in _courses(r).values()]))

    return r.signals.once(("fed", projector is r.quiet_forms), linear, made)
