"""From an estimate to the record that a corrector applies: ``rate_raw`` of the mission mode, as made with the nominal scale factor."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from datetime import datetime, timezone
from typing import Any

from .. import __version__
from ..errors import CalibrationRefused
from ..estimation import CalibrationResult
from ..quantity import Quantity
from ..recording.command import Command
from ..recording.recording import Campaign
from .record import CalibrationRecord

__all__ = ["record_from_result"]

#: a record is applied without a warning within this distance from its temperature [K], and for this long [s]
VALID_K = 5.0
VALID_S = 30.0 * 86400.0
#: mission mode -> its channel in a result
_CHANNELS = {"ftr_x": "x", "ftr_y": "y", "whole_angle": "whole_angle"}


def record_from_result(
    result: CalibrationResult,
    campaign: Campaign,
    *,
    run_id: str,
    mode: str = "ftr_x",
    created: datetime | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> CalibrationRecord:
    """Build the record of an estimate.

    Parameters
    ----------
    result : CalibrationResult
        What was estimated.
    campaign : Campaign
        What it was estimated from; its factory data hold the nominal scale factor that ``rate_raw`` was made with.
    run_id : str
        Run that made it.
    mode : str
        Mission mode, ``"ftr_x"``, ``"ftr_y"`` or ``"whole_angle"``.
    created : datetime, optional
        Time of creation (default: now).
    provenance : mapping, optional
        What to tell besides.

    Raises
    ------
    CalibrationRefused
        The mode has no rate channel in the result, the factory data lack the nominal scale factor, or the estimate is not finite.
    """
    key = _CHANNELS.get(mode, "")
    if key not in result.mission:
        known = ", ".join(m for m, name in _CHANNELS.items() if name in result.mission)
        raise CalibrationRefused(f"Mode must be one that the result calibrates ({known}), but got {mode!r}.")
    channel = result.mission[key]
    volts = _nominal_volts(result, campaign, key) if channel.unit == "V" else 1.0
    variance = channel.covariance / volts**2
    if not (math.isfinite(channel.bias_v) and math.isfinite(channel.volts_per_rad_s) and math.isfinite(float(variance.sum()))):
        found = f"bias {channel.bias_v!r} {channel.unit} and {channel.volts_per_rad_s!r} {channel.unit}/(rad/s)"
        raise CalibrationRefused(f"Estimate must be finite, but got {found}.")
    compensation = campaign.recordings[-1].command.compensation
    compensated = result.drive_chain if compensation != Command().compensation else None
    temperatures = [t for r in campaign for t in (float(r.temperature_degc.min()), float(r.temperature_degc.max()))]
    record = CalibrationRecord(
        record_id="pending",
        device_id=result.device_id,
        created_utc=(created or datetime.now(timezone.utc)).isoformat(timespec="seconds"),
        method=result.method,
        mode=mode,
        bias=Quantity(channel.bias_v / volts, math.sqrt(variance[0, 0]), "rad/s"),
        scale_factor=Quantity(channel.volts_per_rad_s / volts, math.sqrt(variance[1, 1]), "1"),
        bias_scale_covariance=float(variance[0, 1]),
        rate_noise_density=result.rate_noise_density[key],
        rate=result.rate,
        temperature_degc=Quantity(result.temperature_degc, result.temperature_sd_k, "degC"),
        bias_by_axis=dict(result.bias),
        scale_factor_by_axis=dict(result.scale_factor),
        compensation=compensation,
        compensation_covariance=() if compensated is None else tuple(compensated.compensation_covariance().ravel()),
        axis_scale_covariance=result.axis_scale_covariance,
        parameters={**result.parameters, **_residual(result, compensation)},
        operating_point={"amplitude_v": result.amplitude_v, "ref_freq_hz": result.reference_frequency_hz},
        validity={
            "temperature_min_degc": min(temperatures) - VALID_K,
            "temperature_max_degc": max(temperatures) + VALID_K,
            "max_age_s": VALID_S,
        },
        condition_number=result.condition_number,
        not_observable=result.not_observable,
        warnings=result.warnings,
        provenance={
            "run_id": run_id,
            "software": f"gyro_calib {__version__}",
            "recordings": len(campaign),
            "duration_s": sum(r.duration_s for r in campaign),
            "data_sha256": _fingerprint(campaign),
            "chi2_per_dof": result.chi2_per_dof,
            "nominal_scale_factor_v_per_rad_s": volts,
            "equation": "rate = (rate_raw - bias) / scale_factor; kappa assumed constant (no self-calibration sees it)",
            **(provenance or {}),
        },
    )
    return record.with_new_id()


def _residual(result: CalibrationResult, compensation: tuple[float, float, float, float]) -> dict[str, Quantity]:
    """What the compensation leaves of the drive chain."""
    return {} if result.drive_chain is None else result.drive_chain.behind(compensation).quantities("residual_")


def _nominal_volts(result: CalibrationResult, campaign: Campaign, axis: str) -> float:
    """What the firmware divides the rate channel by at the amplitude of the result [V/(rad/s)]."""
    nominal = campaign.factory.get("nominal_scale_factor_v_per_rad_s")
    if not isinstance(nominal, dict) or axis not in nominal:
        raise CalibrationRefused(f"Factory data must hold nominal_scale_factor_v_per_rad_s for {axis!r}, but got {nominal!r}.")
    return float(nominal[axis]) * result.amplitude_v / float(campaign.factory.get("nominal_amplitude_v", result.amplitude_v))


def _fingerprint(campaign: Campaign) -> str:
    digest = hashlib.sha256()
    for recording in campaign:
        digest.update(recording.data.tobytes())
    return digest.hexdigest()
