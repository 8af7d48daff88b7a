"""What a pick-off that errs adds: by the flow as by its derivative, and wherever the resonance is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from gyro_calib.gap.cubic_forms import cube
from gyro_calib.gap.flow_left import rows_left
from gyro_calib.gap.forms import FORMS, behind
from gyro_calib.gap.parts import REST, SKEW, UNEQUAL, Linear, read_at_once, unexplained
from gyro_calib.gap.signals import Signals, with_pick
from gyro_calib.gap.warm_forms import _HALF_PER_K, _LATE_S
from gyro_calib.recording.columns import COLUMNS
from gyro_calib.recording.command import Command, Setpoints
from gyro_calib.recording.recording import Recording

ROW_S = 0.002
#: what a gradient does besides splitting
DAMPED = ("thermal_damping", "thermal_damping_anisotropy")
A = np.array([[-1.5 - 0.2j, 0.03 + 0.05j], [-0.02 + 0.04j, -1.4 + 0.3j]])
G = np.array([[-8.0j, 0.2 + 0.1j], [0.1j, -7.5j]])


def moving(detuning_rad_s: float) -> tuple[Signals, Linear]:
    """Two seconds of a driven motion that solves its flow, seen from a reference that is off the resonance."""
    t = ROW_S * np.arange(1000)
    rows = np.zeros((t.size, len(COLUMNS)))
    rows[:, 0], rows[:, 1], rows[:, 10], rows[:, 11] = t, 1.0, 15000.0, 25.0
    recording = Recording("ring", rows, Command("ftr_x", setpoints=Setpoints(amplitude_v=1.0)), 1.0 / ROW_S, "r")
    signals = Signals(recording, 2 * np.pi * 15000.0, 1.5, 1, 25.0, 0.0)

    def drive(time: float | np.ndarray) -> np.ndarray:
        return np.stack([0.2j * (1.0 + 0.3 * np.cos(3.0 * time)), 0.05 * np.sin(2.0 * time) + 0.0j * time], axis=-1)

    turned = A + 1j * detuning_rad_s * np.eye(2)
    solved = solve_ivp(
        lambda time, p: turned @ p + G @ drive(time), (0.0, t[-1]), np.array([1.0 + 0j, 0.1j]), t_eval=t, rtol=1e-10, atol=1e-12
    )
    signals = with_pick(signals, solved.y.T)
    signals.__dict__["drive"] = drive(t)
    return signals, Linear(A, G, np.zeros((2, 2), complex), 0.8, 0.0)


@pytest.mark.parametrize("detuning_rad_s", [0.0, 20.0])
@pytest.mark.parametrize("f", [cube, lambda v: 1j * v * np.array([1.0, 0.0]), lambda v: cube(v)[:, ::-1]])
def test_the_flow_says_how_fast_a_reading_changes(f: Callable[[np.ndarray], np.ndarray], detuning_rad_s: float) -> None:
    signals, linear = moving(detuning_rad_s)
    scale = 1.0 + 0.5 * np.sin(1.3 * signals.time_s)
    part = read_at_once("c", signals, linear, lambda v: scale[:, None] * f(v))
    assert part.speed is not None
    found = part.speed - linear.resting(signals, part.signal)
    # o' - A o with the detuning that a form by derivatives has to know
    expected = np.gradient(part.signal, ROW_S, axis=0, edge_order=2) - part.signal @ (A + 1j * detuning_rad_s * np.eye(2)).T
    np.testing.assert_allclose(found[3:-3], expected[3:-3], atol=1e-3 * max(1.0, detuning_rad_s))


@pytest.mark.parametrize("phase", [0.0, 0.7, 2.5])
def test_in_open_drive_the_other_axis_rubs_in_its_own_phase(phase: float) -> None:
    """A drive of x alone moves y a little by cross coupling, in any phase: all of the friction of y acts, along that motion."""
    signals, linear = moving(0.0)
    volts = np.stack(
        [np.exp(0.3j) * np.ones_like(signals.time_s), 2e-4 * np.exp(1j * (0.3 + phase)) * np.ones_like(signals.time_s)], axis=1
    )
    for mode in ("loops_off", "ftr_x"):
        open_ = Signals(replace(signals.recording, command=Command(mode)), 2 * np.pi * 15000.0, 1.5, 1, 25.0, 0.0)
        parts = FORMS["coulomb_friction"].parts(_without_drive(with_pick(open_, volts)), linear, {"axes": 1.0})
        found = np.stack([p.signal[:, 1] for p in parts if p.parameter.startswith(SKEW)], axis=1)
        rubbed = -volts[:, 1] / np.abs(volts[:, 1])
        told = np.linalg.lstsq(np.concatenate([found.real, found.imag]), np.concatenate([rubbed.real, rubbed.imag]), rcond=None)[0]
        assert (np.abs(found @ told - rubbed).max() < 1e-6) == (mode == "loops_off" or phase == 0.0)


@pytest.mark.parametrize(("name", "factor"), [("duffing", 1j), ("nonlinear_damping", -1.0)])
@pytest.mark.parametrize("skew", [2e-3, 2e-3j])
def test_a_cube_of_each_axis_is_read_as_pickoffs_that_are_not_square_do(name: str, factor: complex, skew: complex) -> None:
    """What the axes do is reckoned in their own motion, P^-1 p, and read by P: all but its square in the skew is in the columns."""
    signals, linear = moving(0.0)
    sizes = np.array([0.7, 1.3])
    P = np.eye(2) + 0.5 * skew * np.array([[0.0, 1.0], [1.0, 0.0]])
    read = factor * (sizes * cube(signals.pick @ np.linalg.inv(P).T)) @ P.T - factor * sizes * cube(signals.pick)
    parts = {p.parameter: p.signal for p in FORMS[name].parts(signals, linear, {"axes": 1.0})}
    of = {2e-3: "mixed", 2e-3j: "late"}[skew]
    told = sum(size * abs(skew) * parts[f"{SKEW}_{of}_{axis}"] for size, axis in zip(sizes, "xy", strict=True))
    assert np.abs(read).max() > 1e-4
    np.testing.assert_allclose(told, read, atol=3.0 * abs(skew) * np.abs(read).max())
    letters = {p[0] for p in parts if not p.startswith(SKEW)}
    assert len(letters) == 1


@pytest.mark.parametrize("skew", [2e-4, -1e-3])
def test_an_axis_at_rest_rubs_as_its_pickoffs_are_not_square(skew: float) -> None:
    """Held along x as read, the motion has a little of y: of dry friction by axis that is all, against or with the wave."""
    signals, linear = moving(0.0)
    azimuth = 0.4 * signals.time_s
    for angle, at_rest in ((np.zeros_like(azimuth), True), (0.6 + azimuth, False)):
        volts = np.stack([np.cos(angle), np.sin(angle)], axis=1) * np.exp(0.3j)
        motion = np.stack([volts[:, 0], volts[:, 1] - skew * volts[:, 0]], axis=1)
        found = {
            p.parameter: p.signal for p in FORMS["coulomb_friction"].parts(_without_drive(with_pick(signals, volts)), linear, {"axes": 1.0})
        }
        rest = -np.sign(skew) * UNEQUAL
        told = found["c_x"] + found["c_y"] + rest * found[f"{SKEW}_rest_y"]
        np.testing.assert_allclose(told, -motion / np.abs(motion), atol=2e-2)
        assert (np.abs(found[f"{SKEW}_rest_y"][:, 1]).max() * UNEQUAL > 0.9) == at_rest


def _without_drive(signals: Signals) -> Signals:
    signals.__dict__["drive"] = np.zeros_like(signals.pick)
    return signals


def test_a_stiffness_of_the_drives_may_meet_the_motion_late() -> None:
    """``u^2 x`` at the carrier, the volts turned by one angle and the motion by another: all of it is in the parts to first order."""
    signals, linear = moving(0.0)
    turned_rad, late_rad = 0.03, 0.05
    parts = {p.parameter: p.signal for p in FORMS["drive_stiffness"].parts(signals, linear, {"axes": 0.0})}
    u, p = signals.drive * np.exp(1j * turned_rad), signals.pick
    met = p * np.exp(-1j * late_rad)
    whole = 1j * (2.0 * np.abs(u) ** 2 * met + u**2 * met.conj())
    for axis, name in enumerate("xy"):
        made = parts[f"k_{name}"] + UNEQUAL / 0.2 * (turned_rad * parts[f"{SKEW}_held_{name}"] + late_rad * parts[f"{SKEW}_met_{name}"])
        second = 4.0 * (turned_rad + late_rad) ** 2 * np.abs(u[:, axis]) ** 2 * np.abs(p[:, axis])
        assert np.all(np.abs(made[:, axis] - whole[:, axis]) <= second + 1e-12)
        assert np.abs(parts[f"k_{name}"][:, axis] - whole[:, axis]).max() > 5.0 * second.max()


def test_a_gradient_of_temperature_damps_as_well_alike_and_unequally() -> None:
    signals, linear = moving(0.0)
    signals.__dict__["temperature_k"] = 0.5 * signals.time_s
    setting = {"tau": 0.4}
    split = {p.parameter: p.signal for p in FORMS["thermal_split_lag"].parts(signals, linear, setting)}
    signals.__dict__["temperature_k"] = behind(signals, 0.4).real[:, 0]
    damped = {p.parameter: p.signal for name in DAMPED for p in FORMS[name].parts(signals, linear, {})}
    for beside, alone in ((f"{REST}_damped", "c"), (f"{SKEW}_damped_c", "c_c"), (f"{SKEW}_damped_s", "c_s")):
        beside, alone = split[beside], damped[alone]
        np.testing.assert_allclose(beside, -0.3 / UNEQUAL * alone)
        assert np.abs(alone).max() > 0.0


def test_what_is_charged_drives_and_reads_otherwise_as_well() -> None:
    """As the split comes, for V0 is in the stiffness twice and in the force once; of the electrodes of either axis, or of both.

    Two plants charged those of x alone: beside the charge a drive's gain drifted, 311 in chi-square of one.
    """
    signals, linear = moving(0.0)
    parts = {p.parameter: p for p in FORMS["charge_accumulation"].parts(signals, linear, {"tau": 0.7})}
    rise = (1.0 - np.exp(-signals.time_s / 0.7))[:, None]
    driven = [parts[f"{SKEW}_gain_{a}"] for a in "xy"]
    assert {part.kind for part in driven} == {"drive"}
    for part, axis in zip(driven, np.eye(2), strict=True):
        np.testing.assert_allclose(part.signal, 3.0 / UNEQUAL * rise * signals.drive * axis)
    for a, axis in zip("xy", np.eye(2), strict=True):
        read = read_at_once("", signals, linear, lambda v, axis=axis: 3.0 / UNEQUAL * rise * v * axis)  # type: ignore[misc]
        np.testing.assert_allclose(parts[f"{SKEW}_read_{a}"].signal, read.signal)
        assert parts[f"{SKEW}_read_{a}"].kind == read.kind


def test_what_feeds_through_by_warmth_has_a_phase_and_goes_across() -> None:
    signals, linear = moving(0.0)
    signals.__dict__["temperature_k"] = 0.5 * signals.time_s
    parts = {p.parameter: p.signal for p in FORMS["thermal_feedthrough"].parts(signals, linear, {})}
    fed = signals.temperature_k[:, None] * signals.drive
    np.testing.assert_allclose(parts["e_x"] + parts["e_y"], fed)
    np.testing.assert_allclose(UNEQUAL * (parts[f"{SKEW}_late_x"] + parts[f"{SKEW}_late_y"]), 1j * fed)
    np.testing.assert_allclose(UNEQUAL * (parts[f"{SKEW}_across_xc"] + parts[f"{SKEW}_across_yc"]), 0.3 * fed[:, ::-1])
    np.testing.assert_allclose(parts[f"{SKEW}_across_xs"], 1j * parts[f"{SKEW}_across_xc"])


def warming(duration_k: float) -> tuple[Signals, Linear]:
    """That motion while it warms steadily, by so much."""
    signals, linear = moving(0.0)
    signals.__dict__["temperature_k"] = duration_k * signals.time_s / signals.time_s[-1]
    return signals, linear


@pytest.mark.parametrize("name", ["thermal_drive_phase", "thermal_pickoff_phase"])
def test_a_phase_by_the_temperature_turns_and_leaves_no_gain_by_its_square(name: str) -> None:
    signals, linear = warming(10.0)
    x = signals.drive if "drive" in name else signals.pick
    parts = {p.parameter: p.signal for p in FORMS[name].parts(signals, linear, {})}
    sizes = {"x": 4e-4, "y": -6e-4}
    first = sum(g * parts[f"g_{n}"] for n, g in sizes.items())
    shorter = sum(0.5 * g**2 * UNEQUAL / _HALF_PER_K * parts[f"{SKEW}_shorter_{n}"] for n, g in sizes.items())
    exact = (np.exp(1j * signals.temperature_k[:, None] * np.array(list(sizes.values()))) - 1.0) * x
    assert np.abs(first - exact).max() > 1e-6 * np.abs(x).max()
    assert np.abs(first + shorter - exact).max() < 5e-3 * np.abs(first - exact).max()


def test_a_damping_that_bends_does_so_before_a_thermometer_that_is_late() -> None:
    signals, linear = warming(10.0)
    late_s = 0.015
    (bent, late) = FORMS["thermal_damping_curvature"].parts(signals, linear, {})
    assert (bent.parameter, late.parameter) == ("c", f"{SKEW}_late")
    # what bends follows the resonator, which is warmer by then
    warmer = ((signals.temperature_k + 5.0 * late_s) / np.maximum(signals.temperature_k, 1e-9)) ** 2
    exact = warmer[:, None] * bent.signal
    found = bent.signal - UNEQUAL * late_s / _LATE_S * late.signal
    inner = slice(50, -50)
    assert np.abs(found - exact)[inner].max() < 0.05 * np.abs(bent.signal - exact)[inner].max()


def test_a_drive_that_runs_against_its_limit_kicks_nothing() -> None:
    """Its corner lies between rows; a difference of rows to both sides holds the mean of what the drive does there, not its middle."""
    row_s, t = 0.01, 0.01 * np.arange(400)
    rows = np.zeros((t.size, len(COLUMNS)))
    rows[:, 0], rows[:, 1], rows[:, 10], rows[:, 11] = t, 1.0, 15000.0, 25.0
    recording = Recording("ring", rows, Command("whole_angle", setpoints=Setpoints(amplitude_v=1.0)), 1.0 / row_s, "r")
    signals = Signals(recording, 2 * np.pi * 15000.0, 1.5, 1, 25.0, 0.0)

    def drive(time: float | np.ndarray) -> np.ndarray:
        falling = np.maximum(np.asarray(time) - 2.0, 0.0)
        return np.stack([0.05j + 0.0j * falling, 0.3j * np.exp(-falling / 0.05)], axis=-1)

    solved = solve_ivp(lambda time, p: A @ p + G @ drive(time), (0.0, t[-1]), np.array([1.0 + 0j, 0.1j]), t_eval=t, rtol=1e-11, atol=1e-13)
    signals = with_pick(signals, solved.y.T)
    signals.__dict__["drive"] = drive(t)
    linear = Linear(A, G, np.zeros((2, 2), complex), 0.8, 0.0)
    azimuth, along, across = rows_left(signals, linear)
    assert np.ptp(azimuth) > 0.1
    plain = unexplained(signals, linear)
    # a kick is a step of the sum
    kicked, before = (
        np.abs(np.cumsum(x[150:250], axis=0)).max() * row_s
        for x in (np.stack([along, across], axis=1), plain / np.abs(signals.pick[:, :1]))
    )
    assert kicked < 0.1 * before
