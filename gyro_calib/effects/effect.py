"""What an effect is: where it acts, its parameters with their bounds and usual size, and what recordings must hold to show it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..errors import DeviceError

__all__ = ["LOCATIONS", "MODES", "NEEDS", "Effect", "Parameter"]

#: where an effect acts
LOCATIONS = ("dynamics", "drive", "pick-off", "electronics", "environment")
#: what recordings must vary, or hold, for an effect to show apart from the constants of a linear device
NEEDS = ("amplitudes", "temperature", "rate", "rates", "time", "large drive", "open drive", "side bands", "azimuth")
#: campaigns in which an effect shows
MODES = ("force-rebalance", "whole-angle")


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Parameters
    ----------
    name : str
        Key in a device file.
    unit : str
        Unit, in pick-off volts of x, drive volts as recorded, kelvin, seconds, radians.
    lower, upper : float
        Bounds; a device outside them is refused.
    typical : float
        A size that a real device may show at moderate strength, > 0; the sign is either where the bounds allow both.
    meaning : str
        One line for people.
    """

    name: str
    unit: str
    lower: float
    upper: float
    typical: float
    meaning: str

    def __post_init__(self) -> None:
        if not (math.isfinite(self.lower) and math.isfinite(self.upper) and self.lower < self.upper):
            raise DeviceError(f"Parameter {self.name} must have finite bounds in order, but got {self.lower!r}, {self.upper!r}.")
        if not 0.0 < self.typical <= self.upper:
            raise DeviceError(f"Parameter {self.name} must have a typical size within 0 and {self.upper!r}, but got {self.typical!r}.")

    @property
    def may_be_zero(self) -> bool:
        """Whether leaving it out is the same as zero."""
        return self.lower <= 0.0 <= self.upper

    @property
    def signed(self) -> bool:
        """Whether both signs are possible."""
        return self.lower < 0.0


@dataclass(frozen=True)
class Effect:
    """One effect that the linear model of a gyro leaves out.

    Parameters
    ----------
    name : str
        Key in a device file and in every report.
    title : str
        For people.
    location : str
        One of :data:`LOCATIONS`.
    row : tuple of int or None
        Rows of the catalogue of effects it belongs to; None: not in it.
    parameters : tuple of Parameter
        Its numbers, in the order in which a fit takes them.
    needs : tuple of str
        Of :data:`NEEDS`.
    modes : tuple of str
        Of :data:`MODES`.
    meaning : str
        What it adds to the envelopes, first order of averaging: to ``p' = (A - i dw) p + G u``, to the pick-offs (``V +=``), to the
        drives (``u +=``, which then acts through G).
    nearest : tuple of str
        Effects that it is most easily taken for.
    """

    name: str
    title: str
    location: str
    row: tuple[int, ...] | None
    parameters: tuple[Parameter, ...]
    needs: tuple[str, ...]
    modes: tuple[str, ...]
    meaning: str
    nearest: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.location not in LOCATIONS:
            raise DeviceError(f"Effect {self.name} location must be one of {', '.join(LOCATIONS)}, but got {self.location!r}.")
        strange = sorted(set(self.needs) - set(NEEDS)) + sorted(set(self.modes) - set(MODES))
        if strange or not self.modes or not self.parameters:
            raise DeviceError(f"Effect {self.name} must have parameters, known needs and known modes, but got {strange}.")

    def parameter(self, name: str) -> Parameter:
        """Parameter by name; raises :class:`DeviceError` naming the known ones."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        known = ", ".join(p.name for p in self.parameters)
        raise DeviceError(f"Effect {self.name} parameter must be one of {known}, but got {name!r}.")

    @property
    def typical(self) -> dict[str, float]:
        """Every parameter at its typical size, positive."""
        return {p.name: p.typical for p in self.parameters}
