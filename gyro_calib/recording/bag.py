"""Campaigns as ROS 2 bags (MCAP): what ``ros2 bag record`` makes of a gyro's topics, read and written without ROS.

A bag holds ``channels`` (blocks of rows), ``temperature`` and ``/parameter_events``, from which come the device id, the factory data
and the command of every segment. Needs ``rosbags`` (the extra ``bags``).
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from .attributes import is_stated, naming_recording
from .columns import COLUMNS
from .command import Command
from .integrity import validate
from .mcap_checksums import check_checksums
from .parameter_log import ParameterChange, command_of, driver_changes, states_of_segments, words_of
from .recording import Campaign, Recording

__all__ = ["import_rosbags", "read_campaign_bag"]

FloatArray = NDArray[np.float64]

BLOCKS_TYPE = "std_msgs/msg/Float64MultiArray"
EVENTS_TYPE = "rcl_interfaces/msg/ParameterEvent"
EVENTS_TOPIC = "/parameter_events"
#: what only this package's writer says about a recording
SETTLED, LABEL, EXTRAS = "recording.settled", "recording.label", "recording.extras"
#: bytes by which a message may be too long [B]
_MOST_SURPLUS = 1024
_VALUE_FIELDS = {
    1: "bool_value",
    2: "integer_value",
    3: "double_value",
    4: "string_value",
    6: "bool_array_value",
    7: "integer_array_value",
    8: "double_array_value",
    9: "string_array_value",
}


@lru_cache(maxsize=1)
def import_rosbags() -> tuple[ModuleType, Any]:
    """``rosbags.rosbag2`` and the type store of Jazzy; one for all, because a store compiles every type for itself.

    Raises
    ------
    DataError
        rosbags is not installed.
    """
    try:
        from rosbags import rosbag2
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise DataError(
            f"Bags must be read and written with rosbags, but got {error}. Install it: pip install 'gyro_calib[bags]' (or rosbags)."
        ) from error
    return rosbag2, get_typestore(Stores.ROS2_JAZZY)


def read_campaign_bag(
    path: str | os.PathLike[str],
    *,
    topic: str | None = None,
    device_id: str | None = None,
    factory: Mapping[str, Any] | None = None,
    initial: Command | None = None,
    settle_s: float = 1.0,
    check: bool = True,
    on_progress: Callable[[float, str], None] | None = None,
) -> Campaign:
    """Read the bag of a gyro, recorded by ``ros2 bag record`` or written here.

    The rows are split by their ``segment``; each segment takes its command from the parameter events. A first segment whose command was
    set before the bag began is left out unless ``initial`` gives it.

    Parameters
    ----------
    path : path
        Bag folder, or its storage file.
    topic : str, optional
        The ``channels`` topic, for a bag of several gyros.
    device_id, factory : optional
        For a bag that lacks them, because recording began after the driver.
    initial : Command, optional
        Command in force when the bag began, where it does not say.
    settle_s : float
        Left out at the start of each segment while the loops settle [s]; a campaign written here has settled already.
    check : bool
        Validate every recording.
    on_progress : callable, optional
        Called with the fraction done and the name of the recording just read.

    Returns
    -------
    Campaign

    Raises
    ------
    DataError
        No bag, no such topic or several, no device id, or a recording that does not pass the checks.
    """
    source = Path(path)
    rosbag2, store = import_rosbags()
    try:
        for file in source.glob("*.mcap") if source.is_dir() else [source]:
            check_checksums(file)
        with rosbag2.Reader(source) as reader:
            stream = _read_stream(reader, store, topic)
    except DataError as error:
        raise DataError(f"{source}: {error}") from error
    except Exception as error:  # rosbags and its storages raise many kinds on a torn file
        raise DataError(
            f"Bag must be readable, but got {type(error).__name__}: {error} for {source}. "
            "After a crash: ros2 bag reindex; else record it again."
        ) from error
    try:
        return _campaign(stream, device_id, factory, initial, settle_s, check, on_progress or (lambda fraction, name: None))
    except DataError as error:
        raise DataError(f"{source}: {error}") from error


@dataclass(frozen=True)
class _Stream:
    """Rows of one gyro, where its segments first appeared, and what its driver was told."""

    rows: FloatArray
    first_seen: list[tuple[int, int]]
    changes: list[ParameterChange]


def _read_stream(reader: Any, store: Any, topic: str | None) -> _Stream:
    channels = _channels_connection(reader, store, topic)
    events = [c for c in reader.connections if c.msgtype == EVENTS_TYPE]
    namespace = channels.topic.rpartition("/")[0]
    blocks: list[FloatArray] = []
    changes: list[ParameterChange] = []
    first_seen: list[tuple[int, int]] = []
    for connection, log_ns, data in reader.messages(connections=[channels, *events]):
        message = _decode(store, data, connection.msgtype)
        if connection.msgtype == EVENTS_TYPE:
            changes.append(ParameterChange(log_ns, message.node, _event_values(message)))
            continue
        rows = _block_rows(message, connection.topic)
        blocks.append(rows)
        for segment in _changes_in_order(rows[:, COLUMNS.index("segment")]):
            if not first_seen or first_seen[-1][0] != segment:
                first_seen.append((int(segment), log_ns))
    if not blocks:
        raise DataError(f"Topic {channels.topic} must hold blocks, but got none. Record while the gyro runs.")
    return _Stream(np.concatenate(blocks), first_seen, driver_changes(changes, namespace))


def _channels_connection(reader: Any, store: Any, topic: str | None) -> Any:
    """The connection whose blocks are labelled with the columns of a recording."""
    found = {}
    for connection in (c for c in reader.connections if c.msgtype == BLOCKS_TYPE):
        first = next(iter(reader.messages(connections=[connection])), None)
        if first is not None and set(COLUMNS) <= set(_labels(_decode(store, first[2], connection.msgtype))):
            found[connection.topic] = connection
    if topic is not None:
        wanted = "/" + topic.strip("/")
        if wanted not in found:
            raise DataError(f"Topic must be one of the gyros' ({', '.join(found) or 'none in this bag'}), but got {wanted}. Choose one.")
        return found[wanted]
    if len(found) != 1:
        raise DataError(
            f"A bag must hold one {BLOCKS_TYPE} topic labelled with the columns of a gyro, but got {', '.join(found) or 'none'}. "
            + ("Choose one by topic=." if found else "Record the topic channels of the gyro.")
        )
    return next(iter(found.values()))


def _decode(store: Any, data: Any, kind: str) -> Any:
    """Message of its bytes. Python writers add what the middleware had estimated too much, which the decoder takes for damage."""
    try:
        return store.deserialize_cdr(data, kind)
    except Exception:
        for surplus in range(4, _MOST_SURPLUS, 4):
            with suppress(Exception):
                return store.deserialize_cdr(data[:-surplus], kind)
        raise


def _labels(message: Any) -> list[str]:
    dimensions = message.layout.dim
    return [name.strip() for name in dimensions[-1].label.split(",")] if len(dimensions) == 2 else []


def _block_rows(message: Any, topic: str) -> FloatArray:
    labels, data = _labels(message), np.asarray(message.data, dtype=np.float64)
    missing = [column for column in COLUMNS if column not in labels]
    if missing or data.size % max(len(labels), 1):
        raise DataError(
            f"A block of {topic} must hold whole rows of {len(COLUMNS)} labelled columns, but got {data.size} numbers and no {missing}. "
            "Check the driver."
        )
    rows = data.reshape(-1, len(labels))
    return rows if labels == list(COLUMNS) else rows[:, [labels.index(column) for column in COLUMNS]]


def _changes_in_order(segment: FloatArray) -> Iterator[float]:
    if segment.size:
        yield from segment[np.concatenate(([True], np.diff(segment) != 0))]


def _event_values(message: Any) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for parameter in (*message.new_parameters, *message.changed_parameters):
        field = _VALUE_FIELDS.get(parameter.value.type)
        if field is not None:
            value = getattr(parameter.value, field)
            values[parameter.name] = value.tolist() if isinstance(value, np.ndarray) else value
    return values | {parameter.name: None for parameter in message.deleted_parameters}


def _campaign(
    stream: _Stream,
    device_id: str | None,
    factory: Mapping[str, Any] | None,
    initial: Command | None,
    settle_s: float,
    check: bool,
    on_progress: Callable[[float, str], None],
) -> Campaign:
    states = states_of_segments(stream.first_seen, stream.changes)
    everything: dict[str, Any] = {name: value for change in stream.changes for name, value in change.values.items() if is_stated(value)}
    device = _device_id(everything.get("device_id"), device_id)
    facts = dict(factory) if factory is not None else _factory(everything.get("factory"))
    rate = _sample_rate(everything.get("sample_rate_hz"))
    recordings = []
    for index, (rows, state) in enumerate(zip(_split(stream), states, strict=True)):
        with naming_recording(str(state.get(LABEL) or f"segment_{int(rows[0, 1])}")):
            command = command_of(state) or (initial if index == 0 else None)
            recording = None if command is None else _recording(rows, state, command, device, rate, settle_s)
        if recording is not None:
            if check:
                validate(recording, facts)
            recordings.append(recording)
            on_progress((index + 1) / len(states), recording.label)
    if not recordings:
        raise DataError(
            f"A bag must hold a segment longer than {settle_s:g} s whose command is known from {EVENTS_TOPIC}, but got none. "
            "Record /parameter_events too and start before the run, or give the command in force (initial=)."
        )
    return Campaign(device, tuple(recordings), facts)


def _device_id(recorded: Any, given: str | None) -> str:
    if recorded and given and recorded != given:
        raise DataError(f"Device id must be the bag's, {recorded!r}, but got {given!r}. Leave it out, or take the bag of that device.")
    if not (recorded or given):
        raise DataError(
            f"A bag must tell the device id in {EVENTS_TOPIC}, but got none. Start recording before the driver, or give it (device_id=)."
        )
    return str(recorded or given)


def _sample_rate(stated: Any) -> float | None:
    if stated is None:
        return None
    if isinstance(stated, bool) or not isinstance(stated, int | float) or not 0.0 < stated < math.inf:
        raise DataError(f"Parameter sample_rate_hz must be a number > 0, but got {stated!r}. Correct it in the driver.")
    return float(stated)


def _factory(text: Any) -> dict[str, Any]:
    if not text:
        return {}
    try:
        facts = json.loads(text)
    except (TypeError, ValueError):
        facts = None
    if not isinstance(facts, dict):
        raise DataError(f"Parameter factory must be a JSON object, but got {text!r}. Correct it in the driver, or give factory=.")
    return facts


def _split(stream: _Stream) -> list[FloatArray]:
    """Rows of each segment, in order."""
    numbers = [segment for segment, _ in stream.first_seen]
    if any(later <= earlier for earlier, later in pairwise(numbers)):
        raise DataError(
            f"Column segment must increase through a bag, but got {numbers}. A block is repeated, or the driver was started anew: "
            "record again."
        )
    segment = stream.rows[:, COLUMNS.index("segment")]
    return np.split(stream.rows, np.flatnonzero(np.diff(segment) != 0) + 1)


def _recording(
    rows: FloatArray, state: Mapping[str, Any], command: Command, device: str, rate_hz: float | None, settle_s: float
) -> Recording | None:
    """The settled rows of a segment, or None if nothing is left."""
    skip = 0.0 if state.get(SETTLED) else settle_s
    rate = rate_hz or _rate(rows)
    settled = rows[round(skip * rate) :]
    if settled.shape[0] < 2:
        return None
    extras = words_of(state) | _extras(state.get(EXTRAS))
    if "applied_rate" in extras and not {"t_run_start", "settle_s"} <= extras.keys():
        # a table's steps count from the first row, settled or not
        extras |= {"t_run_start": float(rows[0, 0]) - 0.5 / rate, "settle_s": 0.0}
    label = state.get(LABEL) or f"segment_{int(rows[0, 1])}_{command.mode}"
    return Recording(device, settled, command, rate, label, extras)


def _extras(text: Any) -> dict[str, Any]:
    try:
        extras = json.loads(text or "{}")
    except (TypeError, ValueError, RecursionError):
        extras = None
    if not isinstance(extras, dict):
        raise DataError(f"Parameter {EXTRAS} must be a JSON object, but got {text!r}. Copy or record the bag again.")
    return {name: word for name, word in extras.items() if word is None or is_stated(word)}


def _rate(rows: FloatArray) -> float:
    step = float(np.median(np.diff(rows[:, 0]))) if rows.shape[0] > 1 else 0.0
    if not step > 0.0:
        raise DataError(f"Column t must increase, but got steps of {step:g} s at sample 1. Check the driver's clock.")
    return 1.0 / step
