"""Kernels compile with numba when it is installed and run as plain Python when it is not: the same source either way."""

from __future__ import annotations

import hashlib
import logging
import os
from collections.abc import Callable
from pathlib import Path
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
    if not COMPILED:
        return function
    # numba's own cache looks at the file of the function alone and would keep machine code with an old version of a kernel that it calls
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(_cache_folder(function))
    try:
        compiled: F = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:  # nowhere to keep it: compile in every process
        compiled = numba.njit(nogil=True, error_model="numpy")(function)
    finally:
        numba.config.CACHE_DIR = before
    return compiled


def _cache_folder(function: Callable[..., Any]) -> Path:
    """Where the machine code of a kernel is kept: named by the sources of the kernel and of all that it calls."""
    files = sorted(_source_files(function, set()))
    digest = hashlib.sha256(b"\0".join(file.read_bytes() for file in files)).hexdigest()[:16]
    tree = Path(function.__code__.co_filename).parent / "__pycache__"
    if numba.config.CACHE_DIR:
        root = Path(numba.config.CACHE_DIR)
    elif os.access(tree if tree.exists() else tree.parent, os.W_OK):
        root = tree
    else:
        root = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "gyro_calib"
    return root / f"kernels-{digest}"


def _source_files(function: Callable[..., Any], seen: set[Callable[..., Any]]) -> set[Path]:
    """Files of a kernel and of the kernels that it calls, whose decorators have run by now."""
    seen.add(function)
    files = {Path(function.__code__.co_filename)}
    for name in function.__code__.co_names:
        called = getattr(function.__globals__.get(name), "py_func", None)
        if called is not None and called not in seen:
            files |= _source_files(called, seen)
    return files


def say_if_uncompiled() -> None:
    """Log once per process that the kernels run as plain Python."""
    global _said
    if not COMPILED and not _said:
        _said = True
        logging.getLogger("gyro_calib").warning(
            "numba is not installed: simulation kernels run as plain Python, some hundred times slower. Remedy: pip install numba."
        )
