"""Where between two bins a line stands: its frequency, and the standard deviation that is claimed."""

from __future__ import annotations

import numpy as np
import pytest
from spectra_samples import LINEAR, records

from gyro_calib.gap.spectra import pick_spectra
from gyro_calib.gap.tones import Tone, find_tone


def found(seed: int, hz: float, volts: float) -> Tone:
    tone = find_tone(pick_spectra(records(np.random.default_rng(seed), hum=(hz, volts))), LINEAR)
    assert tone is not None
    return tone


@pytest.mark.parametrize("volts", [3e-6, 3e-5])
def test_a_line_between_two_bins_is_told_as_well_as_is_claimed(volts: float) -> None:
    """At the third of a bin that is farthest from what bins of these records have; sixteen draws of the noise."""
    tones, hz = [found(seed, 24.155, volts) for seed in range(16)], 24.155
    z = np.array([(t.frequency_hz - hz) / t.frequency_sd_hz for t in tones])
    # chi-square of sixteen: 5.1 to 34.3 at one in two hundred to either side
    assert 5.1 < float(z @ z) < 34.3
    assert abs(float(z.mean())) < 3.0 / np.sqrt(len(z))


def test_a_louder_line_is_told_better_in_proportion() -> None:
    faint, loud = found(3, 24.155, 3e-6), found(3, 24.155, 3e-5)
    assert faint.frequency_sd_hz / loud.frequency_sd_hz == pytest.approx(10.0, rel=0.2)


def test_the_size_between_two_bins_is_that_on_a_bin() -> None:
    sizes = [float(np.max(found(3, hz, 3e-5).volts)) for hz in (24.0, 24.05, 24.155)]
    assert np.ptp(sizes) < 0.02 * sizes[0]
