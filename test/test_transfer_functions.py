"""Side-band transfer functions (document 000, Eqs. 11-18): the algebra by hand, and the sensor's own response at the carrier level."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gyro_calib.device import Device, draw_unit, load_device
from gyro_calib.errors import CalibrationRefused
from gyro_calib.estimation.sideband_table import SidebandRow, sideband_table
from gyro_calib.estimation.transfer_functions import (
    demodulated,
    drive_system,
    from_signs,
    pairs_of_runs,
    respond,
    solve_transfer_functions,
    to_signs,
)
from gyro_calib.experiments import Plan, SimulatedInstrument, Step, run_plan
from gyro_calib.recording.command import Command, Excitation
from gyro_calib.simulation import GyroSimulator

LINES_HZ = (0.5, 1.5)


def _complex(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def _table(device: Device, *, noisy: bool, seed: int = 0) -> list[SidebandRow]:
    steps = tuple(
        Step(f"{axis}{nu}", Command(f"ftr_{axis}", Excitation("amplitude_modulation", nu, 0.15)), 10.0, 3.0)
        for axis in "xy"
        for nu in LINES_HZ
    )
    simulator = GyroSimulator(device, rng=np.random.default_rng(seed), noisy=noisy)
    return sideband_table(list(run_plan(SimulatedInstrument(simulator), Plan("sides", steps))))


def _one_frequency(seed: int) -> Device:
    """A unit whose two oscillators run at the same frequency: no split, equal phases of the electronics."""
    device = draw_unit(load_device("ring_15k"), seed)
    return replace(
        device,
        resonator=replace(device.resonator, frequency_split_hz=0.0),
        drive=replace(device.drive, phase_x_rad=2e-3, phase_y_rad=2e-3),
        pickoff=replace(device.pickoff, phase_x_rad=-1e-3, phase_y_rad=-1e-3),
    )


def _sensor(device: Device, omega_rad_s: float, nu_rad_s: float) -> np.ndarray:
    """Volts per volt at omega + nu from the equation of motion itself (theory.md Eq. 1 at rest), without feed-forward.

    The drive that acts is the recorded one on the side band, times the gain that its zero-order hold has at the carrier.
    """
    w = omega_rad_s + nu_rad_s
    impedance = device.resonator.stiffness_matrix() - w**2 * np.eye(2) + 1j * w * device.resonator.damping_matrix()
    held = np.sinc(omega_rad_s / device.electronics.adc_rate_hz / (2 * math.pi))
    return device.pickoff.matrix() @ np.linalg.solve(impedance, device.drive.matrix()) * held


@pytest.fixture(scope="module")
def equal() -> tuple[Device, list[SidebandRow]]:
    device = _one_frequency(3)
    return device, _table(device, noisy=False)


def test_sine_and_cosine_parts_answer_as_a_carrier_that_is_demodulated_does() -> None:
    rng = np.random.default_rng(0)
    carrier, nu = 2 * math.pi * 1000.0, 2 * math.pi * 2.0
    t = np.arange(0, 1.0, 1 / 64000.0)
    plus, minus = complex(*rng.standard_normal(2)), complex(*rng.standard_normal(2))
    drive = np.array([[0.3 - 0.2j], [-0.1 + 0.4j]])
    # through the sensor at omega + nu and omega - nu, then demodulated by 2 sin and 2 cos as in the document
    out = np.real((plus * drive[0, 0] * np.exp(1j * nu * t) + minus * drive[1, 0] * np.exp(-1j * nu * t)) * np.exp(1j * carrier * t))
    base = np.exp(-1j * nu * t)
    seen_s, seen_c = (2.0 * np.mean(out * wave * base) for wave in (np.sin(carrier * t), np.cos(carrier * t)))
    H_s, H_c = from_signs(np.array(plus), np.array(minus))
    D_s, D_c = demodulated(drive)
    O_s, O_c = respond(H_s, H_c, D_s[0], D_c[0])
    assert seen_s == pytest.approx(O_s, rel=1e-3)
    assert seen_c == pytest.approx(O_c, rel=1e-3)


def test_the_4x4_system_is_two_2x2_systems_one_per_sign() -> None:
    rng = np.random.default_rng(1)
    direct, swapped = _complex(rng, 2, 2), _complex(rng, 2, 2)
    H = _complex(rng, 2, 2)  # (sign, drive) of one pick-off
    outputs = []
    for run in (direct, swapped):
        outputs += demodulated(np.sum(H * run, axis=1))
    solved = np.linalg.solve(drive_system(direct, swapped), np.array(outputs))
    by_sign = np.stack(to_signs(solved[0::2], solved[1::2]))
    for sign in (0, 1):
        two = np.linalg.solve(np.array([direct[sign], swapped[sign]]), np.array([direct[sign] @ H[sign], swapped[sign] @ H[sign]]))
        assert by_sign[sign] == pytest.approx(two)
        assert by_sign[sign] == pytest.approx(H[sign])


def test_solved_transfer_functions_are_the_sensors_own_at_both_signs(equal: tuple[Device, list[SidebandRow]]) -> None:
    device, table = equal
    for direct, swapped in pairs_of_runs(table):
        found = solve_transfer_functions(direct, swapped, device.feedthrough.matrix())
        for sign, nu in ((0, direct.nu_rad_s), (1, -direct.nu_rad_s)):
            assert np.max(np.abs(found.signs[sign] - _sensor(device, direct.omega_rad_s, nu))) < 1e-5 * np.max(np.abs(found.signs))


def test_feed_forward_left_in_the_pickoffs_shows_in_the_transfer_functions(equal: tuple[Device, list[SidebandRow]]) -> None:
    device, table = equal
    direct, swapped = pairs_of_runs(table)[0]
    with_it = solve_transfer_functions(direct, swapped)
    without = solve_transfer_functions(direct, swapped, device.feedthrough.matrix())
    assert with_it.signs[0] - without.signs[0] == pytest.approx(device.feedthrough.matrix(), rel=1e-3, abs=1e-7)


def test_a_split_of_the_resonances_breaks_the_direct_comparison() -> None:
    device = replace(_one_frequency(3), device_id="split")
    device = replace(device, resonator=replace(device.resonator, frequency_split_hz=0.2, split_azimuth_rad=0.1))
    direct, swapped = pairs_of_runs(_table(device, noisy=False))[0]
    found = solve_transfer_functions(direct, swapped, device.feedthrough.matrix())
    expected = _sensor(device, direct.omega_rad_s, direct.nu_rad_s)
    assert np.max(np.abs(found.signs[0] - expected)) > 0.02 * np.max(np.abs(expected))


def test_covariance_of_the_transfer_functions_covers_their_scatter(equal: tuple[Device, list[SidebandRow]]) -> None:
    device, quiet = equal
    E = device.feedthrough.matrix()
    true = [solve_transfer_functions(*pair, E) for pair in pairs_of_runs(quiet)]
    pulls = []
    for seed in range(4):
        for pair, expected in zip(pairs_of_runs(_table(device, noisy=True, seed=seed)), true, strict=True):
            found = solve_transfer_functions(*pair, E)
            error = np.stack([found.sine - expected.sine, found.cosine - expected.cosine], axis=2).reshape(8)
            pulls.append(error.view(np.float64) / np.sqrt(np.diag(found.covariance)))
    # half of normal errors lie within 0.67 sd; the mean square would hang on a few lines of an oscillator's steep phase noise
    assert 0.5 < np.median(np.abs(pulls)) < 1.0


def test_runs_of_different_side_bands_and_runs_with_the_same_drive_are_refused(equal: tuple[Device, list[SidebandRow]]) -> None:
    _, table = equal
    low, high = (r for r in table if r.axis == "x")
    other = next(r for r in table if r.axis == "y" and r.frequency_hz == low.frequency_hz)
    with pytest.raises(CalibrationRefused, match=r"same side band, but got 0\.5 and 1\.5 Hz"):
        solve_transfer_functions(low, high)
    with pytest.raises(CalibrationRefused, match="driven differently"):
        solve_transfer_functions(low, replace(low, pick=other.pick))


def test_only_runs_of_both_axes_make_a_pair(equal: tuple[Device, list[SidebandRow]]) -> None:
    _, table = equal
    assert len(pairs_of_runs(table)) == len(LINES_HZ)
    assert pairs_of_runs([r for r in table if r.axis == "x"]) == []
    assert all(d.axis == "x" and s.axis == "y" and d.frequency_hz == s.frequency_hz for d, s in pairs_of_runs(table[::-1]))
