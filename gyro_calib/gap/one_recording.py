"""What goes with time or remembers must not be one recording's doing: a knock, a visitor, a loop not settled change that one alone.

A course of time that begins or ends a campaign is told by few recordings, most by the first: a clean ring whose first record's quadrature
lay five standard deviations from the others held a charge that was there after 25 s (40 in chi-square, 10 without that record). And a
ring-down of a healthy hemisphere that began before the wave had come to rest, 25 s after a ramp, was a bias that lags behind it (80, of
which the ramp itself told nothing) or what warmed drives do: all that differs at a record's beginning is a memory of what went before.
A mode beside the carrier has six sizes and follows the noise of one ring-down's lines (66, of which 11 are not that recording's); an open
drive next to it may well be the only one to tell it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..effects import EFFECTS
from .saturated import is_of_time
from .screen import Candidate, Screened, Screener

if TYPE_CHECKING:
    from .evidence import RecordingEvidence
    from .model import CampaignModel

__all__ = ["memories_of_several", "told_by_several"]

#: how the registry calls what lags, behind the temperature if it needs one; a mode of which waves tell, and open drives
_LAG, _MODE = "_lag", "spurious_mode"


def told_by_several(model: CampaignModel, found: Screened, others: Sequence[Candidate]) -> bool:
    """Whether an effect that goes with time, is late or rings is still likelier than none without the recording that tells most of it.

    Late behind the temperature, that is; and of such a lag that one may be all there is, if the temperature moves in it. What rings may be
    told by one open drive, and not by one wave.

    Parameters
    ----------
    model : CampaignModel
    found : Screened
    others : sequence of Candidate
        What else was found.
    """
    lags = found.name.endswith(_LAG) and "temperature" in EFFECTS[found.name].needs
    rings = found.name == _MODE
    if not (lags or rings or is_of_time(found.name)):
        return True
    for r in _loudest(model, found, model.screener_with(others)):
        alone = (lags and r.is_warming) or (rings and not r.is_wave)
        still = found if alone else model.seen_without((r.index,), found, others)
        if still is None or still.log_evidence <= 0.0:
            return False
    return True


def memories_of_several(
    model: CampaignModel, screener: Screener, found: Iterable[Screened], others: Sequence[Candidate]
) -> Iterator[Screened]:
    """Those unnamed memories that still are likelier than none without the recording that tells most of each.

    Parameters
    ----------
    model : CampaignModel
    screener : Screener
        Holds the others.
    found : iterable of Screened
    others : sequence of Candidate
    """
    without: dict[int, Screener] = {}
    for memory in found:
        cold = [r.index for r in _loudest(model, memory, screener) if not r.is_warming]
        without |= {index: model.without((index,), others) for index in cold if index not in without}
        still = (without[index].screen(memory.candidate) for index in cold)
        if all(s is not None and s.log_evidence > 0.0 for s in still):
            yield memory


def _loudest(model: CampaignModel, found: Screened, screener: Screener) -> list[RecordingEvidence]:
    """The recordings in which an effect does most, and in which it explains most: these are one, or two."""
    made = found.directions @ (found.directions.T @ screener.left)
    ends = np.cumsum([2 * r.signal.lhs.size for r in model.evidence])
    places = {
        int(np.argmax([float(part.sum()) for part in np.split(of_rows[: ends[-1]], ends[:-1])]))
        for of_rows in (made**2, made * screener.left)
    }
    return [model.evidence.recordings[k] for k in sorted(places)]
