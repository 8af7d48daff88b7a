"""Do the signals of a recording look like a gyro's in the units and on the axes they claim? Used by :mod:`.integrity`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from .columns import CHANNELS
from .recording import Recording

__all__ = ["check_signals"]

FloatArray = NDArray[np.float64]

_AXES = ("x", "y")
#: an envelope this close to full scale comes from a converter that clips
_CLIP_LEVEL = 0.999
#: an envelope so many times above full scale is not in volts
_FAR_ABOVE = 5.0
#: so many equal samples in a row at a channel's extreme are a flat top
_FLAT_TOP_SAMPLES = 8
#: a column of no more values, of one distance, is rounded
_ROUNDED_VALUES = 256
#: an extreme that stands so many times as often as any other value is where a channel clips
_TIMES_OTHERS = 10
#: so many equal samples in a row of a noisy channel are a frozen one
_FROZEN_SAMPLES = 20
#: so often an axis reads exactly nothing that its converter rounds: a cable that breaks does so once or twice
_ROUNDINGS = 5
#: so many rows in a row that stood before are a repeated block
_REPEAT_SAMPLES = 8
#: relative tolerance of the amplitude against its set point
_AMPLITUDE_TOLERANCE = 0.2
#: relative tolerance of the reference frequency against the nominal one
_FREQUENCY_TOLERANCE = 0.1
_PICK_NAMES = CHANNELS[:4]


def check_signals(recording: Recording, factory: Mapping[str, Any], where: str = "") -> None:
    """Refuse clipped, frozen or repeated samples, wrong units and swapped axes.

    Parameters
    ----------
    recording : Recording
        Finite rows at a steady rate.
    factory : mapping
        Factory data of the device, perhaps empty.
    where : str
        Names the recording inside an error's text.

    Raises
    ------
    DataError
        What is wrong, at which sample, and what to do.
    """
    _check_clipping(recording, factory, where)
    _check_frozen(recording, where)
    _check_repeats(recording, where)
    _check_frequency_unit(recording, factory, where)
    _check_temperature_unit(recording, where)
    _check_axes(recording, where)
    _check_amplitude_unit(recording, where)


def _at(recording: Recording, sample: int) -> str:
    return f"sample {sample} (t = {recording.t[sample]:.6g} s)"


def _full_scale(factory: Mapping[str, Any], name: str) -> float:
    value = factory.get(name)
    return float(value) if isinstance(value, int | float) and value > 0 else np.inf


def _check_clipping(recording: Recording, factory: Mapping[str, Any], where: str) -> None:
    for kind, envelopes, name in (("pick", recording.pick, "adc_full_scale_V"), ("drive", recording.drive, "dac_full_scale_V")):
        limit = _CLIP_LEVEL * _full_scale(factory, name)
        for axis, envelope in zip(_AXES, np.abs(envelopes).T, strict=True):
            if (over := envelope >= limit).any():
                sample = int(np.argmax(over))
                # no converter gives several times its full scale
                far = envelope[sample] > _FAR_ABOVE * limit
                remedy = (
                    f"it looks like mV. Give the {kind} columns in volts."
                    if far
                    else "it clips. Lower the amplitude or the gain, and record again."
                )
                raise DataError(
                    f"Channel {axis}_{kind}{where} must stay below its full scale of {factory[name]:g} V ({name}), but got "
                    f"{envelope[sample]:.6g} V at {_at(recording, sample)}, {int(over.sum())} such samples: {remedy}"
                )
    closed = recording.command.mode in ("ftr_x", "ftr_y", "whole_angle")  # an open drive is flat by command
    for name in CHANNELS if closed else _PICK_NAMES:
        column = recording.column(name)
        for extreme in _clipping_levels(column, name):
            start, length = _longest_run(column == extreme)
            if _FLAT_TOP_SAMPLES <= length <= column.size // 2 and _is_flat_top(column, start, length, recording):
                raise DataError(
                    f"Column {name}{where} must not sit at its extreme, but got {length} samples of exactly {extreme:.6g} V from "
                    f"{_at(recording, start)}: a flat top, the channel clips. Lower the amplitude or the gain, and record again."
                )
        _check_extremes(recording, name, where)


def _clipping_levels(column: FloatArray, name: str) -> list[float]:
    """Extremes at which a channel may clip: a drive of nothing at all is in its dead zone, or at rest, and not at an end of its range."""
    return [level for level in (float(column.max()), float(column.min())) if level != 0.0 or name in _PICK_NAMES]


def _is_flat_top(column: FloatArray, start: int, length: int, recording: Recording) -> bool:
    return _moves_beside(column, start, length, recording) and not _is_rounded(column)


def _check_extremes(recording: Recording, name: str, where: str) -> None:
    """A noisy channel that clips comes to one value again and again, and to no other: no run of them need be long."""
    column = recording.column(name)
    for extreme in _clipping_levels(column, name):
        there = column == extreme
        count = int(np.count_nonzero(there))
        if count < _FLAT_TOP_SAMPLES or not _is_noisy(column, recording):
            continue
        # the steps of a converter come again as well, all of them
        others = np.unique(column[~there], return_counts=True)[1]
        if len(others) >= _FLAT_TOP_SAMPLES and count >= _TIMES_OTHERS * int(others.max()):
            raise DataError(
                f"Column {name}{where} must not sit at its extreme, but got {count} samples of exactly {extreme:.6g} V, the first "
                f"{_at(recording, int(np.argmax(there)))}, and no other value more than {int(others.max())} times: the channel clips. "
                "Lower the amplitude or the gain, and record again."
            )


def _check_frozen(recording: Recording, where: str) -> None:
    """A pick-off always carries noise; a run of equal samples next to moving ones is a stuck channel or logger."""
    for name in _PICK_NAMES:
        column = recording.column(name)
        start, length = _longest_run(np.diff(column) == 0.0)
        frozen = length + 1 >= _FROZEN_SAMPLES and _moves_beside(column, start, length + 1, recording)
        if frozen and not _rounds_to_zero(recording, name) and not _is_rounded(column):
            raise DataError(
                f"Column {name}{where} must carry the noise of its channel, but got {length + 1} equal samples of {column[start]:.6g} V "
                f"from {_at(recording, start)}: the channel is frozen. Check its cable and the logger, and record again."
            )
    # with loops closed a drive answers that noise
    closed = recording.command.mode.startswith("ftr") or recording.command.mode == "whole_angle"
    for name in CHANNELS if closed else _PICK_NAMES:
        column = recording.column(name)
        # one whose mean is nothing may be less than half a step of its converter
        still = column[0] != 0.0 and not np.ptp(column)
        others = [recording.column(other) for other in (_PICK_NAMES if name in _PICK_NAMES else CHANNELS[4:]) if other != name]
        if still and all(_is_noisy(other, recording) and not _is_rounded(other) for other in others if np.any(other)):
            raise DataError(
                f"Column {name}{where} must carry the noise of its channel, but got {column[0]:.6g} V in all {len(recording)} samples from "
                f"{_at(recording, 0)}: the channel is frozen. Check its cable and the logger, and record again."
            )
    if recording.command.oscillator_axis is None:
        return
    for axis, c, s in (("x", "x_pick_c", "x_pick_s"), ("y", "y_pick_c", "y_pick_s")):
        dead = not (np.ptp(recording.column(c)) or np.ptp(recording.column(s)))
        if dead and _is_noisy(recording.column(f"{_AXES[1 - _AXES.index(axis)]}_pick_s"), recording):
            raise DataError(
                f"Channel {axis}_pick{where} must carry the noise of its channel, but got {recording.column(c)[0]:.6g} V in all "
                f"{len(recording)} samples from {_at(recording, 0)}: the channel is dead. Check its cable, and record again."
            )


def _is_rounded(column: FloatArray) -> bool:
    """Whether a column comes to a few values only, of one distance: steps of a converter or of a file."""
    values = np.unique(column)
    if values.size > _ROUNDED_VALUES or values.size < 2:
        return False
    steps = np.diff(values)
    places = steps / steps.min()
    return bool(np.all(np.abs(places - np.rint(places)) < 0.05))


def _rounds_to_zero(recording: Recording, name: str) -> bool:
    """Whether an axis that hardly moves reads nothing again and again, in both quadratures: less than half a step of its converter."""
    nothing = np.all([recording.column(f"{name[:-1]}{q}") == 0.0 for q in "cs"], axis=0)
    begins = np.flatnonzero(np.diff(np.concatenate([[0], nothing.astype(np.int8)])) == 1)
    return len(begins) >= _ROUNDINGS


def _check_repeats(recording: Recording, where: str) -> None:
    """The same envelopes again at a later time: a block written twice with its times counted on."""
    bits = np.ascontiguousarray(recording.data[:, 2:10]).view(np.uint64)
    weights = np.random.default_rng(0).integers(1, 2**63, bits.shape[1], dtype=np.uint64) | np.uint64(1)
    keys = (bits * weights).sum(axis=1, dtype=np.uint64)
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    seen_at = first[inverse.reshape(-1)]
    again = seen_at < np.arange(keys.size)
    if np.count_nonzero(again) < _REPEAT_SAMPLES or np.count_nonzero(again) > keys.size // 2:
        return  # nothing repeats; or a noise-free recording, where everything does
    start, length = _longest_run(again)
    if length >= _REPEAT_SAMPLES and not _constant(recording.data[start : start + length, 2:10]):
        raise DataError(
            f"Rows{where} must not repeat, but got {length} rows from {_at(recording, start)} that already stood at "
            f"{_at(recording, int(seen_at[start]))}: a block was written twice. Drop the repeats, or record again."
        )


def _check_frequency_unit(recording: Recording, factory: Mapping[str, Any], where: str) -> None:
    nominal, found = factory.get("nominal_f0_hz"), float(np.median(recording.column("ref_freq")))
    if not isinstance(nominal, int | float) or nominal <= 0:
        return
    ratio = found / nominal
    if abs(ratio - 1.0) <= _FREQUENCY_TOLERANCE:
        return
    remedy = "Check that the factory data are this unit's."
    for factor, unit, cure in (
        (2.0 * np.pi, "rad/s", "Divide it by 2 pi."),
        (1e-3, "kHz", "Multiply it by 1000."),
        (1e3, "mHz", "Divide it by 1000."),
    ):
        if abs(ratio / factor - 1.0) <= _FREQUENCY_TOLERANCE:
            remedy = f"It looks like {unit}. {cure}"
    raise DataError(
        f"Column ref_freq{where} must be in Hz near the nominal {nominal:g} Hz, but got {found:.6g} at {_at(recording, 0)}. {remedy}"
    )


def _check_temperature_unit(recording: Recording, where: str) -> None:
    found = float(np.median(recording.temperature_degc))
    if found > 200.0 or found < -150.0:
        remedy = "It looks like kelvins: subtract 273.15." if 200.0 < found < 475.0 else "Check the thermometer's scale."
        raise DataError(f"Column temperature{where} must be in degC, but got {found:.6g} at {_at(recording, 0)}. {remedy}")


def _check_axes(recording: Recording, where: str) -> None:
    axis = recording.command.oscillator_axis
    if axis is None:
        return
    level = dict(zip(_AXES, np.median(np.abs(recording.pick), axis=0), strict=True))
    other = _AXES[1 - _AXES.index(axis)]
    if level[other] > 0.5 * level[axis]:
        raise DataError(
            f"Mode {recording.command.mode}{where} must have its vibration on the {axis} pick-off, but got {level[axis]:.6g} V on {axis} "
            f"and {level[other]:.6g} V on {other} (median, from {_at(recording, 0)}). Swap the axes of the columns, or correct the mode."
        )


def _check_amplitude_unit(recording: Recording, where: str) -> None:
    command = recording.command
    if command.mode not in ("ftr_x", "ftr_y", "whole_angle"):
        return
    found = float(np.median(np.sqrt(np.sum(np.abs(recording.pick) ** 2, axis=1))))
    wanted = command.setpoints.amplitude_v
    swing = min(abs(command.excitation.index), 0.9) if command.excitation.kind == "amplitude_modulation" else 0.0
    low, high = wanted * (1.0 - swing) * (1.0 - _AMPLITUDE_TOLERANCE), wanted * (1.0 + swing) * (1.0 + _AMPLITUDE_TOLERANCE)
    if low <= found <= high:
        return
    remedy = "Correct the set point, or record after the amplitude loop has settled."
    for factor, unit in ((1e3, "mV"), (1e6, "µV")):
        if low <= found / factor <= high:
            remedy = f"It looks like {unit}: divide the pick-off columns by {factor:g}."
    if low <= 1e3 * found <= high:
        remedy = "The set point looks like mV: divide it by 1000."
    if abs(found / wanted * np.sqrt(2.0) - 1.0) < 0.03 and not swing:
        remedy = "It looks like rms volts: envelopes are peak values, multiply by sqrt(2)."
    raise DataError(
        f"Pick-off amplitude{where} must be in volts near its set point of {wanted:g} V, but got {found:.6g} "
        f"(median, from {_at(recording, 0)}). {remedy}"
    )


def _longest_run(flags: NDArray[np.bool_]) -> tuple[int, int]:
    """Start and length of the longest stretch of True; (0, 0) without any."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).astype(np.int8)))
    if edges.size == 0:
        return 0, 0
    starts, lengths = edges[::2], np.diff(edges)[::2]
    longest = int(np.argmax(lengths))
    return int(starts[longest]), int(lengths[longest])


def _is_noisy(column: FloatArray, recording: Recording) -> bool:
    """Whether neighbouring samples differ by more than rounding, seen against the largest signal."""
    largest = float(np.abs(recording.data[:, 2:10]).max())
    return column.size > 2 and float(np.median(np.abs(np.diff(column)))) > 1e-10 * largest


def _moves_beside(column: FloatArray, start: int, length: int, recording: Recording) -> bool:
    """Whether the samples next to a run of equal ones are noisy: tells a stuck channel from one that has converged without noise."""
    before, after = column[max(0, start - 50) : start], column[start + length : start + length + 50]
    return _is_noisy(before if before.size >= after.size else after, recording)


def _constant(rows: FloatArray) -> bool:
    return not np.any(np.ptp(rows, axis=0))
