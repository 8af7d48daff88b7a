"""Device descriptions: physics of the matrices, YAML round trip, drawn units, refusals with their message."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from gyro_calib.device import (
    BOLTZMANN_J_PER_K,
    Device,
    J,
    PickoffChain,
    device_from_dict,
    device_to_dict,
    draw_unit,
    dump_device,
    load_device,
)
from gyro_calib.device.averaging import averaged_force, instant_force
from gyro_calib.device.operating_point import ftr_operating_point
from gyro_calib.errors import DeviceError
from gyro_calib.units import deg_rth


@pytest.fixture(scope="module")
def ring() -> Device:
    return load_device("ring_15k")


def test_eigenfrequencies_and_decay_rates_are_the_described_ones(ring: Device) -> None:
    r = replace(ring.resonator, damping_azimuth_rad=ring.resonator.split_azimuth_rad, damping_anisotropy=0.05)
    system = np.block([[np.zeros((2, 2)), np.eye(2)], [-r.stiffness_matrix(), -r.damping_matrix()]])
    roots = np.linalg.eigvals(system)
    roots = np.sort_complex(roots[roots.imag > 0])
    roots = roots[np.argsort(roots.imag)]
    split = (roots[1].imag - roots[0].imag) / (2 * math.pi)
    # modes sqrt(w^2 +/- w dw): the split is exact to (dw/2w)^2
    assert split == pytest.approx(r.frequency_split_hz, rel=5e-6)
    assert -roots.real.sum() == pytest.approx(2.0 * r.decay_rate(), rel=1e-9)
    # aligned axes: the stiffer mode is also the more strongly damped one, by the anisotropy
    assert -(roots[1].real - roots[0].real) == pytest.approx(r.damping_anisotropy * r.decay_rate(), rel=1e-6)


def test_slow_flow_steady_state_is_the_resonators_frequency_response(ring: Device) -> None:
    """Theory Eq. 4 about the drive frequency against the second-order system solved at that frequency."""
    omega = ring.resonator.omega0_rad_s + 3.0
    rate = 0.3
    flow = ring.slow_flow(rate, omega_rad_s=omega)
    u = np.array([0.1 + 0.2j, -0.05 + 0.07j])
    envelope = np.linalg.solve(flow.A, -flow.G @ u)
    r = ring.resonator
    damping = r.damping_matrix() + 2.0 * r.angular_gain * rate * J
    dynamic = r.stiffness_matrix() - omega**2 * np.eye(2) + 1j * omega * damping
    hold = np.sinc(omega / (2 * math.pi) / ring.electronics.adc_rate_hz)
    motion = np.linalg.solve(dynamic, hold * ring.drive.matrix() @ u)
    np.testing.assert_allclose(envelope, ring.pickoff.matrix() @ motion, rtol=1e-12)


def test_operating_point_satisfies_the_slow_flow_and_the_loops(ring: Device) -> None:
    flow = ring.slow_flow(0.02)
    for axis, osc in (("x", 0), ("y", 1)):
        point = ftr_operating_point(flow.A, flow.G, flow.E, 1.0, axis)
        volts = point.pick + flow.E @ point.drive
        assert abs(volts[osc] - 1.0) < 1e-12
        assert abs(volts[1 - osc]) < 1e-12
        assert abs(point.drive[osc].real) < 1e-9
        residual = (flow.A - 1j * point.detuning_rad_s * np.eye(2)) @ point.pick + flow.G @ point.drive
        np.testing.assert_allclose(residual, 0.0, atol=1e-9)


def test_scale_factor_of_a_perfect_unit_is_theory_eq_7(ring: Device) -> None:
    perfect = replace(
        ring,
        drive=replace(ring.drive, gain_mismatch=0.0, two_delta_rad=0.0, two_lambda_rad=0.0),
        pickoff=PickoffChain(ring.pickoff.gain_v_per_m, gain_mismatch=-0.02),
        resonator=replace(ring.resonator, frequency_split_hz=0.0, damping_anisotropy=0.0),
        feedthrough=type(ring.feedthrough)(),
    )
    flow = perfect.slow_flow()
    ahead = ftr_operating_point(flow.A + 0.1 * flow.dA_dOmega, flow.G, flow.E, 1.0, "x").rate_channel_v
    assert ahead / 0.1 == pytest.approx(ring.resonator.angular_gain * 0.98 / abs(flow.G[1, 1]), rel=1e-9)
    behind = ftr_operating_point(flow.A + 0.1 * flow.dA_dOmega, flow.G, flow.E, 1.0, "y").rate_channel_v
    assert behind / 0.1 == pytest.approx(-ring.resonator.angular_gain / (0.98 * abs(flow.G[0, 0])), rel=1e-9)


def test_averaged_nonlinear_force_is_the_first_harmonic_of_the_instant_one() -> None:
    rng = np.random.default_rng(4)
    omega = 2.0
    for _ in range(5):
        c = tuple(rng.standard_normal(8))
        x, y = complex(*rng.standard_normal(2)), complex(*rng.standard_normal(2))
        phase = np.linspace(0, 2 * math.pi, 64, endpoint=False)
        turn = np.exp(1j * phase)
        forces = np.array(
            [instant_force((x * e).real, (y * e).real, (1j * omega * x * e).real, (1j * omega * y * e).real, np.array(c)) for e in turn]
        )
        first = 2.0 * (forces * np.exp(-1j * phase)[:, None]).mean(axis=0)
        np.testing.assert_allclose(averaged_force(x, y, omega, np.array(c)), first, rtol=1e-12, atol=1e-12)


def test_thermomechanical_floor_of_the_packaged_ring_is_near_its_data_sheet(ring: Device) -> None:
    amplitude = 1.0 / ring.pickoff.gain_v_per_m
    arw = ring.resonator.thermomechanical_arw(amplitude, 25.0)
    r = ring.resonator
    by_hand = math.sqrt(BOLTZMANN_J_PER_K * 298.15 / (r.modal_mass_kg * r.omega0_rad_s * r.quality_factor)) / (r.angular_gain * amplitude)
    assert arw == pytest.approx(by_hand, rel=1e-12)
    assert 0.03 < deg_rth(arw) < 0.05


def test_yaml_round_trip_is_exact(ring: Device, tmp_path: Path) -> None:
    unit = draw_unit(ring, 7)
    dump_device(unit, tmp_path / "unit.yaml")
    assert load_device(tmp_path / "unit.yaml") == unit
    assert device_from_dict(device_to_dict(ring)) == ring


def test_drawn_units_differ_repeatably_and_keep_the_design_mean(ring: Device) -> None:
    assert draw_unit(ring, 3) == draw_unit(ring, 3)
    units = [draw_unit(ring, s) for s in range(400)]
    mismatch = np.array([u.drive.gain_mismatch for u in units])
    assert abs(mismatch.mean() - ring.drive.gain_mismatch) < 4 * mismatch.std() / math.sqrt(len(units))
    assert mismatch.std() == pytest.approx(0.01, rel=0.2)
    assert len({u.device_id for u in units}) == len(units)
    ratios = np.array([u.factory_data.drive_gain_ratio_x_over_y * (1 + u.drive.gain_mismatch) for u in units])
    assert np.abs(ratios - 1).max() < 1e-4


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("resonator", "quality_factor"), -3.0, "quality_factor must be > 0, but got -3.0"),
        (("resonator", "frequency_hz"), float("nan"), "frequency_hz must be finite"),
        (("resonator", "colour"), "red", "got colour"),
        (("electronics", "samples_per_control"), 2.5, "must be an integer, but got 2.5"),
        (("noise", "thermomechanical"), "maybe", "must be true or false"),
        (("drive",), 4, "drive must be a mapping"),
        (("environment", "temperature_degc"), -400.0, "within -273.15 and 1000"),
        (("electronics", "adc_rate_hz"), 30000.0, "8 or more samples per carrier cycle"),
        (("surprise",), {}, "unknown ['surprise']"),
    ],
)
def test_wrong_descriptions_are_refused_by_name(ring: Device, tmp_path: Path, path: tuple[str, ...], value: object, message: str) -> None:
    document = device_to_dict(ring)
    place = document
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    file = tmp_path / "bad.yaml"
    file.write_text(yaml.safe_dump(document))
    with pytest.raises(DeviceError, match="(?s).*" + message.replace("[", r"\[").replace("]", r"\]")):
        load_device(file)


def test_missing_parts_and_unknown_names_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match=r"one of .*ring_15k"):
        load_device("no_such_device")
    (tmp_path / "half.yaml").write_text("device_id: a\n")
    with pytest.raises(DeviceError, match="missing"):
        load_device(tmp_path / "half.yaml")
    (tmp_path / "torn.yaml").write_text("a: [1, 2\n")
    with pytest.raises(DeviceError, match="readable YAML"):
        load_device(tmp_path / "torn.yaml")
    with pytest.raises(DeviceError, match="seed must be >= 0"):
        draw_unit(load_device("ring_15k"), -1)
