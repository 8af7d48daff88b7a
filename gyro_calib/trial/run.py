"""All trials, in parallel processes: seals first, verdicts, labels opened last."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from .. import __version__
from ..errors import DataError
from .labels import LADDER, STRATA, Trial, draw_trials
from .scores import TrialGate, baseline_rows, by_severity, confusion, gates, reliability
from .trial import TRIALS_PER_UNIT, Outcome, prepare, run_trial

__all__ = ["BlindTrials", "TrialLog", "run_blind_trials"]

#: how sizes are given, told with the figures
SIZING = (
    "The size of an effect is set by its effective signal-to-noise ratio: the norm of its whitened columns with the nuisances projected "
    "out, on a clean campaign of the same unit that is not diagnosed; ratio^2 is the chi-square that it takes away on average."
)


@dataclass(frozen=True)
class BlindTrials:
    """Outcomes with the figures.

    Parameters
    ----------
    outcomes : tuple of Outcome
    gates : tuple of TrialGate
    seed : int
    quality : str
    elapsed_s : float
    created_utc : str
    broken : mapping of int to str
        Trials that could not be recorded, and why.
    ladder : tuple of float
        Effective signal-to-noise ratios of single effects.
    """

    outcomes: tuple[Outcome, ...]
    gates: tuple[TrialGate, ...]
    seed: int
    quality: str
    elapsed_s: float
    created_utc: str
    broken: dict[int, str]
    ladder: tuple[float, ...] = LADDER

    @property
    def passed(self) -> bool:
        """Whether every gate that trials were made for holds."""
        return not self.broken and all(gate.passed is not False for gate in self.gates)

    def to_json(self) -> dict[str, Any]:
        """Everything."""
        return {
            "schema": 1,
            "version": __version__,
            "seed": self.seed,
            "quality": self.quality,
            "created_utc": self.created_utc,
            "elapsed_s": round(self.elapsed_s, 1),
            "sizing": SIZING,
            "strata": STRATA,
            "ladder": list(self.ladder),
            "passed": self.passed,
            "gates": [gate.to_json() for gate in self.gates],
            "by_severity": by_severity(self.outcomes, self.ladder),
            "confusion": confusion(self.outcomes),
            "reliability": reliability(self.outcomes),
            "baselines": baseline_rows(self.outcomes),
            "trials": [o.to_json() for o in self.outcomes],
            "broken": {str(k): v for k, v in self.broken.items()},
        }


class TrialLog:
    """The seals as they are made, the labels when all verdicts are in: one line each.

    Parameters
    ----------
    path : Path or None
        Text file; None: kept in memory only.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self._seals: dict[int, str] = {}
        if path is not None:
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text("", encoding="utf-8")
            except OSError as error:
                raise DataError(f"Log of the trials must be writable, but got {error}. Choose another path.") from error

    def seal(self, number: int, sha256: str) -> None:
        """Written before the campaign is diagnosed.

        Raises
        ------
        DataError
            The trial has a seal already.
        """
        if number in self._seals:
            raise DataError(f"Trial {number} must be sealed once, but has a seal already. The trial is void.")
        self._seals[number] = sha256
        self._line(f"sealed {number} {sha256}")

    def open(self, outcome: Outcome) -> None:
        """Check a label against the seal in the log; raises :class:`DataError` when it is another."""
        number = outcome.label.number
        if self._seals.get(number) != outcome.seal.sha256:
            raise DataError(f"Trial {number} must open the seal in the log, {self._seals.get(number)}, but got {outcome.seal.sha256}.")
        outcome.seal.check(outcome.label, outcome.nonce)
        self._line(f"opened {number} {outcome.nonce} {list(outcome.label.effects) or 'clean'} -> {outcome.verdict.verdict}")

    def _line(self, text: str) -> None:
        if self._path is not None:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(text + "\n")


def run_blind_trials(
    count: int,
    seed: int,
    *,
    strata: Sequence[str] = (),
    ladder: Sequence[float] = LADDER,
    jobs: int = 1,
    quality: str = "standard",
    baselines: bool = True,
    log: TrialLog | None = None,
    on_done: Callable[[int, int], None] | None = None,
) -> BlindTrials:
    """Draw, record, seal, diagnose, open, score.

    Parameters
    ----------
    count, seed : int
        The figures do not depend on ``jobs``.
    strata : sequence of str
        Only these (default: all).
    ladder : sequence of float
        Effective signal-to-noise ratios of single effects, in turn.
    jobs : int
        Processes; each holds one campaign at a time and the clean models of two units.
    quality : {"quick", "standard", "fine"}
        Of the campaigns.
    baselines : bool
        Run the four baselines too.
    log : TrialLog, optional
    on_done : callable, optional
        Called with (trials done, trials in all).

    Raises
    ------
    DataError
        An unknown stratum, a ladder without a ratio from 8 on, fewer than one job or trial, a label that is not the sealed one.
    """
    if jobs < 1 or count < 1:
        raise DataError(f"Arguments count and jobs must be >= 1, but got {count!r}, {jobs!r}.")
    log = log or TrialLog()
    began = time.monotonic()
    trials = draw_trials(count, seed, strata, ladder)
    outcomes: dict[int, Outcome] = {}
    broken: dict[int, str] = {}
    for done, (number, outcome) in enumerate(_outcomes(trials, seed, jobs, quality, baselines, log), 1):
        if isinstance(outcome, str):
            broken[number] = outcome
        else:
            outcomes[number] = outcome
        if on_done is not None:
            on_done(done, count)
    ordered = tuple(outcomes[k] for k in sorted(outcomes))
    for outcome in ordered:
        log.open(outcome)
    return BlindTrials(
        outcomes=ordered,
        gates=tuple(gates(ordered)),
        seed=seed,
        quality=quality,
        elapsed_s=time.monotonic() - began,
        created_utc=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        broken=broken,
        ladder=tuple(ladder),
    )


def _units(trials: Sequence[Trial]) -> list[list[Trial]]:
    """Trials of one unit together: a process that has its clean model keeps it."""
    groups: dict[tuple[str, int], list[Trial]] = {}
    for trial in trials:
        groups.setdefault((trial.kind, trial.number // 2 // TRIALS_PER_UNIT), []).append(trial)
    return list(groups.values())


def _outcomes(
    trials: Sequence[Trial], seed: int, jobs: int, quality: str, baselines: bool, log: TrialLog
) -> Iterator[tuple[int, Outcome | str]]:
    groups = _units(trials)
    if jobs == 1:
        for group in groups:
            for trial in group:
                yield _one(trial, seed, quality, baselines, log.seal)
        return
    context = multiprocessing.get_context("spawn")
    with context.Manager() as manager, ProcessPoolExecutor(min(jobs, len(groups)), mp_context=context) as pool:
        queue = manager.Queue()
        pending = list(groups)
        waiting: set[Future[Any]] = set()
        while pending or waiting:
            while pending and len(waiting) < jobs:
                waiting.add(pool.submit(_group, pending.pop(0), seed, quality, baselines, queue))
            done, waiting = wait(waiting, timeout=0.5, return_when=FIRST_COMPLETED)
            for future in done:
                future.result()
            while not queue.empty():
                kind, number, what = queue.get()
                if kind == "seal":
                    log.seal(number, what)
                else:
                    yield number, what


def _group(group: Sequence[Trial], seed: int, quality: str, baselines: bool, queue: Any) -> None:
    """The trials of a unit, in a process of its own; seals and outcomes go through the queue in their order."""
    for trial in group:
        number, outcome = _one(trial, seed, quality, baselines, lambda n, sha256: queue.put(("seal", n, sha256)))
        queue.put(("outcome", number, outcome))


def _one(trial: Trial, seed: int, quality: str, baselines: bool, seal: Callable[[int, str], None]) -> tuple[int, Outcome | str]:
    try:
        prepared = prepare(trial, seed, quality)
    except Exception as error:
        return trial.number, f"{type(error).__name__}: {error}"
    seal(trial.number, prepared.seal.sha256)
    return trial.number, run_trial(prepared, baselines=baselines)
