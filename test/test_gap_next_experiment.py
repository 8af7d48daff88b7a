"""What to record next of something without a name."""

from __future__ import annotations

import numpy as np
import pytest
from table_samples import table_model

from gyro_calib.gap.diagnosis import Unknown
from gyro_calib.gap.monomials import FED, MONOMIALS
from gyro_calib.gap.next_experiment import _of_several_rates, _recipe, _varied, experiment_for

#: on what terms of other sources depend: courses of time, one recording, halves that disagree
OTHERS = {"time", "recording", "experiment"}


@pytest.mark.parametrize("depends_on", sorted({depends for _, depends in (*MONOMIALS, *FED)} | OTHERS))
def test_the_form_of_whatever_has_no_name_can_be_looked_for(depends_on: str) -> None:
    found = experiment_for(Unknown("drive", "in phase", "|x| x", depends_on, "", 100.0))
    assert found.description.endswith(".")
    assert found.purpose == "find the form of what has no name"


def test_the_experiment_varies_what_the_term_depends_on() -> None:
    said = {d: experiment_for(Unknown("drive", "in phase", "x", d, "", 1.0)).description for d in ("amplitude", "temperature", "rate")}
    assert "five amplitudes" in said["amplitude"]
    assert "10 K" in said["temperature"]
    assert "deg/s" in said["rate"]


def test_a_gyro_whose_wave_never_turns_is_asked_for_no_precession() -> None:
    model = table_model()
    assert "precession" not in _recipe(model, "large drive")
    assert "azimuth" in _varied(model), "nothing to ask for"


@pytest.mark.parametrize(("levels", "several"), [((0.7, -0.7), False), ((0.7, -0.2), True), ((0.7, -0.35), True), ((0.0, 0.0), False)])
def test_an_excess_that_grows_with_the_rate_needs_two_of_them(levels: tuple[float, float], several: bool) -> None:
    """Of 40 deg/s to both sides alone it is one of the angular gain; on its way a motor of 15 ms passes by all rates."""
    t = np.arange(0.0, 8.0, 2e-3)
    commanded = np.select([(t > 2.0) & (t < 4.0), t > 6.0], levels, 0.0)
    motor = np.exp(-np.arange(0.0, 0.1, 2e-3) / 0.015)
    assert _of_several_rates(np.convolve(commanded, motor / motor.sum())[: t.size]) == several
