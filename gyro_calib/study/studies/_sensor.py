"""Truth and estimate of the sensor itself (theory.md Eq. 7): comparable between experiments, whatever the running loops add."""

from __future__ import annotations

import numpy as np

from ...device import Device
from ...device.operating_point import ftr_operating_point
from ...estimation.separation import Priors
from ...estimation.sideband import SidebandProblem
from ...estimation.slow_flow_estimate import SlowFlowEstimate
from ...recording.recording import Campaign
from ...units import DEG_H

__all__ = ["sensor_errors"]


def sensor_errors(
    device: Device, campaign: Campaign, fit: SlowFlowEstimate, rate_rad_s: float, temperature_degc: float
) -> dict[str, float]:
    """Errors of bias and rate [deg/h] and of the scale factor [ppm] with x as the oscillator, and their claimed sd.

    The truth is that at ``temperature_degc`` and its natural frequency; an estimate made at another one is brought to it (G ~ 1/omega).
    """
    problem = SidebandProblem(list(campaign), campaign.factory, device.resonator.angular_gain, Priors(), fit=fit)
    derived, covariance = problem.solve()
    flow = device.slow_flow(0.0, temperature_degc)
    amplitude = device.factory_data.nominal_amplitude_v
    point = ftr_operating_point(flow.A, flow.G, np.zeros((2, 2), dtype=complex), amplitude, "x")
    scale = device.resonator.angular_gain * amplitude * (1.0 + device.pickoff.gain_mismatch) / abs(flow.G[1, 1])
    moved = flow.omega0_rad_s / (problem.stretch["x"] * fit.omega0_rad_s)
    figures = {}
    for name, figure, true, factor, unit in (
        ("bias", "bias_x", point.rate_channel_v / scale, 1.0, DEG_H),
        ("rate", "rate", rate_rad_s, 1.0, DEG_H),
        ("scale", "scale_x", scale, moved, scale * 1e-6),
    ):
        place = derived.names.index(figure)
        figures[name] = (float(derived.values[place]) * factor - true) / unit
        figures[f"{name}/sd"] = float(np.sqrt(covariance[place, place])) / abs(unit)
    return figures
