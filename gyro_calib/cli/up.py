"""Start simulator, calibration and corrector as ROS 2 nodes, without a launch system; Ctrl-C ends them."""

from __future__ import annotations

import argparse
import signal
import sys
import time
from pathlib import Path
from typing import Any

from .console import non_negative_int


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "--device", default="ring_15k", metavar="NAME", help="device description: a YAML file, or the name of a packaged one"
    )
    parser.add_argument("--seed", type=non_negative_int, metavar="N", help="draw a unit of the design; without it the design itself")
    parser.add_argument("--namespace", default="gyro", metavar="NS", help="namespace of the three nodes")
    parser.add_argument(
        "--realtime-factor", type=float, default=1.0, metavar="F", help="1: wall clock; 0: as fast as possible, with /clock"
    )
    parser.add_argument("--no-sim", action="store_true", help="only calibration and corrector, for a real gyro's driver")


def node_parameters(
    device: str,
    seed: int | None,
    realtime_factor: float,
    *,
    simulator: dict[str, Any] | None = None,
    calibration: dict[str, Any] | None = None,
) -> dict[str, dict[str, Any]]:
    """Parameters of each node by name.

    Parameters
    ----------
    device, seed
        Of the simulated unit; a path is made absolute.
    realtime_factor : float
        Anything but 1 makes the simulator the source of ``/clock``.
    simulator, calibration : dict or None
        Further parameters.
    """
    source = str(Path(device).resolve()) if Path(device).is_file() else device
    clock = {"use_sim_time": realtime_factor != 1.0}
    unit = {"device": source, "realtime_factor": realtime_factor} | ({} if seed is None else {"seed": seed})
    return {
        "gyro_sim": unit | (simulator or {}),
        "gyro_calibration": clock | (calibration or {}),
        "imu_corrector": dict(clock),
    }


def run(arguments: argparse.Namespace) -> int:
    """Start, forward logs, end together."""
    from ..device import load_device
    from .processes import NODES, NodeGroup, ros_arguments

    if not arguments.no_sim:
        load_device(arguments.device)  # a wrong name is said at once, not by a node that ends
    # a shell starts what it puts into the background with SIGINT ignored, and a supervisor ends it by SIGTERM: both end the nodes in order
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    parameters = node_parameters(arguments.device, arguments.seed, arguments.realtime_factor)
    wanted = {name: module for name, module in NODES.items() if not (arguments.no_sim and name == "gyro_sim")}
    width = max(map(len, wanted))
    with NodeGroup({}, lambda name, line: print(f"{name:>{width}} | {line}", flush=True)) as group:
        try:
            for name, module in wanted.items():
                group.start(name, module, ros_arguments(arguments.namespace, parameters[name]))
            while (ended := group.ended()) is None:
                time.sleep(0.2)
        except KeyboardInterrupt:
            print("ending the nodes", file=sys.stderr, flush=True)
            return 0
    name, code = ended
    print(f"gyro-calib up: node {name} ended with exit code {code}; the others were ended too", file=sys.stderr)
    return 1
