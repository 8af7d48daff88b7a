"""Something that is not in the registry: the unnamed term that shows in what the registry leaves, and whether it counts."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .anonymous import HEATED, LOCATIONS, Anonymous
from .drifts import walks_in
from .floors import beside_wander, louder_floors
from .kin import nearest_known
from .model import CampaignModel
from .monomials import remembers
from .one_recording import memories_of_several
from .parts import SKEW
from .screen import Candidate, Screened, Screener, worth

__all__ = [
    "BANK_MARGIN",
    "CHANGES",
    "LEAST_GAIN",
    "LEFT_SHARE",
    "LEFT_SIGMA",
    "MARGIN",
    "SECOND_ORDER",
    "Stranger",
    "bank_terms",
    "cancel",
    "one_change_of_another_kind",
    "own_directions",
    "stranger",
    "unnamed_counts",
    "unnamed_rest",
    "worth_of",
]

#: least log evidence and chi-square of an effect that is taken up: seven false alarms of clean trials lay between 11.1 and 11.6, of 62
#: effects found in three mixed trials one (of SNR 4) below 12.7
MARGIN, LEAST_GAIN = 12.0, 25.0
#: a share of the gap that is left after the best set, from which on something is missing from the catalogue; and its significance
LEFT_SHARE, LEFT_SIGMA = 0.04, 6.0
#: a share of what effects take that an unnamed term takes beside them, from which on it is no more what first order leaves: right names
#: of SNR 100 to 400 left 0.0023 at most; soft knees and a hysteresis left 0.015 to 0.03 of three names
_BESIDE_SHARE = 0.01
#: a share of what effects take from which on an unnamed term is what they are
_AS_MUCH = 0.9
#: log evidence that some two hundred anonymous terms may reach by chance beyond what fifty named ones do, and chi-square
BANK_MARGIN, _BANK_GAIN = 3.0, 39.0
#: share of an effect's gain that its form, of first order, may leave
SECOND_ORDER = 0.005
#: standard deviations beyond which a size is larger than another
_SURELY = 3.0
#: how much better an anonymous term must be than any one effect of the registry; several that it does better than are that term
_BETTER = 12.0
#: and what goes with time beyond those: a 1/f floor swings so, up to a log evidence of 13 in 24 healthy campaigns, 18 in another
_COURSE_MARGIN = 10.0

#: properties and their changes with time and temperature that the registry knows: a device has one of them or two, not three; what bends
#: and delays a drive (a stage that warms itself does both); and what lags behind the temperature, for if three properties do one thing
#: makes them
CHANGES = (
    {"split_drift", "charge_accumulation", "thermal_split", "thermal_split_curvature", "thermal_split_lag"},
    {"damping_drift", "thermal_damping", "thermal_damping_curvature", "thermal_damping_lag", "thermal_damping_anisotropy_lag"},
    {"drive_gain_drift", "thermal_drive_gain", "thermal_drive_gain_curvature", "thermal_drive_gain_lag"},
    {"pickoff_gain_drift", "thermal_pickoff_gain", "thermal_pickoff_gain_curvature", "thermal_pickoff_gain_lag"},
    {"frequency_ageing", "thermal_frequency_curvature", "thermal_lag", "thermal_frequency_lag"},
    {"feedthrough_drift", "cross_feedthrough_drift", "thermal_feedthrough"},
    {"bias_drift", "thermal_bias", "thermal_bias_lag"},
    {"drive_nonlinearity", "drive_amplitude_phase", "drive_sag", "drive_saturation", "drive_dead_zone", "drive_memory", "pickoff_memory"},
    {
        "thermal_lag",
        "thermal_frequency_lag",
        "thermal_damping_lag",
        "thermal_damping_anisotropy_lag",
        "thermal_split_lag",
        "thermal_bias_lag",
        "thermal_drive_gain_lag",
        "thermal_pickoff_gain_lag",
    },
)
#: what two effects leave of each other over the smaller, below which they are one thing
_REST = 0.05
#: what is one where both are there: a late damping is late along its axes as well
_ONE_OF = {"thermal_damping_anisotropy_lag": "thermal_damping_lag"}
#: where the first of these stand
_PLACES = (("dynamics", "in quadrature"), ("dynamics", "in phase"), ("drive", "in phase"), ("pick-off", "in phase"))
#: so many effects, each of which takes that share of all that they take: a device with three at once is rarer than one that has another
_TOO_MANY, _OF_THREE = 3, 0.05


@dataclass(frozen=True)
class Stranger:
    """Something that is not in the registry.

    Parameters
    ----------
    term : Anonymous
        The anonymous term that closes most of the gap.
    screened : Screened
    nearest : str
        Effect of the registry that comes nearest, or "".
    """

    term: Anonymous
    screened: Screened
    nearest: str


def unnamed_counts(found: Screened, effects: Sequence[Screened]) -> bool:
    """Whether an unnamed term is more than what a hundred of them reach by chance, and more than what first order leaves of the effects."""
    least = max(_BANK_GAIN, _BESIDE_SHARE * sum(e.gain for e in effects))
    return worth_of(found) > MARGIN + BANK_MARGIN and found.gain > least


def stranger(model: CampaignModel, chosen: Sequence[Candidate], effects: Sequence[Screened], first: Sequence[Screened]) -> Stranger | None:
    """The anonymous term that shows in what the registry leaves, if it is more than what a good model may leave."""
    screener = model.screener_with(chosen)
    rest = _most_worth(_unnamed(model, screener, chosen))
    significant = (screener.chi2 - screener.dof) / np.sqrt(2.0 * screener.dof)
    before = model.screener.chi2 - model.screener.dof
    share = (screener.chi2 - screener.dof) / before if before > 0.0 else 0.0
    if rest is not None:
        if unnamed_counts(rest[0], effects) and _seen_at_rest(model, chosen, *rest):
            # three names that are not it say less of it than the one term that comes nearest
            return _stranger(model, (_said_of_their_kind(model, effects) if len(effects) >= _TOO_MANY else None) or rest)
        if chosen:
            alone = _said_of_their_kind(model, effects)
            named = max(_set_worth(model, chosen), _worth_of_one(model, chosen, effects, first))
            if alone is not None and (alone[1].form, alone[1].phase) == HEATED:
                named = max(named, _set_worth_beside_wander(model, effects))
            if alone is not None and (worth_of(alone[0]) > named or one_change_of_another_kind(effects) or cancel(model, effects)):
                return _stranger(model, alone)
        if significant > LEFT_SIGMA and share > LEFT_SHARE:
            return _stranger(model, rest)
    return None


def unnamed_rest(model: CampaignModel, chosen: Sequence[Candidate]) -> Stranger | None:
    """The anonymous term that says most of what effects leave, or, if one says nearly as much as they do, that one."""
    screener = model.screener_with(chosen)
    most, alone = _most_worth(_unnamed(model, screener, chosen)), _most_worth(_unnamed(model, model.screener))
    if alone is not None and alone[0].gain > _AS_MUCH * (model.screener.chi2 - screener.chi2):
        # a friction that is smooth at rest: what a dry one leaves of it has the form of nothing
        return _stranger(model, alone)
    return _stranger(model, most) if most is not None else None


def _stranger(model: CampaignModel, found: tuple[Screened, Anonymous]) -> Stranger:
    return Stranger(found[1], found[0], nearest_known(model, found[0].candidate))


def _said_of_their_kind(model: CampaignModel, effects: Sequence[Screened]) -> tuple[Screened, Anonymous] | None:
    """The term that says most of a campaign; of effects that all change one property, one that does too, if it says half as much.

    A split that went to and fro with a gradient was a lag, a drift and a charge of it, and a cube of the pick-offs said more than any.
    """
    found = _unnamed(model, model.screener)
    names = {e.name for e in effects}
    places = [place for changes, place in zip(CHANGES, _PLACES, strict=False) if len(names & changes) >= _TOO_MANY]
    best, of_kind = _most_worth(found), _most_worth([pair for pair in found if (pair[1].location, pair[1].phase) in places])
    return of_kind if best is not None and of_kind is not None and worth_of(of_kind[0]) > 0.5 * worth_of(best[0]) else best


def _most_worth(found: Sequence[tuple[Screened, Anonymous]]) -> tuple[Screened, Anonymous] | None:
    return max(found, key=lambda pair: worth_of(pair[0]), default=None)


def _worth_of_one(model: CampaignModel, chosen: Sequence[Candidate], effects: Sequence[Screened], first: Sequence[Screened]) -> float:
    """What an unnamed term must be worth to be better than any one effect of the registry.

    An effect of first order is short of what it takes by a share of it: an asymmetry of SNR 450 was 26 short of 201 702. Where several
    effects are more than that share of the first it is not: a square drag that the registry lacked was a cubic one and two more.
    """
    one = [*first, *(s for c in chosen if (s := _by_its_own(model, c)) is not None)]
    gains = sorted(e.gain for e in effects)
    short = 0.5 * SECOND_ORDER if sum(gains[:-1]) < SECOND_ORDER * max(gains, default=0.0) else 0.0
    return max((worth_of(s, own_directions(s)) + max(_BETTER, short * s.gain) for s in one), default=0.0)


def _by_its_own(model: CampaignModel, candidate: Candidate) -> Screened | None:
    """An effect beside what unlike pick-offs make of it, which is no larger than they are: free, it is any cube for a square."""
    own, skew = (
        replace(candidate, columns=tuple(candidate.columns[k] for k in places), prior_sd=candidate.prior_sd[places])
        for of in (False, True)
        for places in [[k for k, c in enumerate(candidate.columns) if c.name.startswith(SKEW) is of]]
    )
    return model.screener_with([skew] if skew.columns else []).screen(own)


def one_change_of_another_kind(effects: Sequence[Screened]) -> bool:
    """Whether so many effects say how one property changes, or that all lag, that none of them is what does: hysteresis took three.

    A rate made by a gradient across the shell was late gains of both sides and a late damping. And of a pick-off with two memories a drive
    that bends took four fifths, a nonlinear damping and a voltage by the reference the rest.
    """
    together: dict[str, float] = defaultdict(float)
    for e in effects:
        together[_ONE_OF.get(e.name, e.name)] += e.gain
    gains, names = together.values(), together.keys()
    if len(gains) >= _TOO_MANY and min(gains) > _OF_THREE * sum(gains):
        return True
    return any(len(names & changes) >= _TOO_MANY for changes in CHANGES)


def cancel(model: CampaignModel, effects: Sequence[Screened]) -> bool:
    """Whether two effects are each other's negative but for a small rest: no device has both of just that size, and the rest is a third.

    A damping that lags behind the temperature was a gain of the drives that does, of 2.9e-3/K, and one of the pick-offs of -2.9e-3/K: of
    both remains how fast they change, a seventieth.
    """
    made = [model.screener.projected(e.candidate.columns)[0] @ e.values for e in effects]
    sizes = [float(np.linalg.norm(m)) for m in made]
    return any(float(np.linalg.norm(made[i] + made[j])) < _REST * min(sizes[i], sizes[j]) for i in range(len(made)) for j in range(i))


def _seen_at_rest(model: CampaignModel, chosen: Sequence[Candidate], found: Screened, term: Anonymous) -> bool:
    """Whether a term that has nothing to do with rate counts without the recordings that were turned."""
    still = found if term.depends_on == "rate" else model.at_rest(found, chosen)
    return still is not None and worth_of(still) > MARGIN + BANK_MARGIN


def _unnamed(model: CampaignModel, screener: Screener, chosen: Sequence[Candidate] = ()) -> list[tuple[Screened, Anonymous]]:
    """Unnamed terms beside what a screener holds, and of the courses of time and temperature the best."""
    found, course = bank_terms(model, screener, chosen), model.courses.best(screener, model.whitener)
    if course is None or (course[1].location, course[1].phase) in walks_in(chosen):
        return found
    return [*found, course] if _no_floors(model, chosen, [course[0]]) else found


def bank_terms(model: CampaignModel, screener: Screener, chosen: Sequence[Candidate] = ()) -> list[tuple[Screened, Anonymous]]:
    """Unnamed terms beside what a screener holds; those that go with time if they are no floor, that remember if several recordings do."""
    terms = {id(c): a for a, c in model.bank}
    screened = ((s, terms[id(s.candidate)]) for s in screener.screened(c for _, c in model.bank))
    weighed = ((_beside_wander(model, chosen, s) if (a.form, a.phase) == HEATED else s, a) for s, a in screened if _may_be(s, a))
    found = [(s, a) for s, a in weighed if s is not None]
    no_floors = {id(s) for s in _no_floors(model, chosen, [s for s, a in found if a.depends_on == "time"])}
    memories = [s for s, a in found if remembers(a.form) and worth_of(s) > MARGIN]
    of_one = {id(s) for s in memories} - {id(s) for s in memories_of_several(model, screener, memories, chosen)}
    return [(s, a) for s, a in found if (a.depends_on != "time" or id(s) in no_floors) and id(s) not in of_one]


def _may_be(found: Screened, term: Anonymous) -> bool:
    """Whether what is read or driven is no larger a share of its signal than one is.

    What bends with a cube on both axes at once is nothing along a wave and noise beside it: it took a third of the volts.
    """
    return term.location == LOCATIONS["flow"] or bool(np.all(np.abs(found.values) < found.candidate.prior_sd + _SURELY * found.sd))


def _beside_wander(model: CampaignModel, chosen: Sequence[Candidate], found: Screened) -> Screened | None:
    """What lies between records, if no wander of any size imitates it: as loud as beside the measured one, or beside its own."""
    if worth_of(found) < 0.0:
        return None
    beside = replace(found, gain=beside_wander(model, chosen, found))
    return max(found, beside, key=worth_of) if worth_of(beside) > MARGIN + BANK_MARGIN + _COURSE_MARGIN else None


def _no_floors(model: CampaignModel, chosen: Sequence[Candidate], found: Sequence[Screened]) -> list[Screened]:
    """Those that no 1/f floor explains, of the size that it was measured or a larger one."""
    counting = [s for s in found if worth_of(s) > MARGIN + BANK_MARGIN + _COURSE_MARGIN]
    if not counting:
        return []
    # and by what hundreds of them reach by chance: a drift of the rate that larger floors beat was crossed and unnamed by 0.05
    least = louder_floors(model, chosen) + BANK_MARGIN
    return [s for s in counting if worth_of(s) > least]


def worth_of(found: Screened, directions: int | None = None) -> float:
    """Log evidence with the same price for every direction; ``directions``: if it is not what the data tell of it."""
    return worth(found.gain, found.rank if directions is None else directions, found.candidate.choices)


def _set_worth(model: CampaignModel, chosen: Sequence[Candidate]) -> float:
    """Worth of a set: what it leaves, its sizes' priors counted, at the price of all its directions.

    One effect after the other would say more than all of them take: what a prior keeps from one is there for the next.
    """
    found = [model.screener.screen(candidate) for candidate in chosen]
    directions = sum(own_directions(f) for f in found if f is not None)
    return worth(model.screener.chi2 - model.screener_with(chosen).chi2, directions, math.prod(c.choices for c in chosen))


def _set_worth_beside_wander(model: CampaignModel, effects: Sequence[Screened]) -> float:
    """The same beside a wander between records that is as large as it is with the effects, as what lies between records is weighed.

    A Duffing of a device that has no wander was a heat of the wave: its 9197 in chi-square were beside one that the Duffing had made.
    """
    gain, others = 0.0, list[Candidate]()
    for e in effects:
        gain += beside_wander(model, others, e)
        others.append(e.candidate)
    return worth(gain, sum(map(own_directions, effects)), math.prod(c.choices for c in others))


def own_directions(found: Screened) -> int:
    """Directions of its parameters: what unlike pick-offs make of it follows from them."""
    return min(found.rank, sum(not c.name.startswith(SKEW) for c in found.candidate.columns))
