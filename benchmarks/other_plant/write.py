"""Files: recordings as HDF5 and labels as JSON, each under its final name only when complete."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import h5py
import numpy as np

from campaign import Recording
from unit import Unit


def write_campaign(path: Path, unit: Unit, recordings: list[Recording]) -> None:
    """Write one campaign as doc/gap_campaign.md has it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    with h5py.File(part, "w") as file:
        file.attrs["format"] = "gyro_calib recording"
        file.attrs["format_version"] = 1
        file.attrs["device_id"] = unit.name
        file.attrs["factory"] = json.dumps(unit.factory())
        for i, recording in enumerate(recordings):
            group = file.create_group(f"recording_{i:03d}")
            for name, value in recording.attributes.items():
                group.attrs[name] = value
            for name, column in recording.columns.items():
                exact = name in ("t", "ref_freq", "temperature")
                group.create_dataset(name, data=column.astype(np.float64 if exact else np.float32))
    part.replace(path)


def write_label(folder: Path, name: str, label: dict[str, object]) -> str:
    """Write a label, append its hash to ``labels.sha256`` and return that hash."""
    text = json.dumps(label, indent=1)
    target = folder / "labels" / f"{name}.json"
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_suffix(".part")
    part.write_text(text)
    part.replace(target)
    digest = hashlib.sha256(text.encode()).hexdigest()
    with (folder / "labels.sha256").open("a") as file:
        file.write(f"{digest}  labels/{name}.json\n")
    return digest
