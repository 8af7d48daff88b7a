"""Say how large the coefficients of healthy units of one kind are, from a campaign of each.

UNIT is a recording, bag or folder of one unit, in which its temperature moves. Three units or more. `gyro-calib diagnose --fleet FILE` then
sees of another unit what is small beside what any gyro may have, and large beside what these have.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from .console import print_table, print_warnings, progress_bar, say, spinner
from .outputs import check_outputs

if TYPE_CHECKING:
    from ..gap.fleet import FleetSize
    from ..gap.units import Unit
    from ..report.table import Table


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("units", nargs="+", type=Path, metavar="UNIT", help="HDF5 file, ROS 2 bag or folder, each of another healthy unit")
    parser.add_argument("--yaml", type=Path, metavar="FILE", default=Path("fleet.yaml"), help="where to write it")
    parser.add_argument("--topic", metavar="TOPIC", help="the channels topic, for a bag of several gyros")


def run(arguments: argparse.Namespace) -> int:
    """Diagnose each unit, estimate, report, write."""
    with spinner("loading"):
        from ..gap.fleet import fleet_sizes
        from ..gap.fleet_file import write_fleet
        from ..gap.units import fleet_of, unit_of
        from ..recording.load import load_campaign

    check_outputs(arguments, "yaml")
    units: list[Unit] = []
    with progress_bar("diagnosing", lines=True) as report:
        for k, path in enumerate(arguments.units):
            units.append(unit_of(load_campaign(path, topic=arguments.topic)))
            report((k + 1) / len(arguments.units), units[-1].device_id)
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
