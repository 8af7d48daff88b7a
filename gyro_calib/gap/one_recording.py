"""What goes with time must not be one recording's doing: a knock, a visitor, a loop that had not settled change that one alone.

A course of time that begins or ends a campaign is told by few recordings, most by the first: a clean ring whose first record's quadrature
lay five standard deviations from the others held a charge that was there after 25 s (40 in chi-square, 10 without that record).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .saturated import is_of_time
from .screen import Candidate, Screened

if TYPE_CHECKING:
    from .model import CampaignModel

__all__ = ["told_by_several"]


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
    made = found.directions @ (found.directions.T @ model.screener_with(others).left)
    ends = np.cumsum([2 * r.signal.lhs.size for r in model.evidence])
    loudest = int(np.argmax([float(part @ part) for part in np.split(made[: ends[-1]], ends[:-1])]))
    still = model.seen_without((model.evidence.recordings[loudest].index,), found, others)
    return still is not None and still.log_evidence > 0.0
