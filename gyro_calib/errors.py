"""Errors whose text names the value that is wrong and the remedy.

One grammar: ``"<What> must <requirement>, but got <value>. <Remedy>"``.
"""

from __future__ import annotations

__all__ = ["CalibrationRefused", "DataError", "DeviceError", "ExperimentAborted", "GyroCalibError", "StoreError"]


class GyroCalibError(Exception):
    """Base of every error this package raises on purpose."""


class DataError(GyroCalibError):
    """A recording or stream is not usable: NaN, gap, repeat, clipping, wrong unit, missing column, wrong device."""


class DeviceError(GyroCalibError):
    """A device description is not physical or not readable."""


class StoreError(GyroCalibError):
    """A calibration record is torn, foreign, of another schema, or cannot be written."""


class ExperimentAborted(GyroCalibError):
    """A running sequence ended early: stream lost, temperature or base moved, cancelled, time-out."""


class CalibrationRefused(GyroCalibError):
    """The data do not support the estimate (ill-conditioned, not observable, failed its own checks)."""
