"""Is a recording what it claims to be? Every refusal names the sample, its time, the value and the remedy.

:func:`validate` looks at a whole recording, however it came (file, bag, live); :func:`check_rows` looks at one live block and costs
microseconds.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from .columns import COLUMNS
from .plausibility import check_signals
from .recording import Recording

__all__ = ["check_rows", "validate"]

FloatArray = NDArray[np.float64]

#: a step of device time may differ from the nominal one by this part of it before rows count as lost or repeated
_STEP_TOLERANCE = 0.5
#: largest relative difference between the stated and the recorded sample rate
_RATE_TOLERANCE = 1e-3
#: below this many rows a second no side band can be seen; a file in milliseconds looks like 1 Hz
_LEAST_RATE_HZ = 10.0


def validate(recording: Recording, factory: Mapping[str, Any] | None = None) -> None:
    """Refuse a recording that is damaged, or that is not in the units and on the axes it claims.

    Parameters
    ----------
    recording : Recording
        One recording; one segment.
    factory : mapping, optional
        Factory data of the device; ``adc_full_scale_V``, ``dac_full_scale_V`` and ``nominal_f0_hz`` sharpen the checks.

    Raises
    ------
    DataError
        NaN or infinity, a gap, a repeat, time running back, a wrong sample rate, a change of segment, a clipped or frozen channel,
        a wrong unit, or swapped axes. The text names the first sample concerned, its time, its value and what to do.
    """
    where = f" of recording {recording.label!r}" if recording.label else ""
    if len(recording) < 2:
        raise DataError(f"Recording {recording.label!r} must have at least 2 samples, but got {len(recording)}. Record for longer.")
    _check_finite(recording.data, where)
    _check_rate(recording, where)
    _check_steps(recording.t, np.diff(recording.t), recording.sample_rate_hz, 1, where)
    _check_segment(recording, where)
    check_signals(recording, factory or {}, where)


def check_rows(rows: FloatArray, sample_rate_hz: float, previous_t: float | None = None) -> float:
    """Refuse a live block that is not finite or does not continue the one before it.

    Parameters
    ----------
    rows : ndarray, shape (n, 12)
        Rows of the block, in the order of :data:`~gyro_calib.recording.columns.COLUMNS`.
    sample_rate_hz : float
        Rows per second of device time.
    previous_t : float, optional
        Device time of the last row of the block before [s]; None for the first block.

    Returns
    -------
    float
        Device time of the last row [s], the ``previous_t`` of the next call.

    Raises
    ------
    DataError
        Wrong shape, an empty block, NaN or infinity, lost or repeated rows. Sample indices count from the start of the block.
    """
    if rows.ndim != 2 or rows.shape[1] != len(COLUMNS) or rows.shape[0] == 0:
        raise DataError(f"A block of rows must have shape (n, {len(COLUMNS)}) with n >= 1, but got {rows.shape}. Check the driver.")
    _check_finite(rows, " of the live block")
    t = rows[:, 0]
    if previous_t is None:
        _check_steps(t, np.diff(t), sample_rate_hz, 1, " of the live block")
    else:
        _check_steps(t, np.diff(t, prepend=previous_t), sample_rate_hz, 0, " of the live block")
    return float(t[-1])


def _check_finite(rows: FloatArray, where: str) -> None:
    finite = np.isfinite(rows)
    if finite.all():
        return
    sample, column = (int(i) for i in np.argwhere(~finite)[0])
    t = rows[sample, 0]
    at = f"sample {sample}" + (f" (t = {t:.6g} s)" if np.isfinite(t) else "")
    raise DataError(
        f"Column {COLUMNS[column]}{where} must be finite, but got {rows[sample, column]} at {at}, {int((~finite).sum())} such values in "
        "all. Leave that stretch out, or record again."
    )


def _check_rate(recording: Recording, where: str) -> None:
    stated, step_s = recording.sample_rate_hz, float(np.median(np.diff(recording.t)))
    if step_s <= 0.0:
        return  # the steps say more
    ratio = step_s * stated
    for factor, unit in ((1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")):
        if abs(ratio / factor - 1.0) < _STEP_TOLERANCE:
            raise DataError(
                f"Column t{where} must be in seconds, but got steps of {step_s:.6g} at {stated:g} samples a second: it looks like {unit}. "
                f"Divide t by {factor:g}."
            )
    if stated < _LEAST_RATE_HZ:
        raise DataError(
            f"Sample rate{where} must be at least {_LEAST_RATE_HZ:g} Hz, but got {stated:g} Hz (t advances by {step_s:.6g} a sample). "
            "Give t in seconds."
        )
    if abs(ratio - 1.0) > _RATE_TOLERANCE:
        raise DataError(
            f"Sample rate{where} must agree with t, but got {stated:g} Hz stated and {1.0 / step_s:.6g} Hz in t (sample 1, "
            f"t = {recording.t[1]:.6g} s). Correct sample_rate_hz, or the logger's clock."
        )


def _check_steps(t: FloatArray, steps: FloatArray, rate_hz: float, first: int, where: str) -> None:
    """``steps[i]`` leads to sample ``i + first``."""
    nominal = 1.0 / rate_hz
    wrong = np.abs(steps - nominal) > _STEP_TOLERANCE * nominal
    if not wrong.any():
        return
    i = int(np.argmax(wrong))
    sample, step = i + first, float(steps[i])
    at = f"sample {sample} (t = {t[sample] if sample < t.size else t[-1]:.9g} s)"
    must = f"Column t{where} must advance by {nominal:.6g} s a sample"
    if step > 0.0 and step > nominal:
        raise DataError(
            f"{must}, but got a gap of {step:.6g} s before {at}: {round(step * rate_hz) - 1} samples are missing. "
            "Give the subscription a deeper queue or the logger a faster disk, and record again."
        )
    if step < 0.0:
        raise DataError(
            f"{must}, but got a step back of {-step:.6g} s at {at}: a block is repeated or out of order. "
            "Sort the blocks, drop the repeats, or record again."
        )
    raise DataError(
        f"{must}, but got {step:.6g} s before {at}: a row is repeated or its time is wrong. Drop the repeats, or store t as float64."
    )


def _check_segment(recording: Recording, where: str) -> None:
    segment = recording.column("segment")
    changed = segment != segment[0]
    if changed.any():
        sample = int(np.argmax(changed))
        raise DataError(
            f"Column segment{where} must be one number in a recording, but got {segment[0]:g} and then {segment[sample]:g} at "
            f"sample {sample} (t = {recording.t[sample]:.6g} s): a command took effect there. Split the recording at that sample."
        )
