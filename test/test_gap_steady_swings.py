"""What goes to and fro with one phase through a whole campaign: told by all recordings together, and by no noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from gyro_calib.gap.evidence import CHANNELS
from gyro_calib.gap.flow_left import FlowLeft
from gyro_calib.gap.steady_swings import find_steady_swing
from gyro_calib.gap.swings import find_swing

ROW_S, ROWS, COUNT = 0.01, 900, 12
#: every seventeen seconds a recording of nine
STARTS_S = 3.21 + 17.0 * np.arange(COUNT)
#: no harmonic of it is folded near what swings
CARRIER_HZ = 15030.0
SWING_HZ = 0.43
#: of a gain of forces and of a walk [1/s]
FORCED, WALK = 2e-5, 1e-7


def flows(rng: np.random.Generator) -> list[FlowLeft]:
    """Recordings at rest of two kinds."""

    def noise() -> NDArray[np.float64]:
        return FORCED * rng.standard_normal(ROWS) + WALK * np.cumsum(rng.standard_normal(ROWS))

    return [
        FlowLeft(f"static_{k}", ("ftr_x", float(k % 2), False), ROW_S, CARRIER_HZ, 0.0, 0.0, {c: noise() for c in CHANNELS}, start_s)
        for k, start_s in enumerate(STARTS_S)
    ]


def swinging(of: list[FlowLeft], channel: str, size: float, phases: NDArray[np.float64], hz: float = SWING_HZ) -> list[FlowLeft]:
    """With a swing of these phases at the zero of the device's clock, as those recordings that ``phases`` has numbers for hold it."""
    found = []
    for flow, phase in zip(of, phases, strict=True):
        t = flow.start_s + ROW_S * np.arange(ROWS)
        more = 0.0 if np.isnan(phase) else size * np.sin(2.0 * np.pi * hz * t + phase)
        found.append(replace(flow, rate={**flow.rate, channel: flow.rate[channel] + more}))
    return found


def test_noise_alone_goes_nowhere() -> None:
    for seed in range(20):
        assert find_steady_swing(flows(np.random.default_rng(seed))) is None


@pytest.mark.parametrize("channel", CHANNELS)
def test_all_recordings_together_tell_what_none_of_them_does(channel: str) -> None:
    """A bench that rocked every 2.3 s was *none*: in records of eight seconds it is near their mean and twice their noise."""
    rocked = swinging(flows(np.random.default_rng(1)), channel, 6e-6, np.full(COUNT, 0.6))
    assert find_swing(rocked) is None
    found = find_steady_swing(rocked)
    assert found is not None
    assert found.channel == channel
    assert found.records == COUNT
    # as fine as the campaign is long, not as a recording is
    assert found.frequency_hz == pytest.approx(SWING_HZ, abs=0.3 / (STARTS_S[-1] - STARTS_S[0]))
    assert "to and fro every 2.3" in found.unknown().form


def test_what_begins_anew_in_each_recording_is_not_steady() -> None:
    """A hundred times as large it is a floor that stands higher there, whatever it is about."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        anew = rng.uniform(0.0, 2.0 * np.pi, COUNT)
        assert find_steady_swing(swinging(flows(rng), "precession", 1e-4, anew)) is None


def test_one_disturbed_recording_is_not_the_campaign() -> None:
    phases = np.full(COUNT, np.nan)
    phases[4] = 0.6
    assert find_steady_swing(swinging(flows(np.random.default_rng(3)), "precession", 4e-5, phases)) is None


def test_two_recordings_of_a_kind_whose_floor_is_mistaken_are_not_the_campaign() -> None:
    """Near their mean all wander alike, but of two of twelve no bin that tells the floor says so: their phases agree, within a tenth."""
    rng = np.random.default_rng(6)
    quiet = flows(rng)
    for k in range(10):
        wander = quiet[k].rate["frequency"] + 100.0 * WALK * np.cumsum(rng.standard_normal(ROWS))
        quiet[k] = replace(quiet[k], rate={**quiet[k].rate, "frequency": wander})
    for k in (10, 11):
        quiet[k] = replace(quiet[k], kind=("ftr_y", 0.0, False))
    phases = np.full(COUNT, np.nan)
    phases[10:] = 0.6, 0.7
    assert find_steady_swing(swinging(quiet, "frequency", 5e-5, phases, 0.3)) is None


def test_a_campaign_of_days_is_asked_for_no_more_frequencies_than_one_of_minutes() -> None:
    """All that one tells apart up to 12 Hz would be a hundred million."""
    days = [replace(f, start_s=1e4 * f.start_s) for f in flows(np.random.default_rng(5))]
    assert find_steady_swing(days) is None
    hours = [replace(f, start_s=60.0 * f.start_s) for f in flows(np.random.default_rng(5))]
    found = find_steady_swing(swinging(hours, "precession", 1e-5, np.full(COUNT, 0.6)))
    assert found is not None
    # recordings at even distances tell it but for a multiple of one over these
    assert found.frequency_hz == pytest.approx(SWING_HZ, abs=0.5 / (ROW_S * ROWS))


def test_few_recordings_tell_nothing() -> None:
    rocked = swinging(flows(np.random.default_rng(4)), "precession", 1e-4, np.full(COUNT, 0.6))
    assert find_steady_swing(rocked) is not None
    assert find_steady_swing(rocked[:5]) is None
