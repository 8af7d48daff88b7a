"""A converter's hold on a drive whose envelope changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from recording_samples import make_recording

from gyro_calib.estimation.projection import hold_delay
from gyro_calib.recording.recording import Recording


@pytest.fixture
def recording() -> Recording:
    return make_recording()


def test_a_held_tone_beside_the_carrier_is_late_and_smaller_as_the_staircase_is(recording: Recording) -> None:
    """The fundamental of the staircase itself, summed sample by sample, at two frequencies near the carrier."""
    hold, omega0 = 1.0 / 22000.0, 2.0 * np.pi * 5000.0

    def passed(omega: float) -> complex:
        # mean of the held sample against the tone over one hold
        t = (np.arange(20000) + 0.5) / 20000.0 * hold
        return complex(np.mean(np.exp(-1j * omega * t)))

    step = 2.0 * np.pi * 5.0
    slope = (np.log(passed(omega0 + step)) - np.log(passed(omega0 - step))) / (2.0 * step)
    # an envelope e^{i d t} passes as 1 - i d (delay)
    found = hold_delay(replace(recording, extras={**recording.extras, "dac_zero_order_hold_s": hold}), omega0)
    assert found == pytest.approx(1j * slope, rel=1e-4)
    assert hold_delay(replace(recording, extras={}), omega0) == 0.0
