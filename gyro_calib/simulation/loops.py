"""Loop parameters and starting state from a device and a command."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..device import Device
from ..device.electronics import SLOTS
from ..device.operating_point import OperatingPoint
from ..errors import DeviceError
from ..recording.command import Command
from . import control_layout as c

__all__ = ["HeldShares", "check_command", "hand_over", "held_shares", "initial_loop_state", "loop_parameters", "supported_modes"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
_MODES = {
    "ftr_x": c.MODE_FTR_X,
    "ftr_y": c.MODE_FTR_Y,
    "loops_off": c.MODE_LOOPS_OFF,
    "whole_angle": c.MODE_WHOLE_ANGLE,
    "ring_down": c.MODE_RING_DOWN,
    "ring_up": c.MODE_RING_UP,
    # stiffness control acts in every closed mode: this one says what it is for
    "stiffness": c.MODE_WHOLE_ANGLE,
}
_EXCITATIONS = {
    "none": c.EXC_NONE,
    "amplitude_modulation": c.EXC_AMPLITUDE,
    "frequency_modulation": c.EXC_FREQUENCY,
    "secondary_modulation": c.EXC_SECONDARY,
    "drive": c.EXC_DRIVE,
    "body": c.EXC_BODY,
}


@dataclass(frozen=True)
class HeldShares:
    """What the loops hold: amplitude over its set point, quadrature over the amplitude, modal azimuth of force to rebalance [rad]."""

    amplitude: float
    quadrature: float
    azimuth_rad: float

    def volts(self, amplitude_v: float, axis: str) -> ComplexArray:
        """Pick-off envelopes at which a force-rebalance wave is held [V], shape (2,)."""
        held = amplitude_v * self.amplitude
        closed = held * complex(self.azimuth_rad, -self.quadrature)
        return np.array([held, closed] if axis == "x" else [-closed, held], dtype=np.complex128)

    def wave(self, amplitude_v: float, psi_rad: float) -> ComplexArray:
        """Pick-off envelopes of a whole-angle wave at an azimuth [V], shape (2,)."""
        c, s = math.cos(psi_rad), math.sin(psi_rad)
        return amplitude_v * self.amplitude * np.array([c + 1j * self.quadrature * s, s - 1j * self.quadrature * c], dtype=np.complex128)


def held_shares(device: Device) -> HeldShares:
    """Of a device: 1, 0, 0 where its loops do not err."""
    error = device.effects.get("loop_error", {})
    return HeldShares(1.0 + error.get("a", 0.0), error.get("q", 0.0), error.get("psi", 0.0))


def supported_modes() -> tuple[str, ...]:
    """Modes whose loops exist."""
    return tuple(_MODES)


def design_gain(device: Device) -> float:
    """g of the design, |G| of a perfect unit [1/s per V]: what the firmware's loop gains were computed with."""
    return device.pickoff.gain_v_per_m * device.drive.gain_m_s2_per_v / (2.0 * device.resonator.omega0_rad_s)


def loop_parameters(device: Device, command: Command) -> FloatArray:
    """Parameters of the control law, shape (N_PARAM,). Loops are second order, critically damped, crossing over at their bandwidth."""
    param = np.zeros(c.N_PARAM)
    excitation = command.excitation
    gain = design_gain(device)
    param[c.P_MODE] = _MODES[command.mode]
    held = held_shares(device)
    param[c.P_AMPLITUDE] = command.setpoints.amplitude_v * held.amplitude
    param[c.P_HELD_Q], param[c.P_HELD_PSI] = held.quadrature, held.azimuth_rad
    param[c.P_EXCITATION] = _EXCITATIONS[excitation.kind]
    off = command.mode == "loops_off" and excitation.kind not in ("drive", "body")
    param[c.P_FREQUENCY] = device.factory_data.nominal_f0_hz if off else excitation.frequency_hz
    param[c.P_INDEX] = excitation.index
    param[c.P_VOLTS] = excitation.volts
    param[c.P_AXIS] = 1.0 if excitation.axis == "y" else 0.0
    param[c.P_OMEGA] = 2.0 * math.pi * device.factory_data.nominal_f0_hz
    for kp, ki, bandwidth, scale in (
        (c.P_PLL_KP, c.P_PLL_KI, device.loops.pll_bandwidth_hz, 1.0),
        (c.P_AMP_KP, c.P_AMP_KI, device.loops.amplitude_bandwidth_hz, gain),
        (c.P_REB_KP, c.P_REB_KI, device.loops.rebalance_bandwidth_hz, gain),
        (c.P_QUAD_KP, c.P_QUAD_KI, device.loops.quadrature_bandwidth_hz, gain),
    ):
        crossover = 2.0 * math.pi * bandwidth
        param[kp] = crossover / scale
        param[ki] = (0.5 * crossover) ** 2 / scale
    # a multiplexed drive is on for a share of the time and gives the rest in advance
    param[c.P_FULL_SCALE] = device.electronics.dac_full_scale_v * device.multiplexing.drive_share
    param[c.P_COMP : c.P_COMP + 4] = command.compensation
    param[c.P_REBALANCE] = command.setpoints.rebalance
    param[c.P_PERIOD] = (SLOTS if device.multiplexing.enabled else 1) / device.electronics.control_rate_hz
    # a discrete low-pass that keeps a share k of what it was delays by k/(1 - k) periods
    late_s = device.angle_latency_s
    param[c.P_LATE] = late_s / (late_s + param[c.P_PERIOD])
    param[c.P_PRECESSION] = command.setpoints.virtual_precession_v
    param[c.P_STIFFNESS] = command.setpoints.stiffness_v_per_v
    param[c.P_GAIN] = command.setpoints.amplitude_gain_v_per_v
    param[c.P_THRESHOLD] = device.loops.ring_threshold
    param[c.P_CONSTANT] = float(device.drive.at_twice_frequency)
    return param


def check_command(command: Command) -> None:
    """Refuse what the loops cannot do.

    Raises
    ------
    DeviceError
        Unknown mode, an excitation that the mode does not have, or a ring-down that drives up (or the reverse).
    """
    if command.mode not in _MODES:
        raise DeviceError(f"Mode must be one of {', '.join(_MODES)} for this simulator, but got {command.mode!r}.")
    if _MODES[command.mode] < c.MODE_WHOLE_ANGLE:
        return
    if command.excitation.kind != "none":
        raise DeviceError(f"Excitation must be none in mode {command.mode}, but got {command.excitation.kind!r}.")
    gain = command.setpoints.amplitude_gain_v_per_v
    if (command.mode == "ring_down" and gain > 0.0) or (command.mode == "ring_up" and gain <= 0.0):
        wanted = "<= 0 in mode ring_down" if command.mode == "ring_down" else "> 0 in mode ring_up"
        raise DeviceError(
            f"Set point amplitude_gain_v_per_v must be {wanted}, but got {gain!r}. Negative drives down, 0 rings down freely."
        )


def hand_over(state: FloatArray, before: Command, after: Command) -> None:
    """Prepare the loop state for a new command, in place: the wave keeps its azimuth, its quadrature drive goes on.

    A drive ``u_perp_c n_perp`` of the whole-angle loops is ``-u_perp_c`` on x for a wave on y, ``u_perp_c`` on y for one on x.
    """
    state[c.S_LEG] = 0.0
    free, freed = _MODES[before.mode] >= c.MODE_WHOLE_ANGLE, _MODES[after.mode] >= c.MODE_WHOLE_ANGLE
    if freed and not free and before.oscillator_axis is not None:
        on_x = before.oscillator_axis == "x"
        state[c.S_WAVE], state[c.S_WAVE + 1] = (1.0, 0.0) if on_x else (0.0, 1.0)
        state[c.S_QUAD] = -state[c.S_REB_S] if on_x else state[c.S_REB_S]
    elif free and after.oscillator_axis is not None:
        on_x = after.oscillator_axis == "x"
        state[c.S_REB_C] = 0.0
        state[c.S_REB_S] = -state[c.S_QUAD] * state[c.S_WAVE] if on_x else state[c.S_QUAD] * state[c.S_WAVE + 1]


def initial_loop_state(device: Device, command: Command, point: OperatingPoint) -> FloatArray:
    """Loop state at the steady state of a force-rebalance command, shape (N_STATE,)."""
    state = np.zeros(c.N_STATE)
    osc = 0 if command.oscillator_axis == "x" else 1
    rebalance = point.drive[1 - osc]
    omega = device.slow_flow().omega0_rad_s + point.detuning_rad_s
    state[c.S_OMEGA] = omega
    state[c.S_PLL] = omega - 2.0 * math.pi * device.factory_data.nominal_f0_hz
    state[c.S_AMP] = point.drive[osc].imag
    state[c.S_REB_C], state[c.S_REB_S] = -rebalance.imag, rebalance.real
    state[c.S_WAVE + osc] = 1.0
    state[c.S_DRIVE : c.S_DRIVE + 4] = [point.drive[0].real, point.drive[0].imag, point.drive[1].real, point.drive[1].imag]
    return state
