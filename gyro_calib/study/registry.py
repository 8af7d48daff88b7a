"""What a study is, and which there are."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from .gates import Gate

__all__ = ["Study", "find_study", "list_studies"]

#: figures by name, one entry per seed that succeeded, shape (n,)
Figures = Mapping[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Study:
    """A claim and how to try it.

    Parameters
    ----------
    name : str
        Short name with hyphens.
    description : str
        The claim in one sentence.
    run : callable
        ``run(seed) -> {name: float}``: one trial; a function of a module, so that another process finds it. The same names for every seed.
    summarise : callable
        ``summarise(figures) -> gates``; ``figures`` maps each name to an array over the seeds that succeeded.
    default_seeds : int
        Number of trials when nobody says otherwise; seeds are 0, 1, ….
    plot : callable or None
        ``plot(figures, theme) -> Drawing`` of :mod:`gyro_calib.report.figures`; None draws the distribution of every figure.
    """

    name: str
    description: str
    run: Callable[[int], Mapping[str, float]]
    summarise: Callable[[Figures], Sequence[Gate]]
    default_seeds: int = 20
    plot: Callable[[Figures, Any], Any] | None = None


def list_studies() -> list[Study]:
    """Every study of :mod:`gyro_calib.study.studies`, by name."""
    from . import studies

    found = [
        importlib.import_module(f"{studies.__name__}.{module.name}").STUDY
        for module in pkgutil.iter_modules(studies.__path__)
        if not module.name.startswith("_")
    ]
    return sorted(found, key=lambda study: study.name)


def find_study(name: str) -> Study:
    """The study of that name.

    Raises
    ------
    DataError
        There is none; the text names those there are.
    """
    known = {study.name: study for study in list_studies()}
    if name not in known:
        raise DataError(f"Study must be one of {', '.join(known) or '(there are none yet)'}, but got {name!r}.")
    return known[name]
