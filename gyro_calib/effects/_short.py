"""Short forms for writing the catalogue."""

from __future__ import annotations

from .effect import MODES, Parameter

__all__ = ["BOTH", "FORCE_REBALANCE", "WHOLE_ANGLE", "pair", "positive", "pump_rates", "signed"]

BOTH = MODES
FORCE_REBALANCE, WHOLE_ANGLE = MODES[:1], MODES[1:]


def signed(name: str, unit: str, typical: float, bound: float, meaning: str) -> Parameter:
    """A parameter of either sign within plus and minus ``bound``."""
    return Parameter(name, unit, -bound, bound, typical, meaning)


def positive(name: str, unit: str, typical: float, bound: float, meaning: str, lower: float = 0.0) -> Parameter:
    """A parameter from ``lower`` to ``bound``."""
    return Parameter(name, unit, lower, bound, typical, meaning)


def pair(names: str, unit: str, typical: float, bound: float, meaning: str) -> tuple[Parameter, Parameter]:
    """Two signed parameters, the names divided by a blank."""
    first, second = names.split()
    return signed(first, unit, typical, bound, f"{meaning}, {first}"), signed(second, unit, typical, bound, f"{meaning}, {second}")


def pump_rates(unit: str, typical: float, bound: float) -> tuple[Parameter, ...]:
    """Pump rates of each axis: growth of what is in phase with the reference, and exchange between the quadratures."""
    meanings = {"c": "growth in phase, decay in quadrature", "s": "exchange between the quadratures"}
    return tuple(signed(f"h_{axis}{q}", unit, typical, bound, f"{of}, {axis}") for axis in "xy" for q, of in meanings.items())
