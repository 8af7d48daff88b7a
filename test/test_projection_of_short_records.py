"""A ring-down of a third of a second is projected as well as one of ten."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gyro_calib.estimation.wave_projection import thinning
from gyro_calib.gap.signals import Signals
from gyro_calib.recording.columns import COLUMNS
from gyro_calib.recording.command import Command, Setpoints
from gyro_calib.recording.recording import Recording

DECAY_S = 2.06


def falling(rate_hz: float, rows: int) -> Recording:
    """A wave that falls exactly as its damping has it, without drive."""
    data = np.zeros((rows, len(COLUMNS)))
    data[:, 0] = np.arange(rows) / rate_hz
    data[:, COLUMNS.index("x_pick_c")] = np.exp(-DECAY_S * data[:, 0])
    data[:, COLUMNS.index("ref_freq")], data[:, COLUMNS.index("temperature")] = 7000.0, 25.0
    return Recording("ring_down_x", data, Command("ftr_x", setpoints=Setpoints(amplitude_v=1.0)), rate_hz, "r")


@pytest.mark.parametrize(("rate_hz", "rows"), [(1000.0, 330), (1000.0, 1000), (500.0, 200), (250.0, 5000)])
def test_an_exact_decay_leaves_nothing(rate_hz: float, rows: int) -> None:
    r = falling(rate_hz, rows)
    signals = Signals(r, 2.0 * math.pi * 7000.0, DECAY_S, thinning(r), 25.0, 0.0)
    assert signals.pick.shape[0] >= min(rows, 115)
    step = 1.0 / r.duration_s
    projector = signals.projector([k * step for k in range(4)])
    left = projector.through_flow([signals.pick]) - projector.plain([-DECAY_S * signals.pick])
    # the imaginary part holds the square of the decay over the carrier's; 31 rows of the shortest left 4e-4
    assert np.abs(left.real).max() < 1e-7


def test_long_records_are_thinned_to_a_hundred_rows_a_second() -> None:
    assert [thinning(falling(rate, rows)) for rate, rows in ((1000.0, 20_000), (250.0, 5000), (100.0, 3000), (1000.0, 330))] == [
        10,
        2,
        1,
        2,
    ]
