"""Records for tests of the calibration package and of the nodes that carry them."""

from __future__ import annotations

from typing import Any

from gyro_calib.calibration import CalibrationRecord
from gyro_calib.quantity import Quantity
from gyro_calib.units import DEG_H, PPM


def make_record(device_id: str = "ring_15k-0007", **changes: Any) -> CalibrationRecord:
    """A record like the one that self-calibration makes: bias 1200 +/- 1 deg/h, scale factor 1.03 +/- 30 ppm."""
    fields: dict[str, Any] = {
        "record_id": "unset",
        "device_id": device_id,
        "created_utc": "2026-03-01T12:00:00Z",
        "method": "sideband",
        "mode": "ftr_x",
        "bias": Quantity(1200.0 * DEG_H, 1.0 * DEG_H, "rad/s"),
        "scale_factor": Quantity(1.03, 30.0 * PPM, "1"),
        "bias_scale_covariance": 0.2 * DEG_H * 30.0 * PPM,
        "rate_noise_density": Quantity(2.1e-5, 1e-7, "rad/s/sqrt(Hz)"),
        "rate": Quantity(15.0 * DEG_H, 1.0 * DEG_H, "rad/s"),
        "temperature_degc": Quantity(25.0, 0.1, "degC"),
        "bias_by_axis": {"x": Quantity(1200.0 * DEG_H, 1.0 * DEG_H, "rad/s"), "y": Quantity(-900.0 * DEG_H, 1.5 * DEG_H, "rad/s")},
        "scale_factor_by_axis": {"x": Quantity(0.51, 2e-5, "V/(rad/s)")},
        "parameters": {"A_yx_re": Quantity(-0.0131, 1e-6, "1/s"), "pickoff_phase": Quantity(0.0, float("inf"), "rad")},
        "operating_point": {"amplitude_v": 1.0, "ref_freq_hz": 15000.25},
        "validity": {"temperature_min_degc": 20.0, "temperature_max_degc": 30.0, "max_age_s": 86400.0},
        "not_observable": ("pickoff_phase",),
        "provenance": {"run_id": "run-1", "steps": 12, "durations_s": [20.0, 1e-7], "nested": {"software": "0.1.0", "done": True}},
    }
    record = CalibrationRecord(**{**fields, **changes})
    return record if "record_id" in changes else record.with_new_id()
