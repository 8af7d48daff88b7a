"""Call a service of the calibration by its short name and wait for the end of the run.

Runs: self_calibrate, run_sideband, run_cubic, run_virtual_precession, run_scale_factor, run_feedthrough, diagnose_gap.
At once: cancel, save, revert, self_test, enable, disable.
"""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from .console import print_table, progress_bar, say, spinner

if TYPE_CHECKING:
    from .ros_client import RosClient

_AT_ONCE = ("cancel", "save", "revert")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("service", metavar="SERVICE", help="short name, e.g. self_calibrate")
    parser.add_argument("--namespace", default="gyro", metavar="NS", help="namespace of the gyro")
    parser.add_argument("--no-wait", action="store_true", help="return as soon as the run is accepted")


def run(arguments: argparse.Namespace) -> int:
    """Call, wait, report."""
    from .ros_client import RosClient

    with RosClient(arguments.namespace) as client:
        if arguments.service in ("enable", "disable"):
            return _switch(client, arguments.service == "enable")
        if arguments.service == "self_test":
            return _self_test(client)
        with spinner(f"calling {arguments.service}"):
            accepted = client.start_run(arguments.service)
        if arguments.no_wait or arguments.service in _AT_ONCE:
            say(accepted)
            return 0
        return _follow(client, arguments.service, accepted)


def _follow(client: RosClient, service: str, accepted: str) -> int:
    """Progress until the run ends."""
    try:
        with progress_bar(service, lines=True) as report:
            view = client.follow_run(accepted, lambda seen: report(seen.fraction, seen.message))
    except KeyboardInterrupt:
        print("no longer waiting; the run goes on, gyro-calib call cancel ends it", file=sys.stderr)
        return 130
    say(view.message)
    return 0


def _switch(client: RosClient, on: bool) -> int:
    """The corrector on or off."""
    from std_srvs.srv import SetBool

    with spinner("calling the corrector"):
        response = client.call(SetBool, "imu_corrector/enable", SetBool.Request(data=on))
    print(response.message, file=sys.stdout if response.success else sys.stderr)
    return 0 if response.success else 1


def _self_test(client: RosClient) -> int:
    """One row per check."""
    from diagnostic_msgs.srv import SelfTest

    from ..report.table import Table

    with spinner("self-test"):
        response = client.call(SelfTest, "gyro_calibration/self_test")
    passed = response.passed == b"\x01"
    words = {b"\x00": "ok", b"\x01": "warning", b"\x02": "error", b"\x03": "stale"}
    rows = tuple((status.name, words.get(status.level, "?"), status.message) for status in response.status)
    title = f"Self-test of {response.id or 'the gyro'}: {'passed' if passed else 'FAILED'}"
    print_table(Table(title, ("check", "", "message"), rows))
    return 0 if passed else 1
