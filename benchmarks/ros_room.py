"""A ROS domain and a folder of its own for the nodes of a benchmark; afterwards the environment is what it was."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from gyro_calib.cli.domain import leased_domain

__all__ = ["ros_room"]


@contextlib.contextmanager
def ros_room(**variables: str) -> Iterator[Path]:
    """Nodes that are started inside hear one another and nobody else.

    Parameters
    ----------
    **variables : str
        More of the environment.
    """
    before = dict(os.environ)
    with tempfile.TemporaryDirectory() as folder, leased_domain() as domain:
        os.environ |= {
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_HOME": folder,
            "ROS_LOG_DIR": folder,
            **variables,
        }
        try:
            yield Path(folder)
        finally:
            os.environ.clear()
            os.environ.update(before)
