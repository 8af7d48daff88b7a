"""What a calibration says, with its covariance and its warnings; the JSON contract of design.md section 5."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..quantity import Quantity
from .compensation import IdentifiedChain
from .feedthrough_check import FeedthroughCheck
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
    """Estimate from the recordings up to a device time (for the picture of convergence).

    Parameters
    ----------
    time_s : float
        Device time [s].
    bias, scale_factor : mapping of str to Quantity
        By oscillator axis [rad/s], [V/(rad/s)].
    """

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
    feedthrough : FeedthroughCheck, optional
        What the side bands say of the feedthrough that was measured (force to rebalance).
    limits : mapping of str to mapping of str to float
        Share of the variance of rate, bias and scale factors by where it comes from, the largest first.
    drive_chain : IdentifiedChain, optional
        dG, 2 delta, 2 lambda as the controller sees them, whatever compensation was in force (whole angle).
    axis_scale_covariance : float, optional
        Covariance of the two scale factors [(V/(rad/s))^2].
    compensation : tuple of 4 float
        Drive compensation that ``mission`` holds for, row-major.
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
    feedthrough: FeedthroughCheck | None = None
    limits: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    drive_chain: IdentifiedChain | None = None
    axis_scale_covariance: float | None = None
    compensation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 1.0)

    @property
    def verdicts(self) -> tuple[str, ...]:
        """Findings in sentences: whether the feedthrough is as measured, and what limits each figure."""
        found = () if self.feedthrough is None else (self.feedthrough.verdict,)
        limited = tuple(
            f"{name} is limited by {', '.join(f'{source} ({100 * share:.0f} %)' for source, share in list(shares.items())[:2])}"
            for name, shares in self.limits.items()
        )
        return found + limited

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
            "verdicts": list(self.verdicts),
            **({} if self.feedthrough is None else {"feedthrough_check": self.feedthrough.to_json()}),
            **({} if not self.limits else {"variance_shares": {name: dict(shares) for name, shares in self.limits.items()}}),
            **({} if self.drive_chain is None else {"compensation": _compensation(self.drive_chain, self.compensation)}),
        }


def _compensation(found: IdentifiedChain, in_force: tuple[float, float, float, float]) -> dict[str, Any]:
    """The matrix that was in force, what it left, and the one that undoes the chain as it was found (row-major)."""
    sd = np.sqrt(np.diag(found.compensation_covariance()))
    return {
        "in_force": list(in_force),
        "residual": {name: q.to_json() for name, q in found.behind(in_force).quantities().items()},
        "matrix": [Quantity(float(c), float(s), "1").to_json() for c, s in zip(found.compensation(), sd, strict=True)],
    }
