"""Runs of one device beside each other: what moved between them, against the standard deviations that they claim."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ..errors import DataError
from ..quantity import Quantity
from .record import CalibrationRecord

__all__ = ["RunChange", "RunChanges", "changes_between"]

#: a change beyond this many of its standard deviations is more than noise
SIGNIFICANT = 3.0
#: temperatures further apart than this explain a change by themselves [K]
_SAME_TEMPERATURE_K = 1.0


@dataclass(frozen=True)
class RunChange:
    """One figure over the runs.

    Parameters
    ----------
    name : str
        Name of the record's field or parameter.
    values : tuple of Quantity
        One per run, oldest first, each with the sd that its run claims.
    """

    name: str
    values: tuple[Quantity, ...]

    @property
    def change(self) -> Quantity:
        """Last minus first; sd of the two together, as if they had no error in common."""
        first, last = self.values[0], self.values[-1]
        return Quantity(last.value - first.value, math.hypot(first.sd, last.sd), first.unit)

    @property
    def pull(self) -> float:
        """The change over its sd; NaN where no sd is known."""
        change = self.change
        return change.value / change.sd if 0.0 < change.sd < math.inf else math.nan

    def to_json(self) -> dict[str, Any]:
        """``{"values", "change"}`` with quantities."""
        return {"values": [value.to_json() for value in self.values], "change": self.change.to_json()}


@dataclass(frozen=True)
class RunChanges:
    """All figures that the runs have in common.

    Parameters
    ----------
    records : tuple of CalibrationRecord
        Of one device, oldest first.
    figures : tuple of RunChange
        Bias, scale factor, input rate, rate noise, then those of each oscillator axis.
    parameters : tuple of RunChange
        Fitted parameters.
    cautions : tuple of str
        Why the runs are not alike: mode, drive compensation, temperature.
    """

    records: tuple[CalibrationRecord, ...]
    figures: tuple[RunChange, ...]
    parameters: tuple[RunChange, ...]
    cautions: tuple[str, ...]

    @property
    def device_id(self) -> str:
        """The device of all runs."""
        return self.records[0].device_id

    def figure(self, name: str) -> RunChange:
        """One of ``figures`` by name."""
        return next(figure for figure in self.figures if figure.name == name)

    @property
    def moved(self) -> tuple[RunChange, ...]:
        """Of bias and scale factor, what changed by more than three of its standard deviations."""
        return tuple(f for f in (self.figure("bias"), self.figure("scale_factor")) if abs(f.pull) > SIGNIFICANT)

    def to_json(self) -> dict[str, Any]:
        """Records by id and time, and every figure in SI units."""
        return {
            "device_id": self.device_id,
            "records": [{"record_id": r.record_id, "created_utc": r.created_utc} for r in self.records],
            "figures": {figure.name: figure.to_json() for figure in self.figures},
            "parameters": {figure.name: figure.to_json() for figure in self.parameters},
            "moved": [figure.name for figure in self.moved],
            "cautions": list(self.cautions),
        }


def changes_between(records: Sequence[CalibrationRecord]) -> RunChanges:
    """Put runs of one device beside each other.

    Parameters
    ----------
    records : sequence of CalibrationRecord
        Two or more, in any order.

    Returns
    -------
    RunChanges
        Oldest first; figures and parameters that all of them have.

    Raises
    ------
    DataError
        Fewer than two different records, or records of several devices.
    """
    runs = tuple(sorted({r.record_id: r for r in records}.values(), key=lambda r: r.created))
    if len(runs) < 2:
        raise DataError(f"Comparison must have two different records at least, but got {len(runs)}. Calibrate again, or name another file.")
    if len(devices := {r.device_id for r in runs}) > 1:
        raise DataError(f"Records must be of one device, but got {', '.join(sorted(devices))}. A calibration says nothing of another unit.")
    figures = [RunChange(n, tuple(getattr(r, n) for r in runs)) for n in ("bias", "scale_factor", "rate", "rate_noise_density")]
    for field in ("bias_by_axis", "scale_factor_by_axis"):
        figures += _common(field.removesuffix("_by_axis") + "_", [getattr(r, field) for r in runs])
    return RunChanges(runs, tuple(figures), tuple(_common("", [r.parameters for r in runs])), tuple(_cautions(runs)))


def _common(prefix: str, found: Sequence[Any]) -> list[RunChange]:
    names = [name for name in found[0] if all(name in other and other[name].unit == found[0][name].unit for other in found)]
    return [RunChange(prefix + name, tuple(other[name] for other in found)) for name in names]


def _cautions(runs: Sequence[CalibrationRecord]) -> list[str]:
    cautions = []
    if len(modes := {r.mode for r in runs}) > 1:
        cautions.append(f"The runs correct different modes ({', '.join(sorted(modes))}): bias and scale factor are not the same figures.")
    if len({r.compensation for r in runs}) > 1:
        cautions.append("The drive compensation differs between the runs: bias and scale factor moved with it.")
    if len(methods := {r.method for r in runs}) > 1:
        cautions.append(f"The runs used different methods ({', '.join(sorted(methods))}).")
    temperatures = [r.temperature_degc.value for r in runs if math.isfinite(r.temperature_degc.value)]
    if temperatures and max(temperatures) - min(temperatures) > _SAME_TEMPERATURE_K:
        spread = f"{min(temperatures):.1f} to {max(temperatures):.1f} degC"
        cautions.append(f"The runs were made at {spread}: a change of bias or scale factor may be the temperature's.")
    return cautions
