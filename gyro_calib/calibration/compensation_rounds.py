"""Identify the drive chain, compensate it, identify again, until what is left is noise (document 004, step 6), on any instrument.

Round 1 identifies with the compensation that is in force, and the axes of the damping: with the matrix that is sought the amplitude drive
gives back in every direction what the damping takes there, so that neither the drives' errors nor the uneven damping turn a free wave. (A
wave that is driven round by virtual precession goes by that matrix too, and is uneven by half of the damping's relative anisotropy.) Each
further round puts the matrix of the round before in force and identifies anew; it ends when the residual is no larger than the noise of
the two identifications. Between rounds, and however it ends, the gyro rests in its mission with the compensation that it had before:
nothing is changed until the caller puts :attr:`Compensated.mission` in force.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.special import chdtri

from ..errors import CalibrationRefused
from ..estimation import CalibrationResult, calibrate
from ..estimation.compensation import IdentifiedChain
from ..estimation.drive_chain import DriveChain
from ..experiments import Instrument, Plan, Progress, compensation_in_force, run_plan
from ..recording.command import Command
from ..recording.recording import Campaign

__all__ = ["MOST_ROUNDS", "Compensated", "CompensationRound", "Leg", "compensate"]

#: rounds at most: two are the rule, one when the compensation in force still holds
MOST_ROUNDS = 4
#: chance that noise alone asks for another round
_CHANCE = 1e-3
#: modes whose recordings a round identifies from; ring-down, ring-up and stiffness control are for the last estimate
_ROUND_MODES = ("whole_angle", "ftr_x", "ftr_y", "loops_off")
#: a compensation that leaves more than this share of what there was does not work
_NO_BETTER = 0.5


@dataclass(frozen=True)
class CompensationRound:
    """One identification.

    Parameters
    ----------
    number : int
        From 1.
    compensation : tuple of 4 float
        In force during its recordings, row-major.
    identified : IdentifiedChain
        The chain of the unit itself.
    residual : IdentifiedChain
        What was left of it behind the compensation.
    chi_square : float
        Residual over the noise of this identification and of the one that the compensation came from, 3 degrees of freedom.
    """

    number: int
    compensation: tuple[float, float, float, float]
    identified: IdentifiedChain
    residual: IdentifiedChain
    chi_square: float

    @property
    def settled(self) -> bool:
        """Whether the residual is noise."""
        return self.chi_square <= float(chdtri(3, _CHANCE))

    def __str__(self) -> str:
        left = ", ".join(f"{name} {q.value:.2e} ± {q.sd:.1e} {q.unit}".rstrip(" 1") for name, q in self.residual.quantities().items())
        verdict = "at its noise" if self.settled else f"chi-square {self.chi_square:.3g} of 3"
        return f"round {self.number}: residual {left} ({verdict})"

    def to_plain(self) -> dict[str, Any]:
        """For a record's provenance."""
        return {
            "compensation": list(self.compensation),
            "residual": {name: q.to_json() for name, q in self.residual.quantities().items()},
            "chi_square": self.chi_square,
        }


@dataclass(frozen=True)
class Leg:
    """A plan that is being carried out, and where it stands in the whole: ``done_s`` before it of ``total_s`` of device time."""

    number: int
    plan: Plan
    done_s: float
    total_s: float

    def fraction(self, of_plan: float) -> float:
        """Part of the whole that is done, 0 to 1."""
        return min((self.done_s + of_plan * self.plan.duration_s) / self.total_s, 1.0)


@dataclass(frozen=True)
class Compensated:
    """What came of it.

    Parameters
    ----------
    campaign : Campaign
        Recordings of all rounds; those of the last one are last.
    result : CalibrationResult
        From all of them; its mission is the one with the new compensation.
    rounds : tuple of CompensationRound
    mission : Command
        What to put in force: the mission with the new compensation.
    """

    campaign: Campaign
    result: CalibrationResult
    rounds: tuple[CompensationRound, ...]
    mission: Command


def compensate(
    instrument: Instrument,
    first: Plan,
    verify: Plan,
    *,
    estimate: Callable[[Campaign], CalibrationResult] = lambda campaign: calibrate(campaign, with_convergence=False),
    rounds: int = MOST_ROUNDS,
    on_leg: Callable[[Leg], None] = lambda leg: None,
    on_progress: Callable[[Leg, Progress], None] = lambda leg, progress: None,
    on_round: Callable[[CompensationRound], None] = lambda done: None,
    on_settled: Callable[[Campaign], None] = lambda campaign: None,
    cancelled: Callable[[], bool] | None = None,
) -> Compensated:
    """Iterate the drive compensation of a whole-angle gyro.

    Parameters
    ----------
    instrument : Instrument
        The gyro; its compensation at the start is where the iteration begins, and what it has again in the end.
    first, verify : Plan
        What the first round records, and each further one: virtual precession of both senses at least. Loops-off recordings of the
        first serve all rounds.
    estimate : callable
        Campaign -> result with a ``drive_chain``.
    rounds : int
        At most.
    on_leg, on_progress, on_round, on_settled : callable
        Told of each plan as it begins, of progress in it, of each identification, and when only the last estimate is left.
    cancelled : callable, optional
        As in :func:`.run_plan`.

    Raises
    ------
    CalibrationRefused
        An estimate refuses, gives no drive chain, or the compensation does not work: the residual did not fall.
    ExperimentAborted, DataError
        As :func:`.run_plan`.
    """
    before = in_force = compensation_in_force(instrument)
    source = np.zeros((3, 3))
    campaign = Campaign(instrument.device_id, (), dict(instrument.factory))
    done: list[CompensationRound] = []
    recorded_s, aim = 0.0, None
    for number in range(1, max(rounds, 1) + 1):
        plan = (first if number == 1 else verify).with_compensation(in_force, final=before, suffix="" if number == 1 else f"_r{number}")
        # two rounds are the rule; the whole grows when there are more
        leg = Leg(number, plan, recorded_s, recorded_s + plan.duration_s + (verify.duration_s if number == 1 and rounds > 1 else 0.0))
        on_leg(leg)
        made = run_plan(instrument, plan, on_progress=partial(on_progress, leg), cancelled=cancelled)
        recorded_s += plan.duration_s
        own = _of_round(campaign, made)
        found = estimate(own)
        if number > 1:
            found = _aimed(found, aim)
        campaign = replace(made, recordings=(*campaign.recordings, *made.recordings))
        done.append(_round(number, in_force, found, source))
        on_round(done[-1])
        if done[-1].settled:
            break
        if number < rounds:
            in_force, source = done[-1].identified.compensation(), done[-1].identified.covariance
            # what the matrix was made for is settled with it: what is left over is the drives' alone
            aim = done[-1].identified.aim
    _check(done)
    on_settled(campaign)
    result = found if len(own) == len(campaign) else _aimed(estimate(campaign), aim)
    if not done[-1].settled:
        result = replace(
            result,
            warnings=(*result.warnings, f"the residual of the compensation stays above its noise after {len(done)} rounds: {done[-1]}"),
        )
    return Compensated(campaign, result, tuple(done), replace(first.final, compensation=in_force))


def _aimed(found: CalibrationResult, aim: DriveChain | None) -> CalibrationResult:
    return found if found.drive_chain is None or aim is None else replace(found, drive_chain=found.drive_chain.aimed_at(aim))


def _of_round(before: Campaign, made: Campaign) -> Campaign:
    """What one identification uses: the round's own recordings, and what was recorded with loops off, in this round or the first."""
    recordings = [r for r in before if r.command.mode == "loops_off"] + [r for r in made if r.command.mode in _ROUND_MODES]
    return replace(made, recordings=tuple(recordings))


def _round(number: int, in_force: tuple[float, float, float, float], found: CalibrationResult, source: Any) -> CompensationRound:
    if found.drive_chain is None:
        raise CalibrationRefused(
            f"Estimate must identify a drive chain to be compensated, but method {found.method!r} gives none. Record virtual precession."
        )
    residual = found.drive_chain.behind(in_force)
    return CompensationRound(number, in_force, found.drive_chain, residual, residual.chi_square(source))


def _check(done: list[CompensationRound]) -> None:
    """A matrix that does not take the errors away must not come into force (crossed wires, a driver that applies it elsewhere)."""
    first, last = done[0], done[-1]
    if len(done) > 1 and not last.settled and np.linalg.norm(last.residual.vector) > _NO_BETTER * np.linalg.norm(first.residual.vector):
        raise CalibrationRefused(
            f"Compensation must take the errors of the drive chain away, but left {last}, from {first}. "
            "Check that the driver applies it to (u_x, u_y) before the recorded drives. The previous compensation stays."
        )
