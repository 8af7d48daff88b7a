"""Keep ROS tests out of each other's way: domains, discovery, shared memory."""

from __future__ import annotations

import contextlib
import fcntl
import random
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

#: domains that work on every platform without touching the ephemeral ports
DOMAINS = range(1, 102)


@contextlib.contextmanager
def lease_domain() -> Iterator[int]:
    """A domain that no other lease holder has; the lease ends with the process at the latest."""
    folder = Path(tempfile.gettempdir()) / "gyro_calib_ros_domains"
    folder.mkdir(exist_ok=True, mode=0o777)
    candidates = list(DOMAINS)
    random.SystemRandom().shuffle(candidates)
    for domain in candidates:
        with (folder / f"{domain}.lock").open("w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            yield domain
            return
    raise RuntimeError(f"A ROS domain must be free, but all of {DOMAINS} are leased in {folder}.")


def discovery_profile(lease_s: int = 20) -> str:
    """Fast DDS profile: announcements every 200 ms, so that a late joiner is found in half a second instead of two.

    One that dies without a word is forgotten after its own ``lease_s``.
    """
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <participant profile_name="quick_discovery" is_default_profile="true">
    <rtps><builtin><discovery_config>
      <leaseDuration><sec>{lease_s}</sec></leaseDuration>
      <leaseAnnouncement><sec>0</sec><nanosec>200000000</nanosec></leaseAnnouncement>
      <initialAnnouncements><count>20</count><period><sec>0</sec><nanosec>200000000</nanosec></period></initialAnnouncements>
    </discovery_config></builtin></rtps>
  </participant>
</profiles>
"""


def clean_shared_memory(folder: Path = Path("/dev/shm"), min_age_s: float = 10.0) -> list[str]:
    """Remove segments of Fast DDS whose owner is gone (its lock is free); returns their names.

    A living owner holds the lock of ``<segment>_el``; a young file may belong to one that has not locked it yet.
    """
    removed: list[str] = []
    for lock in folder.glob("fastrtps_*_el"):
        segment = lock.with_name(lock.name.removesuffix("_el"))
        with contextlib.suppress(OSError), lock.open("r") as file:
            if time.time() - lock.stat().st_mtime < min_age_s:
                continue
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            segment.unlink(missing_ok=True)
            lock.unlink(missing_ok=True)
            removed.append(segment.name)
    return removed
