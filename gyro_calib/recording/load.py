"""Load a campaign from whatever it was recorded in."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py

from ..errors import DataError
from .bag import read_campaign_bag
from .hdf5 import read_campaign_h5
from .recording import Campaign, Recording

__all__ = ["load_campaign"]

_BAG_MAGIC = (b"\x89MCAP0\r\n", b"SQLite format 3\x00")


def load_campaign(
    *paths: str | os.PathLike[str],
    topic: str | None = None,
    device_id: str | None = None,
    factory: Mapping[str, Any] | None = None,
    check: bool = True,
    on_progress: Callable[[float, str], None] | None = None,
) -> Campaign:
    """Read one or more files or bags of one device as one campaign, in the order given.

    Parameters
    ----------
    *paths : path
        HDF5 files, bag folders, MCAP files, or folders of HDF5 files; known by content, not by name.
    topic : str, optional
        The ``channels`` topic of a bag of several gyros.
    device_id, factory : optional
        For a bag that lacks them.
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
        Nothing given, unknown content, different devices, contradicting factory data, or a recording that does not pass the checks.
    """
    sources = [source for path in paths for source in _expand(Path(path))]
    if not sources:
        raise DataError("At least one recording must be given, but got none. Name an HDF5 file or a bag.")
    report = on_progress or (lambda fraction, name: None)
    campaigns = []
    for index, source in enumerate(sources):

        def share(fraction: float, name: str, done: int = index) -> None:
            report((done + fraction) / len(sources), name)

        if _is_bag(source):
            campaigns.append(read_campaign_bag(source, topic=topic, device_id=device_id, factory=factory, check=check, on_progress=share))
        else:
            campaigns.append(read_campaign_h5(source, check=check, on_progress=share))
    return _merge(campaigns, sources)


def _expand(path: Path) -> list[Path]:
    """The path itself, or the HDF5 files of a folder that is not a bag."""
    if not path.exists():
        raise DataError(f"Recording must exist, but got {path}. Check the path.")
    if not path.is_dir() or _is_bag(path):
        return [path]
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in (".h5", ".hdf5"))
    if not files:
        raise DataError(f"A folder must be a bag (metadata.yaml) or hold HDF5 files, but got neither in {path}. Name the recording itself.")
    return files


def _is_bag(path: Path) -> bool:
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or any(path.glob("*.mcap"))
    try:
        with path.open("rb") as file:
            start = file.read(16)
    except OSError as error:
        raise DataError(f"Recording must be readable, but got {error}. Check its permissions.") from error
    if start.startswith(_BAG_MAGIC):
        return True
    if not h5py.is_hdf5(path):
        raise DataError(
            f"A recording must be an HDF5 file or a ROS 2 bag (MCAP or SQLite), but got {path}, which begins with {start!r}. "
            "Convert it, or check the path."
        )
    return False


def _merge(campaigns: list[Campaign], sources: list[Path]) -> Campaign:
    first, factory = campaigns[0], dict(campaigns[0].factory)
    recordings: list[Recording] = list(first.recordings)
    for campaign, source in zip(campaigns[1:], sources[1:], strict=True):
        if campaign.device_id != first.device_id:
            raise DataError(
                f"Recordings of a campaign must be of one device, {first.device_id!r} ({sources[0]}), but got {campaign.device_id!r} "
                f"({source}). Calibrate each device on its own."
            )
        for key, value in campaign.factory.items():
            if factory.setdefault(key, value) != value:
                raise DataError(
                    f"Factory data must agree among the files, but got {key} = {value!r} in {source} and {factory[key]!r} before. "
                    "Correct the wrong one."
                )
        recordings += campaign.recordings
    return Campaign(first.device_id, tuple(recordings), factory)
