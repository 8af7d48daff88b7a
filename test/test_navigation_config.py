"""The sample configurations of robot_localization, imu_tools and Nav2: they fit each other, and their numbers do what is said."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from calibration_samples import make_record
from numpy.typing import NDArray

from gyro_calib.calibration import CovarianceModel, RateErrorModel

ROOT = Path(__file__).resolve().parents[1]
#: as robot_localization orders its states
STATES = ["x", "y", "z", "roll", "pitch", "yaw", "vx", "vy", "vz", "vroll", "vpitch", "vyaw", "ax", "ay", "az"]
#: what robot_localization does without a matrix: yaw, vyaw
DEFAULT_NOISE = (0.06, 0.02)
#: it raises smaller variances of a measurement to this one
LEAST_VARIANCE = 1e-9


def parameters(file: str, node: str) -> dict[str, Any]:
    content = yaml.safe_load((ROOT / "config" / file).read_text(encoding="utf-8"))
    for part in node.split("."):
        content = content[part]
    return dict(content["ros__parameters"])


def noise_of(name: str) -> float:
    matrix = np.reshape(parameters("robot_localization_ekf.yaml", "ekf_filter_node")["process_noise_covariance"], (15, 15))
    assert np.count_nonzero(matrix - np.diag(np.diag(matrix))) == 0
    return float(matrix[STATES.index(name), STATES.index(name)])


def filtered_yaw(rates: NDArray[np.float64], variance: float, rate_hz: float, noise: tuple[float, float]) -> tuple[float, float]:
    """Yaw and its variance as robot_localization finds them: states yaw and vyaw, diagonal process noise, one correction a sample."""
    dt, variance = 1.0 / rate_hz, max(variance, LEAST_VARIANCE)
    state, covariance = np.zeros(2), np.diag([1e-9, 1e-9])  # as it begins
    step = np.array([[1.0, dt], [0.0, 1.0]])
    for rate in rates:
        state = step @ state
        covariance = step @ covariance @ step.T + dt * np.diag(noise)
        gain = covariance[:, 1] / (covariance[1, 1] + variance)
        state = state + gain * (rate - state[1])
        left = np.eye(2) - np.outer(gain, [0.0, 1.0])
        covariance = left @ covariance @ left.T + variance * np.outer(gain, gain)
    return float(state[0]), float(covariance[0, 0])


@pytest.fixture(scope="module")
def found() -> dict[str, float]:
    """A minute of turning and standing, 100 Hz, with the variance of the advised mode for a calibration to 1 deg/h."""
    advised = parameters("robot_localization_ekf.yaml", "/**/imu_corrector")
    rate_hz, duration_s = 100.0, advised["covariance_horizon_s"]
    model = RateErrorModel.from_record(make_record(validity={}))
    coefficients = {
        mode: model.variance_coefficients(CovarianceModel(mode, rate_hz, horizon_s=duration_s))[0]
        for mode in ("white", advised["covariance_mode"])
    }
    claimed, white = coefficients[advised["covariance_mode"]], coefficients["white"]
    constant = (model.bias_sd_rad_s / model.scale_factor) ** 2
    times = np.arange(round(duration_s * rate_hz)) / rate_hz
    rates = 0.5 * np.sin(np.pi * times / duration_s) ** 2
    yaw, variance = filtered_yaw(rates, claimed, rate_hz, (noise_of("yaw"), noise_of("vyaw")))
    _, default = filtered_yaw(rates, claimed, rate_hz, DEFAULT_NOISE)
    honest = white * duration_s / rate_hz + constant * duration_s**2
    return {"yaw": yaw, "true": 0.25 * duration_s, "variance": variance, "honest": honest, "default": default}


def test_the_advised_numbers_let_the_gyro_decide_how_sure_the_yaw_is(found: dict[str, float]) -> None:
    assert found["variance"] == pytest.approx(found["honest"], rel=0.05)
    assert found["default"] > 1e5 * found["honest"]


def test_the_advised_numbers_follow_a_turn(found: dict[str, float]) -> None:
    assert abs(found["yaw"] - found["true"]) < 0.1 * np.sqrt(found["honest"])


def test_frames_and_topics_of_the_files_are_the_same() -> None:
    ekf = parameters("robot_localization_ekf.yaml", "ekf_filter_node")
    assert ekf["world_frame"] == ekf["odom_frame"]
    assert ekf["publish_tf"]
    assert parameters("nav2_odometry.yaml", "local_costmap.local_costmap")["global_frame"] == ekf["odom_frame"]
    assert parameters("nav2_odometry.yaml", "behavior_server")["local_frame"] == ekf["odom_frame"]
    assert parameters("nav2_odometry.yaml", "amcl")["odom_frame_id"] == ekf["odom_frame"]
    for node in ("bt_navigator", "behavior_server", "local_costmap.local_costmap"):
        assert parameters("nav2_odometry.yaml", node)["robot_base_frame"] == ekf["base_link_frame"]
    for node in ("bt_navigator", "controller_server", "velocity_smoother"):
        assert parameters("nav2_odometry.yaml", node)["odom_topic"] == "/odometry/filtered"


def test_the_readme_names_every_file_and_no_other() -> None:
    section = (ROOT / "README.md").read_text(encoding="utf-8").split("## In a navigation stack")[1].split("\n## ")[0]
    named = set(re.findall(r"config/(\w+\.yaml)", section))
    assert named == {path.name for path in (ROOT / "config").glob("*.yaml")} - {"gyro_calib.yaml"}


@pytest.mark.ros
def test_the_corrector_takes_the_advised_mode(ros: Any, tmp_path: Path) -> None:
    from gyro_calib.nodes.imu_corrector_node import ImuCorrector

    file = str(ROOT / "config" / "robot_localization_ekf.yaml")
    node = ImuCorrector(namespace="/gyro", cli_args=["--ros-args", "--params-file", file])
    try:
        advised = parameters("robot_localization_ekf.yaml", "/**/imu_corrector")
        assert {name: node.get_parameter(name).value for name in advised} == advised
    finally:
        node.destroy_node()


def test_nothing_in_the_files_is_read_as_a_boolean_by_mistake() -> None:
    """ROS's parser takes bare y, n, on, off, yes and no for booleans, PyYAML not all of them."""
    for path in (ROOT / "config").glob("*.yaml"):
        for line in path.read_text(encoding="utf-8").splitlines():
            assert not re.search(r":\s+(y|n|on|off|yes|no)\s*(#.*)?$", line, flags=re.IGNORECASE), f"{path.name}: {line}"
