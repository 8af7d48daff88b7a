"""A diagnosis as :func:`gyro_calib.gap.diagnose` returns one, without the minute that it takes."""

from __future__ import annotations

from gyro_calib.gap import Diagnosis, FoundEffect, Gap, NextExperiment
from gyro_calib.gap.gap_map import Cell
from gyro_calib.quantity import Quantity

__all__ = ["make_diagnosis"]


def make_diagnosis(device_id: str, verdict: str = "effects", recordings: int = 31) -> Diagnosis:
    """One effect found, or none."""
    effect = FoundEffect(
        "nonlinear_damping", "Damping that grows", ("nonlinear_damping", "drive_nonlinearity"), 0.97,
        {"c": Quantity(0.021, 0.002, "1/s/V^2")}, "dynamics", "nonlinear_damping", 80.0,
    )  # fmt: skip
    gap = Gap(
        4.0, 1.1, Quantity(0.98, 0.01, "1"),
        Quantity(3.0, 0.2, "deg/h"), Quantity(0.2, 0.2, "deg/h"), Quantity(700.0, 20.0, "ppm"), Quantity(12.0, 20.0, "ppm"),
    )  # fmt: skip
    cell = Cell("side_x_a1.4_1.5hz", "amplitude", "in phase with velocity", "mean", 0.6, 9.0, 11.0)
    return Diagnosis(
        device_id,
        verdict,
        "One effect." if verdict == "effects" else "Nothing beyond the noise.",
        (effect,) if verdict == "effects" else (),
        None, (cell,), (), gap, ("thermal_damping",), NextExperiment("Record a temperature step.", "makes it testable"),
        900.0, 300.0, 290, 0.02, 0.01, recordings, 12.0,
    )  # fmt: skip
