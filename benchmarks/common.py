"""What the benchmarks share: an outcome with gates, timing that other processes disturb little, the machine in general terms."""

from __future__ import annotations

import argparse
import math
import os
import platform
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

# one thread for the linear algebra, as the command line takes it; before numpy is loaded, so import this first where times matter
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from gyro_calib.cli.console import print_table, write_json
from gyro_calib.quantity import Quantity
from gyro_calib.report.table import Table, number
from gyro_calib.study import Gate

__all__ = ["Options", "Outcome", "cpu_seconds", "gate_table", "machine", "main", "ratio", "spread"]


@dataclass(frozen=True)
class Options:
    """How much to measure: ``quick`` is a tenth of the work; ``seeds`` None means as many as the benchmark says."""

    quick: bool = False
    seeds: int | None = None
    jobs: int = 2


@dataclass(frozen=True)
class Outcome:
    """Figures of one benchmark; ``facts`` go to the JSON document as they are."""

    gates: Sequence[Gate]
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """Whether every gate holds."""
        return all(gate.passed for gate in self.gates)

    def to_json(self) -> dict[str, Any]:
        """Gates and facts."""
        return {"passed": self.passed, "gates": [gate.to_json() for gate in self.gates], "facts": dict(self.facts)}


def cpu_seconds(works: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, NDArray[np.float64]]:
    """CPU time of this process for each piece of work [s], shape (repeats,); taken in turns, so that a change of load meets all alike."""
    for work in works.values():
        work()
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(repeats):
        for name, work in works.items():
            began = time.process_time()
            work()
            times[name].append(time.process_time() - began)
    return {name: np.array(values) for name, values in times.items()}


def spread(values: NDArray[np.float64], unit: str) -> Quantity:
    """Median with the sd of a median (from the median absolute deviation)."""
    middle = float(np.median(values))
    deviation = 1.4826 * float(np.median(np.abs(values - middle)))
    return Quantity(middle, 1.2533 * deviation / np.sqrt(values.size), unit)


def ratio(above: Quantity, below: Quantity) -> Quantity:
    """``above / below`` with the sd of independent errors."""
    value = above.value / below.value
    return Quantity(value, abs(value) * math.hypot(above.sd / above.value, below.sd / below.value), "1")


def machine() -> dict[str, Any]:
    """Processor architecture, number of processors, load and versions; nothing that names the machine."""
    import scipy

    found: dict[str, Any] = {
        "architecture": platform.machine(),
        "processors": os.cpu_count(),
        "load": round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else None,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }
    try:
        import numba

        found["numba"] = numba.__version__
    except ImportError:
        found["numba"] = None
    return found


def gate_table(title: str, gates: Sequence[Gate]) -> Table:
    """One row per gate."""
    rows = []
    for gate in gates:
        verdict = ("pass" if gate.passed else "FAIL") if gate.limit else ""
        value = f"{number(gate.value.value, gate.value.sd)} {gate.value.unit}".removesuffix(" 1")
        rows.append((gate.name, value, gate.limit, verdict))
    return Table(title, ("figure", "value", "limit", ""), tuple(rows))


def main(name: str, measure: Callable[[Options], Outcome]) -> int:
    """Command line of one benchmark; exit code 1 when a gate does not hold."""
    description = sys.modules[measure.__module__].__doc__
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a tenth of the work")
    parser.add_argument("--seeds", type=int, metavar="N", help="units to try, where a benchmark tries units")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes, where a benchmark can use more than one")
    parser.add_argument("--json", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    outcome = measure(Options(quick=arguments.quick, seeds=arguments.seeds, jobs=arguments.jobs))
    print_table(gate_table(name, outcome.gates))
    if arguments.json is not None:
        write_json(arguments.json, {"machine": machine(), name: outcome.to_json()})
    return 0 if outcome.passed else 1
