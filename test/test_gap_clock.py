"""Rows whose second is not that of the reference: two crystals part by tens of ppm, and no effect of a device is named for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from table_samples import looked_at, on_a_table, table_model

from gyro_calib.gap.model import CampaignModel
from gyro_calib.gap.screen import Candidate, Screened, Screener

#: of the rows' clock over that of the reference: ten times what a healthy device may have, for a quick campaign tells it to 2e-5
LATE = 4e-4


def clock_of(model: CampaignModel) -> Screened:
    """The share of the motion's speed that says most beside the other nuisances."""
    (column,) = (c for c in model.nuisances if c.name == "clock")
    others = [c for c in model.nuisances if c is not column]
    found = Screener(model.whitener, others, model.target).screen(Candidate("clock", {}, (column,), np.ones(1)))
    assert found is not None
    return found


@pytest.mark.slow
def test_a_clock_beside_that_of_the_reference_is_a_share_of_the_speed() -> None:
    """Taken for none it was a supply that sags: the gain by side bands was another than that of the open drives."""
    campaign = on_a_table()
    late = replace(campaign, recordings=tuple(replace(r, sample_rate_hz=r.sample_rate_hz / (1.0 + LATE)) for r in campaign))
    found, before = clock_of(looked_at(late)), clock_of(table_model())
    assert abs(before.values[0]) < 4.0 * before.sd[0] < 0.3 * LATE
    assert found.values[0] - before.values[0] == pytest.approx(-LATE, abs=4.0 * found.sd[0])
    assert found.gain > 50.0
