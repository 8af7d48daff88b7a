"""What swings or jumps within recordings: found in what the linear device leaves of each row, and nowhere in noise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter
from table_samples import looked_at, on_a_table

from gyro_calib.gap import jumps
from gyro_calib.gap.diagnose import diagnose
from gyro_calib.gap.evidence import CHANNELS, CampaignEvidence
from gyro_calib.gap.flow_left import FlowLeft, flows_left
from gyro_calib.gap.jumps import find_jumps
from gyro_calib.gap.preflight import usable
from gyro_calib.gap.swings import find_swing
from gyro_calib.recording.recording import Campaign, Recording

ROW_S, ROWS = 0.01, 1500
#: no harmonic of it is folded near it by a converter
CARRIER_HZ = 15030.0
#: white noise of a pick-off over its volts, and of forces [1/s]
READ, FORCED = 1e-5, 2e-5


def noise(rng: np.random.Generator) -> NDArray[np.float64]:
    """A pick-off's through the derivative, forces, and a walk."""
    read = np.gradient(READ * rng.standard_normal(ROWS), ROW_S)
    return read + FORCED * rng.standard_normal(ROWS) + 1e-7 * np.cumsum(rng.standard_normal(ROWS))


def flows(rng: np.random.Generator, count: int = 8, excited_hz: float = 0.0) -> list[FlowLeft]:
    """Recordings at rest of one kind."""
    kind, still = ("ftr_x", 1.0, False), np.zeros(ROWS)
    return [
        FlowLeft(f"static_{k}", kind, ROW_S, CARRIER_HZ, excited_hz, 0.0, {c: noise(rng) for c in CHANNELS}, still) for k in range(count)
    ]


def with_more(flow: FlowLeft, channel: str, more: NDArray[np.float64]) -> FlowLeft:
    return replace(flow, rate={**flow.rate, channel: flow.rate[channel] + more})


def step(at_s: float) -> NDArray[np.float64]:
    return np.where(ROW_S * np.arange(ROWS) > at_s, 1.0, 0.0)


def test_noise_alone_neither_swings_nor_jumps() -> None:
    for seed in range(30):
        of_seed = flows(np.random.default_rng(seed))
        assert find_swing(of_seed) is None
        assert find_jumps(of_seed) is None


@pytest.mark.parametrize("channel", CHANNELS)
def test_a_swing_stands_at_one_frequency_in_several_recordings(channel: str) -> None:
    rng = np.random.default_rng(1)
    t = ROW_S * np.arange(ROWS)
    swinging = [with_more(f, channel, 1e-4 * np.sin(2 * np.pi * 0.7 * t + rng.uniform(0, 6.28))) for f in flows(rng)]
    found = find_swing(swinging)
    assert found is not None
    assert found.channel == channel
    assert found.frequency_hz == pytest.approx(0.7, abs=1.0 / (ROW_S * ROWS))
    assert f"to and fro every {1.0 / found.frequency_hz:.3g} s" in found.unknown().form


def test_a_swing_does_not_pass_for_its_own_floor() -> None:
    """In few records a loud swing of a low bin made a floor of 1/f, over which it stood no higher than its neighbours below it."""
    t = ROW_S * np.arange(ROWS)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        swing = 1e-3 * np.sin(2 * np.pi * 0.7 * t)
        found = find_swing([with_more(f, "amplitude", swing) for f in flows(rng, 3)])
        assert found is not None
        assert found.records == 3
        assert found.log_evidence > 300.0, "as its power over the noise has it"


def test_a_swing_in_one_recording_is_a_disturbance() -> None:
    first, *rest = flows(np.random.default_rng(2))
    loud = with_more(first, "amplitude", 1e-3 * np.sin(2 * np.pi * 0.7 * ROW_S * np.arange(ROWS)))
    assert find_swing([loud, *rest]) is None


def test_a_resonance_that_wanders_does_not_swing() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        wander = [lfilter([0.03], [1.0, -0.97], 1e-3 * np.cumsum(rng.standard_normal(ROWS))) for _ in range(15)]
        kinds = [replace(f, kind=("ftr_x", float(k // 3), False)) for k, f in enumerate(flows(rng, 15))]
        of_seed = [with_more(f, "frequency", w) for f, w in zip(kinds, wander, strict=True)]
        # images of this carrier leave but a few of the low bins, all of them loud
        still = [replace(f, carrier_hz=4998.84, rate={c: x[:1000] for c, x in f.rate.items()}, azimuth_rad=np.zeros(1000)) for f in of_seed]
        assert find_swing(still) is None


def test_a_hump_of_the_loops_is_no_swing() -> None:
    """Of a reference that follows the resonance: three times what white, flicker and walk say, from one hertz to three."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        pole = 0.97 * np.exp(2j * math.pi * 1.4 * ROW_S)
        humps = [lfilter([2e-6], [1.0, -2.0 * pole.real, abs(pole) ** 2], rng.standard_normal(ROWS)) for _ in range(15)]
        of_seed = [with_more(f, "frequency", h) for f, h in zip(flows(rng, 15), humps, strict=True)]
        assert find_swing(of_seed) is None


def test_an_image_of_the_carrier_is_no_swing() -> None:
    """At 15 000.35 Hz a converter of 10 kHz has the carrier's double 0.7 Hz from it."""
    rng = np.random.default_rng(1)
    t = ROW_S * np.arange(ROWS)
    imaged = [with_more(replace(f, carrier_hz=15000.35), "amplitude", 1e-4 * np.sin(2 * np.pi * 0.7 * t)) for f in flows(rng)]
    assert find_swing(imaged) is None


def test_harmonics_of_a_side_band_are_no_swing() -> None:
    wave = 1e-3 * np.sin(2 * np.pi * 1.0 * ROW_S * np.arange(ROWS)) ** 3
    quiet = flows(np.random.default_rng(3), excited_hz=1.0)
    assert find_swing([with_more(f, "amplitude", wave) for f in quiet]) is None
    assert find_swing([with_more(replace(f, excited_hz=0.0), "amplitude", wave) for f in quiet]) is not None


def test_a_force_that_jumps_once_is_a_finding() -> None:
    first, *rest = flows(np.random.default_rng(4))
    found = find_jumps([with_more(first, "precession", 3e-4 * step(8.0)), *rest])
    assert found is not None
    assert (found.channel, found.kicks, found.records) == ("precession", False, ("static_0",))


def test_a_force_that_jumps_again_and_again_need_not_jump_far(monkeypatch: pytest.MonkeyPatch) -> None:
    """One jump of six usual sizes is what healthy campaigns have, six are not; three of eight there are not here."""
    quiet = flows(np.random.default_rng(4), count=12)
    hopping = [with_more(f, "precession", 3e-5 * step(3.0 + k)) for k, f in enumerate(quiet[:9])]
    found = find_jumps([*hopping, *quiet[9:]])
    assert found is not None
    assert (found.channel, found.kicks) == ("precession", False)
    assert found.count >= 6
    assert found.largest < 12.0
    monkeypatch.setattr(jumps, "_FINDINGS", jumps._FINDINGS[:1])
    assert find_jumps([*hopping, *quiet[9:]]) is None


def test_a_knock_is_none_and_a_pick_off_that_hops_is() -> None:
    """A kick in one row is what a gain that jumps leaves, and what a knock on the bench does: it counts when it comes again."""
    kick = np.zeros(ROWS)
    kick[700] = 3e-4 / ROW_S
    quiet = flows(np.random.default_rng(5))
    assert find_jumps([with_more(quiet[0], "amplitude", kick), *quiet[1:]]) is None
    found = find_jumps([*(with_more(f, "amplitude", np.roll(kick, 90 * k)) for k, f in enumerate(quiet[:4])), *quiet[4:]])
    assert found is not None
    assert found.kicks
    assert found.count >= 4
    assert "static_3" in found.records


# -- on a simulated ring -------------------------------------------------------------------------------------------------------------------


def driven_more(recording: Recording, more: NDArray[np.float64]) -> Recording:
    """A drive that makes so much more than is logged: what acted was the log."""
    rows = recording.data.copy()
    rows[:, 6:10] /= 1.0 + more[:, None]
    return replace(recording, data=rows)


def spoilt(campaign: Campaign, frequency_hz: float, size: float) -> Campaign:
    of_drives = (driven_more(r, size * np.sin(2 * np.pi * frequency_hz * r.t)) if r.command.mode != "loops_off" else r for r in campaign)
    return replace(campaign, recordings=tuple(of_drives))


@pytest.mark.slow
def test_what_is_left_of_a_wave_is_the_force_that_is_not_in_the_log() -> None:
    """A held amplitude loses as much as its drive brings: a share more of the drive is that share of 1/tau."""
    campaign, share = on_a_table(), 1e-3
    model = looked_at(campaign)
    loss = -np.real(np.trace(model.linear.A)) / 2.0
    later = [driven_more(r, share * (np.arange(len(r)) > len(r) // 2)) for r in usable(campaign)]
    healthy, spoilt_flows = (
        flows_left(evidence, model.linear) for evidence in (model.evidence, CampaignEvidence.of(later, model.evidence.decay_rate))
    )
    assert len(healthy) > 3
    compared = 0
    for before, after in zip(healthy, spoilt_flows, strict=True):
        if before.excited_hz:
            continue
        compared += 1
        gained = after.rate["amplitude"] - before.rate["amplitude"]
        place = np.linspace(-1.0, 1.0, len(gained))
        ideal = np.where(place > 0.0, 1.0, -1.0) - 1.5 * place
        assert float(gained @ ideal / (ideal @ ideal)) == pytest.approx(0.5 * share * loss, rel=0.05)
    assert compared > 3


@pytest.mark.slow
def test_a_supply_that_swings_within_recordings_is_unknown() -> None:
    campaign = on_a_table()
    assert diagnose(campaign).verdict == "none"
    found = diagnose(spoilt(campaign, 1.3, 2e-3))
    assert found.verdict == "unknown"
    assert found.unknown is not None
    assert "to and fro every 0.7" in found.unknown.form
    assert math.isfinite(found.unknown.gain)
