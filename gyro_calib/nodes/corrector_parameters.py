"""Parameters of ``imu_corrector``: declared with unit and range, read into checked settings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node

from ..calibration import COVARIANCE_MODES, RateErrorModel, SenseAxes
from ..errors import DataError
from ..units import DEG_H
from .correction_state import CorrectionSettings
from .gyro_input import InputNames
from .runtime import describe

__all__ = ["check_changes", "declare_parameters", "input_names", "read_settings", "sense_axes"]

_POLICIES = ("pass", "hold")

#: axes by number of gyros, when none are given
_DEFAULT_AXES: dict[int, list[float]] = {
    1: [0.0, 0.0, 1.0],
    2: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0],
    3: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
}

#: name -> default, lowest, highest, description
_NUMBERS: dict[str, tuple[float, float, float, str]] = {
    "covariance_horizon_s": (60.0, 1e-3, 1e9, "Mode horizon: time over which integrating independent samples shall be honest [s]."),
    "noise_bandwidth_hz": (0.0, 0.0, 1e6, "Noise bandwidth [Hz]: variance at rest over density squared; 0: half of the sample rate."),
    "bias_drift_sd_rad_s": (0.0, 0.0, 10.0, "How far the bias moves between calibration and use, 1 sigma [rad/s]; adds to the record's."),
    "bias_temperature_sd_rad_s_per_k": (
        -1.0,
        -1.0,
        1.0,
        "Change of the bias per kelvin away from the calibration, 1 sigma [rad/s/K]; negative: 0.5 % of the record's bias.",
    ),
    "scale_factor_temperature_sd_per_k": (
        -1.0,
        -1.0,
        1.0,
        "Change of the scale factor per kelvin away from it, 1 sigma [1/K]; negative: 150 ppm.",
    ),
    "out_of_validity_sd_factor": (10.0, 1.0, 1e6, "Factor on the sd of bias and scale factor outside the validity of the record [1]."),
    "uncalibrated_bias_sd_rad_s": (2000.0 * DEG_H, 0.0, 10.0, "Bias of an uncalibrated gyro, 1 sigma [rad/s], from its data sheet."),
    "uncalibrated_scale_factor_sd": (0.05, 0.0, 1.0, "Scale factor error of an uncalibrated gyro, 1 sigma [1], from its data sheet."),
    "uncalibrated_noise_density": (5e-5, 0.0, 10.0, "White noise of an uncalibrated gyro, one-sided [rad/s/sqrt(Hz)]: sqrt(2) ARW."),
    "rate_limit_rad_s": (0.0, 0.0, 1e4, "Raw rate of a saturated gyro [rad/s]: as fast or faster is not passed on; 0: as its driver says."),
    "join_tolerance_s": (0.005, 0.0, 10.0, "Largest difference of stamps between gyros of one message [s]."),
    "accel_max_age_s": (0.1, 0.0, 10.0, "Largest difference of stamps between rate and the acceleration passed on [s]."),
    "stream_timeout_s": (3.0, 0.1, 3600.0, "Time without a rate after which a gyro counts as silent [s]."),
}


def declare_parameters(node: Node) -> None:
    """Declare all of them; what shapes the node is read-only, what shapes a number may change at any time."""
    gyros = node.declare_parameter(
        "gyros", [""], describe("Namespaces of one to three gyros, relative to the node's; an empty one is the node's own.", read_only=True)
    ).value
    count = len(gyros)
    axes = "Sense axis of each gyro in the frame of the output, three numbers per gyro [1]; default z, or x y, or x y z."
    node.declare_parameter("axes", _DEFAULT_AXES.get(count, [0.0, 0.0, 1.0]), describe(axes, read_only=True))
    expected = "Device expected of each gyro; records of others are refused. Empty: ask the gyro's node."
    node.declare_parameter("device_ids", [""] * count, describe(expected, read_only=True))
    urls = "Stored record of each gyro: file:// or package:// URL or path; empty: $ROS_HOME/gyro_calib/<device>.yaml; 'none': no file."
    node.declare_parameter("record_urls", [""] * count, describe(urls, read_only=True))
    node.declare_parameter("gyro_node", "gyro_sim", describe("Name of a gyro's driver node, asked for its device_id.", read_only=True))
    node.declare_parameter("calibration_node", "gyro_calibration", describe("Name of a gyro's calibration node.", read_only=True))
    node.declare_parameter("frame_id", "", describe("Frame of the output; empty: that of the first gyro's rate_raw.", read_only=True))
    unsensed = "Standard deviation reported for directions that no gyro senses [rad/s]."
    node.declare_parameter("unsensed_sd_rad_s", 1000.0, describe(unsensed, lo=1e-3, hi=1e9, read_only=True))
    rate = "Sample rate of rate_raw [Hz]; 0 to measure it from the stamps."
    node.declare_parameter("sample_rate_hz", 0.0, describe(rate, lo=0.0, hi=1e6, read_only=True))
    mode = f"What the covariance holds: one of {', '.join(COVARIANCE_MODES)} (noise; bias and scale factor too; for integration)."
    node.declare_parameter("covariance_mode", "total", describe(mode))
    policy = "Without an applicable record: 'pass' raw rates with the uncalibrated_* covariance, or 'hold' the output."
    node.declare_parameter("uncalibrated_policy", "pass", describe(policy))
    for name, (default, lo, hi, description) in _NUMBERS.items():
        node.declare_parameter(name, default, describe(description, lo=lo, hi=hi))


def check_changes(changes: Sequence[Any]) -> SetParametersResult:
    """Refuse a word that is none of those allowed; ranges of numbers are kept by rclpy."""
    allowed = {"covariance_mode": COVARIANCE_MODES, "uncalibrated_policy": _POLICIES}
    for parameter in changes:
        words = allowed.get(parameter.name)
        if words and parameter.value not in words:
            return SetParametersResult(
                successful=False, reason=f"Parameter {parameter.name} must be one of {', '.join(words)}, but got {parameter.value!r}."
            )
    return SetParametersResult(successful=True)


def read_settings(node: Node) -> CorrectionSettings:
    """Read the parameters that may change.

    Raises
    ------
    DataError
        A word that is none of those allowed (an override at start-up).
    """
    result = check_changes([node.get_parameter("covariance_mode"), node.get_parameter("uncalibrated_policy")])
    if not result.successful:
        raise DataError(result.reason)
    number = {name: float(node.get_parameter(name).value) for name in _NUMBERS}
    return CorrectionSettings(
        uncalibrated=RateErrorModel.uncalibrated(
            number["uncalibrated_bias_sd_rad_s"], number["uncalibrated_scale_factor_sd"], number["uncalibrated_noise_density"]
        ),
        covariance_mode=node.get_parameter("covariance_mode").value,
        horizon_s=number["covariance_horizon_s"],
        bandwidth_hz=number["noise_bandwidth_hz"] or None,
        bias_drift_sd_rad_s=number["bias_drift_sd_rad_s"],
        bias_temperature_sd_rad_s_per_k=_stated(number["bias_temperature_sd_rad_s_per_k"]),
        scale_factor_temperature_sd_per_k=_stated(number["scale_factor_temperature_sd_per_k"]),
        out_of_validity_sd_factor=number["out_of_validity_sd_factor"],
        hold_uncalibrated=node.get_parameter("uncalibrated_policy").value == "hold",
        rate_limit_rad_s=number["rate_limit_rad_s"],
    )


def _stated(value: float) -> float | None:
    return None if value < 0.0 else value


def input_names(node: Node) -> list[tuple[InputNames, str]]:
    """Names and expected device of each gyro.

    Raises
    ------
    DataError
        Lists of different lengths, no gyro, more than three, or one twice.
    """
    prefixes = list(node.get_parameter("gyros").value)
    if not 1 <= len(prefixes) <= 3 or len(set(prefixes)) != len(prefixes):
        raise DataError(f"Parameter gyros must name one to three different namespaces, but got {prefixes}.")
    lists = {}
    for name in ("device_ids", "record_urls"):
        lists[name] = list(node.get_parameter(name).value)
        if len(lists[name]) != len(prefixes):
            raise DataError(f"Parameter {name} must have one entry for each of {len(prefixes)} gyros, but got {lists[name]}.")
    driver, calibration = node.get_parameter("gyro_node").value, node.get_parameter("calibration_node").value
    return [
        (InputNames(prefix, driver, calibration, url), device)
        for prefix, url, device in zip(prefixes, lists["record_urls"], lists["device_ids"], strict=True)
    ]


def sense_axes(node: Node) -> SenseAxes:
    """Sense axes of the gyros.

    Raises
    ------
    DataError
        Not three numbers for each gyro, or axes that do not differ.
    """
    flat, count = list(node.get_parameter("axes").value), len(node.get_parameter("gyros").value)
    if len(flat) != 3 * count:
        raise DataError(f"Parameter axes must have 3 numbers for each of {count} gyros, but got {len(flat)}: {flat}.")
    return SenseAxes(np.reshape(flat, (count, 3)), node.get_parameter("unsensed_sd_rad_s").value)
