"""Run a study over seeds, in parallel processes, and keep what is needed to run it again."""

from __future__ import annotations

import importlib.metadata
import multiprocessing
import platform
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from ..errors import DataError
from ..quantity import Quantity
from .gates import Gate
from .registry import Study

__all__ = ["StudyResult", "run_study"]

#: what may change a number; a package that is absent is reported as such
_PACKAGES = ("numpy", "scipy", "numba")


@dataclass(frozen=True)
class StudyResult:
    """Outcome of a study.

    Parameters
    ----------
    study : Study
        What was run.
    seeds : tuple of int
        Seeds that succeeded, in the order of every array in ``figures``.
    figures : mapping of str to ndarray, shape (n,)
        Figures by name.
    gates : tuple of Gate
        The summary; the last gate counts the seeds that failed.
    failures : mapping of int to str
        Seeds that failed and why.
    elapsed_s : float
        Wall time.
    created_utc : str
        ISO 8601.
    """

    study: Study
    seeds: tuple[int, ...]
    figures: Mapping[str, NDArray[np.float64]]
    gates: tuple[Gate, ...]
    failures: Mapping[int, str]
    elapsed_s: float
    created_utc: str

    @property
    def passed(self) -> bool:
        """Whether every gate holds."""
        return all(gate.passed for gate in self.gates)

    def to_json(self) -> dict[str, Any]:
        """Everything, with versions; figures that are not finite become None."""
        return {
            "study": self.study.name,
            "description": self.study.description,
            "passed": self.passed,
            "gates": [gate.to_json() for gate in self.gates],
            "seeds": list(self.seeds),
            "figures": {name: [x if np.isfinite(x) else None for x in values.tolist()] for name, values in self.figures.items()},
            "failures": {str(seed): reason for seed, reason in self.failures.items()},
            "elapsed_s": round(self.elapsed_s, 3),
            "created_utc": self.created_utc,
            "versions": _versions(),
        }


def run_study(study: Study, seeds: Iterable[int], *, jobs: int = 1, on_done: Callable[[int, int], None] | None = None) -> StudyResult:
    """Run every seed and summarise.

    Parameters
    ----------
    study : Study
        What to run.
    seeds : iterable of int
        Seeds; the result does not depend on ``jobs`` or on the order in which they finish.
    jobs : int
        Processes; 1 runs in this one.
    on_done : callable or None
        Called with (seeds done, seeds in all) after each.

    Raises
    ------
    DataError
        No seed, fewer than one job, seeds that return different names, or not one seed that succeeded.
    """
    wanted = list(dict.fromkeys(seeds))
    if not wanted:
        raise DataError("Argument seeds must name one or more seeds, but got none.")
    if jobs < 1:
        raise DataError(f"Argument jobs must be >= 1, but got {jobs!r}.")
    began = time.monotonic()
    outcomes: dict[int, dict[str, float] | str] = {}
    for seed, outcome in _outcomes(study, wanted, jobs):
        outcomes[seed] = outcome
        if on_done is not None:
            on_done(len(outcomes), len(wanted))
    values: dict[int, dict[str, float]] = {}
    failures: dict[int, str] = {}
    for seed in wanted:
        outcome = outcomes[seed]
        if isinstance(outcome, str):
            failures[seed] = outcome
        else:
            values[seed] = outcome
    if not values:
        raise DataError(f"Study {study.name} must succeed for some seed, but got none of {len(wanted)}: {next(iter(failures.values()))}")
    figures = _stacked(study, values)
    failed = Gate("seeds that failed", Quantity(float(len(failures)), 0.0, "1"), upper=0.0)
    return StudyResult(
        study=study,
        seeds=tuple(values),
        figures=figures,
        gates=(*study.summarise(figures), failed),
        failures=failures,
        elapsed_s=time.monotonic() - began,
        created_utc=datetime.now(timezone.utc).isoformat(timespec="seconds"),
    )


def _trial(run: Callable[[int], Mapping[str, float]], seed: int) -> dict[str, float] | str:
    """One seed; an error of the trial is a result, not the end of the study."""
    try:
        return {name: float(value) for name, value in run(seed).items()}
    except Exception as error:
        return f"{type(error).__name__}: {error}"


def _outcomes(study: Study, seeds: Sequence[int], jobs: int) -> Iterator[tuple[int, dict[str, float] | str]]:
    """Outcomes as they come."""
    if jobs == 1:
        for seed in seeds:
            yield seed, _trial(study.run, seed)
        return
    # spawned, not forked: numerical libraries have threads that a fork would break
    with ProcessPoolExecutor(min(jobs, len(seeds)), mp_context=multiprocessing.get_context("spawn")) as pool:
        waiting: dict[Future[Any], int] = {pool.submit(_trial, study.run, seed): seed for seed in seeds}
        try:
            while waiting:
                done, _ = wait(waiting, return_when=FIRST_COMPLETED)
                for future in done:
                    yield waiting.pop(future), future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _stacked(study: Study, values: Mapping[int, Mapping[str, float]]) -> dict[str, NDArray[np.float64]]:
    """Arrays over seeds by name."""
    names = list(next(iter(values.values())))
    for seed, row in values.items():
        if set(row) != set(names):
            raise DataError(f"Study {study.name} must return {', '.join(names)} for every seed, but got {', '.join(row)} for seed {seed}.")
    return {name: np.array([row[name] for row in values.values()]) for name in names}


def _versions() -> dict[str, str]:
    """Of this package, Python and what computes."""
    found = {"gyro_calib": __version__, "python": platform.python_version(), "machine": platform.machine()}
    for name in _PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "absent"
    return found
