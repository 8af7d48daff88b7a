"""The equations of a healthy device's campaign with something of an effect's own columns added."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gyro_calib.gap.columns import Column
from gyro_calib.gap.linear_device import target_of
from gyro_calib.gap.model import CampaignModel
from gyro_calib.gap.screen import Screener

__all__ = ["with_effects"]


def with_effects(model: CampaignModel, columns: Sequence[Column], snrs: float | Sequence[float]) -> CampaignModel:
    """The campaign with each of these beside what is there, as large as makes it its ratio to the noise beside the nuisances."""
    each = np.broadcast_to(snrs, len(columns))
    sizes = [snr / float(np.linalg.norm(model.screener.projected([c])[0])) for c, snr in zip(columns, each, strict=True)]
    added = [sum(size * c.signal[k] for size, c in zip(sizes, columns, strict=True)) for k in range(len(model.evidence))]
    recordings = tuple(
        replace(r, signal=replace(r.signal, lhs=r.signal.lhs + more / r.turn)) for r, more in zip(model.evidence, added, strict=True)
    )
    evidence = replace(model.evidence, recordings=recordings)
    screener = Screener(model.whitener, model.nuisances, target_of(evidence, model.linear.angular_gain))
    return replace(model, evidence=evidence, screener=screener)
