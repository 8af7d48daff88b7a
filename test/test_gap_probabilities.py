"""How likely a device is healthy after a diagnosis that names nothing."""

import numpy as np
import pytest

from gyro_calib.gap.diagnosis import FoundEffect, Unknown
from gyro_calib.gap.probabilities import beside_unknown, none_or_unknown
from gyro_calib.gap.screen import Candidate, Screened
from gyro_calib.gap.select import Selection


def selection(log_evidence: float, *, named: bool = False) -> Selection:
    candidate = Candidate("duffing", {}, (), np.ones(1))
    found = Screened(candidate, 30.0, 1, log_evidence, np.ones(1), np.ones(1), 0.1, np.ones((1, 1)))
    return Selection(
        (found,) if named else (), (("duffing",),) if named else (), (0.8,) if named else (), None, {"duffing": found}, 1.0, 1.0, 1
    )


def test_evidence_that_healthy_devices_reach_leaves_them_likely():
    """A verdict of none does not read as doubted: of trials with that verdict most were healthy, whatever the evidence below the limit."""
    said = [none_or_unknown(selection(best), (), None)[0] for best in (-5.0, 2.0, 4.0, 8.0, 11.9)]
    assert said == sorted(said, reverse=True)
    assert said[0] > 0.8
    assert said[-1] > 0.6


def test_none_is_believed_no_more_than_trials_allow():
    """Of what is there a sixth is not seen: no campaign makes a healthy device certain."""
    none, unnamed = none_or_unknown(selection(-9.0), (), None)
    assert 0.8 < none < 0.87
    assert 0.05 < unnamed < 1.0 - none


def test_a_name_leaves_little_for_none():
    weak, strong = (none_or_unknown(selection(best, named=True), (), None)[0] for best in (12.0, 40.0))
    assert strong < 1e-6 < weak < 0.1


def test_what_is_unknown_is_most_likely_so_and_the_more_so_the_larger_it_is():
    """Every report had 90 %, a cubic of 137 000 in chi-square and a healthy floor of 87."""
    said = [none_or_unknown(selection(3.0), (), Unknown("drive", "in phase", "x", "time", "", gain)) for gain in (60.0, 300.0, 1e5)]
    assert [none for none, _ in said] == sorted((none for none, _ in said), reverse=True)
    assert said[0][0] > 0.1
    assert said[-1][0] < 0.02
    for none, unknown in said:
        assert 0.8 < unknown <= 1.0 - none


@pytest.mark.parametrize(
    ("gains", "unknown", "stand"),
    [
        ((13_280.0,), 134.0, (13_280.0,)),
        ((9_000.0, 700.0), 100.0, (9_000.0,)),
        ((900.0,), 134.0, ()),
        # three that imitate one term
        ((9_000.0, 8_000.0, 7_000.0), 100.0, ()),
    ],
)
def test_beside_something_unknown_stands_what_takes_many_times_as_much(
    gains: tuple[float, ...], unknown: float, stand: tuple[float, ...]
) -> None:
    """A stiffness of 13 280 on a hemisphere of another plant was not in the verdict at all, for 134 that no name took."""
    effects = tuple(FoundEffect("duffing", "", ("duffing",), 0.9, {}, "dynamics", "duffing", gain) for gain in gains)
    left = Unknown("pick-off", "in phase", "x", "time", "", unknown)
    assert tuple(e.gain for e in beside_unknown(effects, left)) == stand
    assert beside_unknown(effects, None) == effects


def test_a_device_with_an_effect_beside_something_unknown_is_not_healthy():
    effect = FoundEffect("duffing", "", ("duffing",), 0.9, {}, "dynamics", "duffing", 9e3)
    left = Unknown("pick-off", "in phase", "x", "time", "", 60.0)
    assert none_or_unknown(selection(3.0), (), left, (effect,))[0] == 0.0 < none_or_unknown(selection(3.0), (), left)[0]
