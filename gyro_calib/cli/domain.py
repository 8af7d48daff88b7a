"""A ROS domain of one's own, so that a demonstration neither hears nor disturbs other nodes on the machine."""

from __future__ import annotations

import fcntl
import os
import random
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import GyroCalibError

__all__ = ["leased_domain"]

#: above those that people choose by hand, below those whose ports fall into the ephemeral range
_DOMAINS = range(60, 102)


@contextmanager
def leased_domain() -> Iterator[int]:
    """A domain id that no other process has leased; it is free again when the process ends, however it ends.

    Raises
    ------
    GyroCalibError
        All are taken.
    """
    directory = Path(tempfile.gettempdir()) / f"gyro_calib_domains_{os.getuid()}"
    directory.mkdir(exist_ok=True)
    for domain in random.sample(_DOMAINS, len(_DOMAINS)):
        with (directory / str(domain)).open("w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            yield domain
            return
    raise GyroCalibError(f"One of the ROS domains {_DOMAINS[0]}…{_DOMAINS[-1]} must be free, but got none. End other demonstrations.")
