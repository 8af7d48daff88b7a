"""A ROS domain of one's own, so that a demonstration neither hears nor disturbs other nodes on the machine."""

from __future__ import annotations

import contextlib
import fcntl
import random
import tempfile
from collections.abc import Iterator
from pathlib import Path

from ..errors import GyroCalibError

__all__ = ["leased_domain"]

#: above those that people choose by hand, below those whose ports fall into the ephemeral range
_DOMAINS = range(60, 102)


@contextlib.contextmanager
def leased_domain() -> Iterator[int]:
    """A domain id that no other process has leased; it is free again when the process ends, however it ends.

    Raises
    ------
    GyroCalibError
        All are taken.
    """
    directory = Path(tempfile.gettempdir()) / "gyro_calib_ros_domains"
    directory.mkdir(exist_ok=True)
    with contextlib.ExitStack() as stack:
        for domain in random.sample(_DOMAINS, len(_DOMAINS)):
            try:
                file = stack.enter_context((directory / f"{domain}.lock").open("w"))
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:  # another process, or another user, has it
                continue
            yield domain
            return
    raise GyroCalibError(f"One of the ROS domains {_DOMAINS[0]}…{_DOMAINS[-1]} must be free, but got none. End other demonstrations.")
