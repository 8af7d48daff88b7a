"""Where the files that are not Python live: device descriptions, launch files, parameter files."""

from __future__ import annotations

import os
import re
import sysconfig
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from .errors import GyroCalibError

__all__ = ["package_version", "share_path"]

_NAME = "gyro_calib"
_PACKAGE = Path(__file__).resolve().parent


def share_path(*parts: str) -> Path:
    """Path of a shared file or folder, e.g. ``share_path("config", "devices", "ring_15k.yaml")``.

    Looked for in the source checkout (so that an edit counts at once), then in ``share/gyro_calib`` of the prefix the package is
    installed under (pip or colcon), of the interpreter's data prefixes, and of every prefix of the ament index.

    Parameters
    ----------
    *parts : str
        Path below the share directory; none gives the directory itself.

    Returns
    -------
    Path
        An existing path.

    Raises
    ------
    GyroCalibError
        No such file in any of them; the text lists the places.
    """
    looked_in: list[Path] = []
    for root in _roots():
        path = root.joinpath(*parts)
        if path.exists():
            return path
        looked_in.append(root)
    wanted = "/".join(parts) or "its share directory"
    places = ", ".join(map(str, looked_in)) or "no share directory at all"
    raise GyroCalibError(
        f"Shared file of {_NAME} must be installed with the package, but got no {wanted!r} in {places}. "
        "Install the package by pip or colcon, source its workspace, or check the name."
    )


@lru_cache(maxsize=1)
def package_version() -> str:
    """Version of the package, as package.xml states it (the one place that does).

    Raises
    ------
    GyroCalibError
        There is no package.xml, or no version in it.
    """
    text = share_path("package.xml").read_text(encoding="utf-8")
    match = re.search(r"<version>\s*([^<\s]+)\s*</version>", text)
    if match is None:
        raise GyroCalibError(f"package.xml of {_NAME} must have a <version>, but got none. Install the package anew.")
    return match.group(1)


def _roots() -> Iterator[Path]:
    """Share directories that exist, best first, each once."""
    seen: set[Path] = set()
    for root in _candidates():
        if root not in seen and (root / "package.xml").is_file():
            seen.add(root)
            yield root


def _candidates() -> Iterator[Path]:
    checkout = _PACKAGE.parent
    if (checkout / "resource" / _NAME).is_file():
        yield checkout
    tail = Path("share", _NAME)
    # site-packages or dist-packages of a venv, a user scheme, /usr/local or a colcon prefix: the prefix is an ancestor in each
    for ancestor in _PACKAGE.parents:
        yield ancestor / tail
    for scheme in (sysconfig.get_default_scheme(), sysconfig.get_preferred_scheme("user")):
        yield Path(sysconfig.get_path("data", scheme)) / tail
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        yield Path(prefix) / tail
