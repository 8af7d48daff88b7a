"""One self-calibration of a noisy unit at an unknown rate: what was wrong before, what is left after, and whether the sd says so."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...estimation import calibrate
from ...quantity import Quantity
from ...units import deg_h
from ..gates import Gate, rms
from ..registry import Figures, Study
from ._units import run_unit


def run(seed: int) -> dict[str, float]:
    """One unit at carrier level, plan quality standard: bias [deg/h], scale factor [%, ppm] and rate [deg/h] of the rate channel."""
    trial = run_unit(seed, quality="standard")
    result = calibrate(trial.campaign, with_convergence=False)
    nominal = trial.campaign.factory["nominal_scale_factor_v_per_rad_s"]["x"]
    mission = result.mission["x"]
    bias_error = mission.bias_v / nominal - trial.truth.bias_rad_s
    bias_sd, scale_sd = np.sqrt(np.diag(mission.covariance)) / nominal
    scale_error = mission.volts_per_rad_s / nominal - trial.truth.scale_factor
    rate_error = result.rate.value - trial.rate_rad_s
    return {
        "bias_before_deg_h": deg_h(trial.truth.bias_rad_s),
        "scale_before_percent": 100.0 * (trial.truth.scale_factor - 1.0),
        "bias_error_deg_h": deg_h(bias_error),
        "bias_over_sd": bias_error / bias_sd,
        "scale_error_ppm": 1e6 * scale_error / trial.truth.scale_factor,
        "scale_over_sd": scale_error / scale_sd,
        "rate_error_deg_h": deg_h(rate_error),
        "rate_over_sd": rate_error / result.rate.sd,
        "chi2_per_dof": result.chi2_per_dof,
        "plan_s": sum(recording.duration_s for recording in trial.campaign),
    }


def summarise(figures: Figures) -> Sequence[Gate]:
    """Before, after, and error over sd."""
    before = np.abs(figures["bias_before_deg_h"])
    return [
        Gate("bias before, median", Quantity(float(np.median(before)), 0.0, "deg/h")),
        Gate("bias before, largest", Quantity(float(before.max()), 0.0, "deg/h")),
        Gate("scale factor off before, rms", rms(figures["scale_before_percent"], "%")),
        Gate("bias error, rms", rms(figures["bias_error_deg_h"], "deg/h"), upper=2.0),
        Gate("scale-factor error, rms", rms(figures["scale_error_ppm"], "ppm"), upper=50.0),
        Gate("rate error, rms", rms(figures["rate_error_deg_h"], "deg/h")),
        Gate("bias error / sd, rms", rms(figures["bias_over_sd"], "1"), lower=0.8, upper=1.3),
        Gate("scale-factor error / sd, rms", rms(figures["scale_over_sd"], "1"), lower=0.8, upper=1.3),
        Gate("rate error / sd, rms", rms(figures["rate_over_sd"], "1"), lower=0.8, upper=1.3),
    ]


STUDY = Study(
    name="self-calibration",
    description="Bias and scale factor before and after one self-calibration at carrier level, unknown rate within twice the earth's",
    run=run,
    summarise=summarise,
    default_seeds=20,
)
