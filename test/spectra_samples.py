"""Held waves with noise, hums and tones, without a resonator behind them."""

from __future__ import annotations

import numpy as np

from gyro_calib.gap.parts import Linear
from gyro_calib.recording.columns import COLUMNS
from gyro_calib.recording.command import Command, Setpoints
from gyro_calib.recording.recording import Recording

ROWS_HZ, NOISE_V = 500.0, 2e-6
#: axes of a ring that ring alike; G turns a volt into -8i V/s
LINEAR = Linear(-1.5 * np.eye(2) + 0j, -8j * np.eye(2), np.zeros((2, 2), complex), 0.8, 0.0)


def records(
    rng: np.random.Generator,
    *,
    carrier_hz: tuple[float, ...] = (15000.0, 15000.3),
    hum: tuple[float, float] = (0.0, 0.0),
    tone: tuple[float, float] = (0.0, 0.0),
    ripple: tuple[float, float] = (0.0, 0.0),
    gain: float = 0.0,
    clock: float = 0.0,
    of_each: int = 3,
) -> list[Recording]:
    """Held waves of three amplitudes: hum (Hz, V), tone (Hz, V on the pick-off), ripple (Hz, 1), noise of gain and phase per row."""
    found = []
    for k, amplitude in enumerate((0.6, 1.0, 1.4) * of_each):
        count = 5000
        t = 20.0 * k + np.arange(count) / ROWS_HZ
        f = carrier_hz[k % len(carrier_hz)]
        wave = amplitude * (1.0 + gain * rng.standard_normal(count) + 1j * clock * rng.standard_normal(count))
        wave *= 1.0 + ripple[1] * np.cos(2 * np.pi * ripple[0] * t)
        wave = wave + hum[1] * np.cos(2 * np.pi * hum[0] * t) + tone[1] * np.exp(2j * np.pi * (tone[0] - f) * t)
        noise = NOISE_V * (rng.standard_normal((count, 2)) + 1j * rng.standard_normal((count, 2)))
        rows = np.zeros((count, len(COLUMNS)))
        rows[:, 0], rows[:, 1] = t, k + 1.0
        for axis, x in enumerate((wave + noise[:, 0], noise[:, 1])):
            rows[:, 2 + 2 * axis], rows[:, 3 + 2 * axis] = x.real, x.imag
        rows[:, 10], rows[:, 11] = f, 25.0
        command = Command("ftr_x", setpoints=Setpoints(amplitude_v=amplitude))
        found.append(Recording("ring", rows, command, ROWS_HZ, f"static_{k}"))
    return found
