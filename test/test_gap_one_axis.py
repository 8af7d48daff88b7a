"""A campaign of one axis: the other holds noise that its controller answers, and that is no law of the device."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from table_samples import looked_at, on_a_table, table_model

from gyro_calib.gap.column import Column
from gyro_calib.gap.model import CampaignModel
from gyro_calib.gap.one_axis import axis_alone, heard
from gyro_calib.gap.select import select_effects
from gyro_calib.recording.recording import Recording


def of_axis(r: Recording, axis: str) -> bool:
    return (r.command.oscillator_axis or r.command.excitation.axis) == axis


#: each is a model of its own, half a minute: the second one is among the long tests
AXES = ("x", pytest.param("y", marks=pytest.mark.slow))


@cache
def alone(axis: str) -> CampaignModel:
    whole = on_a_table()
    return looked_at(replace(whole, recordings=tuple(r for r in whole if of_axis(r, axis))))


@pytest.mark.parametrize("axis", AXES)
def test_the_axis_at_rest_keeps_its_noise(axis: str) -> None:
    """It fell to a ten-thousandth where damping and gain of that axis were free to be the loop's."""
    model, whole = alone(axis), table_model()
    assert axis_alone(model.evidence) == "xy".index(axis)
    assert axis_alone(whole.evidence) is None
    role = f"ftr_{axis}"
    lines = next(r for r in model.evidence if r.role == role).lines("precession")
    for channel in ("precession", "quadrature"):
        ratio = np.median(model.noise[role, channel].density(lines) / whole.noise[role, channel].density(lines))
        assert 0.2 < ratio < 5.0


@pytest.mark.parametrize("axis", AXES)
def test_the_other_axis_is_of_the_same_design(axis: str) -> None:
    linear, truth, other = alone(axis).linear, table_model().linear, 1 - "xy".index(axis)
    assert abs(linear.G[other, other] / truth.G[other, other] - 1.0) < 0.2
    assert abs(linear.A[other, other].real / truth.A[other, other].real - 1.0) < 2.0


@pytest.mark.parametrize("axis", AXES)
def test_a_healthy_axis_has_nothing_that_is_not_in_the_catalogue(axis: str) -> None:
    selection = select_effects(alone(axis))
    assert not selection.effects
    assert selection.stranger is None


def test_what_grows_from_the_noise_of_an_axis_at_rest_is_not_tried() -> None:
    model = alone("x")
    c = model.candidates["pickoff_gain_drift"][0]
    assert [column.name for column in c.columns] == ["g_x"]
    faint = Column("g_y", tuple(1e-3 * v for v in c.columns[0].signal), tuple(1e-3 * v for v in c.columns[0].quiet))
    apart = replace(faint, name="tau")
    assert [column.name for column in heard(model.evidence, [c.columns[0], faint, apart])] == ["g_x", "tau"]
    both = table_model()
    assert [column.name for column in both.candidates["pickoff_gain_drift"][0].columns] == ["g_x", "g_y"]


def test_constants_of_both_axes_are_heard_whatever_oscillates() -> None:
    """What does not grow from a signal does not grow from its noise."""
    model = alone("x")
    loud = model.candidates["pickoff_gain_drift"][0].columns[0]
    constants = [replace(loud, name="f_xc"), Column("f_yc", tuple(1e-3 * v for v in loud.signal), tuple(1e-3 * v for v in loud.quiet))]
    assert heard(model.evidence, constants) == constants
