"""The work of a run on a simulated gyro, without ROS: what it leaves behind when it succeeds, and when it does not."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyro_calib.calibration.record import CalibrationRecord
from gyro_calib.device import draw_unit, load_device
from gyro_calib.errors import DataError, ExperimentAborted, StoreError
from gyro_calib.experiments import Plan, SimulatedInstrument, Step
from gyro_calib.nodes.calibration_runs import RUNS, CalibrationRun, KeptRecordings, record_results
from gyro_calib.nodes.run_manager import RunManager, RunState, RunStatus
from gyro_calib.recording.command import Command
from gyro_calib.recording.load import load_campaign
from gyro_calib.recording.recording import Recording
from gyro_calib.simulation import GyroSimulator

PATIENCE_S = 60.0


class Instrument(SimulatedInstrument):
    """A simulated gyro on which a test can act at a command or a recording."""

    def __init__(self) -> None:
        device = draw_unit(load_device("ring_15k"), 7)
        self.simulator = GyroSimulator(device, rng=np.random.default_rng(1), fidelity="slow_flow")
        super().__init__(self.simulator)
        self.at_record: Callable[[], None] = lambda: None
        self.at_configure: Callable[[Command], None] = lambda command: None

    def configure(self, command: Command) -> None:
        self.at_configure(command)
        super().configure(command)

    def record(self, duration_s: float, *, settle_s: float = 0.0, label: str = "") -> Recording:
        self.at_record()
        return super().record(duration_s, settle_s=settle_s, label=label)


class Bench:
    """A run manager, an instrument, and what was put in force."""

    def __init__(self) -> None:
        self.seen: list[RunStatus] = []
        self.crashes: list[str] = []
        self.runs = RunManager(self.seen.append, self.crashes.append)
        self.instrument = Instrument()
        self.kept = KeptRecordings()
        self.adopted: list[CalibrationRecord] = []
        self.confirm: Callable[[], None] = lambda: None
        self.adopt: Callable[[CalibrationRecord], None] = self.adopted.append

    def work(self, name: str, *, artifacts: Path | None = None, short: bool = False) -> CalibrationRun:
        plan = RUNS[name].plan(self.instrument.factory, quality="quick")
        if short:
            plan = replace(plan, steps=plan.steps[:2])
        options = {"kept": self.kept, "confirm": lambda: self.confirm(), "adopt": lambda record: self.adopt(record), "artifacts": artifacts}
        return CalibrationRun(self.instrument, RUNS[name], plan, **options)

    def run(self, name: str, **options: object) -> RunStatus:
        assert self.runs.request(name, self.work(name, **options)).accepted  # type: ignore[arg-type]
        assert self.runs.wait(PATIENCE_S)
        return self.runs.status


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_a_self_calibration_puts_one_record_in_force(bench: Bench, tmp_path: Path) -> None:
    status = bench.run("self_calibrate", artifacts=tmp_path)
    assert status.state is RunState.DONE, status.message
    (record,) = bench.adopted
    assert record.provenance["run_id"] == status.run_id
    assert record.record_id in status.message
    assert status.results == record_results(record)
    truth = bench.instrument.simulator.truth()
    assert abs(record.bias.value - truth.bias_rad_s) < 5.0 * record.bias.sd
    assert bench.instrument.simulator.command == Command()
    assert len(load_campaign(tmp_path / status.run_id / "campaign.h5")) == record.provenance["recordings"]


def test_run_cubic_records_three_amplitudes_and_calibrates_for_the_missions(bench: Bench, tmp_path: Path) -> None:
    status = bench.run("run_cubic", artifacts=tmp_path)
    assert status.state is RunState.DONE, status.message
    (record,) = bench.adopted
    campaign = load_campaign(tmp_path / status.run_id / "campaign.h5")
    assert {r.command.setpoints.amplitude_v for r in campaign if r.command.oscillator_axis} == {0.6, 1.0, 1.4}
    assert record.operating_point["amplitude_v"] == 1.0
    truth = bench.instrument.simulator.truth()
    assert abs(record.bias.value - truth.bias_rad_s) < 5.0 * record.bias.sd
    # this unit is linear, and the test for the terms says so
    assert "cubic" not in status.message


def test_progress_goes_up_names_the_step_and_ends_in_an_estimate(bench: Bench) -> None:
    bench.run("run_sideband")
    running = [s for s in bench.seen if s.state is RunState.RUNNING]
    fractions = [s.fraction for s in running]
    assert fractions == sorted(fractions)
    assert (fractions[0], fractions[-1]) == (0.0, 1.0)
    assert running[0].message == f"step 1 of {len(running) - 1}: static_x_0"
    assert running[-1].message == "recordings complete"
    assert [s.message for s in bench.seen if s.state is RunState.ESTIMATING] == [f"estimating from {len(running) - 1} recordings"]


def test_a_heartbeat_tells_the_progress_inside_a_step(bench: Bench) -> None:
    work = bench.work("run_sideband")
    first = RUNS["run_sideband"].plan(bench.instrument.factory, quality="quick")
    beats: list[RunStatus] = []

    def beat() -> None:
        if not beats:
            work.heartbeat(0.5)
            beats.append(bench.seen[-1])

    bench.instrument.at_record = beat
    work.heartbeat(0.5)  # before the run: says nothing
    bench.runs.request("run_sideband", work)
    assert bench.runs.wait(PATIENCE_S)
    assert beats[0].fraction == pytest.approx(0.5 * first.steps[0].duration_s / first.duration_s)
    assert beats[0].eta_s >= 0.0
    done = len(bench.seen)
    work.heartbeat(0.5)  # after the run: says nothing
    assert len(bench.seen) == done


def test_feedthrough_alone_puts_nothing_in_force_and_serves_the_next_side_bands(bench: Bench) -> None:
    status = bench.run("run_feedthrough")
    assert status.state is RunState.DONE
    assert bench.adopted == []
    assert status.results["recorded"].unit == "s"
    bench.run("run_sideband")
    (with_feedthrough,) = bench.adopted
    assert with_feedthrough.parameters["E_xy_re"].sd > 0.0
    stranger = Bench()
    stranger.run("run_sideband")
    (alone,) = stranger.adopted
    assert alone.provenance["recordings"] < with_feedthrough.provenance["recordings"]
    assert any("feedthrough E was not measured" in warning for warning in alone.warnings)


def test_kept_recordings_of_another_device_are_not_used(bench: Bench) -> None:
    bench.run("run_feedthrough")
    mine = bench.kept._campaign
    assert mine is not None
    other = replace(mine, device_id="other", recordings=tuple(replace(r, device_id="other") for r in mine.recordings[:1]))
    assert bench.kept.before(other) is other


@pytest.mark.parametrize(
    "error",
    [DataError("NaN in x_pick_c."), ExperimentAborted("Stream stopped."), ZeroDivisionError("a mistake")],
    ids=lambda e: type(e).__name__,
)
def test_a_recording_that_fails_changes_nothing_and_puts_the_gyro_back(bench: Bench, error: Exception) -> None:
    calls = []

    def fail() -> None:
        calls.append(1)
        if len(calls) == 3:
            raise error

    bench.instrument.at_record = fail
    status = bench.run("self_calibrate")
    assert status.state is RunState.FAILED
    assert str(error) in status.message
    assert "may not be back" not in status.message
    assert bench.adopted == []
    assert bench.instrument.simulator.command == Command()


def test_a_gyro_out_of_reach_is_said_to_be_perhaps_not_back(bench: Bench) -> None:
    reached: list[Command] = []

    def unreachable(command: Command) -> None:
        reached.append(command)
        if len(reached) > 2:
            raise ExperimentAborted("The gyro does not answer.")

    bench.instrument.at_configure = unreachable
    status = bench.run("self_calibrate")
    assert status.state is RunState.FAILED
    assert status.message.startswith("The gyro does not answer. The gyro may not be back in its mission command (ftr_x)")


def test_another_device_at_the_end_is_refused_before_anything_changes(bench: Bench) -> None:
    def confirm() -> None:
        raise DataError("Gyro must stay 'a', but is now 'b'.")

    bench.confirm = confirm
    status = bench.run("run_sideband")
    assert (status.state, status.message) == (RunState.FAILED, "Gyro must stay 'a', but is now 'b'.")
    assert bench.adopted == []


def test_a_record_that_cannot_be_stored_fails_the_run(bench: Bench) -> None:
    def adopt(record: CalibrationRecord) -> None:
        raise StoreError("Store must be writable, but the disk is full.")

    bench.adopt = adopt
    status = bench.run("run_sideband")
    assert status.state is RunState.FAILED
    assert "disk is full" in status.message
    assert status.results == {}


def test_an_estimate_without_both_axes_is_refused(bench: Bench) -> None:
    status = bench.run("run_sideband", short=True)
    assert status.state is RunState.FAILED
    assert "ftr_y" in status.message
    assert bench.adopted == []


def test_a_cancel_between_steps_leaves_no_trace(bench: Bench, tmp_path: Path) -> None:
    bench.instrument.at_record = lambda: bench.runs.cancel("enough") and None  # type: ignore[func-returns-value]
    status = bench.run("self_calibrate", artifacts=tmp_path)
    assert (status.state, status.message) == (RunState.CANCELLED, "enough")
    assert bench.adopted == []
    assert list(tmp_path.iterdir()) == []
    assert bench.instrument.simulator.command == Command()


def test_a_cancel_at_the_last_moment_still_leaves_no_trace(bench: Bench) -> None:
    bench.confirm = lambda: bench.runs.cancel("at the last moment") and None  # type: ignore[func-returns-value]
    status = bench.run("run_sideband")
    assert (status.state, status.message) == (RunState.CANCELLED, "at the last moment")
    assert bench.adopted == []


def test_recordings_that_cannot_be_written_do_not_end_the_run(bench: Bench, tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    status = bench.run("run_sideband", artifacts=blocked)
    assert status.state is RunState.DONE
    assert "The recordings could not be written" in status.message
    assert len(bench.adopted) == 1


def test_results_are_in_the_units_of_people(bench: Bench) -> None:
    bench.run("run_sideband")
    (record,) = bench.adopted
    results = record_results(record)
    assert results["bias"].unit == "deg/h"
    assert results["bias"].value == pytest.approx(math.degrees(record.bias.value) * 3600.0)
    # one-sided density = sqrt(2) ARW; deg/sqrt(h) = 60 deg/sqrt(s)
    arw = math.degrees(record.rate_noise_density.value / math.sqrt(2.0)) * 60.0
    assert results["angle_random_walk"].value == pytest.approx(arw)
    assert 0.01 < arw < 0.2
    assert results["scale_factor.y"] == record.scale_factor_by_axis["y"]


def test_every_run_has_a_plan_for_a_force_rebalance_gyro(bench: Bench) -> None:
    for name, kind in RUNS.items():
        plan = kind.plan(bench.instrument.factory, quality="quick")
        assert isinstance(plan, Plan), name
        assert plan.steps, name
        assert all(isinstance(step, Step) for step in plan.steps)
        assert plan.final == Command()
        assert kind.description
