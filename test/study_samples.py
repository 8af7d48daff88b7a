"""Studies for tests: in a module of their own, so that another process finds their functions."""

from __future__ import annotations

import os

import numpy as np

from gyro_calib.errors import DataError
from gyro_calib.study import Gate, Study, coverage, rms


def noise(seed: int) -> dict[str, float]:
    """Error of a perfect estimator with unit sd."""
    return {"error [deg/h]": float(np.random.default_rng(seed).standard_normal()), "pid": float(os.getpid())}


def fails_on_three(seed: int) -> dict[str, float]:
    """As :func:`noise`, but seed 3 fails."""
    if seed == 3:
        raise DataError("Seed must not be 3, but got 3.")
    return noise(seed)


def changes_names(seed: int) -> dict[str, float]:
    """Returns other names for other seeds."""
    return {f"name {seed}": 1.0}


def summarise(figures):
    """Gates on rms and coverage."""
    errors = figures["error [deg/h]"]
    return [
        Gate("rms error", rms(errors, "deg/h"), upper=1.5),
        Gate("coverage", coverage(errors, np.ones_like(errors)), lower=80.0, upper=100.0),
    ]


NOISE = Study("noise", "A unit normal.", noise, summarise, default_seeds=8)
FAILING = Study("failing", "One seed fails.", fails_on_three, summarise)
INCONSISTENT = Study("inconsistent", "Names differ.", changes_names, summarise)
