"""Whole-angle recordings from theory.md Eq. 3 by Runge-Kutta: no line of it is shared with the simulator or with the estimators."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gyro_calib.recording.command import Command, Setpoints
from gyro_calib.recording.recording import Campaign, Recording

ComplexArray = NDArray[np.complex128]
J = np.array([[0.0, -1.0], [1.0, 0.0]])
#: drives that hold the wave: volts per volt of amplitude and quadrature error, rad/s per rad of phase error
STIFF = 60.0


@dataclass
class WaveWorld:
    """A gyro by its slow flow; ``run`` goes on where the last run ended."""

    A: ComplexArray
    G: ComplexArray
    omega0: float = 2 * np.pi * 5000.0
    rate_hz: float = 100.0
    distort: Callable[[ComplexArray], ComplexArray] = field(default=lambda p: p)
    force: Callable[[ComplexArray], ComplexArray] = field(default=lambda p: 0.0 * p)
    state: ComplexArray = field(default_factory=lambda: np.array([1.0, 0.0], dtype=complex))
    time: float = 0.0

    def run(
        self,
        duration: float,
        *,
        precession: float = 0.0,
        gain: float | None = None,
        stiffness: float = 0.0,
        amplitude: float = 1.0,
        label: str = "",
    ) -> Recording:
        """Rows of a whole-angle run; with ``gain`` a ring-down or ring-up (drive along the wave = i gain p)."""
        rows, steps, row_s = round(duration * self.rate_hz), 4, 1.0 / self.rate_hz
        data = np.zeros((rows, 12))
        h = row_s / steps
        for row in range(rows):
            for step in range(steps):
                if step == steps // 2:
                    volts, drive, shift = self._loops(self.state, precession, gain, stiffness, amplitude)
                    data[row, 0] = self.time
                    data[row, 2:6] = volts.view(float)
                    data[row, 6:10] = drive.view(float)
                    data[row, 10] = (self.omega0 + shift) / (2 * np.pi)
                self.state = self._advance(h, precession, gain, stiffness, amplitude)
                self.time += h
        data[:, 11] = 25.0
        mode = "whole_angle" if gain is None else ("ring_down" if gain < 0 else "ring_up")
        if stiffness:
            mode = "stiffness"
        setpoints = Setpoints(amplitude, precession, stiffness, 0.0 if gain is None else gain)
        return Recording("integrated", data, Command(mode, setpoints=setpoints), self.rate_hz, label)

    def campaign(self, recordings: list[Recording], **factory: object) -> Campaign:
        known = {"angular_gain_kappa": 0.55, "nominal_f0_hz": 5000.0, "nominal_q": 2e5, "nominal_amplitude_v": 1.0, "kind": "hrg"}
        return Campaign("integrated", tuple(recordings), known | factory)

    def _loops(
        self, p: ComplexArray, precession: float, gain: float | None, stiffness: float, amplitude: float
    ) -> tuple[ComplexArray, ComplexArray, float]:
        volts = self.distort(p)
        phase = 0.5 * np.angle(np.sum(volts**2))
        turned = volts * np.exp(-1j * phase)
        if turned.real @ self._before < 0:  # the same wave, half a turn on
            turned, phase = -turned, phase + np.pi
        n = turned.real / np.linalg.norm(turned.real)
        self._before = n
        m = J @ n
        a, q = float(np.linalg.norm(turned.real)), -float(turned.imag @ m)
        along = STIFF * (amplitude - a) if gain is None else gain * a
        phase = (phase + np.pi / 2) % np.pi - np.pi / 2
        drive = (1j * along + stiffness * a) * n + (-STIFF * q + 1j * precession) * m
        return volts, drive * np.exp(1j * phase), STIFF * phase

    _before = np.array([1.0, 0.0])

    def _slope(self, p: ComplexArray, *controls: float) -> ComplexArray:
        _, drive, shift = self._loops(p, *controls)  # type: ignore[arg-type]
        return self.A @ p - 1j * shift * p + self.G @ drive + self.force(p)

    def _advance(self, h: float, *controls: float | None) -> ComplexArray:
        p = self.state
        k1 = self._slope(p, *controls)  # type: ignore[arg-type]
        k2 = self._slope(p + 0.5 * h * k1, *controls)  # type: ignore[arg-type]
        k3 = self._slope(p + 0.5 * h * k2, *controls)  # type: ignore[arg-type]
        k4 = self._slope(p + h * k3, *controls)  # type: ignore[arg-type]
        return p + h / 6.0 * (k1 + 2 * k2 + 2 * k3 + k4)


def slow_flow(
    *,
    delta_g: float = -0.027,
    two_delta: float = 3.6e-3,
    two_lambda: float = -0.022,
    decay: float = 0.084,
    anisotropy: float = 1.2e-3,
    split: float = 0.012,
    kappa_rate: float = 0.0,
    gain: float = 0.13,
) -> tuple[ComplexArray, ComplexArray]:
    """A and G of a gyro with perfect pick-offs (theory.md Eqs. 1, 4 and 8)."""

    def axes(alpha: float) -> NDArray[np.float64]:
        return np.array([[np.cos(alpha), np.sin(alpha)], [np.sin(alpha), -np.cos(alpha)]])

    A = -decay * np.eye(2) - 0.5 * anisotropy * axes(0.7) + 0.5j * split * axes(1.9) - kappa_rate * J
    a, b = np.tan(two_delta), np.tan(two_lambda)
    G = -1j * gain * np.array([[1.0, a - b], [a + b, 1.0 + delta_g]])
    return np.asarray(A, dtype=complex), G
