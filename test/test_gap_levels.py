"""A dead zone beside the noise of the loops, against noise drawn period by period."""

from __future__ import annotations

import numpy as np
import pytest

from gyro_calib.gap.levels import dead, lost_in_noise


@pytest.mark.parametrize("over_noise", [0.0, 0.3, 1.0, 3.0, 20.0])
def test_noise_dithers_a_dead_zone(over_noise: float) -> None:
    """A zone a hundredth of the noise: the mean of what it takes from each period, at any phase of the drive."""
    noise_v, level_v = 1e-2, 1e-4
    rng = np.random.default_rng(8)
    drive = over_noise * noise_v * np.exp(0.7j)
    drawn = noise_v * (rng.standard_normal(400_000) + 1j * rng.standard_normal(400_000))
    taken = dead(drive + drawn, level_v).mean()
    told = level_v * lost_in_noise(np.array([drive]), noise_v)[0]
    # the mean of so many directions, and the zone's hundredth of the noise beside a zone of none
    assert abs(taken - told) < 4.0 * (4.0 / np.pi) * level_v / np.sqrt(drawn.size) + 0.01 * abs(told)


def test_without_noise_all_amplitudes_lose_alike() -> None:
    drives = np.array([0.01, 0.3, 2.0]) * np.exp([0.0j, 1.0j, 2.0j])
    np.testing.assert_allclose(lost_in_noise(drives, 1e-5), -4.0 / np.pi * drives / np.abs(drives), rtol=1e-5)
