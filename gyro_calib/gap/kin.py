"""Which effect of the registry comes nearest to something without a name: the one that imitates most of what it shows."""

from __future__ import annotations

import numpy as np

from .model import CampaignModel
from .screen import Candidate

__all__ = ["nearest_known"]

#: share of what an unnamed term shows that an effect must imitate to be called near
_NEAR = 0.25


def nearest_known(model: CampaignModel, unnamed: Candidate) -> str:
    """Name of the effect, or "" where none is near.

    What explains most of the data is not what is most like the term: a drive that goes to and fro every 47 s had a skew of the channels.

    Parameters
    ----------
    model : CampaignModel
    unnamed : Candidate
        As it shows beside the nuisances alone.
    """
    screener = model.screener
    found = screener.screen(unnamed)
    if found is None:
        return ""
    shown = found.directions @ (found.directions.T @ screener.left)
    imitated: dict[str, float] = {}
    for r in screener.screened(c for tried in model.candidates.values() for c in tried):
        imitated[r.name] = max(imitated.get(r.name, 0.0), float(np.sum((r.directions.T @ shown) ** 2)))
    name = max(imitated, key=imitated.__getitem__, default="")
    return name if name and imitated[name] > _NEAR * float(shown @ shown) else ""
