"""A number that carries its standard deviation and its unit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

__all__ = ["Quantity"]


@dataclass(frozen=True)
class Quantity:
    """Estimated value with standard deviation and unit.

    Parameters
    ----------
    value : float
        Best estimate.
    sd : float
        Standard deviation, same unit, ``>= 0``; ``inf`` says "not observable".
    unit : str
        SI unit text (``"rad/s"``, ``"V/(rad/s)"``, ``"1"``), or a display unit where a person reads it.

    Raises
    ------
    ValueError
        ``sd`` negative or NaN.
    """

    value: float
    sd: float
    unit: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", float(self.value))
        object.__setattr__(self, "sd", float(self.sd))
        if math.isnan(self.sd) or self.sd < 0.0:
            raise ValueError(f"Argument sd must be >= 0, but got {self.sd!r}.")

    def scaled(self, factor: float, unit: str) -> Quantity:
        """Return the same quantity in another unit: value and sd times ``factor``."""
        return Quantity(self.value * factor, self.sd * abs(factor), unit)

    def interval(self, sigmas: float = 1.959964) -> tuple[float, float]:
        """Symmetric interval ``value -/+ sigmas * sd`` (default: 95 % of a normal distribution)."""
        return self.value - sigmas * self.sd, self.value + sigmas * self.sd

    def to_json(self) -> dict[str, Any]:
        """``{"value", "sd", "unit"}``; a non-finite number becomes ``None`` so that the text stays standard JSON."""
        return {"value": _finite(self.value), "sd": _finite(self.sd), "unit": self.unit}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Quantity:
        """Inverse of :meth:`to_json`; a missing ``sd`` reads as ``inf``."""
        value, sd = data["value"], data.get("sd")
        return cls(math.nan if value is None else float(value), math.inf if sd is None else float(sd), str(data["unit"]))

    def __format__(self, spec: str) -> str:
        return f"{self.value:{spec or '.6g'}} ± {self.sd:{spec or '.2g'}} {self.unit}"


def _finite(number: float) -> float | None:
    return float(number) if math.isfinite(number) else None
