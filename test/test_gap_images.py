"""The image of a held voltage that stands still beside a resonance, against converters' samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray
from table_samples import looked_at

from gyro_calib.device import draw_unit, load_device
from gyro_calib.experiments import Plan, SimulatedInstrument, gap_ftr_plan, gap_whole_angle_plan, run_plan
from gyro_calib.gap.images import _mirror
from gyro_calib.gap.model import CampaignModel
from gyro_calib.gap.signals import Signals
from gyro_calib.simulation import GyroSimulator

FloatArray = NDArray[np.float64]
SAMPLE_HZ, HELD, ROW, SPAN_S = 240_000, 24, 480, 4.0
CARRIER_HZ, MODULATION_HZ = 14_999.986, 1.5
CARRIER_OF_HEMISPHERE_HZ = 5_000.303


def line(x: NDArray[np.complex128], step_s: float, frequency_hz: float) -> complex:
    """Amplitude of a line through a window that leaves nothing of the others."""
    t, weight = np.arange(len(x)) * step_s, np.blackman(len(x))
    return complex(np.sum(x * weight * np.exp(-2j * np.pi * frequency_hz * t)) / weight.sum())


def mirror_of(carrier_hz: float) -> NDArray[np.complex128] | None:
    row_s = ROW / SAMPLE_HZ
    rows = round(SPAN_S / row_s)
    return _mirror(cast(Signals, SimpleNamespace(omega_rad_s=np.full(rows, 2.0 * np.pi * carrier_hz), row_s=row_s)))


@pytest.mark.parametrize("held", [True, False])
def test_a_held_side_band_has_its_mirror_at_the_carrier(held: bool) -> None:
    t = np.arange(round(SPAN_S * SAMPLE_HZ)) / SAMPLE_HZ
    u = np.exp(2j * np.pi * MODULATION_HZ * (t - t % (HELD / SAMPLE_HZ) if held else t))
    volts = (u * np.exp(2j * np.pi * CARRIER_HZ * t)).real
    # but for what is wanted
    seen = 2.0 * volts * np.exp(-2j * np.pi * CARRIER_HZ * t) - u
    # against the carrier the conjugate turns with twice the distance from half the loops' rate
    away_hz = 30_000.0 - 2.0 * CARRIER_HZ - MODULATION_HZ
    found = line(seen, 1.0 / SAMPLE_HZ, away_hz)
    mirror = mirror_of(CARRIER_HZ)
    assert mirror is not None
    row_s = ROW / SAMPLE_HZ
    rows = np.exp(2j * np.pi * MODULATION_HZ * np.arange(len(mirror)) * row_s)
    told = line(mirror[:, 0] * np.gradient(rows, row_s).conj(), row_s, away_hz)
    assert abs(told) == pytest.approx(MODULATION_HZ / (2.0 * CARRIER_HZ), rel=1e-3)
    # of 24 samples each, where the formula has continuous holds
    assert abs(found) == pytest.approx(abs(told) if held else 0.0, rel=0.03, abs=1e-7)


def test_an_image_that_moves_away_has_no_columns() -> None:
    assert mirror_of(15_000.1) is not None
    assert mirror_of(15_000.2) is None
    assert mirror_of(14_971.3) is None


def looked_at_quiet(name: str, frequency_hz: float, plan: Callable[..., Plan], *, multiplexed: bool = False) -> CampaignModel:
    """A quiet device at a frequency, sample by sample, and its look."""
    device = draw_unit(load_device(name), 5)
    device = replace(
        device,
        resonator=replace(device.resonator, frequency_hz=frequency_hz),
        multiplexing=replace(device.multiplexing, enabled=multiplexed),
        noise=replace(device.noise, pickoff_v_rthz=2e-8, drive_v_rthz=2e-8, drive_flicker_v=0.0, thermomechanical=False),
    )
    instrument = SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(3), fidelity="carrier"))
    return looked_at(run_plan(instrument, plan(device.factory(), quality="quick")))


def image_sizes(model: CampaignModel, image: str = "image_") -> tuple[list[str], FloatArray, FloatArray]:
    """Columns of images, and each image's size and its sd."""
    places = [k for k, c in enumerate(model.base.columns) if c.name.startswith(image)]
    values, covariance = model.base.values[places].reshape(-1, 2), model.base.covariance[np.ix_(places, places)]
    sizes, sds = np.linalg.norm(values, axis=1), np.sqrt(np.diag(covariance)).reshape(-1, 2).max(axis=1)
    return [model.base.columns[k].name for k in places], sizes, sds


@pytest.mark.slow
def test_the_carrier_s_images_have_the_size_of_the_formula() -> None:
    """A ring at half of three times its loops' rate; a phase depends on where its record begins."""
    model = looked_at_quiet("ring_15k", CARRIER_HZ, gap_ftr_plan)
    names, sizes, sds = image_sizes(model)
    excited = [r.index for r in model.evidence if r.is_wave and r.recording.command.excitation.kind != "none"]
    assert names == [f"image_{i}_{part}" for i in excited for part in ("re", "im")]
    assert np.all(np.abs(sizes - 1.0) < 3.0 * sds)
    assert np.average(sizes, weights=sds**-2.0) == pytest.approx(1.0, abs=0.25)


@pytest.mark.slow
def test_the_drives_of_a_wave_that_turns_have_their_image_too() -> None:
    """A hemisphere, twice whose frequency is 0.6 Hz from a multiple of its loops' rate: the fastest line of its fastest turns."""
    _, sizes, sds = image_sizes(looked_at_quiet("hrg_hardware", CARRIER_OF_HEMISPHERE_HZ, gap_whole_angle_plan))
    seen = sds < 0.3
    assert seen.any()
    assert np.all(np.abs(sizes[seen] - 1.0) < 3.0 * sds[seen])


@pytest.mark.slow
def test_what_takes_turns_has_the_image_of_its_voltage() -> None:
    """A multiplexed hemisphere, twice whose frequency is 0.1 Hz from a multiple of its loops' rate."""
    model = looked_at_quiet("hrg_hardware", 5000.05, gap_whole_angle_plan, multiplexed=True)
    assert max(float(np.abs(r.recording.drive).max()) for r in model.evidence if r.is_wave) < 0.9
    _, held, held_sds = image_sizes(model)
    assert np.all(held < 3.0 * held_sds)
    _, sizes, sds = image_sizes(model, "slot_image_")
    assert sds.min() < 0.03
    assert np.all(np.abs(sizes - 1.0) < 3.0 * sds)
    assert np.average(sizes, weights=sds**-2.0) == pytest.approx(1.0, abs=0.08)
