"""Which command was in force when: the parameter events of a bag, laid beside its segments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from .command import MODES, Command

__all__ = ["ParameterChange", "command_of", "driver_changes", "states_of_segments"]

_COMMAND_PREFIXES = ("excitation.", "setpoint.")
_COMMAND_NAMES = ("mode", "compensation")


@dataclass(frozen=True)
class ParameterChange:
    """Parameters that one node set at once, at log time ``log_ns`` [ns]."""

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
    commands = [change.log_ns for change in changes if change.log_ns > start_ns and any(map(_is_command_name, change.values))]
    steps = [later[0] - earlier[0] for earlier, later in pairwise(first_seen)]
    paired = all(step == 1 for step in steps) and len(commands) == len(steps)
    until = [start_ns, *commands] if paired else [log_ns for _, log_ns in first_seen]
    return [_state(changes, limit) for limit in until]


def command_of(state: Mapping[str, Any]) -> Command | None:
    """Command in force, or None while its mode is not known."""
    flat = {name: value for name, value in state.items() if _is_command_name(name)}
    return Command.from_parameters(flat) if "mode" in flat else None


def _state(changes: Sequence[ParameterChange], until_ns: int) -> dict[str, Any]:
    state: dict[str, Any] = {}
    for change in changes:
        if change.log_ns <= until_ns:
            state.update(change.values)
    return state


def _is_command_name(name: str) -> bool:
    return name in _COMMAND_NAMES or name.startswith(_COMMAND_PREFIXES)


def _is_command(name: str, value: Any) -> bool:
    return name.startswith(_COMMAND_PREFIXES) or (name == "mode" and value in MODES)
