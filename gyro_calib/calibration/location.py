"""Where a record lives: ``file://`` and ``package://`` URLs, plain paths, and the default under ``$ROS_HOME``."""

from __future__ import annotations

import os
from pathlib import Path
from urllib.parse import quote, unquote, urlsplit

from ..errors import StoreError

__all__ = ["default_path", "resolve_url", "ros_home"]


def ros_home() -> Path:
    """``$ROS_HOME``, or ``~/.ros``."""
    home = os.environ.get("ROS_HOME", "")
    return Path(home).expanduser() if home else Path.home() / ".ros"


def default_path(device_id: str) -> Path:
    """``$ROS_HOME/gyro_calib/<device>.yaml``, with special characters percent-encoded, so that no two devices share a file."""
    return ros_home() / "gyro_calib" / f"{quote(device_id, safe='')}.yaml"


def resolve_url(url_or_path: str | os.PathLike[str] | None, device_id: str) -> Path:
    """Return the file that a record of ``device_id`` is kept in.

    Parameters
    ----------
    url_or_path : str, path or None
        ``file:///abs/path.yaml``, ``package://package/path.yaml`` (in the share directory of an installed package), a path, or ``None``
        or ``""`` for :func:`default_path`. ``${ROS_HOME}`` and ``${DEVICE}`` are replaced. A directory (existing, or ending in ``/``)
        gets ``<device>.yaml``.
    device_id : str
        Identity of the unit.

    Raises
    ------
    StoreError
        Another scheme, a remote host, a relative file URL, an unknown package, or a path that leaves the package.
    """
    url = os.fspath(url_or_path) if url_or_path is not None else ""
    if not url:
        return default_path(device_id)
    safe_device = quote(device_id, safe="")
    path = _path(url.replace("${ROS_HOME}", str(ros_home())).replace("${DEVICE}", safe_device))
    if url.endswith("/") or path.is_dir():
        path = path / f"{safe_device}.yaml"
    return path.absolute()


def _path(url: str) -> Path:
    if "://" not in url:
        return Path(url).expanduser()
    try:
        parts = urlsplit(url)
    except ValueError as error:
        raise StoreError(f"Record URL must be file:// or package://, but got {url!r} ({error}).") from error
    path = unquote(parts.path)
    if parts.scheme == "file":
        if parts.netloc not in ("", "localhost") or not path.startswith("/"):
            raise StoreError(f"Record URL must name a local absolute file, but got {url!r}. Write file:///absolute/path.yaml.")
        return Path(path)
    if parts.scheme == "package":
        return _in_package(parts.netloc, path.lstrip("/"), url)
    raise StoreError(f"Record URL must be file:// or package://, but got {url!r}.")


def _in_package(package: str, relative: str, url: str) -> Path:
    try:
        from ament_index_python.packages import get_package_share_directory

        share = Path(get_package_share_directory(package))
    except (ImportError, LookupError, OSError, ValueError) as error:  # OSError: no AMENT_PREFIX_PATH
        raise StoreError(f"Record URL must name an installed package, but got {url!r} ({error}). Install it, or use file://.") from error
    # not resolved: in a symlink install the files of the share directory point into the source tree
    path = Path(os.path.normpath(share / relative))
    if not relative or not path.is_relative_to(os.path.normpath(share)):
        raise StoreError(f"Record URL must name a file inside the package, but got {url!r}.")
    return path
