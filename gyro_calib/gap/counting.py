"""Whether an effect counts: against none, beside a louder one, and where all recordings are louder than their noise."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..effects import EFFECTS
from .model import CampaignModel
from .screen import Candidate, Screened
from .strangers import LEAST_GAIN, MARGIN, SECOND_ORDER, bank_terms, worth_of

__all__ = ["beyond_complete", "completes", "enough", "stands"]

#: of what first order leaves of an effect, the share that goes with what its own form knows nothing of: time, temperature, rate
_OF_OTHERS = 0.1
#: and of all that is left beside it: where another effect was still missing such forms had 0.13 at most
_OF_THE_REST = 0.15
#: and of all that is left, what so much of it is of one other effect: of a Duffing of 1e8 in chi-square 1e3 were left, all of them a cubic
#: damping's, and what forms of first order leave is of many
_ALL_OF_THE_REST = 0.8
#: and of all that is left, what so much of it is where nothing counts beside it any more
_MOST_OF_THE_REST = 0.5
#: chi-square over the degrees of freedom that a complete model leaves: noise is taken for larger than it is by as much as that
_COMPLETE = 0.8


def enough(found: Screened, largest: Screened | None = None, rest: float = math.inf) -> bool:
    """Whether an effect counts beside the loudest: what the first order of averaging leaves of that one is no effect.

    Parameters
    ----------
    found : Screened
    largest : Screened or None
        The loudest effect, if there is another.
    rest : float
        Chi-square that is left without it beside what else was found, from :func:`beyond_complete`.
    """
    left = 0.0 if largest is None else SECOND_ORDER * largest.gain
    moved_by, loudest_by = _moved_by(found.name), set() if largest is None else _moved_by(largest.name)
    if moved_by != loudest_by and not moved_by & loudest_by:
        # experiments are in a drawn order, and most of them cold and at rest: little of what is static is seen in what is not, or of
        # what is not in what is static
        left = min(_OF_OTHERS * left, _OF_THE_REST * rest)
    left = min(left, _ALL_OF_THE_REST * rest)
    return found.log_evidence > MARGIN and found.gain > max(LEAST_GAIN, left)


def completes(model: CampaignModel, chosen: Sequence[Candidate], found: Screened, rest: float) -> bool:
    """Whether an effect is most of what is left beside a louder one, and nothing counts beside both, named or not.

    What forms of first order leave is of many. Of an unequal Duffing of 8e5 in chi-square a soft limit of the drives was left, 632 and
    right in size, which is not 0.8 of the rest: the noise of hemispheres is not taken for so much larger than it is.

    Parameters
    ----------
    model : CampaignModel
    chosen : sequence of Candidate
        All effects, this one among them.
    found : Screened
        It, beside the others.
    rest : float
        Chi-square that is left without it beside the others, from :func:`beyond_complete`.
    """
    if found.log_evidence <= MARGIN or found.gain <= max(LEAST_GAIN, _MOST_OF_THE_REST * rest):
        return False
    screener = model.screener_with(chosen)
    taken = {c.name for c in chosen}
    named = (c for name, tried in model.candidates.items() if name not in taken for c in tried)
    if any(s.log_evidence > MARGIN for s in screener.screened(named)):
        return False
    return all(worth_of(s) <= MARGIN for s, _ in bank_terms(model, screener, chosen))


def beyond_complete(chi2: float, dof: int) -> float:
    """Chi-square that effects leave beyond what a complete model would, at least 0."""
    return max(chi2 - _COMPLETE * dof, 0.0)


def stands(found: Screened, louder: float) -> bool:
    """Whether an effect counts where all recordings hold so much more power than the noise: that noise was measured too low."""
    return louder <= 1.0 or found.log_evidence - 0.5 * found.gain * (1.0 - 1.0 / louder) > MARGIN


def _moved_by(name: str) -> set[str]:
    """What moves an effect besides the motion itself; what is late behind the temperature is still while that is."""
    moved_by = {"time", "temperature", "rate"} & set(EFFECTS[name].needs)
    return moved_by - {"time"} if "temperature" in moved_by else moved_by
