"""Units of a fleet: each diagnosed by itself, those that are healthy told from those that are not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..errors import DataError
from ..recording.recording import Campaign
from .diagnose import diagnose
from .fleet import FEWEST_UNITS, Coefficients
from .patch import ONE_KIND

__all__ = ["Unit", "fleet_of", "unit_of"]


@dataclass(frozen=True)
class Unit:
    """What a campaign says of one unit.

    Parameters
    ----------
    device_id : str
    nominal_f0_hz : float
    verdict : str
        Of its diagnosis.
    effects : tuple of str
        Those found that are not harmless.
    coefficients : Coefficients
    """

    device_id: str
    nominal_f0_hz: float
    verdict: str
    effects: tuple[str, ...]
    coefficients: Coefficients

    @property
    def is_healthy(self) -> bool:
        """Whether nothing was found, or nothing that does a rate any harm."""
        return self.verdict in ("none", "effects") and not self.effects


def unit_of(campaign: Campaign) -> Unit:
    """Diagnose a unit as any device.

    Raises
    ------
    DataError
        As of :func:`.diagnose.diagnose`.
    """
    found = diagnose(campaign)
    assert found.estimate is not None
    assert found.estimate.coefficients is not None
    harm = tuple(e.name for e in found.effects if not e.harmless)
    return Unit(campaign.device_id, float(campaign.factory["nominal_f0_hz"]), found.verdict, harm, found.estimate.coefficients)


def fleet_of(units: Sequence[Unit]) -> tuple[list[Unit], list[str]]:
    """The healthy ones, and a line on each of the others.

    Raises
    ------
    DataError
        Units of two kinds, one that is there twice, fewer than three that are healthy.
    """
    first = units[0]
    for k, unit in enumerate(units):
        if abs(unit.nominal_f0_hz - first.nominal_f0_hz) > ONE_KIND * first.nominal_f0_hz:
            said = f"{first.device_id} of {first.nominal_f0_hz:g} Hz and {unit.device_id} of {unit.nominal_f0_hz:g} Hz"
            raise DataError(f"Units of a fleet must be of one kind, but got {said}. Make a fleet of each kind.")
        if any(unit.device_id == other.device_id for other in units[:k]):
            raise DataError(f"Units of a fleet must differ, but got {unit.device_id} twice. Give its recordings as one folder.")
    warnings = [f"{u.device_id} is left out: its verdict is {_verdict(u)}." for u in units if not u.is_healthy]
    healthy = [unit for unit in units if unit.is_healthy]
    if len(healthy) < FEWEST_UNITS:
        left = f", and not {', '.join(u.device_id for u in units if not u.is_healthy)}" if warnings else ""
        raise DataError(f"A fleet must have {FEWEST_UNITS} healthy units or more, but got {len(healthy)}{left}. Record more of them.")
    return healthy, warnings


def _verdict(unit: Unit) -> str:
    return f"{unit.verdict} ({', '.join(unit.effects)})" if unit.effects else unit.verdict
