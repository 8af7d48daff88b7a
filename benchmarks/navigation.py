"""How far a planar EKF can believe the covariance of imu/data_raw: squared normalised errors (NEES) of each covariance mode, against truth.

Real processes: imu_corrector, and test/consumer_ekf.py, which knows only standard messages. Two kinds of gyro: drawn ones, wrong by what a
record leaves unsure; and simulated units at carrier level that have calibrated themselves, each driven with its own record. The mean of an
honest claim's NEES is 1. Gates, the 99.9 % of honest claims: the yaw of mode horizon at its horizon, and the rate of mode total for drawn
gyros; the noise of the simulated ring rises with frequency, so that one sample of it is noisier than its record's density says.

python benchmarks/navigation.py [--quick] [--seeds 20] [--json FILE]
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from common import Options, Outcome, main
from numpy.typing import NDArray
from ros_room import ros_room
from scipy.interpolate import CubicSpline
from scipy.stats import chi2

from gyro_calib.calibration import CalibrationRecord, record_from_result
from gyro_calib.cli.console import print_table, progress_bar
from gyro_calib.device import draw_unit, load_device
from gyro_calib.estimation import calibrate
from gyro_calib.experiments import SimulatedInstrument, mission_mode, run_plan, self_calibration_plan
from gyro_calib.quantity import Quantity
from gyro_calib.recording.command import Command
from gyro_calib.recording.rate import raw_rate
from gyro_calib.report.table import Table
from gyro_calib.simulation import GyroSimulator
from gyro_calib.study import Gate
from gyro_calib.units import EARTH_RATE_RAD_S, deg_h

if TYPE_CHECKING:
    from navigation_trips import Trip, TripDriver

ROOT = Path(__file__).resolve().parents[1]
MODES = ("white", "total", "horizon")
RATE_HZ = 2.0
HORIZON_S = 120.0
#: each trip goes on for twice the horizon
MOMENTS = {"at the horizon": 1.0, "at twice the horizon": 2.0}
SETTLE_S = 5.0

FloatArray = NDArray[np.float64]
#: moment -> figure (rate, yaw, pose) -> one number a trip
Squares = dict[str, dict[str, list[float]]]


def measure(options: Options) -> Outcome:
    """Both kinds of gyro in every mode."""
    sys.path.insert(0, str(ROOT / "test"))
    units = options.seeds or (4 if options.quick else 20)
    drawn = 10 if options.quick else 100
    with progress_bar(f"{units} units calibrate themselves and drive", lines=True) as report:
        calibrated = [_progress(report, k, units, lambda k=k: calibrated_unit(k)) for k in range(units)]
    typical = calibrated[0][0]
    figures: dict[str, dict[str, Squares]] = {}
    with _processes() as driver:
        figures["drawn"] = _drive_all(driver, "drawn gyros", [(typical, *_drawn(typical, seed)) for seed in range(drawn)])
        figures["calibrated"] = _drive_all(driver, "calibrated units", calibrated)
    for name, by_mode in figures.items():
        print_table(_table(name, by_mode))
    sd = float(np.median([deg_h(record.bias.sd) for record, _, _ in calibrated]))
    means = {name: {mode: _means(squares) for mode, squares in by_mode.items()} for name, by_mode in figures.items()}
    return Outcome(_gates(figures), {"units": units, "drawn": drawn, "bias_sd_deg_h": sd, "horizon_s": HORIZON_S, "mean_nees": means})


def calibrated_unit(seed: int) -> tuple[CalibrationRecord, Trip, FloatArray]:
    """A unit's own record, a trip, and its raw rate on it, shape (n,) [rad/s]; carrier level, its bias wanders on while it drives."""
    from navigation_trips import draw_motion

    simulator = GyroSimulator(draw_unit(load_device("ring_15k"), seed), rng=np.random.default_rng([seed, 71]), fidelity="carrier")
    standing = float(np.random.default_rng([seed, 72]).uniform(-1.0, 1.0)) * EARTH_RATE_RAD_S
    campaign = run_plan(SimulatedInstrument(simulator, standing), self_calibration_plan(simulator.factory, quality="quick"))
    mode = mission_mode(simulator.factory)
    record = record_from_result(calibrate(campaign, with_convergence=False), campaign, run_id=f"unit-{seed}", mode=mode)
    trip = draw_motion(np.random.default_rng([seed, 73]), 2.0 * HORIZON_S, RATE_HZ)
    command = Command(mode)
    simulator.configure(command)
    # each sample is the mean of the rows around its stamp
    per_sample = round(simulator.sample_rate_hz / RATE_HZ)
    simulator.advance(SETTLE_S, float(trip.rate_rad_s[0]))
    count = per_sample * trip.times_s.size
    times = (np.arange(count) + 0.5) / simulator.sample_rate_hz - 0.5 / RATE_HZ
    rows = simulator.advance(count / simulator.sample_rate_hz, CubicSpline(trip.times_s, trip.rate_rad_s)(times))
    raw = raw_rate(rows, command, simulator.factory).reshape(-1, per_sample)
    return _anonymous(record), trip, np.nanmean(raw, axis=1)


def _drawn(record: CalibrationRecord, seed: int) -> tuple[Trip, FloatArray]:
    from navigation_trips import draw_motion, draw_raw_rate

    rng = np.random.default_rng([seed, 74])
    trip = draw_motion(rng, 2.0 * HORIZON_S, RATE_HZ)
    return trip, draw_raw_rate(rng, record, trip)


def _anonymous(record: CalibrationRecord) -> CalibrationRecord:
    """The record under one name for all units: the corrector sees one gyro that is calibrated again and again."""
    return replace(record, device_id="navigation", validity={}).with_new_id()


def _progress(report: Callable[[float, str], None], k: int, count: int, work: Callable[[], Any]) -> Any:
    report(k / count, f"{k} of {count}")
    return work()


@contextlib.contextmanager
def _processes() -> Iterator[TripDriver]:
    """Corrector and EKF in a ROS domain of their own, and the driver between them."""
    from navigation_trips import TripDriver
    from ros_helpers import RosSession
    from ros_processes import start_node, wait_for

    with ros_room() as folder:
        settings = {"covariance_horizon_s": HORIZON_S, "sample_rate_hz": RATE_HZ, "device_ids": ["navigation"]}
        place: dict[str, Any] = {"folder": folder, "namespace": "/robot"}
        processes = [
            start_node("imu_corrector_node", parameters=settings, **place),
            start_node("consumer_ekf.py", remap={"imu": "imu/data_raw", "odom": "wheels/odom"}, **place),
        ]
        try:
            with RosSession() as session:
                driver = TripDriver(session.node("driver", "/robot"), "imu_corrector")
                wait_for(driver.ready, 60.0, "the processes")
                yield driver
        finally:
            for process in processes:
                process.stop()


def _drive_all(driver: TripDriver, title: str, trips: list[tuple[CalibrationRecord, Trip, FloatArray]]) -> dict[str, Squares]:
    """Every trip in every mode."""
    from navigation_trips import nees

    found: dict[str, Squares] = {mode: {moment: {} for moment in MOMENTS} for mode in MODES}
    with progress_bar(title, lines=True) as report:
        for number, (record, trip, raw) in enumerate(trips):
            driver.calibrate(record)
            for mode in MODES:
                driver.set(covariance_mode=mode)
                claims = driver.drive(trip, raw)
                for moment, horizons in MOMENTS.items():
                    for name, value in nees(trip, claims, round(horizons * HORIZON_S * RATE_HZ)).items():
                        found[mode][moment].setdefault(name, []).append(value)
            report((number + 1) / len(trips), f"{number + 1} of {len(trips)}")
    return found


def _means(squares: Squares) -> dict[str, dict[str, float]]:
    return {moment: {name: float(np.mean(values)) for name, values in rows.items()} for moment, rows in squares.items()}


def _table(name: str, by_mode: dict[str, Squares]) -> Table:
    rows = [
        (mode, moment, *(f"{found[figure]:.3g}" for figure in ("rate", "yaw", "pose")))
        for mode, squares in by_mode.items()
        for moment, found in _means(squares).items()
    ]
    return Table(f"Mean NEES, {name} gyros; honest: 1, 1, 3", ("mode", "moment", "rate", "yaw", "pose"), tuple(rows))


def _gates(figures: dict[str, dict[str, Squares]]) -> list[Gate]:
    gates = []
    for name, by_mode in figures.items():
        for mode, figure in (("horizon", "yaw"), ("total", "rate")):
            values = by_mode[mode]["at the horizon"][figure]
            low, high = (float(limit) / len(values) for limit in chi2.ppf([0.0005, 0.9995], len(values)))
            limits = {} if (name, figure) == ("calibrated", "rate") else {"lower": low, "upper": high}
            gates.append(Gate(f"{name}: NEES of the {figure}, {mode}", _mean(values), **limits))
        for mode in ("white", "total"):
            gates.append(Gate(f"{name}: NEES of the yaw, {mode}", _mean(by_mode[mode]["at the horizon"]["yaw"])))
    return gates


def _mean(values: list[float]) -> Quantity:
    return Quantity(float(np.mean(values)), float(np.std(values) / np.sqrt(len(values))), "1")


if __name__ == "__main__":
    sys.exit(main("navigation", measure))
