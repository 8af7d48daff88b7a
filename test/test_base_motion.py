"""A base that sways, drifts or steps during a calibration, below the limit that ends the run: the result is right or warned of."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gyro_calib.calibration import CalibrationRecord, record_from_result
from gyro_calib.device import draw_unit, load_device
from gyro_calib.errors import ExperimentAborted
from gyro_calib.estimation import calibrate
from gyro_calib.experiments import SimulatedInstrument, run_plan, self_calibration_plan
from gyro_calib.recording.command import Command
from gyro_calib.simulation import GyroSimulator
from gyro_calib.simulation.truth import truth_of

FloatArray = NDArray[np.float64]
DEVICE = draw_unit(load_device("ring_15k"), 7)
PLAN = self_calibration_plan(DEVICE.factory(), quality="quick")


class Swaying:
    """A simulator on a base that moves."""

    def __init__(self, motion: Callable[[FloatArray], FloatArray]) -> None:
        self._simulator = GyroSimulator(DEVICE, rng=np.random.default_rng(3), fidelity="slow_flow")
        self._motion = motion

    def __getattr__(self, name: str) -> Any:
        return getattr(self._simulator, name)

    def advance(self, duration_s: float, rate_rad_s: float = 0.0) -> FloatArray:
        rate_hz = self._simulator.sample_rate_hz
        times = self._simulator.time_s + np.arange(1, round(duration_s * rate_hz) + 1) / rate_hz
        return self._simulator.advance(duration_s, rate_rad_s + self._motion(times))


def calibrated(motion: Callable[[FloatArray], FloatArray]) -> tuple[CalibrationRecord, float]:
    """Record, and error of its bias over its sd."""
    campaign = run_plan(SimulatedInstrument(Swaying(motion), 0.0), PLAN)  # type: ignore[arg-type]
    record = record_from_result(calibrate(campaign, with_convergence=False), campaign, run_id="run", mode="ftr_x")
    truth = truth_of(DEVICE, Command(), 0.0)
    assert abs(record.scale_factor.value - truth.scale_factor) < 5.0 * record.scale_factor.sd
    return record, abs(record.bias.value - truth.bias_rad_s) / record.bias.sd


def warned(record: CalibrationRecord) -> bool:
    return any("the linear model leaves chi-square/dof" in warning for warning in record.warnings)


@pytest.mark.parametrize("rate_rad_s", [0.0, 0.005], ids=["at rest", "turning steadily"])
def test_a_steady_rate_does_no_harm(rate_rad_s: float) -> None:
    record, error = calibrated(lambda t: rate_rad_s + 0.0 * t)
    assert error < 3.0
    assert not warned(record)
    assert abs(record.rate.value - rate_rad_s) < 5.0 * record.rate.sd


@pytest.mark.parametrize(
    "motion",
    [
        pytest.param(lambda t: 1e-3 * np.sin(2.0 * np.pi * 0.5 * t + 1.0), id="sway at a side band"),
        pytest.param(lambda t: 1e-3 * np.sin(2.0 * np.pi * 1.5 * t + 1.0), id="sway at the other", marks=pytest.mark.slow),
        pytest.param(lambda t: 1e-3 * np.sin(2.0 * np.pi * 7.0 * t), id="vibration", marks=pytest.mark.slow),
        pytest.param(lambda t: 1e-3 * np.sin(2.0 * np.pi * 0.05 * t + 1.0), id="slow sway"),
        pytest.param(lambda t: 5e-3 * t / 120.0, id="steady change"),
        pytest.param(lambda t: 5e-3 * (t > 60.0), id="step", marks=pytest.mark.slow),
    ],
)
def test_a_motion_below_the_limit_is_within_the_claim_or_warned_of(motion: Callable[[FloatArray], FloatArray]) -> None:
    record, error = calibrated(motion)
    assert error < 3.0 or warned(record)
    assert error < 10.0  # the claim grows with the motion, if not enough


def test_a_motion_above_the_limit_ends_the_run() -> None:
    with pytest.raises(ExperimentAborted, match=r"Base must stay within 0\.573 deg/s of rest"):
        calibrated(lambda t: 0.02 * (t > 50.0))
