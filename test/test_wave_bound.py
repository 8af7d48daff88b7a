"""The whole-angle Cramer-Rao bound against a direct Fisher information, its scaling, and a few campaigns of the estimator it judges."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from wave_integrator import WaveWorld, slow_flow

from gyro_calib.estimation.wave_bound import WaveNoise, wave_bound
from gyro_calib.recording.recording import Recording
from gyro_calib.simulation.flicker import FLICKER_TIMES_S
from gyro_calib.study import find_study

WHITE = WaveNoise(1e-14, 0.0, 0.0, FLICKER_TIMES_S)


@pytest.fixture(scope="module")
def recordings() -> list[Recording]:
    world = WaveWorld(*slow_flow(), rate_hz=50.0)
    world.run(1.0)
    speeds = ((12.0, 4.0), (12.0, -4.0), (6.0, 2.0), (4.0, 0.0))
    return [world.run(duration, precession=volts) for duration, volts in speeds] + [world.run(4.0, gain=-2.0), world.run(4.0, gain=2.0)]


def bound(recordings: list[Recording], noise: WaveNoise, **options: float) -> np.ndarray:
    return wave_bound(recordings, 2 * np.pi * 5000.0, noise, slow_flow(), has_feedthrough=False, bodies=[], **options)


def test_white_forces_alone_give_the_fisher_information_of_the_rows(recordings: list[Recording]) -> None:
    information = np.zeros((8, 8))
    for r in recordings:
        columns = np.hstack([r.pick, r.drive])
        real = np.zeros((2 * len(r), 8))
        real[: len(r), 0::2], real[: len(r), 1::2] = columns.real, -columns.imag
        real[len(r) :, 0::2], real[len(r) :, 1::2] = columns.imag, columns.real
        information += real.T @ real / (WHITE.force * r.sample_rate_hz)
    sd, direct = np.sqrt(np.diag(bound(recordings, WHITE, block_s=0.1))), np.sqrt(np.diag(np.linalg.inv(information)))
    # what a triangle at either end of a record leaves out
    np.testing.assert_allclose(sd[:8], direct, rtol=0.06)
    np.testing.assert_allclose(sd[8:], direct, rtol=0.06)


def test_bound_scales_with_the_noise_and_not_with_the_blocks(recordings: list[Recording]) -> None:
    noise = WaveNoise(3.4e-15, 4e-14, 1.4e-7, FLICKER_TIMES_S)
    louder = replace(noise, force=4 * noise.force, pickoff=4 * noise.pickoff, flicker_v=2 * noise.flicker_v)
    base = bound(recordings, noise)
    np.testing.assert_allclose(bound(recordings, louder), 4.0 * base, rtol=1e-6, atol=1e-9 * np.abs(base).max())
    sd, finer = np.sqrt(np.diag(base)), np.sqrt(np.diag(bound(recordings, noise, block_s=0.25)))
    np.testing.assert_allclose(finer, sd, rtol=0.12)
    for part in ("force", "pickoff", "flicker_v"):
        less = np.sqrt(np.diag(bound(recordings, replace(noise, **{part: 0.0}))))
        assert np.all(less <= sd * (1.0 + 1e-5))


def test_a_temperature_that_moves_costs_what_its_unknowns_do(recordings: list[Recording]) -> None:
    moved = []
    for k, r in enumerate(recordings):
        data = r.data.copy()
        data[:, 11] += 1e-3 * math.sin(2.0 * k) + 1e-4 * np.sin(0.3 * r.t)
        moved.append(replace(r, data=data))
    # as an unknown it scales out: a gyro that follows it strongly is known as well as one that hardly does
    still, small, large = (np.diag(bound(r, WHITE)) for r in (recordings, moved, [_scaled(r, 10.0) for r in moved]))
    assert np.all(small >= still * (1.0 - 1e-9))
    assert np.any(small > 1.01 * still)
    np.testing.assert_allclose(large, small, rtol=1e-4)


def _scaled(recording: Recording, factor: float) -> Recording:
    data = recording.data.copy()
    data[:, 11] = 25.0 + factor * (data[:, 11] - 25.0)
    return replace(recording, data=data)


def test_recordings_that_excite_too_little_have_no_bound(recordings: list[Recording]) -> None:
    with pytest.raises(np.linalg.LinAlgError, match="do not excite every parameter"):
        bound([replace(recordings[3], data=recordings[3].data[:100])], WHITE)


@pytest.mark.slow
def test_the_study_runs_and_its_gates_have_their_figures() -> None:
    study = find_study("precession-crb")
    # one seed stands for two: a scatter of one is not a number
    figures = {name: np.full(2, value) for name, value in study.run(4).items()}
    gates = {gate.name: gate for gate in study.summarise(figures)}
    assert all(math.isfinite(gate.value.value) for gate in gates.values())
    for name in ("delta_g", "two_delta", "two_lambda", "scale_factor_x", "scale_factor_y"):
        assert gates[f"{name}: bound (median)"].value.value < 2e-6
        assert np.abs(figures[f"{name}/crb"]).max() < 6.0
