"""A table's step that takes less than a period: what it leaves of the wave depends on the carrier's phase, and is allowed for."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.linalg import expm
from table_samples import looked_at, loudest

from gyro_calib.device import draw_unit, load_device
from gyro_calib.experiments import SimulatedInstrument, gap_whole_angle_plan, run_plan
from gyro_calib.gap.model import CampaignModel
from gyro_calib.simulation import GyroSimulator

#: [rad/s]; how fast the wave turns once the table does, -kappa dOmega
OMEGA, TURN = 2.0 * math.pi * 5000.0, -0.5
J = np.array([[0.0, -1.0], [1.0, 0.0]])


def courses(turn: float, times: np.ndarray) -> np.ndarray:
    """Fundamental solutions of x'' + w^2 x = 2 turn J x' at these times, shape (times, 4, 4)."""
    flow = np.block([[np.zeros((2, 2)), np.eye(2)], [-(OMEGA**2) * np.eye(2), 2.0 * turn * J]])
    return np.array([expm(flow * t) for t in times])


def fitted(x: np.ndarray, turn: float, times: np.ndarray, phase: float) -> np.ndarray:
    """Complex envelope at t = 0 of positions x, shape (times, 2), that the slow flow turns by ``turn``."""
    rows = []
    for t in times:
        turned = expm(turn * t * J)
        carrier = np.exp(1j * (math.hypot(OMEGA, turn) * t + phase))
        rows.append(np.hstack([(carrier * turned).real, -(carrier * turned).imag]))
    solved = np.linalg.lstsq(np.concatenate(rows), x.ravel(), rcond=None)[0]
    return solved[:2] + 1j * solved[2:]


@pytest.mark.parametrize("phase", [0.0, 0.4, 1.3, 2.6])
def test_the_jump_is_that_of_the_phase(phase: float) -> None:
    """Motion and velocity go on: integrated exactly from the step on, fitted behind it."""
    times = np.linspace(0.1e-3, 2e-3, 57)
    before = np.array([0.8, 0.3 + 2e-3j])
    state = np.concatenate([(before * np.exp(1j * phase)).real, (1j * OMEGA * before * np.exp(1j * phase)).real])
    after = fitted((courses(TURN, times) @ state)[:, :2], TURN, times, phase)
    predicted = 1j * TURN / (2.0 * OMEGA) * (1.0 + np.exp(-2j * phase)) * (J @ before.real)
    np.testing.assert_allclose(after - before, predicted, atol=0.02 * abs(TURN) / OMEGA)


@cache
def hemisphere(*, wanders: bool = True) -> CampaignModel:
    """A healthy one, whose simulated table steps from one converter sample to the next."""
    device = draw_unit(load_device("hrg_hardware"), 5)
    if not wanders:
        device = replace(device, environment=replace(device.environment, wander_k=0.0))
    instrument = SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(3), fidelity="carrier"), 2e-5)
    return looked_at(run_plan(instrument, gap_whole_angle_plan(device.factory(), quality="quick", abilities=("applied_rate",))))


@pytest.mark.slow
def test_every_step_has_a_phase_of_its_own() -> None:
    found = {name: value for name, value in hemisphere().base.by_name().items() if name.startswith("table_step_")}
    assert len(found) == 2 * 4 * 2
    # over dOmega / 2 w each is kappa times a unit vector: the prior takes a little of it
    assert math.sqrt(sum(v**2 for v in found.values()) / 8) == pytest.approx(0.55, rel=0.3)


@pytest.mark.slow
def test_what_a_step_leaves_is_neither_noise_nor_an_effect() -> None:
    model = hemisphere()
    along, across = (model.noise["turned", channel].coefficients for channel in ("amplitude", "precession"))
    assert across[2] < 5.0 * along[2]
    ((_, sd),) = loudest(model, "rate_asymmetry").sizes().values()
    assert sd < 3e-6
    assert loudest(model, "rate_nonlinearity").gain < 9.0


@pytest.mark.slow
def test_what_no_wander_hides_is_no_centrifugal_stiffness() -> None:
    """``kappa^2 / w``, what a Coriolis force of the volts alone lacks, was 9.5e-6 of a hemisphere whose resonance stands still."""
    model = hemisphere(wanders=False)
    found = model.screener.screen(model.candidates["centrifugal_stiffness"][0])
    assert found is not None
    ((value, sd),) = found.sizes().values()
    assert sd < 2e-6
    assert abs(value) < 4.0 * sd
