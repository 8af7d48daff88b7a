"""Try the diagnosis on sealed campaigns of drawn units: gates with their intervals, confusion, reliability, baselines."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from .console import non_negative_int, positive_int, print_table, print_warnings, progress_bar, say, spinner, write_json
from .outputs import check_outputs

if TYPE_CHECKING:
    from ..report.table import Table
    from ..trial.run import BlindTrials


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--trials", type=positive_int, required=True, metavar="N", help="number of trials")
    parser.add_argument("--seed", type=non_negative_int, default=0, metavar="S", help="draws units, effects and noise")
    parser.add_argument("--json", type=Path, metavar="F", help="write every figure and every trial; - for stdout")
    parser.add_argument("--jobs", type=positive_int, default=1, metavar="J", help="processes, each of up to a gigabyte")
    parser.add_argument("--strata", nargs="+", default=[], metavar="NAME", help="only these: clean, one, two, removed, drift, poor")
    parser.add_argument("--snr", nargs="+", type=float, metavar="S", help="signal-to-noise ratios of single effects, in turn")
    parser.add_argument("--quality", choices=("quick", "standard", "fine"), default="standard", help="duration of the campaigns")
    parser.add_argument("--no-baselines", action="store_true", help="leave the four baselines out (half of the time of a trial)")
    parser.add_argument("--log", type=Path, metavar="FILE", help="seals as they are made, labels once all verdicts are in")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw reliability and confusion (.png, .svg, .pdf)")


def run(arguments: argparse.Namespace) -> int:
    """Run the trials; exit code 1 when a gate does not hold."""
    with spinner("loading"):
        from ..report.theme import require_plot_suffix, save_figure
        from ..trial.labels import LADDER
        from ..trial.run import SIZING, TrialLog, run_blind_trials

    if arguments.plot is not None:
        require_plot_suffix(arguments.plot)
    check_outputs(arguments, "json", "log", "plot")
    with progress_bar("blind trials", lines=True) as report:
        result = run_blind_trials(
            arguments.trials,
            arguments.seed,
            strata=arguments.strata,
            ladder=arguments.snr or LADDER,
            jobs=arguments.jobs,
            quality=arguments.quality,
            baselines=not arguments.no_baselines,
            log=TrialLog(arguments.log),
            on_done=lambda done, total: report(done / total, f"{done} of {total} trials"),
        )
    to_stdout = arguments.json is not None and str(arguments.json) == "-"
    if not to_stdout:
        for table in tables(result):
            print_table(table)
        say(SIZING)
    print_warnings(f"trial {number} could not be recorded: {reason}" for number, reason in result.broken.items())
    if arguments.json is not None:
        write_json(arguments.json, result.to_json())
    if arguments.plot is not None:
        from ..report.trial_figures import draw_trials

        with spinner("drawing"):
            save_figure(draw_trials(result), arguments.plot)
        if not to_stdout:
            say(f"plot: {arguments.plot}")
    return 0 if result.passed else 1


def tables(result: BlindTrials) -> list[Table]:
    """Gates, ladder, confusion, reliability, baselines."""
    from ..report.table import Table
    from ..trial.scores import baseline_rows, by_severity, confusion, reliability

    strata: dict[str, int] = {}
    for o in result.outcomes:
        strata[o.label.stratum] = strata.get(o.label.stratum, 0) + 1
    counts = ", ".join(f"{count} {name}" for name, count in strata.items())
    caption = f"seed {result.seed}; {counts}; {result.elapsed_s:.0f} s. Every label opened and equal to its seal."
    rows = []
    for g in result.gates:
        verdict = "no trials" if g.passed is None else "pass" if g.passed else "FAIL"
        exact = f"{_figure(g.exact[0])} … {_figure(g.exact[1])}" if g.count else ""
        interval = f"{_figure(g.low)} … {_figure(g.high)}" if g.count else ""
        rows.append((g.name, _figure(g.value), interval, exact, str(g.count), g.limit, verdict))
    found = [Table("gates", ("", "value", "95 % (Wilson)", "95 % (exact)", "of", "limit", "verdict"), tuple(rows), caption=caption)]
    steps = [
        (f"{r['snr']:g}", *(str(r[k]) for k in ("count", "detected", "first", "unknown")))
        for r in by_severity(result.outcomes, result.ladder)
    ]
    found.append(
        Table("severity (effective SNR), one effect", ("SNR", "trials", "detected", "right first", "called unknown"), tuple(steps))
    )
    lines = [(truth, ", ".join(f"{said} {n}" for said, n in sorted(row.items()))) for truth, row in confusion(result.outcomes).items()]
    found.append(Table("confusion", ("truth", "said (a group that holds the truth counts as it)"), tuple(lines)))
    bins = [
        (f"{r['from']:g} … {r['to']:g}", str(r["count"]), _figure(r["stated"]), _figure(r["right"] / r["count"]))
        for r in reliability(result.outcomes)
        if r["count"]
    ]
    found.append(Table("reliability", ("probability", "verdicts", "mean stated", "share right"), tuple(bins)))
    others = [
        (r["name"], f"{r['false_alarms']}/{r['clean']}", f"{r['detected']}/{r['strong']}", f"{r['first']}/{r['strong']}")
        for r in baseline_rows(result.outcomes)
    ]
    words = "A baseline is also right with what no campaign of the unit tells from the truth."
    found.append(Table("baselines", ("", "alarms on clean", "detected, SNR 8 and up", "right first"), tuple(others), caption=words))
    return found


def _figure(value: float | None) -> str:
    return "" if value is None or not math.isfinite(value) else f"{value:.3f}"
