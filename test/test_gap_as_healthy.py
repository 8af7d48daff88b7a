"""What a device has as any healthy one may: no effect, but said by its name and with its size."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from quick_looks import healthy, looked_at

from gyro_calib.device import draw_unit, load_device
from gyro_calib.experiments import SimulatedInstrument, gap_ftr_plan, run_plan
from gyro_calib.gap.as_healthy import _of_both, as_healthy
from gyro_calib.gap.column import Column
from gyro_calib.gap.diagnose import diagnose
from gyro_calib.gap.healthy import HealthySpread
from gyro_calib.gap.model import CampaignModel, look_at
from gyro_calib.gap.select import select_effects
from gyro_calib.gap.system import Solution
from gyro_calib.quantity import Quantity
from gyro_calib.recording.recording import Campaign
from gyro_calib.report.gap_tables import as_healthy_table
from gyro_calib.simulation import GyroSimulator

#: of the drive of y and of x besides the unit's own [1/K]
Y_PER_K, X_PER_K = 1.9e-4, -1.7e-4


@cache
def campaign(g_x: float, g_y: float) -> Campaign:
    """A ring with its temperature run, whose drives' gains part with the temperature."""
    device = draw_unit(load_device("ring_15k"), 5)
    device = replace(device, effects={"thermal_drive_gain": {"g_x": g_x, "g_y": g_y}})
    instrument = SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(3), fidelity="slow_flow"), 2e-5)
    return run_plan(instrument, gap_ftr_plan(device.factory(), quality="quick", abilities=("temperature",)))


@cache
def model(g_x: float, g_y: float) -> CampaignModel:
    made = campaign(g_x, g_y)
    f = made.factory
    return look_at(list(made), math.pi * f["nominal_f0_hz"] / f["nominal_q"], f["angular_gain_kappa"])


@pytest.mark.parametrize(("g_x", "g_y"), [(X_PER_K, Y_PER_K), pytest.param(0.0, 0.0, marks=pytest.mark.slow)])
def test_drives_that_part_with_the_temperature_are_said_with_their_sizes(g_x: float, g_y: float) -> None:
    """Besides what the unit's chains have alike; of a device without the effect that is all that is said of its gains."""
    device, m = draw_unit(load_device("ring_15k"), 5), model(g_x, g_y)
    alike = device.drive.gain_tempco_per_k + device.pickoff.gain_tempco_per_k
    (held,) = [h for h in as_healthy(m, (), m.base) if h.name.startswith("thermal_") and h.name.endswith("_gain")]
    assert held.told == {}
    for name, size in (("g_x", g_x), ("g_y", g_y)):
        told = held.parameters[name]
        assert told.value == pytest.approx(alike + size, abs=4.0 * told.sd)
        assert 0.0 < told.sd < 5e-6
    assert held.gain > 1000.0
    assert held.usual == {"gain_per_k": HealthySpread().gain_per_k, "axis_gain_per_k": HealthySpread().axis_gain_per_k}
    assert (held.times_usual > 1.0) == (g_x != g_y)


def test_two_axes_that_only_their_difference_tells_are_said_by_it() -> None:
    """All of a drive's gain that both axes have is a damping."""
    columns = tuple(Column(f"thermal_drive_gain.g_{axis}", (), ()) for axis in "xy")
    alike, apart = 1e-8, 1e-12
    covariance = np.array([[alike + apart, alike], [alike, alike + apart]])
    fit = Solution(columns, np.array([-2e-5, 2.7e-4]), covariance, np.zeros(0), 0.0, np.zeros((0, 2)))
    sizes = {name: Quantity(v, 1e-4, "1/K") for name, v in (("g_x", -2e-5), ("g_y", 2.7e-4))}
    told = _of_both(sizes, fit, {"g_x": 0, "g_y": 1})
    assert list(told) == ["g_y - g_x"]
    assert (told["g_y - g_x"].value, told["g_y - g_x"].sd) == pytest.approx((2.9e-4, math.sqrt(2.0 * apart)))
    assert _of_both(sizes, replace(fit, covariance=np.diag([1e-8, 1e-8])), {"g_x": 0, "g_y": 1}) == {}
    assert _of_both(sizes, fit, {"g_x": 0}) == {}


def test_an_effect_that_was_found_and_one_that_the_registry_does_not_hold_are_none_of_these() -> None:
    m = model(X_PER_K, Y_PER_K)
    (chosen,) = m.candidates["thermal_drive_gain"]
    assert "thermal_drive_gain" not in [h.name for h in as_healthy(m, [chosen], m.fitted([chosen]))]
    assert "thermal_drive_gain" not in [h.name for h in as_healthy(m, (), m.base, ("thermal_drive_gain",))]


@pytest.mark.slow
def test_the_diagnosis_says_it_in_words_rows_and_json() -> None:
    found = diagnose(campaign(X_PER_K, Y_PER_K))
    assert found.verdict == "none"
    assert "as some do: thermal_drive_gain (g_x = " in found.summary
    said = next(h for h in found.to_json()["as_healthy"] if h["name"] == "thermal_drive_gain")
    assert said["parameters"]["g_y"]["value"] - said["parameters"]["g_x"]["value"] == pytest.approx(Y_PER_K - X_PER_K, rel=0.1)
    assert [line.split("=")[0] for line in said["simulate"]] == ["thermal_drive_gain.g_x", "thermal_drive_gain.g_y"]
    assert as_healthy_table(found).rows[0][0] == "thermal_drive_gain"


def test_the_axes_of_a_split_turn_with_the_temperature() -> None:
    """All healthy units of a plant by another hand had a *thermal split*, for theirs turned by 0.07 to 0.3 mrad/K."""
    model = healthy("ring")
    unequal = float(np.abs(model.linear.A - np.eye(2) * np.trace(model.linear.A) / 2.0).max())
    allowed = {c.name: c.prior_sd / unequal for c in model.nuisances if c.name.startswith("thermal_split.")}
    assert allowed == {"thermal_split.k_c": pytest.approx(1e-3, rel=0.2), "thermal_split.k_s": pytest.approx(1e-3, rel=0.2)}
    found = looked_at("ring", {"thermal_split": {"k_c": 8e-3 * unequal, "k_s": -8e-3 * unequal}})
    assert [e.name for e in select_effects(found).effects] == ["thermal_split"]
