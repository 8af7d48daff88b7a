"""Factory calibration on a rate table: Bryant factor, pick-off frame, mounting, fixed rate difference.

RECORDING holds table runs (attribute applied_rate) with each axis as the oscillator and a self-calibration at rest: record the plan
`factory`, or give your own logger's files. The record is stored apart from field calibrations, which read it and never write it.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from .console import print_table, print_warnings, progress_bar, say, spinner, write_json
from .outputs import check_output, check_outputs

if TYPE_CHECKING:
    from ..estimation.factory import FactoryResult
    from ..report.table import Table


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("recordings", nargs="+", type=Path, metavar="RECORDING", help="HDF5 files, ROS 2 bags or folders, of one device")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result; - for stdout")
    parser.add_argument(
        "--known-rate", type=float, metavar="DEG_H", help="constant rate about the sense axis while the table stands (earth rate) [deg/h]"
    )
    parser.add_argument("--known-rate-sd", type=float, default=0.0, metavar="DEG_H", help="its standard deviation [deg/h]")
    parser.add_argument(
        "--store", nargs="?", const="", metavar="URL", help="store the record: a file or directory, or without URL $ROS_HOME/gyro_calib"
    )
    parser.add_argument("--replace", action="store_true", help="replace a factory record that is there")
    parser.add_argument("--topic", metavar="TOPIC", help="the channels topic, for a bag of several gyros")
    parser.add_argument("--device-id", metavar="ID", help="identity of the unit, for a bag that lacks it")


def run(arguments: argparse.Namespace) -> int:
    """Read, estimate, report, store."""
    with spinner("loading"):
        from ..calibration import FactoryStore, factory_record_from_result
        from ..estimation.factory import calibrate_factory
        from ..quantity import Quantity
        from ..recording.load import load_campaign
        from ..units import DEG_H

    known = None
    if arguments.known_rate is not None:
        known = Quantity(arguments.known_rate * DEG_H, abs(arguments.known_rate_sd) * DEG_H, "rad/s")
    check_outputs(arguments, "json")
    with progress_bar("reading") as report:
        campaign = load_campaign(*arguments.recordings, topic=arguments.topic, device_id=arguments.device_id, on_progress=report)
    if arguments.store is not None:
        check_output("--store", FactoryStore(arguments.store, campaign.device_id).path)
    with progress_bar("estimating") as report:
        result = calibrate_factory(campaign, known_rate=known, on_progress=lambda fraction: report(fraction, ""))
    quiet = arguments.json is not None and str(arguments.json) == "-"
    if not quiet:
        print_table(factory_table(result))
    print_warnings(result.warnings)
    if arguments.json is not None:
        write_json(arguments.json, result.to_json())
    if arguments.store is not None:
        record = factory_record_from_result(result, campaign, known_rate=known)
        path = FactoryStore(arguments.store, result.device_id).save(record, replace_existing=arguments.replace)
        if not quiet:
            say(f"factory record: {path}")
    return 0


def factory_table(result: FactoryResult) -> Table:
    """What the factory found, for a person."""
    from ..report.table import Table, quantity_cells
    from ..units import DEG_H

    rows = [
        ("kappa (2 x Bryant factor)", result.angular_gain_kappa),
        ("pick-off ratio r", result.pickoff_ratio),
        ("pick-off non-orthogonality", result.pickoff_non_orthogonality.scaled(1e3, "mrad")),
        ("pick-off phase", result.pickoff_phase.scaled(1e3, "mrad")),
    ]
    rows += [(f"misalignment {k.replace('_', ' ')}", q.scaled(1e3, "mrad")) for k, q in (result.misalignment or {}).items()]
    if result.rate_difference is not None:
        rows.append(("fixed rate difference", result.rate_difference.scaled(1.0 / DEG_H, "deg/h")))
    return Table(f"Factory: {result.device_id}", ("", "value", "sd", "unit"), tuple((name, *quantity_cells(q)) for name, q in rows))
