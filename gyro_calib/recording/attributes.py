"""From the words of a logger to a command: the attributes of a file, however their writer spelled them.

What is understood becomes a :class:`~gyro_calib.recording.command.Command`; every attribute is kept, decoded, under its own name.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from ..errors import DataError
from .command import MODES, Command, Excitation, Setpoints, excitation_kind

__all__ = ["command_from_attributes", "decode_attribute", "is_stated", "naming_recording", "plain_value", "to_attributes"]

_IDENTITY = (1.0, 0.0, 0.0, 1.0)


def decode_attribute(value: Any) -> Any:
    """Plain Python value of an attribute: bytes and numpy types unwrapped, JSON text of objects and lists parsed.

    Parameters
    ----------
    value : object
        Attribute as the file library gives it.

    Returns
    -------
    object
        str, bool, int, float, list, dict or None; text that only looks like JSON stays text.
    """
    if isinstance(value, bytes | np.bytes_):
        value = bytes(value).decode("utf-8", errors="replace")
    if isinstance(value, np.ndarray):
        return decode_attribute(value.reshape(-1)[0]) if value.size == 1 else [decode_attribute(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
        return decode_attribute(value) if isinstance(value, bytes) else value
    if isinstance(value, str) and value.strip()[:1] in ("{", "["):
        try:
            return json.loads(value)
        except (ValueError, RecursionError):
            return value
    return value


def is_stated(value: Any) -> bool:
    """Whether an attribute or parameter says anything: a driver declares what it has not as an empty text.

    Parameters
    ----------
    value : object
    """
    return value is not None and not (isinstance(value, str | bytes) and not value.strip())


@contextmanager
def naming_recording(label: str) -> Iterator[None]:
    """What is wrong with an attribute, with the recording that has it.

    Parameters
    ----------
    label : str

    Raises
    ------
    DataError
        That of the block, its text after the recording's label.
    """
    try:
        yield
    except DataError as error:
        raise DataError(f"Recording {label!r}: {error}") from error


def command_from_attributes(attributes: Mapping[str, Any], measured_amplitude_v: float | None = None) -> Command:
    """What was commanded, from decoded attributes.

    Understood are this package's own ``command`` (ROS parameter names and values) or, from any logger, ``mode``, ``oscillator_axis``,
    ``amplitude_set_V``, ``virtual_precession_V``, ``excitation`` {kind, m, nu_hz}, ``open_drive`` and ``body_excitation`` {freq, axis,
    volts}, ``compensation``, ``stiffness_control`` and ``amplitude_control``. A recording under ``stiffness_control`` or
    ``amplitude_control`` has the mode ``stiffness`` or ``ring_down`` whatever its base mode: the schedule stays in the attributes.

    Parameters
    ----------
    attributes : mapping
        Decoded attributes of one recording.
    measured_amplitude_v : float, optional
        Set point to assume when the file states none [V].

    Returns
    -------
    Command

    Raises
    ------
    DataError
        No mode, or words that are not understood.
    """
    own = attributes.get("command")
    if isinstance(own, Mapping):
        return Command.from_parameters(own)
    amplitude = _first(attributes, ("amplitude_set_V", "amplitude_set_v", "amplitude_v", "amplitude_V"))
    stiffness, ring = attributes.get("stiffness_control"), attributes.get("amplitude_control")
    mode = "stiffness" if stiffness else _ring_mode(attributes, ring) if ring else _mode(attributes)
    if mode == "loops_off" and amplitude is not None and _number(amplitude, "amplitude_set_V") == 0.0:
        # no loop holds an amplitude then
        amplitude = None
    if amplitude is None:
        amplitude = measured_amplitude_v if measured_amplitude_v else 1.0
    setpoints = Setpoints(
        amplitude_v=_number(amplitude, "amplitude_set_V"),
        virtual_precession_v=_number(_first(attributes, ("virtual_precession_V", "virtual_precession_v")) or 0.0, "virtual_precession_V"),
        stiffness_v_per_v=_steady_stiffness(stiffness),
        amplitude_gain_v_per_v=_ring_gain(ring),
    )
    return Command(mode, _excitation(attributes), setpoints, _compensation(attributes.get("compensation")))


def _ring_mode(attributes: Mapping[str, Any], ring: Any) -> str:
    """The mode as it was stated, if it was one of these; otherwise by the sign of the gain."""
    stated = _mode(attributes) if attributes.get("mode") else ""
    if stated in ("ring_down", "ring_up"):
        return stated
    return "ring_up" if _ring_gain(ring) > 0.0 else "ring_down"


def _ring_gain(ring: Any) -> float:
    """Drive in phase with velocity per volt of amplitude, negative down; a record of both begins with the way down."""
    for name in ("gain_down", "gain_up"):
        if isinstance(ring, Mapping) and name in ring:
            return _number(ring[name], name)
    return 0.0


def to_attributes(command: Command) -> dict[str, Any]:
    """The words of :func:`command_from_attributes` for a command: its own form, and a stranger's for what both know."""
    words: dict[str, Any] = {
        "command": command.to_parameters(),
        "mode": command.mode,
        "amplitude_set_V": command.setpoints.amplitude_v,
        "virtual_precession_V": command.setpoints.virtual_precession_v,
        "compensation": [list(command.compensation[:2]), list(command.compensation[2:])],
    }
    excitation = command.excitation
    if command.oscillator_axis:
        words["oscillator_axis"] = command.oscillator_axis
    if excitation.kind == "drive":
        words["open_drive"] = {"freq": excitation.frequency_hz, "axis": excitation.axis, "volts": excitation.volts}
    elif excitation.kind == "body":
        words["body_excitation"] = {"freq": excitation.frequency_hz, "volts": excitation.volts}
    elif excitation.kind != "none":
        words["excitation"] = {"kind": excitation.kind, "m": excitation.index, "nu_hz": excitation.frequency_hz}
    return words


def plain_value(value: Any) -> Any:
    """Value that JSON knows: mappings, sequences and numpy types unwrapped, anything else as text."""
    if isinstance(value, Mapping):
        return {str(key): plain_value(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_value(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain_value(value.tolist())
    return value if isinstance(value, str | bool | int | float) or value is None else str(value)


def _first(words: Mapping[str, Any], names: tuple[str, ...]) -> Any:
    return next((words[name] for name in names if words.get(name) is not None), None)


def _number(value: Any, name: str) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise DataError(f"Attribute {name} must be a number, but got {value!r}. Correct it in the file.") from None


def _mode(attributes: Mapping[str, Any]) -> str:
    stated, axis = attributes.get("mode"), str(attributes.get("oscillator_axis", "")).strip().lower()
    mode = re.sub(r"[^a-z]+", "_", str(stated or "").lower()).strip("_")
    mode = re.sub(r"^force_(to_)?rebalance", "ftr", mode)
    if mode in ("", "ftr") and axis in ("x", "y"):
        mode = f"ftr_{axis}"
    if mode not in MODES:
        raise DataError(f"Attribute mode must be one of {', '.join(MODES)}, but got {stated!r}. State the mode of the recording.")
    if mode.startswith("ftr_") and axis in ("x", "y") and mode[-1] != axis:
        raise DataError(f"Attribute oscillator_axis must agree with mode {stated!r}, but got {axis!r}. Correct one of them.")
    return mode


def _excitation(attributes: Mapping[str, Any]) -> Excitation:
    for name, kind, axis in (("open_drive", "drive", "x"), ("body_excitation", "body", "both")):
        words = attributes.get(name)
        if words:
            words = _mapping(words, name)
            return _excitation_from(words, kind, str(words.get("axis", axis)).lower())
    words = attributes.get("excitation")
    if not words or str(words).strip().lower() == "none":
        return Excitation()
    words = _mapping(words, "excitation")
    return _excitation_from(words, excitation_kind(words.get("kind", "none")), str(words.get("axis", "x")).lower())


def _mapping(value: Any, name: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise DataError(f"Attribute {name} must be a JSON object, but got {value!r}. Correct it in the file.")
    return value


def _excitation_from(words: Mapping[str, Any], kind: str, axis: str) -> Excitation:
    return Excitation(
        kind=kind,
        frequency_hz=_number(_first(words, ("nu_hz", "frequency_hz", "freq", "freq_hz", "f_hz")) or 0.0, "frequency of the excitation"),
        index=_number(_first(words, ("m", "index", "modulation_index")) or 0.0, "index of the excitation"),
        volts=_number(_first(words, ("volts", "volts_v", "volts_V", "amplitude_V")) or 0.0, "volts of the excitation"),
        axis=axis,
    )


def _compensation(value: Any) -> tuple[float, float, float, float]:
    if value is None:
        return _IDENTITY
    try:
        matrix = np.asarray(value, dtype=np.float64).reshape(4)
    except (TypeError, ValueError):
        raise DataError(f"Attribute compensation must be a 2x2 matrix, but got {value!r}. Correct it in the file.") from None
    a, b, c, d = (float(v) for v in matrix)
    return a, b, c, d


def _steady_stiffness(schedule: Any) -> float:
    """CR, where the whole recording has one; a schedule of several stays in the attributes."""
    steps = schedule.get("cr_V_per_V") if isinstance(schedule, Mapping) else schedule
    if isinstance(steps, int | float):
        return float(steps)
    if isinstance(steps, list) and len(steps) == 1 and isinstance(steps[0], list) and len(steps[0]) == 2:
        return _number(steps[0][1], "cr_V_per_V")
    return 0.0
