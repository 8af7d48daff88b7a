"""Synthetic recordings that look like a gyro's to every check, and can be spoiled one way at a time."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from gyro_calib.recording import COLUMNS, Campaign, Command, Recording

FACTORY: dict[str, Any] = {"unit": "ring-0001", "nominal_f0_hz": 15000.0, "adc_full_scale_V": 2.5, "dac_full_scale_V": 5.0}
#: the four bench files, where there are any
BENCH = Path(os.environ.get("GYRO_CALIB_BENCH", Path(__file__).resolve().parents[2] / "shared" / "bench"))


def make_rows(
    n: int = 2000, *, mode: str = "ftr_x", rate_hz: float = 1000.0, start_s: float = 0.0, segment: int = 0, seed: int = 1
) -> np.ndarray:
    """Rows of a steady gyro with white noise on every channel, shape (n, 12)."""
    rng = np.random.default_rng([seed, segment])
    rows = 1e-5 * rng.standard_normal((n, len(COLUMNS)))
    oscillator = COLUMNS.index("y_pick_c" if mode == "ftr_y" else "x_pick_c")
    rows[:, oscillator] += 1.0
    rows[:, COLUMNS.index("x_drive_s")] += 0.18
    rows[:, 0] = start_s + np.arange(n) / rate_hz
    rows[:, 1] = segment
    rows[:, COLUMNS.index("ref_freq")] = 14981.0 + 1e-4 * rng.standard_normal(n)
    rows[:, COLUMNS.index("temperature")] = 25.0
    return rows


def make_recording(rows: np.ndarray | None = None, command: Command | None = None, **extras: Any) -> Recording:
    """A recording of :func:`make_rows`."""
    return Recording("ring-0001", make_rows() if rows is None else rows, command or Command(), 1000.0, "static", extras)


def make_campaign(modes: tuple[str, ...] = ("ftr_x", "ftr_y", "ftr_x"), n: int = 2000) -> Campaign:
    """One recording per mode, segments 0, 1, …, times counting on with a pause between."""
    recordings = []
    for index, mode in enumerate(modes):
        rows = make_rows(n, mode=mode, segment=index, start_s=index * (n / 1000.0 + 1.0))
        recordings.append(Recording("ring-0001", rows, Command(mode), 1000.0, f"{mode}_{index}", {"note": f"number {index}"}))
    return Campaign("ring-0001", tuple(recordings), FACTORY)


def write_raw_bag(path: Path, messages: list[tuple[str, str, bytes]]) -> Path:
    """A bag of serialised messages (topic, type, bytes), a millisecond apart."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store, connections = get_typestore(Stores.ROS2_JAZZY), {}
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for count, (topic, kind, data) in enumerate(messages):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], (count + 1) * 1_000_000, data)
    return path
