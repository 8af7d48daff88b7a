"""Bias separated from earth rate at latitudes 0 to 90 degrees, without turning the gyro."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ...estimation.sideband import calibrate_sideband
from ...quantity import Quantity
from ...units import DEG_H, EARTH_RATE_RAD_S, deg_h
from ..gates import Gate, rms
from ..registry import Figures, Study
from ._units import run_unit


def run(seed: int) -> dict[str, float]:
    """One unit, input axis vertical, at a latitude spread over 0-90 degrees by the seed."""
    latitude = math.radians((seed % 19) * 5.0)
    vertical = EARTH_RATE_RAD_S * math.sin(latitude)
    trial = run_unit(seed, rate_rad_s=vertical)
    result = calibrate_sideband(trial.campaign, with_convergence=False)
    nominal = trial.campaign.factory["nominal_scale_factor_v_per_rad_s"]["x"]
    return {
        "latitude_deg": math.degrees(latitude),
        "earth_rate_deg_h": deg_h(vertical),
        "rate_error_deg_h": deg_h(result.rate.value - vertical),
        "rate_over_sd": (result.rate.value - vertical) / result.rate.sd,
        "bias_error_deg_h": (result.mission["x"].bias_v / nominal - trial.truth.bias_rad_s) / DEG_H,
        "bias_before_deg_h": deg_h(trial.truth.bias_rad_s),
    }


def summarise(figures: Figures) -> Sequence[Gate]:
    """Against 15.04 deg/h, and whether the error follows the rate that was there."""
    earth, error = np.asarray(figures["earth_rate_deg_h"]), np.asarray(figures["rate_error_deg_h"])
    slope = float(np.polyfit(earth, error, 1)[0])
    slope_sd = float(error.std(ddof=1) / (earth.std() * math.sqrt(earth.size)))
    return [
        Gate("bias before calibration, rms", rms(figures["bias_before_deg_h"], "deg/h")),
        Gate("bias error, rms", rms(figures["bias_error_deg_h"], "deg/h"), upper=deg_h(EARTH_RATE_RAD_S)),
        Gate("rate error, rms", rms(error, "deg/h"), upper=deg_h(EARTH_RATE_RAD_S)),
        Gate("rate error / sd, rms", rms(figures["rate_over_sd"], "1"), lower=0.8, upper=1.3),
        Gate("part of the earth rate taken for bias (slope) over its sd", Quantity(abs(slope) / slope_sd, 1.0, "1"), upper=3.0),
    ]


STUDY = Study(
    name="earth-rate",
    description="Bias separated from earth rate at latitudes 0-90 deg (input axis vertical), error against 15.04 deg/h",
    run=run,
    summarise=summarise,
    default_seeds=114,
)
