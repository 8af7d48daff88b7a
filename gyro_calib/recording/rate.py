"""The uncalibrated rate a gyro's own firmware reports: rebalance drive over the *nominal* scale factor.

``omega_meas = K omega + b + n`` with ``K`` the true scale factor over the nominal one; calibration finds ``K`` and ``b``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from .columns import column_index
from .command import Command

__all__ = ["raw_rate"]

_RATE_COLUMN = {"ftr_x": ("y_drive_s", "x"), "ftr_y": ("x_drive_s", "y")}


def raw_rate(rows: NDArray[np.float64], command: Command, factory: Mapping[str, Any]) -> NDArray[np.float64]:
    """Uncalibrated rate of each row [rad/s].

    Parameters
    ----------
    rows : ndarray, shape (n, 12)
        Rows in recording order.
    command : Command
        What was in force; only force-to-rebalance modes have a rate channel.
    factory : mapping
        ``nominal_scale_factor_v_per_rad_s`` {x, y} at ``nominal_amplitude_v`` (default 1 V).

    Returns
    -------
    ndarray, shape (n,)
        Rebalance drive in phase with velocity over the nominal scale factor (theory.md Eq. 7); NaN in other modes.

    Raises
    ------
    DataError
        The factory data lack the nominal scale factor.
    """
    if command.mode not in _RATE_COLUMN:
        return np.full(rows.shape[0], np.nan)
    column, axis = _RATE_COLUMN[command.mode]
    nominal = factory.get("nominal_scale_factor_v_per_rad_s")
    if not isinstance(nominal, Mapping) or axis not in nominal:
        raise DataError(f"Factory data must hold nominal_scale_factor_v_per_rad_s for axis {axis!r}, but got {nominal!r}.")
    scale = float(nominal[axis]) * command.setpoints.amplitude_v / float(factory.get("nominal_amplitude_v", 1.0))
    return rows[:, column_index(column)] / scale
