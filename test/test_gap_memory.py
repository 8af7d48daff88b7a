"""Memories carried from recording to recording against one low-pass over all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from gyro_calib.gap.evidence import CampaignEvidence
from gyro_calib.gap.forms import FORMS
from gyro_calib.gap.memory import behind, remembered
from gyro_calib.gap.parts import Linear
from gyro_calib.gap.signals import Signals, with_pick
from gyro_calib.recording.columns import COLUMNS
from gyro_calib.recording.command import Command, Setpoints
from gyro_calib.recording.recording import Recording

ROW_S, GAP_S = 0.01, 2.0
AMPLITUDES_V = (1.0, 0.6, 1.4)


def chain(temperatures: tuple[tuple[float, float], ...] = ((25.0, 25.0),) * 3) -> list[Signals]:
    """Three recordings of 6 s with breaks of 2 s: an amplitude each, a temperature that goes straight from one number to the other."""
    found: list[Signals] = []
    for k, (amplitude, (low, high)) in enumerate(zip(AMPLITUDES_V, temperatures, strict=True)):
        t = k * (6.0 + GAP_S) + ROW_S * np.arange(600)
        rows = np.zeros((t.size, len(COLUMNS)))
        rows[:, 0], rows[:, 1], rows[:, 2] = t, k + 1.0, amplitude
        rows[:, 10], rows[:, 11] = 15000.0, np.linspace(low, high, t.size)
        command = Command("ftr_x", setpoints=Setpoints(amplitude_v=amplitude))
        recording = Recording("ring", rows, command, 1.0 / ROW_S, f"r{k}")
        found.append(Signals(recording, 2 * np.pi * 15000.0, 1.5, 1, 25.0, 0.0, k, found[-1] if found else None))
    return found


def whole(values: np.ndarray, tau_s: float) -> np.ndarray:
    """One low-pass, begun settled."""
    share = 1.0 - np.exp(-ROW_S / tau_s)
    return np.asarray(lfilter([share], [1.0, share - 1.0], values, zi=[(1.0 - share) * values[0]])[0])


@pytest.mark.parametrize("tau_s", [0.3, 2.0, 10.0])
def test_an_amplitude_that_was_set_before_is_remembered(tau_s: float) -> None:
    signals = chain()
    breaks = round(GAP_S / ROW_S)
    line = np.concatenate([np.full(600 + (breaks if k else 0), a) for k, a in enumerate(AMPLITUDES_V)])
    expected = whole(line, tau_s)
    for k, s in enumerate(signals):
        first = k * (600 + breaks)
        found = remembered(s, lambda of: of.pick, tau_s)[:, 0].real
        np.testing.assert_allclose(found, expected[first : first + 600], atol=4e-3)
    if tau_s == 10.0:
        alone = Signals(signals[2].recording, 2 * np.pi * 15000.0, 1.5, 1, 25.0, 0.0, 2)
        assert abs(remembered(alone, lambda of: of.pick, tau_s)[0, 0].real - expected[2 * (600 + breaks)]) > 0.2


@pytest.mark.parametrize("speed_rad_s", [0.4, -1.1])
def test_a_wave_that_precesses_has_precessed_before(speed_rad_s: float) -> None:
    """A pattern that turns at one speed through two recordings and the break between them, and long before."""
    tau_s, signals = 4.0, []
    for s in chain()[:2]:
        angle = speed_rad_s * s.time_s
        pattern = np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(complex)
        signals.append(with_pick(replace(s, before=signals[-1] if signals else None), pattern))
    lag, size = np.arctan(speed_rad_s * tau_s), 1.0 / np.hypot(1.0, speed_rad_s * tau_s)
    for s in signals:
        angle = speed_rad_s * s.time_s - lag
        found = remembered(s, lambda of: of.pick, tau_s)
        np.testing.assert_allclose(found, size * np.stack([np.cos(angle), np.sin(angle)], axis=1), atol=0.01)
    # what is taken to have stood still before is wrong by a lot
    assert np.abs(remembered(signals[0], lambda of: of.pick[:, :1], tau_s)[0, 0] - size * np.cos(lag)) > 0.1


def test_a_temperature_goes_straight_between_recordings() -> None:
    signals = chain(((25.0, 28.0), (29.0, 33.0), (33.0, 33.0)))
    breaks = round(GAP_S / ROW_S)
    line = np.concatenate([np.linspace(0, 3, 600), np.linspace(3, 4, breaks), np.linspace(4, 8, 600), np.full(breaks + 600, 8.0)])
    expected = whole(line, 8.0)
    found = remembered(signals[2], lambda of: of.temperature_k[:, None].astype(complex), 8.0, steady=False)[:, 0].real
    # the first recording is taken to begin settled at what it shows, 1.5 K in the mean here
    np.testing.assert_allclose(found, expected[-600:], atol=0.25)
    assert np.abs(found - line[-600:]).max() > 1.5


def test_a_temperature_may_be_on_its_way_where_a_recording_begins() -> None:
    """At rest until then: its lag begins at nothing, not at the mean of the first rows."""
    signals = chain(((25.0, 25.0), (25.0, 33.0), (33.0, 33.0)))
    line = np.concatenate([np.zeros(600 + round(GAP_S / ROW_S)), np.linspace(0, 8, 600)])
    found = remembered(signals[1], lambda of: of.temperature_k[:, None].astype(complex), 0.6, steady=False)[:, 0].real
    np.testing.assert_allclose(found, whole(line, 0.6)[-600:], atol=2e-3)


def test_clocks_that_begin_anew_say_nothing_of_what_came_before() -> None:
    first, second = chain()[:2]
    rows = second.recording.data.copy()
    rows[:, 0] -= 5.0
    again = Recording("ring", rows, second.recording.command, 1.0 / ROW_S, "again")
    overlapping = Signals(again, 2 * np.pi * 15000.0, 1.5, 1, 25.0, 0.0, 1, first)
    np.testing.assert_allclose(remembered(overlapping, lambda of: of.pick, 2.0)[:, 0], AMPLITUDES_V[1], atol=1e-12)


def test_the_lag_of_a_thermometer_spans_recordings() -> None:
    signals = chain(((25.0, 25.0), (25.0, 33.0), (33.0, 33.0)))
    linear = Linear(-1.5 * np.eye(2) + 0j, -8j * np.eye(2), np.zeros((2, 2), complex), 0.8, -2.5)
    parts = FORMS["thermal_lag"].parts(signals[2], linear, {"tau": 5.0})
    # the resonator is still colder than its sensor when the temperature has come to rest: silicon, so its frequency is higher
    late = (parts[0].signal[:, 0] / signals[2].pick[:, 0]).imag
    assert late[0] > 4.0 > late[-1] > 0.0


def warmed(after_degc: float) -> list[Recording]:
    """A recording that ends ten kelvins warmer, another two seconds later, and one that comes from there."""
    ends = ((25.0, 35.0), (after_degc, after_degc), (after_degc, after_degc))
    return [s.recording for s in chain(ends)]


@pytest.mark.parametrize(("after_degc", "follows"), [(25.0, False), (34.0, True), (35.0, True)])
def test_a_chamber_that_went_back_while_the_clock_stood_leaves_no_memory(after_degc: float, follows: bool) -> None:
    """Ten kelvins in two seconds where the ramp took six: the practice campaigns do so. A kelvin is what it may have lost meanwhile."""
    evidence = CampaignEvidence.of(warmed(after_degc), 1.5)
    first, second, third = (r.signals for r in evidence)
    assert (second.before is first) is follows
    assert third.before is second
    late_k = behind(second, 3.0)[:, 0].real
    if follows:
        assert abs(late_k[0]) > 0.5
    else:
        np.testing.assert_allclose(late_k, 0.0, atol=1e-9)
