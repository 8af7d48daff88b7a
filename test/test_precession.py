"""Document 004's own method on carrier-level recordings, against the exact joint fit, with a constant rate, and its claimed uncertainty."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from wave_samples import design_gain, low_q_hrg, simulate, whole_angle

from gyro_calib.device import Device
from gyro_calib.errors import CalibrationRefused
from gyro_calib.estimation.drive_chain import drive_chain_of
from gyro_calib.estimation.precession import (
    azimuth_fit,
    difference_and_sum,
    orientation_pair,
    rate_as_two_lambda,
    virtual_precession_gain,
    volts_for,
)
from gyro_calib.estimation.whole_angle_fit import fit_whole_angle
from gyro_calib.experiments import SimulatedInstrument
from gyro_calib.quantity import Quantity
from gyro_calib.recording.recording import Recording
from gyro_calib.units import DEG_H

KAPPA = 0.55
SPEED = math.radians(8.0)


def hrg() -> Device:
    errors = {"gain_mismatch": -0.03, "two_delta_rad": 3.6e-3, "two_lambda_rad": -0.02}
    return low_q_hrg(**errors, damping_anisotropy=0.01, frequency_split_hz=3e-3)


def precess(device: Device, speeds: list[float], **options: object) -> list[Recording]:
    """One recording per precession speed [rad/s], over two periods of 4 theta and a little more."""
    rate = float(options.pop("rate", 0.0))  # type: ignore[arg-type]
    simulator = simulate(device, **options)  # type: ignore[arg-type]
    instrument = SimulatedInstrument(simulator, rate)
    found = []
    for speed in speeds:
        instrument.configure(whole_angle(virtual_precession_v=speed / (0.5 * design_gain(device))))
        found.append(instrument.record(1.1 * math.pi / SPEED, settle_s=3.0, label=f"{speed:+.2f}"))
    return found


def pair(device: Device, **options: object) -> list[Recording]:
    return precess(device, [SPEED, -SPEED], **options)


@pytest.fixture(scope="module")
def carrier() -> list[Recording]:
    return pair(hrg(), fidelity="carrier")


def test_difference_and_sum_find_the_drive_chain_as_well_as_their_neglect_allows(carrier: list[Recording]) -> None:
    true = drive_chain_of(hrg().slow_flow().G)
    k = 0.5 * design_gain(hrg())
    plain, recorded = (difference_and_sum(*carrier, recorded=r) for r in (False, True))
    for found in (plain, recorded):
        assert found.chain.delta_g == pytest.approx(true.delta_g, rel=1e-3)
        assert found.chain.two_delta == pytest.approx(true.two_delta, rel=1e-3)
        assert found.chain.two_lambda == pytest.approx(true.two_lambda, rel=2e-3)
    # u_amp is no constant: its part that follows u_vir is in the constant of the difference
    assert plain.k_vir.value / k - 1 == pytest.approx(0.5 * (0.5 * 0.03) ** 2 + 1e-4, abs=5e-5)
    # what is left is the latency of the loops over tau
    assert abs(recorded.k_vir.value / k - 1) == pytest.approx(hrg().loop_latency_s * hrg().resonator.decay_rate(), abs=3e-5)


def test_the_joint_fit_with_exact_trigonometry_is_far_better_on_the_same_recordings(carrier: list[Recording]) -> None:
    true = drive_chain_of(hrg().slow_flow().G)
    G = fit_whole_angle(carrier, hrg().resonator.decay_rate(), terms=()).flow.values.G
    joint, document = drive_chain_of(G), difference_and_sum(*carrier).chain
    for name in ("delta_g", "two_delta", "two_lambda"):
        error, theirs = (abs(getattr(chain, name) - getattr(true, name)) for chain in (joint, document))
        assert error < 4e-7
        assert error < 0.3 * theirs
    assert abs(G[0, 0]) == pytest.approx(design_gain(hrg()), rel=2e-6)


def test_carrier_and_slow_flow_precess_alike(carrier: list[Recording]) -> None:
    for exact, averaged in zip(carrier, pair(hrg()), strict=True):
        difference = azimuth_fit(exact).coefficients - azimuth_fit(averaged).coefficients
        assert np.abs(difference).max() < 2e-6 * SPEED


def test_a_constant_rate_passes_for_two_lambda_unless_it_is_handled() -> None:
    rate, device = 200.0 * DEG_H, hrg()
    true = drive_chain_of(device.slow_flow().G).two_lambda
    east, west = (pair(device, rate=sign * rate) for sign in (1.0, -1.0))
    one, other = (difference_and_sum(*both, recorded=True) for both in (east, west))
    confounded = -KAPPA * rate / device.resonator.decay_rate()
    assert one.chain.two_lambda - true == pytest.approx(confounded, rel=0.03)
    drive = azimuth_fit(east[0]).amplitude_drive[0] + azimuth_fit(east[1]).amplitude_drive[0]
    assert rate_as_two_lambda(rate, KAPPA, one.k_vir.value, 0.5 * drive) == pytest.approx(confounded, rel=0.03)
    # a rate that is known
    known = difference_and_sum(*east, recorded=True, known_rate=Quantity(rate, 1.0 * DEG_H, "rad/s"), kappa=KAPPA)
    assert known.chain.two_lambda == pytest.approx(true, rel=2e-3)
    assert math.sqrt(known.covariance[2, 2]) == pytest.approx(abs(confounded) / 200.0, rel=0.05)
    # the sense axis turned about
    turned, part = orientation_pair(one, other)
    assert turned.value == pytest.approx(true, rel=2e-3)
    assert part.value == pytest.approx(confounded, rel=0.03)
    # no second orientation: u_amp under both senses tells them apart in the joint fit
    G = fit_whole_angle(east, device.resonator.decay_rate(), terms=()).flow.values.G
    assert drive_chain_of(G).two_lambda == pytest.approx(true, rel=2e-5)


def test_a_second_amplitude_does_not_tell_a_rate_from_two_lambda() -> None:
    """u_amp/a = 1/(g tau) whatever the amplitude: document 004's sum errs alike, which is why it is not offered as a way out."""
    rate, found = 200.0 * DEG_H, []
    for amplitude in (1.0, 0.6):
        instrument = SimulatedInstrument(simulate(hrg()), rate)
        both = []
        for sign in (1.0, -1.0):
            volts = sign * amplitude * SPEED / (0.5 * design_gain(hrg()))
            instrument.configure(whole_angle(virtual_precession_v=volts, amplitude_v=amplitude))
            both.append(instrument.record(1.1 * math.pi / SPEED, settle_s=3.0))
        found.append(difference_and_sum(*both, recorded=True).chain.two_lambda)
    assert found[0] == pytest.approx(found[1], rel=1e-3)
    assert abs(found[0] - math.atan(math.tan(-0.02))) > 5e-3


def test_three_amplitudes_give_k_vir_and_the_volts_for_a_tenth_of_a_degree_per_second() -> None:
    device = low_q_hrg(gain_mismatch=-0.01, two_delta_rad=2e-3)
    gain, drift = virtual_precession_gain(precess(device, [SPEED, 1.5 * SPEED, 2.0 * SPEED], fidelity="carrier"))
    assert gain.value == pytest.approx(0.5 * design_gain(device) * (1.0 - 0.005), rel=3e-4)
    assert abs(drift.value) < 1e-3 * SPEED
    volts = volts_for(math.radians(0.1), gain)
    instrument = SimulatedInstrument(simulate(device))
    instrument.configure(whole_angle(virtual_precession_v=volts))
    recording = instrument.record(930.0, settle_s=3.0)
    slow = azimuth_fit(recording)
    assert slow.periods == 1
    assert slow.coefficients[0] == pytest.approx(math.radians(0.1), rel=1e-3)


def test_claimed_covariance_is_the_scatter_over_seeds() -> None:
    device, found, claimed = hrg(), [], []
    for seed in range(14):
        result = difference_and_sum(*pair(device, noisy=True, seed=seed), recorded=True)
        found.append([result.chain.delta_g, result.chain.two_delta, result.chain.two_lambda, result.k_vir.value])
        claimed.append([*np.sqrt(np.diag(result.covariance)), result.k_vir.sd])
    ratio = np.std(found, axis=0, ddof=1) / np.sqrt(np.mean(np.square(claimed), axis=0))
    assert np.all(ratio < 1.6)
    assert np.all(ratio > 0.15)


def test_refusals(carrier: list[Recording]) -> None:
    forward, backward = carrier
    with pytest.raises(CalibrationRefused, match="must be of opposite volts, but got 2"):
        difference_and_sum(forward, forward)
    with pytest.raises(CalibrationRefused, match="must turn by a period of 4 theta"):
        azimuth_fit(replace(forward, data=forward.data[:200]))
    for some in ([forward, forward, backward], [forward]):
        with pytest.raises(CalibrationRefused, match="three amplitudes of the same sign"):
            virtual_precession_gain(some)
