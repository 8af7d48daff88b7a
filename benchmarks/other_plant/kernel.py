"""The compiled carrier integrator: built at first use, its parameter names read from its own source."""

from __future__ import annotations

import ctypes
import hashlib
import re
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SOURCE = Path(__file__).with_name("plant.c")
N_STATE, N_OUT = 10, 10


def _names(mark: str) -> dict[str, int]:
    text = SOURCE.read_text()
    body = text.split(f"/* BEGIN {mark} */")[1].split(f"/* END {mark} */")[0]
    body = re.sub(r"/\*.*?\*/", "", body, flags=re.DOTALL)
    return {name: i for i, name in enumerate(re.findall(r"\b[PSC]_(\w+)", body))}


PAR, SLOW, CMD = _names("PAR"), _names("SLOW"), _names("CMD")


@cache
def _library() -> ctypes.CDLL:
    digest = hashlib.sha256(SOURCE.read_bytes()).hexdigest()[:16]
    target = Path(tempfile.gettempdir()) / f"other_plant_{digest}.so"
    if not target.exists():
        with tempfile.TemporaryDirectory() as folder:
            fresh = Path(folder) / "plant.so"
            subprocess.run(["cc", "-O2", "-shared", "-fPIC", str(SOURCE), "-o", str(fresh), "-lm"], check=True)
            part = target.with_suffix(".part")
            part.write_bytes(fresh.read_bytes())
            part.replace(target)
    lib = ctypes.CDLL(str(target))
    pointer, double = ctypes.c_void_p, ctypes.c_double
    lib.plant_new.restype, lib.plant_new.argtypes = pointer, [pointer, pointer, pointer, ctypes.c_long, ctypes.c_uint64]
    lib.plant_free.argtypes = [pointer]
    lib.plant_run.argtypes = [pointer, pointer, ctypes.c_long, pointer]
    lib.plant_set_state.argtypes = lib.plant_get_state.argtypes = [pointer, pointer]
    lib.plant_frequency.restype, lib.plant_frequency.argtypes = double, [pointer]
    sizes = [lib.plant_sizes(i) for i in range(4)]
    if sizes != [len(PAR), len(SLOW), len(CMD), N_OUT]:
        raise RuntimeError(f"plant.c counts {sizes}, its enums were read as {[len(PAR), len(SLOW), len(CMD), N_OUT]}")
    return lib


class Plant:
    """One gyro and its firmware, running in continuous device time.

    Parameters
    ----------
    par : dict
        Values of the names of `PAR`; what is left out is zero.
    propagator : ndarray, shape (10, 12)
        State and input matrix of one sub-step.
    slow : ndarray, shape (n, len(SLOW))
        What changes slowly, on a grid of ``par["SLOW_DT"]`` from time zero on.
    seed : int
        Of the fast noise.
    """

    def __init__(self, par: dict[str, float], propagator: Array, slow: Array, seed: int) -> None:
        self._lib = _library()
        values = np.zeros(len(PAR))
        for name, value in par.items():
            values[PAR[name]] = value
        self._slow = np.ascontiguousarray(slow, dtype=float)  # the kernel keeps the pointer
        prop = np.ascontiguousarray(propagator, dtype=float)
        self._ptr = self._lib.plant_new(values.ctypes.data, prop.ctypes.data, self._slow.ctypes.data, len(slow), seed)

    def __del__(self) -> None:
        if getattr(self, "_ptr", None):
            self._lib.plant_free(self._ptr)

    def run(self, command: dict[str, float], windows: int, keep: bool = False) -> Array:
        """Run some windows of one command; the rows of the windows if they are kept, else nothing."""
        values = np.zeros(len(CMD))
        for name, value in command.items():
            values[CMD[name]] = value
        out = np.empty((windows if keep else 0, N_OUT))
        self._lib.plant_run(self._ptr, values.ctypes.data, windows, out.ctypes.data if keep else None)
        return out

    @property
    def frequency(self) -> float:
        """Frequency that the phase-locked loop holds [rad/s]."""
        return float(self._lib.plant_frequency(self._ptr))

    @property
    def state(self) -> Array:
        """State of the linear part."""
        s = np.empty(N_STATE)
        self._lib.plant_get_state(self._ptr, s.ctypes.data)
        return s

    @state.setter
    def state(self, value: Array) -> None:
        s = np.ascontiguousarray(value, dtype=float)
        self._lib.plant_set_state(self._ptr, s.ctypes.data)
