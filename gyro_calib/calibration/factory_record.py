"""The factory record: Bryant factor, pick-off frame, mounting and fixed rate difference of one unit, stored apart from field calibrations.

It has a file, a format and a schema of its own (``<device>.factory.yaml``), written once by the factory and read-only for the field: a field
calibration takes kappa and the rate correction from it (:func:`with_factory_record`) and has no way to write it.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any
from urllib.parse import quote

from ..errors import DataError, StoreError
from ..estimation.factory import FactoryResult
from ..quantity import Quantity
from ..recording.recording import Campaign
from ._plain import plain, quantity, text
from .document import dump_content, parse_content
from .files import clean_temporaries, locked_directory, make_directory, replace_text, take_copy
from .location import resolve_url, ros_home

__all__ = ["FACTORY_FORMAT", "FactoryRecord", "FactoryStore", "factory_path", "factory_record_from_result", "with_factory_record"]

#: what the key ``format`` of a factory document says
FACTORY_FORMAT = "gyro_calib factory record"
FACTORY_SCHEMA = 1
_HEADER = """\
# Factory record of gyro_calib: what only a rate table tells. A field calibration reads it and never writes it.
# Do not edit: the checksum covers the content and an edited record is refused.
"""
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
    """The record of a factory estimate."""
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


def factory_path(url_or_path: str | os.PathLike[str] | None, device_id: str) -> Path:
    """File of a unit's factory record: the path or URL given, ``<device>.factory.yaml`` in a directory given, or in ``$ROS_HOME/gyro_calib``."""
    name = f"{quote(device_id, safe='')}.factory.yaml"
    if url_or_path is None or not os.fspath(url_or_path):
        return ros_home() / "gyro_calib" / name
    path = resolve_url(url_or_path, device_id)
    given = os.fspath(url_or_path)
    return path.with_name(name) if given.endswith("/") or Path(given).is_dir() else path


class FactoryStore:
    """Keeps the factory record of one unit.

    Parameters
    ----------
    url_or_path : str, path or None
        See :func:`factory_path`.
    device_id : str
    lock_timeout_s : float
        How long to wait for another writer.
    """

    def __init__(self, url_or_path: str | os.PathLike[str] | None, device_id: str, *, lock_timeout_s: float = 10.0) -> None:
        self.device_id = device_id
        self.path = factory_path(url_or_path, device_id)
        self._lock_timeout_s = lock_timeout_s

    def load(self) -> FactoryRecord | None:
        """The record, or None when there is no file.

        Raises
        ------
        StoreError
            The file is torn, foreign, of another schema or device, or not readable.
        """
        try:
            content = self.path.read_text(encoding="utf-8")
        except FileNotFoundError:
            return None
        except (OSError, UnicodeDecodeError) as error:
            raise StoreError(f"Factory record {self.path} must be readable, but got: {error}.") from error
        source = f"Factory record {self.path}"
        try:
            record = FactoryRecord.from_dict(parse_content(content, FACTORY_FORMAT, FACTORY_SCHEMA, source=source))
        except DataError as error:
            raise StoreError(f"{source} must hold a valid record, but got: {error}") from error
        if record.device_id != self.device_id:
            raise StoreError(f"{source} must belong to device {self.device_id!r}, but got one of {record.device_id!r}. Correct the path.")
        return record

    def save(self, record: FactoryRecord, *, replace_existing: bool = False) -> Path:
        """Store a record; the one before it, if it may be replaced, is kept as ``<file>.before``.

        Raises
        ------
        StoreError
            Another device's record, one that is there already, or a disk that refuses; what was stored stays as it was.
        """
        if record.device_id != self.device_id:
            raise StoreError(f"Factory store of {self.device_id!r} must get its own record, but got one of {record.device_id!r}.")
        document = dump_content(_HEADER, FACTORY_FORMAT, FACTORY_SCHEMA, record.to_dict())
        try:
            make_directory(self.path.parent)
            with locked_directory(self.path.parent, self._lock_timeout_s):
                clean_temporaries(self.path.parent)
                if self.path.exists():
                    if not replace_existing:
                        raise StoreError(f"Factory record {self.path} must not be overwritten, but there is one. Say --replace to do so.")
                    take_copy(self.path, self.path.with_name(self.path.name + ".before"))
                replace_text(self.path, document)
                # only says what it is: whoever may write the directory can still replace the file
                with contextlib.suppress(OSError):
                    self.path.chmod(0o444)
        except OSError as error:
            raise StoreError(f"Factory record {self.path} must be writable, but got: {error}. What was stored is untouched.") from error
        return self.path


def with_factory_record(campaign: Campaign, record: FactoryRecord | None) -> Campaign:
    """The campaign with kappa and the fixed rate difference of the factory record in its factory data (unchanged without a record).

    ``angular_gain_kappa`` becomes the measured one, with ``angular_gain_kappa_sd``; ``fixed_rate_difference_rad_s`` and its sd are subtracted
    from the constant rate that the side-band estimate finds, so that the bias holds at the true rate.

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
