"""How many threads the linear algebra may have: one, before numpy is loaded."""

from __future__ import annotations

import os

__all__ = ["one_thread"]


def one_thread() -> None:
    """Ask the libraries of the linear algebra for one thread, unless the environment says otherwise.

    On many small matrices their threads wait for each other: a calibration takes twice the processor time with two, three times and more on
    a busy machine. Without effect once numpy is loaded.
    """
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
