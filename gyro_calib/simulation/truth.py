"""The hidden truth of a simulated unit: bias and scale factor of ``rate_raw``."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..device import Device, SlowFlow, averaging
from ..device.operating_point import OperatingPoint, ftr_operating_point
from ..device.wave_point import WavePoint, wave_point
from ..errors import DeviceError
from ..recording.command import Command
from ..recording.rate import WAVE_MODES
from .effect_setup import nonlinear_coefficients
from .effect_truth import SteadyEffects
from .loops import held_shares

__all__ = ["Truth", "operating_point", "truth_of", "wave_points"]

ComplexArray = NDArray[np.complex128]
#: azimuths over a turn of psi = 2 theta: exact up to the 7th harmonic of 4 theta
_AZIMUTHS = 16
#: repetitions of a steady state: for its frequency, and for effects that depend on its drives
_REPEAT, _REPEAT_BENT = 4, 12


@dataclass(frozen=True)
class Truth:
    """``rate_raw = scale_factor * rate + bias``.

    Parameters
    ----------
    bias_rad_s : float
        b [rad/s].
    scale_factor : float
        K, dimensionless.
    scale_factor_v_per_rad_s : float
        Rebalance volts per rad/s, signed as theory.md Eq. 7.
    """

    bias_rad_s: float
    scale_factor: float
    scale_factor_v_per_rad_s: float


def operating_point(device: Device, command: Command, rate_rad_s: float) -> OperatingPoint:
    """Steady state of a force-rebalance mode, exact in the frequency (A and G written about the reference frequency itself).

    The drive is the one that acts, behind the compensation: the loops hold the pick-offs and find it whatever the matrix. What the matrix
    moves is the frequency, because the PLL keeps the oscillator's drive in phase with velocity *before* it.

    Raises
    ------
    DeviceError
        A mode without a rebalance channel.
    """
    axis = command.oscillator_axis
    if axis is None:
        raise DeviceError(f"Operating point must be of a force-rebalance mode, but got {command.mode!r}.")
    compensation = np.reshape(command.compensation, (2, 2))
    omega = device.slow_flow(rate_rad_s).omega0_rad_s
    held = held_shares(device)
    amplitude = held.amplitude * command.setpoints.amplitude_v
    point = None
    effects = SteadyEffects(device, rate_rad_s) if device.effects else None
    for _ in range(_REPEAT if effects is None else _REPEAT_BENT):
        flow, extra, volts = device.slow_flow(rate_rad_s, omega_rad_s=omega), _nonlinear_forces(device, omega), None
        if effects is not None:
            flow = effects.flow(flow, omega)
            factor = 1.0 if point is None else device.drive_factor(point.pick)
            extra = _with_effects(effects, extra, flow, omega, compensation, point, factor)
            volts = effects.true_volts(held.volts(command.setpoints.amplitude_v, axis), omega)
        G, E = flow.G @ compensation, flow.E @ compensation
        point = ftr_operating_point(flow.A, G, E, amplitude, axis, volts=volts, extra=extra)
        omega += point.detuning_rad_s
    assert point is not None
    drive = compensation @ point.drive / device.drive_factor(point.pick)
    detuning = omega - device.slow_flow(rate_rad_s).omega0_rad_s
    closed = 1 if axis == "x" else 0
    return OperatingPoint(drive, point.pick, detuning, float(drive[closed].imag))


def wave_points(device: Device, command: Command, rate_rad_s: float = 0.0, azimuths: int = _AZIMUTHS) -> list[WavePoint]:
    """State of a whole-angle gyro with ideal loops at azimuths spread evenly over ``theta`` = 0 to pi.

    Raises
    ------
    DeviceError
        A mode that does not hold a free wave at amplitude.
    """
    if command.mode not in WAVE_MODES:
        raise DeviceError(f"Wave points must be of one of the modes {', '.join(WAVE_MODES)}, but got {command.mode!r}.")
    amplitude = held_shares(device).amplitude * command.setpoints.amplitude_v
    flow = device.slow_flow(rate_rad_s)
    nonlinear = _nonlinear_forces(device, flow.omega0_rad_s)
    effects = SteadyEffects(device, rate_rad_s) if device.effects else None
    if effects is not None:
        flow = effects.flow(flow, flow.omega0_rad_s)
    points = []
    for theta in math.pi * np.arange(azimuths) / azimuths:
        wave = np.asarray([amplitude * math.cos(2.0 * theta), amplitude * math.sin(2.0 * theta)], dtype=np.complex128)
        here = replace(flow, G=flow.G * device.drive_factor(wave))
        point = _wave_at(device, here, command, theta, nonlinear)
        for _ in range(_REPEAT_BENT if effects is not None else 0):
            assert effects is not None
            excess = effects.wave_excess(here, command, theta, point)
            point = _wave_at(device, here, command, theta, _sum_of(nonlinear, excess, excess.volts))
        points.append(point)
    return points


def _wave_at(
    device: Device, flow: SlowFlow, command: Command, theta: float, extra: Callable[[ComplexArray], ComplexArray] | None
) -> WavePoint:
    held = held_shares(device)
    return wave_point(
        flow.A,
        flow.G,
        flow.E,
        held.amplitude * command.setpoints.amplitude_v,
        theta,
        precession_v=command.setpoints.virtual_precession_v,
        stiffness_v_per_v=command.setpoints.stiffness_v_per_v,
        compensation=np.reshape(command.compensation, (2, 2)),
        latency_s=device.loop_latency_s + device.angle_latency_s,
        quadrature=held.quadrature,
        extra=extra,
    )


def truth_of(device: Device, command: Command, rate_rad_s: float = 0.0) -> Truth:
    """Bias and scale factor of ``rate_raw`` about an input rate; of a whole-angle gyro their means over the azimuth."""
    nominal = device.factory_data.nominal_scale_factor(command.oscillator_axis or "x", command.setpoints.amplitude_v)
    if command.mode in WAVE_MODES:
        return _wave_truth(device, command, rate_rad_s, nominal)
    step = 0.05
    ahead = operating_point(device, command, rate_rad_s + step).rate_channel_v
    behind = operating_point(device, command, rate_rad_s - step).rate_channel_v
    here = operating_point(device, command, rate_rad_s).rate_channel_v
    slope = (ahead - behind) / (2.0 * step)
    return Truth(bias_rad_s=(here - slope * rate_rad_s) / nominal, scale_factor=slope / nominal, scale_factor_v_per_rad_s=slope)


def _wave_truth(device: Device, command: Command, rate_rad_s: float, nominal_v_per_rad_s: float) -> Truth:
    """Means over the azimuth; the scale factor in volts is that of a precession drive that would hold the wave."""

    def precession(rate: float, volts: float = 0.0) -> float:
        setpoints = replace(command.setpoints, virtual_precession_v=command.setpoints.virtual_precession_v + volts)
        points = wave_points(device, replace(command, setpoints=setpoints), rate)
        return float(np.mean([p.theta_rate_rad_s for p in points]))

    step, kappa = 0.05, device.factory_data.angular_gain_kappa
    per_rate = (precession(rate_rad_s + step) - precession(rate_rad_s - step)) / (2.0 * step)
    step = 0.05 * abs(nominal_v_per_rad_s)
    per_volt = (precession(rate_rad_s, step) - precession(rate_rad_s, -step)) / (2.0 * step)
    scale = -2.0 / kappa * per_rate
    reported = -2.0 / kappa * precession(rate_rad_s) + command.setpoints.virtual_precession_v / nominal_v_per_rad_s
    return Truth(bias_rad_s=reported - scale * rate_rad_s, scale_factor=scale, scale_factor_v_per_rad_s=-per_rate / per_volt)


def _nonlinear_forces(device: Device, omega: float) -> Callable[[ComplexArray], ComplexArray] | None:
    """N(p) of theory.md Eq. 3 [V/s], or None without any."""
    coefficients = nonlinear_coefficients(device)
    if not coefficients.any():
        return None
    pick = device.pickoff_matrix(device.temperature_rise(device.environment.temperature_degc))
    unpick = np.linalg.inv(pick)

    def forces(p: ComplexArray) -> ComplexArray:
        x, y = unpick @ p
        envelope = np.array(averaging.averaged_force(complex(x), complex(y), omega, coefficients))
        return np.asarray(0.5j / omega * pick @ envelope, dtype=np.complex128)

    return forces


def _sum_of(
    nonlinear: Callable[[ComplexArray], ComplexArray] | None, more: Callable[[ComplexArray], ComplexArray], aside: ComplexArray
) -> Callable[[ComplexArray], ComplexArray]:
    """Both forces of the same motion; ``nonlinear`` is asked ``aside`` of the pick-offs that ``more`` is asked at."""
    if nonlinear is None:
        return more
    return lambda p: nonlinear(np.asarray(p + aside, dtype=np.complex128)) + more(p)


def _with_effects(
    effects: SteadyEffects,
    nonlinear: Callable[[ComplexArray], ComplexArray] | None,
    flow: SlowFlow,
    omega_rad_s: float,
    compensation: NDArray[np.float64],
    last: OperatingPoint | None,
    factor: float,
) -> Callable[[ComplexArray], ComplexArray]:
    """N(p) with what the effects add, drives as last found."""
    drive = np.zeros(2, dtype=np.complex128) if last is None else np.asarray(compensation @ last.drive / factor, dtype=np.complex128)
    acting = np.asarray(factor * (flow.G @ effects.drive_excess(drive, omega_rad_s)), dtype=np.complex128)
    return _sum_of(nonlinear, lambda p: np.asarray(effects.rate(p, drive) + acting, dtype=np.complex128), np.zeros(2, dtype=np.complex128))
