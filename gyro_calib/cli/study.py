"""Try a claim over many seeds: table, gates, figures, plot."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .console import positive_int, print_table, print_warnings, progress_bar, say, spinner, write_json
from .outputs import check_outputs

if TYPE_CHECKING:
    from ..report.table import Table
    from ..study import StudyResult


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("name", nargs="?", metavar="NAME", help="which study")
    what.add_argument("--list", action="store_true", help="say which there are")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write gates and figures; - for stdout")
    parser.add_argument("--seeds", type=positive_int, metavar="N", help="number of trials (default: as the study says)")
    parser.add_argument("--jobs", type=positive_int, default=2, metavar="N", help="processes")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the figures (.png, .svg, .pdf)")


def run(arguments: argparse.Namespace) -> int:
    """Run a study; exit code 1 when a gate does not hold."""
    with spinner("loading"):
        from ..report.theme import require_plot_suffix, save_figure
        from ..study import find_study, list_studies, run_study

    if arguments.list:
        for known in list_studies():
            say(f"{known.name:<24} {known.description}")
        return 0
    study = find_study(arguments.name)
    if arguments.plot is not None:
        require_plot_suffix(arguments.plot)
    check_outputs(arguments, "json", "plot")
    seeds = range(arguments.seeds or study.default_seeds)
    with progress_bar(study.name) as report:
        result = run_study(study, seeds, jobs=arguments.jobs, on_done=lambda done, total: report(done / total, f"{done} of {total} seeds"))
    to_stdout = arguments.json is not None and str(arguments.json) == "-"
    if not to_stdout:
        print_table(study_table(result))
    print_warnings(f"seed {seed} failed: {reason}" for seed, reason in result.failures.items())
    if arguments.json is not None:
        write_json(arguments.json, result.to_json())
    if arguments.plot is not None:
        with spinner("drawing"):
            save_figure(study_drawing(result).figure, arguments.plot)
        if not to_stdout:
            say(f"plot: {arguments.plot}")
    return 0 if result.passed else 1


def study_table(result: StudyResult) -> Table:
    """One row per gate."""
    from ..report.table import Table, quantity_cells

    rows = []
    for gate in result.gates:
        value, sd, unit = quantity_cells(gate.value)
        verdict = "" if not gate.limit else ("pass" if gate.passed else "FAIL")
        rows.append((gate.name, value, sd if gate.value.sd > 0.0 else "", unit, gate.limit, verdict))
    caption = f"{result.study.description} {len(result.seeds)} seeds in {result.elapsed_s:.0f} s."
    return Table(result.study.name, ("", "value", "sd", "unit", "limit", "verdict"), tuple(rows), caption=caption)


def study_drawing(result: StudyResult) -> Any:
    """The study's own plot, or the distribution of every figure."""
    from ..report.noise_figures import draw_distributions
    from ..report.theme import PAPER

    if result.study.plot is not None:
        return result.study.plot(result.figures, PAPER)
    held = sum(gate.passed for gate in result.gates)
    return draw_distributions(result.figures, result.study.name, f"{held} of {len(result.gates)} gates hold.", PAPER)
