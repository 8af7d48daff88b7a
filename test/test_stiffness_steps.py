"""A stiffness that follows its temperature row by row moves the amplitude as a slow change does, wherever the carrier happens to be.

And the image that steps leave where a plant has them (`gyro_calib.gap.images`).
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from gyro_calib.device import load_device
from gyro_calib.gap.images import _mirror
from gyro_calib.gap.signals import Signals
from gyro_calib.recording.command import Command
from gyro_calib.simulation import GyroSimulator

FloatArray = NDArray[np.float64]
#: what a ramp passes at its middle, its speed, and how long it takes
CARRIER_HZ, SLOPE_HZ_S, SPAN_S = 5000.0, 0.35, 4.0


class _Released(GyroSimulator):
    """A simulator whose drives are off from the start."""

    def __init__(self, device: Any) -> None:
        super().__init__(device, rng=np.random.default_rng(0), noisy=False)
        self.configure(Command("loops_off"))
        self._plant.loop[7:12] = 0.0

    def motion(self) -> FloatArray:
        """x, y, x'/w, y'/w [m]."""
        return np.array(self._plant.z[:4])


def test_a_warmed_resonator_keeps_its_action() -> None:
    """Twice the carrier passes a multiple of the rows' rate: rows of stepped stiffness would move it by 5.5e-5 there."""
    device = load_device("hrg_hardware")
    resonator = replace(device.resonator, quality_factor=1e15, frequency_split_hz=0.0, damping_anisotropy=0.0, quality_exponent=0.0)
    tempco = resonator.frequency_tempco_per_k
    ramp = SLOPE_HZ_S / (tempco * CARRIER_HZ)
    start = CARRIER_HZ - 0.5 * SLOPE_HZ_S * SPAN_S
    device = replace(
        device,
        resonator=replace(resonator, frequency_hz=start, reference_temperature_degc=device.environment.temperature_degc),
        environment=replace(device.environment, wander_k=0.0, ramp_k_per_s=ramp),
    )
    simulator = _Released(device)
    w = device.resonator.omega0_rad_s
    action = []
    for _ in range(int(SPAN_S / 0.05)):
        simulator.advance(0.05)
        # the stiffness of the last row
        omega = float(np.sqrt(simulator._plant.z[4]))
        x, y, vx, vy = simulator.motion()
        energy = 0.5 * (omega**2 * (x * x + y * y) + w**2 * (vx * vx + vy * vy))
        action.append(energy / omega)
    assert omega / w - 1.0 == pytest.approx(SLOPE_HZ_S * SPAN_S / start, rel=0.01)
    assert np.ptp(action) / np.mean(action) < 1e-7


def test_the_image_of_a_stepped_stiffness_has_the_size_of_the_formula() -> None:
    """An oscillator whose stiffness is renewed a hundred times a second, as it turns exactly in between."""
    rate_hz = 100.0
    count = round(SPAN_S * rate_hz)
    omega = 2.0 * np.pi * (CARRIER_HZ + SLOPE_HZ_S * (np.arange(count) / rate_hz - 0.5 * SPAN_S))
    x, v, amplitude = 1.0, 0.0, []
    for w in omega:
        amplitude.append(np.hypot(x, v / w))
        c, s = np.cos(w / rate_hz), np.sin(w / rate_hz)
        x, v = x * c + v / w * s, v * c - w * x * s
    # what a slow change does is no image
    seen = np.log(amplitude) + 0.5 * np.log(omega)
    mirror = _mirror(cast(Signals, SimpleNamespace(omega_rad_s=omega, row_s=1.0 / rate_hz)))
    assert mirror is not None
    force = np.gradient(omega, 1.0 / rate_hz) * mirror[:, 0]
    told = np.cumsum(force) / rate_hz
    design = np.column_stack([told.real, told.imag, np.ones(count)])
    sizes = np.linalg.lstsq(design, seen, rcond=None)[0]
    assert np.ptp(seen) > 2e-5
    assert np.hypot(*sizes[:2]) == pytest.approx(1.0, abs=0.02)
    assert np.std(seen - design @ sizes) < 0.05 * np.std(seen)
