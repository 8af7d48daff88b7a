"""What must hold before a calibration is worth its minutes: one check, one verdict, one remedy. Works on plain rows, without ROS."""

from __future__ import annotations

import contextlib
import math
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..calibration.files import TEMPORARY_SUFFIX
from ..calibration.store import RecordMissingError, RecordStore
from ..errors import StoreError
from ..recording.columns import COLUMNS, column_index
from ..recording.command import Command

__all__ = ["SelfCheck", "check_device", "check_record", "check_store", "check_stream"]

FloatArray = NDArray[np.float64]

#: relative error of the mean row interval [1]: a crystal is good to 1e-4, a wrong rate is off by percents
RATE_TOLERANCE = 1e-3
#: oscillator amplitude from its set point, and the closed axis from zero, relative to the set point [1]
AMPLITUDE_TOLERANCE = 0.02
#: change of the amplitude between the halves of what was looked at, relative to the set point [1]
SETTLED_AMPLITUDE = 0.005
#: change of the reference frequency between the halves [Hz]: a fifth of the half-width of a 15 kHz ring with Q = 30 000
SETTLED_FREQUENCY_HZ = 0.05
#: what a thermometer beside a gyro can say [degC]
TEMPERATURE_RANGE_DEGC = (-100.0, 200.0)
#: shortest stretch to judge from [rows]
MIN_ROWS = 20


@dataclass(frozen=True)
class SelfCheck:
    """Verdict of one check.

    Parameters
    ----------
    name : str
        What was checked.
    passed : bool
        Whether a run may rely on it.
    message : str
        What was found and, when it failed, the remedy.
    values : mapping
        Numbers behind the verdict; every key names its unit.
    warning : bool
        Passed, but worth knowing.
    """

    name: str
    passed: bool
    message: str
    values: Mapping[str, object] = field(default_factory=dict)
    warning: bool = False


def check_stream(
    rows: FloatArray | None,
    age_s: float,
    timeout_s: float,
    *,
    sample_rate_hz: float | None,
    command: Command | None,
    problem: str = "",
) -> list[SelfCheck]:
    """Checks of the latest stretch of the block stream.

    Parameters
    ----------
    rows : ndarray, shape (n, 12), or None
        Latest rows, in order of arrival; ``None`` when there never were any.
    age_s, timeout_s : float
        Time since the last block, and the most that is accepted [s].
    sample_rate_hz : float or None
        What the gyro says its rate is.
    command : Command or None
        What the gyro says is in force.
    problem : str
        Why the last block could not be read; "" when it could.

    Returns
    -------
    list of SelfCheck
        ``stream`` and, if it passed, ``finite``, ``sample_rate``, ``temperature``, ``amplitude``, ``loops``.
    """
    if problem:
        return [SelfCheck("stream", False, problem)]
    if rows is None or rows.shape[0] == 0:
        return [SelfCheck("stream", False, "No block has arrived. Start the gyro's driver and check the namespace of both nodes.")]
    values = {"age [s]": float(age_s), "rows [1]": int(rows.shape[0])}
    if age_s > timeout_s:
        text = f"The last block is {age_s:.1f} s old, the limit is {timeout_s:g} s. Restart the gyro's driver or check the link."
        return [SelfCheck("stream", False, text, values)]
    if rows.shape[0] < MIN_ROWS:
        text = f"Only {rows.shape[0]} rows have arrived, {MIN_ROWS} are needed to judge. Ask again in a moment."
        return [SelfCheck("stream", False, text, values)]
    checks = [SelfCheck("stream", True, "Blocks arrive.", values), _finite(rows), _sample_rate(rows, sample_rate_hz), _temperature(rows)]
    return [*checks, *_loops(rows, command)]


def check_device(reported: str, expected: str) -> SelfCheck:
    """Whether the gyro says who it is, and is the one that was expected ("" accepts any)."""
    values = {"device_id": reported, "expected": expected or "any"}
    if not reported:
        return SelfCheck(
            "device", False, "The gyro has not told its device_id. Check the parameter gyro_node and that its driver runs.", values
        )
    if expected and reported != expected:
        text = f"The gyro must be device {expected!r}, but is {reported!r}. Connect the right one or correct the parameter device_id."
        return SelfCheck("device", False, text, values)
    return SelfCheck("device", True, f"The gyro is {reported}.", values)


def check_store(store: RecordStore) -> SelfCheck:
    """Whether a record could be written now: really writes a file beside it and takes it away again."""
    values = {"path": str(store.path)}
    folder = store.path.parent
    try:
        while not folder.exists():
            folder = folder.parent
        _probe(folder)
    except OSError as error:
        text = f"A record could not be saved at {store.path}: {error}. Free space, correct the rights, or set record_url."
        return SelfCheck("store", False, text, values)
    return SelfCheck("store", True, f"Records can be saved at {store.path}.", values)


def check_record(store: RecordStore) -> SelfCheck:
    """Whether the stored record is readable and of this device; none at all passes with a warning."""
    try:
        record = store.load()
    except RecordMissingError:
        return SelfCheck("record", True, f"There is no record at {store.path} yet. Call self_calibrate.", warning=True)
    except StoreError as error:
        return SelfCheck("record", False, str(error))
    return SelfCheck("record", True, f"Record {record.record_id} is readable and of this device.", {"record": record.record_id})


def _probe(folder: Path) -> None:
    # named as the store's temporaries are: what a killed process leaves goes with the next save
    handle, name = tempfile.mkstemp(prefix=".probe.", suffix=TEMPORARY_SUFFIX, dir=folder)
    try:
        os.write(handle, b"probe")
        os.fsync(handle)
    finally:
        os.close(handle)
        with contextlib.suppress(OSError):
            os.unlink(name)


def _finite(rows: FloatArray) -> SelfCheck:
    bad = [name for i, name in enumerate(COLUMNS) if not np.isfinite(rows[:, i]).all()]
    if bad:
        return SelfCheck(
            "finite", False, f"Columns must be finite, but {', '.join(bad)} hold NaN or infinity. Check the gyro's electronics."
        )
    return SelfCheck("finite", True, "All columns are finite.")


def _sample_rate(rows: FloatArray, sample_rate_hz: float | None) -> SelfCheck:
    if sample_rate_hz is None or not math.isfinite(sample_rate_hz):
        return SelfCheck("sample_rate", False, "The gyro has not told its sample_rate_hz. Check the parameter gyro_node.")
    steps = np.diff(rows[:, 0]) * sample_rate_hz
    median = float(np.median(steps))
    measured = sample_rate_hz / median if median > 0 else math.nan
    odd = int(np.count_nonzero(np.abs(steps - 1.0) > 0.5))
    values = {"reported [Hz]": float(sample_rate_hz), "measured [Hz]": measured, "gaps and repeats [1]": odd}
    if not abs(median - 1.0) <= RATE_TOLERANCE:
        text = f"Rows must come at {sample_rate_hz:g} Hz, but come at {measured:.6g} Hz. Correct sample_rate_hz of the gyro's driver."
        return SelfCheck("sample_rate", False, text, values)
    if odd:
        return SelfCheck(
            "sample_rate", False, f"Rows must follow each other, but {odd} gaps or repeats were seen. Check the link and the load.", values
        )
    return SelfCheck("sample_rate", True, f"Rows come at {measured:.6g} Hz.", values)


def _temperature(rows: FloatArray) -> SelfCheck:
    mean = float(rows[:, column_index("temperature")].mean())
    lo, hi = TEMPERATURE_RANGE_DEGC
    passed = lo <= mean <= hi
    remedy = "" if passed else f" It must lie in {lo:g}…{hi:g} degC. Connect the thermometer."
    return SelfCheck("temperature", passed, f"Temperature is {mean:.3f} degC.{remedy}", {"temperature [degC]": mean})


def _loops(rows: FloatArray, command: Command | None) -> list[SelfCheck]:
    """Oscillator at its set point, closed axis at zero, neither amplitude nor frequency on the move."""
    if command is None:
        return [SelfCheck("amplitude", False, "The gyro has not told its command. Check the parameter gyro_node.")]
    if command.mode not in ("ftr_x", "ftr_y", "whole_angle") or command.excitation.kind != "none":
        text = f"The gyro must rest in ftr_x, ftr_y or whole_angle, but is in {command.mode} with excitation {command.excitation.kind}."
        return [SelfCheck("amplitude", False, f"{text} Wait for the experiment to end or set the mode.")]
    x = np.hypot(rows[:, 2], rows[:, 3])
    y = np.hypot(rows[:, 4], rows[:, 5])
    oscillator, closed = {"ftr_x": (x, y), "ftr_y": (y, x)}.get(command.mode, (np.hypot(x, y), np.zeros_like(x)))
    point = command.setpoints.amplitude_v
    mean, rest = float(oscillator.mean()), float(closed.mean())
    half = rows.shape[0] // 2
    creep = abs(float(oscillator[half:].mean() - oscillator[:half].mean())) / point
    frequency = rows[:, column_index("ref_freq")]
    shift = abs(float(frequency[half:].mean() - frequency[:half].mean()))
    near = abs(mean - point) <= AMPLITUDE_TOLERANCE * point and rest <= AMPLITUDE_TOLERANCE * point
    settled = creep <= SETTLED_AMPLITUDE and shift <= SETTLED_FREQUENCY_HZ
    away = "" if near else f" They must be within {AMPLITUDE_TOLERANCE:.0%} of the set point. Check the amplitude and rebalance loops."
    moving = "" if settled else " Wait for the loops to settle, or check their gains."
    return [
        SelfCheck(
            "amplitude",
            near,
            f"Oscillator at {mean:.4g} V of {point:g} V, closed axis at {rest:.2g} V.{away}",
            {"amplitude [V]": mean, "set point [V]": point, "closed axis [V]": rest},
        ),
        SelfCheck(
            "loops",
            settled,
            f"Amplitude moves by {creep:.2g} of its set point, the reference by {shift:.2g} Hz.{moving}",
            {"amplitude change [1]": creep, "reference change [Hz]": shift},
        ),
    ]
