"""Steps of the drives' converter: what rounding adds to a carrier, and whether it is named where samples show the grid."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from table_samples import looked_at, on_a_table

from gyro_calib.gap.coarse_drive import _form, rounded, with_coarse_drive
from gyro_calib.gap.columns import form_columns
from gyro_calib.gap.model import CampaignModel
from gyro_calib.gap.spectral_effects import SpectralEffects, spectral_effects
from gyro_calib.recording.recording import Recording
from gyro_calib.trial.injected import with_columns

LSB_V, NOISE = 0.02, 0.2


@pytest.mark.parametrize("noise", [0.1, 0.2, 0.3])
def test_what_rounding_adds_to_a_carrier_is_the_series(noise: float) -> None:
    """Against samples drawn: amplitudes below a step and of many."""
    rng = np.random.default_rng(7)
    phase = rng.uniform(0.0, 2.0 * np.pi, 1_000_000)
    for amplitude in (0.3, 0.9, 1.4, 7.25, 30.5):
        x = amplitude * np.cos(phase) + noise * rng.standard_normal(phase.size)
        drawn = 2.0 * float(np.mean((np.round(x) - x) * np.cos(phase)))
        assert rounded(np.array([amplitude]), 1.0, noise)[0] == pytest.approx(drawn, abs=4.0 * np.sqrt(2.0 / 12.0 / phase.size))


@cache
def model() -> CampaignModel:
    return looked_at(on_a_table())


def sampled(lsb_v: float) -> list[Recording]:
    """With drives as a converter of such steps makes them."""
    rng, found = np.random.default_rng(5), []
    for r in on_a_table():
        t = np.arange(2000) / 200e3
        drive = 0.7 * np.cos(2.0 * np.pi * 15e3 * t) + 0.1 * lsb_v * rng.standard_normal(t.size)
        found.append(replace(r, raw={"t": t, "x_drive": lsb_v * np.round(drive / lsb_v) if lsb_v else drive}))
    return found


def findings(lsb_v: float, of: CampaignModel, without: tuple[str, ...] = ()) -> SpectralEffects:
    recordings = sampled(lsb_v)
    return with_coarse_drive(spectral_effects(recordings, of.linear, without), of, recordings, without)


def status(found: SpectralEffects) -> list[str]:
    return [s.status for s in found.standings if s.name == "drive_quantisation"]


def test_steps_that_the_slow_flow_shows_are_named_with_the_size_that_the_samples_have() -> None:
    (column,) = form_columns(model().evidence, _form(LSB_V, NOISE), model().linear, {})
    coarse = with_columns(model(), [(column, 1.0)])
    found = findings(LSB_V, coarse)
    assert [e.name for e in found.effects] == ["drive_quantisation"]
    assert found.effects[0].parameters["lsb"].value == pytest.approx(LSB_V, rel=1e-6)
    assert found.products > found.effects[0].gain
    assert status(found) == ["present"]
    assert findings(LSB_V, coarse, ("drive_quantisation",)).effects == ()
    # no samples, no grid: nothing is known of a converter
    assert status(findings(0.0, coarse)) == ["not testable"]


def test_steps_that_do_nothing_are_no_effect() -> None:
    """As of a record whose columns are what the converter made."""
    found = findings(LSB_V, model())
    assert found.effects == ()
    assert status(found) == ["excluded"]
