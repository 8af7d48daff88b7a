"""The uncalibrated rate of a gyro's own firmware: rebalance drive over the *nominal* scale factor, or turning of a free wave over the
*nominal* angular gain.

``omega_meas = K omega + b + n`` with ``K`` the true scale factor over the nominal one; calibration finds ``K`` and ``b``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from .columns import column_index
from .command import Command

__all__ = ["WAVE_MODES", "rate_range", "raw_rate", "wave_azimuth"]

FloatArray = NDArray[np.float64]
#: modes in which the wave turns freely
WAVE_MODES = ("whole_angle", "stiffness", "ring_down", "ring_up")
_RATE_COLUMN = {"ftr_x": ("y_drive_s", "x"), "ftr_y": ("x_drive_s", "y")}
#: share of the drive's full scale that is still believed
_BELIEVED = 0.98


def raw_rate(rows: FloatArray, command: Command, factory: Mapping[str, Any], *, before: FloatArray | None = None) -> FloatArray:
    """Uncalibrated rate of each row [rad/s].

    Parameters
    ----------
    rows : ndarray, shape (n, 12)
        Rows in recording order, of one segment.
    command : Command
        What was in force.
    factory : mapping
        ``nominal_scale_factor_v_per_rad_s`` {x, y} at ``nominal_amplitude_v`` (default 1 V); of a free wave ``angular_gain_kappa``.
    before : ndarray, shape (12,), optional
        The row before the first one, of a free wave: with it the rates of successive blocks add up to the angle turned, however the rows
        are divided. Ignored when it is of another segment.

    Returns
    -------
    ndarray, shape (n,)
        Force to rebalance: rebalance drive in phase with velocity over the nominal scale factor (theory.md Eq. 7). Free wave
        (:data:`WAVE_MODES`): mean of ``-2 theta' / kappa`` (Eq. 6) since the row before, less what the commanded virtual precession turns a
        nominal gyro, ``u / S``; the first row without ``before`` has the rate of the second. NaN in other modes, and for a single row of a
        free wave on its own.

    Raises
    ------
    DataError
        The factory data lack what the mode needs.
    """
    if command.mode in WAVE_MODES:
        return _wave_rate(rows, command, factory, before)
    if command.mode not in _RATE_COLUMN:
        return np.full(rows.shape[0], np.nan)
    column, axis = _RATE_COLUMN[command.mode]
    return rows[:, column_index(column)] / (_nominal_scale(factory, axis) * command.setpoints.amplitude_v)


def rate_range(mode: str, amplitude_v: float, factory: Mapping[str, Any]) -> float:
    """Raw rate at which the rebalance drive is at the end of its range [rad/s]: one as large is no measurement.

    Parameters
    ----------
    mode : str
        In force.
    amplitude_v : float
        Set point of the oscillator [V].
    factory : mapping
        ``dac_full_scale_V`` and what :func:`raw_rate` needs.

    Returns
    -------
    float
        inf for a free wave, and where the factory data do not say.
    """
    full_scale, axis = factory.get("dac_full_scale_V"), _RATE_COLUMN.get(mode, ("", ""))[1]
    if not axis or isinstance(full_scale, bool) or not isinstance(full_scale, int | float) or not full_scale > 0.0 or not amplitude_v > 0.0:
        return math.inf
    try:
        scale = abs(_nominal_scale(factory, axis)) * amplitude_v
    except (DataError, TypeError, ValueError, ZeroDivisionError):
        return math.inf
    return _BELIEVED * float(full_scale) / scale if scale > 0.0 else math.inf


def wave_azimuth(rows: FloatArray) -> FloatArray:
    """Azimuth theta of the wave [rad], unwrapped, shape (n,): half the angle of the pick-offs turned back by their phase.

    Parameters
    ----------
    rows : ndarray, shape (n, 12)
        Rows in recording order.
    """
    x, y = rows[:, 2] + 1j * rows[:, 3], rows[:, 4] + 1j * rows[:, 5]
    back = np.exp(-0.5j * np.angle(x * x + y * y))
    # a phase past a quarter turn flips both: the wave is the same after half a turn of psi
    azimuth: FloatArray = 0.5 * np.unwrap(np.arctan2((y * back).real, (x * back).real), period=np.pi)
    return azimuth


def _wave_rate(rows: FloatArray, command: Command, factory: Mapping[str, Any], before: FloatArray | None) -> FloatArray:
    if before is not None and rows.shape[0] and before[1] != rows[0, 1]:
        before = None
    all_rows = rows if before is None else np.vstack([before, rows])
    if all_rows.shape[0] < 2:
        return np.full(rows.shape[0], np.nan)
    kappa = factory.get("angular_gain_kappa")
    if not isinstance(kappa, int | float):
        raise DataError(f"Factory data must hold angular_gain_kappa for the rate of a whole-angle gyro, but got {kappa!r}.")
    rate = -2.0 / float(kappa) * np.diff(wave_azimuth(all_rows)) / np.diff(all_rows[:, 0])
    if before is None:
        rate = np.concatenate([rate[:1], rate])
    precession = command.setpoints.virtual_precession_v
    if precession:
        rate = rate + precession / (_nominal_scale(factory, "x") * np.sqrt((rows[:, 2:6] ** 2).sum(axis=1)))
    return np.asarray(rate, dtype=np.float64)


def _nominal_scale(factory: Mapping[str, Any], axis: str) -> float:
    """Nominal scale factor per volt of amplitude [(V per rad/s) per V]."""
    nominal = factory.get("nominal_scale_factor_v_per_rad_s")
    if not isinstance(nominal, Mapping) or axis not in nominal:
        raise DataError(f"Factory data must hold nominal_scale_factor_v_per_rad_s for axis {axis!r}, but got {nominal!r}.")
    return float(nominal[axis]) / float(factory.get("nominal_amplitude_v", 1.0))
