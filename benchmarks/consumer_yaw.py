"""What a calibration is worth to a robot: yaw integrated by a stranger's program over ten simulated minutes of turning at 0.5 deg/s.

Real nodes calibrate themselves at rest (at an unknown rate, earth included); then the base turns, and test/consumer_yaw.py, which knows
only sensor_msgs/Imu and geometry_msgs/TwistStamped, integrates both rates. Gate: imu/data_raw ends 100 times or more closer than rate_raw.

python benchmarks/consumer_yaw.py [--json FILE] [--minutes 10] [--seed 1]; exit code 1 when the gate does not hold.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from gyro_calib.cli.console import print_table, progress_bar, progress_lines, write_json
from gyro_calib.cli.demo_session import unknown_rate
from gyro_calib.cli.domain import leased_domain
from gyro_calib.cli.processes import NODES, NodeGroup, ros_arguments
from gyro_calib.cli.ros_client import RosClient
from gyro_calib.cli.up import node_parameters
from gyro_calib.errors import GyroCalibError
from gyro_calib.report.table import Table

ROOT = Path(__file__).resolve().parents[1]
NAMESPACE = "gyro"
RATE_DEG_S = 0.5
GATE = 100.0


def main() -> int:
    """Calibrate, turn, integrate, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--minutes", type=float, default=10.0, help="simulated time of turning")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--speed", type=float, default=10.0, help="largest simulated time per wall time")
    parser.add_argument("--quality", default="standard", help="duration of the calibration")
    arguments = parser.parse_args()
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder, leased_domain() as domain:
        environment = {
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_HOME": folder,
            "ROS_LOG_DIR": folder,
        }
        os.environ.update(environment)
        lines: list[str] = []
        try:
            with (
                NodeGroup(environment, lambda name, line: lines.append(f"{name}: {line}")) as nodes,
                RosClient(NAMESPACE, domain) as client,
            ):
                yaw = _turn(nodes, client, arguments)
        except GyroCalibError as error:
            print("\n".join([f"consumer_yaw: {error}", *lines[-10:]]), file=sys.stderr)
            return 1
    found = _judge(yaw, arguments, time.monotonic() - began)
    print_table(_table(found))
    if arguments.json is not None:
        write_json(arguments.json, found)
    return 0 if found["passed"] else 1


def _turn(nodes: NodeGroup, client: RosClient, arguments: argparse.Namespace) -> dict[str, Any]:
    """Nodes up, calibration at rest, base turning, stranger integrating; returns what it printed."""
    simulator = {"max_realtime_factor": arguments.speed, "constant_rate_rad_s": unknown_rate(arguments.seed), "rate_raw_hz": 50.0}
    parameters = node_parameters("ring_15k", arguments.seed, 0.0, simulator=simulator, calibration={"plan_quality": arguments.quality})
    with progress_lines("starting the nodes"):
        for name, module in NODES.items():
            nodes.start(name, module, ros_arguments(NAMESPACE, parameters[name]))
        client.spin_until(lambda: client.latest is not None and client.latest.values.get("stream") == "alive", 60.0)
        accepted = client.start_run("self_calibrate", discovery_s=60.0)
    with progress_bar("self-calibration", lines=True) as report:
        client.follow_run(accepted, lambda view: report(view.fraction, view.message))
    _set_rate(client, math.radians(RATE_DEG_S))
    script = ROOT / "test" / "consumer_yaw.py"
    command = [sys.executable, str(script), "--seconds", str(60.0 * arguments.minutes)]
    with progress_lines(f"a stranger integrates {arguments.minutes:g} simulated minutes at {RATE_DEG_S} deg/s"):
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode != 0:
        raise GyroCalibError(f"Consumer must end with exit code 0, but got {done.returncode}.")
    return dict(json.loads(done.stdout))


def _set_rate(client: RosClient, rate_rad_s: float) -> None:
    """Turn the base."""
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    parameter = Parameter("constant_rate_rad_s", value=rate_rad_s).to_parameter_msg()
    response = client.call(SetParameters, "gyro_sim/set_parameters", SetParameters.Request(parameters=[parameter]))
    if not response.results[0].successful:
        raise GyroCalibError(f"Simulator must take the rate, but refused: {response.results[0].reason}")


def _judge(yaw: dict[str, Any], arguments: argparse.Namespace, elapsed_s: float) -> dict[str, Any]:
    """Errors against the truth, and the gate."""
    errors = {name: yaw[name]["yaw_deg"] - RATE_DEG_S * yaw[name]["duration_s"] for name in ("rate_raw", "imu")}
    ratio = abs(errors["rate_raw"]) / max(abs(errors["imu"]), 1e-12)
    return {
        "seed": arguments.seed,
        "elapsed_s": round(elapsed_s, 1),
        "true_rate": {"value": RATE_DEG_S, "sd": 0.0, "unit": "deg/s"},
        "duration_s": yaw["imu"]["duration_s"],
        "samples": {name: yaw[name]["samples"] for name in errors},
        "yaw_error": {name: {"value": error, "sd": 0.0, "unit": "deg"} for name, error in errors.items()},
        "times_closer": ratio,
        "gate": GATE,
        "passed": ratio >= GATE,
    }


def _table(found: dict[str, Any]) -> Table:
    rows = tuple((name, f"{found['samples'][name]}", f"{found['yaw_error'][name]['value']:+.4f}") for name in ("rate_raw", "imu"))
    caption = f"{found['times_closer']:.0f} times closer, wanted {GATE:g}: {'pass' if found['passed'] else 'FAIL'}"
    return Table(
        f"Yaw after {found['duration_s']:.0f} s at {RATE_DEG_S} deg/s", ("integrated from", "samples", "error [deg]"), rows, caption
    )


if __name__ == "__main__":
    sys.exit(main())
