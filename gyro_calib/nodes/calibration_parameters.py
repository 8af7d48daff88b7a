"""Parameters of the calibration node: declared with range and unit, checked, read as one value."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import SetParametersResult

from ..errors import DataError
from ..experiments import QUALITIES, Limits
from .runtime import describe

__all__ = ["CalibrationSettings", "check_parameters", "declare_parameters", "read_parameters"]

_LIMITS = Limits()


@dataclass(frozen=True)
class CalibrationSettings:
    """Parameters as one value; the text beside each is in :func:`declare_parameters`."""

    gyro_node: str
    device_id: str
    record_url: str
    frame_id: str
    stream_timeout_s: float
    temperature_limit_k: float
    base_rate_limit_rad_s: float
    plan_quality: str
    autosave: bool
    apply_compensation: bool
    artifacts_dir: str
    fleet: str

    @property
    def limits(self) -> Limits:
        """Abort conditions of a run."""
        return Limits(self.temperature_limit_k, self.base_rate_limit_rad_s)


def declare_parameters(node: Any) -> CalibrationSettings:
    """Declare all parameters on ``node``; returns their values.

    Raises
    ------
    DataError
        An override that names no quality.
    """
    qualities = ", ".join(QUALITIES)
    fixed = {
        "gyro_node": ("gyro_sim", "Name of the gyro's driver, in the namespace of this node"),
        "device_id": ("", "Only device that is accepted; empty: whichever the driver says"),
        "record_url": ("", "Where records live: file:// or package:// URL or path; empty: $ROS_HOME/gyro_calib/<device>.yaml"),
        "frame_id": ("gyro", "Frame of the gyro in the headers of bias and scale factor; its z is the sense axis"),
    }
    for name, (default, text) in fixed.items():
        node.declare_parameter(name, default, describe(text, read_only=True))
    timeout = describe("Steady time without a block after which the stream counts as stopped [s]", lo=0.1, hi=60.0, read_only=True)
    node.declare_parameter("stream_timeout_s", 5.0, timeout)
    node.declare_parameter(
        "temperature_limit_k",
        _LIMITS.temperature_k,
        describe("Temperature excursion since the start of a run that ends it [K]", lo=0.01, hi=100.0),
    )
    node.declare_parameter(
        "base_rate_limit_rad_s",
        _LIMITS.base_rate_rad_s,
        describe("Motion of the base during a run that ends it [rad/s]", lo=1e-6, hi=10.0),
    )
    node.declare_parameter("plan_quality", "standard", describe(f"Durations of the next runs, one of {qualities}"))
    node.declare_parameter("autosave", True, describe("Store the record of a successful run at once; otherwise ~/save does"))
    text = "Put the drive compensation of the calibration in force on a gyro that starts without one, and on revert; otherwise that is said"
    node.declare_parameter("apply_compensation", True, describe(text))
    node.declare_parameter("artifacts_dir", "", describe("Folder for the recordings of each run, <run id>/campaign.h5; empty: not kept"))
    text = "File of gyro-calib fleet, of healthy units of this kind, for diagnose_gap; empty: a unit is judged as any device"
    node.declare_parameter("fleet", "", describe(text))
    settings = read_parameters(node)
    _check_quality(settings.plan_quality)
    return settings


def read_parameters(node: Any) -> CalibrationSettings:
    """Present values."""
    return CalibrationSettings(**{name: node.get_parameter(name).value for name in CalibrationSettings.__dataclass_fields__})


def check_parameters(parameters: Iterable[Any]) -> SetParametersResult:
    """Refuse what descriptors cannot: a quality that does not exist. Changes count from the next run on."""
    for parameter in parameters:
        if parameter.name == "plan_quality":
            try:
                _check_quality(parameter.value)
            except DataError as error:
                return SetParametersResult(successful=False, reason=str(error))
    return SetParametersResult(successful=True)


def _check_quality(name: str) -> None:
    if name not in QUALITIES:
        raise DataError(f"Parameter plan_quality must be one of {', '.join(QUALITIES)}, but got {name!r}.")
