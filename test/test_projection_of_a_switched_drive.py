"""Rows of a drive that is switched within a record: what folds at their rate, and what the switch does at twice the carrier."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from gyro_calib.estimation.projection import test_functions as lines_of_test
from gyro_calib.estimation.wave_projection import spectral_derivatives
from gyro_calib.simulation.filters import boxcar_cascade

DECAY, GAIN = 0.0475, 0.22
FINE_HZ, ROW_HZ, RECORD_S, SWITCHED_S = 8000, 100, 2.0, 1.4
#: pick-off noise of a hemisphere on such a record's lines [V/s]
NOISE = 2.5e-6


def switched() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rows of p and u of p' = -DECAY p + GAIN u, through the logger's filter: held, driven down from 0 s on, held again."""
    t = (np.arange(round(-0.2 * FINE_HZ), round((RECORD_S + 0.2) * FINE_HZ)) + 0.5) / FINE_HZ
    held = DECAY / GAIN
    falling = DECAY + 2.0 * GAIN
    down = np.exp(-falling * np.clip(t, 0.0, SWITCHED_S))
    u = np.where(t < 0.0, held, np.where(t < SWITCHED_S, -2.0 * down, held * down))
    n = FINE_HZ // ROW_HZ
    centre = (3 * n - 3) // 2
    last = np.searchsorted(t, 0.0) + n * np.arange(1, round(RECORD_S * ROW_HZ) + 1)
    return tuple(np.convolve(x, boxcar_cascade(n))[last + centre] for x in (down, u))  # type: ignore[return-value]


def test_a_switched_drive_does_not_fold_into_the_lines() -> None:
    """With a window that rises over 12 rows it left 2.3 standard deviations of a hemisphere's noise, as a memory of 0.15 s would."""
    p, u = switched()
    t = (np.arange(p.size) + 0.5) / ROW_HZ
    functions = lines_of_test(t, 1.0 / ROW_HZ, [k / RECORD_S for k in range(4)])
    slope, _ = spectral_derivatives(functions.value, 1.0 / ROW_HZ)
    left = -slope @ p - functions.value @ (GAIN * u - DECAY * p)
    assert np.abs(left).max() / ROW_HZ < 0.3 * NOISE


def test_a_falling_wave_by_parts_is_itself() -> None:
    """Over 3.7 s of rows of 8 ms; with ends of lower order it left 6e-7 of the wave, a memory of 50 ms in other hemispheres."""
    row_s, decay = 0.008, 0.5
    t = np.arange(465) * row_s
    wave = np.exp(-decay * t)
    functions = lines_of_test(t, row_s, [k / (t.size * row_s) for k in range(5)])
    first, second = spectral_derivatives(functions.value, row_s)
    assert np.abs(first @ wave - decay * functions.value @ wave).max() * row_s < 5e-8
    assert np.abs(second @ wave - decay**2 * functions.value @ wave).max() * row_s < 2e-7


def test_a_step_of_the_drive_kicks_the_wave_by_what_turns_at_twice_the_carrier() -> None:
    """An oscillator from rest, a drive that begins at one phase or another: beside G u t a jump of conj(G u) / 2 w, turned by -2 phase."""
    omega, gain, step = 2.0 * np.pi * 200.0, 3.0, 0.7
    end, cycle = 40.0 * np.pi / omega, 2.0 * np.pi / omega
    t = end + cycle * np.arange(64) / 64
    kicks = []
    for phase in (0.3, 1.4, 2.9):

        def acceleration(t: float, y: NDArray[np.float64], phase: float = phase) -> list[float]:
            return [y[1], -(omega**2) * y[0] - 2.0 * omega * gain * step * np.sin(omega * t + phase)]

        y = solve_ivp(acceleration, (0.0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-11, atol=1e-13, max_step=0.05 * cycle).y
        wave = (y[0] - 1j * y[1] / omega) * np.exp(-1j * (omega * t + phase))
        kicks.append(np.mean(wave - gain * step * t) * np.exp(2j * phase))
    np.testing.assert_allclose(np.abs(kicks), gain * step / (2.0 * omega), rtol=1e-3)
    assert np.ptp(np.angle(kicks)) < 1e-3
