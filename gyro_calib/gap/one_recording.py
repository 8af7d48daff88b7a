"""What goes with time must not be one recording's doing: a knock, a visitor, a loop that had not settled change that one alone.

A course of time that begins or ends a campaign is told by few recordings, most by the first: a clean ring whose first record's quadrature
lay five standard deviations from the others held a charge that was there after 25 s (40 in chi-square, 10 without that record).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..recording.applied_rate import is_turned
from .saturated import is_of_time
from .screen import Candidate, Screened

if TYPE_CHECKING:
    from .model import CampaignModel

__all__ = ["told_by_several", "turned_alike"]

#: fewest turned recordings that confirm one another, and chi-square beyond which no table does such a thing
_TURNED, _NO_TABLE = 2, 100.0


def told_by_several(model: CampaignModel, found: Screened, others: Sequence[Candidate]) -> bool:
    """Whether an effect that goes with time is still likelier than none without the recording that tells most of it.

    Parameters
    ----------
    model : CampaignModel
    found : Screened
    others : sequence of Candidate
        What else was found.
    """
    if not is_of_time(found.name):
        return True
    still = model.seen_without((_loudest(model, found, others),), found, others)
    return still is not None and still.log_evidence > 0.0


def turned_alike(model: CampaignModel, found: Screened, others: Sequence[Candidate]) -> bool:
    """Whether something unnamed that goes with rate is likelier than none without the turned recording that tells most of it.

    A table does things besides its log, this time and not the next: two of a clean hemisphere held 35 and 6 of chi-square of one crossed
    rate. What one recording alone could say so loudly that no table does it, that one may.
    """
    turned = [r for r in model.evidence if is_turned(r.recording)]
    if len(turned) < _TURNED or found.gain > _NO_TABLE:
        return True
    still = model.seen_without((_loudest(model, found, others),), found, others)
    return still is not None and still.log_evidence > 0.0


def _loudest(model: CampaignModel, found: Screened, others: Sequence[Candidate]) -> int:
    """Index of the recording that holds most of what was found."""
    made = found.directions @ (found.directions.T @ model.screener_with(others).left)
    ends = np.cumsum([2 * r.signal.lhs.size for r in model.evidence])
    loudest = int(np.argmax([float(part @ part) for part in np.split(made[: ends[-1]], ends[:-1])]))
    return model.evidence.recordings[loudest].index
