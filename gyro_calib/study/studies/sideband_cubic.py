"""Cubic stiffness, cubic cross stiffness and nonlinear damping at three drive amplitudes: the estimate without and with the cubic terms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...device import Nonlinearity, load_device
from ...estimation.separation import Priors
from ...estimation.sideband import SidebandProblem
from ...estimation.slow_flow_data import usable_recordings
from ...experiments import cubic_plan
from ...quantity import Quantity
from ...units import DEG_H
from ..gates import Gate, rms
from ..registry import Figures, Study
from ._units import run_unit

#: mission amplitude; the largest drawn effects there are a Duffing shift of 1e-6 of the frequency, cross terms of 0.02 1/s and a nonlinear
#: damping of 3e-3 of 1/tau
_AMPLITUDE_M = 1e-6


def _nonlinearity(seed: int) -> Nonlinearity:
    rng = np.random.default_rng([seed, 7])
    ring = load_device("ring_15k").resonator
    omega = ring.omega0_rad_s
    # (3/8) k3 a^2 / omega^2 = shift; cross stiffness rate (3/8) k a^2 / omega; damping (1/8) c a^2
    square = _AMPLITUDE_M**2
    stiffness = 1e-6 * omega**2 / (0.375 * square)
    cross = 0.02 * omega / (0.375 * square)
    damping = 3e-3 * ring.decay_rate() / (0.125 * square)
    u = rng.uniform(-1, 1, 5)
    return Nonlinearity(u[0] * stiffness, 0.3 * u[1] * stiffness, 0.0, u[2] * cross, u[3] * cross, abs(u[4]) * damping)


def run(seed: int) -> dict[str, float]:
    """One unit: errors of bias and scale factor without the terms, with them, and as the test decides."""
    design = replace(load_device("ring_15k"), nonlinearity=_nonlinearity(seed))
    plan = cubic_plan(design.factory(), quality="quick")
    trial = run_unit(seed, design=design, plan=plan)
    recordings = usable_recordings(trial.campaign)[0]
    nominal = trial.campaign.factory["nominal_scale_factor_v_per_rad_s"]["x"]
    kappa = trial.device.resonator.angular_gain
    free = SidebandProblem(recordings, trial.campaign.factory, kappa, Priors())
    figures: dict[str, float] = {"asked": float(free.fit.has_cubic)}
    for name, cubic in (("without", False), ("with", True)):
        same = free.fit.has_cubic == cubic
        problem = free if same else SidebandProblem(recordings, trial.campaign.factory, kappa, Priors(), cubic=cubic)
        derived, covariance = problem.solve()
        for figure, truth, unit in (
            ("mission_bias_x", trial.truth.bias_rad_s * nominal, nominal * DEG_H),
            ("mission_scale_x", trial.truth.scale_factor * nominal, trial.truth.scale_factor * nominal * 1e-6),
            ("rate", trial.rate_rad_s, DEG_H),
        ):
            k = derived.names.index(figure)
            figures[f"{figure}/{name}"] = (float(derived.values[k]) - truth) / unit
            figures[f"{figure}/{name}/sd"] = float(np.sqrt(covariance[k, k])) / abs(unit)
    return figures


def summarise(figures: Figures) -> Sequence[Gate]:
    """Errors without and with the terms."""
    gates = [Gate("units where the data asked for the terms", Quantity(100 * float(np.mean(figures["asked"])), 0.0, "%"), lower=90.0)]
    for name, unit in (("rate", "deg/h"), ("mission_bias_x", "deg/h"), ("mission_scale_x", "ppm")):
        gates.append(Gate(f"{name} error without cubic terms, rms", rms(figures[f"{name}/without"], unit)))
        gates.append(Gate(f"{name} error with them, rms", rms(figures[f"{name}/with"], unit)))
        ratio = np.asarray(figures[f"{name}/with"]) / np.asarray(figures[f"{name}/with/sd"])
        gates.append(Gate(f"{name} error / sd with them, rms", rms(ratio, "1"), lower=0.7, upper=1.3))
    return gates


STUDY = Study(
    name="sideband-cubic",
    description="Errors without and with the cubic terms of document 000 (Eqs. 20-27), three drive amplitudes, drawn nonlinearities",
    run=run,
    summarise=summarise,
    default_seeds=100,
)
