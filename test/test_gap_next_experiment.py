"""What to record next of something without a name."""

from __future__ import annotations

import pytest
from table_samples import table_model

from gyro_calib.gap.diagnosis import Unknown
from gyro_calib.gap.monomials import FED, MONOMIALS
from gyro_calib.gap.next_experiment import _recipe, _varied, experiment_for

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
