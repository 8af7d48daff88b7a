"""The zero-order hold of the input rate."""

from __future__ import annotations

import numpy as np
import pytest

from gyro_calib.nodes.rate_input import RateInput


def test_nothing_said_is_no_rate() -> None:
    held = RateInput(timeout_s=0.5)
    np.testing.assert_array_equal(held.sample(np.array([1.0, 2.0])), [0.0, 0.0])
    assert not held.stale


def test_each_value_holds_from_its_stamp_to_the_next() -> None:
    held = RateInput()
    held.push(1.0, 0.15)
    held.push(2.0, 0.35)
    np.testing.assert_array_equal(held.sample(np.array([0.1, 0.2, 0.3])), [0.0, 1.0, 1.0])
    np.testing.assert_array_equal(held.sample(np.array([0.35, 0.4, 500.0])), [2.0, 2.0, 2.0])


@pytest.mark.parametrize("stamp", [None, 0.5, 9.9, 1.7e9, -3.0])
def test_a_stamp_that_is_absent_past_or_of_another_clock_counts_from_now(stamp: float | None) -> None:
    held = RateInput()
    held.sample(np.array([1.0]))
    held.push(3.0, stamp)
    np.testing.assert_array_equal(held.sample(np.array([1.1, 1.2])), [3.0, 3.0])


def test_a_simulation_that_lags_behind_its_clock_takes_each_value_at_its_time() -> None:
    held = RateInput(window_s=1.0)
    held.sample(np.array([1.0]))
    held.push(3.0, 4.0, clock_s=4.0)
    held.push(5.0, 6.0, clock_s=4.0)  # ahead of the clock too
    np.testing.assert_array_equal(held.sample(np.array([1.1, 3.9, 4.0, 4.1])), [0.0, 0.0, 5.0, 5.0])
    held.push(7.0, 5.0, clock_s=4.2)
    np.testing.assert_array_equal(held.sample(np.array([4.9, 5.1])), [5.0, 7.0])


def test_what_waits_for_a_time_that_will_not_come_holds_from_now_on() -> None:
    held = RateInput()
    held.sample(np.array([1.0]))
    held.push(3.0, 4.0, clock_s=8.0)
    held.push(5.0, 8.0, clock_s=8.0)
    held.catch_up()
    np.testing.assert_array_equal(held.sample(np.array([1.1, 9.0])), [5.0, 5.0])
    held.catch_up()  # nothing waits, nothing changes
    assert held.sample(np.array([9.1])) == 5.0


def test_a_value_out_of_order_does_not_undo_later_ones() -> None:
    held = RateInput()
    held.push(1.0, 0.3)
    held.push(2.0, 0.2)
    held.push(3.0, 0.35)
    np.testing.assert_array_equal(held.sample(np.array([0.25, 0.3, 0.34, 0.4])), [0.0, 2.0, 2.0, 3.0])


def test_a_rate_that_nobody_renews_times_out_and_comes_back() -> None:
    held = RateInput(timeout_s=0.5)
    held.push(1.0, 0.0)
    np.testing.assert_array_equal(held.sample(np.array([0.4, 0.6])), [1.0, 0.0])
    assert held.stale
    held.push(1.5, 0.7)
    np.testing.assert_array_equal(held.sample(np.array([0.65, 0.7])), [0.0, 1.5])
    assert not held.stale


@pytest.mark.parametrize("rate", [np.nan, np.inf, -np.inf])
def test_a_rate_that_is_not_finite_is_not_taken(rate: float) -> None:
    held = RateInput()
    assert held.push(1.0)
    assert not held.push(rate)
    assert held.sample(np.array([1.0])) == 1.0


def test_no_rows_ask_for_nothing() -> None:
    held = RateInput()
    held.push(1.0)
    assert held.sample(np.zeros(0)).shape == (0,)
    assert held.sample(np.array([0.0])) == 1.0
