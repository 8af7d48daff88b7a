"""Angle-dependent drift: its axes identified, predicted, compensated; rate against azimuth before and after, at carrier level."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from wave_samples import design_gain, low_q_hrg, simulate, whole_angle

from gyro_calib.device import Device
from gyro_calib.errors import CalibrationRefused
from gyro_calib.estimation.angle_drift import damping_pattern, measured_drift
from gyro_calib.estimation.drive_chain import compensation_matrix, drive_chain_of, iterated_compensation
from gyro_calib.estimation.held import held_quadrature
from gyro_calib.estimation.separation import Priors
from gyro_calib.estimation.whole_angle_fit import fit_whole_angle
from gyro_calib.estimation.whole_angle_values import WholeAngleValues
from gyro_calib.experiments import SimulatedInstrument
from gyro_calib.quantity import Quantity
from gyro_calib.recording.recording import Recording
from gyro_calib.units import DEG_H

SPEED = math.radians(8.0)
AXES = {"damping_anisotropy": 0.01, "damping_azimuth_rad": 0.4, "frequency_split_hz": 3e-3, "split_azimuth_rad": 0.9}
NONE = np.eye(2)


def hrg() -> Device:
    return low_q_hrg(gain_mismatch=-0.03, two_delta_rad=3.6e-3, two_lambda_rad=-0.02, **AXES)


def precess(device: Device, compensation: np.ndarray = NONE, *, rate: float = 0.0, **options: object) -> list[Recording]:
    """Both senses and a faster one under a compensation."""
    instrument, found = SimulatedInstrument(simulate(device, **options), rate), []  # type: ignore[arg-type]
    four = tuple(float(c) for c in np.ravel(compensation))
    for share in (1.0, -1.0, 1.5):
        command = whole_angle(virtual_precession_v=share * SPEED / (0.5 * design_gain(device)))
        instrument.configure(replace(command, compensation=four))
        found.append(instrument.record(1.1 * math.pi / SPEED, settle_s=3.0))
    return found


def identified(recordings: list[Recording], device: Device, factory: Mapping[str, object]) -> WholeAngleValues:
    estimate = fit_whole_angle(recordings, device.resonator.decay_rate(), terms=())
    return WholeAngleValues(estimate, factory, Priors(), 1.0, Quantity(device.loop_latency_s, 1e-6, "s"), NONE)


@pytest.fixture(scope="module")
def before() -> list[Recording]:
    return precess(hrg(), fidelity="carrier")


@pytest.fixture(scope="module")
def values(before: list[Recording]) -> WholeAngleValues:
    return identified(before, hrg(), hrg().factory())


def test_axes_of_damping_and_frequency_are_identified(values: WholeAngleValues) -> None:
    derived, covariance = values.propagate(values.estimate.covariance)
    found = dict(zip(derived.names, derived.values, strict=True))
    sd = dict(zip(derived.names, np.sqrt(np.diag(covariance)), strict=True))
    decay = hrg().resonator.decay_rate()
    assert found["decay_rate"] == pytest.approx(decay, rel=5e-6)
    assert found["damping_anisotropy"] == pytest.approx(0.01 * decay, rel=2e-3)
    assert found["frequency_split"] == pytest.approx(2.0 * math.pi * 3e-3, rel=1e-5)
    # an axis is one of four: theta and theta + 90 deg are the same
    for name, true in (("damping_azimuth", 0.4), ("frequency_azimuth", 0.9)):
        assert math.remainder(found[name] - true, math.pi / 2) == pytest.approx(0.0, abs=1e-3)
        assert 0.0 < sd[name] < 1e-3


def test_predicted_drift_is_the_measured_one(before: list[Recording], values: WholeAngleValues) -> None:
    measured, predicted = measured_drift(before[0], before[1], 0.55), values.drift(NONE)
    np.testing.assert_allclose(predicted.harmonics, measured.harmonics, atol=2e-3 * np.abs(measured.harmonics).max())
    assert measured.amplitude_rad_s > 300.0 * DEG_H
    theta = np.linspace(0.0, math.pi / 2, 50)
    middle = measured.harmonics[0]
    assert np.ptp(measured.at(theta)) == pytest.approx(2.0 * measured.amplitude_rad_s, rel=0.01)
    assert measured.at(theta).mean() == pytest.approx(middle, rel=0.1)
    assert np.all(np.diag(predicted.covariance) > 0.0)


def test_a_quadrature_that_the_loops_hold_turns_the_wave_by_the_split() -> None:
    """theta' = dw (q/a)/2 cos 4 (theta - theta_w): of millihertz and thousandths several degrees an hour that no compensation takes off."""
    device = replace(hrg(), effects={"loop_error": {"q": 2e-3}})
    recordings = precess(device)
    q = held_quadrature(recordings)
    assert q == pytest.approx(2e-3, abs=1e-5)
    measured, ideal = measured_drift(recordings[0], recordings[1], 0.55), identified(recordings, device, device.factory())
    predicted = WholeAngleValues(
        ideal.estimate, device.factory(), Priors(), 1.0, Quantity(device.loop_latency_s, 1e-6, "s"), NONE, quadrature=q
    )
    near, far = (float(np.linalg.norm(v.drift(NONE).harmonics - measured.harmonics)) for v in (predicted, ideal))
    # a rate is 2/kappa of it, one way or the other
    assert far == pytest.approx(2.0 / 0.55 * 0.5 * 2.0 * math.pi * 3e-3 * q, rel=0.03)
    assert near < 0.05 * far


def test_compensating_the_drives_leaves_the_damping_and_compensating_both_leaves_nothing(
    before: list[Recording], values: WholeAngleValues
) -> None:
    A, G, _ = values.at_rest()
    drives, both = (compensation_matrix(drive_chain_of(G)) @ aim for aim in (NONE, damping_pattern(A).matrix))
    first = measured_drift(before[0], before[1], 0.55)
    left, nothing = (measured_drift(*precess(hrg(), c, fidelity="carrier")[:2], 0.55) for c in (drives, both))
    # D(1/tau)/4 sin 4 (theta - theta_tau) of theta', as a rate 2/kappa of it
    damping = 0.5 / 0.55 * 0.01 * hrg().resonator.decay_rate()
    assert left.amplitude_rad_s == pytest.approx(damping, rel=5e-3)
    assert abs(left.harmonics[0]) < 1e-3 * abs(first.harmonics[0])
    assert nothing.amplitude_rad_s < 1e-3 * first.amplitude_rad_s
    assert nothing.amplitude_rad_s < 0.5 * DEG_H
    assert values.drift(both).amplitude_rad_s < 0.1 * DEG_H
    assert not np.allclose(both, drives, atol=1e-3)


def test_a_compensation_in_force_is_refined_not_replaced() -> None:
    """Half of the right compensation in force, the rest identified under it: the next one is the right one."""
    device = hrg()
    true = drive_chain_of(device.slow_flow().G)
    half = NONE + 0.5 * (compensation_matrix(true) - NONE)
    recordings = precess(device, half)
    G = fit_whole_angle(recordings, device.resonator.decay_rate(), terms=()).flow.values.G
    # the recorded drives act after the compensation, so that G is the device's own
    residual = drive_chain_of(G @ half)
    refined = iterated_compensation(half, residual)
    np.testing.assert_allclose(refined / refined[0, 0], compensation_matrix(true) / compensation_matrix(true)[0, 0], atol=2e-6)
    seen = drive_chain_of(device.slow_flow().G @ refined)
    assert max(abs(seen.delta_g), abs(seen.two_delta), abs(seen.two_lambda)) < 2e-6


def test_a_constant_rate_is_in_the_mean_only() -> None:
    still, turned = (measured_drift(*precess(hrg(), rate=rate)[:2], 0.55) for rate in (0.0, 50.0 * DEG_H))
    assert turned.harmonics[0] - still.harmonics[0] == pytest.approx(50.0 * DEG_H, rel=2e-3)
    np.testing.assert_allclose(turned.harmonics[1:], still.harmonics[1:], atol=0.5 * DEG_H)


def test_refusals(before: list[Recording]) -> None:
    with pytest.raises(CalibrationRefused, match="opposite volts"):
        measured_drift(before[0], before[2], 0.55)
