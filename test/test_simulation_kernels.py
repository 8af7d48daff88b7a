"""The two simulators against each other, against closed forms, against their claimed noise, and against their own source uncompiled."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.special import ndtr

from gyro_calib.device import Device, draw_unit, load_device
from gyro_calib.device.chains import DriveChain, Feedthrough, PickoffChain
from gyro_calib.jit import COMPILED, _collect_sources
from gyro_calib.recording.columns import column_index
from gyro_calib.recording.command import Command, Excitation
from gyro_calib.recording.rate import raw_rate
from gyro_calib.simulation import GyroSimulator
from gyro_calib.simulation.normals import LANES, NormalSource, random_words
from gyro_calib.simulation.truth import operating_point

FIDELITIES = ("carrier", "slow_flow")
#: minutes of device time: as plain Python they would take an hour
compiled_only = pytest.mark.skipif(not COMPILED, reason="numba is not installed or switched off")
CHANNELS = slice(2, 10)
X_PICK = slice(2, 4)


@pytest.fixture(scope="module")
def unit() -> Device:
    """A unit with every imperfection of the design's spread."""
    return draw_unit(load_device("ring_15k"), 3)


def quiet(device: Device, fidelity: str) -> GyroSimulator:
    return GyroSimulator(device, rng=np.random.default_rng(0), fidelity=fidelity, noisy=False)


def perfect(device: Device) -> Device:
    """Ideal chains, matched modes, no feedthrough; damping and Coriolis force are all that is left."""
    resonator = replace(device.resonator, frequency_split_hz=0.0, damping_anisotropy=0.0)
    drive, pickoff = DriveChain(device.drive.gain_m_s2_per_v), PickoffChain(device.pickoff.gain_v_per_m)
    return replace(device, resonator=resonator, drive=drive, pickoff=pickoff, feedthrough=Feedthrough())


# ---------------------------------------------------------------- carrier against slow flow


@compiled_only
@pytest.mark.parametrize("mode", ["ftr_x", "ftr_y"])
def test_both_simulators_settle_at_one_operating_point(unit: Device, mode: str) -> None:
    means = []
    for fidelity in FIDELITIES:
        simulator = quiet(unit, fidelity)
        simulator.configure(Command(mode))
        simulator.advance(4.0 if mode == "ftr_y" else 2.0, 0.1)
        means.append(simulator.advance(0.2, 0.1).mean(axis=0))
    carrier, slow = means
    # rebalance drives of some 0.01 to 1 V; 2e-7 V of the rate channel is 0.4 deg/h
    np.testing.assert_allclose(slow[CHANNELS], carrier[CHANNELS], rtol=0.0, atol=2e-7)
    assert slow[10] == pytest.approx(carrier[10], abs=2e-6)


@compiled_only
def test_both_simulators_answer_a_step_of_rate_alike(unit: Device) -> None:
    answers = []
    for fidelity in FIDELITIES:
        simulator = quiet(unit, fidelity)
        simulator.advance(1.0)
        before = raw_rate(simulator.advance(0.1), simulator.command, simulator.factory).mean()
        answers.append(raw_rate(simulator.advance(0.3, 0.2), simulator.command, simulator.factory) - before)
    carrier, slow = answers
    # the loop overshoots and settles: the transient is there, and the same to 1e-3 of the step
    assert carrier.max() > 1.02 * carrier[-1]
    assert carrier[-1] == pytest.approx(0.2, rel=0.15)
    np.testing.assert_allclose(slow, carrier, rtol=0.0, atol=2e-4)


@compiled_only
def test_both_simulators_answer_side_bands_alike(unit: Device) -> None:
    answers = []
    for fidelity in FIDELITIES:
        simulator = quiet(unit, fidelity)
        simulator.configure(Command("ftr_x", Excitation("amplitude_modulation", 1.5, 0.15)))
        simulator.advance(2.0)
        answers.append(simulator.advance(1.0))
    carrier, slow = answers
    modulation = np.ptp(carrier[:, column_index("x_pick_c")])
    assert modulation == pytest.approx(0.3, rel=0.1)
    # first-order averaging leaves out the rate of change of the envelope over the carrier frequency, some 1e-5
    np.testing.assert_allclose(slow[:, CHANNELS], carrier[:, CHANNELS], rtol=0.0, atol=2e-5)


@compiled_only
def test_open_drive_off_resonance_agrees_to_the_first_order_of_averaging(unit: Device) -> None:
    detuning_hz = 40.0
    frequency = unit.resonator.frequency_hz + detuning_hz
    answers = []
    for fidelity in FIDELITIES:
        simulator = quiet(unit, fidelity)
        simulator.configure(Command("loops_off", Excitation("drive", frequency, 0.0, 2.0, "y")))
        simulator.advance(8.0)
        rows = simulator.advance(0.2).mean(axis=0)
        answers.append(complex(rows[4], rows[5]))
    carrier, slow = answers
    assert abs(carrier) > 0.01
    # 1 / (w0^2 - w^2) against 1 / 2 w (w0 - w): they part by half the relative detuning, the hold's sinc by 3e-5
    assert slow / carrier == pytest.approx(1.0 + 0.5 * detuning_hz / frequency, abs=1e-4)


# ---------------------------------------------------------------- closed forms


@compiled_only
@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_ring_down_follows_the_matrix_exponential(unit: Device, fidelity: str) -> None:
    """Free decay of both modes, coupled by everything, against exp(A t) about the drive frequency."""
    frequency = unit.resonator.frequency_hz - 3.0
    simulator = quiet(unit, fidelity)
    simulator.advance(0.5, 0.3)
    simulator.configure(Command("loops_off", Excitation("drive", frequency, 0.0, 0.0, "x")))
    simulator.advance(0.05, 0.3)
    rows = simulator.advance(0.6, 0.3)
    envelope = rows[:, 2:6:2] + 1j * rows[:, 3:6:2]
    flow = unit.slow_flow(0.3)
    detuning = 2.0 * math.pi * frequency - flow.omega0_rad_s
    time = rows[-1, 0] - rows[0, 0]
    expected = expm((flow.A - 1j * detuning * np.eye(2)) * time) @ envelope[0]
    np.testing.assert_allclose(envelope[-1], expected, rtol=0.0, atol=1e-5)


@compiled_only
@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_ring_down_rate_of_a_perfect_ring_is_omega_over_2q(unit: Device, fidelity: str) -> None:
    simulator = quiet(perfect(unit), fidelity)
    simulator.configure(Command("loops_off", Excitation("drive", unit.resonator.frequency_hz, 0.0, 0.0, "x")))
    simulator.advance(0.1)
    rows = simulator.advance(1.0)
    level = np.log(np.hypot(rows[:, 2], rows[:, 3]))
    rate = -(level[-1] - level[0]) / (rows[-1, 0] - rows[0, 0])
    assert rate == pytest.approx(unit.resonator.decay_rate(), rel=1e-7)


@compiled_only
def test_carrier_has_no_numerical_damping(unit: Device) -> None:
    """Q = 1e12: a second of the nonlinear, undriven resonator keeps its energy to 1e-7, of which the damping takes 9.4e-8."""
    device = replace(unit, resonator=replace(unit.resonator, quality_factor=1e12, damping_anisotropy=0.0))
    # amplitude-dependent stiffness of 0.4 Hz: the splitting between linear and nonlinear part is at work
    device = replace(device, nonlinearity=replace(device.nonlinearity, cubic_isotropic=1e18))
    simulator = quiet(device, "carrier")
    simulator.configure(Command("loops_off"))
    simulator.advance(0.01)
    r = device.resonator
    w, stiffness = r.omega0_rad_s, r.stiffness_matrix()

    def energy() -> float:
        z = simulator._plant.z  # type: ignore[attr-defined]
        place, velocity = z[:2], w * z[2:4]
        return float(0.5 * velocity @ velocity + 0.5 * place @ stiffness @ place + 0.25e18 * (place @ place) ** 2)

    before = energy()
    simulator.advance(1.0)
    assert before > 0.0
    # the splitting makes the energy breathe by (w dt)^2 of the cubic part, 5e-6 of the whole, without drift
    assert energy() == pytest.approx(before, rel=1e-5)
    linear = replace(device, nonlinearity=replace(device.nonlinearity, cubic_isotropic=0.0))
    simulator = quiet(linear, "carrier")
    simulator.configure(Command("loops_off"))
    simulator.advance(0.01)

    def linear_energy() -> float:
        z = simulator._plant.z  # type: ignore[attr-defined]
        return float(w**2 * z[2:4] @ z[2:4] + z[:2] @ stiffness @ z[:2])

    before = linear_energy()
    simulator.advance(1.0)
    lost = 1.0 - linear_energy() / before
    assert lost == pytest.approx(w / 1e12, abs=2e-11)


@compiled_only
@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_scale_factor_of_a_perfect_ring_is_theory_eq_7(unit: Device, fidelity: str) -> None:
    device = perfect(unit)
    simulator = quiet(device, fidelity)
    volts = []
    for rate in (-0.1, 0.1):
        simulator.advance(1.5, rate)
        volts.append(simulator.advance(0.2, rate)[:, column_index("y_drive_s")].mean())
    gain = abs(device.slow_flow().G[1, 1])
    amplitude = simulator.command.setpoints.amplitude_v
    assert (volts[1] - volts[0]) / 0.2 == pytest.approx(device.resonator.angular_gain * amplitude / gain, rel=1e-9)
    assert volts[1] + volts[0] == pytest.approx(0.0, abs=1e-12)


@compiled_only
@pytest.mark.parametrize("fidelity", FIDELITIES)
@pytest.mark.parametrize("mode", ["ftr_x", "ftr_y"])
def test_bias_and_scale_factor_are_what_truth_says(unit: Device, fidelity: str, mode: str) -> None:
    simulator = quiet(unit, fidelity)
    simulator.configure(Command(mode))
    simulator.advance(4.0)
    measured = []
    for rate in (0.0, 0.05):
        simulator.advance(1.0, rate)
        measured.append(raw_rate(simulator.advance(0.2, rate), simulator.command, simulator.factory).mean())
    truth = simulator.truth()
    assert abs(truth.bias_rad_s) > 1e-4
    assert measured[0] == pytest.approx(truth.bias_rad_s, abs=3e-8)  # 0.006 deg/h
    assert (measured[1] - measured[0]) / 0.05 == pytest.approx(truth.scale_factor, rel=2e-6)


@compiled_only
@pytest.mark.parametrize("mode", ["ftr_x", "ftr_y"])
def test_truth_knows_the_drive_compensation_of_a_force_rebalance_gyro(unit: Device, mode: str) -> None:
    found = {}
    for compensation in ((1.0, 0.0, 0.0, 1.0), (0.9, 0.4, -0.3, 1.2)):
        simulator = quiet(unit, "slow_flow")
        simulator.configure(Command(mode, compensation=compensation))
        simulator.advance(4.0)
        rows = simulator.advance(0.2)
        truth = simulator.truth()
        measured = raw_rate(rows, simulator.command, simulator.factory).mean()
        assert measured == pytest.approx(truth.bias_rad_s, abs=3e-8)
        # the PLL works before the matrix: the frequency moves with it
        point = operating_point(unit, simulator.command, 0.0)
        frequency = (unit.slow_flow().omega0_rad_s + point.detuning_rad_s) / (2.0 * math.pi)
        assert rows[:, column_index("ref_freq")].mean() == pytest.approx(frequency, abs=1e-6)
        found[compensation] = truth.bias_rad_s, frequency
    (plain, first), (compensated, second) = found.values()
    assert abs(compensated - plain) > 3e-7
    assert abs(second - first) > 1e-3


# ---------------------------------------------------------------- noise


@compiled_only
@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_angle_random_walk_is_the_thermomechanical_floor(unit: Device, fidelity: str) -> None:
    """Brownian force alone: means of the rate over T scatter by ARW / sqrt(T), as nearly as 600 of them tell."""
    device = perfect(unit)
    device = replace(
        device,
        noise=replace(device.noise, pickoff_v_rthz=0.0, drive_v_rthz=0.0),
        environment=replace(device.environment, wander_k=0.0),
    )
    simulator = GyroSimulator(device, rng=np.random.default_rng(5), fidelity=fidelity)
    simulator.advance(0.5)
    # a hundred times the 2 ms of the loop, so that its shape does not count
    length_s, count = 0.2, 600
    rate = raw_rate(simulator.advance(length_s * count), simulator.command, simulator.factory) / simulator.truth().scale_factor
    scatter = rate.reshape(count, -1).mean(axis=1).std(ddof=1) * math.sqrt(length_s)
    amplitude_m = simulator.command.setpoints.amplitude_v / device.pickoff.gain_v_per_m
    expected = device.resonator.thermomechanical_arw(amplitude_m, device.environment.temperature_degc)
    assert scatter == pytest.approx(expected, rel=4.0 / math.sqrt(2.0 * count))


@compiled_only
def test_both_simulators_have_the_same_noise_in_every_closed_channel(unit: Device) -> None:
    """Scatter row by row, inside and beyond the loops' bandwidths; thermomechanical, drive and pick-off noise together."""
    device = replace(unit, environment=replace(unit.environment, wander_k=0.0))
    scatter = []
    for fidelity in FIDELITIES:
        simulator = GyroSimulator(device, rng=np.random.default_rng(6), fidelity=fidelity)
        simulator.advance(0.5)
        scatter.append(simulator.advance(8.0)[:, (2, 3, 4, 5, 7, 8, 9, 10)].std(axis=0))
    # 4000 rows, correlated over the loops' 10 to 100 Hz: some 80 to 800 independent ones
    np.testing.assert_allclose(scatter[1], scatter[0], rtol=0.15)


def test_normals_are_normal() -> None:
    x = NormalSource(np.random.default_rng(1)).draw(2_000_000).astype(float)
    for power, moment in ((1, 0.0), (2, 1.0), (3, 0.0), (4, 3.0)):
        sd = np.std(x**power) / math.sqrt(x.size)
        assert abs(np.mean(x**power) - moment) < 4.0 * sd
    edges = np.linspace(-4.5, 4.5, 181)
    counts = np.histogram(x, edges)[0]
    expected = np.diff(ndtr(edges)) * x.size
    seen = expected > 20.0
    chi2 = np.sum((counts - expected)[seen] ** 2 / expected[seen])
    assert chi2 < seen.sum() + 4.0 * math.sqrt(2.0 * seen.sum())
    # neighbours and values a block apart have nothing to do with each other
    for lag in (1, 2, 4, 8, 256, 8192):
        assert abs(np.mean(x[:-lag] * x[lag:])) < 4.5 / math.sqrt(x.size)


@compiled_only
def test_words_are_those_of_numpys_generators() -> None:
    lanes = [np.random.SFC64(seed) for seed in range(LANES)]
    state = np.array([lane.state["state"]["state"] for lane in lanes], dtype=np.uint64).T.copy()
    words = np.empty(100 * LANES, dtype=np.uint64)
    random_words(state, words)
    np.testing.assert_array_equal(words.reshape(100, LANES).T, [lane.random_raw(100) for lane in lanes])


def test_normals_do_not_depend_on_how_they_are_asked_for() -> None:
    whole = NormalSource(np.random.default_rng(2)).draw(20_000).copy()
    source = NormalSource(np.random.default_rng(2))
    parts = np.concatenate([source.draw(count).copy() for count in (0, 1, 7, 255, 257, 9_480, 10_000)])
    np.testing.assert_array_equal(parts, whole)
    assert not np.array_equal(NormalSource(np.random.default_rng(3)).draw(20_000), whole)


# ---------------------------------------------------------------- determinism, compiled and not


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_rows_depend_on_the_seed_and_not_on_how_calls_divide_the_time(unit: Device, fidelity: str) -> None:
    def rows(seed: int, *durations_s: float) -> np.ndarray:
        simulator = GyroSimulator(unit, rng=np.random.default_rng(seed), fidelity=fidelity)
        return np.concatenate([simulator.advance(duration, 0.1) for duration in durations_s])

    whole = rows(1, 0.6)
    np.testing.assert_array_equal(rows(1, 0.6), whole)
    np.testing.assert_array_equal(rows(1, 0.002, 0.3, 0.098, 0.2), whole)
    assert not np.array_equal(rows(2, 0.6), whole)


SHORT_RUN = """
import sys
import numpy as np
from gyro_calib.device import draw_unit, load_device
from gyro_calib.jit import COMPILED
from gyro_calib.recording.command import Command, Excitation
from gyro_calib.simulation import GyroSimulator
assert not COMPILED
rows = {}
for fidelity, duration in (("carrier", 0.01), ("slow_flow", 0.06)):
    simulator = GyroSimulator(draw_unit(load_device("ring_15k"), 3), rng=np.random.default_rng(4), fidelity=fidelity)
    first = simulator.advance(duration, 0.1)
    simulator.configure(Command("ftr_x", Excitation("amplitude_modulation", 1.5, 0.15)))
    rows[fidelity] = np.concatenate([first, simulator.advance(duration, 0.1)])
np.savez(sys.argv[1], **rows)
"""


@compiled_only
def test_compiled_kernels_do_what_their_source_says(tmp_path: Path) -> None:
    """The same short noisy run in a process without compilation gives the same rows, to rounding."""
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    subprocess.run([sys.executable, "-c", SHORT_RUN, str(tmp_path / "rows.npz")], env=environment, check=True, timeout=120)
    plain = np.load(tmp_path / "rows.npz")
    for fidelity, duration in (("carrier", 0.01), ("slow_flow", 0.06)):
        simulator = GyroSimulator(draw_unit(load_device("ring_15k"), 3), rng=np.random.default_rng(4), fidelity=fidelity)
        first = simulator.advance(duration, 0.1)
        simulator.configure(Command("ftr_x", Excitation("amplitude_modulation", 1.5, 0.15)))
        compiled = np.concatenate([first, simulator.advance(duration, 0.1)])
        assert plain[fidelity].shape == compiled.shape
        np.testing.assert_allclose(plain[fidelity], compiled, rtol=1e-13, atol=1e-14)


@compiled_only
def test_cache_of_a_kernel_follows_every_module_whose_constants_or_kernels_it_holds() -> None:
    found: dict[str, bytes] = {}
    _collect_sources("gyro_calib.simulation.slow_flow", found)
    wanted = ("simulation.slow_flow", "simulation.carrier", "simulation.control", "simulation.control_layout", "device.averaging", "jit")
    assert {f"gyro_calib.{name}" for name in wanted} <= set(found)
    assert all(source for source in found.values())
