"""What a temperature that only wanders can say: nothing; and what the corners of a ramp are."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from gyro_calib.device import draw_unit, load_device
from gyro_calib.experiments import SimulatedInstrument, run_plan
from gyro_calib.experiments.gap_plans import gap_ftr_plan
from gyro_calib.gap.model import look_at
from gyro_calib.gap.signals import held_readings, smooth_reading, smooth_temperature
from gyro_calib.gap.thermometer import said_sensor_late, sensor_late_s
from gyro_calib.recording.columns import COLUMNS, column_index
from gyro_calib.recording.command import Command, Setpoints
from gyro_calib.recording.recording import Recording
from gyro_calib.simulation import GyroSimulator

ROW_S = 0.01


def low_pass(x: np.ndarray, tau_s: float) -> np.ndarray:
    """First-order, settled before the first row."""
    if tau_s == 0.0:
        return x
    a = math.exp(-ROW_S / tau_s)
    return np.asarray(lfilter([0.5 - 0.5 * a, 0.5 - 0.5 * a], [1.0, -a], x, zi=[(0.5 + 0.5 * a) * x[0]])[0])


def ramp(*, follows: bool, heater_s: float = 0.0, sensor_s: float = 0.0, noise_k: float = 1e-3) -> tuple[Recording, np.ndarray]:
    """A temperature that rises by 4 K in 8 s and then holds, read with noise by a sensor with a lag."""
    t = ROW_S * np.arange(1200)
    true = low_pass(np.minimum(0.5 * t, 4.0), heater_s)
    rng = np.random.default_rng(0)
    rows = np.zeros((t.size, len(COLUMNS)))
    rows[:, 0], rows[:, 1], rows[:, 2] = t, 1.0, 1.0
    rows[:, column_index("ref_freq")] = 15000.0 - (0.4 * true if follows else 0.0)
    rows[:, column_index("temperature")] = 25.0 + low_pass(true, sensor_s) + noise_k * rng.standard_normal(t.size)
    return Recording("ring", rows, Command("ftr_x", setpoints=Setpoints(amplitude_v=1.0)), 1.0 / ROW_S, "r"), 25.0 + true


def test_a_reference_that_follows_the_resonance_gives_a_ramp_its_corner() -> None:
    recording, true = ramp(follows=True)
    fixed, _ = ramp(follows=False)
    corner = slice(760, 840)
    rounded, sharp = (np.abs(smooth_temperature(r) - true)[corner].max() for r in (fixed, recording))
    # a running mean over t rounds a corner of slope s by s t / 8
    assert rounded > 0.018
    assert sharp < 0.009
    assert np.abs(smooth_temperature(recording) - true)[100:700].max() < 2e-3


def test_a_sensor_that_lags_is_late_by_its_own_reading() -> None:
    """A reference tells of the resonator's own corners: they are not late."""
    recording, true = ramp(follows=True, heater_s=0.3, sensor_s=0.25, noise_k=1e-5)
    seen, reading = smooth_temperature(recording), smooth_reading(recording)
    inner = slice(60, -60)
    bend = np.gradient(np.gradient(seen, ROW_S), ROW_S)[inner]
    left = []
    for late_by in (reading, seen):
        missed = (seen + 0.25 * np.gradient(late_by, ROW_S) - true)[inner]
        # what smoothing rounds off is a nuisance of its own
        left.append(float(np.std(missed - bend * float(bend @ missed) / float(bend @ bend))))
    assert left[0] < 0.5e-3
    assert left[1] > 3.0 * left[0]


@pytest.mark.parametrize("follows", [True, False])
def test_a_temperature_ends_as_it_goes(follows: bool) -> None:
    """On its way at the one end, at rest at the other: a running mean that is mirrored there errs by 15 mK and more."""
    recording, true = ramp(follows=follows)
    wrong = np.abs(smooth_temperature(recording) - true)
    assert max(wrong[:40].max(), wrong[-40:].max()) < 2e-3


@pytest.mark.parametrize(("follows", "most_k"), [(True, 0.02), (False, 0.13)])
def test_a_sensor_that_is_read_once_a_second_makes_no_steps(follows: bool, most_k: float) -> None:
    """Each reading held until the next: of a ramp of 0.5 K/s it is late by up to half a kelvin, which no resonator is."""
    recording, true = ramp(follows=follows, noise_k=0.0)
    assert not len(held_readings(recording))
    read = np.concatenate([[0], np.arange(40, len(true), 100)])
    data = recording.data.copy()
    data[:, column_index("temperature")] = true[read[np.searchsorted(read, np.arange(len(true)), side="right") - 1]]
    held = replace(recording, data=data)
    assert set(read[1:10]) <= set(held_readings(held))
    assert np.abs(held.temperature_degc - true).max() > 0.45
    assert np.abs(smooth_temperature(held) - true)[60:-60].max() < most_k


def test_a_reference_that_follows_a_split_as_the_wave_turns_is_no_temperature() -> None:
    """Read once a second a wave of 4 s that a split makes would be left in the temperature by a quarter."""
    recording, true = ramp(follows=True, noise_k=0.0)
    t = recording.t - recording.t[0]
    psi = 0.5 * np.pi * t / 2.0
    data = recording.data.copy()
    for name, x in (("x_pick_c", np.cos(psi)), ("y_pick_c", np.sin(psi))):
        data[:, column_index(name)] = x
    data[:, column_index("ref_freq")] += 0.05 * np.cos(2.0 * psi + 0.4)
    read = np.concatenate([[0], np.arange(40, len(true), 100)])
    data[:, column_index("temperature")] = true[read[np.searchsorted(read, np.arange(len(true)), side="right") - 1]]
    turning = replace(recording, data=data, command=replace(recording.command, mode="whole_angle"))
    fixed = replace(turning, command=recording.command)
    missed, left = (np.abs(smooth_temperature(r) - true)[60:-60] for r in (fixed, turning))
    assert missed.max() > 0.03
    assert left.max() < 0.02
    assert np.median(left) < 0.1 * np.median(missed)


def test_a_sensor_that_is_late_is_said_and_a_resonator_that_is_later_is_not() -> None:
    (told,) = said_sensor_late(sensor_late_s({"thermal_lag.tau": -0.63}))
    assert told.startswith("The thermometer is 0.63 s later")
    for healthy in (-0.3, 0.1, 5.0):
        assert said_sensor_late(sensor_late_s({"thermal_lag.tau": healthy})) == []


@pytest.mark.slow
def test_without_a_temperature_run_its_effects_are_not_tried() -> None:
    device = draw_unit(load_device("ring_15k"), 5)
    device = replace(device, environment=replace(device.environment, wander_k=0.02))
    instrument = SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(3), fidelity="slow_flow"), 2e-5)
    campaign = run_plan(instrument, gap_ftr_plan(device.factory(), quality="quick"))
    f = campaign.factory
    model = look_at(list(campaign), math.pi * f["nominal_f0_hz"] / f["nominal_q"], f["angular_gain_kappa"])
    assert not [name for name in model.candidates if name.startswith("thermal_")]
    assert not [term.name for term, _ in model.bank if term.depends_on == "temperature"]
    # what a healthy device does with the kelvins that it has is allowed for all the same
    assert "thermal_damping.c" in {c.name for c in model.nuisances}
