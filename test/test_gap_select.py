"""What counts beside a loud effect: first order leaves something of that one, but little that goes with the campaign's time."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest

from gyro_calib.gap.screen import Candidate, Screened
from gyro_calib.gap.select import _enough

LOUD = 2.5e7


def screened(name: str, gain: float) -> Screened:
    candidate = Candidate(name, {}, (), np.zeros(0))
    return Screened(candidate, gain, 1, 0.5 * gain, np.zeros(1), np.ones(1), 0.0, cast(np.ndarray, np.zeros((1, 1))))


@pytest.mark.parametrize(
    ("name", "share", "beside", "counts"),
    [
        ("pickoff_nonlinearity", 0.0045, "nonlinear_damping", False),
        ("pickoff_nonlinearity", 0.006, "nonlinear_damping", True),
        # a charge of 113 000 beside a damping of 25 million was none
        ("charge_accumulation", 0.0045, "nonlinear_damping", True),
        ("charge_accumulation", 0.0003, "nonlinear_damping", False),
        ("charge_accumulation", 0.0045, "drive_gain_drift", False),
    ],
)
def test_what_first_order_leaves_keeps_to_no_time(name: str, share: float, beside: str, counts: bool) -> None:
    assert _enough(screened(name, share * LOUD), screened(beside, LOUD)) is counts


def test_alone_an_effect_counts_by_its_evidence() -> None:
    assert _enough(screened("duffing", 40.0))
    assert not _enough(screened("duffing", 20.0))
