"""Whether floors that are larger than they were measured explain what goes with time as well.

Floors are measured beside everything that goes with time, for an effect must not pass for one. So a campaign whose floor happens to move
along a straight line has it measured too small, and the line is an effect: stray volts of a clean ring (seed 2101, 48) were taken to be a
third of what they were, and their drift of six such sizes for a stiffness that moves. Both must be asked: the likelihood of larger floors
without the effect against its evidence beside small ones. A true drift is none of theirs: of the sixteen slow cosines of a family it moves
the first two alone, and floors as large as that would move the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from .saturated import effect_columns, is_of_time
from .screen import Candidate, Screened
from .sizes import gained_by_resizing
from .slow import drift_family, slow_drifts
from .system import solve

if TYPE_CHECKING:
    from .model import CampaignModel

__all__ = ["beat_their_floors", "louder_floors"]


def louder_floors(model: CampaignModel, others: Sequence[Candidate]) -> float:
    """Log likelihood that the slow drifts gain by being as large as they seem where nothing but ``others`` goes with time.

    Parameters
    ----------
    model : CampaignModel
    others : sequence of Candidate
        What was found besides.
    """
    largest = {c.name: c for c in slow_drifts(model.evidence, model.linear)}
    shares = {drift_family(c): c.prior_sd / largest[c.name].prior_sd for c in model.nuisances if c.name in largest}
    drifts = [c for c in largest.values() if drift_family(c) in shares]
    columns = [*(c for c in model.nuisances if not drift_family(c)), *drifts, *effect_columns(others)]
    solution = solve(columns, model.whitener.design(columns, len(model.evidence)), model.whitener.rows(model.target))
    return gained_by_resizing(solution, drift_family, shares)


def beat_their_floors(model: CampaignModel, effects: Sequence[Screened]) -> bool:
    """Whether those of the effects that need but time are likelier than larger floors; true where there are none."""
    of_time = sum(e.log_evidence for e in effects if is_of_time(e.name))
    others = [e.candidate for e in effects if not is_of_time(e.name)]
    return len(others) == len(effects) or of_time > louder_floors(model, others)
