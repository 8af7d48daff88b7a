"""The saturated model: every effect of the registry at once, too rich to name anything; what it cannot follow is noise."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..effects import EFFECTS
from .column import Column
from .evidence import CampaignEvidence
from .forms import FORMS
from .nuisance import BOTH_DRIVES_LATE
from .parts import Linear
from .screen import Candidate, Screener

__all__ = ["columns_of_time", "counting", "effect_columns", "is_of_time", "open_drive", "saturated_columns", "with_twins"]

#: of the settings of a gridded effect, how many are held
_SETTINGS = 4
#: log evidence from which on an effect may be what repeated records differ by: half of what names it
_COUNTS = 5.0
#: and from which on it is there: what else has room comes after
_SURE = 50.0
#: columns over equations, at most
_SATURATION = 0.5
#: share of the room that effects keep if unnamed terms need more than they leave: beside a loud effect nearly all of those may be there
_NAMED = 0.75
#: how much of a drive or of a reading a limiter or a dead zone may take, sd
_TAKEN = 0.03
#: size of an unnamed term over what the drives do, sd
_SMALL = 0.003
#: of a drive and of a pick-off: opposite to each other they are one filter of both
_TWIN = {"pickoff_memory": "drive_memory", "pickoff_lag": "drive_lag", "pickoff_delay": "drive_delay"}
#: effects with a memory, or that feed through
_FAST = (
    "drive_lag",
    "drive_delay",
    "drive_memory",
    "pickoff_lag",
    "pickoff_delay",
    "pickoff_memory",
    "channel_skew",
    "relaxation",
    "spurious_mode",
    "thermal_feedthrough",
    "parametric_pump",
)


def with_twins(names: Iterable[str]) -> set[str]:
    """Effects, and what beside one of them explains but the noise that both share."""
    taken = set(names)
    return taken | {other for pair in _TWIN.items() for one, other in (pair, pair[::-1]) if one in taken}


def effect_columns(candidates: Sequence[Candidate]) -> list[Column]:
    """Columns of effects, named ``effect.parameter``, with the prior of their size."""
    return [
        Column(f"{c.name}.{column.name}", column.signal, column.quiet, float(sd))
        for c in candidates
        for column, sd in zip(c.columns, c.prior_sd, strict=True)
    ]


def is_of_time(name: str) -> bool:
    """Whether an effect of the registry needs but time to show."""
    return set(EFFECTS[name].needs) == {"time"}


def columns_of_time(candidates: Mapping[str, Sequence[Candidate]]) -> list[Column]:
    """Effects that need but time to show: what drifts slowly is like them."""
    return effect_columns([c for name, tried in candidates.items() if is_of_time(name) for c in _some(tried)])


def counting(screener: Screener, candidates: Iterable[Candidate], first: Iterable[str] = ()) -> list[str]:
    """Names of effects and of unnamed terms that may be there, the likeliest first: what repeats differ by need not be noise.

    ``first``: names that come before those that are not sure to be there.
    """
    found = sorted(screener.screened(candidates), key=lambda s: -s.log_evidence)
    sure = (s.name for s in found if s.log_evidence > _SURE)
    return list(dict.fromkeys([*sure, *first, *(s.name for s in found if s.log_evidence > _COUNTS)]))


def open_drive(evidence: CampaignEvidence) -> bool:
    """Whether open drive of both axes tells the feedthrough; otherwise what changes fast is told from the loops' noise by nothing."""
    return {e.axis for r in evidence if (e := r.recording.command.excitation).kind == "drive"} == {"x", "y"}


def saturated_columns(
    evidence: CampaignEvidence,
    linear: Linear,
    nuisances: Sequence[Column],
    candidates: Mapping[str, Sequence[Candidate]],
    unnamed: Sequence[Candidate],
    shown: Sequence[str] = (),
) -> list[Column]:
    """Every effect at once, each of a size that it may have, and unnamed terms: what has no name is no noise either.

    Drive and pick-off that pass through one filter obey the linear flow as before: a memory of the one against the same of the other holds
    no signal, but all of the noise, so of such twins one is enough. Where no open drive of both axes told the feedthrough, without the lag
    of a record and what has a memory: in a closed loop the drive's noise follows from the pick-off's, and a lag that is free would explain
    the noise away. A feedthrough keeps to its prior.

    Parameters
    ----------
    evidence : CampaignEvidence
    linear : Linear
    nuisances : sequence of Column
    candidates : mapping
        Effects by name.
    unnamed : sequence of Candidate
    shown : sequence of str
        Names of effects and of unnamed terms that may be there, the likeliest first: what is held where there are no equations for all.
    """
    told = {name: tried for name, tried in candidates.items() if _TWIN.get(name) not in candidates}
    chosen = [_not_gross(evidence, linear, c) for tried in told.values() for c in _some(tried)]
    if not open_drive(evidence):
        nuisances = [c for c in nuisances if not c.name.startswith(("drive_lag", BOTH_DRIVES_LATE))]
        chosen = [c for c in chosen if c.name not in _FAST]
    # few recordings have no equations for all of that: it would explain their noise
    room = int(_SATURATION * sum(2 * r.signal.lhs.size for r in evidence)) - len(nuisances)
    fits = (held for held in (chosen, _fewest(chosen)) if len(_columns(held)) <= room)
    if (kept := next(fits, None)) is None:
        return list(nuisances)
    # both phases of a term have one name
    small: dict[str, list[Column]] = {}
    for c in unnamed:
        small.setdefault(c.name, []).extend(_columns([_small(evidence, linear, c)]))
    if sum(len(columns) for columns in small.values()) > room - len(_columns(kept)):
        needed = sum(len(small[name]) for name in shown if name in small)
        kept = _with_room(kept, shown, max(room - needed, int(_NAMED * room)))
        small = {name: small[name] for name in _that_fit([n for n in shown if n in small], small, room - len(_columns(kept)))}
    return [*nuisances, *_columns(kept), *(c for columns in small.values() for c in columns)]


def _with_room(named: Sequence[Candidate], shown: Collection[str], room: int) -> list[Candidate]:
    """Effects, less those that hardly are there (of which the noise has little to fear) as far as those that may be need the room."""
    hardly = [c for c in reversed(named) if c.name not in shown]
    short, gone = len(_columns(named)) - room, []
    # what drifts slowly is like those that need but time
    for candidate in sorted(hardly, key=lambda c: is_of_time(c.name)):
        if short > 0:
            gone.append(candidate)
            short -= len(_columns([candidate]))
    return [c for c in named if not any(c is other for other in gone)]


def _that_fit(names: Sequence[str], columns: Mapping[str, Sequence[Column]], room: int) -> list[str]:
    """Those that there is room for, one after the other."""
    fit = []
    for name in names:
        if len(columns[name]) <= room:
            room -= len(columns[name])
            fit.append(name)
    return fit


def _columns(candidates: Sequence[Candidate]) -> list[Column]:
    return [c for c in effect_columns(candidates) if any(np.any(v) for v in c.signal)]


def _fewest(chosen: Sequence[Candidate]) -> list[Candidate]:
    """Each effect at the first of its settings that are held."""
    return list({c.name: c for c in reversed(chosen)}.values())


def _some(tried: Sequence[Candidate]) -> Sequence[Candidate]:
    """Of an effect's settings as many as are held."""
    return tried[:: max(1, len(tried) // _SETTINGS)]


def _small(evidence: CampaignEvidence, linear: Linear, unnamed: Candidate) -> Candidate:
    """An unnamed term that is small against what the drives do: a larger one is seen whatever the noise, and could open the loop."""
    driven = [r.turn * np.einsum("nab,ab->n", r.signal.drive, linear.G) for r in evidence]
    whole = np.sqrt(sum(float(np.sum(np.abs(v) ** 2)) for v in driven))
    sizes = np.array([np.sqrt(sum(float(np.sum(np.abs(v) ** 2)) for v in c.signal)) for c in unnamed.columns])
    return replace(unnamed, prior_sd=np.minimum(unnamed.prior_sd, _SMALL * whole / np.where(sizes > 0.0, sizes, np.inf)))


def _not_gross(evidence: CampaignEvidence, linear: Linear, candidate: Candidate) -> Candidate:
    """A limiter or a dead zone that takes but a share of what passes it.

    One that could swallow the whole of a drive or of a reading would open the loop: what is left of the equation has no noise.
    """
    if "level" not in candidate.setting:
        return candidate
    taken = 0.0
    for r in evidence:
        for part in FORMS[candidate.name].parts(r.signals, linear, candidate.setting):
            whole = np.linalg.norm(r.signals.drive if part.kind == "drive" else r.signals.pick, axis=0)
            taken = max(taken, float(np.max(np.linalg.norm(part.signal, axis=0) / np.where(whole > 0.0, whole, np.inf))))
    return replace(candidate, prior_sd=np.minimum(candidate.prior_sd, _TAKEN / max(taken, 1e-12)))
