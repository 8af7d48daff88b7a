"""What the recordings say of every effect of the registry, the absent ones too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..effects import EFFECTS, INSEPARABLE
from ..quantity import Quantity
from .candidates import registry_name
from .diagnosis import Standing
from .drifts import parameter_of
from .forms import FORMS
from .model import CampaignModel
from .parts import SKEW
from .screen import Screened
from .select import LEAST_GAIN, Selection

__all__ = ["standings"]

#: chi-square at which an effect is taken up, and a standard normal's 90 % point: the size that would have been seen nine times in ten
_SEEN = float(np.sqrt(LEAST_GAIN + 5.0)) + 1.28
#: an effect that must be this many times its usual size to be seen: cannot tell; and: not testable
_LARGE, _BEYOND = 5.0, 50.0
#: share of an effect that is imitated, from which on what is left tells nothing: a pump of a wave that keeps its phase is a damping
_IMITATED = 1.0 - 1e-4


def standings(model: CampaignModel, selection: Selection, without: Sequence[str] = ()) -> tuple[Standing, ...]:
    """One line per effect, the present ones first, then by evidence."""
    present = {e.name for e in selection.effects}
    alike = {name: group[0] for group in selection.groups for name in group[1:]}
    out = []
    screener = model.screener_with([e.candidate for e in selection.effects])
    for name in FORMS:
        if name not in EFFECTS or name in without:
            continue
        effect = EFFECTS[name]
        found = _best(model, screener, name) if name not in present else next(e for e in selection.effects if e.name == name)
        if found is None:
            out.append(Standing(name, effect.title, effect.location, "not testable", None, 0.0, 0.0, 1.0))
            continue
        status, limit = _status(found)
        if name in present:
            status, limit = "present", None
        elif name in alike:
            status, limit = f"like {alike[name]}", None
        out.append(Standing(name, effect.title, effect.location, status, limit, found.log_evidence, found.gain, found.absorbed))
    out += [_like(s, other) for s in out for other in INSEPARABLE.get(s.name, ()) if other not in without]
    rank = {"present": 0, "like": 1}
    return tuple(sorted(out, key=lambda s: (rank.get(s.status.split()[0], 2), -s.log_evidence)))


def _like(known: Standing, other: str) -> Standing:
    """The line of an effect that no recording tells from a known one."""
    effect = EFFECTS[other]
    status = f"like {known.name}" if known.status == "present" else known.status
    return replace(known, name=other, title=effect.title, location=effect.location, status=status, excluded_above=None)


def _best(model: CampaignModel, screener, name: str) -> Screened | None:  # type: ignore[no-untyped-def]
    found = screener.screened(model.candidates.get(name, ()))
    # the setting at which it is seen best
    return min(found, key=_least_seen) if found else None


def _least_seen(found: Screened) -> float:
    """Smallest sd of a parameter over its prior's."""
    own = [c.name == parameter_of(c.name) for c in found.candidate.columns]
    return float(np.min((found.sd / found.candidate.prior_sd)[own]))


def _status(found: Screened) -> tuple[str, Quantity | None]:
    """Excluded above a size, whichever of its parameters has it, or too large to be seen here."""
    effect = EFFECTS[registry_name(found.name, found.candidate.setting)]
    first = found.candidate.columns[0].name
    if first not in {p.name for p in effect.parameters} or first in found.candidate.setting:
        return ("excluded" if _SEEN * float(found.sd[0]) < 1.0 else "cannot tell"), None
    limits = sorted(
        (_SEEN * float(sd) / (p := effect.parameter(c.name)).typical, float(sd), p.unit, max(p.upper, -p.lower))
        for c, sd in zip(found.candidate.columns, found.sd, strict=True)
        if not c.name.startswith(SKEW) and c.name == parameter_of(c.name)
    )
    (least, *_), (ratio, sd, unit, largest) = limits[0], limits[-1]
    # a limit that no device comes near says nothing
    size = Quantity(_SEEN * sd, sd, unit) if _SEEN * sd <= largest else None
    if least > _BEYOND or found.absorbed > _IMITATED:
        return "not testable", size
    return ("cannot tell" if ratio > _LARGE or size is None else "excluded"), size
