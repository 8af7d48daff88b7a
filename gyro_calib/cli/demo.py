"""A simulated gyro calibrates itself, with real ROS 2 nodes, and is compared with its hidden truth.

Starts simulator, calibration and corrector as processes in a ROS domain of their own, calls ~/self_calibrate, follows its status,
listens to the rate before and after correction, prints a table and writes a report page.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from .console import non_negative_int, print_table, print_warnings, say, spinner, write_json
from .outputs import check_outputs


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the outcome; - for stdout")
    parser.add_argument("--seed", type=non_negative_int, default=1, metavar="N", help="draws the unit and its unknown input rate")
    parser.add_argument("--out", type=Path, default=Path("gyro-calib-demo"), metavar="DIR", help="where report, recordings and record go")
    parser.add_argument("--device", default="ring_15k", metavar="NAME", help="device description: a YAML file, or a packaged name")
    parser.add_argument("--quality", choices=("quick", "standard", "fine"), default="standard", help="duration of the calibration")
    parser.add_argument("--speed", type=float, default=12.0, metavar="F", help="largest simulated time per wall time")


def run(arguments: argparse.Namespace) -> int:
    """Run the demonstration."""
    with spinner("loading"):
        from ..report.comparison import comparison_table
        from ..report.theme import require_matplotlib
        from .demo_report import demo_document, write_report
        from .demo_session import DemoSettings, play

    require_matplotlib()
    check_outputs(arguments, "json", "out")
    began = time.monotonic()
    settings = DemoSettings(arguments.device, arguments.seed, arguments.quality, arguments.speed, arguments.out.absolute())
    outcome = play(settings)
    page = write_report(settings, outcome, time.monotonic() - began)
    elapsed_s = time.monotonic() - began
    if arguments.json is None or str(arguments.json) != "-":
        print_table(comparison_table(outcome.comparison))
        say(f"record  {outcome.record.record_id}")
        say(f"report  {page}")
    print_warnings(outcome.record.warnings)
    if arguments.json is not None:
        write_json(arguments.json, demo_document(settings, outcome, elapsed_s))
    return 0
