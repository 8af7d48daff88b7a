"""The two plants behind the simulator: buffers and per-row physics for the carrier kernel and for the slow-flow kernel."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..device import Device, J
from ..device.operating_point import OperatingPoint
from . import carrier, control, filters
from .slow_flow import slow_flow_rows

__all__ = ["CarrierPlant", "Plant", "SlowFlowPlant"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


class Plant(Protocol):
    """Advances the physics; ``param`` holds the loop parameters in force."""

    param: FloatArray
    row_delay_s: float

    def __init__(self, device: Device, rng: np.random.Generator, loop: FloatArray, start: OperatingPoint, *, noisy: bool) -> None: ...

    def rows(self, rate_rad_s: FloatArray, temperature_degc: FloatArray) -> FloatArray:
        """Next rows: eight channels [V] and the reference frequency [rad/s], shape (n, 9)."""


class _Base:
    """What both plants share: filters, loop state, noise levels, scaling with temperature."""

    def __init__(self, device: Device, rng: np.random.Generator, loop: FloatArray, start: OperatingPoint, *, noisy: bool) -> None:
        e = device.electronics
        self.device = device
        self.rng = rng
        self.noisy = noisy
        self.loop = loop
        self.param = np.zeros(control.N_PARAM)
        self.adc_w = filters.polyphase_weights(e.samples_per_control)
        self.row_w = filters.polyphase_weights(e.controls_per_row)
        samples = filters.group_delay_samples(e.samples_per_control) + e.samples_per_control * filters.group_delay_samples(
            e.controls_per_row
        )
        # a row ends with its newest sample at (count * samples - 1) sample times
        self.row_delay_s = (samples + 1.0) / e.adc_rate_hz
        volts = start.pick + device.feedthrough.matrix() @ start.drive
        self.channels0 = np.array(
            [volts[0].real, volts[0].imag, volts[1].real, volts[1].imag, *loop[control.S_DRIVE : control.S_DRIVE + 4]]
        )
        self.held = np.tile(np.append(self.channels0[4:], loop[control.S_OMEGA]), (3, 1))
        # accumulators hold what earlier, steady samples would have left behind
        tail = np.array([self.row_w[1:].sum(), self.row_w[2].sum(), 0.0])
        self.row_acc = tail[:, None] * np.append(self.channels0, loop[control.S_OMEGA])[None, :]

    def force_psd(self, temperature_degc: float) -> float:
        """Two-sided density of the force noise per mass [(m/s^2)^2/Hz]."""
        if not self.noisy:
            return 0.0
        noise = self.device.noise
        thermal = self.device.resonator.thermal_acceleration_psd(temperature_degc) if noise.thermomechanical else 0.0
        return thermal + 0.5 * (noise.drive_v_rthz * self.device.drive.gain_m_s2_per_v) ** 2

    def pickoff_density(self) -> float:
        """One-sided amplitude density of the pick-off noise [V/sqrt(Hz)]."""
        return self.device.noise.pickoff_v_rthz if self.noisy else 0.0

    def normals(self, count: int, columns: int) -> NDArray[np.float32]:
        if not self.noisy:
            return np.zeros((count, columns), dtype=np.float32)
        return self.rng.standard_normal((count, columns), dtype=np.float32)


class CarrierPlant(_Base):
    """Every converter sample."""

    def __init__(self, device: Device, rng: np.random.Generator, loop: FloatArray, start: OperatingPoint, *, noisy: bool) -> None:
        super().__init__(device, rng, loop, start, noisy=noisy)
        omega = loop[control.S_OMEGA]
        self.w = device.resonator.omega0_rad_s
        motion = np.linalg.solve(device.pickoff.matrix(self._rise0()), start.pick)
        self.z = np.concatenate([motion.real, -motion.imag * omega / self.w])
        tail = np.array([self.adc_w[1:].sum(), self.adc_w[2].sum(), 0.0])
        self.adc_acc = tail[:, None] * self.channels0[None, :4]
        e = device.electronics
        full = (e.adc_full_scale_v, e.dac_full_scale_v)
        self.converters = np.array(
            [
                full[0],
                2.0 * full[0] / 2**e.adc_bits if e.adc_bits else 0.0,
                full[1],
                2.0 * full[1] / 2**e.dac_bits if e.dac_bits else 0.0,
                device.pickoff.cubic_per_v2,
            ]
        )
        self.flags = (
            (carrier.FLAG_NONLINEAR if any(device.nonlinearity.coefficients) else 0)
            | (carrier.FLAG_PICKOFF_CUBIC if device.pickoff.cubic_per_v2 else 0)
            | carrier.FLAG_CONVERTERS
        )

    def _rise0(self) -> float:
        return self.device.temperature_rise(self.device.environment.temperature_degc)

    def rows(self, rate_rad_s: FloatArray, temperature_degc: FloatArray) -> FloatArray:
        """See :class:`Plant`."""
        d, count = self.device, rate_rad_s.size
        dt = 1.0 / d.electronics.adc_rate_hz
        mean = float(temperature_degc.mean())
        const = np.array([dt, self.w, math.sqrt(self.force_psd(mean) * dt) / self.w, self.pickoff_density() * math.sqrt(0.5 / dt)])
        noise = self.normals(count * self.row_w.shape[1] * self.adc_w.shape[1], 4)
        out = np.empty((count, 9))
        rise = temperature_degc - d.resonator.reference_temperature_degc
        drive = _scaled(_flat(d.drive.matrix()), 1.0 + d.drive.gain_tempco_per_k * rise)
        pick = _scaled(_flat(d.pickoff.matrix()), 1.0 + d.pickoff.gain_tempco_per_k * rise)
        carrier.carrier_rows(
            self.z, self.loop, self.param, self.adc_acc, self.held, self.row_acc, self.adc_w, self.row_w,
            _row_physics(d, rate_rad_s, temperature_degc), drive, pick, _flat(d.feedthrough.matrix()), d.drive.gain_m_s2_per_v,
            np.array(d.nonlinearity.coefficients), self.converters, const, self.flags, noise, out,
        )  # fmt: skip
        return out


class SlowFlowPlant(_Base):
    """Theory.md Eq. 3 at the control rate; converter effects do not exist here."""

    def __init__(self, device: Device, rng: np.random.Generator, loop: FloatArray, start: OperatingPoint, *, noisy: bool) -> None:
        super().__init__(device, rng, loop, start, noisy=noisy)
        self.p = start.pick.astype(complex)
        volts = start.pick + device.feedthrough.matrix() @ start.drive
        self.means = np.tile(volts, (3, 1))
        self.pick = device.pickoff.matrix()

    def rows(self, rate_rad_s: FloatArray, temperature_degc: FloatArray) -> FloatArray:
        """See :class:`Plant`."""
        d, count = self.device, rate_rad_s.size
        # the flow is interpolated between the extremes of the stretch: its change over a quarter of a second is linear in temperature
        cold, hot = float(temperature_degc.min()), float(temperature_degc.max())
        low, high = d.slow_flow(0.0, cold), d.slow_flow(0.0, hot)
        share = ((temperature_degc - cold) / (hot - cold) if hot > cold else np.zeros(count))[:, None, None]
        a = low.A + share * (high.A - low.A) + rate_rad_s[:, None, None] * low.dA_dOmega
        g = low.G + share * (high.G - low.G)
        omega0 = low.omega0_rad_s + share[:, 0, 0] * (high.omega0_rad_s - low.omega0_rad_s)
        body = (-0.5j / low.omega0_rad_s * self.pick @ np.ones(2)) * d.drive.gain_m_s2_per_v
        period = 1.0 / d.electronics.control_rate_hz
        response = d.pickoff.gain_v_per_m / (2.0 * low.omega0_rad_s)
        nonlinear = np.array(d.nonlinearity.coefficients)
        const = np.array(
            [
                period,
                math.sqrt(2.0 * self.force_psd(cold) * period) * response,
                self.pickoff_density() / math.sqrt(period),
                float(nonlinear.any()),
            ]
        )
        out = np.empty((count, 9))
        slow_flow_rows(
            self.p, self.loop, self.param, self.means, self.held, self.row_acc, self.adc_w.sum(axis=1), self.row_w, a, g,
            np.tile(body, (count, 1)), self.pick, np.linalg.inv(self.pick), nonlinear, d.feedthrough.matrix(), omega0, const,
            self.normals(count * self.row_w.shape[1], 8), out,
        )  # fmt: skip
        return out


def _flat(matrix: ComplexArray) -> FloatArray:
    """Complex 2x2 as re, im of xx, xy, yx, yy, shape (8,)."""
    return np.ascontiguousarray(matrix.reshape(4)).view(np.float64).copy()


def _scaled(flat: FloatArray, factor: FloatArray) -> FloatArray:
    return np.ascontiguousarray(factor[:, None] * flat[None, :])


def _row_physics(device: Device, rate_rad_s: FloatArray, temperature_degc: FloatArray) -> FloatArray:
    """k11, k12, k22, c11, c12, c21, c22 of each row, shape (n, 7), linear in temperature between the extremes of the stretch."""
    r = device.resonator
    cold, hot = float(temperature_degc.min()), float(temperature_degc.max())
    k0, k1 = r.stiffness_matrix(cold), r.stiffness_matrix(hot)
    d0, d1 = r.damping_matrix(cold), r.damping_matrix(hot)
    share = (temperature_degc - cold) / (hot - cold) if hot > cold else np.zeros_like(temperature_degc)
    k = k0 + share[:, None, None] * (k1 - k0)
    c = d0 + share[:, None, None] * (d1 - d0) + 2.0 * r.angular_gain * rate_rad_s[:, None, None] * J
    return np.column_stack([k[:, 0, 0], k[:, 0, 1], k[:, 1, 1], c[:, 0, 0], c[:, 0, 1], c[:, 1, 0], c[:, 1, 1]])
