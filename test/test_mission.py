"""The rate in the mission: the slow flow inverted, away from the operating point of the calibration, against carrier-level truth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gyro_calib.calibration import CalibrationRecord, Drifts, mission_rate, record_from_result
from gyro_calib.device import Device, draw_unit, load_device
from gyro_calib.errors import DataError
from gyro_calib.estimation import calibrate
from gyro_calib.experiments import SimulatedInstrument, run_plan, self_calibration_plan
from gyro_calib.recording.command import Command, Excitation, Setpoints
from gyro_calib.recording.rate import raw_rate
from gyro_calib.recording.recording import Recording
from gyro_calib.simulation import GyroSimulator
from gyro_calib.units import DEG_H

#: what the device file says: drive 100, pick-off 20 ppm/K
KNOWN = Drifts(gain_per_k=120e-6, gain_per_k_sd=5e-6)


class Calibrated:
    """A unit, its factory data and its record."""

    def __init__(self, seed: int, *, noisy: bool) -> None:
        self.device = draw_unit(load_device("ring_15k"), seed)
        simulator = GyroSimulator(self.device, rng=np.random.default_rng([seed, 1]), noisy=noisy)
        campaign = run_plan(SimulatedInstrument(simulator, 9.3 * DEG_H), self_calibration_plan(simulator.factory, quality="quick"))
        if not noisy:  # the factory's ratio as it truly is: only the method's own error remains
            ratio = 1.0 / (1.0 + self.device.drive.gain_mismatch)
            campaign = replace(campaign, factory={**campaign.factory, "drive_gain_ratio_x_over_y": ratio})
        self.factory: dict[str, Any] = dict(campaign.factory)
        self.record: CalibrationRecord = record_from_result(calibrate(campaign, with_convergence=False), campaign, run_id="t")
        self.noisy = noisy

    def recording(
        self, rate: float, *, rise_k: float = 0.0, amplitude_v: float = 1.0, mode: str = "ftr_x", duration_s: float = 10.0
    ) -> Recording:
        hot: Device = replace(self.device, environment=replace(self.device.environment, temperature_degc=25.0 + rise_k))
        instrument = SimulatedInstrument(GyroSimulator(hot, rng=np.random.default_rng(2), noisy=self.noisy), rate)
        instrument.configure(Command(mode, setpoints=Setpoints(amplitude_v)))
        return instrument.record(duration_s, settle_s=4.0)

    def simple(self, recording: Recording) -> float:
        """(rate_raw - b) / K."""
        raw = raw_rate(recording.data, recording.command, self.factory).mean()
        return float((raw - self.record.bias.value) / self.record.scale_factor.value)


@pytest.fixture(scope="module")
def quiet() -> Calibrated:
    return Calibrated(2, noisy=False)


@pytest.fixture(scope="module")
def noisy() -> Calibrated:
    return Calibrated(1, noisy=True)


@pytest.mark.parametrize("mode", ["ftr_x", "ftr_y"])
@pytest.mark.parametrize("rate", [0.0, 0.5])
def test_at_the_calibrations_operating_point_it_is_the_rate(quiet: Calibrated, mode: str, rate: float) -> None:
    found = mission_rate(quiet.recording(rate, mode=mode), quiet.record)
    assert abs(found.rate_rad_s.mean() - rate) < 0.3 * DEG_H + 3e-6 * rate
    # non-orthogonality n turns rotation into damping, 2 n kappa Omega tau of it; the record knows n to 3e-5
    assert found.damping_ratio.mean() == pytest.approx(1.0, abs=1e-5 + 9e-5 * rate)


@pytest.mark.parametrize("mode", ["ftr_x", "ftr_y"])
def test_it_follows_temperature_amplitude_and_frequency_where_the_simple_correction_does_not(quiet: Calibrated, mode: str) -> None:
    for rate in (0.0, 0.5):
        recording = quiet.recording(rate, rise_k=2.0, amplitude_v=0.8, mode=mode)
        found = mission_rate(recording, quiet.record, drifts=KNOWN)
        error = abs(found.rate_rad_s.mean() - rate)
        assert error < 0.3 * DEG_H + 3e-6 * rate
        # damping goes with absolute temperature in this device
        assert found.damping_ratio.mean() == pytest.approx(300.15 / 298.15, abs=1e-4)
        if mode == "ftr_x":
            assert abs(quiet.simple(recording) - rate) > 5 * DEG_H > 10 * error


def test_an_unknown_gain_coefficient_costs_scale_factor_not_bias_and_the_sd_admits_it(quiet: Calibrated) -> None:
    still = mission_rate(quiet.recording(0.0, rise_k=2.0, amplitude_v=0.8), quiet.record)
    assert abs(still.rate_rad_s.mean()) < 0.3 * DEG_H
    turned = mission_rate(quiet.recording(1.0, rise_k=2.0, amplitude_v=0.8), quiet.record)
    error = turned.rate_rad_s.mean() - 1.0
    assert error == pytest.approx(-240e-6, rel=0.05)  # 120 ppm/K over 2 K
    assert abs(error) < 2 * turned.systematic_sd_rad_s.mean()


def test_noisy_rates_lie_within_their_sd_everywhere(noisy: Calibrated) -> None:
    errors = []
    for rise_k, amplitude_v in ((0.0, 1.0), (2.0, 0.8), (-2.0, 1.2)):
        for mode in ("ftr_x", "ftr_y"):
            for rate in (0.0, 0.3):
                recording = noisy.recording(rate, rise_k=rise_k, amplitude_v=amplitude_v, mode=mode)
                found = mission_rate(recording, noisy.record, drifts=KNOWN)
                density = noisy.record.rate_noise_density.value / amplitude_v
                sd = np.hypot(found.systematic_sd_rad_s.mean(), density / np.sqrt(2.0 * recording.duration_s))
                errors.append((found.rate_rad_s.mean() - rate) / sd)
    assert np.abs(errors).max() < 4.0
    assert np.sqrt(np.mean(np.square(errors))) < 1.8


def test_the_variance_of_a_row_is_that_of_the_rows(noisy: Calibrated) -> None:
    found = mission_rate(noisy.recording(0.0), noisy.record)
    scatter = found.rate_rad_s.var()
    assert 0.6 * scatter < found.variance.mean() < 1.6 * scatter
    assert np.all(found.variance > found.systematic_sd_rad_s**2)


def test_uncertainty_grows_with_the_distance_from_the_calibration(noisy: Calibrated) -> None:
    sds = [mission_rate(noisy.recording(0.3, rise_k=k, duration_s=1.0), noisy.record).systematic_sd_rad_s.mean() for k in (0.0, 2.0, 8.0)]
    assert sds[0] < 0.5 * sds[1] < 0.25 * sds[2]


def test_a_changing_rate_and_a_modulated_amplitude_are_followed_row_by_row(quiet: Calibrated) -> None:
    simulator = GyroSimulator(quiet.device, rng=np.random.default_rng(0), noisy=False)
    simulator.configure(Command("ftr_x", Excitation("amplitude_modulation", 0.7, 0.1)))
    simulator.advance(3.0)
    t = np.arange(2000) * 2e-3
    true = 0.2 * np.sin(2 * np.pi * 2.0 * t)
    rows = simulator.advance(4.0, true)
    recording = Recording(quiet.device.device_id, rows, simulator.command, 500.0, extras={"dac_zero_order_hold_s": 1 / 240e3})
    found = mission_rate(recording, quiet.record)
    at_rows = np.interp(recording.t - 3.0, t + 1e-3, true)
    error = (found.rate_rad_s - at_rows)[300:-300]
    assert np.abs(error).max() < 2e-3 * 0.2
    assert abs(error.mean()) < 0.5 * DEG_H


def test_what_it_cannot_use_is_refused(quiet: Calibrated) -> None:
    recording = quiet.recording(0.0, duration_s=0.1)
    with pytest.raises(DataError, match="must belong to device"):
        mission_rate(replace(recording, device_id="other"), quiet.record)
    with pytest.raises(DataError, match="ftr_x or ftr_y"):
        mission_rate(replace(recording, command=Command("loops_off")), quiet.record)
    with pytest.raises(DataError, match="three rows"):
        mission_rate(replace(recording, data=recording.data[:2]), quiet.record)
    bare = replace(quiet.record, parameters={k: v for k, v in quiet.record.parameters.items() if k != "A_yx_re"})
    with pytest.raises(DataError, match=r"lacks A_yx_re\. Calibrate again"):
        mission_rate(recording, bare)
