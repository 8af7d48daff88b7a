"""Which command was in force when: the parameter events of a bag, laid beside its segments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from .attributes import command_from_attributes, decode_attribute, is_stated
from .command import MODES, Command

__all__ = ["ParameterChange", "command_of", "driver_changes", "states_of_segments", "words_of"]

_COMMAND_PREFIXES = ("excitation.", "setpoint.")
_COMMAND_NAMES = ("mode", "compensation")
#: attributes of a recording in HDF5 that say what was commanded, and those that say more of it: a driver may have them as parameters
_COMMAND_WORDS = ("virtual_precession_V", "excitation", "open_drive", "body_excitation", "stiffness_control", "amplitude_control")
_WORDS = (
    *_COMMAND_WORDS, "applied_rate", "t_run_start", "settle_s", "duration_s", "dac_zero_order_hold_s", "control_rate_hz", "adc_rate_hz",
    "firmware_drive_phase_advance_rad",
)  # fmt: skip


@dataclass(frozen=True)
class ParameterChange:
    """Parameters that one node set at once, at log time ``log_ns`` [ns]; None: it has them no longer."""

    log_ns: int
    node: str
    values: Mapping[str, Any]


def driver_changes(changes: Sequence[ParameterChange], namespace: str) -> list[ParameterChange]:
    """Changes of the gyro's driver: the node of ``namespace`` that takes commands.

    Other nodes may stand in the same namespace and have a parameter ``mode`` of another meaning.
    """
    local = [change for change in changes if change.node.rpartition("/")[0] == namespace.rstrip("/")]
    drivers = {change.node for change in local if any(_is_command(name, value) for name, value in change.values.items())}
    return [change for change in local if change.node in drivers]


def states_of_segments(first_seen: Sequence[tuple[int, int]], changes: Sequence[ParameterChange]) -> list[dict[str, Any]]:
    """All parameters known when each segment began.

    A driver increments ``segment`` once per command. Where the counts agree, commands and segments are paired in order; else (events
    lost, a driver that takes its parameters one by one) a segment gets all that had been logged before its first block.

    Parameters
    ----------
    first_seen : sequence of (int, int)
        Segment number and log time of the first block that holds it [ns], in order.
    changes : sequence of ParameterChange
        Of the driver, in log order.

    Returns
    -------
    list of dict
        One per segment.
    """
    if not first_seen:
        return []
    start_ns = first_seen[0][1]
    commands = [
        change.log_ns
        for change in changes
        if change.log_ns > start_ns and any(_is_command_name(name) or name in _WORDS for name in change.values)
    ]
    steps = [later[0] - earlier[0] for earlier, later in pairwise(first_seen)]
    paired = all(step == 1 for step in steps) and len(commands) == len(steps)
    until = [start_ns, *commands] if paired else [log_ns for _, log_ns in first_seen]
    return [_state(changes, limit) for limit in until]


def command_of(state: Mapping[str, Any]) -> Command | None:
    """Command in force, or None while its mode is not known.

    What the parameters of a command do not say the words of a recording in HDF5 may: a schedule of stiffness, a ring-down, an open drive.

    Raises
    ------
    DataError
        Values that are not understood.
    """
    flat = {name: value for name, value in state.items() if _is_command_name(name)}
    if "mode" not in flat:
        return None
    words = {name: word for name, word in words_of(state).items() if name in _COMMAND_WORDS}
    if not words:
        return Command.from_parameters(flat)
    told = command_from_attributes({"mode": flat["mode"], **words}, flat.get("setpoint.amplitude_v"))
    said = told.to_parameters()
    excited = {name: value for name, value in said.items() if name.startswith("excitation.") and told.excitation.kind != "none"}
    points = {name: value for name, value in said.items() if name.startswith("setpoint.") and name not in flat}
    return Command.from_parameters({**flat, **points, **excited, "mode": told.mode})


def words_of(state: Mapping[str, Any]) -> dict[str, Any]:
    """Attributes of a recording in HDF5 among the parameters, decoded.

    Parameters
    ----------
    state : mapping
    """
    return {name: decode_attribute(state[name]) for name in _WORDS if name in state}


def _state(changes: Sequence[ParameterChange], until_ns: int) -> dict[str, Any]:
    state: dict[str, Any] = {}
    for change in changes:
        if change.log_ns <= until_ns:
            state.update(change.values)
    # a mode is not optional: without one the segment would be left out and nobody told
    return {name: value for name, value in state.items() if is_stated(value) or (name == "mode" and value is not None)}


def _is_command_name(name: str) -> bool:
    return name in _COMMAND_NAMES or name.startswith(_COMMAND_PREFIXES)


def _is_command(name: str, value: Any) -> bool:
    return name.startswith(_COMMAND_PREFIXES) or (name == "mode" and value in MODES)
