"""Every effect of the registry at the carrier against its closed form in envelopes, as the catalogue states it.

The carrier's rows give ``p' - (A - i dw) p - G u``, with those of the device without it; no kernel and no envelope is asked for the forms.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from effect_samples import (
    DRIVE_HZ,
    MODULATED,
    OPEN,
    RATE,
    TURN,
    WARM_K,
    ComplexArray,
    Form,
    Rows,
    across_gap,
    assert_form,
    by_axis,
    clipped,
    compiled_only,
    coupled,
    cubes,
    fed,
    isotropic,
    losses,
    measured,
    of_late_y,
    plain_device,
    pumps,
    slope,
    slow,
    split,
    turned_cubes,
)

from gyro_calib.device import Device
from gyro_calib.effects import EFFECTS
from gyro_calib.recording.command import Command, Excitation, Setpoints
from gyro_calib.simulation import GyroSimulator


@pytest.fixture(scope="module")
def plain() -> Device:
    return plain_device()


# ---------------------------------------------------------------- at once: dynamics, drive, pick-off

#: effect -> sizes, form
STATIC: dict[str, tuple[dict[str, float], Form]] = {
    "duffing": ({"k": 0.5}, lambda r: 1j * r.size["k"] * isotropic(r.p)),
    "duffing_axes": ({"k_x": 0.5, "k_y": -0.3}, lambda r: 1j * by_axis(r, "k_x", "k_y") * cubes(r.p)),
    "circulatory_stiffness": ({"k": 0.3}, lambda r: 1j * r.size["k"] * (r.p @ TURN.T)),
    "cubic_cross_stiffness_axes": ({"k_x": 0.5, "k_y": -0.3}, coupled),
    "cubic_cross_stiffness": ({"k": 0.5}, lambda r: 1j * r.size["k"] * cubes(r.p)[:, ::-1]),
    "nonlinear_damping": ({"c": 0.5}, lambda r: -r.size["c"] * isotropic(r.p)),
    "nonlinear_damping_axes": ({"c_x": 0.5, "c_y": 0.8, "c_xy": 0.2, "c_yx": -0.1, "c_xxyy": 0.3}, turned_cubes),
    "coulomb_friction_axes": ({"c_x": 0.3, "c_y": 0.5}, lambda r: -by_axis(r, "c_x", "c_y") * r.p / np.abs(r.p)),
    "parametric_pump": ({"h_c": 0.3, "h_s": 0.5}, lambda r: complex(r.size["h_c"], r.size["h_s"]) * r.p.conj()),
    "parametric_pump_axes": ({"h_xc": 0.3, "h_xs": 0.5, "h_yc": -0.2, "h_ys": 0.4}, lambda r: pumps(r) * r.p.conj()),
    "constant_force": ({"f_xc": 0.01, "f_xs": 0.02, "f_yc": 0.03, "f_ys": -0.04}, lambda r: r.force(_constant(r))),
    "drive_nonlinearity": ({"d_x": 0.02, "d_y": 0.05}, lambda r: r.force(by_axis(r, "d_x", "d_y") * cubes(r.u))),
    "drive_amplitude_phase": ({"d_x": 2e-3, "d_y": 5e-3}, lambda r: r.force(1j * by_axis(r, "d_x", "d_y") * cubes(r.u))),
    "drive_stiffness": (
        {"k_x": 0.05, "k_y": -0.03},
        lambda r: 1j * by_axis(r, "k_x", "k_y") * (2.0 * np.abs(r.u) ** 2 * r.p + r.u**2 * r.p.conj()),
    ),
    "drive_stiffness_mean": ({"k_x": 0.05, "k_y": -0.03}, lambda r: 1j * by_axis(r, "k_x", "k_y") * np.abs(r.u) ** 2 * r.p),
    "drive_gap": ({"d_x": 2e-3, "d_y": -3e-3}, lambda r: r.force(by_axis(r, "d_x", "d_y") * across_gap(r))),
    "drive_sag": ({"d": 0.02}, lambda r: r.force(r.size["d"] * (np.abs(r.u) ** 2).sum(axis=1, keepdims=True) * r.u)),
    "drive_cross_nonlinearity": ({"d": 0.02}, lambda r: r.force(r.size["d"] * cubes(r.u)[:, ::-1])),
    "pickoff_nonlinearity": ({"c_x": 2e-3, "c_y": -3e-3}, lambda r: r.reading(by_axis(r, "c_x", "c_y") * cubes(r.volts))),
    "pickoff_amplitude_phase": ({"c_x": 2e-3, "c_y": -3e-3}, lambda r: r.reading(1j * by_axis(r, "c_x", "c_y") * cubes(r.volts))),
    "pickoff_cross_nonlinearity": ({"c": 2e-3}, lambda r: r.reading(r.size["c"] * cubes(r.volts)[:, ::-1])),
    "drive_delay": ({"tau_x": 2e-4, "tau_y": -1e-4}, lambda r: r.force(_late_drive(r))),
    "pickoff_delay": ({"tau_x": 2e-4, "tau_y": -1e-4}, lambda r: r.reading(_late(r))),
    "pickoff_interference": ({"v_xc": 0.01, "v_xs": 0.02, "v_yc": 0.03, "v_ys": -0.04}, lambda r: r.reading(_constant(r))),
}


def _constant(r: Rows) -> ComplexArray:
    xc, xs, yc, ys = r.size.values()
    return np.tile([complex(xc, xs), complex(yc, ys)], (len(r.t), 1))


@compiled_only
@pytest.mark.parametrize("name", STATIC)
def test_effect_at_the_carrier_is_its_closed_form(plain: Device, name: str) -> None:
    sizes, form = STATIC[name]
    rows = measured(plain, {name: sizes})
    assert_form(rows, form(rows), 0.01)


@compiled_only
def test_without_effects_nothing_is_left_over(plain: Device) -> None:
    assert np.abs(measured(plain, {}).rest).max() < 1e-5


CARRIER_ONLY = {"drive_amplitude_phase", "drive_stiffness", "drive_stiffness_mean", "drive_gap", "pickoff_delay", "drive_delay"}


@compiled_only
@pytest.mark.parametrize("name", sorted(set(STATIC) - CARRIER_ONLY))
def test_slow_flow_has_the_same_effect(plain: Device, name: str) -> None:
    sizes, form = STATIC[name]
    rows, before = measured(plain, {name: sizes}, fidelity="slow_flow"), measured(plain, {}, fidelity="slow_flow")
    # the slow flow is written about the natural frequency, 8 rad/s away: what that leaves over goes with the motion
    assert_form(rows, form(rows), 0.02, before.rest)


@compiled_only
@pytest.mark.parametrize(("name", "level"), [("drive_saturation", 1.0), ("drive_dead_zone", 0.1)])
def test_bent_drive_has_the_fundamental_of_a_bent_sine(plain: Device, name: str, level: float) -> None:
    """On average: 16 held samples a cycle, which slide over it, meet the corner early or late."""
    rows = measured(plain, {name: {"level": level}}, length_s=1.0)
    factor = clipped(np.abs(rows.u), level) - 1.0 if name == "drive_saturation" else -clipped(np.abs(rows.u), level)
    expected = rows.force(factor * rows.u)
    np.testing.assert_allclose(rows.rest.mean(axis=0) / expected.mean(axis=0), 1.0, atol=0.02)


@compiled_only
def test_saturated_pickoff_reads_the_fundamental_of_a_clipped_sine(plain: Device) -> None:
    rows = measured(plain, {"pickoff_saturation": {"level": 0.9}}, Command("ftr_x", setpoints=Setpoints(1.0)), length_s=1.0)
    # the drives tell how far the mode really moves
    true = np.linalg.solve(rows.A, -(rows.u @ rows.G.T).T).T
    assert abs(rows.p[:, 0].mean()) == pytest.approx(1.0, abs=1e-3)
    assert abs(true[:, 0].mean()) * clipped(np.abs(true[:, 0]), 0.9).mean() == pytest.approx(1.0, abs=0.01)
    assert abs(true[:, 0].mean()) > 1.05


@compiled_only
@pytest.mark.parametrize(("name", "power"), [("coulomb_friction", -1), ("quadratic_damping", 1)])
def test_drag_of_a_linear_wave(plain: Device, name: str, power: int) -> None:
    command = Command("ftr_x", setpoints=Setpoints(0.8))
    rows, before = measured(plain, {name: {"c": 0.3}}, command, length_s=1.0), measured(plain, {}, command, length_s=1.0)
    expected = -0.3 * rows.p * np.abs(rows.p[:, :1]) ** power
    assert_form(rows, expected, 0.01, before.rest)


@compiled_only
@pytest.mark.parametrize("fidelity", ["carrier", "slow_flow"])
@pytest.mark.parametrize("name", ["coulomb_friction", "quadratic_damping"])
def test_drag_of_an_elliptic_wave_treats_its_quadrature_otherwise(plain: Device, name: str, fidelity: str) -> None:
    command = replace(OPEN, compensation=(1.0, 0.0, 0.2, 0.0))
    rows, before = measured(plain, {name: {"c": 0.3}}, command, fidelity=fidelity), measured(plain, {}, command, fidelity=fidelity)
    size = np.sqrt((np.abs(rows.p) ** 2).sum(axis=1, keepdims=True))
    turned = (rows.p**2).sum(axis=1, keepdims=True) * rows.p.conj() / size**2
    along, across = 0.5 * (rows.p + turned), 0.5 * (rows.p - turned)
    ratio = np.linalg.norm(across, axis=1, keepdims=True) / np.linalg.norm(along, axis=1, keepdims=True)
    assert ratio.min() > 0.02
    more = np.log(4.0 / ratio) - 1.0
    expected = -0.3 * size * (along + 0.5 * across) if name == "quadratic_damping" else -0.3 / size * (along + more * across)
    assert_form(rows, expected, 0.02, before.rest)
    assert np.abs(more * across).max() > 0.05 * np.abs(along).max()


@compiled_only
@pytest.mark.parametrize("part", ["gain_xx", "gain_xy", "gain_yx", "gain_yy"])
def test_spurious_mode_answers_its_drive_as_a_resonance(plain: Device, part: str) -> None:
    sizes = {"separation_hz": 8.0, "half_width_hz": 5.0, **dict.fromkeys(("gain_xx", "gain_xy", "gain_yx", "gain_yy"), 0.0), part: 0.5}
    rows = measured(plain, {"spurious_mode": sizes})
    above = plain.resonator.frequency_hz + sizes["separation_hz"] - DRIVE_HZ
    q = -1j * rows.u / (2.0 * math.pi * (sizes["half_width_hz"] - 1j * above))
    gains = np.array([[sizes["gain_xx"], sizes["gain_xy"]], [sizes["gain_yx"], sizes["gain_yy"]]])
    assert_form(rows, rows.reading(q @ gains.T), 0.01)


# ---------------------------------------------------------------- environment and time


FED = {"e_xc": 2e-3, "e_xs": -1e-3, "e_yc": 3e-3, "e_ys": 2e-3}
CROSSED = {"c_x": 2e-4, "c_y": -3e-4}
RAMP_K_S, LAG_S, SWAY = 2.0, 0.3, {"frequency_hz": 1.7, "r": 0.05, "phase_rad": 0.4}
ENVIRONMENT: dict[str, tuple[dict[str, float], Form]] = {
    "thermal_damping": ({"c": 0.02}, lambda r: -r.size["c"] * WARM_K * r.p),
    "thermal_damping_curvature": ({"c": 0.01}, lambda r: -r.size["c"] * WARM_K**2 * r.p @ losses(r)),
    "thermal_damping_anisotropy": ({"c_c": 0.02, "c_s": 0.03}, lambda r: -WARM_K * r.p @ split(r, "c_c", "c_s")),
    "thermal_frequency_curvature": ({"k": 0.01}, lambda r: 1j * r.size["k"] * WARM_K**2 * r.p),
    "thermal_bias": ({"b": 0.02}, lambda r: -r.size["b"] * 0.8 * WARM_K * r.p @ TURN.T),
    "bias_drift": ({"b": 0.1}, lambda r: -r.size["b"] * 0.8 * r.t[:, None] * (r.p @ TURN.T)),
    "base_sway": (SWAY, lambda r: -r.size["r"] * 0.8 * np.cos(3.4 * math.pi * r.t + r.size["phase_rad"])[:, None] * (r.p @ TURN.T)),
    "thermal_split": ({"k_c": 0.02, "k_s": 0.03}, lambda r: 1j * WARM_K * r.p @ split(r, "k_c", "k_s")),
    "thermal_split_curvature": ({"k_c": 2e-3, "k_s": 3e-3}, lambda r: 1j * WARM_K**2 * r.p @ split(r, "k_c", "k_s")),
    "thermal_drive_gain": ({"g_x": 2e-3, "g_y": 3e-3}, lambda r: r.force(WARM_K * by_axis(r, "g_x", "g_y") * r.u)),
    "thermal_drive_phase": ({"g_x": 2e-4, "g_y": 3e-4}, lambda r: r.force(1j * WARM_K * by_axis(r, "g_x", "g_y") * r.u)),
    "thermal_pickoff_gain": ({"g_x": 2e-4, "g_y": 3e-4}, lambda r: r.reading(WARM_K * by_axis(r, "g_x", "g_y") * r.p)),
    "thermal_drive_coupling": (CROSSED, lambda r: r.force(WARM_K * by_axis(r, "c_x", "c_y") * r.u[:, ::-1])),
    "thermal_pickoff_coupling": (CROSSED, lambda r: r.reading(WARM_K * by_axis(r, "c_x", "c_y") * r.p[:, ::-1])),
    "thermal_drive_gain_curvature": ({"g_x": 2e-4, "g_y": 3e-4}, lambda r: r.force(WARM_K**2 * by_axis(r, "g_x", "g_y") * r.u)),
    "thermal_pickoff_gain_curvature": ({"g_x": 2e-5, "g_y": 3e-5}, lambda r: r.reading(WARM_K**2 * by_axis(r, "g_x", "g_y") * r.p)),
    "thermal_pickoff_phase": ({"g_x": 2e-4, "g_y": 3e-4}, lambda r: r.reading(1j * WARM_K * by_axis(r, "g_x", "g_y") * r.p)),
    "thermal_feedthrough": ({"e_x": 2e-3, "e_y": 3e-3}, lambda r: r.reading(WARM_K * by_axis(r, "e_x", "e_y") * r.u)),
    "frequency_ageing": ({"k": 0.1}, lambda r: 1j * r.size["k"] * r.t[:, None] * r.p),
    "clock_drift": ({"e": 1e-6}, lambda r: -2j * math.pi * 15003.7 * r.size["e"] * r.t[:, None] * r.p),
    "damping_drift": ({"c": 0.1}, lambda r: -r.size["c"] * r.t[:, None] * r.p),
    "split_drift": ({"k_c": 0.1, "k_s": 0.05}, lambda r: 1j * r.t[:, None] * (r.p @ split(r, "k_c", "k_s"))),
    "charge_accumulation": (
        {"k_c": 0.3, "k_s": 0.2, "k_0": 0.5, "tau": 2.0},
        lambda r: 1j * (1.0 - np.exp(-r.t / 2.0))[:, None] * (0.5 * r.p + r.p @ split(r, "k_c", "k_s")),
    ),
    "drive_gain_drift": ({"g_x": 0.01, "g_y": 5e-3}, lambda r: r.force(r.t[:, None] * by_axis(r, "g_x", "g_y") * r.u)),
    "drive_phase_drift": ({"g_x": 1e-3, "g_y": 5e-4}, lambda r: r.force(1j * r.t[:, None] * by_axis(r, "g_x", "g_y") * r.u)),
    "pickoff_gain_drift": ({"g_x": 1e-3, "g_y": 5e-4}, lambda r: r.reading(r.t[:, None] * by_axis(r, "g_x", "g_y") * r.p)),
    "drive_coupling_drift": ({"c_x": 0.01, "c_y": 5e-3}, lambda r: r.force(r.t[:, None] * by_axis(r, "c_x", "c_y") * r.u[:, ::-1])),
    "pickoff_coupling_drift": (CROSSED, lambda r: r.reading(r.t[:, None] * by_axis(r, "c_x", "c_y") * r.p[:, ::-1])),
    "feedthrough_drift": (FED, lambda r: r.reading(r.t[:, None] * r.u * fed(r))),
    "cross_feedthrough_drift": (FED, lambda r: r.reading(r.t[:, None] * r.u[:, ::-1] * fed(r))),
    "pickoff_phase_drift": ({"g_x": 2e-4, "g_y": 1e-4}, lambda r: r.reading(1j * r.t[:, None] * by_axis(r, "g_x", "g_y") * r.p)),
    "centrifugal_stiffness": ({"k": 0.5}, lambda r: 1j * r.size["k"] * RATE**2 * r.p),
    "centrifugal_stiffness_axes": ({"k_x": 0.5, "k_y": 0.2, "k_s": 0.3}, lambda r: 1j * RATE**2 * r.p @ [[0.5, 0.3], [0.3, 0.2]]),
    "multiplexing_skew": ({"tau": 2e-6}, of_late_y),
    "rate_dependent_damping": ({"c": 0.5}, lambda r: -r.size["c"] * RATE * r.p),
    "angular_gain_error": ({"e": 0.1}, lambda r: -r.size["e"] * 0.8 * RATE * r.p @ TURN.T),
    "rate_nonlinearity": ({"e": 0.1}, lambda r: -r.size["e"] * 0.8 * RATE * abs(RATE) * r.p @ TURN.T),
    "rate_asymmetry": ({"e": 0.1}, lambda r: -r.size["e"] * 0.8 * RATE**2 * r.p @ TURN.T),
}


def behind(r: Rows) -> ComplexArray:
    """A ramp less itself through a low-pass that began with it."""
    return np.asarray(RAMP_K_S * LAG_S * -np.expm1(-r.t / LAG_S)[:, None], dtype=complex)


LATE: dict[str, tuple[dict[str, float], Form]] = {
    "thermal_frequency_lag": ({"k": 0.2}, lambda r: 1j * r.size["k"] * behind(r) * r.p),
    "thermal_damping_lag": ({"c": 0.2}, lambda r: -r.size["c"] * behind(r) * r.p),
    "thermal_damping_anisotropy_lag": ({"c_c": 0.2, "c_s": 0.3}, lambda r: -behind(r) * (r.p @ split(r, "c_c", "c_s"))),
    "thermal_bias_lag": ({"b": 0.2}, lambda r: -0.8 * r.size["b"] * behind(r) * (r.p @ TURN.T)),
    "thermal_split_lag": ({"k_c": 0.2, "k_s": 0.3}, lambda r: 1j * behind(r) * (r.p @ split(r, "k_c", "k_s"))),
    "thermal_drive_gain_lag": ({"g_x": 0.02, "g_y": 0.03}, lambda r: r.force(behind(r) * by_axis(r, "g_x", "g_y") * r.u)),
    "thermal_pickoff_gain_lag": ({"g_x": 2e-3, "g_y": 3e-3}, lambda r: r.reading(behind(r) * by_axis(r, "g_x", "g_y") * r.p)),
}


def surroundings(name: str) -> dict[str, float]:
    return {of: size * (need in EFFECTS[name].needs) for of, need, size in (("rise_k", "temperature", WARM_K), ("rate", "rate", RATE))}


@compiled_only
@pytest.mark.parametrize("name", ENVIRONMENT)
def test_effect_of_surroundings_and_time_is_its_closed_form(plain: Device, name: str) -> None:
    sizes, form = ENVIRONMENT[name]
    if name == "thermal_damping_curvature":
        plain = replace(plain, resonator=replace(plain.resonator, damping_anisotropy=0.4, damping_azimuth_rad=0.2))
    rows = measured(plain, {name: sizes}, **surroundings(name))
    assert_form(rows, form(rows), 0.01)


@compiled_only
@pytest.mark.parametrize("name", sorted(n for n in ENVIRONMENT if "feedthrough" not in n))
def test_slow_flow_follows_surroundings_and_time_too(plain: Device, name: str) -> None:
    sizes, form = ENVIRONMENT[name]
    around = surroundings(name)
    rows, before = measured(plain, {name: sizes}, fidelity="slow_flow", **around), measured(plain, {}, fidelity="slow_flow", **around)
    assert_form(rows, form(rows), 0.05, before.rest)


@compiled_only
@pytest.mark.parametrize(
    ("name", "fidelity"),
    # a reading whose gain changes is a motion to the slow flow, which knows the gain and not its change
    [
        (name, fidelity)
        for name in LATE
        for fidelity in ("carrier", "slow_flow")
        if (name, fidelity) != ("thermal_pickoff_gain_lag", "slow_flow")
    ],
)
def test_what_follows_a_temperature_late_is_its_closed_form_on_a_ramp(plain: Device, name: str, fidelity: str) -> None:
    sizes, form = LATE[name]
    # nothing but the effect follows the ramp
    steady = replace(plain.resonator, frequency_tempco_per_k=0.0, quality_exponent=0.0)
    warming = replace(plain, resonator=steady, environment=replace(plain.environment, ramp_k_per_s=RAMP_K_S))
    rows, before = (measured(warming, e, settle_s=0.4, length_s=0.2, fidelity=fidelity) for e in ({name: sizes | {"tau": LAG_S}}, {}))
    expected = form(rows)
    assert np.abs(expected).max() > 1e-3
    scale = np.abs(expected).max()
    assert np.abs(rows.rest - before.rest - expected)[5:-5].max() / scale < 0.05


@compiled_only
def test_resonator_follows_a_temperature_late(plain: Device) -> None:
    """A ramp: the frequency is that of ``tau`` ago, once the start is forgotten."""
    device = replace(plain, environment=replace(plain.environment, ramp_k_per_s=2.0))
    frequency = []
    for effects in ({}, {"thermal_lag": {"tau": 0.3}}):
        simulator = GyroSimulator(replace(device, effects=effects), rng=np.random.default_rng(0), noisy=False)
        simulator.advance(3.0)
        frequency.append(simulator.advance(0.2)[:, 10].mean())
    per_k = plain.resonator.frequency_hz * plain.resonator.frequency_tempco_per_k
    assert frequency[1] - frequency[0] == pytest.approx(-per_k * 2.0 * 0.3, rel=0.01)


# ---------------------------------------------------------------- memory, side bands, tones


def _late(r: Rows) -> ComplexArray:
    """Of a carrier that is late, on each axis: its envelope, and its phase away from the nominal frequency."""
    return -by_axis(r, "tau_x", "tau_y") * (slope(r.volts) + 1j * r.away_rad_s[:, None] * r.volts)


def _late_drive(r: Rows) -> ComplexArray:
    return -by_axis(r, "tau_x", "tau_y") * (slope(r.u) + 1j * r.away_rad_s[:, None] * r.u)


MEMORY: dict[str, tuple[dict[str, float], Form]] = {
    "relaxation": ({"c": 1.0, "tau": 0.05}, lambda r: 1j * (slow(r.p, 0.05) - r.p)),
    "drive_memory": ({"share": 0.05, "tau": 0.05}, lambda r: r.force(0.05 * slow(r.u, 0.05))),
    "drive_lag": ({"tau": 3e-4}, lambda r: r.force(-3e-4 * slope(r.u))),
    "drive_delay": ({"tau_x": 3e-4, "tau_y": 1e-4}, lambda r: r.force(_late_drive(r))),
    "pickoff_memory": ({"share": 3e-3, "tau": 0.05}, lambda r: r.reading(3e-3 * slow(r.volts, 0.05))),
    "pickoff_lag": ({"tau": 2e-4}, lambda r: r.reading(-2e-4 * slope(r.volts))),
    "pickoff_delay": ({"tau_x": 2e-4, "tau_y": -1e-4}, lambda r: r.reading(_late(r))),
    "channel_skew": ({"tau": 2e-4}, lambda r: r.reading(-2e-4 * slope(r.volts) * np.array([0.0, 1.0]))),
    "channel_skew early": ({"tau": -5e-5}, lambda r: r.reading(5e-5 * slope(r.volts) * np.array([0.0, 1.0]))),
}


@compiled_only
@pytest.mark.parametrize("name", MEMORY)
def test_effect_with_memory_is_its_closed_form_under_modulation(plain: Device, name: str) -> None:
    sizes, form = MEMORY[name]
    name = name.split()[0]
    command = replace(MODULATED, mode="ftr_y") if name == "channel_skew" else MODULATED
    rows, before = (measured(plain, e, command, settle_s=2.0, length_s=1.5) for e in ({name: sizes}, {}))
    expected = form(rows)
    cut = slice(200, -10)  # the low-pass of the rows forgets where it began
    scale = np.abs(expected[cut]).max()
    assert scale > 1e-3
    assert np.abs(rows.rest - before.rest - expected)[cut].max() / scale < 0.03


@compiled_only
def test_external_tone_is_a_force_at_its_own_frequency_and_phase(plain: Device) -> None:
    sizes = {"frequency_hz": DRIVE_HZ + 4.0, "a_x": 0.05, "a_y": 0.03, "phase_rad": 0.7}
    rows = measured(plain, {"external_tone": sizes}, length_s=0.5)
    # the reference's phase at the command: the gyro had run at its resonance until then, no time at all
    expected = rows.force(np.exp(1j * (2.0 * math.pi * 4.0 * rows.t + 0.7))[:, None] * by_axis(rows, "a_x", "a_y"))
    assert_form(rows, expected, 0.02)


@compiled_only
def test_hum_stands_beside_the_carrier(plain: Device) -> None:
    rows = measured(plain, {"mains_pickup": {"frequency_hz": 5.0, "v_x": 3e-3, "v_y": 2e-3}}, length_s=0.5)
    hum = np.cos(2.0 * math.pi * 5.0 * rows.t)[:, None] * np.array([[3e-3, 2e-3]])
    assert_form(rows, rows.reading(hum), 0.01)


# ---------------------------------------------------------------- electronics: steps and noise


@compiled_only
def test_pickoff_samples_are_whole_steps(plain: Device) -> None:
    simulator = GyroSimulator(replace(plain, effects={"pickoff_quantisation": {"lsb": 3e-3}}), rng=np.random.default_rng(0), noisy=False)
    raw = simulator.capture_raw(0.02).raw
    steps = raw["x_pick"] / 3e-3
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert np.unique(np.round(steps)).size > 100


@compiled_only
@pytest.mark.parametrize("by", ["effect", "bits"])
def test_drive_below_half_a_step_does_nothing_and_one_above_is_stepped(plain: Device, by: str) -> None:
    lsb = 40.0 / 2**8
    if by == "effect":
        device = replace(plain, effects={"drive_quantisation": {"lsb": lsb}})
    else:
        device = replace(plain, electronics=replace(plain.electronics, dac_bits=8))
    for volts, share in ((0.45 * lsb, 0.0), (0.8 * lsb, 4.0 / math.pi * math.sqrt(1.0 - (0.5 / 0.8) ** 2) / 0.8)):
        simulator = GyroSimulator(device, rng=np.random.default_rng(0), noisy=False)
        simulator.configure(Command("loops_off", Excitation("drive", DRIVE_HZ, 0.0, volts, "x")))
        simulator.advance(2.5)
        rows = simulator.advance(1.0)
        flow = plain.slow_flow(omega_rad_s=2.0 * math.pi * DRIVE_HZ)
        reached = complex(rows[:, 2].mean(), rows[:, 3].mean()) - flow.E[0, 0] * volts
        full = np.linalg.solve(flow.A, -flow.G[:, 0] * volts)[0]
        assert abs(reached / full - share) < 0.05


# ---------------------------------------------------------------- complete


def test_every_effect_is_tested_here() -> None:
    named = set(STATIC) | set(ENVIRONMENT) | set(LATE) | {name.split()[0] for name in MEMORY}
    alone = {
        "drive_saturation", "drive_dead_zone", "pickoff_saturation", "coulomb_friction", "quadratic_damping", "spurious_mode",
        "thermal_lag", "external_tone", "mains_pickup", "pickoff_quantisation", "drive_quantisation", "amplitude_noise", "driven_pump",
        "pickoff_gain_flicker", "pickoff_phase_flicker", "drive_gain_flicker", "reference_spur", "loop_error", "angle_latency",
    }  # fmt: skip
    assert named | alone == set(EFFECTS)
    assert not named & alone
