"""What the effects of a device do to its steady state, for the hidden truth: at the start of the time, in the mean of tones and noise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..device import Device, SlowFlow
from ..device.wave_point import WavePoint
from ..recording.command import Command
from .effect_envelope import bent_drive, bent_pickoff, effect_rate, envelope_constants
from .effect_rows import SlowEffects, flow_with
from .loops import held_shares

__all__ = ["SteadyEffects"]

ComplexArray = NDArray[np.complex128]
#: a reading is brought back to the volts that cause it by so many repetitions
_REPEAT = 30


class SteadyEffects:
    """The effects of a device at an input rate, in steady state.

    Parameters
    ----------
    device : Device
    rate_rad_s : float
    """

    def __init__(self, device: Device, rate_rad_s: float) -> None:
        self._device = device
        self._numbers = envelope_constants(device.effects)
        self._motion_v = device.pickoff_matrix() / device.pickoff.gain_v_per_m
        temperature = np.array([device.environment.temperature_degc])
        lasting = {name: sizes for name, sizes in device.effects.items() if name != "base_sway"}
        self._terms = SlowEffects(replace(device, effects=lasting)).terms(np.array([rate_rad_s]), temperature)
        # what is slow has settled: it is a gain (of a wave that stands; one that turns within the time constant has none of it)
        self._drive_gain = 1.0 + device.effects.get("drive_memory", {}).get("share", 0.0)
        self._pick_gain = 1.0 + device.effects.get("pickoff_memory", {}).get("share", 0.0)
        late = [device.effects.get(name, {}) for name in ("drive_delay", "pickoff_delay")]
        self._drive_late_s, self._pick_late_s = (np.array([d.get("tau_x", 0.0), d.get("tau_y", 0.0)]) for d in late)
        self._pick_late_s[1] += device.effects.get("multiplexing_skew", {}).get("tau", 0.0)

    def flow(self, flow: SlowFlow, omega_rad_s: float) -> SlowFlow:
        """A, G and E with what temperature, time, rotation and a spurious mode make of them."""
        A, G = flow_with(self._terms, flow.A[None], flow.G[None], self._device.pickoff_matrix())
        E = flow.E + self._terms.feed[0]
        mode = self._device.effects.get("spurious_mode")
        if mode is not None:
            above = 2.0 * math.pi * (self._device.resonator.frequency_at(self._device.environment.temperature_degc) + mode["separation_hz"])
            response = -1j / complex(2.0 * math.pi * mode["half_width_hz"], omega_rad_s - above)
            E = E + response * np.array([[mode["gain_xx"], mode["gain_xy"]], [mode["gain_yx"], mode["gain_yy"]]])
        return replace(flow, A=A[0], G=G[0], E=np.asarray(E, dtype=np.complex128))

    def drive_excess(self, drive: ComplexArray, omega_rad_s: float) -> ComplexArray:
        """Drive that acts, less the commanded one [V]."""
        late = self._turned(self._drive_late_s, omega_rad_s) * drive
        return np.array(bent_drive(complex(late[0]), complex(late[1]), self._numbers)) * self._drive_gain - drive

    def rate(self, pick: ComplexArray, drive: ComplexArray) -> ComplexArray:
        """What damping, friction, pump and a stiffness that the drives make add to p' [V/s]."""
        motion = np.linalg.solve(self._motion_v, pick)
        added = np.array(effect_rate(complex(motion[0]), complex(motion[1]), self._numbers))
        softness = self._device.effects.get("drive_stiffness")
        if softness is not None:
            k = np.array([softness["k_x"], softness["k_y"]])
            added = added + 1j * k * (2.0 * np.abs(drive) ** 2 * motion + drive**2 * motion.conj())
        softness = self._device.effects.get("drive_stiffness_mean")
        if softness is not None:
            added = added + 1j * np.array([softness["k_x"], softness["k_y"]]) * np.abs(drive) ** 2 * motion
        pump = self._device.effects.get("driven_pump")
        if pump is not None:
            command = float((motion.conj() @ drive).imag) / max(float(np.linalg.norm(motion)), 1e-12)
            added = added + command * np.array([complex(pump["h_xc"], pump["h_xs"]), complex(pump["h_yc"], pump["h_ys"])]) * motion.conj()
        return np.asarray(self._motion_v @ added, dtype=np.complex128)

    def true_volts(self, read: ComplexArray, omega_rad_s: float) -> ComplexArray:
        """Volts of the motion and feedthrough that are read as ``read``."""
        prompt = read / self._turned(self._pick_late_s, omega_rad_s)
        volts = np.array(prompt, dtype=np.complex128)
        for _ in range(_REPEAT):
            seen = self._pick_gain * np.array(bent_pickoff(complex(volts[0]), complex(volts[1]), self._numbers))
            volts = volts + prompt - seen
        return volts

    def _turned(self, late_s: NDArray[np.float64], omega_rad_s: float) -> ComplexArray:
        """What a carrier that is late has turned by, away from the frequency at which its phase is part of the gains."""
        return np.asarray(np.exp(-1j * late_s * (omega_rad_s - self._device.resonator.omega0_rad_s)), dtype=np.complex128)

    def wave_excess(self, flow: SlowFlow, command: Command, azimuth_rad: float, last: WavePoint) -> WaveExcess:
        """What the effects add to the balance of a wave, about its state as last found."""
        psi, spin = 2.0 * azimuth_rad, 2.0 * last.theta_rate_rad_s
        held, amplitude = held_shares(self._device), command.setpoints.amplitude_v

        def excess(angle: float) -> ComplexArray:
            read = held.wave(amplitude, angle)
            return self.true_volts(read, flow.omega0_rad_s) - read

        step = 1e-4
        volts = excess(psi)
        turning = spin * (excess(psi + step) - excess(psi - step)) / (2.0 * step)
        late = psi - spin * (self._device.loop_latency_s + self._device.angle_latency_s)
        along, across = np.array([math.cos(late), math.sin(late)]), np.array([-math.sin(late), math.cos(late)])
        drive = 1j * last.amplitude_drive_v * along + (last.quadrature_drive_v + 1j * command.setpoints.virtual_precession_v) * across
        drive = drive + command.setpoints.stiffness_v_per_v * held.wave(amplitude, psi)
        drive = np.asarray(np.reshape(command.compensation, (2, 2)) @ drive, dtype=np.complex128)
        acting = self.drive_excess(drive, flow.omega0_rad_s)
        dynamics = flow.A - 1j * last.detuning_rad_s * np.eye(2)
        return WaveExcess(self, volts, np.asarray(dynamics @ volts + flow.G @ acting - turning, dtype=np.complex128), drive)


class WaveExcess:
    """Extra terms of a wave's balance [V/s], called with the pick-offs that are read, without feedthrough."""

    def __init__(self, effects: SteadyEffects, volts: ComplexArray, constant: ComplexArray, drive: ComplexArray) -> None:
        self._effects, self.volts, self._constant, self._drive = effects, volts, constant, drive

    def __call__(self, pick: ComplexArray) -> ComplexArray:
        return self._constant + self._effects.rate(pick + self.volts, self._drive)
