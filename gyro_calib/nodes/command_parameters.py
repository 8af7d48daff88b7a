"""A gyro's command as ROS parameters: declared with range and unit, checked before they are taken, read back as one command."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..errors import DataError
from ..recording.command import EXCITATIONS, Command
from ..recording.rate import WAVE_MODES
from .runtime import describe

__all__ = ["COMMAND_NAMES", "CommandLimits", "changed_command", "check_command", "declare_command", "read_command"]

#: parameters that make up a command
COMMAND_NAMES: tuple[str, ...] = tuple(Command().to_parameters())
_MODULATIONS = ("amplitude_modulation", "frequency_modulation", "secondary_modulation")
#: largest element of the drive compensation matrix
_COMPENSATION = 2.0


@dataclass(frozen=True)
class CommandLimits:
    """What a device can be told.

    Parameters
    ----------
    modes : tuple of str
        Modes that it has.
    drive_v : float
        Full scale of its drive [V].
    amplitude_v : float
        Largest pick-off amplitude [V].
    frequency_hz : float
        Highest frequency of an excitation [Hz].
    modulation_hz : float
        Highest side-band frequency: half of the recorded rows per second [Hz].
    """

    modes: tuple[str, ...]
    drive_v: float
    amplitude_v: float
    frequency_hz: float
    modulation_hz: float

    @classmethod
    def of(cls, factory: Mapping[str, Any], sample_rate_hz: float, modes: Sequence[str]) -> CommandLimits:
        """Limits that follow from a device's factory data."""
        return cls(
            modes=tuple(modes),
            drive_v=float(factory.get("dac_full_scale_V", 10.0)),
            amplitude_v=float(factory.get("adc_full_scale_V", 10.0)),
            frequency_hz=2.0 * float(factory.get("nominal_f0_hz", 5e5)),
            modulation_hz=0.5 * sample_rate_hz,
        )


def declare_command(node: Any, limits: CommandLimits, start: Command | None = None) -> None:
    """Declare the command parameters on ``node``, with the values of ``start`` (default: ``Command()``) unless overridden."""
    descriptors = {
        "mode": describe(f"Operating mode, one of {', '.join(limits.modes)}. x or y: the oscillator axis"),
        "excitation.kind": describe(f"Known disturbance, one of {', '.join(EXCITATIONS)}; drive and body need mode loops_off"),
        "excitation.frequency_hz": describe(
            f"Side-band frequency of a modulation (at most {limits.modulation_hz:g}), or absolute frequency of drive and body [Hz]",
            lo=0.0,
            hi=limits.frequency_hz,
        ),
        "excitation.index": describe("Modulation index; of frequency_modulation in rad [1]", lo=0.0, hi=1.0),
        "excitation.volts": describe("Amplitude of the excitations drive and body [V]", lo=0.0, hi=limits.drive_v),
        "excitation.axis": describe("Axis of the excitation drive: x, y; both for body"),
        "setpoint.amplitude_v": describe("Pick-off amplitude of the oscillator or of the wave [V]", lo=1e-3, hi=limits.amplitude_v),
        "setpoint.virtual_precession_v": describe(
            "Constant precession drive of a whole-angle gyro [V]", lo=-limits.drive_v, hi=limits.drive_v
        ),
        "setpoint.stiffness_v_per_v": describe(
            "Drive per pick-off, in phase with displacement [V/V]", lo=-limits.drive_v, hi=limits.drive_v
        ),
        "setpoint.amplitude_gain_v_per_v": describe(
            "Drive per pick-off of ring-down and ring-up, in phase with velocity [V/V]", lo=-limits.drive_v, hi=limits.drive_v
        ),
        "setpoint.rebalance": describe("Rebalance of the closed axis: 1 on, 0 off (open secondary) [1]", lo=0.0, hi=1.0, step=1.0),
        "compensation": describe(f"Drive compensation, 2x2 row-major, applied to (u_x, u_y); elements within +/-{_COMPENSATION:g} [V/V]"),
    }
    for name, default in (start or Command()).to_parameters().items():
        node.declare_parameter(name, default, descriptors[name])


def read_command(node: Any) -> Command:
    """The command that the parameters of ``node`` say."""
    return Command.from_parameters({name: node.get_parameter(name).value for name in COMMAND_NAMES})


def changed_command(node: Any, parameters: Iterable[Any], limits: CommandLimits) -> Command | None:
    """The command that ``parameters`` (of one atomic set) would make of the present one; None if none of them belongs to it.

    Raises
    ------
    DataError
        The result is not a command that the device can take; the text names the valid range.
    """
    changes = {parameter.name: parameter.value for parameter in parameters if parameter.name in COMMAND_NAMES}
    if not changes:
        return None
    command = Command.from_parameters({name: changes.get(name, node.get_parameter(name).value) for name in COMMAND_NAMES})
    check_command(command, limits)
    return command


def check_command(command: Command, limits: CommandLimits) -> None:
    """Check what descriptors cannot say: names, and which of them go together.

    Raises
    ------
    DataError
        The device cannot take ``command``.
    """
    excitation = command.excitation
    if command.mode not in limits.modes:
        raise DataError(f"Parameter mode must be one of {', '.join(limits.modes)}, but got {command.mode!r}.")
    if excitation.kind in _MODULATIONS and excitation.frequency_hz > limits.modulation_hz:
        raise DataError(
            f"Parameter excitation.frequency_hz must be in 0 to {limits.modulation_hz:g} Hz for {excitation.kind}, "
            f"but got {excitation.frequency_hz!r}. Half of the recorded rows per second is the limit."
        )
    if excitation.kind in ("drive", "body") and command.mode != "loops_off":
        raise DataError(
            f"Parameter mode must be loops_off for excitation.kind {excitation.kind}, but got {command.mode!r}. "
            "Set both in one atomic call."
        )
    if excitation.kind in _MODULATIONS and command.mode == "loops_off":
        raise DataError(
            f"Parameter mode must be one with a closed loop for excitation.kind {excitation.kind}, but got 'loops_off'. "
            "Set both in one atomic call."
        )
    if excitation.kind != "none" and command.mode in WAVE_MODES:
        raise DataError(f"Parameter excitation.kind must be none in mode {command.mode}, but got {excitation.kind!r}.")
    gain = command.setpoints.amplitude_gain_v_per_v
    if (command.mode == "ring_down" and gain > 0.0) or (command.mode == "ring_up" and gain <= 0.0):
        raise DataError(
            f"Parameter setpoint.amplitude_gain_v_per_v must be {'<= 0' if command.mode == 'ring_down' else '> 0'} in mode {command.mode}, "
            f"but got {gain!r}. Negative drives down."
        )
    if max(abs(c) for c in command.compensation) > _COMPENSATION:
        raise DataError(
            f"Parameter compensation must have elements in {-_COMPENSATION:g} to {_COMPENSATION:g}, but got {list(command.compensation)}."
        )
