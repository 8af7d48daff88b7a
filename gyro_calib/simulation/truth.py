"""The hidden truth of a simulated unit: bias and scale factor of ``rate_raw``."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..device import Device, averaging
from ..device.operating_point import OperatingPoint, ftr_operating_point
from ..device.wave_point import WavePoint, wave_point
from ..errors import DeviceError
from ..recording.command import Command
from ..recording.rate import WAVE_MODES

__all__ = ["Truth", "operating_point", "truth_of", "wave_points"]

ComplexArray = NDArray[np.complex128]
#: azimuths over a turn of psi = 2 theta: exact up to the 7th harmonic of 4 theta
_AZIMUTHS = 16


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

    Raises
    ------
    DeviceError
        A mode without a rebalance channel.
    """
    axis = command.oscillator_axis
    if axis is None:
        raise DeviceError(f"Operating point must be of a force-rebalance mode, but got {command.mode!r}.")
    omega = device.slow_flow(rate_rad_s).omega0_rad_s
    point = None
    for _ in range(4):
        flow = device.slow_flow(rate_rad_s, omega_rad_s=omega)
        point = ftr_operating_point(flow.A, flow.G, flow.E, command.setpoints.amplitude_v, axis, extra=_nonlinear_forces(device, omega))
        omega += point.detuning_rad_s
    assert point is not None
    factor = device.drive_factor(point.pick)
    detuning = omega - device.slow_flow(rate_rad_s).omega0_rad_s
    return OperatingPoint(point.drive / factor, point.pick, detuning, point.rate_channel_v / factor)


def wave_points(device: Device, command: Command, rate_rad_s: float = 0.0, azimuths: int = _AZIMUTHS) -> list[WavePoint]:
    """State of a whole-angle gyro with ideal loops at azimuths spread evenly over ``theta`` = 0 to pi.

    Raises
    ------
    DeviceError
        A mode that does not hold a free wave at amplitude.
    """
    if command.mode not in WAVE_MODES:
        raise DeviceError(f"Wave points must be of one of the modes {', '.join(WAVE_MODES)}, but got {command.mode!r}.")
    amplitude = command.setpoints.amplitude_v
    flow = device.slow_flow(rate_rad_s)
    nonlinear = _nonlinear_forces(device, flow.omega0_rad_s)
    points = []
    for theta in math.pi * np.arange(azimuths) / azimuths:
        wave = np.asarray([amplitude * math.cos(2.0 * theta), amplitude * math.sin(2.0 * theta)], dtype=np.complex128)
        points.append(
            wave_point(
                flow.A,
                flow.G * device.drive_factor(wave),
                flow.E,
                amplitude,
                theta,
                precession_v=command.setpoints.virtual_precession_v,
                stiffness_v_per_v=command.setpoints.stiffness_v_per_v,
                compensation=np.reshape(command.compensation, (2, 2)),
                latency_s=device.loop_latency_s,
                extra=nonlinear,
            )
        )
    return points


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
    coefficients = device.nonlinearity.coefficients
    if not any(coefficients):
        return None
    pick = device.pickoff_matrix(device.temperature_rise(device.environment.temperature_degc))
    unpick = np.linalg.inv(pick)

    def forces(p: ComplexArray) -> ComplexArray:
        x, y = unpick @ p
        envelope = np.array(averaging.averaged_force(complex(x), complex(y), omega, coefficients))
        return np.asarray(0.5j / omega * pick @ envelope, dtype=np.complex128)

    return forces
