"""Steps of a converter read off its samples: their size, and whether the noise dithers them."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray
from spectra_samples import LINEAR, records

from gyro_calib.gap.converter_steps import ConverterSteps, converter_steps, step_of
from gyro_calib.gap.heldout import Shrinkage
from gyro_calib.gap.spectral_effects import spectral_effects
from gyro_calib.gap.summary import summary_of
from gyro_calib.recording.recording import Recording

LSB_V = 7.63e-5


def samples(rng: np.random.Generator, noise_v: float, amplitude_v: float = 0.9) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Time and volts of a carrier whose envelope moves a little, 4096 samples."""
    t = np.arange(4096) / 60e3
    return t, amplitude_v * (1.0 + 1e-4 * t) * np.cos(2 * np.pi * 5000.3 * t + 0.4) + noise_v * rng.standard_normal(t.size)


def recorded(noise_v: float, lsb_v: float, hum_v: float = 0.0) -> list[Recording]:
    rng, found = np.random.default_rng(3), []
    for r in records(rng, carrier_hz=(5000.3,), hum=(50.0, hum_v)):
        (t, x), (_, y) = samples(rng, noise_v), samples(rng, noise_v, 0.002)
        raw = {"t": t, "x_pick": x, "y_pick": y}
        if lsb_v:
            raw |= {name: lsb_v * np.round(raw[name] / lsb_v) for name in ("x_pick", "y_pick")}
        found.append(replace(r, raw=raw))
    return found


@pytest.mark.parametrize("lsb_v", [3e-7, LSB_V, 2e-3])
def test_a_step_is_read_to_many_digits(lsb_v: float) -> None:
    _, x = samples(np.random.default_rng(1), 3e-5)
    for offset in (0.0, 0.37 * lsb_v):
        assert step_of(lsb_v * np.round(x / lsb_v) + offset) == pytest.approx(lsb_v, rel=1e-6)
    single = (lsb_v * np.round(x / lsb_v)).astype(np.float32).astype(float)
    found = step_of(single)
    assert found is None if lsb_v < 1e-6 else found == pytest.approx(lsb_v, rel=1e-2)


def test_samples_on_no_grid_have_no_step() -> None:
    for seed in range(20):
        assert step_of(samples(np.random.default_rng(seed), 3e-5)[1]) is None
    assert step_of(np.zeros(4096)) is None
    assert converter_steps(records(np.random.default_rng(2))) is None


@pytest.mark.parametrize(("noise_v", "undithered"), [(0.2 * LSB_V, True), (0.4 * LSB_V, True), (0.7 * LSB_V, False), (5.0 * LSB_V, False)])
def test_noise_of_half_a_step_dithers_it(noise_v: float, undithered: bool) -> None:
    steps = converter_steps(recorded(noise_v, LSB_V))
    assert steps is not None
    assert steps.lsb_v == pytest.approx(LSB_V, rel=1e-6)
    assert abs(steps.lsb_v - LSB_V) < 2.0 * steps.lsb_sd_v
    assert steps.undithered is undithered


def test_coarse_steps_are_named_with_their_size() -> None:
    found = spectral_effects(recorded(0.3 * LSB_V, LSB_V), LINEAR)
    assert [e.name for e in found.effects] == ["pickoff_quantisation"]
    assert found.effects[0].parameters["lsb"].value == pytest.approx(LSB_V, rel=1e-6)
    # what the slow flow names beside them is not told from what rounding does
    assert found.products > 100.0
    assert "leaves the means of the slow flow alone" not in summary_of("effects", found.effects, None, cast(Shrinkage, None))
    assert spectral_effects(recorded(0.3 * LSB_V, LSB_V), LINEAR, ["pickoff_quantisation"]).effects == ()


def test_what_rounding_says_grows_as_the_noise_dithers_it_less() -> None:
    """The error that follows a sine, beside noise of s steps, drawn; its square over the noise's against the law."""
    rng, law, drawn = np.random.default_rng(4), [], []
    phase = rng.uniform(0.0, 2.0 * np.pi, 2_000_000)
    for s in (0.15, 0.25, 0.3):
        follows = []
        # the error goes to and fro with the amplitude: over a step's worth of them
        for amplitude in 5.0 + np.linspace(0.0, 1.0, 12, endpoint=False):
            x = amplitude * np.cos(phase) + s * rng.standard_normal(phase.size)
            follows.append(2.0 * float(np.mean((np.round(x) - x) * np.cos(phase))))
        drawn.append(float(np.mean(np.square(follows))) / s**2)
        law.append(ConverterSteps(1.0, 0.0, 1.0 / np.hypot(s, np.sqrt(1.0 / 12.0))).rounded_gain)
    assert np.diff(np.log(law)) == pytest.approx(np.diff(np.log(drawn)), abs=0.35)


def test_a_line_within_a_step_is_what_rounding_makes() -> None:
    small, large = (recorded(0.3 * LSB_V, LSB_V, hum_v) for hum_v in (2e-5, 2e-4))
    assert [e.name for e in spectral_effects(small, LINEAR).effects] == ["pickoff_quantisation"]
    assert [e.name for e in spectral_effects(large, LINEAR).effects] == ["mains_pickup", "pickoff_quantisation"]
    assert [e.name for e in spectral_effects(recorded(0.7 * LSB_V, LSB_V, 2e-5), LINEAR).effects] == ["mains_pickup"]


def test_whether_steps_can_be_told_is_said() -> None:
    def said(recordings: list[Recording]) -> str:
        return next(s.status for s in spectral_effects(recordings, LINEAR).standings if s.name == "pickoff_quantisation")

    assert said(recorded(5.0 * LSB_V, LSB_V)) == "excluded"
    assert said(recorded(5.0 * LSB_V, 0.0)) == "excluded"
    assert said(records(np.random.default_rng(4))) == "not testable"
