"""The equations of a healthy device's campaign with something added that is so many times louder than the noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gyro_calib.gap.column import Column
from gyro_calib.gap.model import CampaignModel
from gyro_calib.trial.injected import with_columns

__all__ = ["with_effects"]


def with_effects(model: CampaignModel, columns: Sequence[Column], snrs: float | Sequence[float]) -> CampaignModel:
    """The campaign with each of these beside what is there, as large as makes it its ratio to the noise beside the nuisances."""
    norms = np.linalg.norm(model.screener.projected(columns)[0], axis=0)
    return with_columns(model, list(zip(columns, np.broadcast_to(snrs, len(columns)) / norms, strict=True)))
