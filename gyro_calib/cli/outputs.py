"""Whether what a command is to write can be written: asked before its work, which may take an hour."""

from __future__ import annotations

import argparse
import errno
import os
import tempfile
from pathlib import Path

from ..errors import DataError

__all__ = ["check_output", "check_outputs"]

#: outputs that are folders
_FOLDERS = ("out",)
#: outputs that are written where they stand, so that a file may be written whose folder may not
_IN_PLACE = ("json", "log", "plot")


def check_outputs(arguments: argparse.Namespace, *names: str) -> None:
    """Check the outputs of a command, those that were asked for; nothing is left behind.

    Parameters
    ----------
    arguments : Namespace
        Of the command.
    *names : str
        Arguments that are paths to write.

    Raises
    ------
    DataError
        One of them cannot be written; the text names option and path.
    """
    for name in names:
        path = getattr(arguments, name)
        if path is not None and not (name == "json" and str(path) == "-"):
            check_output(f"--{name.replace('_', '-')}", path, folder=name in _FOLDERS, in_place=name in _IN_PLACE)


def check_output(option: str, path: Path, *, folder: bool = False, in_place: bool = False) -> None:
    """Check one output.

    Parameters
    ----------
    option : str
        Who asked for it.
    path : Path
        What is to be written; missing folders above it are made by who writes.
    folder : bool
        It is a folder.
    in_place : bool
        A file that is there is written, rather than replaced by another of its name.

    Raises
    ------
    DataError
        It cannot be written; the text names option and path.
    """
    try:
        if folder:
            _check_folder(path)
        else:
            _check_file(path, in_place)
    except OSError as error:
        raise DataError(f"Output {option} must be writable, but got {error.strerror or error} for {path}. Choose another path.") from error


def _check_file(path: Path, in_place: bool) -> None:
    if path.is_dir():
        raise _refusal(errno.EISDIR)
    if path.exists() and not path.is_file():
        # a terminal or a pipe: opened, it would wait for who reads it
        if not os.access(path, os.W_OK):
            raise _refusal(errno.EACCES)
        return
    if path.exists() and in_place:
        with path.open("ab"):
            return
    _check_folder(path.parent)


def _check_folder(folder: Path) -> None:
    """The folder, or the nearest one above it that is there; permissions alone do not tell of a full or a foreign file system."""
    while not folder.exists():
        folder = folder.parent
    if not folder.is_dir():
        raise _refusal(errno.ENOTDIR)
    with tempfile.TemporaryFile(dir=folder):
        pass


def _refusal(number: int) -> OSError:
    return OSError(number, os.strerror(number))
