"""The side-band estimate: against carrier-level truth, against another plant's recordings, and its refusals."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from bench_data import BENCH, needs_bench, truth

from gyro_calib.calibration import record_from_result
from gyro_calib.device import Device, draw_unit, load_device
from gyro_calib.device.operating_point import ftr_operating_point
from gyro_calib.errors import CalibrationRefused
from gyro_calib.estimation import CalibrationResult, calibrate
from gyro_calib.estimation.projection import project, test_functions
from gyro_calib.estimation.separation import PickoffFrame, angular_response, input_rate_times_kappa
from gyro_calib.estimation.slow_flow_data import usable_recordings
from gyro_calib.estimation.slow_flow_fit import fit_slow_flow
from gyro_calib.experiments import SimulatedInstrument, run_plan, self_calibration_plan
from gyro_calib.recording import load_campaign
from gyro_calib.recording.command import Command
from gyro_calib.recording.recording import Campaign, Recording
from gyro_calib.simulation import GyroSimulator
from gyro_calib.simulation.truth import Truth
from gyro_calib.units import DEG_H

RATE = 9.3 * DEG_H


def _run(seed: int, *, noisy: bool = True, quality: str = "quick", fidelity: str = "carrier") -> tuple[Device, Campaign, Truth]:
    device = draw_unit(load_device("ring_15k"), seed)
    simulator = GyroSimulator(device, rng=np.random.default_rng([seed, 5]), fidelity=fidelity, noisy=noisy)
    truth_here = simulator.truth()
    campaign = run_plan(SimulatedInstrument(simulator, RATE), self_calibration_plan(simulator.factory, quality=quality))
    return device, campaign, truth_here


@pytest.fixture(scope="module")
def noisy() -> tuple[Device, Campaign, Truth]:
    return _run(1)


@pytest.fixture(scope="module")
def result(noisy: tuple[Device, Campaign, Truth]) -> CalibrationResult:
    return calibrate(noisy[1])


def test_rate_bias_and_scale_factor_lie_within_their_sd_of_the_carrier_level_truth(
    noisy: tuple[Device, Campaign, Truth], result: CalibrationResult
) -> None:
    _, campaign, true = noisy
    record = record_from_result(result, campaign, run_id="test")
    assert abs(result.rate.value - RATE) < 4 * result.rate.sd
    assert abs(record.bias.value - true.bias_rad_s) < 4 * record.bias.sd
    assert abs(record.scale_factor.value - true.scale_factor) < 4 * record.scale_factor.sd
    assert record.bias.sd < 2.0 * DEG_H
    assert record.scale_factor.sd < 50e-6
    # before calibration this unit is off by far more than that
    assert abs(true.bias_rad_s) > 500 * DEG_H
    assert abs(true.scale_factor - 1) > 0.01


def test_noise_free_systematic_error_is_below_a_fifth_of_a_degree_per_hour() -> None:
    device, campaign, true = _run(2, noisy=False)
    # the factory's ratio as it truly is, so that only the estimator's own error remains
    ratio = 1.0 / (1.0 + device.drive.gain_mismatch)
    campaign = replace(campaign, factory={**campaign.factory, "drive_gain_ratio_x_over_y": ratio})
    result = calibrate(campaign, with_convergence=False)
    nominal = campaign.factory["nominal_scale_factor_v_per_rad_s"]["x"]
    mission = result.mission["x"]
    assert abs(mission.bias_v / nominal - true.bias_rad_s) < 0.2 * DEG_H
    assert abs(result.rate.value - RATE) < 0.2 * DEG_H
    assert abs(mission.volts_per_rad_s / nominal / true.scale_factor - 1) < 3e-6


def test_slow_flow_matrices_are_recovered_with_phases_and_feedthrough(noisy: tuple[Device, Campaign, Truth]) -> None:
    device, campaign, _ = noisy
    fit = fit_slow_flow(usable_recordings(campaign)[0], device.resonator.decay_rate())
    true = device.slow_flow(RATE)
    sd = np.sqrt(np.diag(fit.covariance))
    spread = fit.unpack(sd)
    A_sd, G_sd, E_sd = spread.A, spread.G, spread.E
    for i in range(2):
        for j in range(2):
            if i != j:  # the diagonal's imaginary part is the resonance itself, a nuisance
                assert abs((fit.values.A[i, j] - true.A[i, j]).real) < 4.5 * A_sd[i, j].real
                assert abs((fit.values.A[i, j] - true.A[i, j]).imag) < 4.5 * A_sd[i, j].imag
            assert abs(fit.values.G[i, j] - true.G[i, j]) < 4.5 * (abs(G_sd[i, j]) + 1e-6 * abs(true.G[0, 0]))
            assert abs(fit.values.E[i, j] - true.E[i, j]) < 4.5 * abs(E_sd[i, j])
    assert 0.5 < fit.chi2 / fit.dof < 2.0


def test_estimates_converge_and_say_how_far_they_have_come(result: CalibrationResult) -> None:
    assert len(result.convergence) >= 2
    assert result.convergence[-1].bias["x"].value == pytest.approx(result.bias["x"].value)
    times = [p.time_s for p in result.convergence]
    assert times == sorted(times)
    assert {row.axis for row in result.table} == {"", "x", "y"}


def test_json_contract(result: CalibrationResult) -> None:
    document = result.to_json()
    for key in ("device_id", "method", "rate", "bias", "scale_factor", "parameters", "condition_number", "not_observable", "warnings"):
        assert key in document
    assert set(document["bias"]) == {"x", "y"}
    assert {"A_yx_re", "G_yy_abs", "pickoff_ratio"} <= set(document["parameters"])
    for quantity in (document["rate"], *document["bias"].values(), *document["parameters"].values()):
        assert set(quantity) == {"value", "sd", "unit"}


def test_without_body_excitation_and_factory_ratio_the_ratio_is_called_unobservable_and_the_sd_admits_it() -> None:
    _, campaign, true = _run(1)
    loops = tuple(r for r in campaign if r.command.excitation.kind != "body")
    factory = {k: v for k, v in campaign.factory.items() if k != "drive_gain_ratio_x_over_y"}
    result = calibrate(Campaign(campaign.device_id, loops, factory), with_convergence=False)
    assert any(text.startswith("pickoff_ratio") for text in result.not_observable)
    assert any(text.startswith("pickoff_phase") for text in result.not_observable)
    volts = result.mission["x"].volts_per_rad_s
    sd = math.sqrt(result.mission["x"].covariance[1, 1])
    assert sd / volts > 1e-4
    nominal = factory["nominal_scale_factor_v_per_rad_s"]["x"]
    assert abs(volts / nominal - true.scale_factor) < 4 * sd / nominal


def test_wrong_feedthrough_hurts_and_the_measured_one_heals() -> None:
    """Document 000, step 2: without the open-drive records the side bands hardly tell E from the gains, and the bias shows it."""
    device, campaign, true = _run(4, noisy=False)
    assert abs(device.feedthrough.matrix()).max() > 1e-4
    nominal = campaign.factory["nominal_scale_factor_v_per_rad_s"]["x"]
    errors = {}
    for name in ("measured", "missing"):
        kept = tuple(r for r in campaign if name == "measured" or r.command.excitation.kind != "drive")
        result = calibrate(Campaign(campaign.device_id, kept, campaign.factory), with_convergence=False)
        errors[name] = abs(result.bias["x"].value - _sensor_bias(device)) / DEG_H
        assert any("feedthrough E was not measured" in text for text in result.warnings) == (name == "missing")
    assert errors["measured"] < 0.3
    assert errors["missing"] > 10.0 * errors["measured"]
    assert abs(true.bias_rad_s * nominal) > 0


def _sensor_bias(device: Device) -> float:
    """Bias of the feedthrough-free sensor, x oscillator (theory Eq. 7) [rad/s]."""
    flow = device.slow_flow()
    point = ftr_operating_point(flow.A, flow.G, np.zeros((2, 2), dtype=complex), 1.0, "x")
    scale = device.resonator.angular_gain * (1.0 + device.pickoff.gain_mismatch) / abs(flow.G[1, 1])
    return point.rate_channel_v / scale


def test_the_documents_own_fit_agrees_within_its_sd(noisy: tuple[Device, Campaign, Truth], result: CalibrationResult) -> None:
    document = calibrate(noisy[1], method="document")
    assert document.method == "document"
    assert abs(document.rate.value - RATE) < 4 * document.rate.sd
    assert abs(document.bias["x"].value - result.bias["x"].value) < 4 * document.bias["x"].sd
    assert abs(document.scale_factor["x"].value / result.scale_factor["x"].value - 1) < 20e-6


def test_one_axis_alone_is_refused_with_the_remedy() -> None:
    _, campaign, _ = _run(1, fidelity="slow_flow")
    half = Campaign(campaign.device_id, tuple(r for r in campaign if r.command.mode != "ftr_y"), campaign.factory)
    with pytest.raises(CalibrationRefused, match="ftr_x, ftr_y"):
        calibrate(half)
    with pytest.raises(CalibrationRefused, match="axes swapped"):
        fit_slow_flow(list(half), 1.5)
    with pytest.raises(CalibrationRefused, match="angular_gain_kappa"):
        calibrate(replace(campaign, factory={}))


def test_static_records_alone_are_refused_as_not_excited() -> None:
    _, campaign, _ = _run(1, fidelity="slow_flow")
    static = tuple(r for r in campaign if r.label.startswith("static"))
    with pytest.raises(CalibrationRefused, match=r"side bands|full rank"):
        calibrate(Campaign(campaign.device_id, static, campaign.factory))


def test_separation_inverts_theory_eq_4_for_any_pick_off_frame() -> None:
    rng = np.random.default_rng(8)
    for _ in range(20):
        n, rho, r, eps, kappa, rate = rng.normal([0, 0, 1, 0, 0.8, 0], [2e-3, 0, 2e-2, 5e-3, 0.1, 1e-2])
        P = np.diag([1.0, np.exp(1j * eps)]) @ np.array([[1, n - rho], [n + rho, r]])
        sym = rng.normal(size=(2, 2)) + 1j * rng.normal(size=(2, 2))
        inner = sym + sym.T
        coriolis = -kappa * np.array([[0.0, -1.0], [1.0, 0.0]])
        A = P @ (inner + rate * coriolis) @ np.linalg.inv(P)
        bare = np.array([[1, n - rho], [n + rho, r]])
        M = bare @ bare.T
        frame = PickoffFrame(math.sqrt(M[1, 1] / M[0, 0]), M[0, 1] / M[0, 0], eps, (0, 0, 0))
        assert input_rate_times_kappa(A, frame) == pytest.approx(kappa * rate, abs=1e-12)
        np.testing.assert_allclose(angular_response(frame, kappa), P @ coriolis @ np.linalg.inv(P), atol=1e-12)


@pytest.mark.parametrize("away", [2.0, 300.0])
def test_projection_of_a_made_up_motion_satisfies_the_second_order_equation(away: float) -> None:
    """An envelope that obeys m x'' exactly: the projected equation must balance without any fit, drift and transients included.

    Also far from omega0, where what multiplies p' is omega/omega0 to all orders (half of it too much would be 1.6e-3 of p').
    """
    rate_hz, omega0, decay, g = 500.0, 2 * math.pi * 15000.0, 1.6, 8.0
    t = (np.arange(5000) + 0.5) / rate_hz
    omega = omega0 + away + 0.3 * np.sin(0.7 * t)
    p = (1 + 0.1 * np.sin(2 * math.pi * 0.7 * t + 0.3)) * np.exp(0.2j * t)
    dt = t[1] - t[0]
    fine = np.gradient(p, dt, edge_order=2)
    second = np.gradient(fine, dt, edge_order=2)
    slope = 0.3 * 0.7 * np.cos(0.7 * t)
    stiffness = 0.4
    left = second + 2j * omega * fine + 1j * slope * p - omega**2 * p + 2 * decay * (fine + 1j * omega * p)
    left += (omega0**2 + 2 * omega0 * stiffness) * p
    u = left / (2j * omega0) / (-1j * g)
    data = np.zeros((t.size, 12))
    data[:, 0], data[:, 2], data[:, 3], data[:, 6], data[:, 7] = t, p.real, p.imag, u.real, u.imag
    data[:, 10] = omega / (2 * math.pi)
    projected = project(Recording("d", data, Command(), rate_hz), [0.0, 0.7, 1.9], omega0, decay)
    predicted = (-decay + 1j * stiffness) * projected.pick[:, 0] - 1j * g * projected.drive[:, 0]
    scale = np.abs(projected.lhs[:, 0]).max()
    assert np.abs(projected.lhs[:, 0] - predicted).max() < 5e-6 * scale
    functions = test_functions(t, dt, [0.0, 0.7])
    np.testing.assert_allclose(dt * (functions.value**2).sum(axis=1), 1.0)
    np.testing.assert_allclose(np.gradient(functions.value, dt, axis=1)[:, 5:-5], functions.first[:, 5:-5], atol=2e-4)


@needs_bench
@pytest.mark.parametrize("name", ["ring_a", "ring_b"])
def test_another_plants_recordings(name: str) -> None:
    """Bias, scale factor and rate of a device that is not our simulator: within 3 sd, 20 deg/h, 300 ppm."""
    true = truth(name)
    result = calibrate(load_campaign(BENCH / f"{name}.h5"), with_convergence=False)
    rate, kappa, ratio = true["constant_rate_rad_s"], true["angular_gain_kappa"], abs(true["ratio"])
    assert abs(result.rate.value - rate) < min(3 * result.rate.sd, 20 * DEG_H)
    for axis, scale in (("x", kappa * ratio / abs(true["G"][1, 1])), ("y", -kappa / (ratio * abs(true["G"][0, 0])))):
        point = ftr_operating_point(true["A"], true["G"], np.zeros((2, 2), dtype=complex), 1.0, axis)
        bias = point.rate_channel_v / scale - rate
        assert abs(result.bias[axis].value - bias) < min(3 * result.bias[axis].sd, 20 * DEG_H)
        found = result.scale_factor[axis]
        assert abs(found.value - scale) < 3 * found.sd
        assert abs(found.value / scale - 1) < 300e-6
