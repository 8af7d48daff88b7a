"""The catalogue of effects by name, and the validation of their sizes in a device."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from ..errors import DeviceError
from .drive import DRIVE
from .dynamics import DYNAMICS
from .effect import Effect
from .environment import ENVIRONMENT
from .loops import LOOPS
from .pickoff import PICKOFF

__all__ = ["EFFECTS", "INSEPARABLE", "checked_sizes", "effect_named"]

#: every effect by name
EFFECTS: Mapping[str, Effect] = MappingProxyType({e.name: e for e in (*DYNAMICS, *DRIVE, *PICKOFF, *ENVIRONMENT, *LOOPS)})

#: what no recording of a device tells apart: a resonator that ages against a good clock, and a clock that drifts beside a good resonator
INSEPARABLE: Mapping[str, tuple[str, ...]] = MappingProxyType({"frequency_ageing": ("clock_drift",)})


def effect_named(name: str) -> Effect:
    """Effect by name; raises :class:`DeviceError` naming the known ones."""
    if name not in EFFECTS:
        raise DeviceError(f"Effect must be one of {', '.join(EFFECTS)}, but got {name!r}.")
    return EFFECTS[name]


def checked_sizes(sizes: Any) -> dict[str, dict[str, float]]:
    """Sizes of effects by name and parameter, complete: a parameter that may be zero and is left out is zero.

    Parameters
    ----------
    sizes : mapping
        Effect -> parameter -> number, as in the part ``effects`` of a device file. Numbers may be text (``1e6`` in YAML 1.1).

    Raises
    ------
    DeviceError
        Not such a mapping, an unknown effect or parameter, a parameter missing that has no zero, a number out of its bounds.
    """
    if not isinstance(sizes, Mapping):
        raise DeviceError(f"Device part effects must be a mapping of effects, but got {sizes!r}.")
    return {str(name): _checked(effect_named(str(name)), values) for name, values in sizes.items()}


def _checked(effect: Effect, values: Any) -> dict[str, float]:
    if not isinstance(values, Mapping):
        raise DeviceError(f"Effect {effect.name} must be a mapping of its parameters, but got {values!r}.")
    for key in values:
        effect.parameter(str(key))
    missing = [p.name for p in effect.parameters if p.name not in values and not p.may_be_zero]
    if missing:
        raise DeviceError(f"Effect {effect.name} must have {', '.join(missing)}, but got {sorted(map(str, values))}.")
    checked = {}
    for p in effect.parameters:
        number = _number(f"{effect.name}.{p.name}", values.get(p.name, 0.0))
        if not p.lower <= number <= p.upper:
            raise DeviceError(f"Effect {effect.name}.{p.name} must be within {p.lower:g} and {p.upper:g} {p.unit}, but got {number!r}.")
        checked[p.name] = number
    return checked


def _number(name: str, value: Any) -> float:
    try:
        if isinstance(value, bool):
            raise ValueError
        number = float(value)
    except (TypeError, ValueError) as error:
        raise DeviceError(f"Effect {name} must be a number, but got {value!r}.") from error
    if not math.isfinite(number):
        raise DeviceError(f"Effect {name} must be finite, but got {value!r}.")
    return number
