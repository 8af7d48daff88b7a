"""What pyproject.toml cannot say, or colcon does not read there: packages, executables, and the ROS resources in share/ and lib/."""

import re
import sys
from pathlib import Path

from setuptools import Distribution, find_packages, setup

ROOT = Path(__file__).resolve().parent
NAME = "gyro_calib"
NODES = ("gyro_sim_node", "calibration_node", "imu_corrector_node")


def package_xml_version() -> str:
    """Version of package.xml, the only place that states it."""
    match = re.search(r"<version>\s*([^<\s]+)\s*</version>", (ROOT / "package.xml").read_text(encoding="utf-8"))
    if match is None:
        raise SystemExit("package.xml must have a <version>, but got none.")
    return match.group(1)


def data_files() -> list[tuple[str, list[str]]]:
    """Ament index marker and share directory; for pip also the executables of ``ros2 run`` (colcon puts the entry points there)."""
    files = [
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ]
    for top in ("launch", "config"):
        folders = [ROOT / top, *(path for path in sorted((ROOT / top).rglob("*")) if path.is_dir() and path.name != "__pycache__")]
        for folder in folders:
            names = [str(path.relative_to(ROOT)) for path in sorted(folder.iterdir()) if path.is_file()]
            if names:
                files.append((f"share/{NAME}/{folder.relative_to(ROOT)}", names))
    if {"bdist_wheel", "editable_wheel"} & set(sys.argv):
        files.append((f"lib/{NAME}", [f"scripts/{node}" for node in NODES]))
    return files


class RosDistribution(Distribution):
    """Lets an editable install place the data files too: setuptools asks ``has_data``, which no distribution answers by itself."""

    def has_data(self) -> bool:
        """Whether there are data files."""
        return bool(self.data_files)


setup(
    name=NAME,
    version=package_xml_version(),
    license="Apache-2.0",
    python_requires=">=3.10,<3.14",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed"]},
    entry_points={"console_scripts": [f"gyro-calib = {NAME}.cli.main:main", *(f"{node} = {NAME}.nodes.{node}:main" for node in NODES)]},
    data_files=data_files(),
    zip_safe=False,
    distclass=RosDistribution,
)
