"""The demonstration's page and JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..device import Device
from ..device.operating_point import ftr_operating_point
from ..estimation import calibrate
from ..paths import package_version
from ..recording.load import load_campaign
from ..report.calibration_page import AxisTruth, Rates, RunFacts, calibration_page
from ..report.page import write_page
from ..report.series import averaged
from ..units import DEG_H
from .console import progress_bar
from .demo_session import DemoOutcome, DemoSettings

__all__ = ["axis_truths", "demo_document", "write_report"]


def demo_document(settings: DemoSettings, outcome: DemoOutcome, elapsed_s: float) -> dict[str, Any]:
    """JSON of the demonstration (design.md section 5)."""
    return {
        "seed": settings.seed,
        "device_id": outcome.device.device_id,
        "elapsed_s": round(elapsed_s, 3),
        "simulated_s": round(outcome.simulated_s, 3),
        **outcome.comparison.to_json(),
        "rate": {"true": {"value": outcome.true_rate_rad_s / DEG_H, "sd": 0.0, "unit": "deg/h"}},
        "record_id": outcome.record.record_id,
    }


def axis_truths(device: Device) -> dict[str, AxisTruth]:
    """True bias and scale factor of the feedthrough-free sensor (theory.md Eq. 7) by oscillator axis, for the pictures of convergence."""
    no_feedthrough = np.zeros((2, 2), dtype=complex)
    amplitude, step = device.factory_data.nominal_amplitude_v, 1e-3

    def volts(axis: str, rate: float) -> float:
        flow = device.slow_flow(rate)
        return ftr_operating_point(flow.A, flow.G, no_feedthrough, amplitude, axis).rate_channel_v

    truths = {}
    for axis in ("x", "y"):
        slope = (volts(axis, step) - volts(axis, -step)) / (2.0 * step)
        truths[axis] = AxisTruth(bias=volts(axis, 0.0) / slope, scale_factor=slope)
    return truths


def write_report(settings: DemoSettings, outcome: DemoOutcome, elapsed_s: float) -> Path:
    """Write ``report.html`` from what the calibration node recorded; returns its path."""
    campaign = load_campaign(settings.directory / outcome.run_id / "campaign.h5")
    with progress_bar("drawing the report", lines=True) as report:
        result = calibrate(campaign, on_progress=lambda fraction: report(fraction, ""))
    device = outcome.device
    frequency = device.factory_data.nominal_f0_hz / 1000.0
    facts = RunFacts(
        title=f"Self-calibration of {device.device_id}",
        subtitle=(
            f"One service call to three ROS 2 nodes: a simulated {device.factory_data.kind} gyro at {frequency:g} kHz calibrated itself by "
            "side bands. It was never turned, and its input rate (earth and base) was unknown."
        ),
        footer=f"gyro_calib {package_version()}, seed {settings.seed}, run {outcome.run_id}, record {outcome.record.record_id}",
        device_s=outcome.simulated_s,
        elapsed_s=elapsed_s,
    )
    rates = Rates(
        before=averaged(outcome.raw.time_s, outcome.raw.rate_rad_s),
        after=averaged(outcome.calibrated.time_s, outcome.calibrated.rate_rad_s),
        true_rate_deg_h=outcome.true_rate_rad_s / DEG_H,
    )
    page = calibration_page(result, campaign, facts, comparison=outcome.comparison, rates=rates, truths=axis_truths(device))
    path = settings.directory / "report.html"
    write_page(path, page)
    return path
