"""Kernels compile with numba when it is installed and run as plain Python when it is not: the same source either way."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any, TypeVar

__all__ = ["COMPILED", "kernel", "say_if_uncompiled"]

F = TypeVar("F", bound=Callable[..., Any])

try:
    import numba

    COMPILED = not numba.config.DISABLE_JIT
except ImportError:
    numba = None
    COMPILED = False

_said = False


def kernel(function: F) -> F:
    """Compile ``function`` (released GIL, cached on disk), or return it as it is without numba."""
    if numba is None:
        return function
    compiled: F = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    return compiled


def say_if_uncompiled() -> None:
    """Log once per process that the kernels run as plain Python."""
    global _said
    if not COMPILED and not _said:
        _said = True
        logging.getLogger("gyro_calib").warning(
            "numba is not installed: simulation kernels run as plain Python, some hundred times slower. Remedy: pip install numba."
        )
