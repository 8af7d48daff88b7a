"""Kernels compile with numba when it is installed and run as plain Python when it is not: the same source either way."""

from __future__ import annotations

import hashlib
import importlib.util
import logging
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

__all__ = ["COMPILED", "inlined_kernel", "kernel", "say_if_uncompiled"]

F = TypeVar("F", bound=Callable[..., Any])

try:
    import numba

    COMPILED = not numba.config.DISABLE_JIT
except ImportError:
    numba = None
    COMPILED = False

_said = False
_IMPORT = re.compile(r"^from\s+([.\w]+)\s+import\b", re.MULTILINE)


def kernel(function: F) -> F:
    """Compile ``function`` (released GIL, cached on disk), or return it as it is without numba."""
    if not COMPILED:
        return function
    # numba's own cache looks at the file of the function alone: it would keep machine code that holds an old version of another kernel
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(_cache_folder(function))
    try:
        compiled: F = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:  # nowhere to keep it: compile in every process
        compiled = numba.njit(nogil=True, error_model="numpy")(function)
    finally:
        numba.config.CACHE_DIR = before
    return compiled


def inlined_kernel(function: F) -> F:
    """As :func:`kernel`, for what is called at every step: it becomes part of the kernels that call it."""
    if not COMPILED:
        return function
    inlined: F = numba.njit(inline="always", error_model="numpy")(function)
    return inlined


def _cache_folder(function: Callable[..., Any]) -> Path:
    """Where the machine code of a kernel is kept: named by the sources of its module and of all of this package that they import."""
    found: dict[str, bytes] = {}
    _collect_sources(function.__module__, found)
    digest = hashlib.sha256(b"\0".join(found[name] for name in sorted(found))).hexdigest()[:16]
    tree = Path(function.__code__.co_filename).parent / "__pycache__"
    if numba.config.CACHE_DIR:
        root = Path(numba.config.CACHE_DIR)
    elif os.access(tree if tree.exists() else tree.parent, os.W_OK):
        root = tree
    else:
        root = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "gyro_calib"
    return root / f"kernels-{digest}"


def _collect_sources(name: str, found: dict[str, bytes]) -> None:
    """Source of a module and of what it imports from this package, into ``found``: kernels call each other and freeze constants."""
    module = sys.modules[name]
    if name in found or getattr(module, "__file__", None) is None:
        return
    found[name] = Path(str(module.__file__)).read_bytes()
    for imported in _IMPORT.findall(found[name].decode()):
        target = importlib.util.resolve_name(imported, module.__package__ or "")
        if target.startswith(f"{__package__}.") and target in sys.modules:
            _collect_sources(target, found)


def say_if_uncompiled() -> None:
    """Log once per process that the kernels run as plain Python."""
    global _said
    if not COMPILED and not _said:
        _said = True
        logging.getLogger("gyro_calib").warning(
            "numba is not installed: simulation kernels run as plain Python, some hundred times slower. Remedy: pip install numba."
        )
