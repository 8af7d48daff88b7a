"""Real-coefficient columns of the campaign's equations: from the parts of a form to vectors over all equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .evidence import CampaignEvidence, RecordingEvidence
from .parts import SKEW, Form, Linear, Part, Setting
from .signals import Projector

__all__ = ["QUIET", "SIGNAL", "Column", "Place", "form_columns", "part_columns"]

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Place:
    """Where a set of equations lies: the signal's lines, or the quiet ones."""

    quiet: bool

    def projector(self, r: RecordingEvidence) -> Projector:
        """Projector of a recording's forms."""
        return r.quiet_forms if self.quiet else r.signal_forms


SIGNAL, QUIET = Place(False), Place(True)


@dataclass(frozen=True)
class Column:
    """One real unknown.

    Parameters
    ----------
    name : str
        Parameter.
    signal, quiet : tuple of ndarray, complex
        By recording, turned by the wave's phase: what one unit adds to the right of the slow flow at its lines.
    prior_sd : float
        How far the unknown is believed to lie from zero; infinite when nothing is known.
    """

    name: str
    signal: tuple[ComplexArray, ...]
    quiet: tuple[ComplexArray, ...]
    prior_sd: float = float("inf")


def form_columns(evidence: CampaignEvidence, form: Form, linear: Linear, setting: Setting, *, unlike: bool = False) -> list[Column]:
    """Columns of a form at a setting, one per parameter; ``unlike``: and what pick-offs that are not alike make of it."""
    by_recording = [
        [part for part in form.parts(r.signals, linear, setting) if unlike or not part.parameter.startswith(SKEW)] for r in evidence
    ]
    return part_columns(evidence, by_recording, linear)


def part_columns(evidence: CampaignEvidence, by_recording: Sequence[list[Part]], linear: Linear) -> list[Column]:
    """Columns of parts that every recording has in the same order; parts of one parameter are summed."""
    names = list(dict.fromkeys(part.parameter for part in by_recording[0]))
    vectors = {}
    for place in (SIGNAL, QUIET):
        by_name: dict[str, list[ComplexArray]] = {name: [] for name in names}
        for r, parts in zip(evidence, by_recording, strict=True):
            projector = place.projector(r)
            found = _projected(projector, parts, linear)
            for name in names:
                total = sum((v for part, v in zip(parts, found, strict=True) if part.parameter == name), np.zeros(1, dtype=complex))
                by_name[name].append(r.turn * total)
        vectors[place.quiet] = by_name
    return [Column(name, tuple(vectors[False][name]), tuple(vectors[True][name])) for name in names]


def _projected(projector: Projector, parts: list[Part], linear: Linear) -> list[ComplexArray]:
    """What each part adds to the right: plain, G u, or L[V] - A V, with A at the temperature and rate of the moment."""
    flow = []
    for part in parts:
        if part.kind == "flow":
            flow.append(part.signal)
        elif part.kind == "drive":
            flow.append(part.signal @ linear.G.T)
        elif part.speed is not None:
            flow.append(part.speed - linear.resting(projector.signals, part.signal))
        else:
            flow.append(-linear.acting(projector.signals, part.signal))
    out = list(projector.plain(np.stack(flow, axis=1)).T)
    outputs = [k for k, part in enumerate(parts) if part.kind == "output" and part.speed is None]
    if outputs:
        through = projector.through_flow(np.stack([parts[k].signal for k in outputs], axis=1))
        for column, k in zip(through.T, outputs, strict=True):
            out[k] = out[k] + column
    return out
