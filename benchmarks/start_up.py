"""CPU time until a command or a node is there, against what it stands on, and the peak memory of both and of the great works.

python benchmarks/start_up.py [--quick] [--json FILE]

Every measure is of a process of its own, from the interpreter's start to its end; the smallest of several, since load only ever adds. A
bare node: rclpy with the messages that the corrector uses, a node made and destroyed. Memory is the largest resident set.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from common import Options, Outcome, main

from gyro_calib.cli.domain import leased_domain
from gyro_calib.quantity import Quantity
from gyro_calib.study import Gate

_BARE_NODE = (
    "import rclpy, sensor_msgs.msg, geometry_msgs.msg, diagnostic_msgs.msg, std_srvs.srv, rcl_interfaces.srv; from rclpy.node import Node; "
    "rclpy.init(); Node('bare').destroy_node(); rclpy.try_shutdown()"
)
_NODE = "import rclpy; from gyro_calib.nodes.{module} import {name} as N; rclpy.init(); N().destroy_node(); rclpy.try_shutdown()"
NODES = {"imu_corrector": ("imu_corrector_node", "ImuCorrector"), "gyro_calibration": ("calibration_node", "CalibrationNode")}
#: of the corrector over a bare node, and of the command line that only answers over the bare interpreter
NODE_LIMIT, CLI_LIMIT = 2.0, 5.0
MEMORY_LIMIT_MB = 1000.0


@dataclass(frozen=True)
class Process:
    """What a process took: CPU time [s], largest resident set [MB]."""

    cpu_s: float
    peak_mb: float


def measure(options: Options) -> Outcome:
    """Start-up of library, command line and nodes; memory of a calibration and a diagnosis."""
    repeats = 2 if options.quick else 7
    gates: list[Gate] = []
    with tempfile.TemporaryDirectory() as folder, leased_domain() as domain:
        local = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_HOME": folder, "ROS_LOG_DIR": folder}
        starts = {
            "interpreter": ["-c", "pass"],
            "numpy": ["-c", "import numpy"],
            "gyro-calib --help": ["-m", "gyro_calib.cli", "--help"],
            "gyro_calib.estimation": ["-c", "import gyro_calib.estimation"],
        }
        if importlib.util.find_spec("rclpy") is not None:
            starts["bare node"] = ["-c", _BARE_NODE]
            starts |= {name: ["-c", _NODE.format(module=module, name=kind)] for name, (module, kind) in NODES.items()}
        found = {name: _least(arguments, repeats, local) for name, arguments in starts.items()}
        gates += [Gate(f"CPU time to start, {name}", Quantity(round(took.cpu_s, 3), 0.0, "s")) for name, took in found.items()]
        gates.append(_ratio(found, "gyro-calib --help", "interpreter", CLI_LIMIT))
        if "bare node" in found:
            gates.append(_ratio(found, "imu_corrector", "bare node", NODE_LIMIT))
            gates.append(_ratio(found, "gyro_calibration", "bare node", None))
        # a child's peak is at least that of this process at its birth: the small ones say nothing
        large = ("gyro_calib.estimation", "bare node", *NODES)
        gates += [Gate(f"peak memory, {name}", Quantity(round(found[name].peak_mb), 0.0, "MB")) for name in large if name in found]
        for name, took in _works(Path(folder), options).items():
            gates.append(Gate(f"CPU time, {name}", Quantity(round(took.cpu_s, 3), 0.0, "s")))
            gates.append(Gate(f"peak memory, {name}", Quantity(round(took.peak_mb), 0.0, "MB"), upper=MEMORY_LIMIT_MB))
    return Outcome(gates)


def _works(folder: Path, options: Options) -> dict[str, Process]:
    """Recordings are made once, then calibrated and diagnosed by the command line."""
    quality = "quick" if options.quick else "standard"
    cli = ["-m", "gyro_calib.cli"]
    make = [*cli, "simulate", "ring_15k", "--seed", "7", "--quality", quality, "--fidelity", "slow_flow", "--out", str(folder)]
    _took([*make, "--plan", "self_calibrate"], {})
    _took([*make, "--plan", "gap-ftr"], {})
    (calibration,), (gap,) = folder.glob("*_self_calibrate.h5"), folder.glob("*_gap-ftr.h5")
    size = gap.stat().st_size / 1e6
    page = ["--html", str(folder / "page.html")]
    return {
        f"gyro-calib calibrate ({quality})": _took([*cli, "calibrate", str(calibration), *page], {}),
        f"gyro-calib diagnose ({quality}, file of {size:.0f} MB)": _took([*cli, "diagnose", str(gap), *page], {}),
    }


def _least(arguments: list[str], repeats: int, environment: dict[str, str]) -> Process:
    runs = [_took(arguments, environment) for _ in range(repeats)]
    return Process(min(run.cpu_s for run in runs), min(run.peak_mb for run in runs))


def _took(arguments: list[str], environment: dict[str, str]) -> Process:
    """Run ``python ARGUMENTS`` to its end.

    Raises
    ------
    RuntimeError
        It failed.
    """
    # the linear algebra's threads would count as CPU time without helping
    threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1")
    with tempfile.TemporaryFile() as said:
        child = subprocess.Popen(
            [sys.executable, *arguments], stdout=subprocess.DEVNULL, stderr=said, env={**os.environ, **threads, **environment}
        )
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode:
            said.seek(0)
            raise RuntimeError(f"{' '.join(arguments)} must succeed, but said: {said.read().decode(errors='replace')[-500:]}")
    return Process(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0)


def _ratio(found: dict[str, Process], name: str, base: str, limit: float | None) -> Gate:
    limits = {} if limit is None else {"upper": limit}
    return Gate(f"CPU time to start, {name} / {base}", Quantity(round(found[name].cpu_s / found[base].cpu_s, 2), 0.0, "1"), **limits)


if __name__ == "__main__":
    sys.exit(main("start_up", measure))
