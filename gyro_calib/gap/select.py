"""Which effects a campaign needs: forward by evidence, in pairs where singles hide one another, backward, swapped; or something unnamed.

An effect enters only when its evidence beats none by a margin that fifty tests of one campaign do not reach by chance. After the best set,
anonymous terms are tried on what is left: if they close a share of the gap that the registry does not, the effect is not in the catalogue.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np

from .at_rest import seen_at_rest
from .candidates import candidate_at
from .counting import beyond_complete, completes, enough, stands
from .drifts import COURSES, best_course
from .exact_levels import best_exact_level
from .floors import beat_their_floors
from .model import CampaignModel
from .one_recording import told_by_several
from .physical import physical, worth_at_its_level
from .relinearise import relinearised
from .saturated import is_of_time, with_twins
from .screen import Candidate, Screened, Screener
from .settings_together import is_accompanied, settled_together
from .strangers import (
    BANK_MARGIN,
    LEAST_GAIN,
    LEFT_SHARE,
    LEFT_SIGMA,
    MARGIN,
    Stranger,
    bank_terms,
    own_directions,
    stranger,
    unnamed_counts,
    worth_of,
)

__all__ = ["Selection", "as_good", "best_of_each", "select_effects"]

#: an effect that is as good as the best within this log evidence, or takes away as much within this chi-square, is not told apart from it
_ALIKE, _CLOSE = 6.0, 9.0
#: the same for what the drives and the pick-offs have alike: a pick-off's lag is made of recorded volts, noise and all,
#: which cost the lag of trial 2201/13 31 of chi-square
_TWINS_CLOSE = 40.0
_MOST_EFFECTS = 3
#: power over the noise that the best set leaves, up to which it is that of the noise; beyond, something is missing
_LOUDEST = 1.3
#: log evidence, and the share of it that trials found to name the right group (`benchmarks/diagnosis.md`)
_EVIDENCES, _TRUST = (30.0, 1000.0), (0.75, 0.92)
_GOLDEN_STEPS = 8
#: settings that are refined, rounds of those that have two, and how far beyond the ends of its grid one may lie
_REFINED, _REFINEMENTS = ("level", "tau", "separation_hz", "half_width_hz", *COURSES), 3
_BEYOND = {"half_width_hz": (4.0, 4.0), "tau": (1.0, 3.0)}
#: log evidence from which on an effect is asked what comes with it
_SHOWN = 3.0
#: effects that are refined before one is taken: those of so much of the best one's log evidence, and how many at most
_NEAR, _CONTENDERS = 0.75, 4
#: effects tried in pairs, and least gain of a pair that no member shows alone
_PAIRED = 8
#: log evidence that an effect may gain between two settings of its grid
_BETWEEN = 6.0
#: a level that is tried as what it is must leave this much less than what was selected
_EXACT_IS_BETTER = 0.5


@dataclass(frozen=True)
class Selection:
    """What was found.

    Parameters
    ----------
    effects : tuple of Screened
        In the order of their gain; sizes with all of them together.
    groups : tuple of tuple of str
        For each effect those that these data cannot tell from it, itself first.
    probabilities : tuple of float
        For each effect, of its group against none and against something unnamed.
    stranger : Stranger or None
    screened : mapping
        Every effect at its best setting against the nuisances alone.
    chi2_before, chi2_after, dof : float
    """

    effects: tuple[Screened, ...]
    groups: tuple[tuple[str, ...], ...]
    probabilities: tuple[float, ...]
    stranger: Stranger | None
    screened: Mapping[str, Screened]
    chi2_before: float
    chi2_after: float
    dof: int


def _ranked(model: CampaignModel, chosen: Sequence[Candidate], only: Sequence[str] | None = None) -> list[Screened]:
    screener = model.screener_with(chosen)
    taken = with_twins(c.name for c in chosen)
    pool = {n: c for n, c in model.candidates.items() if n not in taken and (only is None or n in only)}
    return best_of_each(screener, pool)


def best_of_each(screener: Screener, pool: Mapping[str, Sequence[Candidate]]) -> list[Screened]:
    """Every name at the best setting of its grid that can be, the best name first."""
    best: dict[str, Screened] = {}
    for s in screener.screened(c for candidates in pool.values() for c in candidates):
        if physical(s) and (s.name not in best or s.log_evidence > best[s.name].log_evidence):
            best[s.name] = s
    return sorted(best.values(), key=lambda s: -s.log_evidence)


def select_effects(model: CampaignModel) -> Selection:
    """Select, name what cannot be told apart, and say whether something unnamed is there."""
    first, chosen = _ranked(model, ()), list[Candidate]()
    ranked = first if not first or enough(first[0]) else _between_settings(model, first)
    largest = ranked[0] if ranked else None
    while (counting := _counting(model, chosen, ranked, largest)) and len(chosen) < _MOST_EFFECTS:
        chosen.append(_best_refined(model, chosen, ranked if counting[0] is ranked[0] else counting))
        # about the device that holds it: what its first order leaves would pass for the next effect
        chosen = relinearised(model, chosen)
        ranked = _ranked(model, chosen)
    if not chosen:
        chosen = _pair(model, first)
    chosen = _improved(model, chosen, largest)
    beside = [model.screener_with(_without(chosen, k)) for k in range(len(chosen))]
    chosen = [best_course(b, model.candidates[c.name], c, partial(_refined, model, b)) for b, c in zip(beside, chosen, strict=True)]
    chosen = settled_together(model, chosen)
    chosen, effects = _settled(model, chosen, largest)
    if any(is_accompanied(c) for c in chosen):
        # what comes with an effect was not there when its time was sought
        chosen = settled_together(model, chosen)
        effects = _together(model, chosen)
    _, effects = _or_exact_level(model, chosen, effects)
    chosen, effects = _named_all_the_same(model, [e.candidate for e in effects], effects)
    groups = tuple(_alike(model, chosen, k) for k in range(len(chosen)))
    screener = model.screener_with(chosen)
    found = stranger(model, chosen, effects, first)
    return Selection(
        effects=effects,
        groups=groups,
        probabilities=tuple(_probability(e) for e in effects),
        stranger=found,
        screened={s.name: s for s in first},
        chi2_before=model.screener.chi2,
        chi2_after=screener.chi2,
        dof=screener.dof,
    )


def _named_all_the_same(
    model: CampaignModel, chosen: list[Candidate], effects: tuple[Screened, ...]
) -> tuple[list[Candidate], tuple[Screened, ...]]:
    """With the effect of the registry that explains what an unnamed term would, if there is one.

    Its prior may be that of much larger devices: a hemisphere that stiffens by 1e-6 of what a ring may has little evidence against none,
    but it has the name.
    """
    screener = model.screener_with(chosen)
    best = max((s for s, _ in bank_terms(model, screener, chosen)), key=worth_of, default=None)
    if best is None or not unnamed_counts(best, effects) or len(chosen) >= _MOST_EFFECTS:
        return chosen, effects
    taken = with_twins(c.name for c in chosen)
    tried = [s for s in screener.screened(c for n, cs in model.candidates.items() if n not in taken for c in cs) if physical(s)]
    named = max(tried, key=lambda s: worth_of(s, own_directions(s)), default=None)
    if named is None or worth_of(named, own_directions(named)) < worth_of(best) - _ALIKE or not seen_at_rest(model, effects, named):
        return chosen, effects
    chosen = relinearised(model, [*chosen, _refined(model, screener, named.candidate)])
    return chosen, _together(model, chosen)


def _pair(model: CampaignModel, first: Sequence[Screened]) -> list[Candidate]:
    """Two effects that hide one another: neither shows alone."""
    best: tuple[float, list[Candidate]] = (MARGIN, [])
    for a, b in combinations(first[:_PAIRED], 2):
        second = model.screener_with([a.candidate]).screen(b.candidate)
        if second is None or not physical(second) or b.name in with_twins([a.name]):
            continue
        together = a.log_evidence + second.log_evidence
        if together > best[0] and a.gain + second.gain > 2.0 * LEAST_GAIN:
            best = (together, [a.candidate, b.candidate])
    return best[1]


def _settled(model: CampaignModel, chosen: list[Candidate], largest: Screened | None) -> tuple[list[Candidate], tuple[Screened, ...]]:
    """The effects about the device that holds them; one of a size that it cannot have, or that the others make needless, is none."""
    while True:
        chosen = relinearised(model, chosen)
        effects = _together(model, chosen)
        left = model.screener_with(chosen)
        louder = float(np.clip(left.chi2 / left.dof, 1.0, _LOUDEST))
        needed = [
            (
                enough(e, largest if len(effects) > 1 else None, r := beyond_complete(left.chi2 + e.gain, left.dof))
                or completes(model, chosen, e, r)
            )
            and seen_at_rest(model, effects, e)
            and told_by_several(model, e, [o.candidate for o in effects if o is not e])
            for e in effects
        ]
        if not beat_their_floors(model, effects):
            needed = [need and not is_of_time(e.name) for e, need in zip(effects, needed, strict=True)]
        doubtful = [e for e, need in zip(effects, needed, strict=True) if not (need and physical(e, rough=False) and stands(e, louder))]
        if not doubtful:
            return chosen, effects
        least = min(doubtful, key=lambda e: e.log_evidence)
        chosen = [e.candidate for e in effects if e is not least]


def _or_exact_level(
    model: CampaignModel, chosen: list[Candidate], effects: tuple[Screened, ...]
) -> tuple[list[Candidate], tuple[Screened, ...]]:
    """A drive that clips or is dead so much that first order does not recognise it, where much is left without."""
    left = model.screener_with(chosen)
    before = model.screener.chi2 - model.screener.dof
    if before <= 0.0 or left.chi2 - left.dof < max(LEFT_SHARE * before, LEFT_SIGMA * np.sqrt(2.0 * left.dof)):
        return chosen, effects
    exact = best_exact_level(model)
    if exact is None or exact.chi2 > _EXACT_IS_BETTER * left.chi2:
        return chosen, effects
    alone = relinearised(model, [model.candidate(exact.name, {"level": exact.level})], exact.linear)
    found = _together(model, alone)
    good = bool(found) and physical(found[0], rough=False) and model.screener_with(alone).chi2 < _EXACT_IS_BETTER * left.chi2
    return (alone, found) if good else (chosen, effects)


def _between_settings(model: CampaignModel, ranked: Sequence[Screened]) -> list[Screened]:
    """Where no effect counts at a setting of its grid: those that nearly do at their best setting, which lies between."""
    nearly = [s for s in ranked if s.candidate.setting and s.log_evidence > MARGIN - _BETWEEN][:_CONTENDERS]
    found = model.screener.screened(_refined(model, model.screener, s.candidate) for s in nearly)
    found += _accompanied(model, model.screener, [s for s in ranked if s.log_evidence > _SHOWN])
    better = {s.name: s for s in sorted(found, key=lambda s: s.log_evidence) if physical(s)}
    return sorted((better.get(s.name, s) for s in ranked), key=lambda s: -s.log_evidence)


def _best_refined(model: CampaignModel, chosen: Sequence[Candidate], ranked: Sequence[Screened]) -> Candidate:
    """The best beside those chosen, at its best setting: one that comes near on the grid may be better between its points.

    And one that counts may be better by what pick-offs that are not alike make of it: where a resonance wanders, a Duffing of a
    hemisphere shows more by their phases than by the frequency, and relaxation was named. A cube of each axis by itself, as large
    on both, is one of their sum but for that; a stiffness by the drives' square is one by its mean but for half a sample of phase.
    """
    screener = model.screener_with(chosen)
    near = [s for s in ranked if s.log_evidence > _NEAR * ranked[0].log_evidence][:_CONTENDERS]
    refined = [_refined(model, screener, s.candidate) for s in near]
    found = screener.screened(refined)
    tried = {s.name for s in near}
    counting = [s for s in ranked if s.log_evidence > _SHOWN and s.name not in tried] + found
    return max(found + _accompanied(model, screener, counting), key=lambda s: s.log_evidence).candidate


def _accompanied(model: CampaignModel, screener: Screener, found: Sequence[Screened]) -> list[Screened]:
    """Effects, as they were found and otherwise, with what comes with them."""
    both = [*found, *(v for f in found for v in _otherwise(model, screener, f))]
    return [s for f in both if (s := _with_unlike_pickoffs(model, screener, f)) is not None]


def _otherwise(model: CampaignModel, screener: Screener, found: Screened) -> list[Screened]:
    """The effect of both axes together, by axis or by its mean over a cycle, if it was found as another of these."""
    axes = found.candidate.setting.get("axes")
    return screener.screened(c for c in model.candidates[found.name] if axes is not None and c.setting["axes"] != axes)


def _with_unlike_pickoffs(model: CampaignModel, screener: Screener, found: Screened) -> Screened | None:
    """An effect with what pick-offs that are not alike make of it at its size, if they make anything."""
    c = found.candidate
    sizes = {name: value for name, (value, _) in found.sizes().items()}
    more = candidate_at(model.evidence, model.linear, c.name, c.setting, c.choices, sizes)
    if len(more.columns) == len(c.columns):
        return None
    screened = screener.screen(more)
    return screened if screened is not None and physical(screened) else None


def _refined(model: CampaignModel, screener: Screener, candidate: Candidate) -> Candidate:
    """The candidate with its settings between the points of the grid, one after the other by golden section on the evidence."""
    keys = [name for name in _REFINED if name in candidate.setting]
    for key in keys * (_REFINEMENTS if len(keys) > 1 else 1):
        candidate = _refined_along(model, screener, candidate, key)
    return candidate


def _refined_along(model: CampaignModel, screener: Screener, candidate: Candidate, key: str) -> Candidate:
    grid = np.unique([float(c.setting[key]) for c in model.grid(candidate.name, key)])
    here = float(candidate.setting[key])
    below, above = grid[grid < here], grid[grid > here]
    low, high = (float(below[-1]) if below.size else here), (float(above[0]) if above.size else here)
    if key in _BEYOND:
        # a width or a long time has no natural end: it may lie beyond its grid's
        down, up = _BEYOND[key]
        low, high = (low if below.size else here / down), (high if above.size else here * up)
    tried: dict[float, tuple[float, Candidate]] = {}

    def evidence(value: float) -> float:
        at = model.candidate(candidate.name, {**candidate.setting, key: value})
        found = screener.screen(at)
        tried[value] = (worth_at_its_level(found) if found is not None and physical(found) else -np.inf, at)
        return tried[value][0]

    evidence(here)
    share = 0.381966
    a, b = low + share * (high - low), high - share * (high - low)
    at_a, at_b = evidence(a), evidence(b)
    for _ in range(_GOLDEN_STEPS):
        if at_a > at_b:
            high, b, at_b = b, a, at_a
            a = low + share * (high - low)
            at_a = evidence(a)
        else:
            low, a, at_a = a, b, at_b
            b = high - share * (high - low)
            at_b = evidence(b)
    return max(tried.values(), key=lambda pair: pair[0])[1]


def _counting(model: CampaignModel, chosen: Sequence[Candidate], ranked: Sequence[Screened], largest: Screened | None) -> list[Screened]:
    """Those that count beside what is chosen."""
    screener = model.screener_with(chosen)
    rest = beyond_complete(screener.chi2, screener.dof)
    return [
        s for s in ranked if enough(s, largest, rest) or (s is ranked[0] and chosen and completes(model, [*chosen, s.candidate], s, rest))
    ]


def _without(chosen: Sequence[Candidate], k: int) -> list[Candidate]:
    return [c for j, c in enumerate(chosen) if j != k]


def _improved(model: CampaignModel, chosen: list[Candidate], largest: Screened | None) -> list[Candidate]:
    """Drop what the others make needless; swap one for what does better in its place."""
    for _ in range(2):
        before = [c.name for c in chosen]
        for k in range(len(chosen)):
            if k >= len(chosen) or len(chosen) < 2:
                break
            others = _without(chosen, k)
            ranked = _ranked(model, others)
            if not _counting(model, others, ranked[:1], largest):
                chosen = others
                continue
            mine = model.screener_with(others).screen(chosen[k])
            if mine is None or mine.log_evidence < ranked[0].log_evidence:
                chosen[k] = ranked[0].candidate
        if [c.name for c in chosen] == before:
            break
    return chosen


def _together(model: CampaignModel, chosen: Sequence[Candidate]) -> tuple[Screened, ...]:
    """Each effect beside the others."""
    found = []
    for k, candidate in enumerate(chosen):
        screened = model.screener_with(_without(chosen, k)).screen(candidate)
        if screened is not None:
            found.append(screened)
    return tuple(found)


def _alike(model: CampaignModel, chosen: Sequence[Candidate], k: int) -> tuple[str, ...]:
    """The effect in place k and those that would do as well in its place."""
    others = _without(chosen, k)
    name = chosen[k].name
    mine = model.screener_with(others).screen(chosen[k])
    if mine is None:
        return (name,)
    return (name, *(s.name for s in _ranked(model, others) if s.name != name and as_good(s, mine)))


def as_good(other: Screened, mine: Screened) -> bool:
    """Whether these data do not tell another effect from the one that was named: by its evidence, or by what it takes away."""
    close = _TWINS_CLOSE if other.name in with_twins([mine.name]) else _CLOSE
    alike = mine.log_evidence > MARGIN and other.log_evidence > max(mine.log_evidence - _ALIKE, 0.0)
    return alike or (other.gain > mine.gain - close and other.log_evidence > min(mine.log_evidence, MARGIN))


def _probability(effect: Screened) -> float:
    """Of the effect against none, both alike before, times how often groups of such evidence were right in blind trials."""
    evidence = max(effect.log_evidence, worth_of(effect, own_directions(effect)) - BANK_MARGIN)
    trust = float(np.interp(np.log10(max(evidence, 1.0)), np.log10(_EVIDENCES), _TRUST))
    return float(trust / (1.0 + np.exp(-0.5 * (evidence - MARGIN / 2.0))))
