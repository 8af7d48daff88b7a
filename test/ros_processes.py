"""Real nodes in processes of their own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parent.parent


def wait_for(predicate: Callable[[], Any], timeout_s: float = 30.0, what: str = "the condition") -> Any:
    """Ask ``predicate`` until it answers something true, which is returned; AssertionError after ``timeout_s``."""
    deadline = time.monotonic() + timeout_s
    while True:
        if answer := predicate():
            return answer
        assert time.monotonic() < deadline, f"waited {timeout_s:g} s for {what}"
        time.sleep(0.02)


class NodeProcess:
    """A node's process and what it has said."""

    def __init__(self, process: subprocess.Popen[bytes], log: Path, name: str) -> None:
        self.process = process
        self.log = log
        self.name = name

    def __str__(self) -> str:
        return f"{self.name} (pid {self.process.pid}, exit code {self.process.poll()}):\n{self.output}"

    @property
    def output(self) -> str:
        """Everything on stdout and stderr so far."""
        return self.log.read_text(errors="replace")

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        return self.process.poll() is None

    def wait_output(self, text: str, timeout_s: float = 60.0) -> str:
        """Wait until ``text`` appears in the output, which is returned; fails at once if the process ends before."""

        def said() -> bool:
            assert text in self.output or self.running, f"ended before it said {text!r}: {self}"
            return text in self.output

        wait_for(said, timeout_s, f"{text!r} from {self}")
        return self.output

    def wait_exit(self, timeout_s: float = 60.0) -> int:
        """Exit code, when it has ended of itself."""
        return self.process.wait(timeout_s)

    def signal(self, number: int) -> None:
        """Send a signal to the node alone."""
        self.process.send_signal(number)

    def kill(self) -> None:
        """SIGKILL to the whole group, as a power cut."""
        if self.running:
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait(30)

    def stop(self, timeout_s: float = 30.0) -> bool:
        """End it by SIGINT; False if it had to be killed."""
        if self.running:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(timeout_s)
            except subprocess.TimeoutExpired:
                self.kill()
                return False
        return True


def start_node(
    module: str,
    *,
    folder: Path,
    namespace: str = "/",
    parameters: Mapping[str, Any] | None = None,
    remap: Mapping[str, str] | None = None,
    arguments: Sequence[str] = (),
    environment: Mapping[str, str] | None = None,
) -> NodeProcess:
    """Start ``python -m module`` as a node.

    Parameters
    ----------
    module : str
        Name below ``gyro_calib.nodes`` (``"gyro_sim_node"``), a full one, or the file name of a script beside this one.
    folder : Path
        Where its output and parameter file go.
    namespace : str
        ROS namespace.
    parameters : mapping
        By name; types are kept.
    remap : mapping
        Names to remap.
    arguments : sequence of str
        Further ones, before ``--ros-args``.
    environment : mapping
        Set over that of this process.
    """
    node = ["-m", module if "." in module else f"gyro_calib.nodes.{module}"]
    program = [str(ROOT / "test" / module)] if module.endswith(".py") else node
    count = len(list(folder.glob(f"{module}_*.log")))
    log = folder / f"{module}_{count}.log"
    command = [sys.executable, *program, *arguments, "--ros-args", "-r", f"__ns:={namespace}"]
    if parameters:
        file = folder / f"{module}_{count}.yaml"
        file.write_text(yaml.safe_dump({"/**": {"ros__parameters": dict(parameters)}}))
        command += ["--params-file", str(file)]
    for source, target in (remap or {}).items():
        command += ["-r", f"{source}:={target}"]
    surroundings = {**os.environ, "PYTHONUNBUFFERED": "1", **(environment or {})}
    surroundings["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), surroundings.get("PYTHONPATH")]))
    with log.open("wb") as out:
        process = subprocess.Popen(
            command, stdout=out, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, env=surroundings, cwd=folder, start_new_session=True
        )
    return NodeProcess(process, log, module)
