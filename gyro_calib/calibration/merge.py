"""A scale-factor run renews the scale factor of a record and leaves what it does not measure well: bias, rate, drive compensation."""

from __future__ import annotations

from dataclasses import replace

from ..errors import DataError
from .record import CalibrationRecord

__all__ = ["with_scale_factor_of"]

#: parameters that ring-down, ring-up and stiffness control measure better than anything else
_GAINS = ("G_xx_abs", "G_yy_abs", "decay_rate_x", "decay_rate_y", "decay_rate", "k_vir")


def with_scale_factor_of(previous: CalibrationRecord, renewed: CalibrationRecord) -> CalibrationRecord:
    """``previous`` with the scale factor of ``renewed``, under a new id.

    The gains have drifted since, so the new scale factors replace the old ones, their covariance with them; the two come from different
    data, so scale factor and bias are no longer correlated. Operating point and validity are those of the new run.

    Parameters
    ----------
    previous : CalibrationRecord
        In force.
    renewed : CalibrationRecord
        What the scale-factor run found, with the same compensation in force.

    Raises
    ------
    DataError
        Not of the same device, mode and compensation.
    """
    for name in ("device_id", "mode", "compensation"):
        mine, other = getattr(previous, name), getattr(renewed, name)
        if mine != other:
            raise DataError(f"Record to renew must have {name} {other!r}, but got {mine!r}. Run the whole calibration instead.")
    taken = {
        name: value for name, value in renewed.parameters.items() if name.startswith(("scale_factor_", "loop_latency")) or name in _GAINS
    }
    return replace(
        previous,
        record_id="pending",
        created_utc=renewed.created_utc,
        scale_factor=renewed.scale_factor,
        bias_scale_covariance=0.0,
        temperature_degc=renewed.temperature_degc,
        scale_factor_by_axis=renewed.scale_factor_by_axis,
        axis_scale_covariance=renewed.axis_scale_covariance,
        parameters={**previous.parameters, **taken},
        operating_point=renewed.operating_point,
        validity=renewed.validity,
        warnings=tuple(dict.fromkeys((*previous.warnings, *renewed.warnings))),
        provenance={
            **previous.provenance,
            "run_id": renewed.provenance.get("run_id"),
            "scale_factor_from": dict(renewed.provenance),
            "bias_from": previous.provenance.get("bias_from", previous.record_id),
        },
    ).with_new_id()
