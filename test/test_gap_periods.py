"""What goes to and fro as slowly as a record lasts and as no cosine: told by its mean waveform, and by no noise and no command."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flow_samples import ROW_S, quiet_flows
from scipy.stats import beta

from gyro_calib.gap.evidence import CHANNELS
from gyro_calib.gap.flow_left import FlowLeft
from gyro_calib.gap.periods import _log_upper_tail, find_period
from gyro_calib.gap.steady_swings import find_steady_swing
from gyro_calib.gap.swings import find_swing

ROWS, COUNT = 1000, 20
#: one after the other, as a plan of one device runs
EVERY_S = 10.6
PERIOD_S = 11.9


def flows(rng: np.random.Generator) -> list[FlowLeft]:
    """Recordings of two kinds, one of which has a side band."""
    return quiet_flows(rng, (EVERY_S * np.arange(COUNT)).tolist(), ROWS, 0.5)


def with_waveform(
    of: list[FlowLeft], channel: str, size: float, period_s: float = PERIOD_S, *, of_commands: bool = False
) -> list[FlowLeft]:
    """With the rate of change of what rises for most of a period and falls in the rest, less what a mean and a slope take of it."""
    found = []
    for flow in of:
        t = ROW_S * np.arange(ROWS) + (0.0 if of_commands else flow.start_s)
        share = (t / period_s) % 1.0
        x = size * np.where(share < 0.85, 1.0 / 0.85, -1.0 / 0.15)
        place = np.linspace(-1.0, 1.0, ROWS)
        x = x - x.mean() - place * (place @ x) / (place @ place)
        found.append(replace(flow, rate={**flow.rate, channel: flow.rate[channel] + x}))
    return found


def test_noise_alone_has_no_period() -> None:
    for seed in range(8):
        assert find_period(flows(np.random.default_rng(seed))) is None


@pytest.mark.parametrize("channel", CHANNELS)
def test_what_no_cosine_tells_its_mean_waveform_does(channel: str) -> None:
    """A supply that hiccups every eleven seconds was a rate asymmetry: each record was disturbed by the harmonics not asked for."""
    hiccups = with_waveform(flows(np.random.default_rng(1)), channel, 4e-6)
    assert find_swing(hiccups) is None
    assert find_steady_swing(hiccups) is None
    found = find_period(hiccups)
    assert found is not None
    assert found.channel == channel
    assert 1.0 / found.frequency_hz == pytest.approx(PERIOD_S, rel=0.01)
    assert "to and fro every 11.9 s" in found.unknown().form


@pytest.mark.parametrize("period_s", [0.5 * EVERY_S, 0.8 * EVERY_S, EVERY_S])
def test_what_settles_after_each_command_has_no_period(period_s: float) -> None:
    """Every record begins with it, and they begin one after the other: it would be the clock's."""
    for seed in range(3):
        assert find_period(with_waveform(flows(np.random.default_rng(seed)), "amplitude", 2e-5, period_s, of_commands=True)) is None


def test_one_record_that_was_disturbed_is_no_period() -> None:
    quiet = flows(np.random.default_rng(2))
    knocked = with_waveform(quiet[7:8], "precession", 3e-3)
    assert find_period([*quiet[:7], *knocked, *quiet[8:]]) is None


def test_few_records_tell_none() -> None:
    assert find_period(with_waveform(flows(np.random.default_rng(1)), "amplitude", 4e-5)[:2]) is None
    assert find_period([]) is None


def test_a_device_without_noise_has_none_and_is_no_error() -> None:
    still = [replace(flow, rate=dict.fromkeys(CHANNELS, np.zeros(ROWS))) for flow in flows(np.random.default_rng(0))]
    assert find_period(still) is None


def test_a_campaign_of_days_is_asked_for_as_many_periods() -> None:
    # eleven weeks would be hundreds of thousands
    apart = quiet_flows(np.random.default_rng(0), (3.6e5 * np.arange(COUNT) + 3.7 * np.arange(COUNT) ** 2).tolist(), ROWS)
    assert find_period(apart) is None


def test_the_tail_of_a_beta_is_that_of_a_beta() -> None:
    for x, a, b in ((0.3, 1.0, 9.0), (0.6, 4.0, 40.0), (0.2, 3.3, 12.5)):
        assert _log_upper_tail(x, a, b) == pytest.approx(beta.logsf(x, a, b), rel=1e-6)
    # where that one has long been nothing
    assert _log_upper_tail(0.999, 1.0, 100.0) == pytest.approx(100.0 * np.log(1e-3), rel=1e-6)
