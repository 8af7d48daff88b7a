"""Lines that no record shows by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from spectra_samples import LINEAR, records

from gyro_calib.gap.spectra import pick_spectra
from gyro_calib.gap.tones import find_tone
from gyro_calib.recording.columns import COLUMNS


def test_a_tone_that_no_record_shows_by_itself_stands_in_all_of_them() -> None:
    for seed in range(3):
        spectra = pick_spectra(records(np.random.default_rng(seed), tone=(15041.7, 1.3e-7), of_each=10))
        # a bin of noise alone has one of a hundred above 4.6
        assert np.median([s.at(np.array([15041.7 - s.carrier_hz]))[0, 0] for s in spectra]) < 8.0
        tone = find_tone(spectra, LINEAR)
        assert tone is not None
        assert tone.name == "external_tone"
        assert tone.frequency_hz == pytest.approx(15041.7, abs=0.1)
        assert tone.volts[0] == pytest.approx(1.3e-7 * 2 * np.pi * 41.55 / 8.0, abs=4.0 * tone.volts_sd[0])
        assert tone.volts_sd[0] < 0.2 * tone.volts[0]
        assert tone.volts[1] < 0.5 * tone.volts[0]


@pytest.mark.parametrize("seed", range(3))
def test_what_some_records_show_faintly_is_no_line_of_all(seed: int) -> None:
    """Loops in three records of a healthy hemisphere answered at 2.5 Hz: that mean of 104 bins, of which twelve held it, was a hum."""
    plain, places = records(np.random.default_rng(seed), of_each=10), [4, 7, 12, 22, 25]
    for k in places:
        hum = 4.5e-7 * np.cos(2 * np.pi * 25.0 * plain[k].t)[:, None] * np.isin(np.arange(len(COLUMNS)), (2, 4))
        plain[k] = replace(plain[k], data=plain[k].data + hum)
    spectra = pick_spectra(plain)
    power = np.array([s.at(np.array([25.0, -25.0])).mean() for s in spectra])
    assert power[places].min() > 4.0 > 1.5 > np.delete(power, places).mean()
    assert find_tone(spectra, LINEAR) is None


@pytest.mark.parametrize("seed", range(3))
def test_what_one_of_three_records_shows_is_no_line_of_all(seed: int) -> None:
    """Of a hemisphere three records heard 2.6 Hz, one of a wave that warmed showed it four times: that was a hum of 17 in log evidence."""
    plain = records(np.random.default_rng(seed), of_each=1)[:3]
    hum = 9e-7 * np.cos(2 * np.pi * 25.0 * plain[1].t)[:, None] * np.isin(np.arange(len(COLUMNS)), (2, 4))
    plain[1] = replace(plain[1], data=plain[1].data + hum)
    spectra = pick_spectra(plain)
    power = [s.at(np.array([25.0, -25.0])).mean() for s in spectra]
    assert power[1] > 8.0 > 3.0 > max(power[0], power[2])
    assert find_tone(spectra, LINEAR) is None
