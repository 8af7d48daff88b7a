"""One self-calibration of 20 drawn units at carrier level, each at an unknown constant rate: bias, scale factor and rate before and after.

python benchmarks/accuracy_seeds.py [--seeds 20] [--jobs 2] [--json FILE]; the trial itself is the study "self-calibration".
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from common import Options, Outcome, main

from gyro_calib.cli.console import print_table, progress_bar
from gyro_calib.report.table import Table
from gyro_calib.study import StudyResult, find_study, run_study

STUDY = "self-calibration"
#: heading and figure of the table, one row per unit
COLUMNS = {
    "bias before [deg/h]": ("bias_before_deg_h", "{:.0f}"),
    "scale before [%]": ("scale_before_percent", "{:+.2f}"),
    "bias error [deg/h]": ("bias_error_deg_h", "{:+.2f}"),
    "/ sd": ("bias_over_sd", "{:+.2f}"),
    "scale error [ppm]": ("scale_error_ppm", "{:+.1f}"),
    " / sd": ("scale_over_sd", "{:+.2f}"),
    "rate error [deg/h]": ("rate_error_deg_h", "{:+.2f}"),
}


def measure(options: Options) -> Outcome:
    """The study with its gates."""
    study = find_study(STUDY)
    seeds = options.seeds or (4 if options.quick else study.default_seeds)
    with _one_thread_each(), progress_bar(f"{STUDY}, {seeds} units", lines=True) as report:
        result = run_study(study, range(seeds), jobs=options.jobs, on_done=lambda done, total: report(done / total, f"{done} of {total}"))
    print_table(_table(result))
    return Outcome(result.gates, {"study": result.to_json()})


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """The processes are the parallelism."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _table(result: StudyResult) -> Table:
    rows = tuple(
        (str(seed), *(form.format(result.figures[figure][k]).replace("-", "−") for figure, form in COLUMNS.values()))
        for k, seed in enumerate(result.seeds)
    )
    seconds = result.figures["plan_s"].mean()
    caption = f"{seconds:.0f} s of records a unit, {result.elapsed_s:.0f} s for all"
    return Table("Self-calibration of drawn units", ("unit", *COLUMNS), rows, caption)


if __name__ == "__main__":
    sys.exit(main("accuracy_seeds", measure))
