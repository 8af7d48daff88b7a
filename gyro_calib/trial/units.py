"""Units for blind trials: every nuisance that a healthy device may have is drawn, and a plant that is not the diagnoser's model.

The diagnoser fits a slow flow. What is drawn here runs at carrier level and has besides what that flow does not say: pick-offs that are not
orthogonal, converters with bits, control of another rate and latency, multiplexed electronics, a thermometer with a lag and a drift of its
own, a rate table whose clock and axis differ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..device import Device, draw_unit, load_device
from ..units import EARTH_RATE_RAD_S

__all__ = ["KINDS", "Unit", "draw_trial_unit"]

#: resonators of a trial and the campaign that each runs
KINDS = {"ring": "force-rebalance", "hemisphere": "whole-angle"}
#: decay of a trial's hemisphere [1/s]: that of the design would need hours of recordings
_HEMISPHERE_DECAY = (0.02, 0.08)
#: drive gain of a trial's hemisphere over the design's
_STRONGER = 2.0


@dataclass(frozen=True)
class Unit:
    """A drawn unit with its surroundings.

    Parameters
    ----------
    kind : str
        Of :data:`KINDS`.
    device : Device
        Without any effect that would be a finding.
    rate_rad_s : float
        Constant input rate, hidden.
    sense_axis : tuple of 3 float
        Sensitive axis in the case.
    table_clock, table_start_s : float
        Relative error of the table's rate, and how late its log is [s].
    sensor_lag_s, sensor_noise_k, sensor_drift_k : float
        Of the thermometer: what the recorded temperature has besides the resonator's.
    """

    kind: str
    device: Device
    rate_rad_s: float
    sense_axis: tuple[float, float, float]
    table_clock: float
    table_start_s: float
    sensor_lag_s: float
    sensor_noise_k: float
    sensor_drift_k: float

    @property
    def mode(self) -> str:
        """Kind of campaign."""
        return KINDS[self.kind]

    def with_device(self, device: Device) -> Unit:
        """The same surroundings around another device."""
        return replace(self, device=device)


def draw_trial_unit(kind: str, seed: int, number: int) -> Unit:
    """Unit ``number`` of a series.

    Parameters
    ----------
    kind : {"ring", "hemisphere"}
    seed, number : int
        Same pair, same unit.
    """
    rng = np.random.default_rng([0xB11D, seed, number])
    device = _ring(rng) if kind == "ring" else _hemisphere(rng)
    tilt = 3e-3 * rng.standard_normal(2)
    return Unit(
        kind=kind,
        device=replace(_healthy(device, rng), device_id=f"trial-{kind}-{seed}-{number}"),
        rate_rad_s=float(rng.uniform(-5.0, 5.0)) * EARTH_RATE_RAD_S,
        sense_axis=(float(tilt[0]), float(tilt[1]), 1.0),
        table_clock=float(2e-5 * rng.standard_normal()),
        table_start_s=float(2e-4 * rng.standard_normal()),
        sensor_lag_s=float(rng.uniform(0.0, 0.03)),
        sensor_noise_k=float(rng.uniform(0.001, 0.005)),
        sensor_drift_k=float(rng.uniform(0.0005, 0.002)),
    )


def _ring(rng: np.random.Generator) -> Device:
    return draw_unit(load_device("ring_15k"), int(rng.integers(2**31)))


def _hemisphere(rng: np.random.Generator) -> Device:
    design = load_device("hrg_hardware")
    decay = float(np.exp(rng.uniform(*np.log(_HEMISPHERE_DECAY))))
    quality = math.pi * design.resonator.frequency_hz / decay
    lossy = replace(
        design,
        resonator=replace(design.resonator, quality_factor=quality, damping_anisotropy=0.01),
        factory_data=replace(design.factory_data, nominal_q=quality),
        # a hemisphere whose drives hold a wave that decays so much faster
        drive=replace(design.drive, gain_m_s2_per_v=_STRONGER * design.drive.gain_m_s2_per_v),
    )
    factory = lossy.factory_data
    lossy = replace(
        lossy,
        factory_data=replace(
            factory,
            nominal_scale_factor_x_v_per_rad_s=factory.nominal_scale_factor_x_v_per_rad_s / _STRONGER,
            nominal_scale_factor_y_v_per_rad_s=factory.nominal_scale_factor_y_v_per_rad_s / _STRONGER,
        ),
    )
    return draw_unit(lossy, int(rng.integers(2**31)))


def _healthy(device: Device, rng: np.random.Generator) -> Device:
    """Noise, floor, temperature coefficients, electronics, loops: within what no one would call a gap."""
    n = rng.standard_normal
    noise, loops, electronics = device.noise, device.loops, device.electronics
    hemisphere = device.factory_data.kind == "hrg"
    louder = float(np.exp(0.4 * n()))
    wider = np.exp(rng.uniform(np.log(0.7), np.log(1.4), size=4))
    return replace(
        device,
        resonator=replace(device.resonator, quality_exponent=float(rng.uniform(0.3, 1.5))),
        drive=replace(device.drive, gain_tempco_per_k=float(1e-4 * n())),
        pickoff=replace(
            device.pickoff,
            gain_tempco_per_k=float(1e-4 * n()),
            non_orthogonality_rad=float(device.pickoff.non_orthogonality_rad + 2e-3 * n()),
        ),
        noise=replace(
            noise,
            pickoff_v_rthz=noise.pickoff_v_rthz * louder,
            drive_v_rthz=noise.drive_v_rthz * float(np.exp(0.4 * n())),
            drive_flicker_v=float(np.exp(rng.uniform(*np.log((2e-7, 2e-6))))),
        ),
        environment=replace(
            device.environment, wander_k=float(rng.uniform(0.0005, 0.004)), wander_time_s=float(np.exp(rng.uniform(*np.log((20.0, 200.0)))))
        ),
        loops=replace(
            loops,
            pll_bandwidth_hz=loops.pll_bandwidth_hz * float(wider[0]),
            amplitude_bandwidth_hz=loops.amplitude_bandwidth_hz * float(wider[1]),
            rebalance_bandwidth_hz=loops.rebalance_bandwidth_hz * float(wider[2]),
            quadrature_bandwidth_hz=loops.quadrature_bandwidth_hz * float(wider[3]),
        ),
        electronics=replace(electronics, adc_bits=int(rng.choice([0, 18, 20])), dac_bits=int(rng.choice([0, 0, 20]))),
        multiplexing=replace(device.multiplexing, enabled=bool(hemisphere and rng.random() < 0.2)),
        effects=_healthy_coefficients(rng, device),
    )


def _healthy_coefficients(rng: np.random.Generator, device: Device) -> dict[str, dict[str, float]]:
    """Differences between the axes that every real device shows with temperature."""
    n = rng.standard_normal
    return {
        "thermal_drive_gain": {"g_x": float(3e-5 * n()), "g_y": float(3e-5 * n())},
        "thermal_drive_phase": {"g_x": float(2e-5 * n()), "g_y": float(2e-5 * n())},
        "thermal_pickoff_gain": {"g_x": float(3e-5 * n()), "g_y": float(3e-5 * n())},
    }
