"""A planar EKF that knows only standard messages, behind a real corrector, against truth: which covariance mode it can believe."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibration_samples import make_record
from numpy.typing import NDArray
from scipy.stats import chi2

pytest.importorskip("rclpy")

from navigation_trips import TripDriver, draw_motion, draw_raw_rate, nees
from ros_helpers import RosSession, wait_for

from gyro_calib.calibration import CovarianceModel, RateErrorModel
from gyro_calib.quantity import Quantity
from gyro_calib.units import DEG_H, PPM

ROOT = Path(__file__).resolve().parents[1]
RATE_HZ = 5.0
HORIZON_S = 20.0
TRIPS = 30
MODES = ("white", "total", "horizon")
#: a calibration that leaves more unsure than the noise of one sample: bias 30 deg/h, scale factor 300 ppm
RECORD = make_record(
    validity={},
    bias=Quantity(1200.0 * DEG_H, 30.0 * DEG_H, "rad/s"),
    scale_factor=Quantity(1.03, 300.0 * PPM, "1"),
    bias_scale_covariance=0.0,
)

Figures = dict[str, dict[str, NDArray[np.float64]]]


def mean_limits(dimension: int, trips: int = TRIPS) -> tuple[float, float]:
    """Mean of squared normalised errors of honest claims, one a trip: 99.9 % lie between."""
    low, high = chi2.ppf([0.0005, 0.9995], dimension * trips) / trips
    return float(low), float(high)


def within(figures: NDArray[np.float64], dimension: int) -> bool:
    low, high = mean_limits(dimension)
    return low < figures.mean() < high


@pytest.fixture(scope="module")
def figures(ros_domain: int, tmp_path_factory: pytest.TempPathFactory) -> Figures:
    """Squared normalised errors of every mode at the end of each trip, and at a quarter of it."""
    from ros_processes import start_node

    folder = tmp_path_factory.mktemp("ekf")
    found: dict[str, dict[str, list[float]]] = {mode: {} for mode in MODES}
    with RosSession() as session, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_HOME", str(folder))
        patch.setenv("ROS_LOG_DIR", str(folder))
        settings: dict[str, Any] = {"covariance_horizon_s": HORIZON_S, "sample_rate_hz": RATE_HZ, "device_ids": [RECORD.device_id]}
        processes = [
            start_node("imu_corrector_node", folder=folder, namespace="/robot", parameters=settings, remap={"imu/data_raw": "imu/yaw"}),
            start_node("consumer_ekf.py", folder=folder, namespace="/robot", remap={"imu": "imu/yaw", "odom": "wheels/odom"}),
        ]
        try:
            node = session.node("driver", "/robot")
            driver = TripDriver(node, "imu_corrector")
            wait_for(lambda: driver.ready() or not all(p.running for p in processes), 60.0, "discovery")
            assert all(process.running for process in processes), "\n".join(map(str, processes))
            driver.calibrate(RECORD)
            for mode in MODES:
                driver.set(covariance_mode=mode)
                for seed in range(TRIPS):
                    rng = np.random.default_rng([61, seed])  # the same trips in every mode
                    trip = draw_motion(rng, HORIZON_S, RATE_HZ)
                    claims = driver.drive(trip, draw_raw_rate(rng, RECORD, trip))
                    early = nees(trip, claims, len(trip.times_s) // 4)
                    row = nees(trip, claims, -1) | {f"{name} early": value for name, value in early.items()}
                    for name, value in row.items():
                        found[mode].setdefault(name, []).append(value)
        finally:
            stopped = [process.stop() for process in processes]
    assert all(stopped)
    return {mode: {name: np.array(values) for name, values in rows.items()} for mode, rows in found.items()}


@pytest.mark.ros
def test_the_stranger_knows_nothing_of_this_package() -> None:
    text = (ROOT / "test" / "consumer_ekf.py").read_text(encoding="utf-8")
    imported = set(re.findall(r"^(?:from|import) (\w+)", text, flags=re.MULTILINE))
    assert imported == {"contextlib", "math", "sys", "collections", "numpy", "rclpy", "geometry_msgs", "nav_msgs", "sensor_msgs"}


@pytest.mark.ros
def test_total_is_honest_about_the_rate_and_white_is_not(figures: Figures) -> None:
    assert within(figures["total"]["rate"], 1)
    assert figures["white"]["rate"].mean() > 3.0 * mean_limits(1)[1]


@pytest.mark.ros
def test_horizon_makes_the_yaw_of_a_filter_honest_at_its_horizon(figures: Figures) -> None:
    assert within(figures["horizon"]["yaw"], 1)
    # a pose has three numbers: no more wrong than it says; less, because an error that stays is not the random walk that is claimed
    assert figures["horizon"]["pose"].mean() < mean_limits(3)[1]
    # before the horizon it is on the safe side
    assert figures["horizon"]["yaw early"].mean() < 0.6
    assert figures["horizon"]["pose early"].mean() < mean_limits(3)[1]


@pytest.mark.ros
def test_a_filter_that_integrates_white_or_total_is_overconfident(figures: Figures) -> None:
    """What one sample's error has in common with the next one's does not average out: by the analysis, 2000 and 95 times too sure."""
    model = RateErrorModel.from_record(RECORD)
    white, total = (model.variance_coefficients(CovarianceModel(mode, RATE_HZ))[0] for mode in ("white", "total"))
    true_variance = white * HORIZON_S / RATE_HZ + (total - white) * HORIZON_S**2
    for mode, claimed in (("white", white), ("total", total)):
        expected = true_variance / (claimed * HORIZON_S / RATE_HZ)
        assert expected > 50.0
        low, high = mean_limits(1)
        # the scale factor adds a little to the bias
        assert low * expected < figures[mode]["yaw"].mean() < 1.2 * high * expected
