"""Real-coefficient columns of the campaign's equations: from the parts of a form to vectors over all equations."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .column import Column
from .evidence import CampaignEvidence, RecordingEvidence
from .feedthrough import with_what_feeds
from .parts import REST, SKEW, Form, Linear, Part, Setting
from .signals import Projector, Signals

__all__ = ["QUIET", "SIGNAL", "Place", "form_columns", "forms_columns", "part_columns"]

ComplexArray = NDArray[np.complex128]
#: place of a form among several, and a parameter
Key = tuple[int, str]


@dataclass(frozen=True)
class Place:
    """Where a set of equations lies: the signal's lines, or the quiet ones."""

    quiet: bool

    def projector(self, r: RecordingEvidence) -> Projector:
        """Projector of a recording's forms."""
        return r.quiet_forms if self.quiet else r.signal_forms


SIGNAL, QUIET = Place(False), Place(True)


def form_columns(evidence: CampaignEvidence, form: Form, linear: Linear, setting: Setting, *, unlike: bool = False) -> list[Column]:
    """Columns of a form at a setting, one per parameter; ``unlike``: and what pick-offs that are not alike make of it."""
    return forms_columns(evidence, [(form, setting)], linear, unlike=unlike)[0]


def forms_columns(
    evidence: CampaignEvidence,
    forms: Sequence[tuple[Form, Setting]],
    linear: Linear,
    on_progress: Callable[[float], None] | None = None,
    *,
    unlike: bool = False,
) -> list[list[Column]]:
    """Columns of many forms at their settings; a recording's are projected all at once.

    Parameters
    ----------
    evidence : CampaignEvidence
    forms : sequence of (Form, Setting)
    linear : Linear
    on_progress : callable, optional
        Called with the fraction done.
    unlike : bool
        With what pick-offs that are not alike make of them; that of an axis at rest (:data:`~.parts.REST`) is always there.
    """

    def parts_of(r: RecordingEvidence) -> list[tuple[Key, Part]]:
        if on_progress is not None:
            on_progress(r.index / len(evidence))
        made = ((k, part) for k, (form, setting) in enumerate(forms) for part in form.parts(r.signals, linear, setting))
        return [
            ((k, part.parameter), part)
            for k, part in made
            if unlike or not part.parameter.startswith(SKEW) or part.parameter.startswith(REST)
        ]

    columns: list[list[Column]] = [[] for _ in forms]
    for (k, _), column in _columns(evidence, map(parts_of, evidence), linear).items():
        columns[k].append(column)
    return columns


def part_columns(evidence: CampaignEvidence, by_recording: Sequence[list[Part]], linear: Linear) -> list[Column]:
    """Columns of parts that every recording has in the same order; parts of one parameter are summed."""
    return list(_columns(evidence, ([((0, part.parameter), part) for part in parts] for parts in by_recording), linear).values())


def _columns(evidence: CampaignEvidence, by_recording: Iterable[list[tuple[Key, Part]]], linear: Linear) -> dict[Key, Column]:
    """Columns by form and parameter; one recording's parts are in memory at a time."""
    vectors: tuple[dict[Key, list[ComplexArray]], ...] = ({}, {})
    for r, keyed in zip(evidence, by_recording, strict=True):
        parts = [part for _, part in keyed]
        added = [_added(r.signals, part, linear) for part in parts]
        for place, by_key in zip((SIGNAL, QUIET), vectors, strict=True):
            totals: dict[Key, ComplexArray] = {}
            for (key, _), found in zip(keyed, _projected(place.projector(r), parts, added), strict=True):
                totals[key] = totals[key] + found if key in totals else found
            for key, total in totals.items():
                by_key.setdefault(key, []).append(r.turn * total)
    if not vectors[0]:
        return {}
    side_by_side = ([np.stack(of_all, axis=1) for of_all in zip(*by_key.values(), strict=True)] for by_key in vectors)
    signal, quiet = with_what_feeds(evidence, linear, *side_by_side)
    return {
        key: Column(key[1], tuple(x[:, k].copy() for x in signal), tuple(x[:, k].copy() for x in quiet)) for k, key in enumerate(vectors[0])
    }


def _added(s: Signals, part: Part, linear: Linear) -> ComplexArray:
    """What a part adds to the right: plain, G u, or of L[V] - A V, with A at the temperature and rate of the moment, all but L[V]."""
    if part.kind == "flow":
        return part.signal
    if part.kind == "drive":
        return np.asarray(part.signal @ linear.G.T)
    if part.speed is not None:
        return np.asarray(part.speed - linear.resting(s, part.signal))
    return -linear.acting(s, part.signal)


def _projected(projector: Projector, parts: Sequence[Part], added: Sequence[ComplexArray]) -> list[ComplexArray]:
    """Projections of what each part adds; one that does not act in a recording takes no time."""
    acting = [k for k, signal in enumerate(added) if np.any(signal)]
    out = [np.zeros(2 * len(projector.value), complex)] * len(parts)
    for k, column in zip(acting, projector.plain([added[k] for k in acting]).T if acting else (), strict=True):
        out[k] = column
    outputs = [k for k, part in enumerate(parts) if part.kind == "output" and part.speed is None and np.any(part.signal)]
    if outputs:
        for column, k in zip(projector.through_flow([parts[k].signal for k in outputs]).T, outputs, strict=True):
            out[k] = out[k] + column
    return out
