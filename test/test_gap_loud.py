"""A recording that is louder than others of its kind."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from gyro_calib.gap.loud import loudest
from gyro_calib.gap.model import CampaignModel


def model(excess: dict[tuple[int, str], float], turned: int = -1) -> CampaignModel:
    recordings = [
        SimpleNamespace(
            index=k,
            signal=SimpleNamespace(lhs=np.zeros(20, dtype=complex)),
            recording=SimpleNamespace(label=f"run_{k}", extras={"applied_rate": {}} if k == turned else {}),
        )
        for k in range(4)
    ]
    return cast(CampaignModel, SimpleNamespace(evidence=recordings, excess=excess))


@pytest.mark.parametrize("excess", [{}, {(0, "amplitude"): 4.4, (3, "quadrature"): 7.9}])
def test_recordings_of_one_kind_differ_by_some_times_their_noise(excess: dict[tuple[int, str], float]) -> None:
    assert loudest(model(excess)) is None


def test_the_loudest_is_named_with_its_channel_and_what_to_do() -> None:
    loud = loudest(model({(1, "amplitude"): 42.9, (1, "quadrature"): 10.7, (2, "precession"): 3.9}))
    assert loud is not None
    assert "run_1 holds 43 times the noise of its kind (amplitude)" in loud.warning()
    assert "Record it again" in loud.warning()
    unknown = loud.unknown()
    assert (unknown.depends_on, unknown.nearest) == ("recording", "")


def test_a_rate_table_does_things_besides_its_log() -> None:
    assert loudest(model({(2, "precession"): 50.0}, turned=2)) is None
