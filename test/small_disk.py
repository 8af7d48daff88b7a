"""A disk of a few pages that fills up: a tmpfs in a mount namespace of the calling process, root or not."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

__all__ = ["NO_SMALL_DISK", "mount_small_disk", "remount_read_only"]

#: exit code of a process that could not get one
NO_SMALL_DISK = 77
_NEWNS, _NEWUSER = 0x00020000, 0x10000000
_RDONLY, _REMOUNT, _REC, _PRIVATE = 0x1, 0x20, 0x4000, 0x40000


def mount_small_disk(folder: Path, size: str) -> None:
    """Mount a tmpfs of ``size`` (``"48k"``) on ``folder``, seen by this process and its children alone.

    The process must have one thread. Where this is barred it ends with :data:`NO_SMALL_DISK`.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    user, group = os.getuid(), os.getgid()
    if libc.unshare(_NEWNS | _NEWUSER) != 0:
        os._exit(NO_SMALL_DISK)
    try:
        Path("/proc/self/setgroups").write_text("deny")
        Path("/proc/self/uid_map").write_text(f"0 {user} 1")
        Path("/proc/self/gid_map").write_text(f"0 {group} 1")
    except OSError:
        os._exit(NO_SMALL_DISK)
    libc.mount(b"none", b"/", None, _REC | _PRIVATE, None)
    if libc.mount(b"tmpfs", os.fsencode(folder), b"tmpfs", 0, f"size={size}".encode()) != 0:
        os._exit(NO_SMALL_DISK)


def remount_read_only(folder: Path) -> None:
    """Make it read-only, as the kernel does with a disk that fails."""
    if ctypes.CDLL(None, use_errno=True).mount(b"tmpfs", os.fsencode(folder), b"tmpfs", _REMOUNT | _RDONLY, None) != 0:
        os._exit(NO_SMALL_DISK)
