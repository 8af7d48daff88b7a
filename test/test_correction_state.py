"""What imu_corrector decides, and how it joins stamps: without ROS."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import datetime, timezone

import numpy as np
import pytest
from calibration_samples import make_record
from hypothesis import given
from hypothesis import strategies as st

from gyro_calib.calibration import RateErrorModel
from gyro_calib.device import draw_unit, load_device
from gyro_calib.nodes.correction_state import ERROR, OK, WARN, CorrectionSettings, CorrectionState
from gyro_calib.nodes.stamps import SampleClock, StampJoin
from gyro_calib.quantity import Quantity
from gyro_calib.recording.command import Command
from gyro_calib.simulation.truth import truth_of
from gyro_calib.units import DEG_H, PPM

DEVICE = "ring_15k-0007"
NOON = datetime(2026, 3, 1, 12, tzinfo=timezone.utc)
FACTORY = RateErrorModel.uncalibrated(1e-2, 0.05, 1e-4)


def make_state(expected: str = DEVICE, **settings) -> CorrectionState:
    state = CorrectionState(CorrectionSettings(FACTORY, **settings), expected)
    state.sample_rate_hz = 100.0
    state.refresh(NOON)
    return state


def corrected_by_record(state: CorrectionState) -> bool:
    return state.corrected and state.bias == make_record().bias.value and state.gain == 1.0 / 1.03


def variance(state: CorrectionState, rate: float) -> float:
    return state.c0 + rate * (state.c1 + rate * state.c2)


def test_without_a_record_rates_pass_with_the_doubt_of_the_factory() -> None:
    state = make_state()
    assert (state.bias, state.gain, state.corrected, state.publishing, state.level) == (0.0, 1.0, False, True, WARN)
    assert variance(state, 2.0) == pytest.approx(1e-4 + 4.0 * 0.05**2 + 1e-8 * 50.0)
    assert "no calibration record" in state.text


def test_without_a_record_rates_can_be_held() -> None:
    state = make_state(hold_uncalibrated=True)
    assert (state.publishing, state.level) == (False, ERROR)
    assert "Held: there is no calibration record" in state.text
    state.offer(make_record(), "test")
    state.refresh(NOON)
    assert state.publishing
    assert state.level == OK


def test_record_is_applied() -> None:
    state = make_state()
    assert state.offer(make_record(), "test")
    state.refresh(NOON)
    assert corrected_by_record(state)
    assert (state.level, state.text) == (OK, f"Corrected by {make_record().record_id}.")
    expected = (DEG_H**2 + 4.0 * (30.0 * PPM) ** 2 + 4.0 * 0.2 * DEG_H * 30.0 * PPM + 2.1e-5**2 * 50.0) / 1.03**2
    assert variance(state, 2.0) == pytest.approx(expected, rel=1e-9)


def test_record_of_another_device_is_refused_and_the_old_one_stays() -> None:
    state = make_state()
    state.offer(make_record(), "test")
    assert not state.offer(make_record("other"), "test")
    state.refresh(NOON)
    assert corrected_by_record(state)
    assert state.level == ERROR
    assert "must belong to device 'ring_15k-0007'" in state.text
    state.offer(make_record(), "test")
    state.refresh(NOON)
    assert state.level == OK


def test_record_goes_when_the_gyro_turns_out_to_be_another() -> None:
    state = make_state(expected="")
    state.offer(make_record(), "test")
    state.refresh(NOON)
    assert corrected_by_record(state)
    assert state.level == WARN
    assert "Device not verified" in state.text
    state.identify("other")
    state.refresh(NOON)
    assert not state.corrected
    assert state.level == ERROR
    state.identify(DEVICE)
    state.offer(make_record(), "test")
    state.refresh(NOON)
    assert (corrected_by_record(state), state.level) == (True, OK)


def test_gyro_that_is_not_the_expected_one_is_not_corrected() -> None:
    state = make_state()
    state.offer(make_record(), "test")
    state.identify("other")
    state.offer(make_record("other"), "test")
    state.refresh(NOON)
    assert not state.corrected
    assert "device_ids says 'ring_15k-0007', but the gyro says 'other'" in state.text


def test_switched_off_is_as_without_a_record() -> None:
    state = make_state()
    state.offer(make_record(), "test")
    state.enabled = False
    state.refresh(NOON)
    assert (state.corrected, state.publishing, state.level) == (False, True, WARN)
    assert "switched off" in state.text


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"mode": "ftr_y"}, "Mode must be 'ftr_x'"),
        ({"excitation": "amplitude_modulation"}, "the gyro is excited (amplitude_modulation)"),
        ({"compensation": (1.0, 0.1, 0.0, 1.0)}, "Drive compensation must be"),
    ],
)
def test_record_of_another_operating_point_is_not_applied(change: dict, text: str) -> None:
    state = make_state()
    state.offer(make_record(), "test")
    for name, value in change.items():
        setattr(state, name, value)
    state.refresh(NOON)
    assert (state.corrected, state.publishing, state.level) == (False, True, WARN)
    assert text in state.text
    state.mode, state.excitation, state.compensation = "ftr_x", "none", (1.0, 0.0, 0.0, 1.0)
    state.refresh(NOON)
    assert corrected_by_record(state)


@pytest.mark.parametrize("temperature", [35.0, math.nan])
def test_outside_its_validity_a_record_is_applied_with_doubt(temperature: float) -> None:
    nothing = {"bias_temperature_sd_rad_s_per_k": 0.0, "scale_factor_temperature_sd_per_k": 0.0}
    state = make_state(out_of_validity_sd_factor=7.0, covariance_mode="total", bandwidth_hz=1e-9, **nothing)
    state.offer(make_record(), "test")
    state.temperature_degc = 25.0
    state.refresh(NOON)
    inside = variance(state, 0.0)
    state.temperature_degc = temperature
    state.refresh(NOON)
    assert corrected_by_record(state)
    assert state.level == WARN
    assert "Temperature must be 20 to 30 degC" in state.text
    assert variance(state, 0.0) == pytest.approx(49.0 * inside, rel=1e-3)
    state.temperature_degc = 25.0
    state.refresh(NOON.replace(day=5))
    assert "Calibrate again" in state.text


def test_rate_that_is_corrected_already_is_never_published() -> None:
    state = make_state()
    state.offer(make_record(), "test")
    state.upstream = ("/other/imu_corrector",)
    state.refresh(NOON)
    assert (state.corrected, state.publishing, state.level) == (False, False, ERROR)
    assert "/other/imu_corrector corrected it already" in state.text


# --- stamps --------------------------------------------------------------------------------------------------------------------


def test_clock_drops_repeats_and_takes_restarts() -> None:
    clock = SampleClock()
    ms = 1_000_000
    stamps = [0, 10 * ms, 10 * ms, 5 * ms, 20 * ms, 5_000 * ms, 3_000 * ms, 3_010 * ms]
    assert [clock.accept(s) for s in stamps] == [True, True, False, False, True, True, True, True]
    assert (clock.repeated, clock.jumps, clock.count) == (2, 1, 2)
    assert clock.rate_hz() == pytest.approx(100.0)


def test_clock_measures_window_by_window() -> None:
    clock = SampleClock()
    assert clock.rate_hz() is None
    clock.restart_window()
    for k in range(11):
        clock.accept(k * 10_000_000)
    assert clock.rate_hz() == pytest.approx(100.0)
    clock.restart_window()
    assert clock.rate_hz() is None
    for k in range(1, 6):
        clock.accept(100_000_000 + k * 1_000_000)
    assert clock.rate_hz() == pytest.approx(1000.0)


def sample(stamp_ns: int, rate: float = 0.0):
    return (stamp_ns, rate, 1.0, None)


def stamps_of(sets) -> list[list[int]]:
    return [[s[0] for s in one] for one in sets]


def test_equal_stamps_join_as_soon_as_all_are_there() -> None:
    join = StampJoin(3, 0.001)
    assert join.add(0, sample(10)) == []
    assert join.add(2, sample(10)) == []
    assert stamps_of(join.add(1, sample(10))) == [[10, 10, 10]]


def test_nearest_is_taken_even_when_it_comes_later() -> None:
    join = StampJoin(2, 1e-6)
    join.add(1, sample(0))
    assert join.add(0, sample(900)) == []  # one nearer than 900 ns may come
    assert stamps_of(join.add(1, sample(1000))) == [[900, 1000]]
    assert join.unmatched == 0


def test_too_far_apart_is_left_out() -> None:
    join = StampJoin(2, 1e-7)
    join.add(1, sample(0))
    join.add(0, sample(500))
    assert join.add(1, sample(1000)) == []
    assert join.unmatched == 1
    assert stamps_of(join.add(0, sample(1000))) == [[1000, 1000]]


def test_silent_gyro_does_not_fill_the_memory() -> None:
    join = StampJoin(2, 1.0, depth=10)
    for k in range(100):
        assert join.add(0, sample(k)) == []
    assert join.unmatched == 90
    assert len(join.add(1, sample(1000))) == 10
    join.clear()
    assert join.add(1, sample(2000)) == []


@given(
    offsets=st.tuples(*[st.integers(-400, 400)] * 2),
    order=st.randoms(use_true_random=False),
)
def test_streams_of_constant_lag_join_completely(offsets: tuple[int, int], order) -> None:
    """Three streams of one rate, each with its lag below half a period and arriving in any interleaving, all join with their twins."""
    period, n = 1000, 12
    join = StampJoin(3, 1.0)
    queues = [[sample(k * period + lag) for k in range(n + 1)] for lag in (0, *offsets)]
    found = []
    while any(queues):
        index = order.choice([i for i, q in enumerate(queues) if q])
        found += join.add(index, queues[index].pop(0))
    assert stamps_of(found)[:n] == [[k * period, k * period + offsets[0], k * period + offsets[1]] for k in range(n)]


def test_the_claim_grows_with_the_distance_from_the_temperature_without_a_word_from_the_user() -> None:
    """Drawn rings 3 K warmer than their record: what their bias moved is within what is claimed, neither far less nor more."""
    ratios = []
    for seed in range(30):
        unit = draw_unit(load_device("ring_15k"), seed)
        here, there = (
            truth_of(replace(unit, environment=replace(unit.environment, temperature_degc=t)), Command(), 0.0) for t in (25.0, 28.0)
        )
        state = make_state()
        state.offer(make_record(bias=Quantity(here.bias_rad_s, 1.0 * DEG_H, "rad/s"), bias_scale_covariance=0.0), "test")
        state.temperature_degc = 25.0
        state.refresh(NOON)
        near = variance(state, 0.0)
        state.temperature_degc = 28.0
        state.refresh(NOON)
        claimed = math.sqrt(variance(state, 0.0) - near) * 1.03
        ratios.append(abs(there.bias_rad_s - here.bias_rad_s) / claimed)
    assert 0.4 < float(np.median(ratios)) < 1.0
    assert np.mean(np.array(ratios) < 2.0) > 0.9


def test_who_states_a_sensitivity_is_taken_at_his_word() -> None:
    state = make_state(bias_temperature_sd_rad_s_per_k=2.0 * DEG_H, scale_factor_temperature_sd_per_k=0.0)
    state.offer(make_record(), "test")
    state.temperature_degc = 25.0
    state.refresh(NOON)
    near = variance(state, 0.0)
    state.temperature_degc = 28.0
    state.refresh(NOON)
    assert variance(state, 0.0) - near == pytest.approx((6.0 * DEG_H / 1.03) ** 2, rel=1e-9)
