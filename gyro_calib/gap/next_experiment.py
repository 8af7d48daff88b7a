"""What to record next: to tell apart what these data cannot, or to make testable what they do not vary."""

from __future__ import annotations

from collections.abc import Sequence

from ..effects import EFFECTS
from .diagnosis import Alternative, NextExperiment, Standing
from .model import CampaignModel
from .select import Selection

__all__ = ["next_experiment"]

#: what to do so that recordings vary what an effect needs
_RECIPES = {
    "temperature": "Repeat the static recordings on both axes with the temperature ramped by 10 K and held",
    "rate": "Repeat a static recording on a rate table with steps of 10, 30 and 60 deg/s of both signs",
    "amplitudes": "Repeat the recordings at two further amplitudes, a third lower and a third higher",
    "large drive": "Record virtual precession or a ring-up at twice the drive",
    "open drive": "Record open drive of each axis at +-20 and +-60 Hz from resonance, loops off",
    "side bands": "Record side bands at 0.1, 0.5, 1 and 1.5 Hz on both axes",
    "time": "Repeat the first static recording at the end, and once more after an hour",
    "azimuth": "Record virtual precession of both senses over whole turns",
}


def next_experiment(model: CampaignModel, selection: Selection, lines: Sequence[Standing]) -> NextExperiment:
    """The recipe that serves most of the effects that are alike or untestable."""
    doubtful = tuple(dict.fromkeys(name for group in selection.groups if len(group) > 1 for name in group))
    purpose = "tell apart " + ", ".join(doubtful) if doubtful else "test what these recordings do not vary"
    served = doubtful or tuple(s.name for s in lines if s.status in ("not testable", "cannot tell"))
    votes: dict[str, list[str]] = {}
    for name in served:
        for need in EFFECTS[name].needs:
            if need in _RECIPES:
                votes.setdefault(need, []).append(name)
    if not votes:
        return NextExperiment("Nothing further is needed: repeat the campaign after some months, or after a change.", "watch for ageing")
    ranked = sorted(votes.items(), key=lambda item: -len(item[1]))
    best = ranked[0]
    return NextExperiment(
        description=_RECIPES[best[0]] + ".",
        purpose=purpose,
        splits=tuple(best[1]),
        alternatives=tuple(Alternative(_RECIPES[need] + ".", tuple(names), 0.0) for need, names in ranked[1:4]),
    )
