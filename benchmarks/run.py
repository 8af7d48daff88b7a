"""All benchmarks with their gates.

python benchmarks/run.py [--only NAME …] [--quick] [--json FILE]; exit code 1 when a gate does not hold or a benchmark fails.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from common import Options, Outcome, gate_table, machine

from gyro_calib.cli.console import print_table, progress_lines, say, write_json
from gyro_calib.quantity import Quantity
from gyro_calib.report.table import Table
from gyro_calib.study import Gate

HERE = Path(__file__).resolve().parent
#: name -> what it shows; each but consumer_yaw is a module with ``measure(Options) -> Outcome``
BENCHMARKS = {
    "carrier_vs_c": "carrier kernel against the same loop in C and against an ODE solver",
    "slow_flow_speed": "device seconds per CPU second of both simulators",
    "estimators": "one fit with own derivatives, with finite differences and over all time instants",
    "blocks_and_bags": "blocks against rclpy's serialisation, bags against bare rosbags",
    "corrector_vs_relay": "imu_corrector against a bare rclpy relay",
    "start_up": "start of commands and nodes, memory of a calibration and a diagnosis",
    "accuracy_seeds": "bias, scale factor and rate before and after, 20 units",
    "consumer_yaw": "yaw of a stranger's program over 10 simulated minutes, real nodes",
    "navigation": "consistency of a stranger's EKF with each covariance mode, real nodes",
    "soak": "memory of the nodes, every message of a corrector at 1 kHz checked",
}


def consumer_yaw(options: Options) -> Outcome:
    """The benchmark of the nodes has a process of its own: it leases a ROS domain for all that it starts."""
    if importlib.util.find_spec("rclpy") is None:
        return Outcome([], {"skipped": "rclpy is not installed"})
    with tempfile.TemporaryDirectory() as folder:
        document = Path(folder) / "yaw.json"
        less = ["--minutes", "1"] if options.quick else []
        done = subprocess.run([sys.executable, str(HERE / "consumer_yaw.py"), "--json", str(document), *less], check=False)
        if not document.exists():
            raise RuntimeError(f"consumer_yaw must write its figures, but ended with exit code {done.returncode}.")
        found = json.loads(document.read_text(encoding="utf-8"))
    # a gain of white noise over a tenth of the time is no measure of the bias: informative only
    limit = {} if options.quick else {"lower": float(found["gate"])}
    errors = [Gate(f"yaw error from {name}", Quantity(q["value"], q["sd"], q["unit"])) for name, q in found["yaw_error"].items()]
    return Outcome([*errors, Gate("times closer", Quantity(found["times_closer"], 0.0, "1"), **limit)], found)


def find(name: str) -> Callable[[Options], Outcome]:
    """``measure`` of a benchmark."""
    return consumer_yaw if name == "consumer_yaw" else importlib.import_module(name).measure


def main() -> int:
    """Run what was asked for, then one table of all gates."""
    listing = "\n".join(f"  {name:<18} {what}" for name, what in BENCHMARKS.items())
    parser = argparse.ArgumentParser(description=f"{__doc__}\n{listing}", formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(BENCHMARKS), metavar="NAME", help="these, by name")
    parser.add_argument("--quick", action="store_true", help="a tenth of the work: does everything run?")
    parser.add_argument("--seeds", type=int, metavar="N", help="units of accuracy_seeds")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes of accuracy_seeds")
    parser.add_argument("--json", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    options = Options(arguments.quick, arguments.seeds, arguments.jobs)
    outcomes: dict[str, Outcome] = {}
    failures: dict[str, str] = {}
    for name in arguments.only or BENCHMARKS:
        with progress_lines(f"{name}: {BENCHMARKS[name]}"):
            measure = find(name)
        try:
            outcomes[name] = measure(options)
        except Exception as error:
            # one benchmark that breaks must not hide the others
            failures[name] = f"{type(error).__name__}: {error}"
            print(f"{name}: {failures[name]}", file=sys.stderr)
            continue
        print_table(gate_table(name, outcomes[name].gates))
    document = {"machine": machine(), "benchmarks": {name: outcome.to_json() for name, outcome in outcomes.items()}, "failures": failures}
    if arguments.json is not None:
        write_json(arguments.json, document)
    return _verdict(outcomes, failures)


def _verdict(outcomes: dict[str, Outcome], failures: dict[str, str]) -> int:
    """One line per benchmark; 0 when all hold."""
    rows = []
    for name, outcome in outcomes.items():
        gates = [gate for gate in outcome.gates if gate.limit]
        held = sum(gate.passed for gate in gates)
        rows.append((name, f"{held} of {len(gates)}", "pass" if outcome.passed else "FAIL"))
    rows += [(name, "", "FAIL") for name in failures]
    print_table(Table("Gates", ("benchmark", "hold", ""), tuple(rows)))
    for name, outcome in outcomes.items():
        if "skipped" in outcome.facts or "c" in outcome.facts:
            say(f"{name}: {outcome.facts.get('skipped') or outcome.facts['c']}")
    return 1 if failures or not all(outcome.passed for outcome in outcomes.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
