"""Only nodes/ and cli/ know ROS: everything else imports where there is none, and nothing below them imports them."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "gyro_calib"
ROS = ("rclpy", "rcl_interfaces", "std_srvs", "builtin_interfaces", "launch", "launch_ros", "rosidl_runtime_py")
MODULES = sorted(path for path in PACKAGE.rglob("*.py") if "__pycache__" not in path.parts)
CORE = [path for path in MODULES if path.relative_to(PACKAGE).parts[0] not in ("nodes", "cli")]

#: a folder -> those it may import; others of the package are above it
BELOW = {
    "effects": set(),
    "device": {"effects"},
    "recording": set(),
    "simulation": {"device", "effects", "recording"},
}

IMPORT_ALL = """
import importlib, sys

class NoRos:
    def find_spec(self, name, path=None, target=None):
        top = name.split(".")[0]
        if top in {ros!r} or top == "ament_index_python" or top.endswith("_msgs"):
            raise ImportError("ROS is not there: " + name)

sys.meta_path.insert(0, NoRos())
for name in {names!r}:
    importlib.import_module(name)
print(len({names!r}), "imported")
"""


def dotted(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(path: Path) -> set[str]:
    """Absolute dotted names that a module imports, anywhere in it."""
    own = path.relative_to(ROOT).with_suffix("").parts
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(own[: len(own) - node.level]) + "." if node.level else ""
            module = (base + (node.module or "")).rstrip(".")
            found |= {f"{module}.{alias.name}" for alias in node.names}
    return found


def is_ros(name: str) -> bool:
    top = name.split(".")[0]
    return top in ROS or top.endswith("_msgs")


def test_the_scan_sees_imports():
    assert any(is_ros(name) for path in (PACKAGE / "nodes").glob("*.py") for name in imports(path))
    assert "gyro_calib.errors.DataError" in imports(PACKAGE / "recording" / "integrity.py")


@pytest.mark.parametrize("path", CORE, ids=dotted)
def test_core_module_imports_neither_ros_nor_nodes(path):
    forbidden = sorted(name for name in imports(path) if is_ros(name) or name.startswith(("gyro_calib.nodes", "gyro_calib.cli")))
    assert forbidden == []


@pytest.mark.parametrize("folder", BELOW)
def test_data_runs_one_way(folder):
    upward = {
        f"{dotted(path)} imports {name}"
        for path in (PACKAGE / folder).rglob("*.py")
        for name in imports(path)
        if name.startswith("gyro_calib.") and (PACKAGE / name.split(".")[1]).is_dir() and name.split(".")[1] not in BELOW[folder] | {folder}
    }
    assert upward == set()


def test_core_imports_where_there_is_no_ros():
    names = tuple(dotted(path) for path in CORE if path.name != "__main__.py")
    code = IMPORT_ALL.format(ros=ROS, names=names)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[-2:] == [str(len(names)), "imported"]
