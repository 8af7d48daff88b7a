"""When a simulated gyro may go on, and what its stamps are."""

from __future__ import annotations

from gyro_calib.nodes.pacing import FollowClock, FreeRun


class Hand:
    """A clock moved by hand [s]."""

    def __init__(self, now: float = 0.0) -> None:
        self.now = now

    def seconds(self) -> float:
        return self.now

    def nanoseconds(self) -> int:
        return round(self.now * 1e9)


def test_free_run_never_waits_and_starts_after_zero() -> None:
    pacer = FreeRun(0.0, epoch_s=1.0)
    assert pacer.wait_s(1e6) == 0.0
    assert pacer.stamp_ns(0.1) == 1_100_000_000
    assert pacer.stamp_ns(-0.006) == 994_000_000


def test_a_factor_paces_against_the_steady_clock() -> None:
    hand = Hand(100.0)
    pacer = FreeRun(10.0, now=hand.seconds)
    assert pacer.wait_s(0.1) == 0.0
    assert abs(pacer.wait_s(0.2) - 0.01) < 1e-12
    hand.now += 0.01
    assert pacer.wait_s(0.2) < 1e-12
    # never longer than what lets a stop be noticed
    assert pacer.wait_s(1000.0) == 0.05


def test_after_a_stall_the_pace_goes_on_without_a_burst() -> None:
    hand = Hand()
    pacer = FreeRun(10.0, now=hand.seconds)
    pacer.wait_s(0.1)
    hand.now += 60.0
    assert pacer.wait_s(0.2) == 0.0
    assert pacer.wait_s(0.3) > 0.009


def test_following_a_clock_waits_for_it() -> None:
    hand = Hand(0.0)
    pacer = FollowClock(hand.nanoseconds, longest_wait_s=0.002)
    # a simulated clock that nobody publishes yet
    assert pacer.wait_s(0.01) == 0.002
    assert not pacer.started
    hand.now = 50.0
    assert pacer.wait_s(0.01) == 0.0
    assert pacer.started
    assert pacer.stamp_ns(0.01) == 50_000_000_000
    assert pacer.wait_s(0.02) == 0.002
    hand.now = 50.01
    assert pacer.wait_s(0.02) == 0.0
    assert pacer.stamp_ns(0.02) == 50_010_000_000


def test_a_short_lag_is_made_up_without_a_jump() -> None:
    hand, jumps = Hand(50.0), []
    pacer = FollowClock(hand.nanoseconds, jumps.append)
    pacer.wait_s(0.0)
    hand.now = 54.0
    assert all(pacer.wait_s(0.1 * n) == 0.0 for n in range(1, 40))
    assert pacer.wait_s(4.5) > 0.0
    assert not jumps
    assert pacer.stamp_ns(4.0) == 54_000_000_000


def test_a_clock_that_runs_away_or_goes_back_is_followed_and_told() -> None:
    hand, jumps = Hand(50.0), []
    pacer = FollowClock(hand.nanoseconds, jumps.append)
    pacer.wait_s(1.0)
    hand.now = 70.0
    assert pacer.wait_s(1.1) == 0.0
    assert pacer.stamp_ns(1.1) == 70_000_000_000
    hand.now = 10.0
    assert pacer.wait_s(1.2) == 0.0
    assert pacer.stamp_ns(1.2) == 10_000_000_000
    assert [round(lag, 1) for lag in jumps] == [19.9, -60.1]
