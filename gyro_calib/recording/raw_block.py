"""A checked block of carrier-rate samples: which channels it must hold, its even grid of times, the temperature that goes with it."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from .decimation import RowGrid, decimate
from .recording import Recording

__all__ = ["SIGNALS", "RawBlock", "finite_number"]

FloatArray = NDArray[np.float64]

#: channels besides the time and the reference [V]
SIGNALS = ("x_pick", "y_pick", "x_drive", "y_drive")
#: a sample may be this far from its place on the grid, relative to the step
_GRID_TOLERANCE = 0.25
_LEAST_SAMPLES = 64


@dataclass(frozen=True)
class RawBlock:
    """Channels of one length on an even grid of times.

    Parameters
    ----------
    channels : mapping of str to ndarray, shape (size,)
    start_s, rate_hz : float
        Time of the first sample, samples per second.
    size : int
    where : str
        Names the recording inside an error's text.
    """

    channels: Mapping[str, FloatArray]
    start_s: float
    rate_hz: float
    size: int
    where: str

    @classmethod
    def of(cls, recording: Recording) -> RawBlock:
        """The raw block of a recording; raises :class:`DataError` for what is missing, not finite, uneven or too short."""
        where = f" of {recording.label!r}" if recording.label else ""
        channels = {name: np.asarray(values, dtype=np.float64) for name, values in (recording.raw or {}).items()}
        missing = [name for name in ("t", *SIGNALS) if name not in channels]
        if missing:
            raise DataError(f"Raw block{where} must hold t, {', '.join(SIGNALS)}, but lacks {', '.join(missing)}. Record every channel.")
        size = channels["t"].size
        for name, values in channels.items():
            if values.shape != (size,):
                raise DataError(f"Raw channel {name}{where} must have shape ({size},) like t, but got {values.shape}.")
            if not np.isfinite(values).all():
                sample = int(np.argmin(np.isfinite(values)))
                raise DataError(f"Raw channel {name}{where} must be finite, but got {values[sample]} at sample {sample}. Record again.")
        if size < _LEAST_SAMPLES:
            raise DataError(f"Raw block{where} must hold {_LEAST_SAMPLES} samples or more, but got {size}. Record longer.")
        start, rate = _time_grid(channels["t"], where)
        return cls(channels, start, rate, size, where)

    def temperature(self, recording: Recording, grid: RowGrid, t: FloatArray, factory: Mapping[str, Any]) -> FloatArray | float:
        """Of the rows, of a raw channel, of the attributes; else assumed, and said so.

        Raises
        ------
        DataError
            None of them, and no reference temperature in the factory data to assume.
        """
        if "temperature" in self.channels:
            return np.asarray(decimate(self.channels["temperature"], grid))
        if len(recording):
            return np.asarray(np.interp(t, recording.t, recording.temperature_degc))
        stated = next(
            (finite_number(v) for k, v in recording.extras.items() if k.lower().startswith("temperature") and finite_number(v) is not None),
            None,
        )
        if stated is not None:
            return stated
        assumed = finite_number(factory.get("reference_temperature_degC"))
        if assumed is None:
            raise DataError(
                f"Recording{self.where} must state its temperature, but neither rows nor a raw channel nor an attribute temperature_degC "
                "does. Add the attribute."
            )
        logging.getLogger("gyro_calib").warning(
            "Recording%s states no temperature: the factory's reference of %g degC is assumed. Add the attribute temperature_degC.",
            self.where,
            assumed,
        )
        return assumed


def _time_grid(t: FloatArray, where: str) -> tuple[float, float]:
    """Start and rate of an even grid; the first sample that is off it is named."""
    step = float(t[-1] - t[0]) / (t.size - 1)
    if not step > 0.0:
        raise DataError(f"Raw channel t{where} must increase, but goes from {t[0]:.9g} to {t[-1]:.9g} s. Sort the samples.")
    median = float(np.median(np.diff(t)))
    off = np.abs(np.diff(t) - median) > _GRID_TOLERANCE * median
    if off.any():
        sample = int(np.argmax(off)) + 1
        raise DataError(
            f"Raw channel t{where} must advance evenly ({median:.6g} s a sample), but got {t[sample] - t[sample - 1]:.6g} s before sample "
            f"{sample} (t = {t[sample]:.9g} s): samples are missing or repeated. Record again."
        )
    rate = 1.0 / step
    return float(t[0]), round(rate) if abs(rate - round(rate)) < 1e-6 * rate else rate


def finite_number(value: Any) -> float | None:
    """``value`` as a float, None when it is no finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)
