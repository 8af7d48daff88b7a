"""What a calibration says, with its covariance and its warnings; the JSON contract of design.md section 5."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..quantity import Quantity
from .slow_flow_estimate import TableRow

__all__ = ["CalibrationResult", "ConvergencePoint", "MissionChannel"]


@dataclass(frozen=True)
class MissionChannel:
    """``rate_raw`` of one mission mode as the device runs: volts = ``volts_per_rad_s`` Omega + ``bias_v``.

    Parameters
    ----------
    bias_v, volts_per_rad_s : float
        Of the rebalance drive in phase with velocity [V], [V/(rad/s)]; of a whole-angle gyro, whose rate has no volts, [rad/s] and 1.
    covariance : ndarray, shape (2, 2)
        Of (bias_v, volts_per_rad_s).
    unit : str
        Of the channel: ``"V"``, or ``"rad/s"`` (whole angle).
    """

    bias_v: float
    volts_per_rad_s: float
    covariance: NDArray[np.float64]
    unit: str = "V"


@dataclass(frozen=True)
class ConvergencePoint:
    """Estimate from the recordings up to a device time (for the picture of convergence)."""

    time_s: float
    bias: Mapping[str, Quantity]
    scale_factor: Mapping[str, Quantity]


@dataclass(frozen=True)
class CalibrationResult:
    """Outcome of an estimate.

    Parameters
    ----------
    device_id, method : str
    rate : Quantity
        Constant input rate during the recordings [rad/s].
    bias, scale_factor : mapping of {"x", "y"} to Quantity
        By oscillator axis, of the feedthrough-free sensor (theory.md Eq. 7, p_y = 0): bias [rad/s], scale factor [V/(rad/s)] at
        ``amplitude_v``. With non-orthogonal pick-offs and drive couplings the slope of a real rate channel differs from Eq. 7 by their
        product (tens of ppm): ``mission`` holds it.
    mission : mapping of {"x", "y", "whole_angle"} to MissionChannel
        The same as the device runs: pick-off volts, feedthrough and phase error included, held where its loops hold them.
        ``"whole_angle"``: mean over the azimuth, latency of the loops included.
    parameters : mapping of str to Quantity
        As named in theory.md.
    rate_noise_density : mapping of {"x", "y", "whole_angle"} to Quantity
        White rate noise, one-sided [rad/s/sqrt(Hz)].
    condition_number : float
    chi2_per_dof : float
    amplitude_v, temperature_degc, temperature_sd_k, reference_frequency_hz : float
        Operating point.
    not_observable, warnings : tuple of str
    table : tuple of TableRow
    convergence : tuple of ConvergencePoint
    """

    device_id: str
    method: str
    rate: Quantity
    bias: Mapping[str, Quantity]
    scale_factor: Mapping[str, Quantity]
    mission: Mapping[str, MissionChannel]
    parameters: Mapping[str, Quantity]
    rate_noise_density: Mapping[str, Quantity]
    condition_number: float
    chi2_per_dof: float
    amplitude_v: float
    temperature_degc: float
    temperature_sd_k: float
    reference_frequency_hz: float
    not_observable: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    table: tuple[TableRow, ...] = ()
    convergence: tuple[ConvergencePoint, ...] = field(default=())

    def to_json(self) -> dict[str, Any]:
        """The JSON document of ``calibrate --json``."""
        return {
            "device_id": self.device_id,
            "method": self.method,
            "rate": self.rate.to_json(),
            "bias": {k: q.to_json() for k, q in self.bias.items()},
            "scale_factor": {k: q.to_json() for k, q in self.scale_factor.items()},
            "rate_channel": {
                k: {
                    "bias": Quantity(m.bias_v, float(np.sqrt(m.covariance[0, 0])), m.unit).to_json(),
                    "scale_factor": Quantity(
                        m.volts_per_rad_s, float(np.sqrt(m.covariance[1, 1])), "V/(rad/s)" if m.unit == "V" else "1"
                    ).to_json(),
                }
                for k, m in self.mission.items()
            },
            "rate_noise_density": {k: q.to_json() for k, q in self.rate_noise_density.items()},
            "parameters": {k: q.to_json() for k, q in self.parameters.items()},
            "condition_number": self.condition_number,
            "chi2_per_dof": self.chi2_per_dof,
            "operating_point": {
                "amplitude": Quantity(self.amplitude_v, 0.0, "V").to_json(),
                "reference_frequency": Quantity(self.reference_frequency_hz, 0.0, "Hz").to_json(),
                "temperature": Quantity(self.temperature_degc, self.temperature_sd_k, "degC").to_json(),
            },
            "not_observable": list(self.not_observable),
            "warnings": list(self.warnings),
        }
