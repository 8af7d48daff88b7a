"""The resonance moves 2 Hz (5 degC of silicon) during the calibration: what that does to bias and scale factor.

Only the resonance moves here; the gains keep still, so that one number is one cause. The bias is that of the sensor (theory.md Eq. 7):
while the frequency ramps, a PLL's standing phase error adds its own bias to the running rate channel, a property of that minute.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...device import Device, load_device
from ...estimation.result import CalibrationResult
from ...estimation.sideband import calibrate_sideband
from ...experiments import Limits, self_calibration_plan
from ...quantity import Quantity
from ...units import DEG_H
from ..gates import Gate, rms
from ..registry import Figures, Study
from ._units import run_unit

_SPAN_K = 5.0


def _design(span_k: float, duration_s: float) -> Device:
    ring = load_device("ring_15k")
    return replace(
        ring,
        drive=replace(ring.drive, gain_tempco_per_k=0.0),
        pickoff=replace(ring.pickoff, gain_tempco_per_k=0.0),
        resonator=replace(ring.resonator, quality_exponent=0.0),
        environment=replace(ring.environment, temperature_degc=25.0 - span_k / 2, ramp_k_per_s=span_k / duration_s),
    )


def run(seed: int) -> dict[str, float]:
    """The same unit and the same noise, still and moving: the change of the estimates over their sd."""
    plan = self_calibration_plan(load_device("ring_15k").factory(), quality="quick", limits=Limits(temperature_k=20.0))
    results: list[CalibrationResult] = []
    moved_hz = 0.0
    for span in (0.0, _SPAN_K):
        trial = run_unit(seed, design=_design(span, plan.duration_s), plan=plan, exact_drive_ratio=True)
        results.append(calibrate_sideband(trial.campaign, with_convergence=False, temperature_window_k=10.0))
        # silicon's frequency at the start and at the end of the ramp
        moved_hz = trial.device.resonator.frequency_hz * abs(trial.device.resonator.frequency_tempco_per_k) * span
    still, moving = results
    # the drive's force acts on a resonance that moved: G = P B / 2 omega follows the frequency, and the estimate says so
    scale = (moving.scale_factor["x"].value * still.reference_frequency_hz) / (
        still.scale_factor["x"].value * moving.reference_frequency_hz
    )
    noise_ppm = 1e6 * moving.parameters["G_yy_im"].sd / abs(moving.parameters["G_yy_im"].value)
    return {
        "moved_hz": moved_hz,
        "bias_change_deg_h": (moving.bias["x"].value - still.bias["x"].value) / DEG_H,
        "bias_sd_deg_h": moving.bias["x"].sd / DEG_H,
        "rate_change_deg_h": (moving.rate.value - still.rate.value) / DEG_H,
        "scale_change_ppm": 1e6 * (scale - 1.0),
        "scale_sd_ppm": 1e6 * moving.scale_factor["x"].sd / abs(moving.scale_factor["x"].value),
        "gain_sd_ppm": noise_ppm,
    }


def summarise(figures: Figures) -> Sequence[Gate]:
    """Changes over the claimed sd."""
    bias = np.asarray(figures["bias_change_deg_h"]) / np.asarray(figures["bias_sd_deg_h"])
    scale = np.asarray(figures["scale_change_ppm"]) / np.asarray(figures["scale_sd_ppm"])
    return [
        Gate("resonance moved", Quantity(float(np.mean(figures["moved_hz"])), 0.0, "Hz"), lower=1.9),
        Gate("bias change, rms", rms(figures["bias_change_deg_h"], "deg/h")),
        Gate("bias change over its sd, rms", rms(bias, "1"), upper=1.0),
        Gate("scale-factor change, rms", rms(figures["scale_change_ppm"], "ppm")),
        Gate("scale-factor change over its sd, rms", rms(scale, "1"), upper=1.0),
    ]


STUDY = Study(
    name="sideband-thermal",
    description="Bias and scale factor when the resonance moves 2 Hz during the calibration, against the same unit held still",
    run=run,
    summarise=summarise,
    default_seeds=100,
)
