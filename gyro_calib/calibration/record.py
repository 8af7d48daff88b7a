"""The calibration record: what was found, how sure, when, from what, and for how long it holds."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from datetime import datetime, timezone
from typing import Any

from ..errors import DataError
from ..quantity import Quantity
from ._plain import float_map, plain, quantity, quantity_map, text

__all__ = ["NOISE_DENSITY_UNIT", "SCHEMA_VERSION", "CalibrationRecord", "canonical_json"]

SCHEMA_VERSION = 1
#: unit of :attr:`CalibrationRecord.rate_noise_density`
NOISE_DENSITY_UNIT = "rad/s/sqrt(Hz)"

_UNITS = {"bias": "rad/s", "scale_factor": "1", "rate_noise_density": NOISE_DENSITY_UNIT, "rate": "rad/s", "temperature_degc": "degC"}
_AXES = {"x", "y"}


@dataclass(frozen=True)
class CalibrationRecord:
    """A calibration of one device, as stored, published and applied.

    ``rate_raw = K * rate + bias`` with ``K = scale_factor``; the calibrated rate is ``(rate_raw - bias) / K``.

    Parameters
    ----------
    record_id : str
        Unique id (``<device>-<UTC time>-<8 hex digits of the content hash>``, see :meth:`with_new_id`).
    device_id : str
        The unit it belongs to; another unit must refuse it.
    created_utc : str
        ISO 8601 time of creation; without a zone it is read as UTC.
    method : str
        ``"sideband"``, ``"virtual_precession"``, ….
    mode : str
        Operating mode whose ``rate_raw`` it corrects (``"ftr_x"``, …).
    bias : Quantity
        b of ``rate_raw`` [rad/s]; value and sd finite.
    scale_factor : Quantity
        K of ``rate_raw``, dimensionless, not zero; value and sd finite.
    bias_scale_covariance : float
        Covariance of b and K [rad/s], not beyond the product of their sd.
    rate_noise_density : Quantity
        White rate noise (angle random walk) [rad/s/sqrt(Hz)], one-sided, equal to the ARW in rad/sqrt(s) times sqrt(2).
    rate : Quantity
        Constant input rate found during the calibration [rad/s].
    temperature_degc : Quantity
        Mean temperature of the calibration and its spread.
    bias_by_axis, scale_factor_by_axis : mapping of str to Quantity
        By oscillator axis: bias [rad/s], scale factor [V per rad/s].
    compensation : tuple of 4 float
        Drive compensation matrix in force, row-major.
    compensation_covariance : tuple of 16 float
        Covariance of its elements, row-major: how well the drive chain that they undo is known; empty for a matrix that was not identified.
    axis_scale_covariance : float, optional
        Covariance of the two of ``scale_factor_by_axis`` [(V per rad/s)^2], where it is known.
    parameters : mapping of str to Quantity
        The fitted parameters (``A_yx_re``, ``G_yy_abs``, ``pickoff_ratio``, …).
    operating_point : mapping of str to float
        ``amplitude_v``, ``ref_freq_hz``, … at calibration.
    validity : mapping of str to float
        ``temperature_min_degc``, ``temperature_max_degc``, ``max_age_s``; one that is absent or not finite sets no limit.
    condition_number : float
        Of the scaled normal equations.
    not_observable, warnings : tuple of str
        What the data could not tell, and what a user should know.
    provenance : mapping
        Run id, plan, software version, duration, hash of the data, …: numbers, texts, lists and mappings of them.
    schema_version : int
        Version of this layout.

    Raises
    ------
    DataError
        A field that could not be applied safely: empty id, wrong unit, a bias or scale factor that is not finite, a covariance that no
        pair of numbers can have, limits out of order, a time that is not ISO 8601.
    """

    record_id: str
    device_id: str
    created_utc: str
    method: str
    mode: str
    bias: Quantity
    scale_factor: Quantity
    bias_scale_covariance: float
    rate_noise_density: Quantity
    rate: Quantity
    temperature_degc: Quantity
    bias_by_axis: Mapping[str, Quantity] = field(default_factory=dict)
    scale_factor_by_axis: Mapping[str, Quantity] = field(default_factory=dict)
    compensation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 1.0)
    compensation_covariance: tuple[float, ...] = ()
    axis_scale_covariance: float | None = None
    parameters: Mapping[str, Quantity] = field(default_factory=dict)
    operating_point: Mapping[str, float] = field(default_factory=dict)
    validity: Mapping[str, float] = field(default_factory=dict)
    condition_number: float = float("nan")
    not_observable: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    schema_version: int = SCHEMA_VERSION

    def __post_init__(self) -> None:
        for name in ("record_id", "device_id", "method", "mode"):
            text(f"Record {name}", getattr(self, name))
        _created(self.created_utc)
        if self.schema_version != SCHEMA_VERSION:
            raise DataError(f"Record schema_version must be {SCHEMA_VERSION}, but got {self.schema_version!r}. Use a matching gyro_calib.")
        self._normalise()
        self._check_correction()
        self._check_limits()

    def _normalise(self) -> None:
        """Plain Python types throughout, so that what is stored, hashed and compared is the same thing."""
        put = object.__setattr__
        for name, unit in _UNITS.items():
            put(self, name, _in_unit(name, getattr(self, name), unit))
        for name in ("bias_by_axis", "scale_factor_by_axis", "parameters"):
            put(self, name, quantity_map(f"Record {name}", getattr(self, name)))
        for name in ("bias_by_axis", "scale_factor_by_axis"):
            if strangers := set(getattr(self, name)) - _AXES:
                raise DataError(f"Record {name} must have the keys x and y, but got {sorted(strangers)!r}.")
        put(self, "operating_point", float_map("Record operating_point", self.operating_point))
        limits = float_map("Record validity", self.validity)
        put(self, "validity", {k: v for k, v in limits.items() if math.isfinite(v)})
        for name in ("not_observable", "warnings"):
            if isinstance(getattr(self, name), str):
                raise DataError(f"Record {name} must be a list of texts, but got the text {getattr(self, name)!r}.")
            put(self, name, tuple(str(item) for item in getattr(self, name)))
        put(self, "bias_scale_covariance", float(self.bias_scale_covariance))
        put(self, "condition_number", float(self.condition_number))
        between = self.axis_scale_covariance
        put(self, "axis_scale_covariance", None if between is None or not math.isfinite(between) else float(between))
        put(self, "compensation", tuple(float(c) for c in self.compensation))
        put(self, "compensation_covariance", tuple(float(c) for c in self.compensation_covariance))
        put(self, "provenance", plain("Record provenance", dict(self.provenance)))

    def _check_correction(self) -> None:
        for name in ("bias", "scale_factor", "rate_noise_density"):
            q = getattr(self, name)
            if not math.isfinite(q.value):
                raise DataError(f"Record {name} must be finite, but got {q.value!r}. What was not observed cannot be applied.")
        for name in ("bias", "scale_factor"):
            sd = getattr(self, name).sd
            if not math.isfinite(sd):
                raise DataError(f"Record {name} must have a finite sd, but got {sd!r}. Give the sd of the factory value instead.")
        if self.scale_factor.value == 0.0:
            raise DataError("Record scale_factor must not be 0, but got 0.0.")
        if self.rate_noise_density.value < 0.0:
            raise DataError(f"Record rate_noise_density must be >= 0, but got {self.rate_noise_density.value!r}.")
        largest = self.bias.sd * self.scale_factor.sd
        if not abs(self.bias_scale_covariance) <= largest * (1.0 + 1e-9):
            raise DataError(
                f"Record bias_scale_covariance must lie within +/- sd(bias) sd(scale_factor) = {largest:.6g} rad/s, "
                f"but got {self.bias_scale_covariance!r}. Take all three from one covariance matrix."
            )

    def _check_limits(self) -> None:
        if len(self.compensation) != 4 or not all(math.isfinite(c) for c in self.compensation):
            raise DataError(f"Record compensation must be 4 finite numbers (2x2, row-major), but got {self.compensation!r}.")
        spread = self.compensation_covariance
        if spread and (len(spread) != 16 or not all(math.isfinite(c) for c in spread) or min(spread[::5]) < 0.0):
            raise DataError(f"Record compensation_covariance must be empty or a 4x4 covariance, row-major, but got {spread!r}.")
        lo, hi = self.validity.get("temperature_min_degc", -math.inf), self.validity.get("temperature_max_degc", math.inf)
        if lo > hi:
            raise DataError(f"Record validity temperature_min_degc must be <= temperature_max_degc, but got {lo!r} > {hi!r}.")
        if self.validity.get("max_age_s", 1.0) <= 0.0:
            raise DataError(f"Record validity max_age_s must be > 0, but got {self.validity['max_age_s']!r}.")

    @property
    def created(self) -> datetime:
        """Time of creation, in UTC."""
        return _created(self.created_utc)

    @property
    def content_hash(self) -> str:
        """SHA-256 (hex) of everything but ``record_id``: the same findings have the same hash."""
        content = {k: v for k, v in self.to_dict().items() if k != "record_id"}
        return hashlib.sha256(canonical_json(content).encode()).hexdigest()

    def with_new_id(self) -> CalibrationRecord:
        """Return a copy whose ``record_id`` is ``<device>-<UTC time>-<8 hex digits of the content hash>``."""
        return replace(self, record_id=f"{self.device_id}-{self.created:%Y%m%dT%H%M%SZ}-{self.content_hash[:8]}")

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON and YAML; quantities as ``{"value", "sd", "unit"}``, numbers that are not finite as ``None``."""
        return {f.name: _to_plain(getattr(self, f.name)) for f in fields(self)}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> CalibrationRecord:
        """Inverse of :meth:`to_dict`.

        Raises
        ------
        DataError
            A field is missing, unknown, or not of its type; and whatever the constructor refuses.
        """
        if not isinstance(data, Mapping):
            raise DataError(f"Record must be a mapping of fields, but got {type(data).__name__}.")
        known = {f.name for f in fields(cls)}
        if unknown := sorted(map(str, set(data) - known)):
            raise DataError(f"Record fields must be of schema {SCHEMA_VERSION}, but got {', '.join(unknown)}. Use a matching gyro_calib.")
        values = dict(data)
        try:
            for name in _UNITS:
                values[name] = quantity(f"Record {name}", values[name])
            for name in ("bias_by_axis", "scale_factor_by_axis", "parameters"):
                values[name] = quantity_map(f"Record {name}", values.get(name, {}))
            if values.get("condition_number", math.nan) is None:
                values["condition_number"] = math.nan
            values["compensation"] = tuple(values.get("compensation", (1.0, 0.0, 0.0, 1.0)))
            values["compensation_covariance"] = tuple(values.get("compensation_covariance", ()))
            return cls(**values)
        except KeyError as error:
            raise DataError(f"Record must have the field {error.args[0]}, but it is missing.") from error
        except (TypeError, ValueError, OverflowError, AttributeError) as error:
            raise DataError(f"Record fields must be of their types, but got something else ({error}).") from error


def canonical_json(value: Any) -> str:
    """One text for one content: sorted keys, no white space, shortest exact floats. What checksums are taken of."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=True)


def _to_plain(value: Any) -> Any:
    if isinstance(value, Quantity):
        return value.to_json()
    if isinstance(value, Mapping):
        return {k: _to_plain(v) for k, v in value.items()}
    if isinstance(value, (tuple, list)):
        return [_to_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _created(created_utc: object) -> datetime:
    try:
        # fromisoformat of Python 3.10 does not know the Z
        when = datetime.fromisoformat(str(created_utc).replace("Z", "+00:00"))
    except ValueError as error:
        raise DataError(f"Record created_utc must be an ISO 8601 time, but got {created_utc!r}.") from error
    return (when if when.tzinfo else when.replace(tzinfo=timezone.utc)).astimezone(timezone.utc)


def _in_unit(name: str, value: object, unit: str) -> Quantity:
    if not isinstance(value, Quantity):
        raise DataError(f"Record {name} must be a Quantity, but got {type(value).__name__}.")
    if value.unit != unit:
        raise DataError(f"Record {name} must be in {unit!r}, but got {value.unit!r}. Convert it before making the record.")
    return quantity(f"Record {name}", value)
