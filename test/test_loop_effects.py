"""Loops that hold what is not their set point, and drives that follow the wave too late: simulated, against the steady state, and found."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from wave_samples import HARDWARE_ERRORS, amplitude, design_gain, in_wave_frame, low_q_hrg, simulate, whole_angle

from gyro_calib.device import Device, draw_unit, load_device
from gyro_calib.estimation.wave import wave_coordinates
from gyro_calib.experiments import SimulatedInstrument
from gyro_calib.gap.loop_effects import LoopEffects, loop_effects
from gyro_calib.recording.command import Command, Excitation, Setpoints
from gyro_calib.recording.recording import Recording
from gyro_calib.simulation.truth import operating_point, truth_of, wave_points

FIDELITIES = ("slow_flow", "carrier")
HELD = {"a": 2e-3, "q": -4e-3, "psi": 1.5e-3}


def ring(**sizes: float) -> Device:
    device = draw_unit(load_device("ring_15k"), 3)
    resonator = replace(device.resonator, quality_factor=3000.0, frequency_split_hz=3.0)
    return replace(device, resonator=resonator, effects={"loop_error": sizes} if sizes else {})


def sphere(**effects: dict[str, float]) -> Device:
    return replace(low_q_hrg(**HARDWARE_ERRORS), effects=effects)


def records(device: Device, commands: Sequence[Command], length_s: float, fidelity: str = "slow_flow", **options: Any) -> list[Recording]:
    instrument = SimulatedInstrument(simulate(device, fidelity, **options), 0.0)
    found = []
    for command in commands:
        instrument.configure(command)
        found.append(instrument.record(length_s, settle_s=2.5))
    return found


def turning(speed_deg_s: float, device: Device) -> Command:
    return whole_angle(virtual_precession_v=math.radians(speed_deg_s) / (0.5 * design_gain(device)))


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_force_to_rebalance_holds_the_wave_where_it_errs_to(fidelity: str, axis: str) -> None:
    device = ring(**HELD)
    command = Command(f"ftr_{axis}")
    sim = simulate(device, fidelity)
    sim.configure(command)
    sim.advance(2.0)
    rows = sim.advance(0.2)
    x, y = (rows[:, k] + 1j * rows[:, k + 1] for k in (2, 4))
    held, closed = (x, y) if axis == "x" else (y, -x)
    assert held.mean() == pytest.approx(1.0 + HELD["a"], abs=1e-7)
    assert closed.mean() / held.mean() == pytest.approx(complex(HELD["psi"], -HELD["q"]), abs=1e-7)
    # which takes another rebalance drive, by the split and the damping: the hidden truth says so
    found = rows[:, 9 if axis == "x" else 7].mean()
    point = operating_point(device, command, 0.0)
    assert found == pytest.approx(point.rate_channel_v, abs=2e-6)
    assert abs(found - operating_point(ring(), command, 0.0).rate_channel_v) > 5e-4


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_a_late_wave_of_held_quadrature_drifts_as_the_steady_state_says(fidelity: str) -> None:
    device = sphere(loop_error={"a": 2e-3, "q": 4e-3}, angle_latency={"tau": 2e-3})
    command = turning(6.0, device)
    sim = simulate(device, fidelity)
    sim.configure(command)
    sim.advance(3.0)
    wave = in_wave_frame(sim.advance(16.0))
    points = wave_points(device, command, azimuths=128)
    theta = math.pi * np.arange(len(points)) / len(points)
    place = np.interp(np.mod(wave.middle, math.pi), [*theta, math.pi], [p.theta_rate_rad_s for p in (*points, points[0])])
    assert np.ptp(place) > 1e-3
    np.testing.assert_allclose(wave.rate, place, atol=6e-6)
    shown = sim.advance(4.0)
    assert amplitude(shown).mean() == pytest.approx(1.0 + 2e-3, rel=2e-5)
    prompt = wave_points(sphere(), command)
    change = np.mean([p.theta_rate_rad_s for p in points]) / np.mean([p.theta_rate_rad_s for p in prompt]) - 1.0
    # a larger wave turns more slowly, a late one by the share tau of the damping too
    assert change == pytest.approx(-2e-3 - 2e-3 * device.resonator.decay_rate(), abs=2e-5)


def test_truth_of_a_late_gyro_is_that_of_the_latency() -> None:
    late, prompt = (truth_of(d, Command("whole_angle"), 0.1) for d in (sphere(angle_latency={"tau": 5e-3}), sphere()))
    decay = sphere().resonator.decay_rate()
    assert late.scale_factor / prompt.scale_factor - 1.0 == pytest.approx(-5e-3 * decay, rel=0.01)
    assert sphere(angle_latency={"tau": 5e-3}).factory()["loop_latency_s"] == sphere().loop_latency_s


def _by_name(found: LoopEffects) -> dict[str, Any]:
    return {e.name: e.parameters for e in found.effects}


def _status(found: LoopEffects) -> dict[str, str]:
    return {s.name: s.status for s in found.standings}


def test_what_rebalance_holds_is_found() -> None:
    side = Excitation("amplitude_modulation", 1.0, 0.3)
    commands = [Command("ftr_x"), Command("ftr_y"), Command("ftr_x", side), Command("ftr_y", setpoints=Setpoints(amplitude_v=0.6))]
    healthy = loop_effects(records(ring(), commands, 5.0, noisy=True), {})
    assert not healthy.effects
    assert _status(healthy) == {"loop_error": "excluded", "angle_latency": "not testable"}
    recordings = records(ring(**HELD), commands, 5.0, noisy=True)
    (found,) = _by_name(loop_effects(recordings, {})).values()
    for name, size in HELD.items():
        assert abs(found[name].value - size) < 4.0 * found[name].sd + 2e-6, name
    assert found["q"].sd < 1e-5
    assert not loop_effects(recordings, {}, ("loop_error",)).effects
    # drives at the end of their range hold nothing: what they miss is no error of the loops
    assert _status(loop_effects(recordings, {"dac_full_scale_V": 1e-3}))["loop_error"] == "not testable"


def _columns_scaled(recordings: Sequence[Recording], scale: float) -> list[Recording]:
    return [replace(r, data=r.data * np.where(np.isin(np.arange(12), (2, 3, 4, 5)), 1.0 + scale, 1.0)) for r in recordings]


@pytest.mark.parametrize("scale", [1.05e-3, -6e-4])
def test_columns_of_another_scale_than_the_loops_reading_are_no_error_of_the_loops(scale: float) -> None:
    """A filter before the demodulators of a thirtieth plant: every healthy unit had an error of its loops."""
    commands = [Command("ftr_x"), Command("ftr_y"), Command("ftr_x", setpoints=Setpoints(amplitude_v=0.6))]
    cold = records(ring(), commands, 5.0, noisy=True)
    warm = [replace(r, data=r.data + 8.0 * (np.arange(12) == 11)) for r in cold]
    found = loop_effects(_columns_scaled([*cold, *warm], scale), {})
    assert not found.effects
    assert _status(found)["loop_error"] == "excluded"
    assert f"{1.0 + scale:.6f}"[:6] in found.warnings[0]
    # too little, and no warm record to tell a loop without an integrator from: its error stays one
    assert bool(loop_effects(_columns_scaled(cold, scale), {}).effects) is (scale < 0.0)
    # and so does one that goes with the damping, or with the axis
    gone = [*_columns_scaled(cold, scale), *_columns_scaled(warm, 1.02 * scale)]
    (error,) = loop_effects(gone, {}).effects
    assert error.parameters["a"].value == pytest.approx(scale, rel=0.03)
    assert not loop_effects(cold, {}).warnings


@pytest.mark.parametrize(("size", "counts"), [(5e-5, False), (1.2e-4, True)])
def test_zeros_of_demodulators_and_set_points_are_no_error_of_the_loops(size: float, counts: bool) -> None:
    """Three healthy hemispheres of a twenty-ninth plant held up to 5e-5."""
    found = loop_effects(records(ring(q=size, psi=-size), [Command("ftr_x"), Command("ftr_y")], 5.0, noisy=True), {})
    assert bool(found.effects) is counts
    limits = [s.excluded_above.value for s in found.standings if s.excluded_above is not None]
    assert limits == ([] if counts else [pytest.approx(9e-5)])


def test_an_amplitude_that_errs_beside_another_error_is_the_loops() -> None:
    recordings = records(ring(a=1e-3, q=5e-4), [Command("ftr_x"), Command("ftr_y")], 5.0, noisy=True)
    (found,) = loop_effects(recordings, {}).effects
    assert found.parameters["a"].value == pytest.approx(1e-3, rel=0.02)


def test_a_control_of_five_periods_is_late_only_where_the_factory_says_less() -> None:
    """Overlapping windows, periods of computing, a pole of the amplifier: hemispheres of two plants by other hands had 2.2 to 5.6."""
    plain = sphere()
    rate = plain.electronics.control_rate_hz
    device = sphere(angle_latency={"tau": 5.5 / rate - plain.loop_latency_s})
    recordings = records(device, [turning(speed, device) for speed in (6.0, -6.0, 9.0)], 20.0, noisy=True)
    assert not loop_effects(recordings, {"control_rate_hz": rate}).effects
    assert [e.name for e in loop_effects(recordings, {"loop_latency_s": plain.loop_latency_s}).effects] == ["angle_latency"]


def test_what_a_free_wave_holds_and_how_late_it_is_are_found() -> None:
    tau = 4e-3
    device = sphere(loop_error={"a": -1e-3, "q": 5e-4}, angle_latency={"tau": tau})
    commands = [turning(speed, device) for speed in (6.0, -6.0, 9.0)]
    healthy = records(sphere(), commands, 20.0, noisy=True)
    stated = {"loop_latency_s": device.loop_latency_s}
    for factory in (stated, {"control_rate_hz": device.electronics.control_rate_hz}):
        found = loop_effects(healthy, factory)
        assert not found.effects
        assert set(_status(found).values()) == {"excluded"}
    recordings = records(device, commands, 20.0, noisy=True)
    assert wave_coordinates(recordings[0]).quadrature_v.mean() == pytest.approx(5e-4, rel=0.05)
    found = _by_name(loop_effects(recordings, stated))
    assert found["angle_latency"]["tau"].value == pytest.approx(tau, abs=4.0 * found["angle_latency"]["tau"].sd)
    assert found["angle_latency"]["tau"].sd < 0.03 * tau
    assert found["loop_error"]["q"].value == pytest.approx(5e-4, abs=4.0 * found["loop_error"]["q"].sd)
    assert found["loop_error"]["a"].value == pytest.approx(-1e-3, abs=4.0 * found["loop_error"]["a"].sd)
    # without a word of the control nobody knows what is late
    bare = [replace(r, extras={}) for r in recordings]
    for nothing in ({}, {"loop_latency_s": None, "control_rate_hz": 0.0, "dac_full_scale_V": "5 V"}):
        assert _status(loop_effects(bare, nothing)) == {"loop_error": "present", "angle_latency": "not testable"}
