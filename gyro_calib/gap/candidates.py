"""The registry's effects as columns of one campaign, at every setting to try."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from ..effects import EFFECTS
from .column import Column
from .columns import form_columns, forms_columns
from .drifts import parameter_of
from .evidence import CampaignEvidence
from .forms import FORMS
from .one_axis import heard
from .parts import REST, SKEW, UNEQUAL, Linear, Setting
from .screen import Candidate

__all__ = ["candidate_at", "candidates_of", "registry_name"]

#: width of the prior of a parameter over its typical size in the registry
_PRIOR_WIDTH = 10.0


def registry_name(name: str, setting: Setting) -> str:
    """Name in the registry of an effect at a setting: a variant may have one of its own."""
    per_axis = FORMS[name].per_axis
    return per_axis if per_axis and setting.get("axes") else name


def candidates_of(
    evidence: CampaignEvidence,
    linear: Linear,
    without: Iterable[str] = (),
    on_progress: Callable[[float], None] | None = None,
) -> dict[str, list[Candidate]]:
    """Candidates by effect; those that no recording holds are left out.

    Parameters
    ----------
    evidence : CampaignEvidence
    linear : Linear
    without : iterable of str
        Effects to leave out of the registry (blind trials).
    on_progress : callable, optional
        Called with the fraction done.
    """
    left_out = set(without)
    signals = [r.signals for r in evidence]
    names = [name for name in FORMS if name not in left_out and name in EFFECTS]
    tried = [(name, setting, len(settings)) for name in names for settings in [FORMS[name].settings(signals)] for setting in settings]
    made = forms_columns(evidence, [(FORMS[name], setting) for name, setting, _ in tried], linear, on_progress)
    found: dict[str, list[Candidate]] = {}
    for (name, setting, choices), columns in zip(tried, made, strict=True):
        if any(np.any(v) for column in columns for v in column.signal):
            found.setdefault(name, []).append(_candidate(name, setting, heard(evidence, columns), choices))
    return found


def candidate_at(
    evidence: CampaignEvidence, linear: Linear, name: str, setting: Setting, choices: int, sizes: Mapping[str, float] | None = None
) -> Candidate:
    """An effect at one setting.

    Parameters
    ----------
    evidence : CampaignEvidence
    linear : Linear
    name : str
    setting : mapping
    choices : int
        How many settings it is tried at.
    sizes : mapping, optional
        Of an effect that was found: what pick-offs that are not alike make of it is then of known size.
    """
    columns = heard(evidence, form_columns(evidence, FORMS[name], linear, setting, unlike=sizes is not None))
    return _candidate(name, setting, columns, choices, sizes)


def _candidate(name: str, setting: Setting, columns: Sequence[Column], choices: int, sizes: Mapping[str, float] | None = None) -> Candidate:
    effect = EFFECTS[registry_name(name, setting)]
    typical = {p.name: p.typical for p in effect.parameters if p.name not in setting}
    # a share multiplies an effect whose size is its setting: it is one when that is right
    prior = {c.name: _PRIOR_WIDTH * typical[of] if (of := parameter_of(c.name)) in typical else 1.0 for c in columns}
    if sizes is None:
        prior |= {c.name: UNEQUAL * _PRIOR_WIDTH * max(typical.values()) for c in columns if c.name.startswith(REST)}
    else:
        own = max((abs(size) for parameter, size in sizes.items() if not parameter.startswith(SKEW)), default=0.0)
        prior |= {c.name: UNEQUAL * own for c in columns if c.name.startswith(SKEW)}
    return Candidate(name, setting, tuple(columns), np.array([prior[c.name] for c in columns]), choices)
