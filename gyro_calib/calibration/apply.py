"""Apply a calibration to a rate, once."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timezone

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import DataError
from .errormodel import CovarianceModel, RateErrorModel
from .record import CalibrationRecord

__all__ = ["CorrectedRate", "Corrector", "validity_problems"]


@dataclass(frozen=True)
class CorrectedRate:
    """A calibrated rate. Its type is the mark that it is corrected: a :class:`Corrector` refuses it.

    Parameters
    ----------
    rate_rad_s : ndarray, shape of the input
        Calibrated rate [rad/s].
    variance : ndarray, same shape
        Its variance [(rad/s)**2], in the mode of the corrector.
    device_id, record_id : str
        The unit and the record that was applied.
    """

    rate_rad_s: NDArray[np.float64]
    variance: NDArray[np.float64]
    device_id: str
    record_id: str


class Corrector:
    """Applies one record: ``(rate_raw - bias) / scale_factor`` with its variance.

    Immutable; a new record or another covariance mode is a new corrector, so that it can be exchanged between two samples.

    Parameters
    ----------
    record : CalibrationRecord
        What is applied.
    device_id : str
        The device whose rate is corrected.
    covariance : CovarianceModel
        Which variance is given (``white``, ``total``, ``horizon``).
    bias_drift_sd_rad_s, sd_factor : float
        See :meth:`RateErrorModel.from_record`.

    Raises
    ------
    DataError
        The record belongs to another device.
    """

    def __init__(
        self,
        record: CalibrationRecord,
        *,
        device_id: str,
        covariance: CovarianceModel | None = None,
        bias_drift_sd_rad_s: float = 0.0,
        sd_factor: float = 1.0,
    ) -> None:
        if record.device_id != device_id:
            raise DataError(
                f"Record must belong to device {device_id!r}, but got {record.record_id!r} of device {record.device_id!r}. "
                "Calibrate this device, or load its own record."
            )
        self.record = record
        self.covariance = covariance or CovarianceModel()
        self.errors = RateErrorModel.from_record(record, bias_drift_sd_rad_s=bias_drift_sd_rad_s, sd_factor=sd_factor)

    def apply(self, rate_raw: ArrayLike) -> CorrectedRate:
        """Correct a rate.

        Parameters
        ----------
        rate_raw : array_like, any shape
            Uncalibrated rate [rad/s].

        Raises
        ------
        DataError
            The rate is corrected already, or a sample is not finite (in a mode without a rate channel it is NaN).
        """
        if isinstance(rate_raw, CorrectedRate):
            raise DataError(f"Rate must be raw, but got one corrected by record {rate_raw.record_id!r}. Apply a calibration once.")
        raw = np.asarray(rate_raw, dtype=np.float64)
        if not np.isfinite(raw).all():
            first = int(np.flatnonzero(~np.isfinite(raw))[0])
            raise DataError(f"Rate must be finite, but sample {first} is {raw.flat[first]}. Correct data of mode {self.record.mode!r}.")
        rate = (raw - self.errors.bias_rad_s) / self.errors.scale_factor
        c0, c1, c2 = self.errors.variance_coefficients(self.covariance)
        return CorrectedRate(rate, c0 + rate * (c1 + c2 * rate), self.record.device_id, self.record.record_id)

    def apply_scalar(self, rate_raw: float) -> tuple[float, float]:
        """Return calibrated rate [rad/s] and variance [(rad/s)**2] of one sample, without arrays; NaN stays NaN."""
        rate = (rate_raw - self.errors.bias_rad_s) / self.errors.scale_factor
        c0, c1, c2 = self.errors.variance_coefficients(self.covariance)
        return rate, c0 + rate * (c1 + c2 * rate)


def validity_problems(
    record: CalibrationRecord,
    *,
    temperature_degc: float | None = None,
    now: datetime | None = None,
    mode: str | None = None,
    compensation: tuple[float, ...] | None = None,
) -> tuple[str, ...]:
    """Why a record does not hold under present conditions; empty when it does. What is ``None`` is not checked.

    Parameters
    ----------
    record : CalibrationRecord
        The record.
    temperature_degc : float, optional
        Temperature of the gyro [degC].
    now : datetime, optional
        Time of use; without a zone it is UTC.
    mode : str, optional
        Operating mode of the gyro.
    compensation : tuple of 4 float, optional
        Drive compensation matrix of the gyro.
    """
    problems = []
    limits = record.validity
    if temperature_degc is not None:
        lo, hi = limits.get("temperature_min_degc", -np.inf), limits.get("temperature_max_degc", np.inf)
        if not lo <= temperature_degc <= hi:
            problems.append(f"Temperature must be {lo:g} to {hi:g} degC, but got {temperature_degc:.4g} degC. Calibrate there.")
    if now is not None and "max_age_s" in limits:
        age = ((now if now.tzinfo else now.replace(tzinfo=timezone.utc)) - record.created).total_seconds()
        if age > limits["max_age_s"]:
            problems.append(f"Record must be at most {limits['max_age_s']:g} s old, but got {age:.0f} s. Calibrate again.")
    if mode is not None and mode != record.mode:
        problems.append(f"Mode must be {record.mode!r}, but the gyro runs {mode!r}. Set the mode, or calibrate in this one.")
    if compensation is not None and not np.allclose(compensation, record.compensation, rtol=0.0, atol=1e-9):
        problems.append(f"Drive compensation must be {list(record.compensation)}, but the gyro has {list(compensation)}. Calibrate again.")
    return tuple(problems)
