"""Real node processes without a launch system: start, forward their logs with a prefix, stop them cleanly."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import IO, Any

__all__ = ["NODES", "NodeGroup", "ros_arguments"]

#: name of a node -> its module, in the order in which they are started
NODES = {
    "gyro_sim": "gyro_calib.nodes.gyro_sim_node",
    "gyro_calibration": "gyro_calib.nodes.calibration_node",
    "imu_corrector": "gyro_calib.nodes.imu_corrector_node",
}
#: how long a node may take to end after SIGINT before it is killed [s]
_PATIENCE_S = 10.0


def ros_arguments(namespace: str, parameters: Mapping[str, Any]) -> list[str]:
    """``--ros-args`` that put a node into a namespace with parameters; a value is written as YAML."""
    import yaml

    arguments = ["--ros-args", "-r", f"__ns:=/{namespace.strip('/')}"]
    for name, value in parameters.items():
        text = yaml.safe_dump(value, default_flow_style=True, width=10**6).strip().removesuffix("...").strip()
        arguments += ["-p", f"{name}:={text}"]
    return arguments


@dataclass
class _Child:
    name: str
    process: subprocess.Popen[str]
    reader: threading.Thread


class NodeGroup:
    """Node processes that live and end together; a context manager.

    Parameters
    ----------
    environment : mapping of str to str
        Added to the environment of the children (``ROS_DOMAIN_ID``, …).
    on_line : callable
        Called with (name of the node, line of its output), from another thread.
    """

    def __init__(self, environment: Mapping[str, str], on_line: Callable[[str, str], None]) -> None:
        self._environment = {**os.environ, "PYTHONUNBUFFERED": "1", **environment}
        self._on_line = on_line
        self._children: list[_Child] = []

    def start(self, name: str, module: str, arguments: Sequence[str]) -> int:
        """Start a node in a process of its own; returns its process id."""
        command = [sys.executable, "-m", "gyro_calib.cli.child", module, *arguments]
        # a session of its own: Ctrl-C in the terminal reaches this process alone, which then ends them once, in order
        process = subprocess.Popen(
            command,
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        reader = threading.Thread(target=self._forward, args=(name, process.stdout), daemon=True)
        reader.start()
        self._children.append(_Child(name, process, reader))
        return process.pid

    def ended(self) -> tuple[str, int] | None:
        """Name and exit code of a node that has ended, or None while all run."""
        for child in self._children:
            code = child.process.poll()
            if code is not None:
                return child.name, code
        return None

    def stop(self) -> None:
        """SIGINT to each, last started first; who does not end in time is killed."""
        for child in reversed(self._children):
            if child.process.poll() is None:
                child.process.send_signal(signal.SIGINT)
        deadline = time.monotonic() + _PATIENCE_S
        for child in self._children:
            try:
                child.process.wait(max(0.1, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                child.process.kill()
                child.process.wait()
            child.reader.join(timeout=2.0)
        self._children.clear()

    def __enter__(self) -> NodeGroup:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.stop()

    def _forward(self, name: str, stream: IO[str]) -> None:
        for line in stream:
            self._on_line(name, line.rstrip("\n"))
