"""An effect's own columns added to the equations of a campaign that was recorded without it.

The recordings' noise, floors and nuisances are those of whatever device made them, and its plan; the effect has the form that the diagnosis
believes in. So it says what recordings of a device can tell, not whether the form is right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..gap.column import Column
from ..gap.columns import form_columns
from ..gap.forms import FORMS
from ..gap.linear_device import target_of
from ..gap.model import CampaignModel
from ..gap.screen import Screener
from .labels import reported_name
from .sizing import Sized

__all__ = ["with_columns", "with_effect"]


def with_columns(model: CampaignModel, parts: Sequence[tuple[Column, float]]) -> CampaignModel:
    """The campaign with so much of each column beside what is there.

    Parameters
    ----------
    model : CampaignModel
    parts : sequence of (Column, float)
        Size in the column's own unit.
    """
    recordings = []
    for k, r in enumerate(model.evidence):
        more = sum(size * column.signal[k] for column, size in parts)
        recordings.append(replace(r, signal=replace(r.signal, lhs=r.signal.lhs + more / r.turn)))
    evidence = replace(model.evidence, recordings=tuple(recordings))
    screener = Screener(model.whitener, model.nuisances, target_of(evidence, model.linear.angular_gain))
    return replace(model, evidence=evidence, screener=screener)


def with_effect(model: CampaignModel, sized: Sized) -> CampaignModel:
    """The campaign of a device that has an effect of a size."""
    name = reported_name(sized.name)
    setting = dict(sized.sizes)
    if FORMS[name].per_axis:
        setting["axes"] = float(name != sized.name)
    # of an effect whose setting is its size, a level or a lag, all of the column
    columns = form_columns(model.evidence, FORMS[name], model.linear, setting)
    return with_columns(model, [(c, sized.sizes.get(c.name, 1.0)) for c in columns])
