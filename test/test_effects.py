"""Every effect of the registry at the carrier against its closed form in envelopes, as the catalogue states it.

The carrier's rows give ``p' - (A - i dw) p - G u``; A, G and E are those of the device without the effect, what is left is the effect. The
forms are written here anew, from the catalogue's words: neither the kernels nor the slow flow's envelopes are asked.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from gyro_calib.device import Device, Feedthrough, device_from_dict, device_to_dict, draw_unit, dump_device, load_device
from gyro_calib.effects import EFFECTS, checked_sizes
from gyro_calib.errors import DeviceError, ExperimentAborted
from gyro_calib.experiments import Plan, SimulatedInstrument, Step, run_plan
from gyro_calib.jit import COMPILED
from gyro_calib.recording.applied_rate import words_of_steps
from gyro_calib.recording.command import Command, Excitation, Setpoints
from gyro_calib.recording.rate import raw_rate
from gyro_calib.simulation import GyroSimulator

compiled_only = pytest.mark.skipif(not COMPILED, reason="numba is not installed or switched off")
ComplexArray = NDArray[np.complex128]
Form = Callable[["Rows"], ComplexArray]

#: both axes driven off the middle of two modes 3 Hz apart, 5 Hz wide: envelopes of either phase on either axis
DRIVE_HZ = 15004.9
OPEN = Command("loops_off", Excitation("drive", DRIVE_HZ, 0.0, 2.0, "x"), compensation=(1.0, 0.0, 0.7, 0.0))
ALONG = np.diag([1.0, -1.0])
ACROSS = np.array([[0.0, 1.0], [1.0, 0.0]])
TURN = np.array([[0.0, -1.0], [1.0, 0.0]])
WARM_K, RATE = 8.0, -0.7


@dataclass(frozen=True)
class Rows:
    """Recorded envelopes with the linear flow of the device without effects."""

    t: NDArray[np.float64]
    p: ComplexArray
    u: ComplexArray
    volts: ComplexArray
    rest: ComplexArray
    A: ComplexArray
    G: ComplexArray
    size: Mapping[str, float]

    def force(self, du: ComplexArray) -> ComplexArray:
        """What a change of the drives adds."""
        return du @ self.G.T

    def reading(self, dv: ComplexArray) -> ComplexArray:
        """What a change of the readings leaves over: it is not followed by the motion."""
        return _slope(dv) - dv @ self.A.T


def _slope(values: ComplexArray) -> ComplexArray:
    return np.asarray(np.gradient(values, 1.0 / 500.0, axis=0))


def _slow(values: ComplexArray, tau: float) -> ComplexArray:
    """First-order low-pass of rows, from rest at the first."""
    keep = math.exp(-1.0 / 500.0 / tau)
    half = 0.5 * (1.0 - keep)
    return np.asarray(lfilter([half, half], [1.0, -keep], values - values[0], axis=0) + values[0])


@pytest.fixture(scope="module")
def plain() -> Device:
    """Two modes that any drive reaches, of low Q; gains of the axes equal, so that volts of x are those of y."""
    ring = load_device("ring_15k")
    return replace(
        ring,
        resonator=replace(ring.resonator, frequency_hz=15003.7, quality_factor=3000.0, frequency_split_hz=3.0, split_azimuth_rad=0.12),
        drive=replace(ring.drive, gain_mismatch=0.0, two_delta_rad=0.0, two_lambda_rad=0.0, phase_x_rad=3e-3, phase_y_rad=-4e-3),
        pickoff=replace(ring.pickoff, gain_mismatch=0.0, non_orthogonality_rad=0.0, phase_y_rad=1e-3),
        electronics=replace(ring.electronics, dac_full_scale_v=20.0),
    )


def measured(
    plain: Device,
    effects: Mapping[str, Mapping[str, float]],
    command: Command = OPEN,
    *,
    rise_k: float = 0.0,
    rate: float = 0.0,
    settle_s: float = 1.5,
    length_s: float = 0.1,
    fidelity: str = "carrier",
) -> Rows:
    device = replace(plain, effects=effects, environment=replace(plain.environment, temperature_degc=25.0 + rise_k))
    simulator = GyroSimulator(device, rng=np.random.default_rng(0), fidelity=fidelity, noisy=False)
    simulator.configure(command)
    simulator.advance(settle_s, rate)
    rows = simulator.advance(length_s, rate)
    volts, u = (rows[:, k : k + 4 : 2] + 1j * rows[:, k + 1 : k + 4 : 2] for k in (2, 6))
    omega = 2.0 * math.pi * rows[:, 10]
    # about the frequency of the drive itself the linear steady state is exact
    flow = plain.slow_flow(rate, 25.0 + rise_k, omega_rad_s=float(omega.mean()))
    p = volts - u @ flow.E.T
    rest = _slope(p) - p @ flow.A.T + 1j * (omega - omega.mean())[:, None] * p - u @ flow.G.T
    size = next(iter(effects.values()), {})
    keep = slice(5, -5)
    return Rows(rows[keep, 0], p[keep], u[keep], volts[keep], rest[keep], flow.A, flow.G, size)


def assert_form(rows: Rows, expected: ComplexArray, relative: float, before: ComplexArray | float = 0.0) -> None:
    """The rest over its linear part is the form: size, sign and phase on both axes."""
    scale = float(np.abs(expected).max())
    assert scale > 1e-3
    found = float(np.abs(rows.rest - before - expected)[1:-1].max()) / scale
    assert found < relative, f"differs by {found:.3g} of the effect"


def cubes(a: ComplexArray) -> ComplexArray:
    return np.abs(a) ** 2 * a


def isotropic(p: ComplexArray) -> ComplexArray:
    return (2.0 * (np.abs(p) ** 2).sum(axis=1, keepdims=True) * p + (p**2).sum(axis=1, keepdims=True) * p.conj()) / 3.0


def by_axis(rows: Rows, x: str, y: str) -> NDArray[np.float64]:
    return np.array([rows.size[x], rows.size[y]])


def split(rows: Rows, c: str, s: str) -> NDArray[np.float64]:
    return rows.size[c] * ALONG + rows.size[s] * ACROSS


def clipped(amplitude: NDArray[np.float64], level: float) -> NDArray[np.float64]:
    """Fundamental of a clipped sine over the sine."""
    share = np.minimum(level / amplitude, 1.0)
    return np.asarray(2.0 / math.pi * (np.arcsin(share) + share * np.sqrt(1.0 - share**2)))


# ---------------------------------------------------------------- at once: dynamics, drive, pick-off

#: effect -> sizes, form
STATIC: dict[str, tuple[dict[str, float], Form]] = {
    "duffing": ({"k": 0.5}, lambda r: 1j * r.size["k"] * isotropic(r.p)),
    "duffing_axes": ({"k_x": 0.5, "k_y": -0.3}, lambda r: 1j * by_axis(r, "k_x", "k_y") * cubes(r.p)),
    "cubic_cross_stiffness": ({"k": 0.5}, lambda r: 1j * r.size["k"] * cubes(r.p)[:, ::-1]),
    "nonlinear_damping": ({"c": 0.5}, lambda r: -r.size["c"] * isotropic(r.p)),
    "nonlinear_damping_axes": ({"c_x": 0.5, "c_y": 0.8}, lambda r: -by_axis(r, "c_x", "c_y") * cubes(r.p)),
    "parametric_pump": ({"h_c": 0.3, "h_s": 0.5}, lambda r: complex(r.size["h_c"], r.size["h_s"]) * r.p.conj()),
    "constant_force": ({"f_xc": 0.01, "f_xs": 0.02, "f_yc": 0.03, "f_ys": -0.04}, lambda r: r.force(_constant(r))),
    "drive_nonlinearity": ({"d_x": 0.02, "d_y": 0.05}, lambda r: r.force(by_axis(r, "d_x", "d_y") * cubes(r.u))),
    "drive_amplitude_phase": ({"d_x": 2e-3, "d_y": 5e-3}, lambda r: r.force(1j * by_axis(r, "d_x", "d_y") * cubes(r.u))),
    "drive_sag": ({"d": 0.02}, lambda r: r.force(r.size["d"] * (np.abs(r.u) ** 2).sum(axis=1, keepdims=True) * r.u)),
    "drive_cross_nonlinearity": ({"d": 0.02}, lambda r: r.force(r.size["d"] * cubes(r.u)[:, ::-1])),
    "pickoff_nonlinearity": ({"c_x": 2e-3, "c_y": -3e-3}, lambda r: r.reading(by_axis(r, "c_x", "c_y") * cubes(r.volts))),
    "pickoff_amplitude_phase": ({"c_x": 2e-3, "c_y": -3e-3}, lambda r: r.reading(1j * by_axis(r, "c_x", "c_y") * cubes(r.volts))),
    "pickoff_cross_nonlinearity": ({"c": 2e-3}, lambda r: r.reading(r.size["c"] * cubes(r.volts)[:, ::-1])),
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


@compiled_only
@pytest.mark.parametrize("name", sorted(set(STATIC) - {"drive_amplitude_phase"}))
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
@pytest.mark.parametrize("part", ["gain_x", "gain_y"])
def test_spurious_mode_answers_both_drives_as_a_resonance(plain: Device, part: str) -> None:
    sizes = {"separation_hz": 8.0, "half_width_hz": 5.0, "gain_x": 0.0, "gain_y": 0.0, part: 0.5}
    rows = measured(plain, {"spurious_mode": sizes})
    above = plain.resonator.frequency_hz + sizes["separation_hz"] - DRIVE_HZ
    q = rows.u.sum(axis=1, keepdims=True) / (2.0 * math.pi * (sizes["half_width_hz"] - 1j * above))
    assert_form(rows, rows.reading(q * by_axis(rows, "gain_x", "gain_y")), 0.01)


# ---------------------------------------------------------------- environment and time

ENVIRONMENT: dict[str, tuple[dict[str, float], Form]] = {
    "thermal_damping": ({"c": 0.02}, lambda r: -r.size["c"] * WARM_K * r.p),
    "thermal_damping_anisotropy": ({"c_c": 0.02, "c_s": 0.03}, lambda r: -WARM_K * r.p @ split(r, "c_c", "c_s")),
    "thermal_frequency_curvature": ({"k": 0.01}, lambda r: 1j * r.size["k"] * WARM_K**2 * r.p),
    "thermal_split": ({"k_c": 0.02, "k_s": 0.03}, lambda r: 1j * WARM_K * r.p @ split(r, "k_c", "k_s")),
    "thermal_drive_gain": ({"g_x": 2e-3, "g_y": 3e-3}, lambda r: r.force(WARM_K * by_axis(r, "g_x", "g_y") * r.u)),
    "thermal_drive_phase": ({"g_x": 2e-4, "g_y": 3e-4}, lambda r: r.force(1j * WARM_K * by_axis(r, "g_x", "g_y") * r.u)),
    "thermal_pickoff_gain": ({"g_x": 2e-4, "g_y": 3e-4}, lambda r: r.reading(WARM_K * by_axis(r, "g_x", "g_y") * r.p)),
    "thermal_pickoff_phase": ({"g_x": 2e-4, "g_y": 3e-4}, lambda r: r.reading(1j * WARM_K * by_axis(r, "g_x", "g_y") * r.p)),
    "thermal_feedthrough": ({"e_x": 2e-3, "e_y": 3e-3}, lambda r: r.reading(WARM_K * by_axis(r, "e_x", "e_y") * r.u)),
    "frequency_ageing": ({"k": 0.1}, lambda r: 1j * r.size["k"] * r.t[:, None] * r.p),
    "damping_drift": ({"c": 0.1}, lambda r: -r.size["c"] * r.t[:, None] * r.p),
    "split_drift": ({"k_c": 0.1, "k_s": 0.05}, lambda r: 1j * r.t[:, None] * (r.p @ split(r, "k_c", "k_s"))),
    "charge_accumulation": (
        {"k_c": 0.3, "k_s": 0.2, "k_0": 0.5, "tau": 2.0},
        lambda r: 1j * (1.0 - np.exp(-r.t / 2.0))[:, None] * (0.5 * r.p + r.p @ split(r, "k_c", "k_s")),
    ),
    "drive_gain_drift": ({"g_x": 0.01, "g_y": 5e-3}, lambda r: r.force(r.t[:, None] * by_axis(r, "g_x", "g_y") * r.u)),
    "drive_phase_drift": ({"g_x": 1e-3, "g_y": 5e-4}, lambda r: r.force(1j * r.t[:, None] * by_axis(r, "g_x", "g_y") * r.u)),
    "pickoff_gain_drift": ({"g_x": 1e-3, "g_y": 5e-4}, lambda r: r.reading(r.t[:, None] * by_axis(r, "g_x", "g_y") * r.p)),
    "centrifugal_stiffness": ({"k": 0.5}, lambda r: 1j * r.size["k"] * RATE**2 * r.p),
    "rate_dependent_damping": ({"c": 0.5}, lambda r: -r.size["c"] * RATE * r.p),
    "angular_gain_error": ({"e": 0.1}, lambda r: -r.size["e"] * 0.8 * RATE * r.p @ TURN.T),
    "rate_nonlinearity": ({"e": 0.1}, lambda r: -r.size["e"] * 0.8 * RATE * abs(RATE) * r.p @ TURN.T),
}


def surroundings(name: str) -> dict[str, float]:
    needs = EFFECTS[name].needs
    return {"rise_k": WARM_K if "temperature" in needs else 0.0, "rate": RATE if "rate" in needs else 0.0}


@compiled_only
@pytest.mark.parametrize("name", ENVIRONMENT)
def test_effect_of_surroundings_and_time_is_its_closed_form(plain: Device, name: str) -> None:
    sizes, form = ENVIRONMENT[name]
    rows = measured(plain, {name: sizes}, **surroundings(name))
    assert_form(rows, form(rows), 0.01)


@compiled_only
@pytest.mark.parametrize("name", sorted(set(ENVIRONMENT) - {"thermal_feedthrough"}))
def test_slow_flow_follows_surroundings_and_time_too(plain: Device, name: str) -> None:
    sizes, form = ENVIRONMENT[name]
    around = surroundings(name)
    rows, before = measured(plain, {name: sizes}, fidelity="slow_flow", **around), measured(plain, {}, fidelity="slow_flow", **around)
    assert_form(rows, form(rows), 0.05, before.rest)


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

MODULATED = Command("ftr_x", Excitation("amplitude_modulation", 4.0, 0.3))
MEMORY: dict[str, tuple[dict[str, float], Form]] = {
    "relaxation": ({"c": 1.0, "tau": 0.05}, lambda r: 1j * (_slow(r.p, 0.05) - r.p)),
    "drive_memory": ({"share": 0.05, "tau": 0.05}, lambda r: r.force(0.05 * _slow(r.u, 0.05))),
    "drive_lag": ({"tau": 3e-4}, lambda r: r.force(-3e-4 * _slope(r.u))),
    "pickoff_memory": ({"share": 3e-3, "tau": 0.05}, lambda r: r.reading(3e-3 * _slow(r.volts, 0.05))),
    "pickoff_lag": ({"tau": 2e-4}, lambda r: r.reading(-2e-4 * _slope(r.volts))),
    "channel_skew": ({"tau": 2e-4}, lambda r: r.reading(-2e-4 * _slope(r.volts) * np.array([0.0, 1.0]))),
    "channel_skew early": ({"tau": -5e-5}, lambda r: r.reading(5e-5 * _slope(r.volts) * np.array([0.0, 1.0]))),
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


@compiled_only
def test_gain_noise_grows_with_the_amplitude_and_is_in_phase_with_it(plain: Device) -> None:
    """Open drive: the reading's in-phase scatter is ``s |V| sqrt(bandwidth)``, its quadrature is quiet."""
    quiet = replace(
        plain, noise=replace(plain.noise, pickoff_v_rthz=0.0, drive_v_rthz=0.0, thermomechanical=False),
        environment=replace(plain.environment, wander_k=0.0),
    )  # fmt: skip
    s = 1e-5
    simulator = GyroSimulator(replace(quiet, effects={"amplitude_noise": {"s": s}}), rng=np.random.default_rng(1))
    simulator.configure(Command("loops_off", Excitation("drive", DRIVE_HZ, 0.0, 2.0, "x")))
    simulator.advance(2.0)
    rows = simulator.advance(8.0)
    volts = (rows[:, 2] + 1j * rows[:, 3]) / complex(rows[:, 2].mean(), rows[:, 3].mean())
    length = 10  # rows: means over 20 ms
    means = volts.reshape(-1, length).mean(axis=1)
    expected = s * math.sqrt(0.5 / (length / 500.0))
    assert means.real.std() == pytest.approx(expected, rel=4.0 / math.sqrt(2.0 * means.size))
    assert means.imag.std() < 0.05 * expected


# ---------------------------------------------------------------- truth, chamber


@compiled_only
@pytest.mark.parametrize(
    "name",
    [
        "cubic_cross_stiffness",
        "nonlinear_damping_axes",
        "spurious_mode",
        "parametric_pump",
        "pickoff_amplitude_phase",
        "thermal_drive_phase",
    ],
)
def test_truth_knows_what_effects_do_to_the_bias(name: str) -> None:
    unit = draw_unit(load_device("ring_15k"), 3)
    warm = replace(unit, environment=replace(unit.environment, temperature_degc=31.0))
    found = []
    for effects in ({}, {name: {key: 3.0 * size for key, size in EFFECTS[name].typical.items()}}):
        simulator = GyroSimulator(replace(warm, effects=effects), rng=np.random.default_rng(0), noisy=False)
        simulator.advance(3.0)
        rate = raw_rate(simulator.advance(0.3), simulator.command, simulator.factory).mean()
        found.append(rate)
        assert rate == pytest.approx(simulator.truth().bias_rad_s, abs=3e-6)  # 0.6 deg/h
    assert abs(found[1] - found[0]) > 1e-4


@pytest.mark.parametrize("over_s", [0.0, 0.4])
def test_chamber_moves_the_temperature_and_the_truth(plain: Device, over_s: float) -> None:
    simulator = GyroSimulator(plain, rng=np.random.default_rng(0), fidelity="slow_flow", noisy=False)
    simulator.advance(0.2)
    before = simulator.truth().bias_rad_s
    simulator.move_to_temperature(45.0, over_s)
    rows = simulator.advance(1.0)
    expected = 25.0 + 20.0 * np.clip(np.arange(500) / 500.0 / over_s, 0.0, 1.0) if over_s else np.full(500, 45.0)
    np.testing.assert_allclose(rows[:, 11], expected, atol=1e-9)
    assert rows[-1, 10] - 15003.7 == pytest.approx(-27e-6 * 20.0 * 15003.7, rel=0.3)
    assert simulator.truth().bias_rad_s != before
    for wrong in ((-300.0, 0.0), (30.0, -1.0)):
        with pytest.raises(DeviceError, match="must be"):
            simulator.move_to_temperature(*wrong)


def test_plan_takes_the_gyro_through_a_chamber_and_over_a_table() -> None:
    simulator = GyroSimulator(load_device("ring_15k"), rng=np.random.default_rng(0), fidelity="slow_flow")
    table = words_of_steps([0.0, 0.5], [0.0, 0.2])
    steps = (
        Step("cold", Command(), 0.4, 0.5),
        Step("warm", Command(), 0.4, 2.0, temperature_degc=35.0),
        Step("still warm", Command(), 1.0, 0.5, applied_rate=table),
    )
    campaign = run_plan(SimulatedInstrument(simulator), Plan("chamber", steps))
    cold, warm, still = campaign.recordings
    assert np.ptp(warm.temperature_degc) < 0.05
    assert warm.temperature_degc.mean() - cold.temperature_degc.mean() == pytest.approx(10.0, abs=0.05)
    assert still.temperature_degc.mean() == pytest.approx(35.0, abs=0.05)
    rates = raw_rate(still.data, still.command, dict(campaign.factory))
    assert rates[-100:].mean() - rates[100:200].mean() == pytest.approx(0.2, rel=0.1)
    with pytest.raises(ExperimentAborted, match="stand in a chamber"):
        run_plan(_NoChamber(simulator), Plan("chamber", steps[:2]))


class _NoChamber(SimulatedInstrument):
    abilities = frozenset({"applied_rate"})


# ---------------------------------------------------------------- registry, device files, refusals


def test_every_effect_is_tested_here() -> None:
    named = set(STATIC) | set(ENVIRONMENT) | {name.split()[0] for name in MEMORY}
    alone = {
        "drive_saturation", "drive_dead_zone", "pickoff_saturation", "coulomb_friction", "quadratic_damping", "spurious_mode",
        "thermal_lag", "external_tone", "mains_pickup", "pickoff_quantisation", "drive_quantisation", "amplitude_noise",
    }  # fmt: skip
    assert named | alone == set(EFFECTS)
    assert not named & alone


def test_registry_is_consistent() -> None:
    for name, effect in EFFECTS.items():
        assert name == effect.name
        assert set(effect.nearest) <= set(EFFECTS) - {name}
        assert checked_sizes({name: effect.typical}) == {name: effect.typical}
        assert len({p.name for p in effect.parameters}) == len(effect.parameters)
        for p in effect.parameters:
            assert p.typical < 0.51 * (p.upper - p.lower)


def test_device_with_effects_survives_its_file(plain: Device, tmp_path: Any) -> None:
    device = replace(plain, effects={name: effect.typical for name, effect in EFFECTS.items()})
    dump_device(device, tmp_path / "unit.yaml")
    assert load_device(tmp_path / "unit.yaml") == device
    assert hash(device) != 0
    assert draw_unit(device, 3).effects == device.effects
    assert "effects" not in device_to_dict(plain)
    document = {**device_to_dict(plain), "effects": {"duffing_axes": {"k_x": "1e-2"}}}
    assert device_from_dict(document).effects == {"duffing_axes": {"k_x": 0.01, "k_y": 0.0}}


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ({"dufing": {"k": 1.0}}, "Effect must be one of duffing, .* but got 'dufing'"),
        ({"duffing": {"kk": 1.0}}, "parameter must be one of k, but got 'kk'"),
        ({"duffing": 3}, "duffing must be a mapping"),
        ({"duffing": {"k": "much"}}, "duffing.k must be a number, but got 'much'"),
        ({"duffing": {"k": float("nan")}}, "duffing.k must be finite"),
        ({"duffing": {"k": 1e9}}, r"duffing.k must be within -20 and 20 rad/s/V\^2"),
        ({"drive_lag": {"tau": -1.0}}, "drive_lag.tau must be within 0 and"),
        ({"relaxation": {"c": 1.0}}, r"relaxation must have tau, but got \['c'\]"),
        ([1], "effects must be a mapping of effects"),
    ],
)
def test_wrong_effects_are_refused_by_name(plain: Device, effects: Any, message: str) -> None:
    with pytest.raises(DeviceError, match=message):
        replace(plain, effects=effects)


@pytest.mark.parametrize("name", ["spurious_mode", "relaxation", "drive_lag", "pickoff_quantisation", "thermal_feedthrough"])
def test_slow_flow_refuses_what_it_does_not_have(plain: Device, name: str) -> None:
    device = replace(plain, effects={name: EFFECTS[name].typical, "duffing": {"k": 0.1}})
    with pytest.raises(DeviceError, match=f"but got {name}. Simulate with fidelity carrier"):
        GyroSimulator(device, rng=np.random.default_rng(0), fidelity="slow_flow")


def test_effects_of_no_size_change_nothing(plain: Device) -> None:
    """Through the effect kernels instead of the plain samples: the same physics, to rounding."""
    device = replace(plain, feedthrough=Feedthrough(1e-3, 2e-3, 3e-4, 1e-4, -2e-4, 1e-4, 5e-4, 1e-3))
    answers = []
    for effects in ({}, {"drive_sag": {"d": 0.0}, "mains_pickup": {"frequency_hz": 50.0}}):
        simulator = GyroSimulator(replace(device, effects=effects), rng=np.random.default_rng(2))
        answers.append(simulator.advance(0.02, 0.1))
    np.testing.assert_allclose(answers[1], answers[0], rtol=1e-9, atol=1e-12)
