"""The factory record: Bryant factor, pick-off frame, mounting and fixed rate difference of one unit, stored apart from field calibrations.

It has a file, a format and a schema of its own (``<device>.factory.yaml``), written once by the factory and read-only for the field: a
field calibration takes kappa and the rate correction from it (:func:`with_factory_record`) and has no way to write it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from typing import TYPE_CHECKING, Any

from ..errors import DataError
from ..quantity import Quantity
from ._plain import plain, quantity, text

if TYPE_CHECKING:
    from ..estimation.factory import FactoryResult
    from ..recording.recording import Campaign

__all__ = ["FACTORY_FORMAT", "FACTORY_SCHEMA", "FactoryRecord", "factory_record_from_result", "with_factory_record"]

#: what the key ``format`` of a factory document says
FACTORY_FORMAT = "gyro_calib factory record"
FACTORY_SCHEMA = 1
_QUANTITIES = {
    "angular_gain_kappa": "1",
    "pickoff_ratio": "1",
    "pickoff_non_orthogonality": "rad",
    "pickoff_phase": "rad",
}


@dataclass(frozen=True)
class FactoryRecord:
    """What the factory found of one unit.

    Parameters
    ----------
    device_id : str
        The unit; another one's is refused.
    created_utc : str
        ISO 8601 time.
    angular_gain_kappa, pickoff_ratio, pickoff_non_orthogonality, pickoff_phase : Quantity
        See :class:`gyro_calib.estimation.factory.FactoryResult`.
    misalignment : mapping of {"about_x", "about_y"} to Quantity, or None
        Sense axis against the case [rad].
    rate_difference : Quantity or None
        Rate that a field calibration finds minus the true one [rad/s]; subtracted from what later field calibrations find.
    temperature_degc : float
    provenance : mapping
        Software, recordings, known rate, warnings.

    Raises
    ------
    DataError
        An empty id, a wrong unit, a kappa that is not positive.
    """

    device_id: str
    created_utc: str
    angular_gain_kappa: Quantity
    pickoff_ratio: Quantity
    pickoff_non_orthogonality: Quantity
    pickoff_phase: Quantity
    misalignment: Mapping[str, Quantity] | None
    rate_difference: Quantity | None
    temperature_degc: float
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        text("Factory record device_id", self.device_id)
        text("Factory record created_utc", self.created_utc)
        wanted = [(name, getattr(self, name), unit) for name, unit in _QUANTITIES.items()]
        wanted += [(f"misalignment {k}", q, "rad") for k, q in (self.misalignment or {}).items()]
        wanted += [("rate_difference", self.rate_difference, "rad/s")] if self.rate_difference is not None else []
        for name, q, unit in wanted:
            if not isinstance(q, Quantity) or q.unit != unit:
                raise DataError(f"Factory record {name} must be a quantity in {unit}, but got {q!r}.")
        if not self.angular_gain_kappa.value > 0.0:
            raise DataError(f"Factory record angular_gain_kappa must be > 0, but got {self.angular_gain_kappa.value!r}.")

    def to_dict(self) -> dict[str, Any]:
        """Plain types; quantities as ``{"value", "sd", "unit"}``."""
        return {
            "device_id": self.device_id,
            "created_utc": self.created_utc,
            **{name: getattr(self, name).to_json() for name in _QUANTITIES},
            "misalignment": None if self.misalignment is None else {k: q.to_json() for k, q in self.misalignment.items()},
            "rate_difference": None if self.rate_difference is None else self.rate_difference.to_json(),
            "temperature_degc": float(self.temperature_degc),
            "provenance": plain("Factory record provenance", dict(self.provenance)),
        }

    @classmethod
    def from_dict(cls, data: Any) -> FactoryRecord:
        """Inverse of :meth:`to_dict`; raises :class:`DataError` for what is missing or of another type."""
        if not isinstance(data, Mapping):
            raise DataError(f"Factory record must be a mapping, but got {type(data).__name__}.")
        try:
            tilt, difference = data["misalignment"], data["rate_difference"]
            return cls(
                device_id=data["device_id"],
                created_utc=data["created_utc"],
                **{name: quantity(f"Factory record {name}", data[name]) for name in _QUANTITIES},
                misalignment=None if tilt is None else {k: quantity(f"Factory record misalignment {k}", q) for k, q in tilt.items()},
                rate_difference=None if difference is None else quantity("Factory record rate_difference", difference),
                temperature_degc=float(data["temperature_degc"]),
                provenance=dict(data["provenance"]),
            )
        except KeyError as error:
            raise DataError(f"Factory record must have the field {error.args[0]}, but it is missing.") from error
        except (TypeError, ValueError, AttributeError) as error:
            raise DataError(f"Factory record fields must be of their types, but got something else ({error}).") from error


def factory_record_from_result(
    result: FactoryResult, campaign: Campaign, *, known_rate: Quantity | None = None, created: datetime | None = None
) -> FactoryRecord:
    """The record of a factory estimate.

    Parameters
    ----------
    result : FactoryResult
        The estimate.
    campaign : Campaign
        What it comes from, for the provenance.
    known_rate : Quantity, optional
        Constant rate that was known while the table stood [rad/s], for the provenance.
    created : datetime, optional
        Time of creation; default now.
    """
    from .. import __version__

    return FactoryRecord(
        device_id=result.device_id,
        created_utc=(created or datetime.now(timezone.utc)).isoformat(timespec="seconds"),
        **{name: getattr(result, name) for name in _QUANTITIES},
        misalignment=result.misalignment,
        rate_difference=result.rate_difference,
        temperature_degc=result.temperature_degc,
        provenance={
            "software": f"gyro_calib {__version__}",
            "recordings": len(campaign),
            "duration_s": sum(r.duration_s for r in campaign),
            "known_rate": None if known_rate is None else known_rate.to_json(),
            "chi2_per_dof": result.chi2_per_dof,
            "warnings": list(result.warnings),
        },
    )


def with_factory_record(campaign: Campaign, record: FactoryRecord | None) -> Campaign:
    """The campaign with kappa and the fixed rate difference of the factory record in its factory data (unchanged without a record).

    ``angular_gain_kappa`` becomes the measured one, with ``angular_gain_kappa_sd``; ``fixed_rate_difference_rad_s`` and its sd are
    subtracted from the constant rate that the side-band estimate finds, so that the bias holds at the true rate.

    Raises
    ------
    DataError
        The record is another device's.
    """
    if record is None:
        return campaign
    if record.device_id != campaign.device_id:
        raise DataError(f"Factory record must belong to device {campaign.device_id!r}, but got one of {record.device_id!r}.")
    known = dict(campaign.factory)
    known["angular_gain_kappa"] = record.angular_gain_kappa.value
    known["angular_gain_kappa_sd"] = record.angular_gain_kappa.sd
    if record.rate_difference is not None:
        known["fixed_rate_difference_rad_s"] = record.rate_difference.value
        known["fixed_rate_difference_sd_rad_s"] = record.rate_difference.sd
    return replace(campaign, factory=known)
