"""A clock that is set while all runs: a robot simulator reset or skipping ahead; a wall clock that was wrong when a record was made."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from calibration_samples import make_record

from gyro_calib.calibration import RecordStore, validity_problems

DEVICE = "ring_15k-0007"
#: simulated seconds per second
PACE = 40.0


@pytest.mark.parametrize("year", ["1970", "2099"], ids=["no clock yet", "far ahead"])
def test_the_newest_record_is_the_one_saved_last_whatever_its_clock_said(tmp_path: Path, year: str) -> None:
    """A robot that boots without a clock stamps 1970; order is by save, and the age of a record never makes it invalid without a word."""
    store = RecordStore(tmp_path / "gyro.yaml", DEVICE)
    first, second = make_record(DEVICE), make_record(DEVICE, created_utc=f"{year}-01-01T00:00:00Z")
    store.save(first)
    store.save(second)
    assert store.load().record_id == second.record_id
    assert store.previous()[0].record.record_id == first.record_id
    assert store.revert().record_id == first.record_id
    problems = validity_problems(second, now=first.created)
    assert bool(problems) == (year == "1970")
    assert all("Calibrate again" in problem for problem in problems)


class SimulatedClock:
    """Publishes ``/clock`` as a robot simulator does, and can be set."""

    def __init__(self, node: Any) -> None:
        from rosgraph_msgs.msg import Clock

        self.now_s = 1000.0
        self._message = Clock()
        self._publisher = node.create_publisher(Clock, "/clock", 10)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        last = time.monotonic()
        while not self._ended.wait(0.005):
            now = time.monotonic()
            # a machine that stalls must not look like a jump
            self.now_s += PACE * min(now - last, 0.05)
            last = now
            self._message.clock.sec, self._message.clock.nanosec = int(self.now_s), int(self.now_s % 1.0 * 1e9)
            self._publisher.publish(self._message)

    def end(self) -> None:
        self._ended.set()
        self._thread.join()


@pytest.fixture
def clock(ros: Any) -> Iterator[SimulatedClock]:
    clock = SimulatedClock(ros.node("robot_simulator"))
    yield clock
    clock.end()


@pytest.mark.ros
def test_a_simulation_that_is_reset_and_skips_ahead_spoils_neither_run_nor_rate(
    ros: Any, clock: SimulatedClock, spawn_node: Callable[..., Any]
) -> None:
    """Three processes on ``use_sim_time``. The gyro's own time goes on: the run is done and right, and stamps follow the clock."""
    from calibration_rig import CalibrationClient
    from diagnostic_msgs.msg import DiagnosticStatus
    from ros_helpers import wait_for
    from sensor_msgs.msg import Imu

    from gyro_calib.device import draw_unit, load_device
    from gyro_calib.nodes.runtime import LATCHED_QOS
    from gyro_calib.recording.command import Command
    from gyro_calib.simulation.truth import truth_of

    client = CalibrationClient(ros)
    imu = ros.listen(client.node, Imu, "imu/data_raw")
    status = ros.listen(client.node, DiagnosticStatus, "imu_corrector/status", LATCHED_QOS)
    gyro = spawn_node("gyro_sim_node", parameters={"fidelity": "slow_flow", "seed": 7, "use_sim_time": True})
    spawn_node("calibration_node", parameters={"plan_quality": "quick", "use_sim_time": True})
    spawn_node("imu_corrector_node", parameters={"use_sim_time": True})
    client.wait_ready()
    run_id = client.run()
    client.wait_value("state", "running")

    def follows() -> bool:
        stamp = imu.messages[-1].header.stamp if imu.messages else None
        return stamp is not None and abs(stamp.sec - clock.now_s) < 6.0

    for now_s in (1.0, 100_000.0):
        wait_for(lambda: client.values["state"] != "running" or float(client.values["fraction"]) > 0.3, 60.0, "some of the run")
        assert client.values["state"] == "running", client.text
        clock.now_s = now_s
        imu.messages.clear()
        wait_for(follows, 30.0, f"stamps near {now_s}")
    assert client.wait_end(run_id) == "done", client.text
    assert "Clock must not go backwards" in gyro.output
    assert "stamps jump ahead" in gyro.output
    record = RecordStore(None, DEVICE).load()
    truth = truth_of(draw_unit(load_device("ring_15k"), 7), Command(), 0.0)
    assert abs(record.bias.value - truth.bias_rad_s) < 5.0 * record.bias.sd

    def restarts() -> int:
        return int(next(pair.value for pair in status.messages[-1].values if pair.key == "time_restarts"))

    wait_for(lambda: restarts() >= 1, 20.0, "the step back in the corrector's status")
    wait_for(lambda: status.messages[-1].level == b"\x00" and record.record_id in status.messages[-1].message, 30.0, "a corrected rate")
    wait_for(follows, 30.0, "stamps of the clock")
