"""Pick-off gaps and relative magnitude from the harmonics of large amplitudes (Trusov-Shkel).

RECORDING holds force-rebalance recordings with converter-rate blocks, each axis as the oscillator: record the plan `pickoff_phase`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from .console import print_table, print_warnings, progress_bar, spinner, write_json
from .outputs import check_outputs


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("recordings", nargs="+", type=Path, metavar="RECORDING", help="HDF5 files of one device, with raw blocks")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result; - for stdout")


def run(arguments: argparse.Namespace) -> int:
    """Read, estimate, report."""
    with spinner("loading"):
        from ..estimation.trusov_shkel import estimate_trusov_shkel
        from ..recording.load import load_campaign
        from ..report.table import Table, quantity_cells

    check_outputs(arguments, "json")
    with progress_bar("reading") as report:
        campaign = load_campaign(*arguments.recordings, on_progress=report)
    with spinner("estimating"):
        result = estimate_trusov_shkel(campaign)
    rows: list[tuple[str, ...]] = [("relative pick-off magnitude, y over x", *quantity_cells(result.pickoff_ratio))]
    for axis, gap in result.axes.items():
        rows.append((f"gap, {axis} pick-off", *quantity_cells(gap.gap_v)))
        rows.append((f"largest amplitude over gap, {axis}", *quantity_cells(gap.amplitude)))
    if arguments.json is None or str(arguments.json) != "-":
        print_table(Table(f"Pick-offs of {result.device_id}", ("", "value", "sd", "unit"), tuple(rows)))
    print_warnings([*(f"not observable: {item}" for item in result.not_observable), *result.warnings])
    if arguments.json is not None:
        write_json(arguments.json, result.to_json())
    return 0
