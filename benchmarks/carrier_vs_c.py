"""The carrier kernel against the same loop in C (same arrays, same rows to 1e-12) and against a general ODE solver.

python benchmarks/carrier_vs_c.py [--quick] [--json FILE]

C is compiled by ``cc`` with -O2, as a distribution would, and for comparison with -O3 and for this very processor with fused operations
("native"); without a C compiler that part is left out and said so. The solver is scipy's DOP853 at the loosest tolerance that keeps the
phase of a free oscillation to 1e-7 rad.
"""

from __future__ import annotations

import ctypes
import inspect
import math
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from common import Options, Outcome, cpu_seconds, main, spread
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from gyro_calib.device import Device, draw_unit, load_device
from gyro_calib.jit import COMPILED
from gyro_calib.quantity import Quantity
from gyro_calib.recording.command import Command, Excitation
from gyro_calib.simulation import GyroSimulator, carrier
from gyro_calib.study import Gate

SOURCE = Path(__file__).with_name("carrier.c")
FLAGS = {"C -O2": ["-O2"], "C -O3": ["-O3"], "C, native": ["-O3", "-march=native", "-ffp-contract=fast"]}
#: what carrier.c takes of the kernel's arguments, in its order; it leaves out what a plain unit does not have (multiplexing, stray drive)
C_ARGUMENTS = (
    "z", "loop", "param", "adc_acc", "row_acc", "adc_w", "row_w", "physics", "drive", "pick", "feed", "body", "nonlinear", "converters",
    "const", "flags", "noise", "out",
)  # fmt: skip
LIMIT = 2.0
#: largest phase error of the solver [rad] over its stretch [s]
PHASE_RAD, SOLVER_S = 1e-7, 0.02


def measure(options: Options) -> Outcome:
    """Ratios to C, ratio to the solver, numerical damping of all."""
    gates, facts = _against_c(options)
    return Outcome([*gates, *_against_solver(options)], facts)


def _arguments() -> dict[str, Any]:
    """Arguments of one call of the kernel by name: a quarter of a second of a noisy unit under side bands."""
    simulator = GyroSimulator(draw_unit(load_device("ring_15k"), 1), rng=np.random.default_rng(1))
    simulator.configure(Command("ftr_x", Excitation("amplitude_modulation", 0.8, 0.15)))
    seen: list[tuple[Any, ...]] = []
    kernel = carrier.carrier_rows

    def spy(*arguments: Any) -> None:
        seen.append(tuple(a.copy() if isinstance(a, np.ndarray) else a for a in arguments))
        kernel(*arguments)

    with patch.object(carrier, "carrier_rows", spy):
        simulator.advance(0.25, 0.01)
    return dict(zip(inspect.signature(kernel.py_func).parameters, seen[0], strict=True))


def _fresh(arguments: dict[str, Any]) -> dict[str, Any]:
    """The same arguments with a state of their own."""
    return {name: a.copy() if isinstance(a, np.ndarray) and name != "noise" else a for name, a in arguments.items()}


def _against_c(options: Options) -> tuple[list[Gate], dict[str, Any]]:
    """Compiled kernel over C, as a ratio of median times."""
    if not COMPILED:
        return [], {"c": "numba is not installed: nothing to compare"}
    compiler = shutil.which("cc")
    if compiler is None:
        return [], {"c": "there is no C compiler (cc): not compared"}
    arguments = _arguments()
    reference = _fresh(arguments)
    carrier.carrier_rows(*reference.values())
    gates: list[Gate] = []
    with tempfile.TemporaryDirectory() as folder:
        works: dict[str, Callable[[], object]] = {"numba": lambda: carrier.carrier_rows(*_fresh(arguments).values())}
        for name, flags in FLAGS.items():
            function = _compiled_c(compiler, flags, Path(folder) / f"carrier{len(works)}.so")
            rows = _fresh(arguments)
            _call_c(function, rows)
            gates.append(Gate(f"rows, numba - {name}", Quantity(_difference(rows["out"], reference["out"]), 0.0, "1"), upper=1e-12))
            works[name] = lambda function=function: _call_c(function, _fresh(arguments))
        times = cpu_seconds(works, 10 if options.quick else 60)
    samples = arguments["noise"].size // 4
    per_sample = {name: spread(values / samples * 1e9, "ns") for name, values in times.items()}
    for name in FLAGS:
        ratio = per_sample["numba"].value / per_sample[name].value
        sd = ratio * math.hypot(*(q.sd / q.value for q in (per_sample["numba"], per_sample[name])))
        gates.append(Gate(f"time of numba / {name}", Quantity(ratio, sd, "1"), upper=LIMIT if name == "C -O2" else math.inf))
    gates += [Gate(f"{name}, per sample", quantity) for name, quantity in per_sample.items()]
    return gates, {}


def _difference(rows: NDArray[np.float64], reference: NDArray[np.float64]) -> float:
    """Largest difference of rows, relative to the largest of the volts and of the reference frequency."""
    scale = np.repeat([np.abs(reference[:, :8]).max(), reference[:, 8].max()], [8, 1])
    return float(np.max(np.abs(rows - reference) / scale))


def _compiled_c(compiler: str, flags: list[str], target: Path) -> Any:
    """``carrier_rows`` of carrier.c, compiled with ``flags``."""
    subprocess.run([compiler, "-std=c99", *flags, "-shared", "-fPIC", "-o", str(target), str(SOURCE), "-lm"], check=True)
    function = ctypes.CDLL(str(target)).carrier_rows
    function.restype = ctypes.c_int
    return function


def _call_c(function: Any, arguments: dict[str, Any]) -> None:
    """Call it with the kernel's arguments that it has."""

    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return value.ctypes.data_as(ctypes.c_void_p)
        return ctypes.c_double(value) if isinstance(value, float) else ctypes.c_long(value)

    sizes = (arguments["out"].shape[0], arguments["adc_w"].shape[1], arguments["row_w"].shape[2])
    if function(*(plain(arguments[name]) for name in C_ARGUMENTS), *map(ctypes.c_long, sizes)) != 0:
        raise RuntimeError("C kernel must take these sizes, but its buffers are too small.")


def _against_solver(options: Options) -> list[Gate]:
    """A free oscillation without losses: time, phase and energy of the kernel and of DOP853."""
    device = _lossless()
    state, matrix = _free_motion(device)
    tolerance, solver_s, solved = _loosest_solver(matrix, state)
    stretch_s = 0.5 if options.quick else 2.0
    simulator = _Released(device)
    simulator.advance(0.1)
    began = time.process_time()
    simulator.advance(stretch_s)
    kernel_s = (time.process_time() - began) / stretch_s
    kernel = _Released(device)
    start = kernel.motion
    kernel.advance(stretch_s)
    exact = expm(matrix * SOLVER_S) @ state
    lag = _phase_error(kernel.motion, expm(matrix * stretch_s) @ start)
    return [
        Gate("DOP853: rtol for 1e-7 rad in 20 ms", Quantity(tolerance, 0.0, "1")),
        Gate("DOP853: phase error, 20 ms", Quantity(_phase_error(solved, exact), 0.0, "rad")),
        Gate("DOP853: energy gained per s", Quantity(_energy(matrix, solved, state) / SOLVER_S, 0.0, "1/s")),
        Gate("kernel: energy gained per s", Quantity(_energy(matrix, kernel.motion, start) / stretch_s, 0.0, "1/s"), -1e-7, 1e-7),
        Gate("kernel: phase error per s", Quantity(lag / stretch_s, 0.0, "rad/s")),
        Gate("time of DOP853 / kernel", Quantity(solver_s / SOLVER_S / kernel_s, 0.0, "1"), lower=1.0),
    ]


class _Released(GyroSimulator):
    """A simulator whose drives are off from the start; ``motion`` is (x, y, x'/w, y'/w) [m]."""

    def __init__(self, device: Device) -> None:
        super().__init__(device, rng=np.random.default_rng(0), noisy=False)
        self.configure(Command("loops_off"))
        self._plant.loop[7:12] = 0.0

    @property
    def motion(self) -> NDArray[np.float64]:
        return np.array(self._plant.z[:4])


def _lossless() -> Device:
    """A unit with Q = 1e15: whatever it loses or gains is numerical."""
    device = draw_unit(load_device("ring_15k"), 1)
    return replace(device, resonator=replace(device.resonator, quality_factor=1e15))


def _free_motion(device: Device) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """State at the release and the matrix of its equation of motion, both in (x, y, x'/w, y'/w)."""
    r = device.resonator
    w = r.omega0_rad_s
    matrix = np.zeros((4, 4))
    matrix[:2, 2:] = w * np.eye(2)
    matrix[2:, :2] = -r.stiffness_matrix() / w
    matrix[2:, 2:] = -r.damping_matrix()
    return _Released(device).motion, matrix


def _loosest_solver(matrix: NDArray[np.float64], state: NDArray[np.float64]) -> tuple[float, float, NDArray[np.float64]]:
    """Tolerance, time of a solution [s] and final state of DOP853."""
    exact = expm(matrix * SOLVER_S) @ state
    scale = float(np.abs(state).max())
    for exponent in range(5, 14):
        tolerance = 10.0**-exponent
        began = time.process_time()
        solution = solve_ivp(lambda t, z: matrix @ z, (0.0, SOLVER_S), state, method="DOP853", rtol=tolerance, atol=tolerance * scale)
        elapsed = time.process_time() - began
        if _phase_error(solution.y[:, -1], exact) < PHASE_RAD:
            return tolerance, elapsed, solution.y[:, -1]
    raise RuntimeError("DOP853 must reach 1e-7 rad at some tolerance, but did not.")


def _phase_error(state: NDArray[np.float64], exact: NDArray[np.float64]) -> float:
    """Angle between the x motion and the exact one in the phase plane [rad]."""
    turned = complex(state[0], -state[2]) / complex(exact[0], -exact[2])
    return abs(math.atan2(turned.imag, turned.real))


def _energy(matrix: NDArray[np.float64], after: NDArray[np.float64], before: NDArray[np.float64]) -> float:
    """Relative gain of energy; the form is v^2 + z K z / w^2."""
    form = np.eye(4)
    form[:2, :2] = -matrix[2:, :2] / matrix[0, 2]
    return float((after @ form @ after) / (before @ form @ before) - 1.0)


if __name__ == "__main__":
    sys.exit(main("carrier_vs_c", measure))
