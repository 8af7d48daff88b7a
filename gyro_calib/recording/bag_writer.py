"""Write a campaign as the bag that ``ros2 bag record`` would have made of it; see :mod:`.bag` for the reading."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError
from .attributes import plain_value
from .bag import BLOCKS_TYPE, EVENTS_TOPIC, EVENTS_TYPE, EXTRAS, LABEL, SETTLED, import_rosbags
from .columns import COLUMNS
from .mcap_checksums import add_checksums
from .recording import Campaign, Recording

__all__ = ["write_campaign_bag"]

_TEMPERATURE_TYPE = "sensor_msgs/msg/Temperature"
#: log time between a command and its first block, and between recordings [ns]
_PAUSE_NS = 1_000_000


def write_campaign_bag(path: str | os.PathLike[str], campaign: Campaign, *, namespace: str = "gyro", block_rows: int = 100) -> Path:
    """Write a campaign as an MCAP bag with the live topics and the parameter events.

    Segments are renumbered from 0 unless those of the campaign already increase from recording to recording; carrier-rate blocks
    (``raw``) have no topic and are left out.

    Parameters
    ----------
    path : path
        Bag folder to make.
    campaign : Campaign
        What to write.
    namespace : str
        Of the gyro's topics.
    block_rows : int
        Rows in a block of ``channels``.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    DataError
        The folder exists or cannot be written, or rosbags is not installed.
    """
    target = Path(path)
    if block_rows < 1:
        raise DataError(f"Argument block_rows must be >= 1, but got {block_rows!r}. Use 100.")
    if target.exists():
        raise DataError(f"Bag folder must be new, but got {target}, which exists. Choose another name, or remove it.")
    rosbag2, store = import_rosbags()
    try:
        with rosbag2.Writer(target, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
            _Bag.open(writer, store, namespace.strip("/"), block_rows).write(campaign)
        for file in target.glob("*.mcap"):
            add_checksums(file)
    except BaseException as error:
        # half a bag would be in the way of the next attempt
        shutil.rmtree(target, ignore_errors=True)
        if isinstance(error, OSError | rosbag2.WriterError):
            raise DataError(f"Bag must be writable, but got {error} for {target}. Choose another folder.") from error
        raise
    return target


@dataclass
class _Bag:
    writer: Any
    store: Any
    topics: dict[str, Any]
    node: str
    block_rows: int
    log_ns: int = 0

    @classmethod
    def open(cls, writer: Any, store: Any, namespace: str, block_rows: int) -> _Bag:
        prefix = f"/{namespace}" if namespace else ""
        topics = {
            "channels": writer.add_connection(f"{prefix}/channels", BLOCKS_TYPE, typestore=store),
            "temperature": writer.add_connection(f"{prefix}/temperature", _TEMPERATURE_TYPE, typestore=store),
            "events": writer.add_connection(EVENTS_TOPIC, EVENTS_TYPE, typestore=store),
        }
        return cls(writer, store, topics, f"{prefix}/gyro_sim", block_rows)

    def write(self, campaign: Campaign) -> None:
        numbers = [r.column("segment")[0] for r in campaign if len(r)]
        increasing = bool(np.all(np.diff(numbers) > 0))
        for index, recording in enumerate(campaign):
            parameters = recording.command.to_parameters() | {
                SETTLED: True,
                LABEL: recording.label,
                EXTRAS: json.dumps(plain_value(recording.extras)),
            }
            if index == 0:
                parameters |= {
                    "device_id": campaign.device_id,
                    "factory": json.dumps(plain_value(campaign.factory)),
                    "sample_rate_hz": recording.sample_rate_hz,
                }
            elif recording.sample_rate_hz != campaign.recordings[0].sample_rate_hz:
                raise DataError(
                    f"A bag must have one sample rate, but got {recording.sample_rate_hz:g} Hz in {recording.label!r}. Use HDF5."
                )
            self._event(parameters, new=index == 0)
            self._rows(recording, recording.column("segment")[:1] if increasing else np.array([float(index)]))

    def _event(self, parameters: dict[str, Any], *, new: bool) -> None:
        types = self.store.types
        values = [types["rcl_interfaces/msg/Parameter"](name, self._value(value)) for name, value in parameters.items()]
        stamp = _stamp(types, self.log_ns)
        self._send("events", types[EVENTS_TYPE](stamp, self.node, values if new else [], [] if new else values, []))
        self.log_ns += _PAUSE_NS

    def _value(self, value: Any) -> Any:
        kind = 1 if isinstance(value, bool) else 4 if isinstance(value, str) else 8 if isinstance(value, list) else 3
        return self.store.types["rcl_interfaces/msg/ParameterValue"](
            type=kind,
            bool_value=value if kind == 1 else False,
            integer_value=0,
            double_value=float(value) if kind == 3 else 0.0,
            string_value=value if kind == 4 else "",
            byte_array_value=np.empty(0, np.uint8),
            bool_array_value=np.empty(0, np.bool_),
            integer_array_value=np.empty(0, np.int64),
            double_array_value=np.asarray(value if kind == 8 else [], dtype=np.float64),
            string_array_value=[],
        )

    def _rows(self, recording: Recording, segment: np.ndarray) -> None:
        rows = recording.data.copy()
        rows[:, COLUMNS.index("segment")] = segment
        start_ns, next_temperature = self.log_ns, 0
        for begin in range(0, len(rows), self.block_rows):
            block = rows[begin : begin + self.block_rows]
            end = begin + len(block)
            self.log_ns = start_ns + int(end / recording.sample_rate_hz * 1e9)
            self._send("channels", self._block(block))
            if end > next_temperature:
                self._send("temperature", self._temperature(block[-1]))
                next_temperature += round(recording.sample_rate_hz)
        self.log_ns += _PAUSE_NS

    def _block(self, rows: np.ndarray) -> Any:
        types, width = self.store.types, len(COLUMNS)
        dimension = types["std_msgs/msg/MultiArrayDimension"]
        dimensions = [dimension("sample", len(rows), len(rows) * width), dimension(",".join(COLUMNS), width, width)]
        return types[BLOCKS_TYPE](types["std_msgs/msg/MultiArrayLayout"](dimensions, 0), rows.reshape(-1))

    def _temperature(self, row: np.ndarray) -> Any:
        types = self.store.types
        header = types["std_msgs/msg/Header"](_stamp(types, round(max(row[0], 0.0) * 1e9)), self.node.rpartition("/")[0].strip("/"))
        return types[_TEMPERATURE_TYPE](header, float(row[COLUMNS.index("temperature")]), 0.0)

    def _send(self, topic: str, message: Any) -> None:
        connection = self.topics[topic]
        self.writer.write(connection, self.log_ns, self.store.serialize_cdr(message, connection.msgtype))


def _stamp(types: Any, time_ns: int) -> Any:
    return types["builtin_interfaces/msg/Time"](time_ns // 1_000_000_000, time_ns % 1_000_000_000)
