"""The package says everything once, names what it needs, and places what ROS looks for, by pip as by colcon."""

from __future__ import annotations

import ast
import os
import re
import runpy
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

import gyro_calib
from gyro_calib import paths
from gyro_calib.errors import GyroCalibError

ROOT = Path(__file__).resolve().parents[1]
if sys.version_info >= (3, 11):
    import tomllib
else:
    tomllib = pytest.importorskip("tomli")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
MANIFEST = ET.parse(ROOT / "package.xml").getroot()
NODES = ("gyro_sim_node", "calibration_node", "imu_corrector_node")
#: what is imported under another name than its rosdep key
ROSDEP_KEYS = {name: f"python3-{name}" for name in ("h5py", "matplotlib", "numba", "numpy", "rich", "scipy", "yaml")}
#: no rosdep key that a released package may name
PIP_ONLY = {"rosbags"}


def setup_arguments(monkeypatch, command):
    """What setup.py hands to setuptools under a command."""
    setuptools = pytest.importorskip("setuptools")
    taken = {}
    monkeypatch.setattr(setuptools, "setup", lambda **arguments: taken.update(arguments))
    monkeypatch.setattr(sys, "argv", ["setup.py", command])
    runpy.run_path(str(ROOT / "setup.py"))
    return taken


def test_version_stands_in_package_xml_alone(monkeypatch):
    version = MANIFEST.findtext("version")
    assert re.fullmatch(r"\d+\.\d+\.\d+", version or "")
    assert gyro_calib.__version__ == version == paths.package_version() == setup_arguments(monkeypatch, "install")["version"]
    assert "version" in PROJECT["project"]["dynamic"]
    others = [p for p in (*ROOT.glob("*.py"), *ROOT.glob("*.toml"), *ROOT.glob("*.cfg"), *(ROOT / "gyro_calib").glob("*.py"))]
    assert [p.name for p in others if re.search(rf"[\"']{re.escape(version)}[\"']", p.read_text(encoding="utf-8"))] == []
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = gyro_calib.nothing


def test_package_xml_names_everything_that_is_imported():
    assert MANIFEST.get("format") == "3"
    assert MANIFEST.findtext("export/build_type") == "ament_python"
    depends = {element.text for element in MANIFEST if element.tag.endswith("depend")}
    imported = set()
    for path in [*(ROOT / "gyro_calib").rglob("*.py"), *(ROOT / "launch").glob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                imported |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                imported.add(node.module.split(".")[0])
    foreign = imported - set(sys.stdlib_module_names) - {"gyro_calib"} - PIP_ONLY
    assert {"rclpy", "sensor_msgs", "numpy", "yaml"} <= foreign
    keys = {ROSDEP_KEYS.get(name, name) for name in foreign}
    assert keys - depends == set()


def test_colcon_reads_what_it_needs_from_setup_py(monkeypatch):
    """It evaluates the options as literals, and a symlink install has no pyproject.toml."""
    arguments = setup_arguments(monkeypatch, "develop")
    assert "requires-python" not in PROJECT["project"]  # setuptools would make an object of it
    assert {"gyro_calib", "gyro_calib.nodes", "gyro_calib.recording"} <= set(arguments["packages"])
    options = {key: value for key, value in arguments.items() if key != "distclass"}
    assert ast.literal_eval(repr(options)) == options


def test_pip_extras_cover_everything_that_is_imported():
    project = PROJECT["project"]
    assert set(project["optional-dependencies"]) >= {"ros", "viz", "bags", "fast", "test", "dev"}
    wanted = [*project["dependencies"], *(item for extra in project["optional-dependencies"].values() for item in extra)]
    names = {re.match(r"[A-Za-z0-9_.-]+", item)[0].lower() for item in wanted}
    assert {"numpy", "scipy", "pyyaml", "h5py", "rich", "matplotlib", "rosbags", "numba"} <= names
    assert {"ros-jazzy-rclpy", "ros-jazzy-common-interfaces", "pytest", "hypothesis", "ruff", "mypy"} <= names


def test_entry_points_exist(monkeypatch):
    scripts = dict(line.split(" = ") for line in setup_arguments(monkeypatch, "install")["entry_points"]["console_scripts"])
    assert set(scripts) == {"gyro-calib", *NODES}
    for name, target in scripts.items():
        module, _, function = target.partition(":")
        path = ROOT / (module.replace(".", "/") + ".py")
        assert path.is_file(), f"{name}: {path}"
        functions = {n.name for n in ast.parse(path.read_text(encoding="utf-8")).body if isinstance(n, ast.FunctionDef)}
        assert function in functions, f"{name}: {target}"


def test_data_files_place_what_ros_looks_for(monkeypatch):
    placed = {
        f"{folder}/{Path(name).name}" for folder, names in setup_arguments(monkeypatch, "bdist_wheel")["data_files"] for name in names
    }
    assert "share/ament_index/resource_index/packages/gyro_calib" in placed
    assert "share/gyro_calib/package.xml" in placed
    for top in ("launch", "config"):
        files = [p for p in (ROOT / top).rglob("*") if p.is_file() and "__pycache__" not in p.parts]
        assert files
        assert {f"share/gyro_calib/{p.relative_to(ROOT)}" for p in files} <= placed
    assert {f"lib/gyro_calib/{name}" for name in NODES} <= placed
    by_colcon = setup_arguments(monkeypatch, "install")["data_files"]
    assert "lib/gyro_calib" not in dict(by_colcon)  # there the entry points themselves come to stand
    assert (ROOT / "setup.cfg").read_text().count("$base/lib/gyro_calib") == 2


@pytest.mark.parametrize("name", NODES)
def test_executable_of_ros2_run_hands_over_to_the_entry_point(tmp_path, name):
    for folder in ("lib/gyro_calib", "bin"):
        (tmp_path / "a b" / folder).mkdir(parents=True)
    entry = tmp_path / "a b" / "bin" / name
    entry.write_text('#!/bin/sh\nprintf "%s|" "$@"\nexit 7\n')
    entry.chmod(0o755)
    shutil.copy(ROOT / "scripts" / name, tmp_path / "a b" / "lib" / "gyro_calib" / name)
    command = [str(tmp_path / "a b" / "lib" / "gyro_calib" / name), "--ros-args", "-r", "__ns:=/g", "two words"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
    assert (done.returncode, done.stdout) == (7, "--ros-args|-r|__ns:=/g|two words|")


def test_installed_package_has_its_share_and_executables(tmp_path):
    """A real install of a copy, without the network."""
    pytest.importorskip("setuptools")
    source = tmp_path / "source"
    shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(".*", "test", "benchmarks", "docs", "out", "build", "__pycache__"))
    (source / "README.md").touch()
    # without --ignore-installed, pip would first take the package out of the environment that runs this test
    options = ["-q", "--no-deps", "--no-build-isolation", "--ignore-installed", "--prefix", str(tmp_path / "prefix")]
    command = [sys.executable, "-m", "pip", "install", *options, "."]
    done = subprocess.run(command, cwd=source, capture_output=True, text=True, timeout=300, check=False)
    if "invalid command 'bdist_wheel'" in done.stderr:
        pytest.skip("setuptools here is older than 70.1")
    assert done.returncode == 0, done.stderr
    prefix = next(p.parents[2] for p in (tmp_path / "prefix").rglob("share/gyro_calib/package.xml"))
    for name in NODES:
        assert os.access(prefix / "lib" / "gyro_calib" / name, os.X_OK)
        assert os.access(prefix / "bin" / name, os.X_OK)
    assert list((prefix / "share" / "gyro_calib" / "config" / "devices").glob("*.yaml"))
    site = next((tmp_path / "prefix").rglob("gyro_calib/paths.py")).parents[1]
    code = "from gyro_calib.paths import share_path, package_version; print(share_path('launch'), package_version())"
    found = subprocess.run(
        [sys.executable, "-P" if sys.version_info >= (3, 11) else "-s", "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(site)},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert found.stdout.split() == [str(prefix / "share" / "gyro_calib" / "launch"), gyro_calib.__version__]


def test_share_path_prefers_the_checkout_and_lists_where_it_looked():
    assert paths.share_path("config", "devices") == ROOT / "config" / "devices"
    assert paths.share_path() == ROOT
    with pytest.raises(GyroCalibError, match=rf"but got no 'config/none.yaml' in {re.escape(str(ROOT))}.* Install the package"):
        paths.share_path("config", "none.yaml")


def test_share_path_finds_an_ament_prefix(tmp_path, monkeypatch):
    share = tmp_path / "install" / "share" / "gyro_calib"
    (share / "config").mkdir(parents=True)
    (share / "package.xml").write_text("<package/>")
    monkeypatch.setattr(paths, "_PACKAGE", tmp_path / "elsewhere" / "gyro_calib")
    monkeypatch.setattr(paths.sysconfig, "get_path", lambda name, scheme: str(tmp_path / "no prefix"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(["", str(tmp_path / "none"), str(tmp_path / "install")]))
    assert paths.share_path("config") == share / "config"
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    with pytest.raises(GyroCalibError, match="no share directory at all"):
        paths.share_path("config")


def test_find_python_passes_over_what_does_not_run(tmp_path):
    (tmp_path / "python3").write_text("#!/bin/sh\nexit 127\n")  # a version manager's shim without a version
    (tmp_path / "python3").chmod(0o755)
    run = [shutil.which("bash"), str(ROOT / "scripts" / "find-python")]
    none = subprocess.run(run, env={"PATH": str(tmp_path)}, capture_output=True, text=True, timeout=60, check=False)
    assert (none.returncode, none.stdout) == (1, "")
    assert "Python 3.10 to 3.13 must be on PATH" in none.stderr
    real = tmp_path / "python3.11"
    real.write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')
    real.chmod(0o755)
    environment = {**os.environ, "PATH": str(tmp_path)}
    found = subprocess.run(run, env=environment, capture_output=True, text=True, timeout=60, check=True)
    assert found.stdout == "python3.11\n"


@pytest.mark.skipif(shutil.which("make") is None, reason="no make")
@pytest.mark.parametrize(
    ("target", "command"),
    [
        ("demo", ".venv/bin/gyro-calib demo --seed 3"),
        ("test", ".venv/bin/python -m pytest --seed 3"),
        ("bench", ".venv/bin/python benchmarks/run.py --seed 3"),
        ("lint", ".venv/bin/mypy"),
    ],
)
def test_make_passes_arguments_on(target, command):
    done = subprocess.run(["make", "-n", target, "ARGS=--seed 3"], cwd=ROOT, capture_output=True, text=True, timeout=60, check=True)
    assert command in done.stdout.splitlines()
