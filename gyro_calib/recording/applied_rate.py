"""The rate that a table applied during a recording, as its attributes tell it.

``extras["applied_rate"]`` = ``{"t_s": [...], "deg_s": [...]}``: from each time after the start of the record on, this rate (steps); with
``"kind"`` naming a linear course (``"linear"``, ``"samples"``) the rate runs straight from point to point. ``"rad_s"`` in place of
``"deg_s"`` is understood, and a single number of deg/s. ``"axis"``, if any, is the table's axis in the frame of the case (three components,
default z). A constant rate (the earth's) is not part of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from .attributes import is_stated, naming_recording
from .recording import Recording

__all__ = ["applied_rate", "is_straight", "is_turned", "table_axis", "words_of_steps"]

FloatArray = NDArray[np.float64]


def words_of_steps(t_s: list[float], rate_rad_s: list[float], axis: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> dict[str, Any]:
    """The attribute of a sequence of steps."""
    return {
        "kind": "steps from t after the start of the record",
        "t_s": [float(t) for t in t_s],
        "deg_s": [math.degrees(rate) for rate in rate_rad_s],
        "axis": [float(a) for a in axis],
    }


def is_turned(recording: Recording) -> bool:
    """Whether a table turned during a recording, as its attributes tell."""
    return is_stated(recording.extras.get("applied_rate"))


def table_axis(recording: Recording) -> FloatArray:
    """Unit vector of the table's axis in the frame of the case, shape (3,).

    Raises
    ------
    DataError
        The attribute is not three numbers, or all of them are zero.
    """
    words = recording.extras.get("applied_rate")
    stated = words.get("axis") if isinstance(words, Mapping) else None
    if stated is None:
        return np.array([0.0, 0.0, 1.0])
    with naming_recording(recording.label):
        vector = _numbers(stated, "axis")
        if vector.shape != (3,) or not np.linalg.norm(vector) > 0.0:
            raise DataError(f"Attribute applied_rate axis must be three numbers, not all zero, but got {stated!r}. Correct it in the file.")
    return vector / float(np.linalg.norm(vector))


def applied_rate(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Applied rate and its change per second, each a mean over every row.

    Returns
    -------
    rate : ndarray, shape (n,)
        [rad/s]; zero without the attribute.
    slope : ndarray, shape (n,)
        Difference of the rate between the ends of the row over its duration [rad/s^2]: a step's is one row long.

    Raises
    ------
    DataError
        An attribute that does not say a rate.
    """
    if not is_turned(recording):
        return np.zeros(len(recording)), np.zeros(len(recording))
    words = recording.extras["applied_rate"]
    row_s = 1.0 / recording.sample_rate_hz
    if isinstance(words, int | float) and not isinstance(words, bool):
        return np.full(len(recording), math.radians(words)), np.zeros(len(recording))
    with naming_recording(recording.label):
        times, rates, linear = _course(words)
    start = _start(recording)
    edges = np.append(recording.t - 0.5 * row_s, recording.t[-1] + 0.5 * row_s) - start
    turned = _angle(edges, times, rates, linear)
    return np.diff(turned) / row_s, np.diff(_at(edges, times, rates, linear)) / row_s


def _course(words: Any) -> tuple[FloatArray, FloatArray, bool]:
    if not isinstance(words, Mapping):
        raise DataError(f"Attribute applied_rate must hold t_s and deg_s, but got {words!r}. Correct it in the file.")
    unit = "deg_s" if "deg_s" in words else "rad_s"
    if unit not in words or "t_s" not in words:
        raise DataError(f"Attribute applied_rate must hold t_s and deg_s, but got {sorted(words)}. Correct it in the file.")
    times, rates = _numbers(words["t_s"], "t_s"), _numbers(words[unit], unit)
    if times.size == 0 or times.shape != rates.shape or np.any(np.diff(times) < 0.0):
        raise DataError(f"Attribute applied_rate must have as many rates as times, in order, but got {times.size} and {rates.size}.")
    return times, np.radians(rates) if unit == "deg_s" else rates, is_straight(words)


def is_straight(words: Mapping[str, Any]) -> bool:
    """Whether the rate runs straight from point to point, rather than in steps."""
    kind = str(words.get("kind", "steps")).lower()
    return any(word in kind for word in ("linear", "sample", "ramp")) and "step" not in kind


def _start(recording: Recording) -> float:
    """Device time at which the record started: where the logger says so, else half a row before its first row's centre."""
    begun, settle = (recording.extras.get(name) for name in ("t_run_start", "settle_s"))
    if isinstance(begun, int | float) and isinstance(settle, int | float):
        return float(begun) + float(settle)
    return float(recording.t[0]) - 0.5 / recording.sample_rate_hz


def _at(t: FloatArray, times: FloatArray, rates: FloatArray, linear: bool) -> FloatArray:
    """Rate at times after the start; zero before the first point."""
    if linear:
        return np.asarray(np.interp(t, times, rates, left=0.0))
    place = np.searchsorted(times, t, side="right")
    return np.asarray(np.concatenate([[0.0], rates])[place])


def _angle(t: FloatArray, times: FloatArray, rates: FloatArray, linear: bool) -> FloatArray:
    """Integral of the rate from the first point, exact for steps and for straight pieces."""
    knots = np.append(times, max(float(t[-1]), float(times[-1])) + 1.0)
    heights = np.append(rates, rates[-1])
    pieces = np.diff(knots) * (0.5 * (heights[:-1] + heights[1:]) if linear else heights[:-1])
    turned = np.concatenate([[0.0], np.cumsum(pieces)])
    place = np.clip(np.searchsorted(knots, t, side="right") - 1, 0, knots.size - 2)
    inside = np.maximum(t - knots[place], 0.0)
    slope = np.diff(heights)[place] / np.maximum(np.diff(knots)[place], 1e-300) if linear else 0.0
    return np.asarray(turned[place] + heights[place] * inside + 0.5 * slope * inside**2)


def _numbers(values: Any, name: str) -> FloatArray:
    try:
        array = np.asarray(values, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError):
        raise DataError(f"Attribute applied_rate {name} must be numbers, but got {values!r}. Correct it in the file.") from None
    if not np.isfinite(array).all():
        raise DataError(f"Attribute applied_rate {name} must be finite, but got {values!r}. Correct it in the file.")
    return array
