"""What turned recordings show must be there without them: a table does things besides its log."""

from __future__ import annotations

from collections.abc import Sequence

from ..effects import EFFECTS
from .model import CampaignModel
from .screen import Screened
from .strangers import MARGIN

__all__ = ["seen_at_rest"]

#: log evidence that turned recordings may add to an effect that has nothing to do with rate and stands at the margin
_TURNED = 1.0
#: chi-square that the others give for an effect of the size that all recordings say: three standard deviations
_SAME_SIZE = 9.0


def seen_at_rest(model: CampaignModel, effects: Sequence[Screened], found: Screened) -> bool:
    """Whether an effect that has nothing to do with rate counts without the recordings that were turned, or they hardly tell of it.

    Or the others want it of the same size: a delay of pick-offs tilts a turning wave, and a table turns it ten times as fast as drives do.
    For what a table makes of its own they are the worse.
    """
    if "rate" in EFFECTS[found.name].needs:
        return True
    others = [e.candidate for e in effects if e is not found]
    still = model.at_rest(found, others)
    if still is None:
        return False
    return still.log_evidence > min(MARGIN, found.log_evidence - _TURNED) or model.taken_at_rest(found, others) > _SAME_SIZE
