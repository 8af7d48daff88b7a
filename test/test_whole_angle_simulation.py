"""Whole-angle simulation against theory.md Eq. 6 and section 5, at carrier level and on the slow flow."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from wave_samples import amplitude, design_gain, harmonics, in_wave_frame, low_q_hrg, simulate, whole_angle

from gyro_calib.device import Device, Feedthrough, Multiplexing, Noise, draw_unit, load_device
from gyro_calib.device.wave_point import wave_point
from gyro_calib.errors import DataError, DeviceError
from gyro_calib.recording.command import Command, Excitation, Setpoints
from gyro_calib.recording.rate import raw_rate, wave_azimuth
from gyro_calib.simulation.flicker import FlickerSource

BOTH = pytest.mark.parametrize("fidelity", ["slow_flow", "carrier"])


@BOTH
def test_a_rate_turns_the_wave_by_half_kappa_omega_less_the_latency_of_the_drive(fidelity: str) -> None:
    device = low_q_hrg()
    sim = simulate(device, fidelity)
    sim.configure(whole_angle())
    for rate in (0.3, -0.3):
        sim.advance(1.0, rate)
        wave = in_wave_frame(sim.advance(4.0, rate))
        ideal = -0.5 * device.resonator.angular_gain * rate
        late = device.loop_latency_s * device.resonator.decay_rate()
        assert late > 5e-5
        assert wave.rate.mean() == pytest.approx(ideal * (1.0 - late), rel=2e-6)
        assert np.ptp(amplitude(wave.rows)) < 1e-6


@BOTH
def test_virtual_precession_turns_the_wave_in_proportion_to_its_volts_and_against_the_amplitude(fidelity: str) -> None:
    device = low_q_hrg()
    sim = simulate(device, fidelity)
    for volts, set_amplitude in ((0.5, 1.0), (1.0, 1.0), (-1.0, 1.0), (1.0, 0.6)):
        sim.configure(whole_angle(virtual_precession_v=volts, amplitude_v=set_amplitude))
        sim.advance(3.0)
        rate = in_wave_frame(sim.advance(2.0)).rate.mean()
        # g u / (4 omega a) with g / 2 omega = |G|; the second order is the latency
        assert rate == pytest.approx(design_gain(device) * volts / (2.0 * set_amplitude), rel=2e-4)


def test_damping_anisotropy_drifts_with_the_fourth_harmonic() -> None:
    device = low_q_hrg(damping_anisotropy=0.05)
    sim = simulate(device)
    sim.configure(whole_angle())
    sim.advance(1.0, 0.1)
    turn = math.pi / (0.05 * device.resonator.angular_gain)
    wave = in_wave_frame(sim.advance(turn, 0.1))
    found = harmonics(wave.rate, wave.middle)
    strength = 0.25 * 0.05 * device.resonator.decay_rate()
    # 1/4 Delta(1/tau) sin 4(theta - theta_tau)
    np.testing.assert_allclose(found[1:], strength * np.array([-math.sin(2.4), math.cos(2.4)]), atol=0.004 * strength)
    # and the amplitude drive by 1/2 Delta(1/tau) cos 4(theta - theta_tau)
    drive = harmonics(wave.along.imag * design_gain(device), wave.theta)
    assert drive[0] == pytest.approx(device.resonator.decay_rate(), rel=1e-3)
    np.testing.assert_allclose(drive[1:], 2.0 * strength * np.array([math.cos(2.4), math.sin(2.4)]), atol=0.01 * strength)


def test_frequency_split_moves_the_frequency_and_the_quadrature_drive() -> None:
    device = low_q_hrg(frequency_split_hz=3.1e-3)
    sim = simulate(device)
    sim.configure(whole_angle())
    sim.advance(2.0, 0.3)
    wave = in_wave_frame(sim.advance(math.pi / (0.15 * device.resonator.angular_gain), 0.3))
    split = 2.0 * math.pi * 3.1e-3
    frequency = harmonics(2.0 * math.pi * wave.rows[:, 10], wave.theta)
    np.testing.assert_allclose(frequency[1:], 0.5 * split * np.array([math.cos(1.0), math.sin(1.0)]), atol=2e-2 * split)
    # q' = ... + 1/2 Delta omega a sin 4(theta - theta_omega) + |G| u_perp_c = 0
    quadrature = harmonics(wave.across.real * design_gain(device), wave.theta)
    np.testing.assert_allclose(quadrature[1:], -0.5 * split * np.array([-math.sin(1.0), math.cos(1.0)]), atol=2e-2 * split)


def test_drive_errors_drift_as_the_amplitude_drive_times_k_av() -> None:
    errors = {"gain_mismatch": 2e-3, "two_delta_rad": 3e-3, "two_lambda_rad": -4e-3}
    device = low_q_hrg(**errors)
    sim = simulate(device)
    sim.configure(whole_angle())
    turn = math.pi / (0.5 * device.resonator.angular_gain)
    drifts = []
    for rate in (1.0, -1.0):
        sim.advance(1.0, rate)
        wave = in_wave_frame(sim.advance(turn, rate))
        drifts.append(harmonics(wave.rate, wave.middle))
    drift = 0.5 * (drifts[0] + drifts[1])
    scale = 0.5 * device.resonator.decay_rate()
    # u_par_s |G| / 2 a of (tan 2 lambda + Delta G/2 sin 4 theta + tan 2 delta cos 4 theta)
    np.testing.assert_allclose(drift, scale * np.array([-4e-3, 3e-3, 1e-3]), atol=scale * 4e-5)


@BOTH
def test_large_drive_errors_agree_with_the_quasi_steady_state(fidelity: str) -> None:
    device = replace(draw_unit(load_device("hrg_hardware"), 3), feedthrough=Feedthrough(xx_re=2e-4, yx_im=3e-4, yy_im=-1e-4))
    sim = simulate(device, fidelity)
    for volts, rate in ((0.5, 0.0), (-0.5, 0.0), (0.02, 0.2)):
        sim.configure(whole_angle(virtual_precession_v=volts))
        sim.advance(3.0, rate)
        wave = in_wave_frame(sim.advance(6.0, rate))
        flow = device.slow_flow(rate)
        places = np.linspace(0, wave.middle.size - 1, 9).astype(int)
        points = [
            wave_point(flow.A, flow.G, flow.E, 1.0, theta, precession_v=volts, latency_s=device.loop_latency_s)
            for theta in wave.middle[places]
        ]
        expected = np.array([p.theta_rate_rad_s for p in points])
        np.testing.assert_allclose(wave.rate[places], expected, rtol=1.5e-5)
        np.testing.assert_allclose(wave.along.imag[places], [p.amplitude_drive_v for p in points], atol=3e-4)


def test_carrier_and_slow_flow_give_the_same_rows_through_every_mode() -> None:
    device = draw_unit(low_q_hrg(gain_mismatch=0.02, two_lambda_rad=0.01, frequency_split_hz=3e-3), 5)
    sims = [simulate(device, fidelity) for fidelity in ("slow_flow", "carrier")]
    commands = [
        whole_angle(virtual_precession_v=1.0),
        whole_angle(virtual_precession_v=-0.7, stiffness_v_per_v=0.5),
        whole_angle("ring_down", amplitude_gain_v_per_v=-3.0),
        whole_angle("ring_up", amplitude_gain_v_per_v=3.0),
        whole_angle("stiffness", stiffness_v_per_v=-1.0),
        Command("ftr_x"),
    ]
    for sim in sims:  # what fills the carrier's filters at the start is not exact
        sim.advance(0.2)
    for command in commands:
        for sim in sims:
            sim.configure(command)
        flow, carrier = (sim.advance(5.0, 0.1) for sim in sims)
        np.testing.assert_allclose(carrier[:, 2:6], flow[:, 2:6], atol=2e-5)
        # the loops' answer to a step of the command shows the first order of averaging
        np.testing.assert_allclose(carrier[:, 6:10], flow[:, 6:10], atol=6e-3)
        np.testing.assert_allclose(carrier[-20:, 6:10], flow[-20:, 6:10], atol=3e-5)
        np.testing.assert_allclose(carrier[:, 10], flow[:, 10], atol=1e-5)


def _slope(rows: np.ndarray, low: float, high: float) -> float:
    """Rate of growth of the amplitude between two levels [1/s]."""
    a = amplitude(rows)
    inside = (a > low) & (a < high)
    assert inside.sum() > 50
    return float(np.polyfit(rows[inside, 0], np.log(a[inside]), 1)[0])


@BOTH
def test_ring_down_and_up_run_at_c_plus_and_minus_the_damping_and_stop_at_their_ends(fidelity: str) -> None:
    device = low_q_hrg()
    sim = simulate(device, fidelity)
    gain = 2.0
    sim.configure(whole_angle("ring_down", amplitude_gain_v_per_v=-gain))
    down = sim.advance(3.5)
    sim.configure(whole_angle("ring_up", amplitude_gain_v_per_v=gain))
    up = sim.advance(6.5)
    fast, slow = -_slope(down, 0.55, 0.95), _slope(up, 0.55, 0.95)
    assert amplitude(down)[-1] == pytest.approx(0.5, abs=1e-4)
    assert amplitude(up)[-1] == pytest.approx(1.0, abs=1e-3)
    c = gain * design_gain(device)
    # the drive answers the amplitude of a latency ago: C exp(+-latency/T)
    assert 0.5 * (fast + slow) == pytest.approx(c * (1.0 + device.loop_latency_s * device.resonator.decay_rate()), rel=2e-6)
    assert 0.5 * (fast - slow) == pytest.approx(device.resonator.decay_rate() + c**2 * device.loop_latency_s, rel=1e-5)


def test_without_gain_the_wave_rings_down_freely_and_quadrature_stays_closed() -> None:
    device = low_q_hrg(frequency_split_hz=3e-3, damping_anisotropy=0.02, damping_azimuth_rad=0.0)
    sim = simulate(device)
    sim.configure(whole_angle("ring_down"))
    rows = sim.advance(8.0)
    # theta = 0 on the axis of the larger damping
    assert -_slope(rows, 0.51, 0.99) == pytest.approx(device.resonator.decay_rate() * 1.01, rel=1e-5)
    cross = 2.0 * (rows[:, 4] * rows[:, 3] - rows[:, 2] * rows[:, 5])
    assert np.abs(cross[100:]).max() < 1e-5


@BOTH
def test_drive_at_twice_the_frequency_makes_exponentials_of_constant_volts(fidelity: str) -> None:
    base = low_q_hrg()
    device = replace(base, drive=replace(base.drive, at_twice_frequency=True))
    sim = simulate(device, fidelity)
    sim.configure(whole_angle("ring_down", amplitude_gain_v_per_v=-2.0))
    down = sim.advance(3.0)
    falling = amplitude(down) > 0.52
    drive = in_wave_frame(down).along.imag[falling][20:]
    np.testing.assert_allclose(drive, -2.0, atol=1e-3)
    # no latency: the force follows the motion itself
    assert -_slope(down, 0.55, 0.95) == pytest.approx(2.0 * design_gain(device) + device.resonator.decay_rate(), rel=1e-6)


@BOTH
@pytest.mark.parametrize("mode", ["stiffness", "whole_angle", "ftr_x"])
def test_stiffness_control_shifts_the_frequency_in_every_closed_mode(fidelity: str, mode: str) -> None:
    errors = {"gain_mismatch": -0.03, "two_delta_rad": 0.01, "two_lambda_rad": -0.02}
    device = low_q_hrg(**errors)
    sim = simulate(device, fidelity)
    frequency = []
    for cr in (2.0, -2.0, 2.0):
        sim.configure(whole_angle(mode, stiffness_v_per_v=cr))
        sim.advance(0.7)
        frequency.append(2.0 * math.pi * sim.advance(0.3)[:, 10].mean())
    v = (frequency[1] - 0.5 * (frequency[0] + frequency[2])) / 4.0
    g = device.slow_flow().G
    # what the force on the other axis makes is taken back by the quadrature or rebalance loop: minus G_xy G_yx / G_yy
    expected = abs(g[0, 0] - g[0, 1] * g[1, 0] / g[1, 1])
    assert abs(expected / abs(g[0, 0]) - 1.0) > 3e-4
    assert v == pytest.approx(expected, rel=5e-5)


def test_the_wave_keeps_its_azimuth_from_command_to_command() -> None:
    device = low_q_hrg(two_lambda_rad=0.02)
    sim = simulate(device)
    sim.configure(Command("ftr_y"))
    sim.advance(12.0)
    sim.configure(whole_angle())
    start = wave_azimuth(sim.advance(0.1))
    assert np.abs(np.abs(start) - math.pi / 4).max() < 1e-3
    last = start[-1]
    for command in (whole_angle(virtual_precession_v=0.5), whole_angle("ring_down", amplitude_gain_v_per_v=-3.0), whole_angle()):
        sim.configure(command)
        theta = wave_azimuth(sim.advance(3.0))
        assert abs(math.remainder(theta[0] - last, math.pi / 2)) < 1e-3
        assert np.abs(np.diff(theta)).max() < 1e-3
        last = theta[-1]


def test_a_wave_builds_up_again_after_it_has_died() -> None:
    ring = load_device("ring_15k")
    sim = simulate(ring, noisy=True)
    sim.configure(whole_angle())
    sim.advance(1.0)
    sim.configure(Command("loops_off"))
    assert amplitude(sim.advance(8.0))[-1] < 1e-3
    sim.configure(whole_angle())
    sim.advance(4.0)
    np.testing.assert_allclose(amplitude(sim.advance(1.0)), 1.0, atol=1e-4)


def test_the_rate_of_blocks_adds_up_to_the_angle_turned_however_they_are_cut() -> None:
    device = replace(low_q_hrg(), noise=Noise(pickoff_v_rthz=1e-5))
    sim = simulate(device, noisy=True)
    sim.configure(whole_angle())
    sim.advance(1.0, 0.2)
    rows = sim.advance(4.0, 0.2)
    whole = raw_rate(rows, sim.command, sim.factory)
    blocks, before = [], None
    for block in np.split(rows, [1, 3, 40, 41, 200]):
        blocks.append(raw_rate(block, sim.command, sim.factory, before=before))
        before = block[-1]
    cut = np.concatenate(blocks)
    assert math.isnan(cut[0])
    np.testing.assert_allclose(cut[1:], whole[1:], rtol=1e-9)
    assert whole.mean() == pytest.approx(0.2, rel=1e-3)
    alone = np.concatenate([raw_rate(block, sim.command, sim.factory) for block in np.split(rows, 20)])
    assert np.std(np.cumsum(alone - whole)) > 3.0 * np.std(np.cumsum(cut[1:] - whole[1:]))
    stranger = rows[0].copy()
    stranger[1] += 1
    np.testing.assert_array_equal(raw_rate(rows, sim.command, sim.factory, before=stranger), whole)


def test_the_raw_rate_leaves_out_the_commanded_precession_and_knows_the_sense_of_the_rate() -> None:
    sim = simulate(low_q_hrg())
    for volts, rate in ((0.5, 0.0), (0.5, 0.1), (0.0, -0.1)):
        sim.configure(whole_angle(virtual_precession_v=volts))
        sim.advance(3.0, rate)
        found = raw_rate(sim.advance(2.0, rate), sim.command, sim.factory)
        # the nominal scale factor has no hold of the converter
        assert found.mean() == pytest.approx(rate, abs=1e-4 * abs(rate) + 0.007 * 0.5 / 4.88)
    with pytest.raises(DataError, match="angular_gain_kappa for the rate of a whole-angle gyro, but got None"):
        raw_rate(sim.advance(0.1), sim.command, {})
    with pytest.raises(DataError, match="nominal_scale_factor_v_per_rad_s for axis 'x', but got None"):
        raw_rate(sim.advance(0.1), whole_angle(virtual_precession_v=1.0), {"angular_gain_kappa": 0.5})


@pytest.mark.parametrize("multiplexed", [False, True])
def test_truth_is_the_mean_over_the_azimuth_of_the_simulated_rate(multiplexed: bool) -> None:
    errors = {"gain_mismatch": 0.01, "two_delta_rad": 0.004, "two_lambda_rad": 0.01, "damping_anisotropy": 0.02, "frequency_split_hz": 2e-3}
    device = replace(low_q_hrg(**errors), multiplexing=Multiplexing(enabled=multiplexed))
    sim = simulate(device)
    sim.configure(whole_angle())
    means = {}
    for rate in (0.5, -0.5):
        sim.advance(2.0, rate)
        wave = in_wave_frame(sim.advance(math.pi / (0.25 * device.resonator.angular_gain), rate))
        means[rate] = harmonics(-2.0 / 0.55 * wave.rate, wave.middle)[0]
    truth = sim.truth()
    assert means[0.5] - means[-0.5] == pytest.approx(truth.scale_factor, rel=1e-5)
    assert 0.5 * (means[0.5] + means[-0.5]) == pytest.approx(truth.bias_rad_s, rel=0.02)
    assert truth.bias_rad_s == pytest.approx(-math.tan(0.01) * device.resonator.decay_rate() / 0.55, rel=0.02)


def test_truth_in_volts_is_the_precession_drive_that_would_hold_the_wave() -> None:
    device = low_q_hrg(gain_mismatch=0.02)
    sim = simulate(device)
    sim.configure(whole_angle())
    g = 0.5 * np.trace(np.abs(device.slow_flow().G))
    assert sim.truth().scale_factor_v_per_rad_s == pytest.approx(device.resonator.angular_gain / g, rel=2e-4)
    sim.configure(whole_angle("ring_down"))
    sim.configure(Command("loops_off"))
    with pytest.raises(DeviceError, match="force-rebalance mode, but got 'loops_off'"):
        sim.truth()


@pytest.mark.parametrize(
    ("command", "text"),
    [
        (Command("whole_angle", Excitation("amplitude_modulation", 1.0, 0.1)), "Excitation must be none in mode whole_angle"),
        (whole_angle("ring_down", amplitude_gain_v_per_v=1.0), "must be <= 0 in mode ring_down, but got 1.0"),
        (whole_angle("ring_up"), "must be > 0 in mode ring_up, but got 0.0"),
    ],
)
def test_what_the_loops_cannot_do_is_refused_and_the_old_command_stays(command: Command, text: str) -> None:
    sim = simulate(load_device("hrg_hardware"))
    before = sim.command
    with pytest.raises(DeviceError, match=text):
        sim.configure(command)
    assert sim.command is before
    assert sim.segment == 0


def test_flicker_has_a_flat_allan_deviation_at_its_floor_and_does_not_depend_on_the_blocks() -> None:
    row_s = 0.05
    noise = FlickerSource(np.random.default_rng(3), 2.0, 16, row_s).rows(60_000)
    for tau in (2.0, 8.0, 32.0, 128.0):
        width = round(tau / row_s)
        means = noise[: len(noise) // width * width].reshape(-1, width, 16).mean(axis=1)
        assert math.sqrt(0.5 * np.mean(np.diff(means, axis=0) ** 2)) == pytest.approx(2.0, rel=0.2)
    source = FlickerSource(np.random.default_rng(3), 2.0, 16, row_s)
    np.testing.assert_allclose(np.concatenate([source.rows(n) for n in (1, 7, 92)]), noise[:100], rtol=1e-12)


@BOTH
def test_stray_flicker_of_the_drives_turns_the_wave_and_is_not_in_the_columns(fidelity: str) -> None:
    device = replace(low_q_hrg(), noise=Noise(thermomechanical=False, drive_flicker_v=1e-3))
    sim = simulate(device, fidelity, noisy=True)
    sim.configure(whole_angle())
    sim.advance(1.0)
    wave = in_wave_frame(sim.advance(20.0))
    found = wave.rate[:1900].reshape(-1, 100).mean(axis=1)
    spread = math.sqrt(0.5 * np.mean(np.diff(found) ** 2))
    assert spread == pytest.approx(1e-3 * design_gain(device) / 2.0, rel=0.5)
    assert np.abs(wave.across.imag).max() < 1e-6


def test_drive_noise_is_the_angle_random_walk_of_the_packaged_hemisphere() -> None:
    base = load_device("hrg_hardware")
    device = replace(base, noise=replace(base.noise, drive_flicker_v=0.0, pickoff_v_rthz=0.0))
    sim = simulate(device, noisy=True)
    sim.configure(whole_angle())
    sim.advance(5.0)
    rates = raw_rate(sim.advance(400.0), sim.command, sim.factory)
    walk = np.std(np.diff(rates.reshape(-1, 100).mean(axis=1))) / math.sqrt(2.0)
    expected = base.noise.drive_v_rthz * design_gain(base) / base.resonator.angular_gain
    assert walk == pytest.approx(expected, rel=0.15)
    assert 2e-4 < math.degrees(walk) * 60.0 < 6e-4


@pytest.mark.parametrize("name", ["hrg_sun2024", "hrg_hardware"])
def test_packaged_hemispheres_are_whole_angle_gyros_and_draw_units(name: str) -> None:
    device = load_device(name)
    factory = device.factory()
    assert factory["mission_mode"] == "whole_angle"
    assert factory["drive_gain_ratio_x_over_y"] == pytest.approx(1.0 / (1.0 + device.drive.gain_mismatch), rel=1e-6)
    assert factory["nominal_scale_factor_v_per_rad_s"]["x"] == pytest.approx(
        0.55 * 2.0 * device.resonator.omega0_rad_s / (device.drive.gain_m_s2_per_v * 1e6), rel=1e-4
    )
    assert device.electronics.adc_rate_hz / device.resonator.frequency_hz >= 16.0
    units = [draw_unit(device, seed) for seed in range(60)]
    assert np.std([u.drive.gain_mismatch for u in units]) == pytest.approx(5e-3, rel=0.3)
    assert np.mean([u.drive.gain_mismatch for u in units]) == pytest.approx(device.drive.gain_mismatch, abs=3e-3)
    assert all(1e-3 <= u.resonator.frequency_split_hz <= 6e-3 for u in units)
    assert max(abs(u.feedthrough.xx_re) for u in units) < 1e-4
    sim = simulate(units[0], noisy=True)
    sim.configure(whole_angle(virtual_precession_v=0.03))
    sim.advance(5.0)
    np.testing.assert_allclose(amplitude(sim.advance(1.0)), 1.0, atol=2e-5)


def test_a_mission_without_a_rate_is_refused() -> None:
    device: Device = load_device("hrg_hardware")
    with pytest.raises(DeviceError, match="mission_mode must be one of ftr_x, ftr_y, whole_angle, but got 'loops_off'"):
        replace(device.factory_data, mission_mode="loops_off")


def test_set_points_are_held_at_other_amplitudes() -> None:
    sim = simulate(low_q_hrg(two_lambda_rad=0.02))
    sim.configure(Command("whole_angle", setpoints=Setpoints(amplitude_v=0.6)))
    sim.advance(4.0)
    np.testing.assert_allclose(amplitude(sim.advance(1.0)), 0.6, atol=1e-6)
