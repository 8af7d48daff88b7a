"""A patched device is the device that the recordings say: its slow flow to rounding, and its simulation shows the same gap again."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from test_gap_parts import moving

from gyro_calib.cli.main import main
from gyro_calib.device import draw_unit, load_device
from gyro_calib.effects import EFFECTS
from gyro_calib.errors import CalibrationRefused
from gyro_calib.experiments import SimulatedInstrument, gap_ftr_plan, run_plan
from gyro_calib.gap import Diagnosis, FoundEffect, Gap, NextExperiment, Standing, diagnose
from gyro_calib.gap.diagnosis import PatchedEstimate
from gyro_calib.gap.drifts import said_course
from gyro_calib.gap.forms import FORMS, GRADIENT_DAMPS
from gyro_calib.gap.patch import constant_rate, patch_notes, patched_device, with_factory_data
from gyro_calib.quantity import Quantity
from gyro_calib.recording.hdf5 import write_campaign_h5
from gyro_calib.report.gap_tables import effects_table
from gyro_calib.simulation import GyroSimulator
from gyro_calib.units import DEG_H

NOTHING = Quantity(0.0, 0.0, "1")
RATE, TEMPERATURE = 3e-4, 26.3
OMEGA = 2.0 * math.pi * 15003.0
SIZES = {"c_x": 3e-4, "c_y": 5e-4}
STEPS = (
    *("static_x_0", "static_y_0", "static_x_1", "static_y_1", "table_x", "table_y", "locate"),
    *("feed_x_+20hz", "feed_y_+20hz", "feed_x_-20hz", "feed_y_-20hz"),
    *("side_x_a1_0.5hz", "side_y_a1_0.5hz", "side_x_a1.4_0.5hz", "side_y_a1.4_0.5hz", "side_x_a0.6_1.5hz", "side_y_a0.6_1.5hz"),
)


def diagnosis_of(estimate, effects=(), standings=()):
    gap = Gap(1.0, 1.0, NOTHING, NOTHING, NOTHING, NOTHING, NOTHING)
    following = NextExperiment("nothing", "nothing")
    return Diagnosis(
        "unit", "none", "", tuple(effects), None, (), tuple(standings), gap, (), following, 0.0, 0.0, 1, 1.0, 0.0, 3, 1.0, estimate=estimate
    )


def estimate_of(device, *, turned, values=()):
    """What a perfect fit would say of a device."""
    flow = device.slow_flow(RATE, temperature_degc=TEMPERATURE, omega_rad_s=OMEGA)
    found = dict(values)
    if turned:
        d = flow.dA_dOmega
        mismatch, skew = 0.5 * (d[0, 1] + d[1, 0]), 0.5 * (d[0, 0] - d[1, 1])
        found |= {"rate_mismatch_re": mismatch.real, "rate_mismatch_im": mismatch.imag, "rate_skew_re": skew.real}
    return PatchedEstimate(flow.A, flow.G, flow.E, OMEGA, TEMPERATURE, -2.5, device.resonator.angular_gain, found)


# -- the linear part --------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_slow_flow_is_that_of_the_estimate(seed, turned):
    truth, previous = draw_unit(load_device("ring_15k"), seed), load_device("ring_15k")
    diagnosis = diagnosis_of(estimate_of(truth, turned=turned))
    patched = patched_device(with_factory_data(previous, truth.factory(), diagnosis), diagnosis)
    flow = patched.slow_flow(constant_rate(patched, diagnosis), temperature_degc=TEMPERATURE, omega_rad_s=OMEGA)
    for name in "AGE":
        wanted = getattr(diagnosis.estimate, name)
        assert np.abs(getattr(flow, name) - wanted).max() < 1e-9 * np.abs(wanted).max(), name


def test_a_rotation_tells_pickoffs_drives_and_rate():
    truth = draw_unit(load_device("ring_15k"), 4)
    diagnosis = diagnosis_of(estimate_of(truth, turned=True))
    patched = patched_device(load_device("ring_15k"), diagnosis)
    assert patched.pickoff.gain_mismatch == pytest.approx(truth.pickoff.gain_mismatch, abs=2e-5)
    assert patched.pickoff.non_orthogonality_rad == pytest.approx(truth.pickoff.non_orthogonality_rad, abs=1e-5)
    assert patched.drive.gain_mismatch == pytest.approx(truth.drive.gain_mismatch, abs=1e-5)
    assert patched.drive.two_delta_rad == pytest.approx(truth.drive.two_delta_rad, abs=1e-5)
    assert constant_rate(patched, diagnosis) == pytest.approx(RATE, abs=0.02 * RATE)
    assert patched.resonator.quality_factor == pytest.approx(truth.resonator.quality_factor / (TEMPERATURE + 273.15) * 298.15, rel=1e-3)
    assert any("turned" in note for note in patch_notes(patched, diagnosis))


def test_without_a_rotation_the_ratio_of_the_drives_is_the_factorys():
    truth = draw_unit(load_device("ring_15k"), 4)
    diagnosis = diagnosis_of(estimate_of(truth, turned=False))
    patched = patched_device(with_factory_data(load_device("ring_15k"), truth.factory(), diagnosis), diagnosis)
    ratio = truth.factory_data.drive_gain_ratio_x_over_y
    assert 1.0 / (1.0 + patched.drive.gain_mismatch) == pytest.approx(ratio, rel=1e-4)
    assert any("Without a rotation" in note for note in patch_notes(patched, diagnosis))


def test_factory_data_without_a_scale_factor_get_a_fitting_one():
    truth = draw_unit(load_device("ring_15k"), 4)
    diagnosis = diagnosis_of(estimate_of(truth, turned=False))
    factory = {"angular_gain_kappa": 0.8, "nominal_f0_hz": 15001.0, "nominal_q": 29000.0}
    f = with_factory_data(load_device("ring_15k"), factory, diagnosis).factory_data
    assert (f.nominal_f0_hz, f.nominal_q) == (15001.0, 29000.0)
    assert f.nominal_scale_factor_x_v_per_rad_s == pytest.approx(0.8 / abs(diagnosis.estimate.G[1, 1]))
    assert f.nominal_scale_factor_y_v_per_rad_s == pytest.approx(-0.8 / abs(diagnosis.estimate.G[0, 0]))


def test_no_estimate_and_no_resonator_are_refused():
    device = load_device("ring_15k")
    with pytest.raises(CalibrationRefused, match="must have an estimate"):
        patched_device(device, diagnosis_of(None))
    growing = estimate_of(device, turned=False)
    growing = replace(growing, A=growing.A + 5.0 * np.eye(2))
    with pytest.raises(CalibrationRefused, match="damped"):
        patched_device(device, diagnosis_of(growing))


# -- effects ----------------------------------------------------------------------------------------------------------------------------


def standing(name, status):
    return Standing(name, name, "dynamics", status, None, 0.0, 0.0, 0.0)


def test_effects_found_replace_those_tested_and_leave_the_others():
    previous = load_device("ring_15k")
    previous = replace(
        previous,
        effects={"duffing": {"k": 0.1}, "thermal_lag": {"tau": 20.0}},
        nonlinearity=replace(previous.nonlinearity, cubic_isotropic=1e15, damping_quadratic=1e9),
    )
    sizes = {"c_x": Quantity(0.01, 1e-4, "1/s/V^2"), "c_y": Quantity(0.02, 1e-4, "1/s/V^2")}
    found = FoundEffect("nonlinear_damping", "", ("nonlinear_damping",), 0.99, sizes, "dynamics", "nonlinear_damping_axes", 100.0)
    warm = {"thermal_drive_gain.g_x": 1e-4, "thermal_drive_gain.g_y": 2e-4, "thermal_damping.c": 0.004}
    estimate = estimate_of(previous, turned=False, values=warm)
    tested = [standing("duffing", "excluded"), standing("nonlinear_damping", "present"), standing("thermal_lag", "not testable")]
    patched = patched_device(previous, diagnosis_of(estimate, [found], tested))
    assert patched.effects == {
        "thermal_lag": {"tau": 20.0},
        "thermal_drive_gain": {"g_x": 1e-4, "g_y": 2e-4},
        "nonlinear_damping_axes": {"c_x": 0.01, "c_y": 0.02, "c_xy": 0.0, "c_yx": 0.0, "c_xxyy": 0.0},
    }
    assert (patched.nonlinearity.cubic_isotropic, patched.nonlinearity.damping_quadratic) == (0.0, 0.0)
    assert patched.drive.gain_tempco_per_k == 0.0
    h = 0.01
    slope = (patched.resonator.decay_rate(TEMPERATURE + h) - patched.resonator.decay_rate(TEMPERATURE - h)) / (2.0 * h)
    assert slope == pytest.approx(0.004, rel=1e-6)


def test_damping_that_bends_is_what_its_law_of_temperature_leaves():
    previous = load_device("ring_15k")
    values = {"thermal_drive_gain.g_x": 1e-4, "thermal_damping.c": 0.01, "damping_per_k2": 3e-4}
    found = FoundEffect(
        "thermal_damping_curvature", "", ("thermal_damping_curvature",), 0.99, {"c": Quantity(-1e-3, 1e-5, "1/s/K^2")}, "dynamics",
        "thermal_damping_curvature", 100.0,
    )  # fmt: skip
    estimate = estimate_of(previous, turned=False, values=values)
    patched = patched_device(previous, diagnosis_of(estimate, [found], [standing("thermal_damping_curvature", "present")]))
    rise = np.array([-4.0, 4.0])
    rates = [patched.resonator.decay_rate(TEMPERATURE + r) for r in rise] + patched.effects["thermal_damping_curvature"]["c"] * rise**2
    # the nuisance counts p' = +T^2 p, the effect -c T^2 p
    expected = patched.resonator.decay_rate(TEMPERATURE) + 0.01 * rise + (-1e-3 - 3e-4) * rise**2
    np.testing.assert_allclose(rates, expected, atol=1e-6)


def test_what_a_gradient_damps_is_in_the_patched_device():
    """By the fit's column of it, so that the device file's effect of its own does to a wave what the column does."""
    previous, tau = load_device("ring_15k"), 7.8
    sizes = {"k_c": Quantity(1e-5, 1e-6, "rad/s/K"), "k_s": Quantity(4e-5, 1e-6, "rad/s/K"), "tau": Quantity(tau, 0.1, "s")}
    found = FoundEffect("thermal_split_lag", "", ("thermal_split_lag",), 0.9, sizes, "environment", "thermal_split_lag", 100.0)
    estimate = estimate_of(previous, turned=False, values={GRADIENT_DAMPS[0]: 3.23e-6})
    patched = patched_device(previous, diagnosis_of(estimate, [found], [standing("thermal_split_lag", "present")]))
    assert patched.effects["thermal_damping_lag"] == {"c": pytest.approx(3.23e-6 * GRADIENT_DAMPS[1]), "tau": tau}
    notes = patch_notes(patched, diagnosis_of(estimate, [found]))
    assert [n for n in notes if "thermal_damping_lag" in n] == [
        "What the gradient of thermal_split_lag damps, -3.23e-05 1/s/K, is thermal_damping_lag here."
    ]
    signals, linear = moving(0.0)
    signals.__dict__["temperature_k"] = 0.5 * signals.time_s
    column = {f"thermal_split_lag.{p.parameter}": p.signal for p in FORMS["thermal_split_lag"].parts(signals, linear, {"tau": tau})}
    (damping,) = FORMS["thermal_damping_lag"].parts(signals, linear, {"tau": tau})
    np.testing.assert_allclose(column[GRADIENT_DAMPS[0]], GRADIENT_DAMPS[1] * damping.signal)
    # what was not named is in no device file
    assert "thermal_damping_lag" not in patched_device(previous, diagnosis_of(estimate)).effects


def test_a_healthy_bias_that_follows_the_temperature_is_in_the_patched_device():
    previous = load_device("ring_15k")
    estimate = estimate_of(previous, turned=False, values={"thermal_drive_gain.g_x": 1e-4, "rate_per_k": 4e-5})
    patched = patched_device(previous, diagnosis_of(estimate))
    assert patched.effects["thermal_bias"]["b"] == pytest.approx(4e-5 / estimate.angular_gain)


# -- the whole way ----------------------------------------------------------------------------------------------------------------------


def simulated(device, seed, rate_rad_s):
    """A small campaign at carrier level."""
    plan = gap_ftr_plan(device.factory(), quality="quick", abilities=("applied_rate",))
    plan = replace(plan, steps=tuple(s for s in plan.steps if s.label in STEPS))
    simulator = GyroSimulator(device, rng=np.random.default_rng(seed), fidelity="carrier")
    return run_plan(SimulatedInstrument(simulator, rate_rad_s), plan)


@pytest.mark.slow
def test_simulation_of_the_patched_device_shows_the_same_effect_again(tmp_path, capsys):
    unit = replace(draw_unit(load_device("ring_15k"), 7), effects={"pickoff_nonlinearity": SIZES})
    path = write_campaign_h5(tmp_path / "first.h5", simulated(unit, 1, 20.0 * DEG_H))
    files = {name: tmp_path / name for name in ("gap.json", "gap.html", "patched.yaml")}
    options = ("--device", "ring_15k", "--json", files["gap.json"], "--html", files["gap.html"], "--patched-device", files["patched.yaml"])
    assert main(["diagnose", str(path), *map(str, options)]) == 0
    out = capsys.readouterr().out
    assert "pickoff_nonlinearity" in out
    assert "simulate --rate" in out
    first = json.loads(files["gap.json"].read_text())
    assert [e["name"] for e in first["effects"]] == ["pickoff_nonlinearity"]
    patched = load_device(files["patched.yaml"])
    assert "# Patched by a diagnosis" in files["patched.yaml"].read_text()
    assert patched.effects["pickoff_nonlinearity"] == pytest.approx({k: q["value"] for k, q in first["effects"][0]["parameters"].items()})
    second = diagnose(simulated(patched, 2, 20.0 * DEG_H))
    (again,) = second.effects
    assert again.name == "pickoff_nonlinearity"
    assert second.gap.closed_fraction.value > 0.9
    for name, before in first["effects"][0]["parameters"].items():
        after = again.parameters[name]
        assert abs(after.value - before["value"]) < 4.0 * math.hypot(after.sd, before["sd"])
        assert abs(before["value"] - SIZES[name]) < 5.0 * before["sd"]
    assert main(["simulate", str(files["patched.yaml"]), "--plan", "static", "--quality", "quick", "--out", str(tmp_path / "again")]) == 0


def test_a_bent_drift_is_a_straight_one_of_a_device_file_and_that_is_said() -> None:
    device = load_device("ring_15k")
    straight = FoundEffect(
        name="drive_gain_drift",
        title=EFFECTS["drive_gain_drift"].title,
        group=("drive_gain_drift",),
        probability=0.9,
        parameters={"g_x": Quantity(0.0, 1e-8, "1/s"), "g_y": Quantity(1e-6, 1e-8, "1/s")},
        location="drive",
        registry_name="drive_gain_drift",
        gain=1000.0,
    )
    bent = replace(straight, title=straight.title + said_course({"saturates_s": 70.0, "end_s": 400.0}))
    for effect, said in ((straight, False), (bent, True)):
        diagnosis = diagnosis_of(estimate_of(device, turned=False), [effect])
        notes = patch_notes(patched_device(device, diagnosis), diagnosis)
        assert any("bent course of drive_gain_drift" in note for note in notes) is said
        assert any("a course that saturates" in cell for row in effects_table(diagnosis).rows for cell in row) is said
