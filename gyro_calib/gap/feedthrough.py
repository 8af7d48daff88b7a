"""What feeds through where an effect moved the resonance goes back into that effect's column (why: :mod:`.followed`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .evidence import CampaignEvidence, RecordingEvidence
from .followed import course_names, resonance_courses
from .parts import Linear
from .signals import Projector

__all__ = ["with_what_feeds"]

ComplexArray = NDArray[np.complex128]


def with_what_feeds(
    evidence: CampaignEvidence, linear: Linear, signal: Sequence[ComplexArray], quiet: Sequence[ComplexArray]
) -> tuple[tuple[ComplexArray, ...], tuple[ComplexArray, ...]]:
    """Effects' columns with what feeds through where they moved the resonance; as they are where nothing is known of that.

    Parameters
    ----------
    evidence : CampaignEvidence
    linear : Linear
    signal, quiet : sequence of ndarray, complex
        By recording, shape (m, k), turned by the wave's phase, with the force on the motion.
    """
    if linear.followed is None:
        return tuple(signal), tuple(quiet)
    moved = linear.followed.moved_by(signal)
    still = np.zeros(signal[0].shape[1])
    sizes = [np.array([moved.get(name, still) for name in course_names(r)]) for r in evidence]
    return (
        tuple(x + _fed(r, r.signal_forms, linear) @ size for r, x, size in zip(evidence, signal, sizes, strict=True)),
        tuple(x + _fed(r, r.quiet_forms, linear) @ size for r, x, size in zip(evidence, quiet, sizes, strict=True)),
    )


def _fed(r: RecordingEvidence, projector: Projector, linear: Linear) -> ComplexArray:
    """Projections of ``i c E u``, c each course, turned by the wave's phase, shape (equations, courses)."""

    def made() -> ComplexArray:
        fed = 1j * (r.signals.drive @ linear.E.T)
        return np.asarray(r.turn * projector.plain([course[:, None] * fed for course in resonance_courses(r).values()]))

    return r.signals.once(("fed", projector is r.quiet_forms), linear, made)
