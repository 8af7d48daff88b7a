"""Plans for the bench: on a rate table (document 000, factory), and at large amplitude with converter samples (Trusov-Shkel)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from ..errors import DataError
from ..recording.applied_rate import words_of_steps
from ..recording.command import Command, Setpoints
from .plan import Limits, Plan, Step
from .plans import QUALITIES, self_calibration_plan

__all__ = ["BENCH_PLANS", "ORIENTATIONS", "factory_plan", "pickoff_phase_plan"]

#: which axis of the case lies along the table's, by name
ORIENTATIONS: dict[str, tuple[float, float, float]] = {"z": (0.0, 0.0, 1.0), "x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0)}
#: seconds at each rate of a table run
_DWELL_S = {"quick": 2.0, "standard": 5.0, "fine": 10.0}
#: converter samples kept of each amplitude [s]
_RAW_S = {"quick": 0.25, "standard": 0.5, "fine": 1.0}
#: amplitudes of the Trusov-Shkel steps over the mission's; three separate the gap from a fixed share of harmonics
LARGE_AMPLITUDES = (1.0, 1.5, 2.0)
_SETTLE_S = 3.0


def factory_plan(
    factory: Mapping[str, Any],
    *,
    quality: str = "standard",
    limits: Limits | None = None,
    orientations: tuple[str, ...] = ("z",),
    rate_rad_s: float = math.radians(50.0),
) -> Plan:
    """A self-calibration at rest, then steps of 0, +, 0, -, 0 of the table with each axis as the oscillator, in each orientation.

    Parameters
    ----------
    factory : mapping
        Factory data of the unit (nominal amplitude, full scales).
    quality : {"quick", "standard", "fine"}
    limits : Limits, optional
        Abort conditions.
    orientations : tuple of {"z", "x", "y"}
        Axis of the case along the table's; all three show the mounting's misalignment. Between them the gyro is mounted anew.
    rate_rad_s : float
        Rate of the table [rad/s].

    Raises
    ------
    DataError
        Unknown quality or orientation, or a rate that is not positive.
    """
    strangers = [o for o in orientations if o not in ORIENTATIONS]
    if strangers or not orientations or quality not in _DWELL_S or not rate_rad_s > 0.0:
        raise DataError(
            f"Factory plan must have orientations among {', '.join(ORIENTATIONS)}, a quality among {', '.join(_DWELL_S)} and a rate > 0, "
            f"but got {orientations!r}, {quality!r}, {rate_rad_s!r}."
        )
    at_rest = self_calibration_plan(factory, quality=quality, limits=limits)
    dwell = _DWELL_S[quality]
    setpoints = Setpoints(float(factory.get("nominal_amplitude_v", 1.0)))
    steps = list(at_rest.steps)
    for name in orientations:
        words = words_of_steps([k * dwell for k in range(5)], [0.0, rate_rad_s, 0.0, -rate_rad_s, 0.0], ORIENTATIONS[name])
        for axis in "xy":
            label = f"table_{axis}" if name == "z" else f"table_{axis}_about_{name}"
            steps.append(Step(label, Command(f"ftr_{axis}", setpoints=setpoints), 5.0 * dwell, _SETTLE_S, applied_rate=words))
    return Plan("factory", tuple(steps), at_rest.limits, at_rest.final)


def pickoff_phase_plan(factory: Mapping[str, Any], *, quality: str = "standard", limits: Limits | None = None) -> Plan:
    """Large amplitudes on each oscillator axis with converter samples, for the lines at 2 and 3 times the carrier.

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
        Unknown quality.
    """
    if quality not in QUALITIES:
        raise DataError(f"Plan quality must be one of {', '.join(QUALITIES)}, but got {quality!r}.")
    amplitude = float(factory.get("nominal_amplitude_v", 1.0))
    full_scale = float(factory.get("adc_full_scale_V", math.inf))
    raw_s = _RAW_S[quality]
    steps = []
    for axis in "xy":
        for share in LARGE_AMPLITUDES:
            volts = min(share * amplitude, 0.9 * full_scale)
            command = Command(f"ftr_{axis}", setpoints=Setpoints(volts))
            steps.append(Step(f"large_{axis}_{share:g}", command, 2.0 * raw_s, _SETTLE_S, raw_s=raw_s))
    return Plan("pickoff_phase", tuple(steps), limits or Limits(), Command("ftr_x", setpoints=Setpoints(amplitude)))


#: plans that ask abilities of the instrument which a gyro in the field has not
BENCH_PLANS: dict[str, Callable[..., Plan]] = {"factory": factory_plan, "pickoff_phase": pickoff_phase_plan}
