"""The demonstration itself: nodes up, one service call, rates before and after."""

from __future__ import annotations

import collections
import contextlib
import os
import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..calibration.record import CalibrationRecord
from ..device import Device, draw_unit, load_device
from ..errors import GyroCalibError
from ..recording.command import Command, Setpoints
from ..report.comparison import Comparison, compare
from ..simulation.truth import truth_of
from ..units import DEG_H, EARTH_RATE_RAD_S
from .console import progress_bar, progress_lines
from .domain import leased_domain
from .processes import NODES, NodeGroup, ros_arguments
from .rate_capture import CapturedRate, RateCapture
from .ros_client import RosClient, RunFailed
from .up import node_parameters

__all__ = ["DemoOutcome", "DemoSettings", "play", "unknown_rate"]

NAMESPACE = "gyro"
#: device time for which the rates are listened to after the calibration [s]
LISTEN_S = 60.0
#: stamp of device time 0 when the simulator is the source of /clock [s]
_CLOCK_EPOCH_S = 1.0
_STARTUP_S = 60.0
_LAST_LINES = 12


@dataclass(frozen=True)
class DemoSettings:
    """What is demonstrated: device description, seed, plan quality, bound of simulated per wall time, output directory."""

    device: str
    seed: int
    quality: str
    max_speed: float
    directory: Path


@dataclass(frozen=True)
class DemoOutcome:
    """What came of it.

    Parameters
    ----------
    device : Device
        The unit as it truly is.
    true_rate_rad_s : float
        Constant input rate that the calibration did not know.
    record : CalibrationRecord
        As the calibration node published it.
    run_id : str
        Of the run; its recordings are in ``<directory>/<run_id>``.
    comparison : Comparison
        Before, after, error.
    raw, calibrated : CapturedRate
        Rates after the calibration.
    simulated_s : float
        Device time.
    """

    device: Device
    true_rate_rad_s: float
    record: CalibrationRecord
    run_id: str
    comparison: Comparison
    raw: CapturedRate
    calibrated: CapturedRate
    simulated_s: float


def unknown_rate(seed: int) -> float:
    """Constant input rate that nobody tells the calibration [rad/s]: earth rate at some latitude and a turning base of up to 50 deg/h."""
    rng = np.random.default_rng([seed, 0xEA27])
    latitude = np.arcsin(rng.uniform(-1.0, 1.0))
    return float(EARTH_RATE_RAD_S * np.sin(latitude) + rng.uniform(-50.0, 50.0) * DEG_H)


def play(settings: DemoSettings) -> DemoOutcome:
    """Run the demonstration.

    Raises
    ------
    GyroCalibError
        A node ended, the run failed, or ROS 2 is not installed; the text ends with the last lines of the nodes' log.
    """
    device = draw_unit(load_device(settings.device), settings.seed)
    true_rate = unknown_rate(settings.seed)
    settings.directory.mkdir(parents=True, exist_ok=True)
    with leased_domain() as domain, _Log(settings.directory / "nodes.log") as log:
        environment = {
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_HOME": str(settings.directory / "ros_home"),
            "ROS_LOG_DIR": str(settings.directory / "ros_log"),
        }
        try:
            with NodeGroup(environment, log.write) as nodes, _localhost_only(), RosClient(NAMESPACE, domain) as client:
                _start(nodes, settings, true_rate)
                return _session(settings, nodes, client, device, true_rate)
        except GyroCalibError as error:
            raise type(error)(f"{error}\nLast lines of {log.path}:\n{log.tail()}") from error


def _session(settings: DemoSettings, nodes: NodeGroup, client: RosClient, device: Device, true_rate: float) -> DemoOutcome:
    def still_there() -> None:
        if (ended := nodes.ended()) is not None:
            raise RunFailed(f"Node {ended[0]} must keep running, but ended with exit code {ended[1]}.")

    records = _Records(client)
    with progress_lines("starting the nodes"):
        _await_ready(client, still_there)
        accepted = client.start_run("self_calibrate", discovery_s=_STARTUP_S)
    with progress_bar("self-calibration", lines=True) as report:
        view = client.follow_run(accepted, lambda seen: report(seen.fraction, seen.message), still_there)
    record = records.wait_for(view.values.get("calibration", ""), device.device_id, still_there)
    capture = RateCapture(client)
    with progress_bar("listening to the rate", lines=True) as report:
        raw, calibrated = capture.collect(LISTEN_S, lambda share: report(share, ""), still_there)
    mission = Command(record.mode, setpoints=Setpoints(device.factory_data.nominal_amplitude_v))
    before = truth_of(device, mission, true_rate)
    truth = truth_of(device, replace(mission, compensation=record.compensation), true_rate)
    return DemoOutcome(
        device=device,
        true_rate_rad_s=true_rate,
        record=record,
        run_id=view.run,
        comparison=compare(truth, true_rate, record.bias, record.scale_factor, record.rate, before=before),
        raw=raw,
        calibrated=calibrated,
        simulated_s=float(raw.time_s[-1]) - _CLOCK_EPOCH_S,
    )


def _start(nodes: NodeGroup, settings: DemoSettings, true_rate: float) -> None:
    parameters = node_parameters(
        settings.device,
        settings.seed,
        0.0,
        simulator={
            "max_realtime_factor": settings.max_speed,
            "constant_rate_rad_s": true_rate,
            "clock_epoch_s": _CLOCK_EPOCH_S,
        },
        calibration={"plan_quality": settings.quality, "artifacts_dir": str(settings.directory)},
    )
    for name, module in NODES.items():
        nodes.start(name, module, ros_arguments(NAMESPACE, parameters[name]))


def _await_ready(client: RosClient, still_there: Any) -> None:
    """The calibration node has found its gyro when the status says that the stream is alive and names the device."""

    def ready() -> bool:
        still_there()
        view = client.latest
        return view is not None and view.values.get("stream") == "alive" and bool(view.values.get("device_id"))

    if not client.spin_until(ready, _STARTUP_S):
        raise RunFailed(f"The nodes must find each other within {_STARTUP_S:g} s, but did not.")


class _Records:
    """Latched ``gyro_calibration/calibration``."""

    def __init__(self, client: RosClient) -> None:
        from diagnostic_msgs.msg import DiagnosticArray

        from ..nodes.runtime import LATCHED_QOS

        self._client = client
        self._message: Any = None
        client.node.create_subscription(DiagnosticArray, "gyro_calibration/calibration", self._on_message, LATCHED_QOS)

    def wait_for(self, record_id: str, device_id: str, still_there: Any) -> CalibrationRecord:
        """The record of that id, as published."""
        from ..nodes.calibration_messages import record_from_calibration

        def found() -> CalibrationRecord | None:
            still_there()
            record = record_from_calibration(self._message, device_id=device_id) if self._message is not None else None
            return record if record is not None and record.record_id == record_id else None

        if not self._client.spin_until(lambda: found() is not None, 10.0):
            raise RunFailed(f"Record {record_id!r} must be published on ~/calibration, but was not.")
        record = found()
        assert record is not None
        return record

    def _on_message(self, message: Any) -> None:
        self._message = message


class _Log:
    """The nodes' output in a file, its last lines at hand."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        # by node: what the others print while they are ended must not push out why the first one did
        self._last: dict[str, collections.deque[str]] = {}

    def __enter__(self) -> _Log:
        self._file = self.path.open("w", encoding="utf-8")
        return self

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._file.close()

    def write(self, name: str, line: str) -> None:
        with self._lock:
            self._last.setdefault(name, collections.deque(maxlen=_LAST_LINES)).append(f"  {name}: {line}")
            if not self._file.closed:
                print(f"{name}: {line}", file=self._file, flush=True)

    def tail(self) -> str:
        with self._lock:
            return "\n".join(line for lines in self._last.values() for line in lines)


@contextlib.contextmanager
def _localhost_only() -> Iterator[None]:
    """This process's own node must not be seen outside either; the environment is the only way to say so."""
    name = "ROS_AUTOMATIC_DISCOVERY_RANGE"
    before = os.environ.get(name)
    os.environ[name] = "LOCALHOST"
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before
