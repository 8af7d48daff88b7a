"""A campaign in which the temperature moves by 5 K: the resonance, the cross stiffness, the damping and the gains move with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyro_calib.calibration import record_from_result
from gyro_calib.device import Device, draw_unit, load_device
from gyro_calib.device.operating_point import ftr_operating_point
from gyro_calib.estimation.linear_fit import fit_axis
from gyro_calib.estimation.separation import Priors
from gyro_calib.estimation.sideband import SidebandProblem, calibrate_sideband
from gyro_calib.estimation.slow_flow_data import SLOPE_WINDOW_K, usable_recordings
from gyro_calib.estimation.thermal_terms import THERMAL_TERMS, ThermalTerms
from gyro_calib.experiments import Limits, SimulatedInstrument, run_plan, self_calibration_plan
from gyro_calib.recording.recording import Campaign
from gyro_calib.simulation import GyroSimulator
from gyro_calib.units import DEG_H

RATE = -11.0 * DEG_H
SPAN_K = 5.0


def _unit(seed: int, *, noisy: bool) -> tuple[Device, Campaign]:
    """A unit on a ramp, its factory ratio as it truly is, so that only the drift is in question."""
    ring = load_device("ring_15k")
    plan = self_calibration_plan(ring.factory(), quality="quick", limits=Limits(temperature_k=10.0, base_rate_rad_s=1.0))
    surroundings = replace(ring.environment, temperature_degc=22.5, ramp_k_per_s=SPAN_K / plan.duration_s)
    device = draw_unit(replace(ring, environment=surroundings), seed)
    ratio = 1.0 / (1.0 + device.drive.gain_mismatch)
    device = replace(device, factory_data=replace(device.factory_data, drive_gain_ratio_x_over_y=ratio))
    simulator = GyroSimulator(device, rng=np.random.default_rng([seed, 8]), fidelity="carrier", noisy=noisy)
    return device, run_plan(SimulatedInstrument(simulator, RATE), plan)


def _errors(device: Device, problem: SidebandProblem) -> dict[str, float]:
    """Of rate and bias [deg/h] and scale factor [ppm] against the sensor (theory.md Eq. 7) at the mean temperature of the campaign."""
    flow = device.slow_flow(0.0, problem.fit.temperature_degc)
    point = ftr_operating_point(flow.A, flow.G, np.zeros((2, 2), dtype=complex), 1.0, "x")
    scale = device.resonator.angular_gain * (1.0 + device.pickoff.gain_mismatch) / abs(flow.G[1, 1])
    here, covariance = problem.solve()
    found = dict(zip(here.names, here.values, strict=True))
    sd = dict(zip(here.names, np.sqrt(np.diag(covariance)), strict=True))
    return {
        "rate": (found["rate"] - RATE) / DEG_H,
        "bias": (found["bias_x"] - point.rate_channel_v / scale) / DEG_H,
        "scale": 1e6 * (found["scale_x"] / scale - 1.0),
        "rate/sd": (found["rate"] - RATE) / sd["rate"],
        "bias/sd": (found["bias_x"] - point.rate_channel_v / scale) / sd["bias_x"],
        "scale/sd": (found["scale_x"] - scale) / sd["scale_x"],
    }


def _problem(campaign: Campaign, like: SidebandProblem | None = None) -> SidebandProblem:
    """The estimate; ``like`` another one in its weights (without noise there is none to measure)."""
    noise = None if like is None else like.fit.noise
    return SidebandProblem(usable_recordings(campaign, SLOPE_WINDOW_K)[0], campaign.factory, 0.8, Priors(), noise=noise)


@pytest.fixture(scope="module")
def noise_free() -> tuple[Device, Campaign]:
    return _unit(3, noisy=False)


@pytest.fixture(scope="module")
def noisy() -> tuple[Device, Campaign]:
    return _unit(3, noisy=True)


def test_a_drift_of_everything_leaves_no_systematic_error(
    noise_free: tuple[Device, Campaign], noisy: tuple[Device, Campaign], monkeypatch: pytest.MonkeyPatch
) -> None:
    device, campaign = noise_free
    like = _problem(noisy[1])
    errors = _errors(device, _problem(campaign, like))
    assert abs(errors["rate"]) < 0.3
    assert abs(errors["bias"]) < 0.3
    assert abs(errors["scale"]) < 5.0
    # and it is the slopes that do it
    monkeypatch.setattr(ThermalTerms, "columns", lambda self, p, axis: np.zeros((p.lhs.shape[0], THERMAL_TERMS), dtype=complex))
    without = _errors(device, _problem(campaign, like))
    assert abs(without["rate"]) > 2.0
    assert abs(without["bias"]) > 2.0
    assert abs(without["scale"]) > 100.0


def test_a_drift_with_noise_is_within_an_sd_that_it_widens_moderately(noisy: tuple[Device, Campaign]) -> None:
    device, campaign = noisy
    errors = _errors(device, _problem(campaign))
    assert max(abs(errors[f"{name}/sd"]) for name in ("rate", "bias", "scale")) < 4.0
    result = calibrate_sideband(campaign, with_convergence=False)
    # two minutes held still: 0.6 deg/h
    assert 0.6 * DEG_H < result.bias["x"].sd < 2.0 * DEG_H
    record = record_from_result(result, campaign, run_id="test")
    assert record.temperature_degc.value == pytest.approx(25.0, abs=1.0)


def test_all_of_a_drift_is_used_but_not_a_step_of_ten_kelvin(noise_free: tuple[Device, Campaign]) -> None:
    _, campaign = noise_free
    assert not any("left out" in text for text in calibrate_sideband(campaign, with_convergence=False).warnings)
    last = campaign.recordings[-1]
    hot = last.data.copy()
    hot[:, 11] += 10.0
    stepped = replace(campaign, recordings=(*campaign.recordings[:-1], replace(last, data=hot)))
    assert [text.split(":")[0] for text in usable_recordings(stepped, SLOPE_WINDOW_K)[1]] == [last.label]


def test_the_median_is_over_time_not_over_records(noise_free: tuple[Device, Campaign]) -> None:
    """Many short records at the cold beginning must not throw out the long ones at the warm end."""
    _, campaign = noise_free
    assert np.median([r.temperature_degc.mean() for r in campaign]) < 24.5
    assert usable_recordings(campaign, SLOPE_WINDOW_K)[1] == []


def test_priors_are_equations_of_the_slopes_alone() -> None:
    A = np.array([[-1.6 + 0.1j, 0.01 + 0.3j], [0.012 + 0.31j, -1.5 - 0.1j]])
    G = np.array([[-8.0j, 0.02j], [0.01j, -8.4j]])
    terms = ThermalTerms.of(A, G, -54e-6)
    prior = terms.prior(1, 7)
    assert not prior.regressors[:, :-THERMAL_TERMS].any()
    # K_yx may move by twice the modulus: 108e-6 of it per kelvin
    assert terms.sd_im[1, 0] == pytest.approx(108e-6 * 0.305)
    assert terms.sd_re[1, 2] == pytest.approx(3e-4 * 8.4)
    # data that say nothing of the slopes leave the prior
    rng = np.random.default_rng(1)
    known = rng.normal(size=(30, 4)) + 1j * rng.normal(size=(30, 4))
    data = replace(
        prior,
        lhs=known @ np.array([1.0, 2.0j, 3.0, 4.0]),
        regressors=np.hstack([known, np.zeros((30, THERMAL_TERMS))]),
        gram=np.eye(30),
        sd_re=np.full(30, 1e-3),
        sd_im=np.full(30, 1e-3),
    )
    fit = fit_axis([data, prior])
    np.testing.assert_allclose(fit.coefficients, [1.0, 2.0j, 3.0, 4.0, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(np.sqrt(np.diag(fit.covariance))[8::2], terms.sd_re[1])
    np.testing.assert_allclose(np.sqrt(np.diag(fit.covariance))[9::2], terms.sd_im[1])
