"""The hidden truth of a simulated unit: bias and scale factor of ``rate_raw``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..device import Device, averaging
from ..device.operating_point import OperatingPoint, ftr_operating_point
from ..errors import DeviceError
from ..recording.command import Command

__all__ = ["Truth", "operating_point", "truth_of"]


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
    pick = device.pickoff.matrix(device.temperature_rise(device.environment.temperature_degc))
    unpick = np.linalg.inv(pick)
    coefficients = device.nonlinearity.coefficients

    def extra(p: np.ndarray) -> np.ndarray:
        x, y = unpick @ p
        return 0.5j / omega * pick @ np.array(averaging.averaged_force(complex(x), complex(y), omega, coefficients))

    nonlinear = extra if any(coefficients) else None
    point = None
    for _ in range(4):
        flow = device.slow_flow(rate_rad_s, omega_rad_s=omega)
        point = ftr_operating_point(flow.A, flow.G, flow.E, command.setpoints.amplitude_v, axis, extra=nonlinear)
        omega += point.detuning_rad_s
    assert point is not None
    return OperatingPoint(point.drive, point.pick, omega - device.slow_flow(rate_rad_s).omega0_rad_s, point.rate_channel_v)


def truth_of(device: Device, command: Command, rate_rad_s: float = 0.0) -> Truth:
    """Bias and scale factor of ``rate_raw`` about an input rate."""
    axis = command.oscillator_axis or "x"
    nominal = device.factory()["nominal_scale_factor_v_per_rad_s"][axis]
    nominal *= command.setpoints.amplitude_v / device.factory_data.nominal_amplitude_v
    step = 0.05
    ahead = operating_point(device, command, rate_rad_s + step).rate_channel_v
    behind = operating_point(device, command, rate_rad_s - step).rate_channel_v
    here = operating_point(device, command, rate_rad_s).rate_channel_v
    slope = (ahead - behind) / (2.0 * step)
    return Truth(bias_rad_s=(here - slope * rate_rad_s) / nominal, scale_factor=slope / nominal, scale_factor_v_per_rad_s=slope)
