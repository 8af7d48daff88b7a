"""A tone within the signal: found from what the slow flow leaves, told with its frequency and volts, and no swing and no noise is one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from flow_samples import CARRIER_HZ, ROW_S, quiet_flows
from numpy.typing import NDArray
from table_samples import looked_at

from gyro_calib.device import draw_unit, load_device
from gyro_calib.experiments import SimulatedInstrument, gap_ftr_plan, run_plan
from gyro_calib.gap.evidence import CHANNELS, CampaignEvidence
from gyro_calib.gap.flow_left import FlowLeft, flows_left
from gyro_calib.gap.near_tones import _floors, _heard, _there, find_near_tone, heard_on_lines
from gyro_calib.gap.parts import Linear
from gyro_calib.gap.steady_swings import find_steady_swing
from gyro_calib.gap.swings import kinds_of
from gyro_calib.simulation import GyroSimulator

ROWS, COUNT = 900, 12
LINEAR = Linear(-1.5 * np.eye(2) + 0j, -8j * np.eye(2), np.zeros((2, 2), dtype=complex), 0.8, -2.5)
#: force of a tone on each axis, in volts of the drives
DRIVE_V = np.array([4e-7, 2e-7])
Azimuth = Callable[[int, NDArray[np.float64]], NDArray[np.float64]]


def still(k: int, t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of waves along x, along y and between."""
    return np.full(t.size, (0.0, 0.5 * np.pi, 0.7)[k % 3])


def turning(k: int, t: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(0.4 * k + (-1.0) ** k * 2.0 * np.pi * 0.05 * t)


def flows(
    rng: np.random.Generator, azimuth: Azimuth = still, away_hz: float = 0.0, drive_v: NDArray[np.float64] = DRIVE_V
) -> list[FlowLeft]:
    """Records of two amplitudes whose references part by some millihertz, with a tone that keeps its frequency and knows no record."""
    found = []
    for k, flow in enumerate(quiet_flows(rng, [3.0 + 17.0 * k for k in range(COUNT)], ROWS)):
        t = ROW_S * np.arange(ROWS)
        psi, amplitude_v, moved_hz = azimuth(k, t), 1.0 + 0.4 * (k % 2), 5e-3 * rng.standard_normal()
        force = LINEAR.G @ drive_v if away_hz else np.zeros(2)
        tone = np.exp(1j * (2.0 * np.pi * (away_hz - moved_hz) * t + rng.uniform(0.0, 6.28))) / amplitude_v
        along = (np.cos(psi) * force[0] + np.sin(psi) * force[1]) * tone
        across = (np.cos(psi) * force[1] - np.sin(psi) * force[0]) * tone
        parts = {"amplitude": along.real, "frequency": along.imag, "precession": across.real, "quadrature": across.imag}
        turned_hz = float(abs(psi[-1] - psi[0])) / (2.0 * np.pi * ROWS * ROW_S)
        found.append(
            replace(
                flow,
                kind=("ftr", amplitude_v, False),
                carrier_hz=CARRIER_HZ + moved_hz,
                turning_hz=turned_hz,
                azimuth_rad=psi,
                rate={name: x + parts[name] for name, x in flow.rate.items()},
            )
        )
    return found


@pytest.mark.parametrize("azimuth", [still, turning])
@pytest.mark.parametrize("away_hz", [-1.19, 2.53])
def test_a_tone_is_told_with_its_frequency_and_its_volts(azimuth: Azimuth, away_hz: float) -> None:
    """One 2.53 Hz below a ring's carrier was none: the spectra of its pick-offs hear from twelve bins of a record on."""
    tone = find_near_tone(flows(np.random.default_rng(1), azimuth, away_hz), LINEAR)
    assert tone is not None
    assert tone.name == "external_tone"
    assert abs(tone.frequency_hz - CARRIER_HZ - away_hz) < 4.0 * tone.frequency_sd_hz < 0.1
    assert np.all(np.abs(tone.volts - DRIVE_V) < 4.0 * tone.volts_sd)
    assert np.all(tone.volts_sd < 0.2 * DRIVE_V.max())


def test_volts_and_frequency_keep_to_their_sd() -> None:
    errors = []
    for seed in range(24):
        tone = find_near_tone(flows(np.random.default_rng(seed), still, 2.53), LINEAR)
        assert tone is not None
        errors.append([*(tone.volts - DRIVE_V) / tone.volts_sd, (tone.frequency_hz - CARRIER_HZ - 2.53) / tone.frequency_sd_hz])
    assert np.all(np.abs(np.mean(errors, axis=0)) < 0.8)
    assert np.all((np.std(errors, axis=0) > 0.4) & (np.std(errors, axis=0) < 1.7))


@pytest.mark.parametrize("azimuth", [still, turning])
def test_noise_alone_is_none(azimuth: Azimuth) -> None:
    for seed in range(12):
        assert find_near_tone(flows(np.random.default_rng(seed), azimuth), LINEAR) is None


@pytest.mark.parametrize("channel", ["amplitude", "frequency", "precession", "quadrature"])
def test_what_goes_to_and_fro_is_none(channel: str) -> None:
    """A gain, a base or a reference that swings stands to both sides of the carrier."""
    swinging = []
    for k, flow in enumerate(flows(np.random.default_rng(2))):
        more = 1e-4 * np.cos(2.0 * np.pi * 2.53 * ROW_S * np.arange(ROWS) + k)
        swinging.append(replace(flow, rate={**flow.rate, channel: flow.rate[channel] + more}))
    assert find_near_tone(swinging, LINEAR) is None


def test_a_tone_that_one_channel_hears_best_is_told_from_what_goes_to_and_fro_in_it() -> None:
    """A tone of 30 by its author's measure stood at both sides of a ring whose amplitude is the quietest of its channels."""

    def louder(flow: FlowLeft, rng: np.random.Generator) -> FlowLeft:
        return replace(flow, rate={c: x if c == "amplitude" else x + 4e-5 * rng.standard_normal(x.size) for c, x in flow.rate.items()})

    found = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        tone = find_near_tone([louder(flow, rng) for flow in flows(rng, still, 2.53, 2.5 * DRIVE_V)], LINEAR)
        found += tone is not None and abs(tone.frequency_hz - CARRIER_HZ - 2.53) < 4.0 * tone.frequency_sd_hz
        swinging = []
        for k, flow in enumerate(flows(rng)):
            more = 1e-5 * np.cos(2.0 * np.pi * 2.53 * ROW_S * np.arange(ROWS) + k)
            swinging.append(louder(replace(flow, rate={**flow.rate, "amplitude": flow.rate["amplitude"] + more}), rng))
        assert find_near_tone(swinging, LINEAR) is None
    assert found >= 7


def test_below_what_tells_a_floor_nothing_is_heard() -> None:
    """References 0.65 and 0.86 Hz beside a multiple of the rows' rate: images leave gaps in which no floor is known."""
    covered = [
        replace(flow, carrier_hz=14999.35 - 0.205 * (k % 2), kind=(*flow.kind, k % 2))
        for k, flow in enumerate(flows(np.random.default_rng(5)))
    ]
    lowest_hz = min(kind.lowest_hz for channel in CHANNELS for kind in kinds_of(covered, channel))
    assert lowest_hz > 3.0
    away_hz = np.linspace(0.3, 9.0, 400)
    told = 0
    for flow, floor in _floors(covered):
        there = _heard(flow, away_hz, floor).there
        assert np.any(_there(flow, away_hz) & (away_hz < lowest_hz)), "a gap between images"
        assert not np.any(there & (away_hz < 0.97 * lowest_hz))
        told += int(np.any(there))
    assert told == COUNT


def test_one_disturbed_record_is_none() -> None:
    quiet = flows(np.random.default_rng(3))
    loud = flows(np.random.default_rng(3), still, 2.53, 100.0 * DRIVE_V)
    assert find_near_tone([*quiet[:4], loud[4], *quiet[5:]], LINEAR) is None


def test_few_records_tell_nothing() -> None:
    assert find_near_tone(flows(np.random.default_rng(4), still, 2.53)[:3], LINEAR) is None
    assert find_near_tone([], LINEAR) is None
    nothing_held = [replace(flow, kind=("ftr", 0.0, False)) for flow in flows(np.random.default_rng(4), still, 2.53)]
    assert find_near_tone(nothing_held, LINEAR) is None


def test_a_tone_and_a_sway_of_the_carrier_have_their_frequencies_sizes_and_the_device_s_clock() -> None:
    """The first recording is lost: one that counted from the first row there is had a sway's phase wrong."""
    device = draw_unit(load_device("ring_15k"), 5)
    tone_hz = device.resonator.frequency_hz + 3.1
    sway = {"frequency_hz": 1.7, "r": 5e-4, "phase_rad": 0.7}
    effects = {"base_sway": sway, "external_tone": {"frequency_hz": tone_hz, "a_x": 3e-5, "a_y": 2e-5, "phase_rad": 0.4}}
    simulator = GyroSimulator(replace(device, effects=effects), rng=np.random.default_rng(3), fidelity="carrier")
    plan = gap_ftr_plan(device.factory(), quality="quick")
    campaign = run_plan(SimulatedInstrument(simulator), plan)
    model = looked_at(replace(campaign, recordings=campaign.recordings[1:]))
    assert model.evidence.recordings[0].signals.start_s > 1.0
    flows_there = flows_left(model.evidence, model.linear)
    tone, swing = find_near_tone(flows_there, model.linear), find_steady_swing(flows_there)
    assert tone is not None
    assert abs(tone.frequency_hz - tone_hz) < 4.0 * tone.frequency_sd_hz
    assert np.all(np.abs(tone.volts - (3e-5, 2e-5)) < 4.0 * tone.volts_sd + 0.02 * 3e-5)
    assert swing is not None
    assert swing.is_a_rate
    assert abs(swing.frequency_hz - 1.7) < 4.0 * swing.frequency_sd_hz
    assert abs(swing.size / model.linear.angular_gain - 5e-4) < 4.0 * swing.size_sd / model.linear.angular_gain
    late = math.remainder(swing.phase_rad + math.pi - 0.7, 2.0 * math.pi)
    assert abs(late) < 4.0 * swing.phase_sd_rad < 1.0


def test_a_tone_leaks_on_lines_that_reach_near_it() -> None:
    """Not on those of slower records; where it does on most, these are all there is to ask."""

    def record(index: int, lines_hz: float, duration_s: float, turns: float = 0.0, is_wave: bool = True) -> SimpleNamespace:
        return SimpleNamespace(
            index=index,
            is_wave=is_wave,
            lines=lambda channel: SimpleNamespace(frequency_hz=np.array([0.1, lines_hz])),
            recording=SimpleNamespace(duration_s=duration_s),
            signal=SimpleNamespace(turn_rad=2.0 * np.pi * turns),
            signals=SimpleNamespace(omega_rad_s=np.full(3, 2.0 * np.pi * CARRIER_HZ)),
        )

    fast, slow = [record(k, 1.5, 12.0) for k in (0, 3)], [record(k, 0.4, 35.0) for k in (1, 2, 4)]
    opened, turning = record(5, 30.0, 2.0, is_wave=False), record(6, 1.2, 20.0, turns=8.0)
    evidence = cast(CampaignEvidence, [*fast, *slow, opened, turning])
    assert heard_on_lines(evidence, CARRIER_HZ - 1.7) == (0, 3, 6)
    assert heard_on_lines(evidence, CARRIER_HZ + 1.95) == ()
    assert heard_on_lines(evidence, CARRIER_HZ + 1.75) == (0, 3, 6)
    assert heard_on_lines(evidence, CARRIER_HZ + 0.3) == ()
