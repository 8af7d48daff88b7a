"""A recording is what a device did under one known command; a campaign is a set of recordings of one device."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from .columns import COLUMNS, column_index
from .command import Command

__all__ = ["Campaign", "Recording"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Recording:
    """Rows of one segment with what was commanded.

    Parameters
    ----------
    device_id : str
        Identity of the unit.
    data : ndarray, shape (n, 12), float64
        Rows in the order of :data:`gyro_calib.recording.columns.COLUMNS`. Made read-only.
    command : Command
        What was in force.
    sample_rate_hz : float
        Rows per second of device time.
    label : str
        Short name for people.
    extras : mapping
        Anything else the logger said: ``applied_rate``, ``t_run_start``, ``dac_zero_order_hold_s``, ``control_rate_hz``, ….
    raw : mapping of str to ndarray or None
        Optional carrier-rate block: ``t``, ``x_pick``, ``y_pick``, ``x_drive``, ``y_drive`` [V], ``phase_ref``.
    """

    device_id: str
    data: FloatArray
    command: Command
    sample_rate_hz: float
    label: str = ""
    extras: Mapping[str, Any] = field(default_factory=dict)
    raw: Mapping[str, FloatArray] | None = None

    def __post_init__(self) -> None:
        data = np.ascontiguousarray(self.data, dtype=np.float64)
        if data.ndim != 2 or data.shape[1] != len(COLUMNS):
            raise DataError(f"Recording data must have shape (n, {len(COLUMNS)}), but got {data.shape}.")
        if not (np.isfinite(self.sample_rate_hz) and self.sample_rate_hz > 0):
            raise DataError(f"Recording sample_rate_hz must be > 0, but got {self.sample_rate_hz!r}.")
        if data is self.data and data.flags.writeable:
            data = data.copy()
        data.setflags(write=False)
        object.__setattr__(self, "data", data)

    def __len__(self) -> int:
        return int(self.data.shape[0])

    def column(self, name: str) -> FloatArray:
        """One column, shape (n,)."""
        return self.data[:, column_index(name)]

    @property
    def t(self) -> FloatArray:
        """Device time [s], shape (n,)."""
        return self.data[:, 0]

    @property
    def pick(self) -> ComplexArray:
        """Pick-off envelopes c + i s [V], shape (n, 2): x, y."""
        return self.data[:, 2:6:2] + 1j * self.data[:, 3:6:2]

    @property
    def drive(self) -> ComplexArray:
        """Drive envelopes c + i s [V], shape (n, 2): x, y."""
        return self.data[:, 6:10:2] + 1j * self.data[:, 7:10:2]

    @property
    def ref_omega_rad_s(self) -> FloatArray:
        """Reference angular frequency, mean over each row [rad/s], shape (n,)."""
        return 2.0 * np.pi * self.data[:, 10]

    @property
    def temperature_degc(self) -> FloatArray:
        """Temperature [degC], shape (n,)."""
        return self.data[:, 11]

    @property
    def duration_s(self) -> float:
        """Rows over sample rate [s]."""
        return len(self) / self.sample_rate_hz


@dataclass(frozen=True)
class Campaign:
    """Recordings of one device, in order.

    Parameters
    ----------
    device_id : str
        The device.
    recordings : tuple of Recording
        In the order of their making.
    factory : mapping
        Factory data of the unit.

    Raises
    ------
    DataError
        Recordings of more than one device.
    """

    device_id: str
    recordings: tuple[Recording, ...]
    factory: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        strangers = sorted({r.device_id for r in self.recordings} - {self.device_id})
        if strangers:
            raise DataError(
                f"Recordings of a campaign must be of device {self.device_id!r}, but got {', '.join(map(repr, strangers))}. "
                "Calibrate each device on its own."
            )

    def __iter__(self) -> Iterator[Recording]:
        return iter(self.recordings)

    def __len__(self) -> int:
        return len(self.recordings)
