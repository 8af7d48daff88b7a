"""The whole-angle regression: on integrated slow flow, on carrier-level simulation, on another plant's recordings; and its refusals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from bench_data import BENCH, needs_bench, truth
from wave_integrator import WaveWorld, slow_flow

from gyro_calib.calibration import record_from_result
from gyro_calib.device import draw_unit, load_device
from gyro_calib.device.operating_point import ftr_operating_point
from gyro_calib.errors import CalibrationRefused
from gyro_calib.estimation import CalibrationResult, calibrate
from gyro_calib.estimation.drive_chain import drive_chain_of
from gyro_calib.estimation.latency import loop_latency
from gyro_calib.estimation.projection import test_functions as windows
from gyro_calib.estimation.wave_projection import Products
from gyro_calib.estimation.wave_slow import slow_forces
from gyro_calib.estimation.whole_angle_fit import fit_whole_angle, usable_wave_recordings
from gyro_calib.experiments import Limits, SimulatedInstrument, plan_by_name, run_plan, self_calibration_plan
from gyro_calib.recording import load_campaign
from gyro_calib.recording.recording import Campaign, Recording
from gyro_calib.simulation import GyroSimulator
from gyro_calib.simulation.flicker import FlickerSource
from gyro_calib.simulation.truth import Truth
from gyro_calib.units import DEG_H

RATE = 9.3 * DEG_H


def _runs(world: WaveWorld) -> list[Recording]:
    world.run(1.0)
    return [
        world.run(16.0, precession=4.0, label="vir_p"),
        world.run(16.0, precession=-4.0, label="vir_n"),
        world.run(8.0, precession=2.0, label="vir_half"),
        world.run(4.0, label="free"),
        world.run(4.0, gain=-2.0, label="ring_down"),
        world.run(4.0, gain=2.0, label="ring_up"),
    ]


@cache
def plain_runs(kappa_rate: float = 0.0) -> list[Recording]:
    """Of a gyro without any effect."""
    return _runs(WaveWorld(*slow_flow(kappa_rate=kappa_rate)))


def test_integrated_slow_flow_gives_its_matrices_back_without_averaging_error() -> None:
    A, G = slow_flow(kappa_rate=4e-4)
    fit = fit_whole_angle(plain_runs(4e-4), 0.084, terms=()).flow.values
    # the estimator's equation is of second order, the integrated one of first: (1/T1)^2 / 2 omega0
    np.testing.assert_allclose(fit.G, G, atol=6e-7)
    # the common frequency of both axes is the reference's business
    middle = 0.5 * np.trace(fit.A - A).imag
    np.testing.assert_allclose(fit.A - 1j * middle * np.eye(2), A, atol=2e-7)


def test_a_constant_rate_goes_into_a_and_leaves_the_forcer_rotation_alone() -> None:
    found = []
    for kappa_rate in (0.0, 4e-4):
        found.append(fit_whole_angle(plain_runs(kappa_rate), 0.084, terms=()).flow.values)
    np.testing.assert_allclose(found[1].G, found[0].G, atol=2e-7)
    turned = (found[1].A - found[0].A).real
    np.testing.assert_allclose(turned, -4e-4 * np.array([[0, -1], [1, 0]]), atol=2e-7)


def _warmed(rises_k: Sequence[float], *, recorded: bool) -> list[Recording]:
    """One world per recording, its resonance and gain where the temperature puts them; the thermometer says so, or nothing."""
    A, G = slow_flow()
    world, runs = WaveWorld(A, G), []
    plan = ({"precession": 4.0}, {"precession": -4.0}, {"precession": 2.0}, {}, {"gain": -2.0}, {"gain": 2.0}, {"precession": -2.0})
    for options, rise in zip(plan, rises_k, strict=True):
        world.A, world.G = A + 2.7j * rise * np.eye(2), G * (1.0 + 2e-4 * rise)
        world.run(0.5)
        r = world.run(12.0 if "precession" in options else 4.0, label=f"run_{len(runs)}", **options)
        data = r.data.copy()
        data[:, 11] = 25.0 + (rise if recorded else 0.0)
        runs.append(replace(r, data=data))
    return runs


def test_a_gain_that_follows_a_recorded_temperature_is_taken_out() -> None:
    rises = 0.2 * np.array([1.0, -1.0, 0.5, 0.0, -0.6, 0.8, -0.7])
    rises -= rises.mean()
    with_it, without = (fit_whole_angle(_warmed(rises, recorded=known), 0.084, terms=()).flow.values.G for known in (True, False))
    true = slow_flow()[1]
    # 2e-4 of the gain per kelvin, 0.2 K: 4e-5 of it
    assert np.abs(with_it - true).max() < 0.4 * np.abs(without - true).max()
    np.testing.assert_allclose(with_it, true, atol=2e-6 * np.abs(true).max())


def test_the_step_of_multiplexed_drives_is_found_as_a_lag_of_one_control_period() -> None:
    base = load_device("hrg_hardware")
    device = replace(base, multiplexing=replace(base.multiplexing, enabled=True))
    instrument = SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(1), fidelity="slow_flow", noisy=False), 0.0)
    plan = plan_by_name("virtual_precession", instrument.factory, quality="standard", limits=Limits(base_rate_rad_s=1.0))
    estimate = fit_whole_angle(usable_wave_recordings(run_plan(instrument, plan))[0], device.resonator.decay_rate(), terms=())
    assert estimate.drive_lag_s == pytest.approx(1.0 / device.electronics.control_rate_hz, rel=0.05)
    found, true = (drive_chain_of(G) for G in (estimate.flow.values.G, device.slow_flow().G))
    for name in ("delta_g", "two_delta", "two_lambda"):
        assert getattr(found, name) == pytest.approx(getattr(true, name), abs=1.5e-6)


def test_flicker_of_a_campaign_has_the_covariance_that_the_fit_takes_it_to_have() -> None:
    world = WaveWorld(*slow_flow(), rate_hz=20.0)
    recordings = [world.run(10.0), world.run(20.0)]
    projected = [Products(r, world.omega0, 0.084).project([0.0, 0.1]) for r in recordings]
    first, second = slow_forces(recordings, projected)
    source = FlickerSource(np.random.default_rng(2), 1.0, 2000, 0.05)
    noise = source.rows(sum(len(r) for r in recordings))
    # what is slower than the campaign is an unknown of the fit: here the mean of all
    noise = np.split(noise - noise.mean(axis=0), [len(recordings[0])])
    seen = [windows(r.t, 0.05, [0.0, 0.1]).value[:2] @ n * 0.05 for r, n in zip(recordings, noise, strict=True)]
    span = [windows(r.t, 0.05, [0.0, 0.1]).value[:2].sum(axis=1) * 0.05 for r in recordings]
    apart = seen[0][0] / span[0][0] - seen[1][0] / span[1][0]
    # one-sided density s^2/(f ln 4), the factor's is two-sided and of unit coefficient
    factor = (first[0] / span[0][0] - second[0] / span[1][0]) / math.sqrt(2.0 * math.log(4.0))
    assert float(np.sum(factor**2)) == pytest.approx(float(np.var(apart)), rel=0.2)


def test_a_cubic_pick_off_is_found_named_and_taken_out() -> None:
    A, G = slow_flow()
    bend = np.array([2e-4, 3e-4])
    world = WaveWorld(A, G, distort=lambda p: p + bend * np.abs(p) ** 2 * p)
    recordings = _noisy(_runs(world))
    estimate = fit_whole_angle(recordings, 0.084)
    assert set(estimate.term_gains) == {"pickoff_cubic"}
    assert estimate.terms["pickoff_cubic_x"].real == pytest.approx(2e-4, rel=0.02)
    assert estimate.terms["pickoff_cubic_y"].real == pytest.approx(3e-4, rel=0.02)
    np.testing.assert_allclose(estimate.flow.values.G, G, atol=2e-6)
    straight = fit_whole_angle(recordings, 0.084, terms=()).flow.values
    assert np.abs(straight.G - G).max() > 1e-5


def test_nothing_cubic_is_found_where_there_is_nothing() -> None:
    estimate = fit_whole_angle(_noisy(plain_runs()), 0.084)
    assert estimate.terms == {}


def _noisy(recordings: list[Recording]) -> list[Recording]:
    rng = np.random.default_rng(4)
    noisy = []
    for r in recordings:
        data = r.data.copy()
        data[:, 2:6] += 2e-6 * rng.normal(size=(len(r), 4))
        noisy.append(replace(r, data=data))
    return noisy


@pytest.fixture(scope="module")
def simulated() -> tuple[Campaign, Truth]:
    device = draw_unit(load_device("hrg_hardware"), 5)
    simulator = GyroSimulator(device, rng=np.random.default_rng([5, 3]), fidelity="carrier")
    campaign = run_plan(SimulatedInstrument(simulator, RATE), self_calibration_plan(simulator.factory, quality="quick"))
    return campaign, simulator.truth()


@pytest.fixture(scope="module")
def result(simulated: tuple[Campaign, Truth]) -> CalibrationResult:
    return calibrate(simulated[0])


def test_rate_and_bias_of_a_simulated_hemisphere_lie_within_their_sd(simulated: tuple[Campaign, Truth], result: CalibrationResult) -> None:
    campaign, true = simulated
    assert result.method == "virtual_precession"
    assert abs(result.rate.value - RATE) < 4 * result.rate.sd
    assert result.rate.sd < 1.0 * DEG_H
    record = record_from_result(result, campaign, run_id="test", mode="whole_angle")
    assert abs(record.bias.value - true.bias_rad_s) < 4 * record.bias.sd
    assert record.bias.sd < 1.0 * DEG_H < 0.2 * abs(true.bias_rad_s)
    assert abs(record.scale_factor.value - true.scale_factor) < 4 * record.scale_factor.sd
    with pytest.raises(CalibrationRefused, match="whole_angle"):
        record_from_result(result, campaign, run_id="test", mode="ftr_x")


def test_drive_chain_and_both_ways_to_the_scale_factor_agree(simulated: tuple[Campaign, Truth], result: CalibrationResult) -> None:
    device = draw_unit(load_device("hrg_hardware"), 5)
    for name, true in (
        ("delta_g", device.drive.gain_mismatch),
        ("two_delta", device.drive.two_delta_rad),
        ("two_lambda", device.drive.two_lambda_rad),
    ):
        assert abs(result.parameters[name].value - true) < 4 * result.parameters[name].sd
        assert result.parameters[f"{name}_seen"].sd < 1e-5
    for axis in "xy":
        by_ratio, by_fit = result.parameters[f"scale_factor_{axis}_gain_ratio"], result.scale_factor[axis]
        assert abs(by_ratio.value - by_fit.value) < 4 * math.hypot(by_ratio.sd, by_fit.sd)
        assert abs(by_ratio.value / by_fit.value - 1) < 100e-6
    latency = loop_latency(simulated[0])
    assert latency is not None
    assert latency.value == pytest.approx(device.loop_latency_s, rel=0.02)


def test_convergence_ends_at_the_estimate_and_the_document_has_what_was_asked(result: CalibrationResult) -> None:
    assert len(result.convergence) >= 2
    last, first = result.convergence[-1], result.convergence[0]
    assert last.bias["x"].value == pytest.approx(result.bias["x"].value, abs=result.bias["x"].sd)
    assert last.bias["x"].sd <= first.bias["x"].sd
    document = result.to_json()
    assert document["rate_channel"]["whole_angle"]["bias"]["unit"] == "rad/s"
    assert {"delta_g", "two_delta", "two_lambda", "k_vir", "pickoff_ratio", "A_yx_re", "G_yy_abs"} <= set(document["parameters"])
    assert any(text.startswith("two_lambda") for text in result.not_observable)


def test_without_open_drive_the_feedthrough_is_said_to_be_missing(simulated: tuple[Campaign, Truth]) -> None:
    campaign = simulated[0]
    loops = tuple(r for r in campaign if r.command.mode != "loops_off")
    found = calibrate(Campaign(campaign.device_id, loops, campaign.factory), with_convergence=False)
    assert any("feedthrough" in text for text in found.warnings)
    # and no body excitation: rate and bias are known apart no better than the phase of the pick-offs
    assert found.rate.sd > 3.0 * calibrate(campaign, with_convergence=False).rate.sd
    assert any(text.startswith("pickoff_phase") for text in found.not_observable)


def test_refusals_say_what_to_record(simulated: tuple[Campaign, Truth]) -> None:
    campaign = simulated[0]
    with pytest.raises(CalibrationRefused, match="angular_gain_kappa"):
        calibrate(replace(campaign, factory={}))
    rings = [r for r in campaign if r.command.mode.startswith("ring")]
    with pytest.raises(CalibrationRefused, match="virtual precession of both senses"):
        fit_whole_angle(rings, 0.1)
    free = tuple(r for r in campaign if r.label.startswith("free"))
    with pytest.raises(CalibrationRefused, match="excite the drives"):
        calibrate(Campaign(campaign.device_id, free, campaign.factory))


def test_plans_fit_the_gyro() -> None:
    factory = load_device("hrg_hardware").factory()
    plan = plan_by_name("virtual_precession", factory, quality="fine")
    assert plan.final.mode == "whole_angle"
    volts = {s.label: s.command.setpoints.virtual_precession_v for s in plan.steps}
    assert volts["vir_p_0"] == pytest.approx(-volts["vir_n_0"])
    assert len({round(v, 9) for v in volts.values() if v > 0}) == 3
    # the document's 0.1 deg/s: a quarter turn takes 900 s
    pair = next(s for s in plan.steps if s.label == "vir_p_0")
    assert 900.0 < pair.duration_s < 1000.0
    modes = [s.command.mode for s in plan_by_name("scale_factor", factory).steps]
    assert {"ring_down", "ring_up", "stiffness", "whole_angle"} <= set(modes)
    whole = self_calibration_plan(factory, quality="quick")
    assert {"loops_off", "ring_down", "whole_angle"} <= {s.command.mode for s in whole.steps}
    assert whole.duration_s < 300.0
    ring = load_device("ring_15k").factory()
    assert all(s.command.mode in ("ftr_x", "ftr_y", "loops_off") for s in self_calibration_plan(ring).steps)


@needs_bench
@pytest.mark.parametrize(("name", "terms"), [pytest.param("hrg_a", set(), marks=pytest.mark.slow), ("hrg_b", {"pickoff_cubic"})])
def test_another_plants_recordings(name: str, terms: set[str]) -> None:
    """Drive chain, scale factor, rate and bias of a gyro that is not our simulator, with the effect that its truth names."""
    true = truth(name)
    campaign = load_campaign(BENCH / f"{name}.h5")
    result = calibrate(campaign, with_convergence=False)
    rate, kappa, ratio = true["constant_rate_rad_s"], true["angular_gain_kappa"], abs(true["ratio"])
    for parameter, value in zip(("delta_g", "two_delta", "two_lambda"), true["drive_delta_g_two_delta_two_lambda"], strict=True):
        assert abs(result.parameters[parameter].value - value) < 3 * result.parameters[parameter].sd
    assert result.parameters["delta_g"].sd < 3e-5
    assert result.parameters["two_delta"].sd < 1e-3
    assert abs(result.rate.value - rate) < min(3 * result.rate.sd, 0.2 * DEG_H)
    for axis, scale in (("x", kappa * ratio / abs(true["G"][1, 1])), ("y", -kappa / (ratio * abs(true["G"][0, 0])))):
        found = result.scale_factor[axis]
        assert abs(found.value - scale) < min(3 * found.sd, 40e-6 * abs(scale))
        point = ftr_operating_point(true["A"], true["G"], np.zeros((2, 2), dtype=complex), 1.0, axis)
        assert abs(result.bias[axis].value - (point.rate_channel_v / scale - rate)) < min(4 * result.bias[axis].sd, 0.3 * DEG_H)
    estimate = fit_whole_angle(usable_wave_recordings(campaign)[0], 0.08)
    assert set(estimate.term_gains) == terms
    np.testing.assert_allclose(estimate.flow.values.G, true["G"], atol=2e-6)
    np.testing.assert_allclose(estimate.flow.values.E, true["E"], atol=5e-7)
    off = ~np.eye(2, dtype=bool)
    np.testing.assert_allclose(estimate.flow.values.A[off], true["A"][off], atol=1e-6)
