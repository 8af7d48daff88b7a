"""The two plants behind the simulator: buffers and per-row physics for the carrier kernel and for the slow-flow kernel."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..device import Device, J
from ..device.electronics import SLOTS
from ..device.operating_point import OperatingPoint
from . import carrier, control_layout, filters
from .effect_envelope import ENVELOPE_EFFECTS, envelope_constants
from .effect_layout import E_CLOSED, N_EFFECT, N_MEMORY, N_ROW
from .effect_rows import SLOW_EFFECTS, SlowEffects, add_to_carrier, flow_with, kernel_rows
from .effect_setup import (
    converter_constants,
    kernel_constants,
    nonlinear_coefficients,
    refuse_without_envelope,
    started_memory,
    uses_kernel,
)
from .flicker import GAIN_TIMES_S, FlickerSource, floor_of_density
from .normals import NormalSource
from .propagator import MOTION
from .slow_flow import slow_flow_rows

__all__ = ["CarrierPlant", "Plant", "SlowFlowPlant"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: what depends on temperature is interpolated between multiples of this [K]
_NODE_K = 0.1
#: effects that make a chain flicker, and which
_FLICKERS = {"pickoff_gain_flicker": "pick", "drive_gain_flicker": "drive", "pickoff_phase_flicker": "pick"}


class Plant(Protocol):
    """Advances the physics; ``param`` holds the loop parameters in force, ``loop`` the state of the loops."""

    param: FloatArray
    loop: FloatArray
    row_delay_s: float

    def __init__(self, device: Device, rng: np.random.Generator, loop: FloatArray, start: OperatingPoint, *, noisy: bool) -> None: ...

    def rows(self, rate_rad_s: FloatArray, temperature_degc: FloatArray) -> FloatArray:
        """Next rows: eight channels [V] and the reference frequency [rad/s], shape (n, 9)."""


class _OverTemperature:
    """A vector over temperature, tabulated where it is needed; on a fixed grid, so that rows do not depend on how calls divide the time."""

    def __init__(self, at: Callable[[float], FloatArray]) -> None:
        self._at = at
        self._nodes: dict[int, FloatArray] = {}

    def table(self, temperature_degc: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Nodes around the temperatures, shape (nodes, columns), and the place of each temperature among them, 0 to nodes - 1."""
        place = temperature_degc / _NODE_K
        first, last = math.floor(place.min()), math.floor(place.max()) + 1
        for node in range(first, last + 1):
            if node not in self._nodes:
                self._nodes[node] = self._at(node * _NODE_K)
        return np.stack([self._nodes[node] for node in range(first, last + 1)]), place - first

    def rows(self, temperature_degc: FloatArray) -> FloatArray:
        """The vector at each temperature, shape (n, columns)."""
        table, place = self.table(temperature_degc)
        node = np.minimum(place.astype(np.intp), table.shape[0] - 2)
        return np.asarray(table[node] + (place - node)[:, None] * np.diff(table, axis=0)[node])


class _Base:
    """What both plants share: filters, loop state, noise levels, scaling with temperature."""

    def __init__(self, device: Device, rng: np.random.Generator, loop: FloatArray, start: OperatingPoint, *, noisy: bool) -> None:
        e = device.electronics
        self.device = device
        self.noisy = noisy
        self._normals = NormalSource(rng)
        flicker = device.noise.drive_flicker_v if noisy else 0.0
        self._flicker = FlickerSource(np.random.default_rng(rng.integers(0, 2**63, size=4)), flicker, 4, 1.0 / e.sample_rate_hz)
        self._has_flicker = flicker > 0.0
        self.loop = loop
        self.param = np.zeros(control_layout.N_PARAM)
        self.adc_w = filters.polyphase_weights(e.samples_per_control)
        self.shares = self.adc_w.sum(axis=1)
        n = e.samples_per_control
        multiplexing = device.multiplexing
        self.settling = round(multiplexing.settling_share * n) if multiplexing.enabled else 0
        # how far the centre of what the pick-offs are made of lies behind the end of a control period [samples]
        age = filters.group_delay_samples(n) + 1.0
        after: FloatArray | None = self.shares
        if multiplexing.enabled:  # every column is held over the frame instead
            age, after = 0.5 * (n - self.settling + 1) + 0.5 * (SLOTS - 1) * n, None
            loop[control_layout.S_HELD : control_layout.S_HELD + 4] = loop[control_layout.S_DRIVE : control_layout.S_DRIVE + 4]
            loop[control_layout.S_PAST : control_layout.S_PAST + 2] = loop[control_layout.S_OMEGA]
        self.row_w = np.stack([filters.polyphase_weights(e.controls_per_row, taps) for taps in (None, after)])
        self.row_delay_s = (age + n * filters.group_delay_samples(e.controls_per_row)) / e.adc_rate_hz
        volts = start.pick + device.feedthrough_matrix() @ start.drive
        self.channels0 = np.array(
            [volts[0].real, volts[0].imag, volts[1].real, volts[1].imag, *loop[control_layout.S_DRIVE : control_layout.S_DRIVE + 4]]
        )
        # accumulators hold what earlier, steady samples would have left behind
        tail = np.repeat([[w[1:].sum(), w[2].sum()] for w in self.row_w], [4, 5], axis=0).T
        self.row_acc = tail * np.append(self.channels0, loop[control_layout.S_OMEGA])

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

    def stray_drive(self, rows: int) -> FloatArray:
        """What reaches the electrodes besides the command in the next rows [V], shape (rows, 4); (0, 4) when nothing does."""
        return self._flicker.rows(rows) if self._has_flicker else np.zeros((0, 4))

    def normals(self, count: int) -> NDArray[np.float32]:
        """Standard normals, shape (count,); zeros without noise."""
        return self._normals.draw(count) if self.noisy else np.zeros(count, dtype=np.float32)


class _ChainFlicker:
    """What both axes of a chain are multiplied by row by row: gains or phases that flicker, of an effect's sizes."""

    def __init__(self, device: Device, effect: str, rng: np.random.Generator) -> None:
        own = np.random.default_rng(rng.integers(0, 2**63, size=4))
        self._of_phase = effect.endswith("_phase_flicker")
        sizes = device.effects[effect]
        self._floor = np.array([floor_of_density(sizes.get(f"{'p' if self._of_phase else 'g'}_{axis}", 0.0)) for axis in "xy"])
        self._source = FlickerSource(own, 1.0, 2, 1.0 / device.electronics.sample_rate_hz, GAIN_TIMES_S)

    def rows(self, count: int) -> NDArray[np.complex128]:
        """Factors of the next rows, shape (count, 2)."""
        moved = self._floor * self._source.rows(count)
        return np.exp(1j * moved) if self._of_phase else 1.0 + moved.astype(np.complex128)


class CarrierPlant(_Base):
    """Every converter sample."""

    def __init__(self, device: Device, rng: np.random.Generator, loop: FloatArray, start: OperatingPoint, *, noisy: bool) -> None:
        super().__init__(device, rng, loop, start, noisy=noisy)
        omega = loop[control_layout.S_OMEGA]
        self.w = device.resonator.omega0_rad_s
        self._physics = _OverTemperature(self._physics_at)
        motion = np.linalg.solve(device.pickoff_matrix(self._rise0()), start.pick)
        self.z = np.zeros(MOTION)
        self.z[:4] = np.concatenate([motion.real, -motion.imag * omega / self.w])
        tail = np.array([self.adc_w[1:].sum(), self.adc_w[2].sum()])
        if device.multiplexing.enabled:
            tail = np.array([1.0, 0.0])
        self.adc_acc = tail[:, None] * self.channels0[None, :4]
        self.converters = converter_constants(device)
        self.nonlinear = nonlinear_coefficients(device)
        self._slow = SlowEffects(device) if device.effects or uses_kernel(device) else None
        self.effect, self.memory = np.zeros(N_EFFECT), np.zeros(N_MEMORY)
        if uses_kernel(device):
            unpick = np.asarray(np.linalg.inv(device.pickoff_matrix(self._rise0())), dtype=np.complex128)
            volts = start.pick + device.feedthrough_matrix() @ start.drive
            self.effect = kernel_constants(device)
            self.memory = started_memory(self.effect, start.pick, volts, start.drive, unpick)
        # a stream of its own: a device without this noise keeps its rows
        self._gain_noise = np.random.default_rng(rng.integers(0, 2**63, size=4)) if noisy and "amplitude_noise" in device.effects else None
        # and so have gains and phases that flicker
        self._flicker_of = {name: _ChainFlicker(device, name, rng) for name in _FLICKERS if noisy and name in device.effects}
        self.flags = (
            (carrier.FLAG_NONLINEAR if self.nonlinear.any() else 0)
            | (carrier.FLAG_PICKOFF_CUBIC if self.converters[4] or self.converters[7] else 0)
            | (carrier.FLAG_PICKOFF_GAP if device.pickoff.gap_amplitude_v else 0)
            | (carrier.FLAG_MULTIPLEXED if device.multiplexing.enabled else 0)
            | (carrier.FLAG_TWICE if device.drive.at_twice_frequency else 0)
            | (carrier.FLAG_STRAY if self._has_flicker else 0)
            | (carrier.FLAG_EFFECTS if uses_kernel(device) else 0)
            | carrier.FLAG_CONVERTERS
        )

    def _rise0(self) -> float:
        return self.device.temperature_rise(self.device.environment.temperature_degc)

    def rows(self, rate_rad_s: FloatArray, temperature_degc: FloatArray) -> FloatArray:
        """See :class:`Plant`."""
        return self._simulate(rate_rad_s, temperature_degc, self.flags, 9)

    def rows_and_raw(self, rate_rad_s: FloatArray, temperature_degc: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Next rows, shape (n, 9), and the converter samples made meanwhile, shape (n controls samples, RAW_CHANNELS)."""
        samples = self.row_w.shape[2] * self.adc_w.shape[1]
        both = self._simulate(rate_rad_s, temperature_degc, self.flags | carrier.FLAG_RAW, 9 + carrier.RAW_CHANNELS * samples)
        return both[:, :9].copy(), both[:, 9:].reshape(-1, carrier.RAW_CHANNELS).copy()

    def _simulate(self, rate_rad_s: FloatArray, temperature_degc: FloatArray, flags: int, width: int) -> FloatArray:
        d, count = self.device, rate_rad_s.size
        dt = 1.0 / d.electronics.adc_rate_hz
        const = np.array([dt, self.w, self.pickoff_density() * math.sqrt(0.5 / dt), self.settling, d.drive_factor_per_m])
        noise = self.normals(4 * count * self.row_w.shape[2] * self.adc_w.shape[1])
        out = np.empty((count, width))
        physics = self._physics.rows(temperature_degc)
        physics[:, 3:7] += np.multiply.outer(rate_rad_s, 2.0 * d.resonator.angular_gain * J.ravel())
        rise = temperature_degc - d.resonator.reference_temperature_degc
        drive = _scaled(_parts(d.drive.matrix()), 1.0 + d.drive.gain_tempco_per_k * rise)
        pick = _scaled(_parts(d.pickoff_matrix()), 1.0 + d.pickoff.gain_tempco_per_k * rise)
        effect_rows, gain_noise = np.zeros((0, N_ROW)), np.zeros(0)
        if self._slow is not None:
            drive, pick, effect_rows = self._slow_effects(rate_rad_s, temperature_degc, physics, drive, pick)
        self.effect[E_CLOSED] = float(self.param[control_layout.P_MODE] != control_layout.MODE_LOOPS_OFF)
        if self._gain_noise is not None:
            gain_noise = self._gain_noise.standard_normal(count * self.row_w.shape[2])
        carrier.carrier_rows(
            self.z, self.loop, self.param, self.adc_acc, self.row_acc, self.adc_w, self.row_w,
            physics, drive, self.stray_drive(count), pick, _parts(d.feedthrough_matrix()), d.drive.gain_m_s2_per_v,
            self.nonlinear, self.converters, const, flags, noise, out, self.effect, self.memory, effect_rows, gain_noise,
        )  # fmt: skip
        return out

    def _slow_effects(
        self, rate_rad_s: FloatArray, temperature_degc: FloatArray, physics: FloatArray, drive: FloatArray, pick: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Put what the effects change from row to row into ``physics``; drive, pick-off and effect rows with them."""
        assert self._slow is not None
        r = self.device.resonator
        omega = r.omega0_rad_s * (1.0 + r.frequency_tempco_per_k * (temperature_degc - r.reference_temperature_degc))
        terms = self._slow.terms(rate_rad_s, temperature_degc)
        for name, source in self._flicker_of.items():
            gains = source.rows(len(rate_rad_s))
            # of a reading by the axis that is read, of a drive by the one that is asked for
            by_axis = gains[:, :, None] if _FLICKERS[name] == "pick" else gains[:, None, :]
            terms = replace(terms, **{_FLICKERS[name]: getattr(terms, _FLICKERS[name]) * by_axis})
        mode = 2.0 * math.pi * self.device.effects.get("spurious_mode", {}).get("separation_hz", 0.0)
        return *add_to_carrier(terms, physics, drive, pick, omega), kernel_rows(terms, omega + mode)

    def _physics_at(self, temperature_degc: float) -> FloatArray:
        """k11, k12, k22, c11, c12, c21, c22 without rotation, and the kick, as :func:`.carrier.carrier_rows` takes them."""
        k = self.device.resonator.stiffness_matrix(temperature_degc)
        c = self.device.resonator.damping_matrix(temperature_degc)
        kick = math.sqrt(self.force_psd(temperature_degc) / self.device.electronics.adc_rate_hz) / self.w
        return np.array([k[0, 0], k[0, 1], k[1, 1], *c.ravel(), kick])


class SlowFlowPlant(_Base):
    """Theory.md Eq. 3 at the control rate; converter effects do not exist here."""

    def __init__(self, device: Device, rng: np.random.Generator, loop: FloatArray, start: OperatingPoint, *, noisy: bool) -> None:
        refuse_without_envelope(device)
        super().__init__(device, rng, loop, start, noisy=noisy)
        self._envelope = envelope_constants(device.effects)
        self._bent = float(bool(ENVELOPE_EFFECTS & set(device.effects)))
        self._nonlinear = nonlinear_coefficients(device)
        self._slow = SlowEffects(device) if SLOW_EFFECTS & set(device.effects) else None
        volts = start.pick + device.feedthrough_matrix() @ start.drive
        self.p = _parts(start.pick)
        self.means = np.tile(_parts(volts), (2, 1))
        self.pick = device.pickoff_matrix()
        self.unpick = np.linalg.inv(self.pick)
        self._period = 1.0 / device.electronics.control_rate_hz
        self._coriolis = _parts(device.slow_flow().dA_dOmega) * self._period
        self._flow = _OverTemperature(self._flow_at)

    def rows(self, rate_rad_s: FloatArray, temperature_degc: FloatArray) -> FloatArray:
        """See :class:`Plant`."""
        d = self.device
        nonlinear = self._nonlinear
        n = d.electronics.samples_per_control
        pick_noise = self.pickoff_density() / math.sqrt(self._period * (1.0 - self.settling / n))
        reading = 0.5 * (1.0 + (self.settling - 1.0) / n) if d.multiplexing.enabled else 0.5
        shares = np.array([1.0, 0.0, 0.0]) if d.multiplexing.enabled else self.shares
        per_metre = d.drive_factor_per_m if d.drive.at_twice_frequency else 0.0
        multiplexed, strayed = float(d.multiplexing.enabled), float(self._has_flicker)
        const = np.array(
            [
                self._period,
                pick_noise,
                float(nonlinear.any()),
                reading,
                multiplexed,
                per_metre,
                strayed,
                self._bent,
                1.0 / d.pickoff.gain_v_per_m,
            ]
        )
        table, place = self._flow.table(temperature_degc)
        coriolis = self._coriolis
        if self._slow is not None:
            table, place = self._with_slow_effects(rate_rad_s, temperature_degc)
            coriolis = np.zeros(8)
        noise = self.normals(8 * rate_rad_s.size * self.row_w.shape[2])
        out = np.empty((rate_rad_s.size, 9))
        slow_flow_rows(
            self.p, self.loop, self.param, self.means, self.row_acc, shares, self.row_w, table, place, coriolis, rate_rad_s,
            self.stray_drive(rate_rad_s.size), self.pick, self.unpick, nonlinear, _parts(d.feedthrough_matrix()), const, noise, out,
            self._envelope,
        )  # fmt: skip
        return out

    def _with_slow_effects(self, rate_rad_s: FloatArray, temperature_degc: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The flow of every row with rotation and what the effects change from row to row, as a table whose places are the rows."""
        assert self._slow is not None
        table = self._flow.rows(temperature_degc)
        table[:, :8] += np.multiply.outer(rate_rad_s, self._coriolis)
        A, G = (np.ascontiguousarray(table[:, k : k + 8]).view(np.complex128).reshape(-1, 2, 2) / self._period for k in (0, 8))
        A, G = flow_with(self._slow.terms(rate_rad_s, temperature_degc), A, G, self.pick)
        for k, matrix in ((0, A), (8, G)):
            table[:, k : k + 8] = self._period * np.ascontiguousarray(matrix).reshape(-1, 4).view(np.float64)
        return np.concatenate([table, table[-1:]]), np.arange(len(rate_rad_s), dtype=float)

    def _flow_at(self, temperature_degc: float) -> FloatArray:
        """Flow without rotation at a temperature, shape (FLOW_COLUMNS,)."""
        d, period = self.device, self._period
        flow = d.slow_flow(0.0, temperature_degc)
        body = -0.5j / flow.omega0_rad_s * d.drive.gain_m_s2_per_v * self.pick.sum(axis=1)
        response = d.pickoff.gain_v_per_m / (2.0 * d.resonator.omega0_rad_s)
        kick = math.sqrt(2.0 * self.force_psd(temperature_degc) * period) * response
        return np.concatenate([_parts(flow.A) * period, _parts(flow.G) * period, _parts(body) * period, [flow.omega0_rad_s, kick]])


def _parts(values: ComplexArray) -> FloatArray:
    """Complex numbers as re, im one after the other; a 2x2 matrix by rows, shape (8,)."""
    return np.array(values, dtype=complex).reshape(-1).view(np.float64)


def _scaled(flat: FloatArray, factor: FloatArray) -> FloatArray:
    return np.ascontiguousarray(factor[:, None] * flat[None, :])
