"""The launch files, run against stand-ins of launch and launch_ros: the executables, parameters and files that they name exist."""

from __future__ import annotations

import ast
import importlib
import sys
from pathlib import Path
from types import ModuleType

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
EXECUTABLES = {"gyro_sim_node": "gyro_sim", "calibration_node": "gyro_calibration", "imu_corrector_node": "imu_corrector"}
#: rclpy's own
OF_EVERY_NODE = {"use_sim_time"}


class Call:
    """Any class of launch: remembers how it was made."""

    def __init__(self, *arguments, **options):
        self.arguments, self.options = arguments, options


def stand_in(monkeypatch, name, **classes):
    module = ModuleType(name)
    for class_name in classes.pop("names"):
        setattr(module, class_name, type(class_name, (Call,), {}))
    monkeypatch.setitem(sys.modules, name, module)
    return module


@pytest.fixture
def described(monkeypatch):
    """Function: description of a launch file, as (arguments, nodes)."""
    stand_in(monkeypatch, "launch", names=["LaunchDescription"])
    stand_in(monkeypatch, "launch.actions", names=["DeclareLaunchArgument"])
    stand_in(monkeypatch, "launch.substitutions", names=["LaunchConfiguration", "PathJoinSubstitution", "PythonExpression"])
    stand_in(monkeypatch, "launch_ros", names=[])
    stand_in(monkeypatch, "launch_ros.actions", names=["Node"])
    stand_in(monkeypatch, "launch_ros.parameter_descriptions", names=["ParameterValue"])
    stand_in(monkeypatch, "launch_ros.substitutions", names=["FindPackageShare"])

    def describe(path):
        space: dict = {"__name__": "launched"}
        exec(compile(path.read_text(encoding="utf-8"), str(path), "exec"), space)
        items = space["generate_launch_description"]().arguments[0]
        declared = {item.arguments[0]: item.options for item in items if type(item).__name__ == "DeclareLaunchArgument"}
        return declared, [item.options for item in items if type(item).__name__ == "Node"]

    return describe


def words_of_nodes() -> set[str]:
    """Every text constant of the nodes: the names of their parameters are among them."""
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in (ROOT / "gyro_calib" / "nodes").glob("*.py")]
    return {node.value for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)}


def configurations(value):
    """Names of launch arguments that stand anywhere in a value."""
    if type(value).__name__ == "LaunchConfiguration":
        return {value.arguments[0]}
    if isinstance(value, Call):
        value = [*value.arguments, *value.options.values()]
    if isinstance(value, dict):
        value = list(value.values())
    return set().union(*map(configurations, value)) if isinstance(value, list | tuple) else set()


@pytest.mark.parametrize("path", sorted((ROOT / "launch").glob("*.launch.py")), ids=lambda p: p.name)
def test_launch_file_names_what_exists(described, path):
    declared, nodes = described(path)
    known = words_of_nodes() | OF_EVERY_NODE
    assert nodes
    for node in nodes:
        assert node["package"] == "gyro_calib"
        assert node["name"] == EXECUTABLES[node["executable"]]
        given = {name for part in node["parameters"] if isinstance(part, dict) for name in part}
        assert "use_sim_time" in given
        assert given - known == set()
        assert configurations(node) <= set(declared)
    assert all(options["description"] and options["default_value"] is not None for options in declared.values())
    used = set().union(*map(configurations, nodes))
    assert set(declared) == used, "an argument that nothing uses"


def test_calibrate_takes_the_arguments_of_the_readme(described):
    declared, nodes = described(ROOT / "launch" / "calibrate.launch.py")
    assert {"namespace", "device", "seed", "use_sim_time"} <= set(declared)
    assert [node["executable"] for node in nodes] == list(EXECUTABLES)
    assert (ROOT / "config" / "devices" / f"{declared['device']['default_value']}.yaml").is_file()


def test_triad_joins_three_namespaces(described):
    _, nodes = described(ROOT / "launch" / "triad.launch.py")
    gyros = [node for node in nodes if node["executable"] == "gyro_sim_node"]
    calibrations = [node for node in nodes if node["executable"] == "calibration_node"]
    (corrector,) = [node for node in nodes if node["executable"] == "imu_corrector_node"]
    assert [g["namespace"] for g in gyros] == [c["namespace"] for c in calibrations] == ["gyro_x", "gyro_y", "gyro_z"]
    assert [g["parameters"][2]["gyro_axis"] for g in gyros] == ["x", "y", "z"]
    assert [n["parameters"][2]["frame_id"] for n in (*gyros, *calibrations)] == ["gyro_x", "gyro_y", "gyro_z"] * 2
    assert corrector["parameters"][2]["gyros"] == ["gyro_x", "gyro_y", "gyro_z"]
    assert len(corrector["parameters"][2]["device_ids"]) == len(corrector["parameters"][2]["record_urls"]) == 3
    assert corrector["parameters"][2]["axes"] == [1, 0, 0, 0, 1, 0, 0, 0, 1]


@pytest.mark.ros
@pytest.mark.parametrize(
    ("executable", "change"),
    [
        ("gyro_sim_node", {"rate_raw_hz": 50.0}),
        ("calibration_node", {"stream_timeout_s": 4.0}),
        ("imu_corrector_node", {"covariance_horizon_s": 50.0}),
    ],
)
def test_node_declares_and_takes_every_parameter_of_the_file(ros, tmp_path, executable, change):
    from rclpy.node import Node

    path, name = tmp_path / "changed.yaml", EXECUTABLES[executable]
    content = yaml.safe_load((ROOT / "config" / "gyro_calib.yaml").read_text(encoding="utf-8"))
    wanted = content[f"/**/{name}"]["ros__parameters"]
    wanted |= change  # one that is not the node's default
    path.write_text(yaml.safe_dump(content))
    module = importlib.import_module(f"gyro_calib.nodes.{executable}")
    made = [c for c in vars(module).values() if isinstance(c, type) and issubclass(c, Node) and c.__module__ == module.__name__]
    node = made[0](namespace="/anywhere", cli_args=["--ros-args", "--params-file", str(path)])
    try:
        assert node.get_name() == name
        assert {key: node.get_parameter(key).value for key in wanted} == wanted
    finally:
        node.destroy_node()


@pytest.mark.parametrize("name", ["robot_localization_ekf.yaml", "imu_tools.yaml"])
def test_sample_configuration_is_a_parameter_file(name):
    content = yaml.safe_load((ROOT / "config" / name).read_text(encoding="utf-8"))
    assert all(set(node) == {"ros__parameters"} for node in content.values())


def test_ekf_takes_the_yaw_rate_alone():
    parameters = yaml.safe_load((ROOT / "config" / "robot_localization_ekf.yaml").read_text(encoding="utf-8"))
    imu = parameters["ekf_filter_node"]["ros__parameters"]
    assert [i for i, used in enumerate(imu["imu0_config"]) if used] == [11]
    assert len(imu["imu0_config"]) == len(imu["odom0_config"]) == 15
