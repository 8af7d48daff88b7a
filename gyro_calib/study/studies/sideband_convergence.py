"""Document 000: "rough estimates for the damping constant and the forcer parameters, with the other parameters assumed to be zero, are
sufficient for convergence"."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...estimation.document_fit import document_fit, known_start, rough_start
from ...estimation.document_model import DocumentModel
from ...estimation.sideband_table import sideband_table
from ...quantity import Quantity
from ..gates import Gate, quantile
from ..registry import Figures, Study
from ._units import run_unit

#: how rough the start is: the design's damping and forcers, each off by this share, up or down
_OFF = 0.3


def run(seed: int) -> dict[str, float]:
    """One unit, carrier level, noise on: the fit from the rough start against the fit from the truth."""
    trial = run_unit(seed)
    table = sideband_table(list(trial.campaign))
    flow = trial.device.slow_flow(trial.rate_rad_s)
    signs = np.random.default_rng([seed, 11]).choice((-1.0, 1.0), 4)

    def rough(model: DocumentModel) -> np.ndarray:
        start = rough_start(model, trial.campaign.factory)
        for name, sign in zip(("B_xx_re", "B_yy_re", "b_x", "b_y"), signs, strict=True):
            start[model.names.index(name)] *= 1.0 + sign * _OFF
        return start

    figures = {}
    for cost in ("positions", "transfer_functions"):
        found = document_fit(table, rough, cost=cost)
        known = document_fit(table, lambda model: known_start(model, flow.A, flow.G, flow.E), cost=cost)
        distance = np.abs(found.values - known.values) / np.sqrt(np.diag(known.covariance))
        figures[f"{cost}/converged"] = float(found.converged and distance.max() < 0.1)
        figures[f"{cost}/distance"] = float(distance.max())
        figures[f"{cost}/iterations"] = float(found.iterations)
    return figures


def summarise(figures: Figures) -> Sequence[Gate]:
    """How many converge, how far the two fits are apart, how long it takes."""
    gates = []
    for cost in ("positions", "transfer_functions"):
        done = np.asarray(figures[f"{cost}/converged"])
        gates.append(Gate(f"{cost}: units that do not converge", Quantity(float(np.sum(done < 0.5)), 0.0, "1"), upper=0.0))
        worst = float(np.max(figures[f"{cost}/distance"]))
        gates.append(Gate(f"{cost}: largest distance from the fit that starts at the truth, over sd", Quantity(worst, 0.0, "1"), upper=0.1))
        gates.append(Gate(f"{cost}: iterations, median", quantile(figures[f"{cost}/iterations"], 0.5, "1")))
    return gates


STUDY = Study(
    name="sideband-convergence",
    description="Fit of document 000's parameters from damping and forcers 30 % off, all else zero: does every drawn unit converge?",
    run=run,
    summarise=summarise,
    default_seeds=200,
)
