"""The time-domain alternative: its integrator against an exact solution, its answer against the frequency domain's and the truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from gyro_calib.device import Device, draw_unit, load_device
from gyro_calib.errors import CalibrationRefused
from gyro_calib.estimation.document_fit import document_fit, known_start, rough_start
from gyro_calib.estimation.document_model import FIRST_FIFTEEN
from gyro_calib.estimation.sideband_table import smooth_reference
from gyro_calib.estimation.time_domain import integrate, row_propagator, time_domain_fit
from gyro_calib.experiments import Plan, SimulatedInstrument, Step, run_plan
from gyro_calib.recording.command import Command, Excitation
from gyro_calib.recording.recording import Recording
from gyro_calib.simulation import GyroSimulator
from gyro_calib.units import DEG_H

LINES_HZ = (0.5, 1.5)
RATE = -12.0 * DEG_H


@pytest.fixture(scope="module")
def device() -> Device:
    return draw_unit(load_device("ring_15k"), 4)


def _recordings(device: Device, *, noisy: bool, duration_s: float = 12.0) -> list[Recording]:
    steps = tuple(
        Step(f"{axis}{nu}", Command(f"ftr_{axis}", Excitation("amplitude_modulation", nu, 0.15)), duration_s, 3.0)
        for axis in "xy"
        for nu in LINES_HZ
    )
    simulator = GyroSimulator(device, rng=np.random.default_rng(2), noisy=noisy)
    return list(run_plan(SimulatedInstrument(simulator, RATE), Plan("sides", steps)))


@pytest.fixture(scope="module")
def quiet(device: Device) -> list[Recording]:
    return _recordings(device, noisy=False)


def test_integrator_is_exact_for_a_drive_that_is_a_cubic_in_time() -> None:
    rng = np.random.default_rng(0)
    A = np.array([[-1.5 + 0.4j, 0.3 - 0.6j], [-0.2 + 0.6j, -1.6 - 0.5j]])
    G = rng.standard_normal((2, 2)) + 1j * rng.standard_normal((2, 2))
    coefficients = rng.standard_normal((4, 2)) + 1j * rng.standard_normal((4, 2))
    row_s, rows = 0.05, 60
    t = row_s * np.arange(rows)
    drive = sum(c[None, :] * t[:, None] ** m for m, c in enumerate(coefficients))
    # u, u', u'', u''' are states of a chain that the matrix exponential solves exactly
    chain = np.zeros((10, 10), dtype=complex)
    chain[:2, :2], chain[:2, 2:4] = A, G
    for m in range(3):
        chain[2 + 2 * m : 4 + 2 * m, 4 + 2 * m : 6 + 2 * m] = np.eye(2)
    start = np.concatenate([[0.4 + 0.1j, -0.3j], *(coefficients[m] * [1.0, 1.0, 2.0, 6.0][m] for m in range(4))])
    exact = np.array([expm(chain * when) @ start for when in t])[:, :2]
    step, weights = row_propagator(A, G, row_s)
    out = np.zeros((rows, 2), dtype=complex)
    integrate(exact[1], step, weights, drive, out)
    assert np.max(np.abs(out[1:-1] - exact[1:-1])) < 1e-12 * np.max(np.abs(exact))


def test_smooth_reference_takes_its_own_side_bands_out_of_the_phase(quiet: list[Recording]) -> None:
    recording = quiet[0]
    pick, drive, omega = smooth_reference(recording)
    assert np.ptp(omega) < 0.05 * np.ptp(recording.ref_omega_rad_s)
    assert np.abs(pick) == pytest.approx(np.abs(recording.pick), rel=1e-12)
    # turned alike: ratios of channels stay
    assert drive[:, 0] * recording.pick[:, 0] == pytest.approx(recording.drive[:, 0] * pick[:, 0], rel=1e-9)
    assert np.ptp(np.angle(pick[:, 0])) > 10 * np.ptp(np.angle(recording.pick[:, 0]))


def test_both_domains_give_the_same_answer_and_the_truth_without_noise(device: Device, quiet: list[Recording]) -> None:
    E = device.feedthrough.matrix()
    frequency = document_fit(quiet, lambda model: 1.3 * rough_start(model, device.factory()), weights="equal", feedforward=E)
    instants = time_domain_fit(quiet, 1.3 * rough_start(frequency.model, device.factory()), feedforward=E)
    flow = device.slow_flow(RATE)
    true = known_start(frequency.model, flow.A, flow.G, flow.E)
    assert frequency.converged
    assert instants.converged
    assert instants.integrations % (len(FIRST_FIFTEEN) + 1) == 0
    # half a deg/h of rate, 3 ppm of the forcers
    limits = {"b": 0.8 * DEG_H, "k": 0.8 * DEG_H * frequency.model.omega0, "B": 3e-6 * true[0]}
    for i, name in enumerate(FIRST_FIFTEEN[:14]):
        limit = limits[name[0]]
        assert abs(instants.values[i] - frequency.values[i]) < limit, name
        assert abs(instants.values[i] - true[i]) < limit, name


def test_with_noise_they_agree_within_their_covariances(device: Device) -> None:
    recordings = _recordings(device, noisy=True)
    E = device.feedthrough.matrix()
    frequency = document_fit(recordings, lambda model: 1.3 * rough_start(model, device.factory()), weights="equal", feedforward=E)
    instants = time_domain_fit(recordings, 1.3 * rough_start(frequency.model, device.factory()), feedforward=E)
    sd = np.sqrt(np.diag(frequency.covariance) + np.diag(instants.covariance))
    assert np.max(np.abs(frequency.values - instants.values) / sd) < 4.0
    flow = device.slow_flow(RATE)
    pulls = (instants.values - known_start(frequency.model, flow.A, flow.G, flow.E)) / np.sqrt(np.diag(instants.covariance))
    assert 0.3 < np.sqrt(np.mean(np.square(pulls))) < 2.5
    assert instants.residual_v > 1e-6


def test_recordings_that_do_not_outlast_their_own_start_are_refused(device: Device, quiet: list[Recording]) -> None:
    short = [Recording(r.device_id, r.data[:2000], r.command, r.sample_rate_hz, r.label, r.extras) for r in quiet]
    start = rough_start(document_fit(quiet, lambda m: rough_start(m, device.factory()), weights="equal").model, device.factory())
    with pytest.raises(CalibrationRefused, match="must last some"):
        time_domain_fit(short, start)
    with pytest.raises(CalibrationRefused, match="y as the oscillator"):
        time_domain_fit(quiet[:2], start)
