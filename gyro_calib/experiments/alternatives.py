"""The ways of exciting the sensor that document 000 names beside its own, to compare them: same lines, same times, same open records first.

``amplitude``       its own: oscillator position modulated in amplitude, secondary closed.
``frequency``       position modulated in frequency instead ("may provide a mechanism for handling nonlinear stiffness terms").
``secondary``       modulation of the secondary output, oscillator steady ("nonlinear stiffness terms again may degrade").
``open_secondary``  its own, but with the secondary loop open ("nonlinear stiffness terms may degrade performance").
``swept_drive``     no self-oscillator, the drive stepped through resonance ("may be very sensitive to variations in stiffness").
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ..errors import DataError
from ..recording.command import Command, Excitation, Setpoints
from .plan import Limits, Plan, Step
from .plans import INDEX, SWAP_SETTLE_S, feedthrough_plan

__all__ = ["ALTERNATIVES", "alternative_plan", "swept_drive_plan"]

_KINDS = {
    "amplitude": "amplitude_modulation",
    "frequency": "frequency_modulation",
    "secondary": "secondary_modulation",
    "open_secondary": "amplitude_modulation",
}
ALTERNATIVES = (*_KINDS, "swept_drive")
#: distances of the stepped drive from resonance [Hz]: the range of the side bands, both sides, the half-width well sampled
SWEEP_HZ = (-1.5, -0.8, -0.35, -0.1, 0.1, 0.35, 0.8, 1.5)
#: decay times until a free oscillation is forgotten (e^-10)
_FORGET = 10.0


def alternative_plan(
    name: str,
    factory: Mapping[str, Any],
    *,
    lines_hz: tuple[float, ...] = (0.3, 0.8, 1.5),
    record_s: float = 10.0,
    quality: str = "quick",
    limits: Limits | None = None,
) -> Plan:
    """Plan of one alternative: open records (feed-forward, pick-off phase), then what it excites, on both axes.

    Parameters
    ----------
    name : str
        One of :data:`ALTERNATIVES`.
    factory : mapping
        Factory data of the unit.
    lines_hz : tuple of float
        Side bands (not of the swept drive).
    record_s : float
        Duration of each recording.
    quality : {"quick", "standard", "fine"}
        Of the open records.
    limits : Limits, optional
        Abort conditions.

    Raises
    ------
    DataError
        Unknown name, or factory data that lack what the plan needs.
    """
    if name not in ALTERNATIVES:
        raise DataError(f"Alternative must be one of {', '.join(ALTERNATIVES)}, but got {name!r}.")
    if name == "swept_drive":
        return swept_drive_plan(factory, record_s=0.4 * record_s, quality=quality, limits=limits)
    start = _first_steps(factory, quality)
    rebalance = 0.0 if name == "open_secondary" else 1.0
    setpoints = Setpoints(_amplitude(factory), rebalance=rebalance)
    settle = _forget_s(factory) if name == "open_secondary" else SWAP_SETTLE_S
    steps = [
        Step(f"{name}_{axis}_{line:g}hz", Command(f"ftr_{axis}", Excitation(_KINDS[name], line, INDEX), setpoints), record_s, settle)
        for axis in "xy"
        for line in lines_hz
    ]
    return Plan(name, (*start, *steps), limits or Limits(), start[0].command)


def swept_drive_plan(factory: Mapping[str, Any], *, record_s: float = 4.0, quality: str = "quick", limits: Limits | None = None) -> Plan:
    """Drive stepped through resonance on each axis, loops off, at the volts that the oscillator needs for its amplitude.

    Raises
    ------
    DataError
        The factory data lack the angular gain or the nominal scale factors, or the quality is unknown.
    """
    start = _first_steps(factory, quality)
    try:
        kappa = float(factory["angular_gain_kappa"])
        gain = {a: kappa * _amplitude(factory) / abs(float(factory["nominal_scale_factor_v_per_rad_s"][o])) for a, o in ("xy", "yx")}
    except (KeyError, TypeError, ZeroDivisionError) as error:
        raise DataError(f"Factory data must hold angular_gain_kappa and nominal_scale_factor_v_per_rad_s, but got {error!r}.") from error
    decay = 1.0 / _decay_s(factory)
    steps = [
        Step(
            f"sweep_{axis}_{df:+g}hz",
            Command("loops_off", Excitation("drive", 0.0, 0.0, _amplitude(factory) * decay / gain[axis], axis)),
            record_s,
            _forget_s(factory),
            detuning_hz=df,
        )
        for axis in "xy"
        for df in SWEEP_HZ
    ]
    return Plan("swept_drive", (*start, *steps), limits or Limits(), start[0].command)


def _first_steps(factory: Mapping[str, Any], quality: str) -> tuple[Step, ...]:
    """Where both resonances are, then the open records."""
    locate = Step("locate_y", Command("ftr_y", setpoints=Setpoints(_amplitude(factory))), 2.0, SWAP_SETTLE_S)
    opened = feedthrough_plan(factory, quality=quality).steps
    return (opened[0], locate, *opened)


def _amplitude(factory: Mapping[str, Any]) -> float:
    return float(factory.get("nominal_amplitude_v", 1.0))


def _decay_s(factory: Mapping[str, Any]) -> float:
    """Decay time of a free oscillation, 2 Q / omega."""
    try:
        return float(factory["nominal_q"]) / (math.pi * float(factory["nominal_f0_hz"]))
    except (KeyError, TypeError, ZeroDivisionError) as error:
        raise DataError(f"Factory data must hold nominal_q and nominal_f0_hz, but got {sorted(factory)} ({error!r}).") from error


def _forget_s(factory: Mapping[str, Any]) -> float:
    return _FORGET * _decay_s(factory)
