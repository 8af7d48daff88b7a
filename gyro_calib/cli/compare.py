"""Compare calibrations of one device: what moved between its runs, and whether that is more than their noise.

RECORD is a calibration record (YAML), as in $ROS_HOME/gyro_calib. One alone is compared with its previous versions, kept beside it.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from .console import print_table, print_warnings, say, spinner, write_json
from .outputs import check_outputs

if TYPE_CHECKING:
    from ..calibration import CalibrationRecord


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("records", nargs="+", metavar="RECORD", help="calibration records of one device, in any order: files or URLs")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every figure of every run; - for stdout")
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a page with pictures")


def run(arguments: argparse.Namespace) -> int:
    """Read, compare, report; the exit code says whether it could be done, not whether something moved."""
    from ..calibration.run_changes import changes_between
    from ..paths import package_version
    from ..report.page import write_page
    from ..report.run_changes_page import run_changes_page, run_changes_table, verdict
    from ..report.theme import require_matplotlib

    if arguments.html is not None:
        require_matplotlib()
    check_outputs(arguments, "json", "html")
    changes = changes_between(_records(arguments.records))
    shown = arguments.json is None or str(arguments.json) != "-"
    if shown:
        print_table(run_changes_table(changes))
        say(verdict(changes))
    print_warnings(changes.cautions)
    if arguments.json is not None:
        write_json(arguments.json, changes.to_json())
    if arguments.html is not None:
        with spinner("drawing the report"):
            write_page(arguments.html, run_changes_page(changes, f"gyro_calib {package_version()}"))
        if shown:
            say(f"report: {arguments.html}")
    return 0


def _records(urls: list[str]) -> list[CalibrationRecord]:
    """Each record; one alone with its previous versions."""
    from ..calibration import RecordStore, read_record, resolve_url

    found = [read_record(resolve_url(url, "")) for url in urls]
    if len(found) == 1:
        found += [loaded.record for loaded in RecordStore(urls[0], found[0].device_id).previous()]
    return found
