"""The resonance moves 2 Hz (5 degC of silicon) during the calibration: what that does to bias and scale factor.

Three times: the resonance alone (one number, one cause), everything that moves with temperature (gains, damping), and the resonance alone
for the swept drive without an oscillator, whose reference does not follow. Side bands are compared with the same unit, with the same noise,
held still at the mean temperature of the moving campaign. The bias is that of the sensor (theory.md Eq. 7): while the frequency ramps, a
PLL's standing phase error adds its own bias to the running rate channel, a property of that minute.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...device import Device, load_device
from ...estimation.result import CalibrationResult
from ...estimation.sideband import calibrate_sideband
from ...estimation.swept_drive import fit_swept_drive
from ...experiments import Limits, Plan, self_calibration_plan
from ...experiments.alternatives import alternative_plan
from ...quantity import Quantity
from ...units import DEG_H
from ..gates import Gate, rms
from ..registry import Figures, Study
from ._sensor import sensor_errors
from ._units import Trial, run_unit

_SPAN_K, _MIDDLE_DEGC = 5.0, 25.0
_LIMITS = Limits(temperature_k=20.0, base_rate_rad_s=1.0)


def _design(middle_degc: float, span_k: float, duration_s: float, *, everything: bool = False) -> Device:
    """The ring on a ramp of ``span_k``; ``everything``: gains and damping move too."""
    ring = load_device("ring_15k")
    design = replace(
        ring,
        environment=replace(ring.environment, temperature_degc=middle_degc - span_k / 2, ramp_k_per_s=span_k / duration_s),
    )
    if everything:
        return design
    return replace(
        design,
        drive=replace(ring.drive, gain_tempco_per_k=0.0),
        pickoff=replace(ring.pickoff, gain_tempco_per_k=0.0),
        resonator=replace(ring.resonator, quality_exponent=0.0),
    )


def _calibrated(seed: int, design: Device, plan: Plan) -> tuple[Trial, CalibrationResult]:
    trial = run_unit(seed, design=design, plan=plan, exact_drive_ratio=True)
    return trial, calibrate_sideband(trial.campaign, with_convergence=False)


def _side_bands(seed: int, *, everything: bool) -> dict[str, float]:
    plan = self_calibration_plan(load_device("ring_15k").factory(), quality="quick", limits=_LIMITS)
    trial, moving = _calibrated(seed, _design(_MIDDLE_DEGC, _SPAN_K, plan.duration_s, everything=everything), plan)
    _, still = _calibrated(seed, _design(moving.temperature_degc, 0.0, plan.duration_s, everything=everything), plan)
    scale = moving.scale_factor["x"]
    resonator = trial.device.resonator
    return {
        # silicon's frequency at the start and at the end of the ramp
        "moved_hz": resonator.frequency_hz * abs(resonator.frequency_tempco_per_k) * _SPAN_K,
        "bias_change_deg_h": (moving.bias["x"].value - still.bias["x"].value) / DEG_H,
        "bias_sd_deg_h": moving.bias["x"].sd / DEG_H,
        "bias_still_sd_deg_h": still.bias["x"].sd / DEG_H,
        "scale_change_ppm": 1e6 * (scale.value / still.scale_factor["x"].value - 1.0),
        "scale_sd_ppm": 1e6 * scale.sd / abs(scale.value),
        "scale_still_sd_ppm": 1e6 * still.scale_factor["x"].sd / abs(scale.value),
    }


def _swept_drive(seed: int) -> dict[str, float]:
    """Its error, which is all change: held still it is some deg/h and ppm off (study sideband-alternatives)."""
    plan = alternative_plan("swept_drive", load_device("ring_15k").factory(), limits=_LIMITS)
    trial = run_unit(seed, design=_design(_MIDDLE_DEGC, _SPAN_K, plan.duration_s), plan=plan, exact_drive_ratio=True)
    recordings = list(trial.campaign)
    middle = float(np.mean([r.ref_omega_rad_s.mean() for r in recordings if r.command.oscillator_axis]))
    estimate = fit_swept_drive(recordings, middle, trial.device.resonator.decay_rate())
    errors = sensor_errors(trial.device, trial.campaign, estimate, trial.rate_rad_s, _MIDDLE_DEGC)
    return {
        "bias_change_deg_h": errors["bias"],
        "bias_sd_deg_h": errors["bias/sd"],
        "scale_change_ppm": errors["scale"],
        "scale_sd_ppm": errors["scale/sd"],
    }


def run(seed: int) -> dict[str, float]:
    """The same unit and the same noise, still and moving: the change of the estimates, and their sd."""
    parts = {
        "resonance": _side_bands(seed, everything=False),
        "everything": _side_bands(seed, everything=True),
        "swept": _swept_drive(seed),
    }
    return {f"{part}/{name}": value for part, figures in parts.items() for name, value in figures.items()}


def summarise(figures: Figures) -> Sequence[Gate]:
    """Changes over the claimed sd."""
    moved = float(np.mean(figures["resonance/moved_hz"]))
    gates = [Gate("resonance moved", Quantity(moved, 0.0, "Hz"), lower=1.9)]
    titles = {"resonance": "resonance moves", "everything": "gains and damping move too", "swept": "swept drive, resonance moves"}
    for part, title in titles.items():
        upper = np.inf if part == "swept" else 1.0
        for what, unit in (("bias", "deg_h"), ("scale", "ppm")):
            change, sd = (np.asarray(figures[f"{part}/{what}_{kind}_{unit}"]) for kind in ("change", "sd"))
            shown = unit.replace("_", "/")
            gates.append(Gate(f"{title}: {what} change, rms", rms(change, shown)))
            gates.append(Gate(f"{title}: {what} sd, rms", rms(sd, shown)))
            gates.append(Gate(f"{title}: {what} change over its sd, rms", rms(change / sd, "1"), upper=upper))
    for what, unit in (("bias", "deg_h"), ("scale", "ppm")):
        # an sd that grows without limit would meet any gate: what the slopes cost is shown and bounded
        cost = np.asarray(figures[f"resonance/{what}_sd_{unit}"]) / np.asarray(figures[f"resonance/{what}_still_sd_{unit}"])
        gates.append(Gate(f"resonance moves: {what} sd over the sd held still, rms", rms(cost, "1"), upper=2.5))
        ratio = rms(figures[f"swept/{what}_change_{unit}"], "1").value / rms(figures[f"resonance/{what}_change_{unit}"], "1").value
        gates.append(Gate(f"{what} change of a swept drive over that of side bands, rms", Quantity(ratio, 0.0, "1"), lower=20.0))
    return gates


STUDY = Study(
    name="sideband-thermal",
    description="Bias and scale factor when the resonance moves 2 Hz during the calibration, against the same unit held still",
    run=run,
    summarise=summarise,
    default_seeds=100,
)
