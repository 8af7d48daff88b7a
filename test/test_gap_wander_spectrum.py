"""What of a wave's frequency is wander, by one spectrum of all recordings, on walks that the test draws."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from gyro_calib.gap.wander import Spectrum, harmonics_of

FloatArray = NDArray[np.float64]
ROW_S, ROWS, RECORDS = 0.01, 1900, 8
ROWS_S = dict.fromkeys(range(RECORDS), ROW_S)
#: azimuths of waves that turn once in a recording, to either side
AZIMUTHS = {k: (1.0 if k % 2 else -1.0) * 2.0 * np.pi * np.arange(ROWS) / ROWS + 0.1 * k for k in range(RECORDS)}


def wanders(rng: np.random.Generator, step: float = 4e-3) -> dict[int, FloatArray]:
    """Random walks of a resonance [rad/s], ``step`` in a second."""
    return {k: np.cumsum(rng.standard_normal(ROWS)) * step * np.sqrt(ROW_S) for k in range(RECORDS)}


def noisy(wander: dict[int, FloatArray], rng: np.random.Generator, phase_rad: float = 3e-5) -> dict[int, FloatArray]:
    """With the phase noise of pick-offs, of which a frequency is the slope."""
    return {k: x + np.diff(rng.standard_normal(x.size + 1)) * phase_rad / ROW_S for k, x in wander.items()}


def test_a_spectrum_is_that_of_the_walk_and_of_the_pick_offs() -> None:
    rng = np.random.default_rng(1)
    found = Spectrum.of(noisy(wanders(rng), rng, 1e-3), ROWS_S)
    assert found.walk == pytest.approx(2.0 * 4e-3**2 / (2.0 * np.pi) ** 2, rel=0.25)
    assert found.pickoff == pytest.approx(2.0 * ROW_S * (2.0 * np.pi * 1e-3) ** 2, rel=0.25)


def test_a_wander_is_followed_as_fast_as_the_wave_turns() -> None:
    """Of what is faster than the recording as well: less than a fifth of the walk about its line is left."""
    rng = np.random.default_rng(2)
    wander = wanders(rng)
    read = noisy(wander, rng)
    spectrum = Spectrum.of(read, ROWS_S)
    line = np.column_stack([np.ones(ROWS), np.arange(ROWS)])
    for k, x in wander.items():
        straight = line @ np.linalg.lstsq(line, x, rcond=None)[0]
        assert np.std(spectrum.wander(read[k], ROW_S) - x) < 0.2 * np.std(x - straight)


@pytest.mark.parametrize(("size", "told"), [(0.0, False), (0.02, True)])
def test_what_goes_with_the_azimuth_is_the_device_s_beyond_chance(size: float, told: bool) -> None:
    """Of walks alone a harmonic is as large as 1.7 mrad/s, and it is the resonance that moved."""
    rng = np.random.default_rng(3)
    courses = {k: x + size * np.cos(2.0 * AZIMUTHS[k]) for k, x in noisy(wanders(rng), rng).items()}
    spectrum = Spectrum.of(courses, ROWS_S)
    found = harmonics_of(AZIMUTHS, courses, ROWS_S, spectrum)
    assert bool(found) is told
    for k, x in found.items():
        assert np.std(x - size * np.cos(2.0 * AZIMUTHS[k])) < 0.3 * size / np.sqrt(2.0)


def test_no_recordings_have_no_wander() -> None:
    assert Spectrum.of({}, {}) == Spectrum(0.0, 0.0, 0.0, 0.0)
    assert harmonics_of({}, {}, {}, Spectrum(1.0, 0.0, 0.0, 0.0)) == {}
