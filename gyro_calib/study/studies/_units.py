"""What the side-band studies share: one drawn unit, calibrated at carrier level against its hidden truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...device import Device, draw_unit, load_device
from ...experiments import Plan, SimulatedInstrument, run_plan, self_calibration_plan
from ...recording.recording import Campaign
from ...simulation import GyroSimulator
from ...simulation.truth import Truth
from ...units import EARTH_RATE_RAD_S

__all__ = ["Trial", "run_unit"]


@dataclass(frozen=True)
class Trial:
    """One campaign with what was true of it."""

    device: Device
    campaign: Campaign
    truth: Truth
    rate_rad_s: float


def run_unit(
    seed: int,
    *,
    noisy: bool = True,
    quality: str = "quick",
    rate_rad_s: float | None = None,
    design: Device | None = None,
    plan: Plan | None = None,
    exact_drive_ratio: bool = False,
) -> Trial:
    """Draw a unit, run a plan at carrier level under a constant rate (default: drawn within plus or minus twice the earth's), return all.

    ``exact_drive_ratio`` gives the calibrator the true drive-gain ratio, so that only the estimator's own error is left.
    """
    device = draw_unit(design or load_device("ring_15k"), seed)
    if exact_drive_ratio:
        ratio = 1.0 / (1.0 + device.drive.gain_mismatch)
        device = replace(device, factory_data=replace(device.factory_data, drive_gain_ratio_x_over_y=ratio))
    rate = float(np.random.default_rng([seed, 2]).uniform(-2, 2)) * EARTH_RATE_RAD_S if rate_rad_s is None else rate_rad_s
    simulator = GyroSimulator(device, rng=np.random.default_rng([seed, 1]), fidelity="carrier", noisy=noisy)
    truth = simulator.truth()
    campaign = run_plan(SimulatedInstrument(simulator, rate), plan or self_calibration_plan(simulator.factory, quality=quality))
    return Trial(device, campaign, truth, rate)
