"""Systematic error of the side-band estimate on noise-free carrier-level data: averaging, zero-order hold, filters, feedthrough, phases."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...estimation.separation import Priors
from ...estimation.sideband import SidebandProblem
from ...estimation.slow_flow_data import usable_recordings
from ...quantity import Quantity
from ...units import DEG_H
from ..gates import Gate, rms
from ..registry import Figures, Study
from ._units import run_unit


def run(seed: int) -> dict[str, float]:
    """One noise-free unit, weighted as its noisy twin is: errors of rate, bias [deg/h] and scale factor [ppm]."""
    trial, twin = (run_unit(seed, noisy=noisy, exact_drive_ratio=True) for noisy in (False, True))
    kappa, priors = trial.device.resonator.angular_gain, Priors(drive_ratio=1e-7)
    weights = SidebandProblem(usable_recordings(twin.campaign)[0], twin.campaign.factory, kappa, priors).fit.noise
    problem = SidebandProblem(usable_recordings(trial.campaign)[0], trial.campaign.factory, kappa, priors, noise=weights)
    derived, _ = problem.solve()
    found = dict(zip(derived.names, derived.values, strict=True))
    nominal = trial.campaign.factory["nominal_scale_factor_v_per_rad_s"]["x"]
    return {
        "rate_deg_h": (found["rate"] - trial.rate_rad_s) / DEG_H,
        "bias_deg_h": (found["mission_bias_x"] / nominal - trial.truth.bias_rad_s) / DEG_H,
        "scale_ppm": (found["mission_scale_x"] / nominal / trial.truth.scale_factor - 1.0) * 1e6,
    }


def summarise(figures: Figures) -> Sequence[Gate]:
    """Gates of the issue, and the worst unit."""
    gates = []
    for name, unit, limit in (("rate", "deg/h", 0.2), ("bias", "deg/h", 0.2), ("scale", "ppm", 2.0)):
        errors = np.asarray(figures[f"{name}_{'ppm' if unit == 'ppm' else 'deg_h'}"])
        gates.append(Gate(f"{name} error, rms", rms(errors, unit), upper=limit))
        gates.append(Gate(f"{name} error, worst unit", Quantity(float(np.abs(errors).max()), 0.0, unit)))
    return gates


STUDY = Study(
    name="sideband-accuracy",
    description="Noise-free systematic error of rate, bias and scale factor at carrier level, drawn units",
    run=run,
    summarise=summarise,
    default_seeds=100,
)
