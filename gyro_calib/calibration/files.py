"""Files that survive a crash at any moment: they hold the old content or the new one, never a mixture."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

from ..errors import StoreError

__all__ = ["TEMPORARY_SUFFIX", "clean_temporaries", "locked_directory", "make_directory", "replace_text", "sync_directory", "take_copy"]

#: last part of every temporary name
TEMPORARY_SUFFIX = ".gyro-calib-tmp"
#: errors of ``link`` that say "not on this file system" rather than "it failed"
_NO_LINKS = {errno.EPERM, errno.EOPNOTSUPP, errno.ENOTSUP, errno.ENOSYS, errno.EMLINK, errno.EXDEV, errno.EINVAL}


def make_directory(path: Path) -> None:
    """Create ``path`` and its parents and make the new entries durable."""
    if path.is_dir():
        return
    make_directory(path.parent)
    path.mkdir(exist_ok=True)
    sync_directory(path.parent)


def sync_directory(path: Path) -> None:
    """Flush the entries of a directory to the disk, so that a rename survives a loss of power."""
    fd = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


@contextlib.contextmanager
def locked_directory(path: Path, timeout_s: float) -> Iterator[None]:
    """Hold an exclusive advisory lock on a directory; the kernel frees it when the process dies, however it dies.

    Raises
    ------
    StoreError
        Another process holds it for longer than ``timeout_s``.
    """
    fd = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        deadline = time.monotonic() + timeout_s
        while True:
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > deadline:
                    raise StoreError(f"Store {path} must be free, but another process held it for {timeout_s:g} s. Try again.") from None
                time.sleep(0.01)
        yield
    finally:
        os.close(fd)


def replace_text(path: Path, text: str) -> None:
    """Replace the content of ``path`` atomically and durably. The caller holds the lock of the directory."""
    temporary = _temporary(path)
    try:
        _write_durably(temporary, text.encode())
        os.replace(temporary, path)
    except OSError:
        # the disk may be full: give back what this attempt took
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise
    sync_directory(path.parent)


def take_copy(source: Path, target: Path) -> None:
    """Give ``source`` the further name ``target``, replacing it: a hard link, or a durable copy where there are none."""
    temporary = _temporary(target)
    try:
        try:
            os.link(source, temporary)
        except OSError as error:
            if error.errno not in _NO_LINKS:
                raise
            shutil.copyfile(source, temporary)
            _fsync_file(temporary)
        os.replace(temporary, target)
        # rename() of two names of one file does nothing, and leaves the temporary name
        with contextlib.suppress(FileNotFoundError):
            temporary.unlink()
    except OSError:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise
    sync_directory(target.parent)


def clean_temporaries(directory: Path) -> None:
    """Remove what a killed writer left. Call it with the lock held: then no writer is alive, and every temporary is stale."""
    for stale in directory.glob(f".*{TEMPORARY_SUFFIX}"):
        with contextlib.suppress(OSError):
            stale.unlink()


def _temporary(path: Path) -> Path:
    return path.with_name(f".{path.name}.{uuid.uuid4().hex[:12]}{TEMPORARY_SUFFIX}")


def _write_durably(path: Path, data: bytes) -> None:
    fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
    try:
        view = memoryview(data)
        while view:
            view = view[os.write(fd, view) :]
        os.fsync(fd)
    finally:
        os.close(fd)


def _fsync_file(path: Path) -> None:
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
