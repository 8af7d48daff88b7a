"""Single-channel electronics: the wave is held and read as by dual-channel ones, apart from what the multiplexer itself adds."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from wave_samples import amplitude, design_gain, in_wave_frame, low_q_hrg, simulate, whole_angle

from gyro_calib.device import Feedthrough, Multiplexing, load_device
from gyro_calib.device.wave_point import wave_point
from gyro_calib.errors import DeviceError
from gyro_calib.experiments import gap_plan

BOTH = pytest.mark.parametrize("fidelity", ["slow_flow", "carrier"])


@BOTH
def test_single_channel_electronics_hold_the_wave_and_turn_it_like_dual_channel(fidelity: str) -> None:
    errors = {"gain_mismatch": -0.03, "two_delta_rad": 0.004, "two_lambda_rad": -0.02, "frequency_split_hz": 3e-3}
    base = replace(low_q_hrg(**errors), feedthrough=Feedthrough(xx_re=1e-3, yx_im=1e-3))
    single = replace(base, multiplexing=Multiplexing(enabled=True))
    assert np.all(single.slow_flow().E == 0.0)
    assert single.loop_latency_s > base.loop_latency_s
    sim = simulate(single, fidelity)
    for volts, rate in ((0.3, 0.0), (-0.3, 0.0), (0.0, 0.2)):
        sim.configure(whole_angle(virtual_precession_v=volts))
        sim.advance(3.0, rate)
        wave = in_wave_frame(sim.advance(5.0, rate))
        flow = single.slow_flow(rate)
        places = np.linspace(0, wave.middle.size - 1, 9).astype(int)
        expected = [
            wave_point(flow.A, flow.G, flow.E, 1.0, theta, precession_v=volts, latency_s=single.loop_latency_s).theta_rate_rad_s
            for theta in wave.middle[places]
        ]
        np.testing.assert_allclose(wave.rate[places], expected, rtol=1.5e-4)
        # x and y are read two slots apart: a turning wave looks larger or smaller by a turn of half that
        slot_s = 1.0 / single.electronics.control_rate_hz
        assert np.abs(amplitude(wave.rows) - 1.0).max() < 1.3 * 2.0 * np.abs(wave.rate).max() * slot_s


def test_recorded_drives_and_pick_offs_of_single_channel_electronics_are_of_the_same_instants() -> None:
    for device in (low_q_hrg(), replace(low_q_hrg(), multiplexing=Multiplexing(enabled=True, settling_share=0.4))):
        sim = simulate(device, "carrier")
        sim.configure(whole_angle())
        sim.advance(3.0, 0.5)
        wave = in_wave_frame(sim.advance(math.pi / (0.5 * 0.5 * device.resonator.angular_gain), 0.5))
        spin = 2.0 * np.gradient(wave.theta, wave.rows[:, 0])
        lever = -spin * wave.along.imag
        # the drive across the wave is that of the lag alone
        assert lever @ wave.across.imag / (lever @ lever) == pytest.approx(device.loop_latency_s, abs=1.5e-5)


@BOTH
def test_delay_and_crosstalk_of_the_multiplexer_turn_and_mix_what_is_seen(fidelity: str) -> None:
    base = low_q_hrg()
    plain = replace(base, multiplexing=Multiplexing(enabled=True))
    delay = 1e-6
    late = replace(base, multiplexing=Multiplexing(enabled=True, delay_s=delay))
    turn = base.resonator.omega0_rad_s * delay
    frequencies = []
    for device in (plain, late):
        sim = simulate(device, fidelity)
        sim.configure(whole_angle())
        sim.advance(2.0)
        frequencies.append(2.0 * math.pi * sim.advance(1.0)[:, 10].mean())
    # the amplitude drive is turned from the velocity by the lag: -tan(lag)/tau
    assert frequencies[1] - frequencies[0] == pytest.approx(-math.tan(turn) * base.resonator.decay_rate(), rel=1e-3)
    mixed = replace(base, multiplexing=Multiplexing(enabled=True, crosstalk=1e-3))
    sim = simulate(mixed, fidelity)
    sim.configure(whole_angle(virtual_precession_v=0.3))
    sim.advance(3.0)
    found = in_wave_frame(sim.advance(2.0)).rate.mean()
    assert found == pytest.approx(0.15 * design_gain(base), rel=2e-3)
    assert found != pytest.approx(0.15 * design_gain(base), rel=1e-4)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"settling_share": 0.95}, "settling_share must be at most 0.9, but got 0.95"),
        ({"settling_share": -0.1}, "settling_share must be >= 0, but got -0.1"),
        ({"delay_s": math.nan}, "delay_s must be finite"),
    ],
)
def test_a_multiplexer_that_cannot_be_is_refused(values: dict[str, float], text: str) -> None:
    with pytest.raises(DeviceError, match=text):
        Multiplexing(enabled=True, **values)


@pytest.mark.parametrize("effect", [{"drive_lag": {"tau": 8e-4}}, {"drive_delay": {"tau_x": -2e-4, "tau_y": -2e-4}}])
@pytest.mark.parametrize("enabled", [False, True])
def test_a_late_drive_is_as_late_in_its_slot(effect: dict[str, dict[str, float]], enabled: bool) -> None:
    """Behind a wave that an input rate turns, the drive that holds it pulls it back by ``decay * spin * tau``, on every azimuth."""
    base = replace(low_q_hrg(), multiplexing=Multiplexing(enabled=enabled))
    found = []
    for device in (base, replace(base, effects=effect)):
        sim = simulate(device, "carrier")
        sim.configure(whole_angle())
        sim.advance(3.0, 0.5)
        wave = in_wave_frame(sim.advance(math.pi / (0.5 * 0.5 * device.resonator.angular_gain), 0.5))
        found.append(wave.rate)
    tau = next(iter(next(iter(effect.values())).values()))
    expected = -base.resonator.decay_rate() * found[0] * tau
    np.testing.assert_allclose(found[1] - found[0], expected, rtol=0.005)


def test_a_plan_keeps_within_what_a_slot_can_give() -> None:
    """A drive that is on for a fifth of the time has a fifth of the range, and takes five times as long to put a wave elsewhere."""
    base = load_device("hrg_hardware")
    single = replace(base, multiplexing=Multiplexing(enabled=True, settling_share=0.2))
    assert single.factory()["dac_full_scale_V"] == pytest.approx(0.2 * base.factory()["dac_full_scale_V"])
    plans = [gap_plan(d.factory(), quality="quick") for d in (base, single)]
    most, most_single = (max(abs(s.command.setpoints.virtual_precession_v) for s in p.steps) for p in plans)
    assert most_single < 0.2 * 5.0 < most
    first, first_single = (next(s.settle_s for s in p.steps if s.command.mode == "ftr_x") for p in plans)
    turn_s = 0.25 * math.pi * abs(base.factory_data.nominal_scale_factor_x_v_per_rad_s) / (base.factory_data.angular_gain_kappa * 1.0)
    assert first_single > 1.5 * turn_s > first
