"""The plans: what to command, for how long, in which order, and why (whole-angle steps: :mod:`.whole_angle_plans`).

Times are device time. Qualities differ in duration only: ``quick`` for a first look, ``standard`` for a mission, ``fine`` for a bench.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from ..errors import DataError
from ..recording.command import Command, Excitation, Setpoints
from .plan import Limits, Plan, Step
from .whole_angle_plans import (
    PLACE_SETTLE_S,
    nominal_decay,
    scale_factor_plan,
    scale_factor_steps,
    virtual_precession_plan,
    virtual_precession_steps,
)

__all__ = [
    "PLANS",
    "QUALITIES",
    "cubic_plan",
    "feedthrough_plan",
    "mission_mode",
    "open_steps",
    "self_calibration_plan",
    "sideband_plan",
    "static_plan",
]


@dataclass(frozen=True)
class Quality:
    """Durations and lines of a plan.

    Parameters
    ----------
    lines_hz : tuple of float
        Side bands, equally spaced from 0.1 to 1.5 Hz (document 000).
    record_s, static_s, open_s : float
        Duration of a side-band, a static and a loops-off record [s].
    rounds : int
        How often the pair of axes is repeated (x y y x …, so that a linear drift cancels).
    """

    lines_hz: tuple[float, ...]
    record_s: float
    static_s: float
    open_s: float
    rounds: int


QUALITIES: dict[str, Quality] = {
    "quick": Quality((0.5, 1.5), 10.0, 10.0, 2.0, 1),
    "standard": Quality((0.1, 0.8, 1.5), 20.0, 30.0, 8.0, 2),
    "fine": Quality((0.1, 0.45, 0.8, 1.15, 1.5), 40.0, 60.0, 15.0, 4),
}
#: modulation index of the side bands (document 000: 2 to 20 %)
INDEX = 0.15
#: detuning of the feedthrough and of the body excitation records [Hz]
FEEDTHROUGH_HZ = (-60.0, -20.0, 20.0, 60.0)
BODY_HZ = (-40.0, 40.0)
#: drive amplitudes over the mission's that separate cubic from linear terms
CUBIC_AMPLITUDES = (0.6, 1.0, 1.4)
#: the loops need this long after a command; the first is a change of the oscillator axis [s]
SWAP_SETTLE_S, SETTLE_S, OPEN_SETTLE_S = 3.0, 1.0, 2.0
#: amplitude to which a wave that would ring on is brought down before its loops are opened, over the mission's
HUSH_SHARE = 0.01


def sideband_plan(factory: Mapping[str, Any], *, quality: str = "standard", limits: Limits | None = None) -> Plan:
    """Side bands and static stretches on both oscillator axes (document 000, steps 4 and 5).

    Parameters
    ----------
    factory : mapping
        Factory data of the unit.
    quality : {"quick", "standard", "fine"}
        Duration.
    limits : Limits, optional
        When to abort.

    Raises
    ------
    DataError
        Unknown quality, or factory data that lack what the plan needs.
    """
    return Plan("sideband", tuple(_loop_steps(_quality(quality), _amplitude(factory))), limits or Limits(), _mission(factory))


def feedthrough_plan(factory: Mapping[str, Any], *, quality: str = "standard", limits: Limits | None = None) -> Plan:
    """Loops off: open drive and body excitation off resonance (document 000, steps 2 and 3).

    Parameters
    ----------
    factory : mapping
        Factory data of the unit.
    quality : {"quick", "standard", "fine"}
        Duration.
    limits : Limits, optional
        When to abort.

    Raises
    ------
    DataError
        Unknown quality, or factory data that lack what the plan needs.
    """
    return Plan("feedthrough", tuple(open_steps(_quality(quality), factory)), limits or Limits(), _mission(factory))


def static_plan(factory: Mapping[str, Any], *, quality: str = "standard", limits: Limits | None = None) -> Plan:
    """A static stretch on each oscillator axis.

    Parameters
    ----------
    factory : mapping
        Factory data of the unit.
    quality : {"quick", "standard", "fine"}
        Duration.
    limits : Limits, optional
        When to abort.

    Raises
    ------
    DataError
        Unknown quality, or factory data that lack what the plan needs.
    """
    q, amplitude = _quality(quality), _amplitude(factory)
    steps = tuple(Step(f"static_{a}", Command(f"ftr_{a}", setpoints=Setpoints(amplitude)), 4.0 * q.static_s, SWAP_SETTLE_S) for a in "xy")
    return Plan("static", steps, limits or Limits(), _mission(factory))


def self_calibration_plan(factory: Mapping[str, Any], *, quality: str = "standard", limits: Limits | None = None) -> Plan:
    """Everything that the gyro's mission needs: feedthrough and pick-off phase; then side bands on both axes (force to rebalance), or
    ring-down, stiffness control and virtual precession (whole angle).

    Parameters
    ----------
    factory : mapping
        Factory data of the unit.
    quality : {"quick", "standard", "fine"}
        Duration.
    limits : Limits, optional
        When to abort.

    Raises
    ------
    DataError
        Unknown quality, or factory data that lack what the plan needs.
    """
    q = _quality(quality)
    if mission_mode(factory) == "whole_angle":
        steps = [*scale_factor_steps(factory, quality), *virtual_precession_steps(factory, quality)]
    else:
        steps = _loop_steps(q, _amplitude(factory))
    return Plan("self_calibrate", (*open_steps(q, factory), *steps), limits or Limits(), _mission(factory))


def mission_mode(factory: Mapping[str, Any]) -> str:
    """Mode of the mission: what the factory says, else whole angle for a hemisphere and force to rebalance for any other resonator."""
    stated = factory.get("mission_mode")
    return str(stated) if stated else ("whole_angle" if factory.get("kind") == "hrg" else "ftr_x")


def cubic_plan(factory: Mapping[str, Any], *, quality: str = "standard", limits: Limits | None = None) -> Plan:
    """The self-calibration at three amplitudes: cubic terms grow with the square and show only so (document 000, Eqs. 20-27).

    Parameters
    ----------
    factory : mapping
        Factory data of the unit.
    quality : {"quick", "standard", "fine"}
        Duration.
    limits : Limits, optional
        When to abort.

    Raises
    ------
    DataError
        Unknown quality, or factory data that lack what the plan needs.
    """
    q, amplitude = _quality(quality), _amplitude(factory)
    steps = open_steps(q, factory)
    for share in CUBIC_AMPLITUDES:
        steps += _loop_steps(q, amplitude * share, f"_a{share:g}")
    return Plan("cubic", tuple(steps), limits or Limits(), _mission(factory))


PLANS: dict[str, Callable[..., Plan]] = {
    "cubic": cubic_plan,
    "sideband": sideband_plan,
    "feedthrough": feedthrough_plan,
    "static": static_plan,
    "self_calibrate": self_calibration_plan,
    "virtual_precession": virtual_precession_plan,
    "scale_factor": scale_factor_plan,
}


def _quality(name: str) -> Quality:
    if name not in QUALITIES:
        raise DataError(f"Plan quality must be one of {', '.join(QUALITIES)}, but got {name!r}.")
    return QUALITIES[name]


def _amplitude(factory: Mapping[str, Any]) -> float:
    return float(factory.get("nominal_amplitude_v", 1.0))


def _mission(factory: Mapping[str, Any]) -> Command:
    return Command(mission_mode(factory), setpoints=Setpoints(_amplitude(factory)))


def _loop_steps(q: Quality, amplitude: float, suffix: str = "") -> list[Step]:
    steps: list[Step] = []
    axes = [a for turn in range(q.rounds) for a in ("xy" if turn % 2 == 0 else "yx")]
    previous = ""
    for count, axis in enumerate(axes):
        base = Command(f"ftr_{axis}", setpoints=Setpoints(amplitude))
        turn = count // 2
        steps.append(Step(f"static_{axis}_{turn}{suffix}", base, q.static_s, SETTLE_S if axis == previous else SWAP_SETTLE_S))
        for line in q.lines_hz:
            command = Command(f"ftr_{axis}", Excitation("amplitude_modulation", line, INDEX), Setpoints(amplitude))
            steps.append(Step(f"side_{axis}_{line:g}hz_{turn}{suffix}", command, q.record_s, SETTLE_S))
        previous = axis
    return steps


def open_steps(q: Quality, factory: Mapping[str, Any]) -> list[Step]:
    """Loops-off records about the resonance that a short static record measures first."""
    volts = 0.4 * float(factory.get("dac_full_scale_V", 5.0))
    amplitude = _amplitude(factory)
    # a hemisphere rings on for minutes once its loops are open, far above what the drives make there: bring it down first
    slow = 0.0 < nominal_decay(factory) * OPEN_SETTLE_S < 1.0
    locate = Command("ftr_x", setpoints=Setpoints(HUSH_SHARE * amplitude if slow else amplitude))
    steps = [Step("locate", locate, 2.0, PLACE_SETTLE_S if slow else SWAP_SETTLE_S)]
    for df in FEEDTHROUGH_HZ:
        for axis in "xy":
            command = Command("loops_off", Excitation("drive", 0.0, 0.0, volts, axis), Setpoints(amplitude))
            steps.append(Step(f"feed_{axis}_{df:+g}hz", command, q.open_s, OPEN_SETTLE_S, detuning_hz=df))
    for df in BODY_HZ:
        command = Command("loops_off", Excitation("body", 0.0, 0.0, 2.0 * volts, "both"), Setpoints(amplitude))
        steps.append(Step(f"body_{df:+g}hz", command, 2.0 * q.open_s, OPEN_SETTLE_S, detuning_hz=df))
    return steps
