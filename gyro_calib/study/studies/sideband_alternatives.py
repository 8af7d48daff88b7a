"""The alternatives that document 000 names, against its own way: still, with the resonance moving 2 Hz, with a cubic stiffness.

Each has the same side bands (a sweep: as many frequencies in the same range), the same times and the same open records, at carrier level.
``amplitude, stiffening`` is the document's own way with two parameters more, by which the resonances follow the amplitude.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...device import Device, Nonlinearity, load_device
from ...estimation.document_fit import document_fit, rough_start
from ...estimation.slow_flow_estimate import SlowFlowEstimate
from ...estimation.swept_drive import fit_swept_drive
from ...experiments import Limits
from ...experiments.alternatives import ALTERNATIVES, alternative_plan
from ...quantity import Quantity
from ..gates import Gate, rms
from ..registry import Figures, Study
from ._sensor import sensor_errors
from ._units import Trial, run_unit

CONDITIONS = ("still", "moving", "cubic")
_STIFFENING = "amplitude, stiffening"
METHODS = ("amplitude", _STIFFENING, *ALTERNATIVES[1:])
_MIDDLE_DEGC, _SPAN_K = 25.0, 5.0
#: relative shift of the resonance at the mission's amplitude of 1 um
_DUFFING, _AMPLITUDE_M = 1e-6, 1e-6


def _design(condition: str, duration_s: float) -> Device:
    """The ring with gains that keep still, so that one number is one cause."""
    ring = load_device("ring_15k")
    span = _SPAN_K if condition == "moving" else 0.0
    cubic = _DUFFING * ring.resonator.omega0_rad_s**2 / (0.375 * _AMPLITUDE_M**2) if condition == "cubic" else 0.0
    return replace(
        ring,
        drive=replace(ring.drive, gain_tempco_per_k=0.0),
        pickoff=replace(ring.pickoff, gain_tempco_per_k=0.0),
        resonator=replace(ring.resonator, quality_exponent=0.0),
        environment=replace(ring.environment, temperature_degc=_MIDDLE_DEGC - span / 2, ramp_k_per_s=span / duration_s),
        nonlinearity=Nonlinearity(cubic_isotropic=cubic),
    )


def _fit(method: str, trial: Trial) -> SlowFlowEstimate:
    recordings, factory = list(trial.campaign), trial.campaign.factory
    if method == "swept_drive":
        middle = float(np.mean([r.ref_omega_rad_s.mean() for r in recordings if r.command.oscillator_axis]))
        return fit_swept_drive(recordings, middle, trial.device.resonator.decay_rate())
    estimate = document_fit(recordings, lambda m: rough_start(m, factory), with_carrier=True, stiffening=method == _STIFFENING)
    return estimate.slow_flow()


def run(seed: int) -> dict[str, float]:
    """One unit under every condition by every method."""
    figures: dict[str, float] = {}
    for condition in CONDITIONS:
        trials: dict[str, Trial] = {}
        for method in METHODS:
            name = method.split(",")[0]
            if name not in trials:
                limits = Limits(temperature_k=20.0, base_rate_rad_s=1.0)
                plan = alternative_plan(name, load_device("ring_15k").factory(), limits=limits)
                trials[name] = run_unit(seed, design=_design(condition, plan.duration_s), plan=plan, exact_drive_ratio=True)
            trial = trials[name]
            errors = sensor_errors(trial.device, trial.campaign, _fit(method, trial), trial.rate_rad_s, _MIDDLE_DEGC)
            figures |= {f"{method}/{condition}/{what}": value for what, value in errors.items()}
    return figures


def summarise(figures: Figures) -> Sequence[Gate]:
    """The table, and the claims of the document about it."""
    gates = []
    for condition in CONDITIONS:
        for method in METHODS:
            gates.append(Gate(f"{condition}: {method}: bias error, rms", rms(figures[f"{method}/{condition}/bias"], "deg/h")))
            gates.append(Gate(f"{condition}: {method}: scale-factor error, rms", rms(figures[f"{method}/{condition}/scale"], "ppm")))
    own = {c: np.asarray(figures[f"amplitude/{c}/bias"]) / np.asarray(figures[f"amplitude/{c}/bias/sd"]) for c in ("still", "moving")}
    gates += [Gate(f"{c}: amplitude: bias error over its sd, rms", rms(e, "1"), upper=1.4) for c, e in own.items()]
    for words, worse, condition, factor in (
        ("a swept drive suffers from a moving resonance", "swept_drive", "moving", 20.0),
        ("an open secondary is noisier", "open_secondary", "still", 3.0),
        ("an open secondary suffers from cubic stiffness", "open_secondary", "cubic", 20.0),
    ):
        ratio = _rms(figures, worse, condition) / _rms(figures, "amplitude" if condition != "cubic" else _STIFFENING, condition)
        gates.append(Gate(f"{words}: bias error over the document's own way", Quantity(ratio, 0.0, "1"), lower=factor))
    healed = _rms(figures, _STIFFENING, "cubic") / _rms(figures, _STIFFENING, "still")
    gates.append(Gate("stiffening as a parameter: bias error with cubic stiffness over without", Quantity(healed, 0.0, "1"), upper=3.0))
    return gates


def _rms(figures: Figures, method: str, condition: str) -> float:
    return float(np.sqrt(np.mean(np.square(figures[f"{method}/{condition}/bias"]))))


def plot(figures: Figures, theme: Any) -> Any:
    """Bias error of every method under every condition."""
    from ...report.figures import Drawing
    from ...report.theme import figure

    with figure(theme) as (drawn, axes):
        for place, (condition, colour) in enumerate(zip(CONDITIONS, theme.series, strict=False)):
            at = np.arange(len(METHODS)) + 0.25 * (place - 1)
            axes.bar(at, [_rms(figures, m, condition) for m in METHODS], width=0.23, color=colour, label=condition)
        axes.set_yscale("log")
        axes.set_xticks(range(len(METHODS)), [m.replace("_", " ").replace(", ", ",\n") for m in METHODS], rotation=30, ha="right")
        axes.set_ylabel("bias error, rms [deg/h]")
        axes.legend()
    conclusion = "Only a closed secondary on an oscillator stands both a moving resonance and a cubic stiffness."
    return Drawing("alternatives", "Alternatives of document 000", conclusion, drawn)


STUDY = Study(
    name="sideband-alternatives",
    description="Alternatives of document 000 (frequency, secondary, open secondary, swept drive) against its own: still, moving, cubic",
    run=run,
    summarise=summarise,
    default_seeds=12,
    plot=plot,
)
