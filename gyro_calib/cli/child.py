"""Run a node module as a child that does not outlive its parent: ``python -m gyro_calib.cli.child MODULE [ROS arguments]``."""

from __future__ import annotations

import ctypes
import importlib
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1


def _end_with_parent() -> None:
    """Linux tells us by SIGINT when the parent dies, even by SIGKILL; elsewhere there is no such thing and nothing is done."""
    if not sys.platform.startswith("linux"):
        return
    parent = os.getppid()
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGINT)
    if os.getppid() != parent:  # it died before we asked
        sys.exit(1)


if __name__ == "__main__":
    # a parent that a shell put into the background hands down a SIGINT that is ignored
    signal.signal(signal.SIGINT, signal.default_int_handler)
    _end_with_parent()
    module = importlib.import_module(sys.argv[1])
    sys.argv = [sys.argv[1], *sys.argv[2:]]
    sys.exit(module.main())
