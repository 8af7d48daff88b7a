"""Say how large the coefficients of healthy units of one kind are, from a campaign of each.

UNIT is a recording, bag or folder of one unit, in which its temperature moves. Three units or more. `gyro-calib diagnose --fleet FILE` then
sees of another unit what is small beside what any gyro may have, and large beside what these have.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path
from typing import TYPE_CHECKING

from .console import positive_int, print_table, print_warnings, progress_bar, say, spinner
from .outputs import check_outputs

if TYPE_CHECKING:
    from ..gap.fleet import FleetSize
    from ..report.table import Table


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("units", nargs="+", type=Path, metavar="UNIT", help="HDF5 file, ROS 2 bag or folder, each of another healthy unit")
    parser.add_argument("--yaml", type=Path, metavar="FILE", default=Path("fleet.yaml"), help="where to write it")
    parser.add_argument("--jobs", type=positive_int, default=1, metavar="J", help="processes, each of up to a gigabyte")
    parser.add_argument("--topic", metavar="TOPIC", help="the channels topic, for a bag of several gyros")


def run(arguments: argparse.Namespace) -> int:
    """Diagnose each unit, estimate, report, write."""
    with spinner("loading"):
        from ..gap.fleet import fleet_sizes
        from ..gap.fleet_file import write_fleet
        from ..gap.units import fleet_of, units_of_files

    check_outputs(arguments, "yaml")
    done = itertools.count(1)
    with progress_bar("diagnosing", lines=True) as report:

        def told(device_id: str) -> None:
            report(next(done) / len(arguments.units), device_id)

        units = units_of_files(arguments.units, topic=arguments.topic, jobs=arguments.jobs, on_done=told)
    healthy, warnings = fleet_of(units)
    sizes = fleet_sizes([unit.coefficients for unit in healthy])
    fleet = write_fleet(arguments.yaml, healthy[0].nominal_f0_hz, [unit.device_id for unit in healthy], sizes)
    print_table(_table(sizes, len(fleet.units)))
    print_warnings(warnings)
    say(f"fleet: {arguments.yaml}")
    return 0


def _table(sizes: tuple[FleetSize, ...], count: int) -> Table:
    from ..report.table import Table

    rows = tuple((s.name, f"{s.likeliest:.2g}", f"{s.bound:.3g}" if s.is_told else "not told", f"{s.usual:.3g}") for s in sizes)
    caption = "Standard deviations about zero, SI; the bound is kept by nineteen of twenty fleets."
    return Table(f"What {count} healthy units have", ("coefficient", "likeliest", "bound", "any device"), rows, caption)
