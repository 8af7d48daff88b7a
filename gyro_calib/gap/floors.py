"""Whether floors explain what goes with time, and whether what goes with time explains the floors.

Floors are measured beside everything that goes with time, for an effect must not pass for one. So a campaign whose floor happens to move
along a straight line has it measured too small, and the line is an effect: stray volts of a clean ring (seed 2101, 48) were taken to be a
third of what they were, and their drift of six such sizes for a stiffness that moves. Both must be asked: the likelihood of larger floors
without the effect against its evidence beside small ones. A true drift is none of theirs: of the sixteen slow cosines of a family it moves
the first two alone, and floors as large as that would move the others; and each recording by itself: gains that were 2e-6 apart from one to
the next, without a drift, were a walk of a pick-off of a healthy ring (88 in chi-square).

And a gain that steps once is a sum of slow cosines, so a family whose size the data tell grows until it holds the step: a drive of the
practice hemisphere that had one of 20 times the noise was a floor ten times as large. So a course of time is asked beside floors of the
size that they have with it. And so is what goes from record to record as where the resonance lies does: a clean ring (trial 5801/26) was
left half its wander by what vibration warms, which took 87 of chi-square beside that half.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .column import Column
from .courses import Courses
from .saturated import effect_columns, is_of_time
from .screen import Candidate, Screened, Screener, worth
from .sizes import Family, gained_by_resizing, gained_by_sizing
from .slow import MOST_WANDER, drift_family, slow_drifts
from .system import Whitener, solve

if TYPE_CHECKING:
    from .model import CampaignModel

__all__ = ["beat_their_floors", "beside_wander", "course_beside_floors", "hidden_by_floors", "louder_floors"]

#: log evidence of a course of time against floors alone: what any effect must have, and the choice among its places
_MARGIN = 12.0
#: log evidence of effects of time beside larger floors against larger floors alone: one in twenty of some twenty such effects
_LIKELIER = 6.0
#: floors beside which effects are looked for that may have made them, over their size; how many are tried, and found at most
_QUIETER, _TRIED, _FOUND = 0.1, 4, 2
#: share of what an effect is likelier by that it must have beside floors of the measured size: with less it is hidden
_SEEN = 0.7


def louder_floors(model: CampaignModel, others: Sequence[Candidate]) -> float:
    """Log likelihood that the slow drifts gain by being as large as they seem where nothing but ``others`` goes with time.

    Parameters
    ----------
    model : CampaignModel
    others : sequence of Candidate
        What was found besides.
    """
    largest = {c.name: c for c in slow_drifts(model.evidence, model.linear, every=True)}
    shares = {drift_family(c): c.prior_sd / largest[c.name].prior_sd for c in model.nuisances if c.name in largest}
    drifts = [c for c in largest.values() if drift_family(c) in shares]
    columns = [*(c for c in model.nuisances if not drift_family(c)), *drifts, *effect_columns(others)]
    solution = solve(columns, model.whitener.design(columns, len(model.evidence)), model.whitener.rows(model.target))
    return gained_by_resizing(solution, drift_family, shares)


def beat_their_floors(model: CampaignModel, effects: Sequence[Screened]) -> bool:
    """Whether those of the effects that need but time are likelier than larger floors; true where there are none.

    Floors are never quite as large as they seem, with the effects or without: where the effects alone do not reach what larger floors gain,
    what these gain beside the effects counts as well, and the effects must be likelier by far.
    """
    of_time = sum(e.log_evidence for e in effects if is_of_time(e.name))
    others = [e.candidate for e in effects if not is_of_time(e.name)]
    if len(others) == len(effects):
        return True
    left = of_time - louder_floors(model, others)
    return left > 0.0 or left + louder_floors(model, [e.candidate for e in effects]) > _LIKELIER


def course_beside_floors(
    courses: Courses, whitener: Whitener, target: Sequence[NDArray[np.complex128]], nuisances: Sequence[Column], drifts: Sequence[Column]
) -> Candidate | None:
    """The course of time that is likelier, with floors as large as they are beside it, than floors alone are.

    Parameters
    ----------
    courses : Courses
    whitener : Whitener
    target : sequence of ndarray, complex
        Left-hand sides by recording.
    nuisances : sequence of Column
        Drifts among them are left out.
    drifts : sequence of Column
        Floors at their largest.
    """
    steady = [c for c in nuisances if not drift_family(c)]
    course = courses.best(Screener(whitener, steady, target), whitener)
    if course is None or course[0].gain < 2.0 * _MARGIN:
        return None
    likelier = _likelier_than_floors(whitener, target, steady, drifts, [course[0]])
    return None if likelier is None else likelier[0]


def hidden_by_floors(
    candidates: Iterable[Candidate],
    whitener: Whitener,
    target: Sequence[NDArray[np.complex128]],
    nuisances: Sequence[Column],
    drifts: Sequence[Column],
) -> list[Candidate]:
    """Effects that are likelier, with floors as large as they are beside them, than floors alone, where these floors hide one; or none.

    Two amplitudes held one after the other tell a damping that grows with amplitude from one that drifts only by how large the drift is,
    and what grows makes it large: on a hemisphere of another plant 19 of log evidence, of which floors of the size without it left 3.

    Parameters
    ----------
    candidates : iterable of Candidate
    whitener : Whitener
    target : sequence of ndarray, complex
        Left-hand sides by recording.
    nuisances : sequence of Column
        Drifts among them at the sizes that were measured.
    drifts : sequence of Column
        Floors at their largest.
    """
    families = {drift_family(c) for c in nuisances}
    largest = [c for c in drifts if drift_family(c) in families]
    pool, found, hidden = list(candidates), list[Candidate](), False
    for _ in range(_FOUND):
        held = [*nuisances, *effect_columns(found)]
        quieter = [replace(c, prior_sd=_QUIETER * c.prior_sd) if drift_family(c) else c for c in held]
        seen = [s for s in Screener(whitener, quieter, target).screened(pool) if s.gain > 2.0 * _MARGIN]
        seen.sort(key=lambda s: -s.log_evidence)
        best = _likelier_than_floors(whitener, target, [c for c in held if not drift_family(c)], largest, seen[:_TRIED])
        if best is None:
            break
        effect, gain = best
        now = Screener(whitener, held, target).screen(effect)
        hidden = hidden or now is None or now.log_evidence < _SEEN * gain
        found.append(effect)
        pool = [c for c in pool if c.name != effect.name]
    return found if hidden else []


def _likelier_than_floors(
    whitener: Whitener,
    target: Sequence[NDArray[np.complex128]],
    steady: Sequence[Column],
    drifts: Sequence[Column],
    tried: Sequence[Screened],
) -> tuple[Candidate, float] | None:
    """The likeliest of some effects beside floors, and by how much it is likelier than these alone."""
    if not tried:
        return None
    alone = _likelihood(whitener, target, steady, drifts, drift_family)
    gains = []
    for s in tried:
        beside = _likelihood(whitener, target, [*steady, *effect_columns([s.candidate])], drifts, drift_family)
        gains.append(beside - alone + worth(0.0, s.rank, s.candidate.choices))
    best = int(np.argmax(gains))
    return (tried[best].candidate, gains[best]) if gains[best] > _MARGIN else None


def beside_wander(model: CampaignModel, others: Sequence[Candidate], found: Screened) -> float:
    """Chi-square that an effect takes away beside a wander from record to record as large as it is with it, over one as it is without.

    Parameters
    ----------
    model : CampaignModel
    others : sequence of Candidate
        What was found besides.
    found : Screened
    """
    most = MOST_WANDER * model.evidence.omega0_rad_s
    waves = {f"shift_{r.index}" for r in model.evidence if r.is_wave}
    shifts = [replace(c, prior_sd=most) for c in model.nuisances if c.name in waves]
    held = [*(c for c in model.nuisances if c.name not in waves), *effect_columns(others)]
    free = [replace(c, prior_sd=np.inf) for c in found.candidate.columns]

    def family(c: Column) -> str:
        return "shift" if c.name in waves else ""

    alone, beside = (_likelihood(model.whitener, model.target, [*held, *more], shifts, family) for more in ([], free))
    return 2.0 * (beside - alone)


def _likelihood(
    whitener: Whitener, target: Sequence[NDArray[np.complex128]], columns: Sequence[Column], drifts: Sequence[Column], family: Family
) -> float:
    """Log likelihood of columns beside a family of drifts of the size that is likeliest with them."""
    whole = [*columns, *drifts]
    solution = solve(whole, whitener.design(whole, len(target)), whitener.rows(target))
    return gained_by_sizing(solution, family) - 0.5 * Screener(whitener, columns, target).chi2
