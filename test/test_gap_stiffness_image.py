"""The image of a stiffness that is warmed in steps, told by the rows of a record that passes it."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from gyro_calib.device import Device, draw_unit, load_device
from gyro_calib.experiments import SimulatedInstrument, gap_whole_angle_plan, run_plan
from gyro_calib.gap.columns import QUIET, SIGNAL
from gyro_calib.gap.evidence import CampaignEvidence
from gyro_calib.gap.images import image_columns
from gyro_calib.gap.parts import Linear, motion
from gyro_calib.gap.stiffness_image import less_stiffness_images
from gyro_calib.recording.recording import Recording
from gyro_calib.simulation import GyroSimulator

#: twice the carrier at which the image stands still, and its phase there
STILL_HZ, PHASE_RAD = 10_000.0, 0.7


@cache
def hemisphere(frequency_hz: float = 4998.5) -> Device:
    """One that passes 5 kHz while it warms."""
    device = draw_unit(load_device("hrg_hardware"), 5)
    return replace(device, resonator=replace(device.resonator, frequency_hz=frequency_hz))


@cache
def records(frequency_hz: float = 4998.5) -> tuple[Recording, ...]:
    """Of its temperature run, and one before it."""
    device = hemisphere(frequency_hz)
    plan = gap_whole_angle_plan(device.factory(), quality="quick", abilities=("temperature",))
    steps = [s for s in plan.steps if s.label.startswith("thermal")]
    still = next(s for s in plan.steps if s.label.startswith("free"))
    instrument = SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(3), fidelity="slow_flow"), 2e-5)
    return tuple(run_plan(instrument, replace(plan, steps=(still, *steps))))


def with_image(r: Recording, size: float) -> Recording:
    """Its wave as steps of the stiffness move it: ``a'/a = size (omega'/2 omega) e^{-2 i phi}`` beside what the rows hold."""
    omega, row_s = r.ref_omega_rad_s, 1.0 / r.sample_rate_hz
    twice = np.cumsum(omega / math.pi - STILL_HZ) * 2.0 * math.pi * row_s
    rate = size * np.gradient(omega, row_s) / (2.0 * omega) * np.exp(-1j * (twice + PHASE_RAD))
    pick = r.pick * np.exp(np.cumsum(rate) * row_s)[:, None]
    rows = r.data.copy()
    rows[:, 2:6:2], rows[:, 3:6:2] = pick.real, pick.imag
    return replace(r, data=rows)


def evidence_of(recordings: tuple[Recording, ...], frequency_hz: float = 4998.5) -> tuple[CampaignEvidence, Linear]:
    """And the device as it is."""
    device = hemisphere(frequency_hz)
    evidence = CampaignEvidence.of(recordings, math.pi * device.resonator.frequency_hz / device.resonator.quality_factor)
    flow = device.slow_flow(0.0, temperature_degc=evidence.temperature_degc, omega_rad_s=evidence.omega0_rad_s)
    slope = 2.0 * math.pi * device.resonator.frequency_hz * device.resonator.frequency_tempco_per_k
    return evidence, Linear(flow.A, flow.G, flow.E, device.resonator.angular_gain, slope)


def left(evidence: CampaignEvidence, linear: Linear, index: int) -> list[NDArray[np.complex128]]:
    """What the device does not do of itself along the wave, at the lines of a recording and at the quiet ones."""
    r = evidence.recordings[index]
    acting = linear.acting(r.signals, motion(r.signals, linear))
    sides = ((r.signal, SIGNAL), (r.quiet, QUIET))
    return [np.split(base.lhs - place.projector(r).plain([acting])[:, 0], 2)[0] for base, place in sides]


def test_an_image_that_a_record_passes_is_taken_off_both_kinds_of_lines() -> None:
    passing = next(k for k, r in enumerate(records()) if np.ptp(r.temperature_degc) > 3.0)
    clean, linear = evidence_of(records())
    disturbed, _ = evidence_of(tuple(with_image(r, 1.0) if k == passing else r for k, r in enumerate(records())))
    told = less_stiffness_images(disturbed, linear)
    assert list(told.image_sd) == [passing]
    assert 0.0 < told.image_sd[passing] < 0.1
    sides = (left(e, linear, passing) for e in (clean, disturbed, told))
    for of_clean, of_disturbed, of_told in zip(*sides, strict=True):
        assert np.linalg.norm(of_told - of_clean) < 0.15 * np.linalg.norm(of_disturbed - of_clean)
    assert [c.prior_sd for c in image_columns(told, linear) if c.name.startswith(f"stiffness_image_{passing}_")] == [
        told.image_sd[passing]
    ] * 2


def test_what_is_not_there_is_not_taken_off() -> None:
    """Rows that do not tell an image leave it to the fit; so does a record that comes near no multiple."""
    clean, linear = evidence_of(records())
    assert less_stiffness_images(clean, linear) is clean
    assert {c.prior_sd for c in image_columns(clean, linear) if c.name.startswith("stiffness_image")} == {2.0}


@pytest.mark.parametrize("frequency_hz", [4990.0])
def test_a_record_that_passes_no_multiple_is_not_asked(frequency_hz: float) -> None:
    evidence, linear = evidence_of(tuple(with_image(r, 1.0) for r in records(frequency_hz)), frequency_hz)
    assert less_stiffness_images(evidence, linear) is evidence
