"""Gains that flicker and a reference that swings: at the carrier, and as findings that stand beside the slow flow."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from effect_samples import DRIVE_HZ, compiled_only, plain_device
from spectra_samples import LINEAR, records

from gyro_calib.device import Device
from gyro_calib.gap.flicker_effects import with_flickers
from gyro_calib.gap.flickers import DRIVE_FLICKERS, PICKOFF_FLICKERS, drive_flicker, pickoff_flicker
from gyro_calib.gap.noise_law import NoiseLaw
from gyro_calib.gap.reference_spur import phase_swing
from gyro_calib.gap.spectral_effects import spectral_effects
from gyro_calib.recording.columns import column_index
from gyro_calib.recording.command import Command, Excitation
from gyro_calib.recording.recording import Recording
from gyro_calib.simulation import GyroSimulator


class Evidence(list[Any]):
    """Recordings of both axes, the nominal decay, no phase that flickers."""

    decay_rate = 1.5
    phase_floors = (0.0, 0.0)


EVIDENCE: Any = Evidence(SimpleNamespace(role=f"ftr_{axis}", mean_square=1.0) for axis in "xy" for _ in range(4))


def quiet(effects: dict[str, dict[str, float]]) -> Device:
    plain = plain_device()
    return replace(
        plain, noise=replace(plain.noise, pickoff_v_rthz=0.0, drive_v_rthz=0.0, thermomechanical=False),
        environment=replace(plain.environment, wander_k=0.0), effects=effects,
    )  # fmt: skip


def density_at(x: np.ndarray, row_s: float, low_hz: float, high_hz: float) -> float:
    """Mean of f times the one-sided density between two frequencies, its root: the density at 1 Hz of a 1/f noise."""
    x = x - np.polyval(np.polyfit(np.arange(x.size), x, 1), np.arange(x.size))
    window = np.hanning(x.size)
    f = np.fft.rfftfreq(x.size, row_s)
    power = 2.0 * row_s * np.abs(np.fft.rfft(x * window)) ** 2 / np.sum(window**2)
    inside = (f > low_hz) & (f < high_hz)
    return math.sqrt(float(np.mean(f[inside] * power[inside])))


@compiled_only
def test_gain_noise_grows_with_the_amplitude_and_is_in_phase_with_it() -> None:
    """Open drive: the reading's in-phase scatter is ``s |V| sqrt(bandwidth)``, its quadrature is quiet."""
    s = 1e-5
    simulator = GyroSimulator(quiet({"amplitude_noise": {"s": s}}), rng=np.random.default_rng(1))
    simulator.configure(Command("loops_off", Excitation("drive", DRIVE_HZ, 0.0, 2.0, "x")))
    simulator.advance(2.0)
    rows = simulator.advance(8.0)
    volts = (rows[:, 2] + 1j * rows[:, 3]) / complex(rows[:, 2].mean(), rows[:, 3].mean())
    length = 10  # rows: means over 20 ms
    means = volts.reshape(-1, length).mean(axis=1)
    expected = s * math.sqrt(0.5 / (length / 500.0))
    assert means.real.std() == pytest.approx(expected, rel=4.0 / math.sqrt(2.0 * means.size))
    assert means.imag.std() < 0.05 * expected


@compiled_only
@pytest.mark.parametrize(("effect", "letter"), [("pickoff_gain_flicker", "g"), ("pickoff_phase_flicker", "p")])
def test_gains_and_phases_of_pickoffs_flicker_in_proportion_to_what_they_read(effect: str, letter: str) -> None:
    """Open drive, which no loop answers: each axis has its own density; gains are in phase with their signal, phases across it."""
    sizes = {f"{letter}_x": 2e-4, f"{letter}_y": 5e-5}
    simulator = GyroSimulator(quiet({effect: sizes}), rng=np.random.default_rng(1))
    for axis, (size, column) in zip("xy", zip(sizes.values(), (2, 4), strict=True), strict=True):
        simulator.configure(Command("loops_off", Excitation("drive", DRIVE_HZ, 0.0, 2.0, axis)))
        simulator.advance(2.0)
        rows = simulator.advance(60.0)
        volts = rows[:, column] + 1j * rows[:, column + 1]
        relative = volts / volts.mean()
        moved, still = (relative.real, relative.imag) if letter == "g" else (relative.imag, relative.real)
        assert density_at(moved, 1.0 / 500.0, 0.3, 30.0) == pytest.approx(size, rel=0.15)
        assert np.std(still) < 0.1 * np.std(moved)


@compiled_only
def test_gains_of_drives_flicker_in_what_they_make() -> None:
    """In closed loop the command answers a drive's gain below the loop's bandwidth: it is less by what the gain is more."""
    size = 1e-3
    simulator = GyroSimulator(quiet({"drive_gain_flicker": {"g_x": size, "g_y": size}}), rng=np.random.default_rng(2))
    simulator.configure(Command("ftr_x"))
    simulator.advance(4.0)
    rows = simulator.advance(60.0)
    drive = rows[:, 6] + 1j * rows[:, 7]
    relative = (drive / drive.mean()).real
    # a loop of 20 Hz or more answers all of it below 2 Hz
    assert density_at(relative, 1.0 / 500.0, 0.1, 1.0) == pytest.approx(size, rel=0.3)


@compiled_only
def test_swing_of_the_reference_is_read_off_phase_and_frequency() -> None:
    """The loop follows what it sees and its frequency says so; what both leave is the swing."""
    truth = {"frequency_hz": 9.3, "s": 3e-5}
    simulator = GyroSimulator(quiet({"reference_spur": truth}), rng=np.random.default_rng(3))
    simulator.configure(Command("ftr_x"))
    simulator.advance(4.0)
    rows = simulator.advance(10.0)
    recording = Recording("ring", rows, Command("ftr_x"), 500.0, "static")
    linear = replace(LINEAR, A=plain_device().slow_flow().A)
    found = phase_swing([recording], linear, truth["frequency_hz"])
    assert found is not None
    assert found[0] == pytest.approx(truth["s"], rel=0.03)


def swinging(s: float, hz: float, *, told: bool = False) -> list[Recording]:
    """Held waves of three amplitudes whose reference swings; ``told``: and whose frequency column says so."""
    made = []
    for r in records(np.random.default_rng(4)):
        data = r.data.copy()
        turn = np.exp(1j * s * np.sin(2.0 * np.pi * hz * data[:, 0]))
        for column in (2, 4):
            turned = (data[:, column] + 1j * data[:, column + 1]) * turn
            data[:, column], data[:, column + 1] = turned.real, turned.imag
        if told:
            data[:, column_index("ref_freq")] -= s * hz * np.cos(2.0 * np.pi * hz * data[:, 0])
        made.append(replace(r, data=data))
    return made


@pytest.mark.parametrize(("size", "hz"), [(2e-5, 31.0), (4e-6, 17.0)])
def test_a_spur_of_the_loop_that_its_frequency_tells_is_no_hum(size: float, hz: float) -> None:
    """The motion follows the reference: nothing is added to the pick-offs, and the slow flow holds on the line."""
    found = spectral_effects(swinging(size, hz, told=True), LINEAR)
    assert [e.name for e in found.effects] == ["reference_spur"]
    assert found.effects[0].group == ("reference_spur",)
    told = found.effects[0].parameters["s"]
    assert abs(told.value - size) < 3.0 * told.sd
    left_out = spectral_effects(swinging(size, hz, told=True), LINEAR, ("reference_spur",))
    assert not left_out.effects
    assert left_out.unknown is not None
    assert left_out.unknown.phase == "in quadrature"


def test_a_phase_that_swings_is_the_reference_and_a_gain_that_swings_is_not() -> None:
    found = spectral_effects(swinging(2e-5, 31.0), LINEAR)
    assert [e.name for e in found.effects] == ["reference_spur"]
    assert found.unknown is None
    size = found.effects[0].parameters["s"]
    assert abs(size.value - 2e-5) < 3.0 * size.sd
    assert found.effects[0].parameters["frequency_hz"].value == pytest.approx(31.0, abs=0.05)
    left_out = spectral_effects(swinging(2e-5, 31.0), LINEAR, ("reference_spur",))
    assert not left_out.effects
    assert left_out.unknown is not None
    assert left_out.unknown.phase == "in quadrature"
    gain = spectral_effects(records(np.random.default_rng(4), ripple=(31.0, 2e-5)), LINEAR)
    assert [e.name for e in gain.effects] == []
    assert gain.unknown is not None
    assert gain.unknown.phase == "in phase"


def laws(pick: tuple[float, float] = (0.0, 0.0), along: float = 1e-10, across: float = 1e-10) -> dict[tuple[str, str], NoiseLaw]:
    """Of both axes: floors of the pick-offs' gains [1/sqrt(Hz)], densities along and across the wave [V^2/s]."""
    out = {}
    for axis in "xy":
        out[f"ftr_{axis}", "amplitude"] = NoiseLaw((along, 0.0, 0.0, 0.0), floors=(pick[0] ** 2, pick[1] ** 2))
        out[f"ftr_{axis}", "precession"] = NoiseLaw((across, 0.0, 0.0, 0.0), floors=(pick[0] ** 2, pick[1] ** 2))
    return out


def test_a_floor_that_healthy_pickoffs_have_is_no_finding() -> None:
    assert pickoff_flicker(laws((3.7e-6, 0.5 * PICKOFF_FLICKERS))) == (0.0, 0.0)
    x, y = pickoff_flicker(laws((0.0, 5e-5)))
    assert (x, y) == (0.0, pytest.approx(5e-5))


def test_a_drive_flickers_where_the_wave_is_shaken_along_itself_alone() -> None:
    decay = -float(LINEAR.A[0, 0].real)
    size = 2.0 * DRIVE_FLICKERS
    along = 0.5 * (size * decay) ** 2
    assert drive_flicker(EVIDENCE, LINEAR, laws(along=along, across=1e-3 * along)) == (pytest.approx(size, rel=1e-3),) * 2
    # thermal noise shakes both ways, and a pick-off's floor moves the amplitude as well
    assert drive_flicker(EVIDENCE, LINEAR, laws(along=along, across=0.3 * along)) == (0.0, 0.0)
    assert drive_flicker(EVIDENCE, LINEAR, laws((0.0, size), along, 1e-3 * along)) == (0.0, 0.0)
    # of two recordings neither the damping nor the noise is known
    few: Any = Evidence(EVIDENCE[::4])
    assert drive_flicker(few, LINEAR, laws(along=along, across=1e-3 * along)) == (0.0, 0.0)


def test_gains_that_flicker_stand_for_the_noise_that_grows_with_the_wave() -> None:
    recordings = records(np.random.default_rng(5), gain=3e-6)
    beside = spectral_effects(recordings, LINEAR)
    assert [e.name for e in beside.effects] == ["amplitude_noise"]
    healthy = with_flickers(beside, EVIDENCE, LINEAR, laws())
    assert [e.name for e in healthy.effects] == ["amplitude_noise"]
    assert {s.status for s in healthy.standings if s.name.endswith("gain_flicker")} == {"excluded"}
    few: Any = Evidence(EVIDENCE[::4])
    status = {s.name: s.status for s in with_flickers(beside, few, LINEAR, laws()).standings}
    assert (status["pickoff_gain_flicker"], status["drive_gain_flicker"]) == ("excluded", "not testable")
    found = with_flickers(beside, EVIDENCE, LINEAR, laws((6e-5, 0.0)))
    assert [e.name for e in found.effects] == ["pickoff_gain_flicker"]
    assert found.effects[0].parameters["g_x"].value == pytest.approx(6e-5)
    assert found.products > healthy.products
    status = {s.name: s.status for s in found.standings}
    assert (status["pickoff_gain_flicker"], status["amplitude_noise"]) == ("present", "excluded")
    flickers = ("pickoff_gain_flicker", "drive_gain_flicker", "pickoff_phase_flicker")
    left_out = with_flickers(beside, EVIDENCE, LINEAR, laws((6e-5, 0.0)), flickers)
    assert left_out == beside
