"""How likely a device is healthy after a diagnosis that names nothing."""

import numpy as np

from gyro_calib.gap.diagnosis import Unknown
from gyro_calib.gap.probabilities import none_or_unknown
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
