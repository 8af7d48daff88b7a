"""Fixtures of all tests. ROS tests run isolated: a domain of their own, this machine only, files under the test's folder."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

# read when the message modules are imported, so before any of them: a wrong type in a field is then an error
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
# before numpy: threads of the linear algebra on small matrices cost many times what they give, the more the busier the machine
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
HAVE_ROS = importlib.util.find_spec("rclpy") is not None
collect_ignore = [] if HAVE_ROS else ["ros_helpers.py"]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what is marked ``ros`` on a machine without rclpy."""
    if not HAVE_ROS:
        for item in items:
            if item.get_closest_marker("ros"):
                item.add_marker(pytest.mark.skip(reason="rclpy is not installed"))


@pytest.fixture(scope="module", autouse=True)
def _nothing_kept(request: pytest.FixtureRequest) -> Iterator[None]:
    """Campaigns that the tests of one file share go with it: gigabytes, and a process that is forked copies their page tables."""
    yield
    for kept in vars(request.module).values():
        if hasattr(kept, "cache_clear") and kept.__module__ == request.module.__name__:
            kept.cache_clear()


@pytest.fixture(scope="session")
def ros_domain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """A ROS domain that no other test run on this machine has, with quick discovery."""
    from ros_isolation import clean_shared_memory, discovery_profile, lease_domain

    profile = tmp_path_factory.mktemp("dds") / "profile.xml"
    profile.write_text(discovery_profile())
    with lease_domain() as domain, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(domain))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        patch.setenv("FASTDDS_DEFAULT_PROFILES_FILE", str(profile))
        patch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(profile))
        patch.delenv("ROS_STATIC_PEERS", raising=False)
        clean_shared_memory()
        yield domain
        clean_shared_memory()


@pytest.fixture
def ros_environment(ros_domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Environment of the nodes of one test; returns its ``ROS_HOME``."""
    home = tmp_path / "ros_home"
    home.mkdir()
    monkeypatch.setenv("ROS_HOME", str(home))
    monkeypatch.setenv("ROS_LOG_DIR", str(home / "log"))
    return home


@pytest.fixture
def spawn_node(ros_environment: Path, tmp_path: Path) -> Iterator[Callable[..., Any]]:
    """Start nodes as processes of their own; see :func:`ros_processes.start_node`. They end with the test, however it ends."""
    from ros_isolation import clean_shared_memory
    from ros_processes import NodeProcess, start_node

    running: list[NodeProcess] = []

    def spawn(module: str, **options: Any) -> NodeProcess:
        running.append(start_node(module, folder=tmp_path, **options))
        return running[-1]

    yield spawn
    killed = [process for process in running if not process.stop()]
    if killed:
        clean_shared_memory()
    assert not killed, f"Nodes must end on SIGINT, but had to be killed: {[str(p) for p in killed]}"


@pytest.fixture
def ros(ros_environment: Path) -> Iterator[Any]:
    """rclpy of this process: nodes in it, served by a thread; see :class:`ros_helpers.RosSession`."""
    from ros_helpers import RosSession

    with RosSession() as session:
        yield session
