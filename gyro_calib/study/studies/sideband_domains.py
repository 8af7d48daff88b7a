"""Frequency against time domain (document 000: "done in the frequency domain rather than the time domain for greatly reduced execution
time"): the same recordings, the same parameters, the same minimiser; the same answer?"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

import numpy as np

from ...device import load_device
from ...estimation.document_fit import DocumentEstimate, document_fit, rough_start
from ...estimation.document_model import FIRST_FIFTEEN, DocumentModel
from ...estimation.sideband_table import sideband_table
from ...estimation.time_domain import TimeDomainEstimate, integrate, time_domain_fit
from ...experiments.alternatives import alternative_plan
from ...quantity import Quantity
from ...units import DEG_H
from ..gates import Gate, quantile, rms
from ..registry import Figures, Study
from ._units import run_unit

T = TypeVar("T")
_LINES_HZ = (0.1, 0.45, 0.8, 1.15, 1.5)
_RECORD_S = 20.0
#: start: damping and forcers 30 % off
_OFF = 1.3


def _timed(work: Callable[[], T]) -> tuple[T, float]:
    """Result and processor time [s] (wall time would measure the neighbours)."""
    began = time.process_time()
    result = work()
    return result, time.process_time() - began


def run(seed: int) -> dict[str, float]:
    """One unit without and with noise."""
    _compile()
    plan = alternative_plan("amplitude", load_device("ring_15k").factory(), lines_hz=_LINES_HZ, record_s=_RECORD_S)
    figures: dict[str, float] = {}
    for case in ("noise-free", "noisy"):
        trial = run_unit(seed, noisy=case == "noisy", plan=plan)
        E = trial.device.feedthrough.matrix()
        recordings = [r for r in trial.campaign if r.command.excitation.kind == "amplitude_modulation"]
        table, table_s = _timed(partial(sideband_table, recordings))
        start = _OFF * rough_start(DocumentModel(table, fit_feedforward=False), trial.campaign.factory)
        frequency, frequency_s = _timed(partial(document_fit, table, start, weights="equal", feedforward=E))
        instants, instants_s = _timed(partial(time_domain_fit, recordings, start, feedforward=E))
        figures |= {f"{case}/{name}": value for name, value in _differences(frequency, instants).items()}
        figures |= {
            f"{case}/converged": float(frequency.converged and instants.converged),
            f"{case}/estimation_ratio": instants_s / frequency_s,
            f"{case}/whole_ratio": instants_s / (frequency_s + table_s),
            f"{case}/frequency_s": frequency_s,
            f"{case}/table_s": table_s,
            f"{case}/time_s": instants_s,
        }
    return figures


def _compile() -> None:
    """Let the integrator be compiled before it is timed."""
    drive = np.zeros((8, 2), dtype=complex)
    integrate(np.zeros(2, dtype=complex), np.eye(2, dtype=complex), np.zeros((4, 2, 2), dtype=complex), drive, drive.copy())


def _differences(frequency: DocumentEstimate, instants: TimeDomainEstimate) -> dict[str, float]:
    """Of the two answers: in deg/h and ppm, and over the sd of both."""
    model = frequency.model
    difference = dict(zip(FIRST_FIFTEEN, frequency.values - instants.values, strict=True))
    sd = np.sqrt(np.diag(frequency.covariance) + np.diag(instants.covariance))
    kappa = 0.8
    cross = [0.5 * difference[n] / kappa / DEG_H for n in ("b_xy", "b_yx")]
    cross += [0.5 * difference[n] / model.omega0 / kappa / DEG_H for n in ("k_xy", "k_yx")]
    forcers = [1e6 * difference[n] / frequency.parameter("B_yy_re").value for n in FIRST_FIFTEEN if n.startswith("B_")]
    return {
        "cross_deg_h": float(np.max(np.abs(cross))),
        "forcers_ppm": float(np.max(np.abs(forcers))),
        "over_sd": float(np.sqrt(np.mean(np.square((frequency.values - instants.values) / sd)))),
    }


def summarise(figures: Figures) -> Sequence[Gate]:
    """Same answer, ratio of times."""
    times = {n: np.concatenate([figures[f"{case}/{n}"] for case in ("noise-free", "noisy")]) for n in ("frequency_s", "table_s", "time_s")}
    ratios = {n: np.concatenate([figures[f"{case}/{n}"] for case in ("noise-free", "noisy")]) for n in ("estimation_ratio", "whole_ratio")}
    failed = sum(float(np.sum(np.asarray(figures[f"{case}/converged"]) < 0.5)) for case in ("noise-free", "noisy"))
    cross, forcers = (float(np.max(figures[f"noise-free/{name}"])) for name in ("cross_deg_h", "forcers_ppm"))
    return [
        Gate("fits that do not converge", Quantity(failed, 0.0, "1"), upper=0.0),
        Gate("noise-free: largest difference of cross terms", Quantity(cross, 0.0, "deg/h"), upper=0.2),
        Gate("noise-free: largest difference of forcers", Quantity(forcers, 0.0, "ppm"), upper=2.0),
        Gate("noisy: difference over its sd, rms", rms(figures["noisy/over_sd"], "1"), upper=1.3),
        Gate("data table, median processor time", quantile(1e3 * times["table_s"], 0.5, "ms")),
        Gate("frequency domain, median processor time", quantile(1e3 * times["frequency_s"], 0.5, "ms")),
        Gate("time domain, median processor time", quantile(1e3 * times["time_s"], 0.5, "ms")),
        Gate("time domain over frequency domain, estimation, median", quantile(ratios["estimation_ratio"], 0.5, "1"), lower=100.0),
        Gate("the same with the data table, median", quantile(ratios["whole_ratio"], 0.5, "1")),
    ]


STUDY = Study(
    name="sideband-domains",
    description="Estimation in the frequency domain against the time domain: same data, same answer, ratio of processor times",
    run=run,
    summarise=summarise,
    default_seeds=12,
)
