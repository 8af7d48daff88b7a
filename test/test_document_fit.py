"""The estimator of document 000: derivatives, truth at the carrier level, convergence, agreement with the product's estimator, refusals."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from bench_data import BENCH, needs_bench, truth

from gyro_calib.device import Device, Nonlinearity, draw_unit, load_device
from gyro_calib.errors import CalibrationRefused
from gyro_calib.estimation.document_cost import Lines
from gyro_calib.estimation.document_fit import DocumentEstimate, document_fit, known_start, rough_start
from gyro_calib.estimation.document_model import FEEDFORWARD, FIRST_FIFTEEN, DocumentModel
from gyro_calib.estimation.levenberg import levenberg_marquardt
from gyro_calib.estimation.separation import Priors
from gyro_calib.estimation.sideband import SidebandProblem
from gyro_calib.estimation.sideband_table import SidebandRow, sideband_table
from gyro_calib.estimation.slow_flow_data import usable_recordings
from gyro_calib.experiments import SimulatedInstrument, run_plan, self_calibration_plan
from gyro_calib.recording import load_campaign
from gyro_calib.recording.recording import Campaign
from gyro_calib.simulation import GyroSimulator
from gyro_calib.units import DEG_H

RATE = 9.3 * DEG_H


def _campaign(device: Device, *, noisy: bool) -> Campaign:
    simulator = GyroSimulator(device, rng=np.random.default_rng(5), noisy=noisy)
    return run_plan(SimulatedInstrument(simulator, RATE), self_calibration_plan(simulator.factory, quality="quick"))


@pytest.fixture(scope="module")
def device() -> Device:
    return draw_unit(load_device("ring_15k"), 3)


@pytest.fixture(scope="module")
def quiet(device: Device) -> list[SidebandRow]:
    return sideband_table(list(_campaign(device, noisy=False)))


@pytest.fixture(scope="module")
def noisy(device: Device) -> Campaign:
    return _campaign(device, noisy=True)


@pytest.fixture(scope="module")
def table(noisy: Campaign) -> list[SidebandRow]:
    return sideband_table(list(noisy))


def _off(device: Device, signs: tuple[float, float, float, float]):
    """Start with damping and forcers of the design, each off by 30 %, all else zero."""

    def start(model: DocumentModel) -> np.ndarray:
        values = rough_start(model, device.factory())
        for name, sign in zip(("B_xx_re", "B_yy_re", "b_x", "b_y"), signs, strict=True):
            values[model.names.index(name)] *= 1.0 + 0.3 * sign
        assert np.count_nonzero(values) == 4
        return values

    return start


def _errors(estimate: DocumentEstimate, device: Device) -> dict[str, float]:
    """Largest errors: cross terms and damping [deg/h of rate], forcers and feed-forward [ppm]."""
    flow = device.slow_flow(RATE)
    found = estimate.slow_flow().values
    cross = np.array([found.A[0, 1] - flow.A[0, 1], found.A[1, 0] - flow.A[1, 0]]).view(float)
    return {
        "cross": float(np.max(np.abs(cross))) / 0.8 / DEG_H,
        "damping": float(np.max(np.abs(np.diag(found.A - flow.A).real))) / 0.8 / DEG_H,
        "forcers": 1e6 * float(np.max(np.abs(found.G - flow.G)) / abs(flow.G[0, 0])),
        "feedforward": 1e6 * float(np.max(np.abs(found.E - flow.E))),
    }


def test_there_are_15_parameters_and_23_with_feed_forward(quiet: list[SidebandRow]) -> None:
    assert len(FIRST_FIFTEEN) == 15
    assert len(FIRST_FIFTEEN + FEEDFORWARD) == 23
    assert DocumentModel(quiet, fit_feedforward=True).names[:23] == FIRST_FIFTEEN + FEEDFORWARD


@pytest.mark.parametrize("stiffening", [False, True])
def test_derivatives_are_those_of_the_positions(device: Device, table: list[SidebandRow], stiffening: bool) -> None:
    model = DocumentModel(table, fit_feedforward=True, stiffening=stiffening)
    flow = device.slow_flow(RATE)
    theta = known_start(model, flow.A, flow.G, flow.E)
    rng = np.random.default_rng(0)
    theta = theta * (1 + 1e-2 * rng.standard_normal(theta.size)) + 1e-3 * rng.standard_normal(theta.size)
    rows = Lines.of(model, with_carrier=True).rows
    _, slope = model.error(theta, rows)
    for i, name in enumerate(model.names):
        step = np.zeros_like(theta)
        step[i] = 1e-4 * max(abs(theta[i]), 10.0 if name[0] in "Bk" else 1e-2)
        numeric = (model.error(theta + step, rows)[0] - model.error(theta - step, rows)[0]) / (2 * step[i])
        assert np.max(np.abs(numeric - slope[:, :, i])) < 1e-5 * np.max(np.abs(slope[:, :, i])), name


@pytest.mark.parametrize("cost", ["positions", "transfer_functions"])
def test_noise_free_carrier_level_data_give_the_true_parameters(device: Device, quiet: list[SidebandRow], cost: str) -> None:
    estimate = document_fit(quiet, _off(device, (1, -1, -1, 1)), cost=cost, weights="equal")
    errors = _errors(estimate, device)
    assert estimate.converged
    assert errors["cross"] < 0.5
    assert errors["damping"] < 2.0
    assert errors["forcers"] < 3.0
    assert errors["feedforward"] < 0.5
    assert abs(estimate.parameter("oscillator_phase").value) < 1e-6
    # the unit's own values are far from what the start assumed
    assert abs(estimate.parameter("k_xy").value) > 1e3
    assert abs(estimate.parameter("B_yx_re").value) > 100.0


@pytest.mark.parametrize("signs", [(1, 1, 1, 1), (-1, -1, -1, -1), (1, -1, 1, -1), (-1, 1, 1, -1)])
@pytest.mark.parametrize("cost", ["positions", "transfer_functions"])
def test_a_rough_start_ends_where_the_truth_does(device: Device, table: list[SidebandRow], cost: str, signs: tuple[float, ...]) -> None:
    flow = device.slow_flow(RATE)
    known = document_fit(table, lambda model: known_start(model, flow.A, flow.G, flow.E), cost=cost)
    found = document_fit(table, _off(device, signs), cost=cost)
    assert found.converged
    assert np.max(np.abs(found.values - known.values) / np.sqrt(np.diag(known.covariance))) < 1e-3


def test_a_rough_start_needs_no_scale_factor_from_the_factory(device: Device, table: list[SidebandRow]) -> None:
    model = DocumentModel(table, fit_feedforward=True)
    start = rough_start(model, {"nominal_q": 30000.0})
    expected = rough_start(model, device.factory())
    assert start[np.nonzero(start)] == pytest.approx(expected[np.nonzero(expected)], rel=0.3)
    assert document_fit(table, start).converged


def test_both_costs_and_the_products_estimator_agree_within_noise(device: Device, noisy: Campaign, table: list[SidebandRow]) -> None:
    recordings = usable_recordings(noisy)[0]
    product = SidebandProblem(recordings, noisy.factory, 0.8, Priors())
    reference, own = product.solve()
    names = [reference.names.index(n) for n in ("rate", "bias_x", "scale_x", "A_yx_re", "A_xy_im", "G_yy_re", "G_xx_im", "E_yy_re")]
    start = _off(device, (1, -1, -1, 1))
    for options in ({}, {"cost": "transfer_functions"}, {"with_carrier": True}):
        fit = document_fit(table, start, **options)
        assert 0.3 < fit.chi2 / fit.dof < 2.5
        assert fit.condition_number < 1e4
        derived, covariance = SidebandProblem(recordings, noisy.factory, 0.8, Priors(), fit=fit.slow_flow()).solve()
        sd = np.sqrt(np.diag(own)[names] + np.diag(covariance)[names])
        assert np.max(np.abs(derived.values[names] - reference.values[names]) / sd) < 4.0
        rate = derived.names.index("rate")
        assert abs(derived.values[rate] - RATE) < 4.0 * math.sqrt(covariance[rate, rate])
        assert math.sqrt(covariance[rate, rate]) < (3.0 if options == {"with_carrier": True} else 20.0) * DEG_H


def test_claimed_covariance_holds_over_noise(device: Device) -> None:
    pulls = []
    plan = self_calibration_plan(device.factory(), quality="quick")
    true = device.slow_flow(RATE)
    for seed in range(4):
        simulator = GyroSimulator(device, rng=np.random.default_rng([seed, 9]), fidelity="carrier")
        campaign = run_plan(SimulatedInstrument(simulator, RATE), plan)
        fit = document_fit(list(campaign), _off(device, (1, 1, 1, 1)))
        expected = known_start(fit.model, true.A, true.G, true.E)
        pulls.append((fit.values - expected)[:14] / np.sqrt(np.diag(fit.covariance))[:14])
    assert 0.6 < np.sqrt(np.mean(np.square(pulls))) < 1.4


def test_wrong_feed_forward_hurts_and_the_measured_one_heals(device: Device, quiet: list[SidebandRow]) -> None:
    start = _off(device, (1, -1, -1, 1))
    without = document_fit(quiet, start, weights="equal", feedforward=np.zeros((2, 2), dtype=complex))
    measured = document_fit(quiet, start, weights="equal")
    assert not without.model.fit_feedforward
    assert _errors(without, device)["cross"] > 50.0
    assert _errors(measured, device)["cross"] < 0.5
    given = document_fit(quiet, start, weights="equal", feedforward=device.feedthrough.matrix())
    assert _errors(given, device)["cross"] < 0.5


def test_a_cubic_stiffness_is_found_as_stiffening() -> None:
    ring = draw_unit(load_device("ring_15k"), 3)
    shift = 1e-6  # of the resonance at 1 V = 1 um
    cubic = shift * ring.resonator.omega0_rad_s**2 / (0.375e-12 / ring.pickoff.gain_v_per_m**2 * 1e12)
    device = replace(ring, nonlinearity=Nonlinearity(cubic_isotropic=cubic))
    table = sideband_table(list(_campaign(device, noisy=True)))
    start = _off(device, (1, -1, -1, 1))
    linear, bent = document_fit(table, start), document_fit(table, start, stiffening=True)
    expected = shift * ring.resonator.omega0_rad_s
    assert linear.chi2 / linear.dof > 20.0
    assert bent.chi2 / bent.dof < 3.0
    for axis in "xy":
        assert bent.parameter(f"stiffening_{axis}").value == pytest.approx(expected, rel=0.1)
    assert _errors(bent, device)["forcers"] < 0.2 * _errors(linear, device)["forcers"]


@needs_bench
def test_another_plants_recordings_give_its_true_cross_terms_or_say_that_an_effect_is_missing() -> None:
    for name, fits in (("ring_a", True), ("ring_b", False)):
        campaign, true = load_campaign(BENCH / f"{name}.h5"), truth(name)
        recordings = usable_recordings(campaign)[0]
        estimate = document_fit(recordings, lambda model, factory=campaign.factory: rough_start(model, factory), with_carrier=True)
        found = estimate.slow_flow()
        # ring_b has a nonlinear damping, which the 15 parameters do not hold
        assert (estimate.chi2 / estimate.dof < 3.0) == fits
        half = found.covariance.shape[0] // 2
        for i, j, place in ((0, 1, 2), (1, 0, half)):
            error = found.values.A[i, j].real - true["A"][i, j].real
            assert abs(error) < (4.0 * math.sqrt(found.covariance[place, place]) if fits else 10 * 0.8 * DEG_H)
        assert np.max(np.abs(found.values.G - true["G"])) < 1e-4 * abs(true["G"][0, 0])


def test_refusals_name_what_is_missing(device: Device, table: list[SidebandRow]) -> None:
    start = _off(device, (1, 1, 1, 1))
    with pytest.raises(CalibrationRefused, match="must include y as the oscillator"):
        document_fit([r for r in table if r.axis != "y"], start)
    with pytest.raises(CalibrationRefused, match="got no such pair"):
        document_fit([r for r in table if r.axis != "y" or r.frequency_hz == 0.0], start, cost="transfer_functions")
    with pytest.raises(CalibrationRefused, match="positions, transfer_functions"):
        document_fit(table, start, cost="volts")
    with pytest.raises(CalibrationRefused, match="Carriers must be weighed by noise"):
        document_fit(table, start, with_carrier=True, weights="equal")
    with pytest.raises(CalibrationRefused, match="excite every parameter"):
        document_fit([r for r in table if r.axis and r.frequency_hz == 0.0], start)
    with pytest.raises(CalibrationRefused, match="positive nominal_q, but got None"):
        document_fit(table, lambda model: rough_start(model, {"angular_gain_kappa": 0.8}))
    with pytest.raises(KeyError, match="B_xx_re"):
        document_fit(table, start).parameter("B_zz")


def test_minimiser_finds_a_curved_valley_and_refuses_parameters_that_look_alike() -> None:
    def rosenbrock(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.array([10.0 * (q[1] - q[0] ** 2), 1.0 - q[0]]), np.array([[-20.0 * q[0], 10.0], [-1.0, 0.0]])

    def alike(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.array([q[0] + q[1] - 1.0, 2.0 * (q[0] + q[1]), 3.0]), np.array([[1.0, 1.0], [2.0, 2.0], [0.0, 0.0]])

    fit = levenberg_marquardt(rosenbrock, np.array([-1.2, 1.0]))
    assert fit.converged
    assert fit.parameters == pytest.approx([1.0, 1.0], abs=1e-8)
    assert fit.covariance == pytest.approx(np.linalg.inv(rosenbrock(fit.parameters)[1].T @ rosenbrock(fit.parameters)[1]))
    assert not levenberg_marquardt(rosenbrock, np.array([-1.2, 1.0]), limit=3).converged
    with pytest.raises(CalibrationRefused, match="tell the parameters apart, but the design has condition number"):
        levenberg_marquardt(alike, np.array([0.3, 0.4]))
