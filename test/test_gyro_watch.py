"""What is known of a gyro without asking: its answers in order, a lost one forgiven, the newest rows and no more."""

from __future__ import annotations

import json
import threading
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from gyro_calib.errors import DataError, ExperimentAborted
from gyro_calib.nodes.gyro_watch import GyroFacts, GyroWatch, RecentRows
from gyro_calib.recording.command import Command

pytestmark = pytest.mark.ros


class Driver:
    """Answers like a gyro's driver; ``error`` makes it fail."""

    def __init__(self) -> None:
        self.values: dict[str, Any] = {"device_id": "a", "factory": json.dumps({"kind": "ring"}), "sample_rate_hz": 500.0}
        self.values |= Command("ftr_y").to_parameters()
        self.error: Exception | None = None

    def get(self, names: Any) -> dict[str, Any]:
        if self.error is not None:
            raise self.error
        return {name: self.values[name] for name in names}


@pytest.fixture
def driver() -> Driver:
    return Driver()


def test_facts_are_what_the_driver_says(driver: Driver) -> None:
    assert GyroFacts.read(driver.get) == GyroFacts("a", {"kind": "ring"}, 500.0, Command("ftr_y"))
    driver.values["factory"] = "not JSON"
    with pytest.raises(DataError, match="must be JSON"):
        GyroFacts.read(driver.get)


def test_an_answer_is_acted_on_before_anybody_sees_it(driver: Driver) -> None:
    seen: list[Any] = []
    watch = GyroWatch(driver.get, lambda facts: seen.append((facts.device_id, watch.facts)), lambda: None)
    assert watch.facts is None
    assert "not answered yet" in watch.problem
    watch.ask()
    assert seen == [("a", None)]
    assert watch.facts is not None
    assert watch.problem == ""


def test_one_lost_answer_is_forgiven_and_two_are_not(driver: Driver) -> None:
    watch = GyroWatch(driver.get, lambda facts: None, lambda: None)
    driver.error = ExperimentAborted("Gyro must answer.")
    watch.ask()
    assert watch.problem == "Gyro must answer.", "with nothing known, nothing is forgiven"
    driver.error = None
    watch.ask()
    driver.error = ExperimentAborted("Gyro must answer.")
    watch.ask()
    assert watch.problem == ""
    watch.ask()
    assert watch.problem == "Gyro must answer."
    assert watch.facts is not None, "what was known stays known"
    driver.error = None
    watch.ask()
    assert watch.problem == ""


def test_the_thread_goes_on_after_an_unexpected_error_and_ends_when_told(driver: Driver) -> None:
    attempts, enough = [], threading.Event()

    def attempt() -> None:
        attempts.append(watch.problem)
        if len(attempts) == 1:
            raise ZeroDivisionError("in the listener")
        enough.set()

    watch = GyroWatch(driver.get, lambda facts: None, attempt, period_s=0.01)
    watch.start()
    assert enough.wait(20.0)
    watch.stop()
    assert not watch._thread.is_alive()


def rows(start_s: float, count: int = 50) -> np.ndarray:
    block = np.zeros((count, 12))
    block[:, 0] = start_s + np.arange(count) / 500.0
    return block


def test_recent_rows_keep_two_seconds_in_order() -> None:
    recent = RecentRows()
    assert recent.rows() is None
    assert recent.age_s == np.inf
    for k in range(100):
        recent.put(rows(0.1 * k))
    kept = recent.rows()
    assert kept is not None
    assert (np.diff(kept[:, 0]) > 0).all()
    assert 1.9 < kept[-1, 0] - kept[0, 0] < 2.2


def test_recent_rows_forget_what_was_before_a_restart_of_the_gyro() -> None:
    recent = RecentRows()
    for k in range(20):
        recent.put(rows(1000.0 + 0.1 * k))
    recent.put(rows(0.0))
    kept = recent.rows()
    assert kept is not None
    assert kept[-1, 0] < 1.0
    assert kept[0, 0] < 1.0


def test_recent_rows_are_bounded_whatever_the_clock_says() -> None:
    recent = RecentRows()
    for _ in range(1000):
        recent.put(rows(5.0))
    kept = recent.rows()
    assert kept is not None
    assert kept.shape[0] <= 20_000 + 50


def test_an_unusable_block_is_remembered_until_a_good_one_comes() -> None:
    now = [10.0]
    recent = RecentRows(lambda: now[0])
    recent.put(rows(0.0))
    now[0] = 12.0
    recent.put(DataError("A block must have 2 dimensions."))
    assert recent.error == "A block must have 2 dimensions."
    assert recent.age_s == 2.0, "an unusable block is no sign of life"
    recent.put(rows(0.1))
    assert recent.error == ""
    assert recent.age_s == 0.0
