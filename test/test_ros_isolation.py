"""ROS tests keep out of each other's way."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from ros_isolation import DOMAINS, clean_shared_memory, lease_domain


def test_leases_are_of_different_domains() -> None:
    with lease_domain() as first, lease_domain() as second:
        assert first != second
        assert {first, second} <= set(DOMAINS)


def test_only_segments_of_dead_owners_are_removed(tmp_path: Path) -> None:
    for name in ("dead", "alive", "young"):
        (tmp_path / f"fastrtps_{name}").write_text("data")
        lock = tmp_path / f"fastrtps_{name}_el"
        lock.write_text("")
        if name != "young":
            os.utime(lock, (0, 0))
    (tmp_path / "somebody_else_s_el").write_text("")
    with (tmp_path / "fastrtps_alive_el").open() as owner:
        fcntl.flock(owner, fcntl.LOCK_EX)
        assert clean_shared_memory(tmp_path) == ["fastrtps_dead"]
    left = sorted(path.name for path in tmp_path.iterdir())
    assert left == ["fastrtps_alive", "fastrtps_alive_el", "fastrtps_young", "fastrtps_young_el", "somebody_else_s_el"]
