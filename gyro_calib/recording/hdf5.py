"""Campaigns on disk as one HDF5 file: written plainly, read liberally.

Layout: root attributes ``format``, ``format_version``, ``device_id``, ``factory`` (JSON); one group per recording in order, its metadata as
attributes (nested ones as JSON), one dataset per column, optionally a group ``raw`` of carrier-rate samples. A recording of raw samples
alone, in the group ``raw`` or beside the attributes, is demodulated as it is read (:mod:`.demodulate`).
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from .attributes import command_from_attributes, decode_attribute, is_stated, naming_recording, plain_value, to_attributes
from .columns import COLUMN_UNITS, COLUMNS
from .demodulate import demodulate
from .integrity import validate
from .names import match_columns, match_envelope, match_raw
from .recording import Campaign, Recording

__all__ = ["FORMAT", "FORMAT_VERSION", "read_campaign_h5", "write_campaign_h5"]

FloatArray = NDArray[np.float64]

FORMAT = "gyro_calib recording"
FORMAT_VERSION = 1
#: what h5py raises on a file that is damaged or holds something else than expected
_READ_ERRORS = (OSError, RuntimeError, KeyError, ValueError, TypeError, IndexError, OverflowError, MemoryError)
#: samples of one dataset; more is a damaged header or a file that does not fit the memory
_MOST_SAMPLES = 2**28
#: release of HDF5 whose format has checksums of its own data; older ones than that of 2008 do not read it
_FORMAT_SINCE = ("v108", "latest")
_RATE_NAMES = ("sample_rate_hz", "sample_rate", "fs_hz", "fs", "rate_hz")


def write_campaign_h5(path: str | os.PathLike[str], campaign: Campaign, *, dtype: str = "float64") -> Path:
    """Write a campaign; the file appears whole or not at all.

    Parameters
    ----------
    path : path
        Target; replaced if it exists.
    campaign : Campaign
        What to write.
    dtype : {"float64", "float32"}
        Of the eight envelope columns; ``t``, ``segment``, ``ref_freq`` and ``temperature`` are always float64.

    Returns
    -------
    Path
        The target.

    Raises
    ------
    DataError
        The target cannot be written.
    """
    target = Path(path)
    partial = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(_image(campaign, dtype))
        os.replace(partial, target)
    except (OSError, RuntimeError, ValueError) as error:
        raise DataError(f"Recording file must be writable, but got {error} for {target}. Choose another folder.") from error
    finally:
        with suppress(OSError):
            partial.unlink()
    return target


def read_campaign_h5(
    path: str | os.PathLike[str], *, check: bool = True, on_progress: Callable[[float, str], None] | None = None
) -> Campaign:
    """Read a campaign written here or by a stranger's logger.

    Taken as they come: bytes or str attributes, nested ones as JSON, any case and usual spellings of column names, no ``segment``, no
    ``sample_rate_hz`` (then from ``t``), float32, recordings in groups (in the order of their numbers) or one at the root.

    Parameters
    ----------
    path : path
        HDF5 file.
    check : bool
        Validate every recording (:func:`~gyro_calib.recording.integrity.validate`).
    on_progress : callable, optional
        Called with the fraction done and the name of the recording just read.

    Returns
    -------
    Campaign
        Every original attribute stands decoded in ``extras`` of its recording.

    Raises
    ------
    DataError
        Not such a file, damaged, or not passing the checks; the text names the file, the recording and the remedy.
    """
    source, report = Path(path), on_progress or (lambda fraction, name: None)
    with ExitStack() as open_files:
        with _reading(source):
            file = open_files.enter_context(h5py.File(source, "r"))
            device_id, factory = _identity(_attributes(file))
            groups = _recording_groups(file)
        recordings = []
        for index, group in enumerate(groups):
            with _reading(source):
                recording = _read_recording(group, device_id, index, factory)
            if check:
                _validate(recording, factory, source)
            recordings.append(recording)
            report((index + 1) / len(groups), recording.label)
    return Campaign(device_id, tuple(recordings), factory)


@contextmanager
def _reading(source: Path) -> Iterator[None]:
    """What h5py raises, in this package's words."""
    try:
        yield
    except DataError as error:
        raise DataError(f"{source}: {error}") from error
    except FileNotFoundError:
        raise DataError(f"Recording file must exist, but got {source}. Check the path.") from None
    except _READ_ERRORS as error:
        raise DataError(f"Recording file must be readable HDF5, but got {error} for {source}. Copy or record it again.") from error


def _validate(recording: Recording, factory: Mapping[str, Any], source: Path) -> None:
    try:
        validate(recording, factory)
    except DataError as error:
        raise DataError(f"{source}: {error}") from error


def _identity(root: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Device id and factory data of the root's attributes."""
    stated = root.get("format")
    if stated not in (None, FORMAT):
        raise DataError(f"Root attribute format must be {FORMAT!r}, but got {stated!r}. This file holds something else.")
    version = root.get("format_version", FORMAT_VERSION)
    if not isinstance(version, int | float) or version > FORMAT_VERSION:
        raise DataError(f"Root attribute format_version must be at most {FORMAT_VERSION}, but got {version!r}. Update gyro_calib.")
    factory = root.get("factory", {})
    if not isinstance(factory, Mapping):
        raise DataError(f"Root attribute factory must be a JSON object, but got {factory!r}. Correct it in the file.")
    device_id = root.get("device_id") or factory.get("unit")
    if not device_id:
        raise DataError("Root attribute device_id must name the unit, but got none. Set it in the file.")
    return str(device_id), dict(factory)


def _recording_groups(file: h5py.File) -> list[h5py.Group]:
    """Groups with datasets, in natural order of their names; the root itself when it holds the columns."""
    if _is_recording(file):
        return [file]
    groups: list[h5py.Group] = [item for item in _items(file).values() if isinstance(item, h5py.Group)]
    if groups and not any(map(_is_recording, groups)):
        groups = [item for group in groups for item in _items(group).values() if isinstance(item, h5py.Group)]
    groups = [group for group in groups if _is_recording(group)]
    if not groups:
        raise DataError("A recording file must hold one group of columns per recording, but got none. Check what the logger wrote.")
    return sorted(groups, key=lambda group: [int(p) if p.isdigit() else p for p in re.split(r"(\d+)", group.name)])


def _is_recording(group: h5py.Group) -> bool:
    return any(isinstance(item, h5py.Dataset) or (key == "raw" and isinstance(item, h5py.Group)) for key, item in _items(group).items())


def _items(group: h5py.Group) -> dict[str, Any]:
    """What a group holds by name; its own ``items()`` gives None for a member that is damaged, as for a link that leads nowhere."""
    hard = {key: isinstance(group.get(key, getlink=True), h5py.HardLink) for key in group}
    return {key: group[key] if must else group.get(key) for key, must in hard.items()}


def _read_recording(group: h5py.Group, device_id: str, index: int, factory: Mapping[str, Any]) -> Recording:
    name = group.name.strip("/") or "root"
    attributes = _attributes(group)
    if _is_raw_only(_dataset_names(group)):
        return _from_raw(group, device_id, index, attributes, factory)
    columns = {column: _dataset(group, key) for column, key in match_columns(_dataset_names(group), name).items()}
    lengths = {column: values.size for column, values in columns.items()}
    if len(set(lengths.values())) > 1:
        raise DataError(f"Columns of {name} must be of one length, but got {lengths}. Write every column at the same rate.")
    label = str(attributes.get("label") or name)
    t, rate = _time_and_rate(columns["t"], attributes, label)
    data = np.empty((t.size, len(COLUMNS)))
    for position, column in enumerate(COLUMNS):
        data[:, position] = columns[column] if column in columns else _stand_in(column, attributes, index, name)
    data[:, 0] = t
    with naming_recording(label):
        command = command_from_attributes(attributes, _amplitude(data))
    return Recording(device_id, data, command, rate, label, attributes, _read_raw(group, name))


def _is_raw_only(names: list[str]) -> bool:
    """No envelopes, but perhaps the carrier-rate channels themselves."""
    return not any(match_envelope(name) for name in names)


def _from_raw(group: h5py.Group, device_id: str, index: int, attributes: Mapping[str, Any], factory: Mapping[str, Any]) -> Recording:
    """Demodulate a recording that holds nothing but carrier-rate samples."""
    name = group.name.strip("/") or "root"
    raw = _read_raw(group, name) or _read_raw_channels(group, name)
    if raw is None or "t" not in raw:
        match_columns(_dataset_names(group), name)  # says what is missing
        raise DataError(f"Raw block of {name} must hold t [s], but does not. Write the time of every sample.")
    step = float(np.median(np.diff(raw["t"]))) if raw["t"].size > 1 else 0.0
    if not step > 0.0:
        raise DataError(f"Raw channel t of {name} must increase, but got steps of {step:.6g} s. Write t as float64 seconds.")
    stated = next((attributes[key] for key in _RATE_NAMES if isinstance(attributes.get(key), int | float)), 1.0 / step)
    label = str(attributes.get("label") or name)
    with naming_recording(label):
        command = command_from_attributes(attributes)
    alone = Recording(device_id, np.empty((0, len(COLUMNS))), command, float(stated), label, attributes, raw)
    recording = demodulate(alone, factory=factory)
    data = recording.data.copy()
    data[:, COLUMNS.index("segment")] = index
    return replace(recording, data=data, command=command_from_attributes(attributes, _amplitude(data)))


def _stand_in(column: str, attributes: Mapping[str, Any], index: int, name: str) -> float:
    """Value of a column that the file does not hold: one recording is one segment; a constant temperature may be an attribute."""
    if column == "segment":
        return float(index)
    constant = next((attributes[key] for key in attributes if key.lower().startswith("temperature")), None)
    if column == "temperature" and isinstance(constant, int | float):
        return float(constant)
    raise DataError(f"Recording {name} must have the column {column} [{COLUMN_UNITS[column]}], but got none like it. Add it to the file.")


def _dataset_names(group: h5py.Group) -> list[str]:
    return [key for key, item in _items(group).items() if isinstance(item, h5py.Dataset)]


def _dataset(group: h5py.Group, key: str) -> NDArray[Any]:
    """A column as float64 (float32 for ``t`` that was stored so: its resolution matters), shape (n,)."""
    dataset = group[key]
    if dataset.dtype.kind not in "fiu" or dataset.size is None:
        raise DataError(f"Column {key} of {group.name} must hold numbers, but got {dataset.dtype}. Write it as float64.")
    if dataset.size > _MOST_SAMPLES:
        raise DataError(f"Column {key} of {group.name} must hold at most {_MOST_SAMPLES} samples, but got {dataset.size}. Split the file.")
    if max(dataset.shape, default=1) != dataset.size:
        raise DataError(
            f"Column {key} of {group.name} must be one-dimensional, but got shape {dataset.shape}. Write one column per dataset."
        )
    values = np.asarray(dataset[()]).reshape(-1)
    return values if values.dtype == np.float32 else values.astype(np.float64)


def _time_and_rate(t: NDArray[Any], attributes: Mapping[str, Any], label: str) -> tuple[FloatArray, float]:
    """Device time in float64 and the sample rate, stated or found in ``t``."""
    time = t.astype(np.float64)
    stated = next((attributes[key] for key in _RATE_NAMES if isinstance(attributes.get(key), int | float)), None)
    if stated is None:
        steps = np.diff(time)
        step = float(np.median(steps)) if steps.size else 0.0
        if not step > 0.0:
            raise DataError(
                f"Column t of {label!r} must increase, but got steps of {step:.6g} s. State sample_rate_hz, or write t as float64 seconds."
            )
        stated = 1.0 / step
        if steps.max() < 1.5 * step:
            stated = (time.size - 1) / (time[-1] - time[0])
        stated = round(stated) if abs(stated - round(stated)) < 1e-6 * stated else stated
    if not (np.isfinite(stated) and stated > 0):
        raise DataError(f"Attribute sample_rate_hz of {label!r} must be > 0, but got {stated!r}. Correct it in the file.")
    return (_regrid(time, float(stated), label) if t.dtype == np.float32 else time), float(stated)


def _regrid(time: FloatArray, rate_hz: float, label: str) -> FloatArray:
    """Times that were stored as float32, put back on the grid they came from; lost and repeated rows stay visible."""
    if time.size == 0 or not np.isfinite(time).all():
        return time
    resolution = float(np.spacing(np.float32(np.abs(time).max())))
    if resolution > 0.5 / rate_hz:
        raise DataError(
            f"Column t of {label!r} must tell samples {1.0 / rate_hz:.3g} s apart, but got float32 with a resolution of "
            f"{resolution:.3g} s. Write t as float64."
        )
    ticks = np.round((time - time[0]) * rate_hz)
    grid = time[0] + ticks / rate_hz
    return grid if np.abs(grid - time).max() <= resolution else time


def _amplitude(data: FloatArray) -> float:
    """Median vibration amplitude [V]: the set point of a file that states none."""
    amplitude = float(np.median(np.sqrt(np.sum(data[:, 2:6] ** 2, axis=1)))) if data.size else 0.0
    return amplitude if np.isfinite(amplitude) else 0.0


def _read_raw(group: h5py.Group, name: str) -> dict[str, FloatArray] | None:
    raw = group.get("raw")
    return _read_raw_channels(raw, name) if isinstance(raw, h5py.Group) else None


def _read_raw_channels(raw: h5py.Group, name: str) -> dict[str, FloatArray] | None:
    channels = {ours: _dataset(raw, key).astype(np.float64) for ours, key in match_raw(_dataset_names(raw)).items()}
    lengths = {channel: values.size for channel, values in channels.items()}
    if len(set(lengths.values())) > 1:
        raise DataError(f"Raw channels of {name} must be of one length, but got {lengths}. Write them at one rate.")
    return channels or None


def _attributes(item: h5py.Group) -> dict[str, Any]:
    values = {key: item.attrs[key] for key in item.attrs}
    decoded = {key: None if isinstance(value, h5py.Empty) else decode_attribute(value) for key, value in values.items()}
    return {key: value for key, value in decoded.items() if value is None or is_stated(value)}


def _image(campaign: Campaign, dtype: str) -> bytes:
    """The file's content. Made in memory, because the HDF5 library ends the process when a disk fills up under it."""
    with h5py.File("campaign", "w", libver=_FORMAT_SINCE, driver="core", backing_store=False, block_size=1 << 20) as file:
        file.attrs["format"] = FORMAT
        file.attrs["format_version"] = FORMAT_VERSION
        file.attrs["device_id"] = campaign.device_id
        file.attrs["factory"] = json.dumps(plain_value(campaign.factory))
        for index, recording in enumerate(campaign):
            _write_recording(file.create_group(f"recording_{index:03d}"), recording, dtype)
        file.flush()
        return bytes(file.id.get_file_image())


def _write_recording(group: h5py.Group, recording: Recording, dtype: str) -> None:
    ours = to_attributes(recording.command)
    words = ours | dict(recording.extras)  # a logger keeps its own words; `command` says what they mean
    words |= {"command": ours["command"], "label": recording.label, "sample_rate_hz": recording.sample_rate_hz}
    for key, value in words.items():
        plain = plain_value(value)
        if plain is None:
            group.attrs[key] = h5py.Empty("f8")
        else:
            group.attrs[key] = plain if isinstance(plain, str | int | float) else json.dumps(plain)
    for column in COLUMNS if len(recording) else ():
        narrow = column in COLUMNS[2:10]
        values = recording.column(column).astype(dtype if narrow else np.float64)
        dataset = group.create_dataset(column, data=values, compression="gzip", compression_opts=1, shuffle=True, fletcher32=True)
        dataset.attrs["unit"] = COLUMN_UNITS[column]
    if recording.raw is not None:
        raw = group.create_group("raw")
        for channel, samples in recording.raw.items():
            raw.create_dataset(channel, data=samples, fletcher32=samples.size > 0)
