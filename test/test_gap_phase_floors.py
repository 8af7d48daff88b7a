"""Phases of the pick-offs that flicker: as a floor of a campaign, in what an open drive tells, and as a finding."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from spectra_samples import LINEAR, records
from test_gap_flickers import EVIDENCE, Evidence, laws
from test_gap_gain_floors import flickering

from gyro_calib.device import draw_unit, load_device
from gyro_calib.experiments import SimulatedInstrument, gap_ftr_plan, run_plan
from gyro_calib.gap import diagnose
from gyro_calib.gap.evidence import CHANNELS, CampaignEvidence, RecordingEvidence
from gyro_calib.gap.flicker_effects import with_flickers
from gyro_calib.gap.flow_left import FlowLeft
from gyro_calib.gap.noise_law import NoiseLaw
from gyro_calib.gap.phase_floors import PHASE_FLICKERS, phase_floors
from gyro_calib.gap.preflight import usable
from gyro_calib.gap.spectral_effects import spectral_effects
from gyro_calib.recording.recording import Campaign
from gyro_calib.simulation import GyroSimulator

FloatArray = NDArray[np.float64]
ROW_S, SECONDS = 0.01, 10.0
#: white noise of the pick-offs over the wave [1/sqrt(Hz)], and of a resonance that wanders, at 1 Hz [1/s/sqrt(Hz)]
WHITE, WALK = 4e-7, 2e-4


def flows(rng: np.random.Generator, phases: tuple[float, float], whites: tuple[float, float] = (WHITE, WHITE)) -> list[FlowLeft]:
    """Waves held on either axis: a resonance that wanders, white noise of the pick-offs in and out of phase, and phases that flicker."""
    rows, made = round(SECONDS / ROW_S), []
    for k in range(12):
        axis = k % 2
        white = math.sqrt(0.5 / ROW_S) * rng.standard_normal((2, rows))
        turned = whites[axis] * white[0] + phases[axis] * flickering(rng, rows, 1.0 / ROW_S, 0.01)
        walk = WALK * 2.0 * np.pi * math.sqrt(0.5 * ROW_S) * np.cumsum(rng.standard_normal(rows))
        rate = dict.fromkeys(CHANNELS, np.zeros(rows))
        rate |= {"frequency": derivative(turned) + walk, "amplitude": derivative(WHITE * white[1])}
        excited_hz = 0.5 if k % 3 == 2 else 0.0
        side_band = 0.01 * np.sin(2.0 * np.pi * excited_hz * ROW_S * np.arange(rows))
        rate["frequency"] = rate["frequency"] + side_band
        made.append(
            FlowLeft(f"run_{k}", (f"ftr_{'xy'[axis]}", 1.0, False), ROW_S, 15e3, excited_hz, 0.0, rate, np.full(rows, 0.5 * np.pi * axis))
        )
    return made


def derivative(x: FloatArray) -> FloatArray:
    """As an endless record has it."""
    f = np.fft.rfftfreq(x.size, ROW_S)
    return np.asarray(np.fft.irfft(2j * np.pi * f * np.fft.rfft(x), x.size))


@pytest.mark.parametrize("phases", [(6e-5, 0.0), (0.0, 2e-5), (6e-5, 6e-5), (6e-5, 2e-5)])
def test_floors_of_phases_have_their_size_on_their_axis(phases: tuple[float, float]) -> None:
    found = phase_floors(flows(np.random.default_rng(1), phases))
    for floor, phase in zip(found, phases, strict=True):
        assert math.sqrt(floor) == pytest.approx(phase, rel=0.25)


@pytest.mark.parametrize("whites", [(WHITE, WHITE), (8.0 * WHITE, WHITE), (8.0 * WHITE, 8.0 * WHITE)])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_white_noise_of_phases_is_no_floor(seed: int, whites: tuple[float, float]) -> None:
    assert phase_floors(flows(np.random.default_rng(seed), (0.0, 0.0), whites)) == (0.0, 0.0)


def test_a_healthy_floor_and_too_little_tell_nothing() -> None:
    assert phase_floors(flows(np.random.default_rng(4), (0.0, 0.4 * PHASE_FLICKERS))) == (0.0, 0.0)
    assert phase_floors(flows(np.random.default_rng(4), (6e-5, 6e-5))[:1]) == (0.0, 0.0)
    turning = [replace(flow, turning_hz=0.1) for flow in flows(np.random.default_rng(4), (6e-5, 6e-5))]
    assert phase_floors(turning) == (0.0, 0.0)
    assert phase_floors([]) == (0.0, 0.0)


@cache
def ring(phase: float) -> Campaign:
    device = draw_unit(load_device("ring_15k"), 5)
    device = replace(device, effects={"pickoff_phase_flicker": {"p_x": phase, "p_y": 0.0}} if phase else {})
    instrument = SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(3), fidelity="carrier"), 2e-5)
    return run_plan(instrument, gap_ftr_plan(device.factory(), quality="quick"))


def open_drives() -> list[RecordingEvidence]:
    campaign = ring(0.0)
    f = campaign.factory
    evidence = CampaignEvidence.of(usable(campaign), math.pi * f["nominal_f0_hz"] / f["nominal_q"])
    return [r for r in evidence if r.recording.command.mode == "loops_off" and r.recording.command.excitation.kind == "drive"]


@pytest.mark.parametrize("is_phase", [False, True])
def test_an_open_drive_reads_gain_and_phase_as_they_stand_at_its_time(is_phase: bool) -> None:
    """Of the time of the whole campaign, drawn row by row, through L: what either of them brings to every channel's mean."""
    rng, ratios = np.random.default_rng(5), []
    for r in open_drives():
        s, axis = r.signals, "xy".index(r.recording.command.excitation.axis)
        slower = math.log(r.campaign_s / (s.row_s * s.time_s.size))
        drawn = rng.standard_normal((400, 1)) * math.sqrt(slower) + np.array(
            [flickering(rng, s.time_s.size, 1.0 / s.row_s, 1.0 / (s.row_s * s.time_s.size)) for _ in range(400)]
        )
        motion = (1j if is_phase else 1.0) * s.pick * np.eye(2)[axis]
        seen = r.turn * r.signal_forms.through_flow([d[:, None] * motion for d in drawn])
        assert list(r.signal_forms.frequency_hz) == [0.0]
        for channel, x in zip(CHANNELS, (seen[0].real, seen[0].imag, seen[1].real, seen[1].imag), strict=True):
            floors = np.zeros(4)
            floors[2 * is_phase + axis] = 1.0
            told = NoiseLaw((0.0, 0.0, 0.0, 0.0), floors=tuple(floors)).covariance(r.lines(channel), r.grams)[0, 0]
            if told > 1e-6 * float(np.mean(np.abs(seen) ** 2)):
                ratios.append(float(np.mean(x**2)) / told)
    assert len(ratios) >= 4
    assert np.median(ratios) == pytest.approx(1.0, abs=0.2)
    assert 0.4 < min(ratios) < max(ratios) < 1.5


def test_phases_that_flicker_are_a_finding_beside_the_slow_flow() -> None:
    recordings = records(np.random.default_rng(5))
    beside = spectral_effects(recordings, LINEAR)
    evidence: Any = Evidence(EVIDENCE)
    evidence.phase_floors = (3.6e-9, 0.0)
    found = with_flickers(beside, evidence, LINEAR, laws())
    left_out = with_flickers(beside, evidence, LINEAR, laws(), ("pickoff_phase_flicker",))
    (effect,) = (e for e in found.effects if e not in beside.effects)
    assert effect.name == "pickoff_phase_flicker"
    assert effect.parameters["p_x"].value == pytest.approx(6e-5)
    assert effect.parameters["p_y"].value == 0.0
    assert "pickoff_phase_flicker" not in {s.name for s in left_out.standings}
    assert left_out.effects == beside.effects


@pytest.mark.slow
def test_a_ring_whose_phase_flickers_has_no_mode_beside_its_carrier() -> None:
    """Open drives read a phase that has moved by some 1e-4: taken for a response, it was a mode 20 Hz away (83 in chi-square at 2e-5)."""
    found = diagnose(ring(6e-5))
    assert [e.name for e in found.effects] == ["pickoff_phase_flicker"]
    told = found.effects[0].parameters
    assert abs(told["p_x"].value - 6e-5) < 2.0 * told["p_x"].sd
    assert told["p_y"].value == 0.0
    assert diagnose(ring(0.0)).verdict == "none"
