"""Units of a fleet: each diagnosed by itself, those that are healthy told from those that are not."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

from ..errors import DataError
from ..recording.load import load_campaign
from ..recording.recording import Campaign
from .diagnose import diagnose
from .fleet import FEWEST_UNITS, Coefficients
from .patch import ONE_KIND

__all__ = ["Unit", "fleet_of", "unit_of", "units_of_files"]


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


def units_of_files(paths: Sequence[Path], *, topic: str | None = None, jobs: int = 1, on_done: Callable[[str], None]) -> list[Unit]:
    """Diagnose a unit of each file, in the order of the files.

    Parameters
    ----------
    paths : sequence of Path
    topic : str, optional
        Of the channels, for bags of several gyros.
    jobs : int
        Processes, each of up to a gigabyte.
    on_done : callable
        Called with the identity of each unit that is done.

    Raises
    ------
    DataError
        As of :func:`.diagnose.diagnose` and of :func:`.load_campaign`.
    """
    if jobs == 1 or len(paths) < 2:
        units = []
        for path in paths:
            units.append(_unit_of_file(path, topic))
            on_done(units[-1].device_id)
        return units
    # spawned, not forked: numerical libraries have threads that a fork would break
    with ProcessPoolExecutor(min(jobs, len(paths)), mp_context=multiprocessing.get_context("spawn")) as pool:
        waiting = [pool.submit(_unit_of_file, path, topic) for path in paths]
        try:
            for future in as_completed(waiting):
                on_done(future.result().device_id)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [future.result() for future in waiting]


def _unit_of_file(path: Path, topic: str | None) -> Unit:
    return unit_of(load_campaign(path, topic=topic))


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
