"""L by parts against L as it is written, for a wave that turns while its resonance moves: every path that projects it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from gyro_calib.estimation.projection import project
from gyro_calib.estimation.projection import test_functions as lines_of_test
from gyro_calib.estimation.wave_projection import Products, frame_directions, thin
from gyro_calib.gap.signals import Signals
from gyro_calib.recording.columns import COLUMNS
from gyro_calib.recording.command import Command, Setpoints
from gyro_calib.recording.recording import Recording

OMEGA0, DECAY = 2 * np.pi * 5000.0, 0.05
#: warming of silica: 3.4 Hz in the record; precession psi' [rad/s]
RAMP_RAD_S2, TURN_RAD_S = 2 * np.pi * 3.4 / 10.0, 0.26
#: what may be left [V/s]; the term that was missing is 4e-5
LEAST = 2e-8


@pytest.fixture(scope="module")
def recording() -> Recording:
    t = np.arange(10_000) / 1000.0
    turned = np.column_stack([np.cos(TURN_RAD_S * t), np.sin(TURN_RAD_S * t)])
    rows = np.zeros((t.size, len(COLUMNS)))
    rows[:, 0], rows[:, 1] = t, 1.0
    rows[:, 2], rows[:, 4] = turned.T
    rows[:, 10] = (OMEGA0 + RAMP_RAD_S2 * (t - 5.0)) / (2 * np.pi)
    rows[:, 11] = 25.0
    command = Command("whole_angle", setpoints=Setpoints(virtual_precession_v=1.0))
    return Recording(label="turning", device_id="d", sample_rate_hz=1000.0, data=rows, command=command)


def written(recording: Recording) -> NDArray[np.complex128]:
    """L[V] of the analytic wave, derivatives by hand (doc/sideband.md, equation 1)."""
    t, omega = recording.t, recording.ref_omega_rad_s
    n = recording.pick
    first = TURN_RAD_S * np.column_stack([-np.sin(TURN_RAD_S * t), np.cos(TURN_RAD_S * t)])
    second = -(TURN_RAD_S**2) * n
    s = omega[:, None]
    moved = (s / OMEGA0) * first + (second + 1j * RAMP_RAD_S2 * n + 2 * DECAY * first) / (2j * OMEGA0)
    return moved + (1j * (s**2 - OMEGA0**2) + 2 * DECAY * (s - OMEGA0)) / (2 * OMEGA0) * n


def expected(recording: Recording, lines: list[float], width: int) -> NDArray[np.complex128]:
    """Projection of it, along the wave and across, x and y."""
    row_s = width / recording.sample_rate_hz
    phi = lines_of_test(thin(recording.t, width), row_s, lines).value
    flow = written(recording)
    directions, _ = frame_directions(recording)
    sides = [row_s * phi @ thin(np.sum(d.m * flow, axis=1), width) for d in directions]
    return np.concatenate(sides)


def test_in_the_frame_of_the_wave(recording: Recording) -> None:
    lines = [0.0, 0.2, 0.4]
    found = Products(recording, OMEGA0, DECAY).project(lines).lhs
    assert np.abs(found - expected(recording, lines, 10)).max() < LEAST


def test_in_the_axes(recording: Recording) -> None:
    lines = [0.0, 0.2, 0.4]
    phi = lines_of_test(recording.t, 1e-3, lines).value
    found = project(recording, lines, OMEGA0, DECAY).lhs
    assert np.abs(found - 1e-3 * phi @ written(recording)).max() < LEAST


def test_row_by_row(recording: Recording) -> None:
    signals = Signals(recording, OMEGA0, DECAY, 1, 25.0, 0.0)
    found = signals.speed_of(signals.pick)[5:-5]
    # what a second derivative is of the carrier is left out, and nothing else: 4e-5 rad/s of the ramp are not
    second = (-(TURN_RAD_S**2) * signals.pick + 2.0 * DECAY * np.gradient(signals.pick, signals.row_s, axis=0)) / (2j * OMEGA0)
    assert np.abs(found + second[5:-5] - written(recording)[5:-5]).max() < LEAST


def test_in_the_forms_of_effects(recording: Recording) -> None:
    lines = [0.0, 0.2, 0.4]
    signals = Signals(recording, OMEGA0, DECAY, 10, 25.0, 0.0)
    found = signals.projector(lines).through_flow([signals.pick])[:, 0]
    # a form is a small part of the motion: it may be formed of thinned signals
    exact = expected(recording, lines, 10)
    assert np.abs(found - exact).max() < 3e-6 * np.abs(exact).max()
    assert np.abs((found - exact)[len(lines) * 2 - 1 :]).max() < 100 * LEAST


@pytest.mark.parametrize("rate_rad_s", [0.87, -0.87, 3.0])
def test_a_wave_on_a_table_by_the_exact_solution(recording: Recording, rate_rad_s: float) -> None:
    """``x'' + w^2 x = -2 kappa Omega J x'`` turns the wave by ``-kappa Omega`` at ``sqrt(w^2 + (kappa Omega)^2)``.

    With Coriolis's force of V alone, and not of the velocity, a quiet hemisphere had a centrifugal stiffness of ``kappa^2 / w``.
    """
    kappa, t = 0.55, recording.t
    turn = -kappa * rate_rad_s
    carrier = np.exp(1j * (np.hypot(OMEGA0, turn) - OMEGA0) * t)
    data = recording.data.copy()
    V = carrier[:, None] * np.column_stack([np.cos(turn * t), np.sin(turn * t)])
    data[:, 2:6] = np.ascontiguousarray(V).view(np.float64).reshape(len(V), 4)
    data[:, 10] = OMEGA0 / (2 * np.pi)
    words = {"kind": "steps from t after the start of the record", "t_s": [0.0], "rad_s": [rate_rad_s]}
    turned = replace(recording, data=data, extras={**recording.extras, "applied_rate": words})
    p = Products(turned, OMEGA0, 0.0).project([0.0, 0.2, 0.4])
    left = p.lhs - kappa * (p.rate_pick[:, 0, 1] - p.rate_pick[:, 1, 0])
    assert np.abs(left).max() < 0.02 * turn**2 / OMEGA0


@pytest.fixture(scope="module")
def late(recording: Recording) -> Recording:
    """The same while it warms, behind whose ramp the reference comes late: a phase of a milliradian that sets in."""
    data = recording.data.copy()
    V = recording.pick * np.exp(1j * behind(recording.t))[:, None]
    data[:, 2:6] = V.view(np.float64).reshape(len(V), 4)
    data[:, 11] = 25.0 + 0.8 * recording.t
    return replace(recording, data=data)


def behind(t: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(1e-3 * np.tanh(t - 5.0))


def test_in_the_frame_that_keeps_the_phase_of_the_wave(late: Recording) -> None:
    """By parts as it is written, derivatives of the rows by differences."""
    lines, t, omega, V = [0.0, 0.2, 0.4], late.t, late.ref_omega_rad_s[:, None], late.pick
    found = Products(late, OMEGA0, DECAY, in_phase=True).project(lines).lhs
    first = np.gradient(V, t, axis=0, edge_order=2)
    second = np.gradient(first, t, axis=0, edge_order=2)
    flow = (omega / OMEGA0) * first + (second + 1j * RAMP_RAD_S2 * V + 2 * DECAY * first) / (2j * OMEGA0)
    flow = flow + (1j * (omega**2 - OMEGA0**2) + 2 * DECAY * (omega - OMEGA0)) / (2 * OMEGA0) * V
    directions, _ = frame_directions(late, in_phase=True)
    phi = lines_of_test(thin(t, 10), 0.01, lines).value
    exact = np.concatenate([0.01 * phi @ thin(np.sum(d.m * flow, axis=1), 10) for d in directions])
    assert np.abs(found - exact).max() < 10 * LEAST


def test_a_resonance_that_wanders_while_it_warms_is_no_noise_of_the_amplitude(late: Recording) -> None:
    """Of a hemisphere it was as loud there as all other noise, and a healthy one had a lag of its frequency."""
    signals = Signals(late, OMEGA0, DECAY, 10, 25.0, 0.0)
    assert signals.is_warming
    wander = 3e-3 * np.sin(2 * np.pi * 0.31 * signals.time_s + 0.4)
    moved = 1j * wander[:, None] * signals.pick
    lines = [0.0, 0.2, 0.4]
    kept = signals.projector(lines).plain([moved])[:, 0]
    plain = replace(signals)
    plain.__dict__.update(signals.__dict__ | {"is_warming": False})
    plain.__dict__.pop("_frame", None)
    along = slice(0, len(kept) // 2)
    left = plain.projector(lines).plain([moved])[along, 0].real
    assert np.abs(left).max() > 1e-6
    assert np.abs(kept[along].real).max() < 0.02 * np.abs(left).max()
    assert np.abs(kept[along].imag).max() > 5e-4
