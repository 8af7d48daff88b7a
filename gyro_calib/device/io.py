"""Device descriptions in YAML: every key is a field of a dataclass with its unit in its name; unknown keys are refused."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import numpy as np
import yaml

from ..errors import DeviceError
from ..paths import share_path
from ..plain_yaml import load_yaml
from .chains import DriveChain, Feedthrough, PickoffChain
from .device import Device, FactoryData
from .electronics import Electronics, Environment, Loops, Multiplexing, Noise
from .resonator import Nonlinearity, Resonator

__all__ = ["device_from_dict", "device_to_dict", "dump_device", "load_device"]

SCHEMA = 1
_PARTS: dict[str, type[Any]] = {
    "factory": FactoryData,
    "resonator": Resonator,
    "drive": DriveChain,
    "pickoff": PickoffChain,
    "feedthrough": Feedthrough,
    "nonlinearity": Nonlinearity,
    "electronics": Electronics,
    "multiplexing": Multiplexing,
    "loops": Loops,
    "noise": Noise,
    "environment": Environment,
}
_REQUIRED = ("factory", "resonator", "drive", "pickoff", "electronics")
T = TypeVar("T")


def load_device(source: str | Path) -> Device:
    """Read a device description.

    Parameters
    ----------
    source : str or Path
        Path of a YAML file, or the name of a packaged device (``"ring_15k"``).

    Raises
    ------
    DeviceError
        File absent, not YAML, unknown or missing key, value of the wrong type or not physical.
    """
    path = Path(source)
    if not path.is_file():
        packaged = share_path("config", "devices") / f"{Path(source).name.removesuffix('.yaml')}.yaml"
        if path.parent != Path(".") or not packaged.is_file():
            known = sorted(p.stem for p in packaged.parent.glob("*.yaml"))
            raise DeviceError(f"Device must be a YAML file or one of {', '.join(known)}, but got {str(source)!r}.")
        path = packaged
    try:
        document = load_yaml(path.read_text(encoding="utf-8"))
    except (ValueError, OSError) as error:
        raise DeviceError(f"Device file {path.name} must be readable YAML, but got: {error}.") from error
    return device_from_dict(document)


def dump_device(device: Device, path: str | Path, notes: Iterable[str] = ()) -> None:
    """Write the description of ``device`` to ``path``, for :func:`load_device` to read back equal, with ``notes`` as comments at its head.

    Raises
    ------
    DeviceError
        The file cannot be written.
    """
    head = "".join(f"# {line}\n" for note in notes for line in note.splitlines())
    target = Path(path)
    # half a description may be one of another device: parts that are missing have defaults
    partial = target.with_name(f".{target.name}.part")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(head + yaml.safe_dump(device_to_dict(device), sort_keys=False), encoding="utf-8")
        os.replace(partial, target)
    except OSError as error:
        with contextlib.suppress(OSError):
            partial.unlink()
        raise DeviceError(f"Device file must be writable, but got {error}. Choose another path.") from error


def device_to_dict(device: Device) -> dict[str, Any]:
    """Plain mapping of a device (the YAML document)."""
    document: dict[str, Any] = {"schema": SCHEMA, "device_id": device.device_id}
    for key in _PARTS:
        document[key] = dataclasses.asdict(getattr(device, "factory_data" if key == "factory" else key))
    if device.effects:
        document["effects"] = {name: dict(sizes) for name, sizes in device.effects.items()}
    return document


def device_from_dict(document: Any) -> Device:
    """Inverse of :func:`device_to_dict`; parts other than the required ones default.

    Raises
    ------
    DeviceError
        A key is unknown or missing, another schema, or a value that no device has.
    """
    if not isinstance(document, Mapping):
        raise DeviceError(f"Device document must be a mapping, but got {type(document).__name__}.")
    unknown = sorted(set(map(str, document)) - set(_PARTS) - {"schema", "device_id", "effects"})
    missing = [key for key in ("device_id", *_REQUIRED) if key not in document]
    if unknown or missing:
        raise DeviceError(f"Device document must have known keys, but got unknown {unknown} and missing {missing}.")
    if document.get("schema", SCHEMA) != SCHEMA:
        raise DeviceError(f"Device schema must be {SCHEMA}, but got {document['schema']!r}.")
    parts = {"factory_data" if key == "factory" else key: _build(_PARTS[key], key, document[key]) for key in _PARTS if key in document}
    device = Device(device_id=str(document["device_id"]), effects=document.get("effects") or {}, **parts)
    _check_computable(device)
    return device


def _check_computable(device: Device) -> None:
    """Each number may be possible, and all together beyond what can be computed."""
    try:
        with np.errstate(all="ignore"):
            flow = device.slow_flow()
            computable = all(np.isfinite(part).all() for part in (flow.A, flow.G, flow.E, flow.dA_dOmega))
    except (ArithmeticError, np.linalg.LinAlgError):
        computable = False
    if not computable:
        raise DeviceError(f"Device {device.device_id!r} must have a finite slow flow, but its numbers give none. Check their units.")


def _build(kind: type[T], name: str, values: Any) -> T:
    if not isinstance(values, Mapping):
        raise DeviceError(f"Device part {name} must be a mapping, but got {values!r}.")
    hints = get_type_hints(kind)
    unknown = sorted(set(map(str, values)) - set(hints))
    if unknown:
        raise DeviceError(f"Device part {name} must have keys among {', '.join(hints)}, but got {', '.join(unknown)}.")
    try:
        return kind(**{key: _coerce(f"{name}.{key}", hints[key], value) for key, value in values.items()})
    except TypeError as error:
        raise DeviceError(f"Device part {name} must be complete, but got {sorted(values)} ({error}).") from error


def _coerce(name: str, wanted: Any, value: Any) -> Any:
    """YAML 1.1 reads ``1e6`` as text: numbers are accepted as text, nothing else is."""
    if wanted is bool:
        if not isinstance(value, bool):
            raise DeviceError(f"Device value {name} must be true or false, but got {value!r}.")
        return value
    if wanted is str:
        return str(value)
    try:
        if isinstance(value, bool):
            raise ValueError
        number = float(value)
        if wanted is int:
            if number != int(number):
                raise ValueError
            return int(number)
    except (TypeError, ValueError, OverflowError) as error:
        raise DeviceError(f"Device value {name} must be {'an integer' if wanted is int else 'a number'}, but got {value!r}.") from error
    return number
