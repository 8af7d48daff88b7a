"""Steps of the drives' converter: what rounding adds to a carrier, and whether it is named where samples show the grid."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from table_samples import on_a_table, table_model

from gyro_calib.gap.coarse_drive import NAME, _form, rounded, with_coarse_drive
from gyro_calib.gap.columns import form_columns
from gyro_calib.gap.diagnose import _loudest_first
from gyro_calib.gap.model import CampaignModel
from gyro_calib.gap.select import select_effects
from gyro_calib.gap.signals import Signals
from gyro_calib.gap.spectral_effects import SpectralEffects, found_beside, spectral_effects
from gyro_calib.gap.system import NoiseByRole
from gyro_calib.gap.unseen_steps import _held_v, _sizes, with_unseen_steps
from gyro_calib.quantity import Quantity
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
    return table_model()


def sampled(lsb_v: float, noise: float = 0.1) -> list[Recording]:
    """With drives as a converter of such steps makes them."""
    rng, found = np.random.default_rng(5), []
    for r in on_a_table():
        t = np.arange(2000) / 200e3
        drive = 0.7 * np.cos(2.0 * np.pi * 15e3 * t) + noise * lsb_v * rng.standard_normal(t.size)
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


def test_steps_that_noise_covers_are_told_by_the_noise_that_they_make() -> None:
    """Beside noise of steps a drive is as if it were not rounded, and its waves are as loud as q^2/12 a sample makes them."""
    gain, white = float(np.abs(np.diag(model().linear.G)).max()), 1e-10
    lsb = float(np.sqrt(12.0 * white * 200e3 / 2.0)) / gain
    for share, full_scale_v, said in ((0.2, 5.0, "present"), (0.01, 5.0, "excluded"), (0.2, 50.0, "excluded")):
        loud = {key: replace(law, coefficients=(white / share, *law.coefficients[1:])) for key, law in model().noise.items()}
        of, recordings = replace(model(), noise=cast(NoiseByRole, loud)), sampled(lsb, 3.0)
        found = with_coarse_drive(spectral_effects(recordings, of.linear, ()), of, recordings, (), full_scale_v)
        assert status(found) == [said]


def test_a_tone_within_half_a_step_of_the_drives_is_what_rounding_makes() -> None:
    """It goes with what is like it and with the recordings that stood beside it; one of more volts stays."""
    (column,) = form_columns(model().evidence, _form(LSB_V, NOISE), model().linear, {})
    coarse = with_columns(model(), [(column, 1.0)])
    recordings = sampled(LSB_V)
    healthy = spectral_effects(recordings, coarse.linear)
    for volts, stays in ((0.2 * LSB_V, False), (0.8 * LSB_V, True)):
        sizes = {"a_x": Quantity(volts, 1e-5, "V"), "a_y": Quantity(0.0, 1e-5, "V")}
        tone = found_beside("external_tone", sizes, 100.0)
        standings = tuple(replace(s, status="present") if s.name == "external_tone" else s for s in healthy.standings)
        beside = replace(healthy, effects=(tone,), standings=standings, near=(3,))
        found = with_coarse_drive(beside, coarse, recordings, ())
        assert [e.name for e in found.effects] == (["external_tone"] if stays else []) + ["drive_quantisation"]
        (said,) = (s.status for s in found.standings if s.name == "external_tone")
        assert said == ("present" if stays else "excluded")
        assert found.near == ((3,) if stays else ())


@pytest.mark.slow
def test_steps_that_no_sample_shows_are_found_by_their_size_alone() -> None:
    """Where something without a name is there; what is better said by it, and a device without steps, have none."""
    volts = max(float(np.abs(r.signals.drive).max()) for r in model().evidence if r.is_wave)
    lsb, noise = volts / 13.2, 0.3
    (column,) = form_columns(model().evidence, _form(lsb, noise), model().linear, {})
    coarse = with_columns(model(), [(column, 1.0)])
    selection = select_effects(coarse)
    assert selection.stranger is not None
    beside = spectral_effects(on_a_table(), coarse.linear, ())
    found = with_unseen_steps(beside, coarse, selection, ())
    assert [e.name for e in found.effects] == [NAME]
    size = found.effects[0].parameters["lsb"]
    assert abs(size.value - lsb) < 3.0 * size.sd
    assert size.sd < 0.01 * lsb
    assert status(found) == ["present"]
    assert with_unseen_steps(beside, coarse, selection, (NAME,)) == beside
    assert with_unseen_steps(beside, coarse, replace(selection, stranger=None), ()) == beside
    loud = replace(selection, chi2_before=selection.chi2_before + 2.0 * found.effects[0].gain)
    assert with_unseen_steps(beside, coarse, loud, ()) == beside
    assert with_unseen_steps(beside, model(), selection, ()) == beside


def test_a_drive_that_swings_sets_no_size_of_steps() -> None:
    """A virtual precession of three volts hid steps of 20 mV: a fortieth of its own was the least that was looked for."""
    swinging = 3.0 * np.cos(np.linspace(0.0, 20.0, 1000))
    held = SimpleNamespace(drive=np.stack([np.full(1000, 0.8j), swinging], axis=1))
    assert _held_v(cast(Signals, held)) == pytest.approx(0.8)
    assert min(_sizes(0.8)) < 0.0196 < max(_sizes(0.8))


def test_the_loudest_finding_is_the_first_wherever_it_shows() -> None:
    size = {"size": Quantity(1.0, 0.1, "1")}
    made = tuple(
        found_beside(name, size, gain) for name, gain in (("thermal_drive_gain", 32.0), ("external_tone", 14042.0), ("duffing", 50.0))
    )
    assert [e.name for e in _loudest_first(made)] == ["external_tone", "duffing", "thermal_drive_gain"]
