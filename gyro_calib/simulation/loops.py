"""Loop parameters and starting state from a device and a command."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..device import Device
from ..device.operating_point import OperatingPoint
from ..recording.command import Command
from . import control as c

__all__ = ["initial_loop_state", "loop_parameters", "supported_modes"]

FloatArray = NDArray[np.float64]
_MODES = {"ftr_x": c.MODE_FTR_X, "ftr_y": c.MODE_FTR_Y, "loops_off": c.MODE_LOOPS_OFF}
_EXCITATIONS = {
    "none": c.EXC_NONE,
    "amplitude_modulation": c.EXC_AMPLITUDE,
    "frequency_modulation": c.EXC_FREQUENCY,
    "secondary_modulation": c.EXC_SECONDARY,
    "drive": c.EXC_DRIVE,
    "body": c.EXC_BODY,
}


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
    param[c.P_AMPLITUDE] = command.setpoints.amplitude_v
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
    ):
        crossover = 2.0 * math.pi * bandwidth
        param[kp] = crossover / scale
        param[ki] = (0.5 * crossover) ** 2 / scale
    param[c.P_FULL_SCALE] = device.electronics.dac_full_scale_v
    param[c.P_COMP : c.P_COMP + 4] = command.compensation
    param[c.P_REBALANCE] = command.setpoints.rebalance
    param[c.P_PERIOD] = 1.0 / device.electronics.control_rate_hz
    return param


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
    state[c.S_DRIVE : c.S_DRIVE + 4] = [point.drive[0].real, point.drive[0].imag, point.drive[1].real, point.drive[1].imag]
    return state
