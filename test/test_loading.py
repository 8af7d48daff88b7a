"""What is loaded when: a corrector runs for months beside others, a command line answers at once."""

from __future__ import annotations

import subprocess
import sys

import pytest

import gyro_calib.calibration
import gyro_calib.experiments
import gyro_calib.recording


def loaded_by(statement: str) -> set[str]:
    """Top-level modules of a fresh interpreter after a statement."""
    code = f"import sys\n{statement}\nprint(' '.join({{name.partition('.')[0] for name in sys.modules}}))"
    return set(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split())


@pytest.mark.ros
def test_corrector_loads_no_estimator() -> None:
    found = loaded_by("import gyro_calib.nodes.imu_corrector_node")
    assert "numpy" in found
    assert not found & {"scipy", "numba", "h5py", "matplotlib", "rosbags"}


@pytest.mark.ros
def test_calibration_node_loads_no_simulator() -> None:
    found = loaded_by("import gyro_calib.nodes.calibration_node")
    assert "scipy" in found
    assert not found & {"numba", "matplotlib", "rosbags"}


def test_command_line_loads_nothing_before_it_is_asked() -> None:
    assert not loaded_by("import gyro_calib.cli.main as m; m.build_parser()") & {"numpy", "scipy", "h5py", "matplotlib", "rclpy"}


@pytest.mark.parametrize("package", [gyro_calib.calibration, gyro_calib.experiments, gyro_calib.recording])
def test_every_promised_name_is_there(package) -> None:
    assert all(getattr(package, name) is not None for name in package.__all__)
    with pytest.raises(AttributeError, match="has no attribute 'nonsense'"):
        package.nonsense  # noqa: B018
