"""Loop latency read from how a turning wave is driven, against the device's own, in all electronics; what it does to the scale factor."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from bench_data import BENCH, needs_bench
from wave_samples import design_gain, low_q_hrg, simulate, whole_angle

from gyro_calib.device import Device, Multiplexing
from gyro_calib.estimation.latency import loop_latency
from gyro_calib.experiments import SimulatedInstrument
from gyro_calib.quantity import Quantity
from gyro_calib.recording import load_campaign

ERRORS = {"gain_mismatch": -0.03, "two_delta_rad": 3.6e-3, "two_lambda_rad": -0.02, "frequency_split_hz": 3e-3}


def latency_of(device: Device, fidelity: str, speed_deg_s: float, **options: object) -> Quantity | None:
    instrument = SimulatedInstrument(simulate(device, fidelity, **options), 0.0)  # type: ignore[arg-type]
    found = []
    for share in (1.0, -1.0, 1.5):
        volts = share * math.radians(speed_deg_s) / (0.5 * design_gain(device))
        instrument.configure(whole_angle(virtual_precession_v=volts))
        found.append(instrument.record(1.1 * math.pi / math.radians(speed_deg_s), settle_s=3.0))
    return loop_latency(found)


@pytest.mark.parametrize(("fidelity", "speed_deg_s"), [("carrier", 8.0), ("slow_flow", 8.0), ("slow_flow", 2.0)])
def test_latency_of_the_loops_is_found(fidelity: str, speed_deg_s: float) -> None:
    device = low_q_hrg(**ERRORS)
    found = latency_of(device, fidelity, speed_deg_s)
    assert found is not None
    assert found.value == pytest.approx(device.loop_latency_s, rel=0.01)
    assert 0.005 * found.value < found.sd < 0.03 * found.value


def test_slower_control_and_single_channel_electronics_are_later() -> None:
    base = low_q_hrg(**ERRORS)
    slow = replace(base, electronics=replace(base.electronics, samples_per_control=80, controls_per_row=10))
    single = replace(base, multiplexing=Multiplexing(enabled=True))
    # single-channel drives have a fifth of the time, and of the volts
    for device, speed, tolerance in ((slow, 8.0, 0.02), (single, 1.5, 0.05)):
        found = latency_of(device, "carrier", speed)
        assert found is not None
        assert found.value > 1.5 * base.loop_latency_s
        assert found.value == pytest.approx(device.loop_latency_s, rel=tolerance)


def test_noise_is_in_the_claimed_uncertainty() -> None:
    device = low_q_hrg(**ERRORS)
    for seed in range(6):
        found = latency_of(device, "slow_flow", 8.0, noisy=True, seed=seed)
        assert found is not None
        assert abs(found.value - device.loop_latency_s) < 3.0 * found.sd
        assert found.sd < 0.1 * found.value


def test_a_drive_at_the_end_of_its_range_is_left_out() -> None:
    device = low_q_hrg(**ERRORS)
    full = device.electronics.dac_full_scale_v * 0.5 * design_gain(device)
    assert latency_of(device, "slow_flow", math.degrees(1.2 * full)) is None


def test_without_a_turning_wave_there_is_no_latency() -> None:
    instrument = SimulatedInstrument(simulate(low_q_hrg()), 0.0)
    instrument.configure(whole_angle())
    assert loop_latency([instrument.record(5.0, settle_s=2.0)]) is None
    assert loop_latency([]) is None


@needs_bench
@pytest.mark.parametrize("name", ["hrg_a", "hrg_b"])
def test_another_plants_loops_are_late_by_one_and_a_half_control_periods(name: str) -> None:
    campaign = load_campaign(BENCH / f"{name}.h5")
    found = loop_latency(campaign)
    assert found is not None
    (rate_hz,) = {float(r.extras["control_rate_hz"]) for r in campaign if "control_rate_hz" in r.extras}
    assert abs(found.value - 1.5 / rate_hz) < max(3.0 * found.sd, 0.06 / rate_hz)
