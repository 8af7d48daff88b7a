"""Drive compensation of a whole-angle gyro: identified, applied, verified, on an instrument and in the work of a run. No ROS."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibration_samples import make_record
from wave_samples import left_behind, unbalanced_hrg

from gyro_calib.calibration import (
    CalibrationRecord,
    Compensated,
    compensate,
    dump_record,
    parse_record,
    read_record,
    record_from_result,
    with_scale_factor_of,
)
from gyro_calib.cli.main import main
from gyro_calib.device.io import dump_device
from gyro_calib.errors import CalibrationRefused, DataError, ExperimentAborted, StoreError
from gyro_calib.estimation import CalibrationResult, MissionChannel
from gyro_calib.estimation.compensation import IdentifiedChain
from gyro_calib.estimation.drive_chain import DriveChain, drive_chain_of
from gyro_calib.experiments import Plan, SimulatedInstrument, compensation_in_force, plan_by_name
from gyro_calib.nodes.calibration_runs import RUNS, CalibrationRun, KeptRecordings
from gyro_calib.nodes.compensation_keeper import CompensationKeeper
from gyro_calib.nodes.run_manager import RunManager, RunState, RunStatus
from gyro_calib.quantity import Quantity
from gyro_calib.recording.command import Command
from gyro_calib.recording.hdf5 import write_campaign_h5
from gyro_calib.recording.load import load_campaign
from gyro_calib.recording.recording import Campaign, Recording
from gyro_calib.simulation import GyroSimulator
from gyro_calib.simulation.truth import truth_of

RATE_RAD_S = 1e-4
IDENTITY = (1.0, 0.0, 0.0, 1.0)
Matrix = tuple[float, float, float, float]


class Gyro(SimulatedInstrument):
    """A simulated whole-angle gyro on which a test can act at a command, and whose driver may mistake the compensation."""

    def __init__(self, mistake: Callable[[Matrix], Matrix] = lambda matrix: matrix) -> None:
        self.device = unbalanced_hrg()
        self.simulator = GyroSimulator(self.device, rng=np.random.default_rng(1), fidelity="slow_flow")
        super().__init__(self.simulator, RATE_RAD_S)
        self.at_configure: Callable[[Command], None] = lambda command: None
        self._mistake = mistake
        self._said = Command()

    @property
    def command(self) -> Command:
        return self._said

    def configure(self, command: Command) -> None:
        self.at_configure(command)
        super().configure(replace(command, compensation=self._mistake(command.compensation)))
        self._said = command

    def record(self, duration_s: float, **options: Any) -> Recording:
        # what the driver claims, whatever it does
        return replace(super().record(duration_s, **options), command=self._said)

    def plan(self) -> Plan:
        """Virtual precession, short: a free run and one pair of senses."""
        plan = plan_by_name("virtual_precession", self.factory, quality="quick")
        return replace(plan, steps=tuple(s for s in plan.steps if s.label in ("place_x", "free_0", "vir_p_0", "vir_n_0")))

    def left_by(self, compensation: Matrix) -> np.ndarray:
        """What a compensation truly leaves over."""
        return left_behind(self.device, compensation)


def test_the_compensation_of_a_chain_leaves_nothing_and_its_covariance_is_that_of_many_draws() -> None:
    rng = np.random.default_rng(2)
    mean, spread = np.array([0.1, 0.05, -0.02]), np.array([[9e-8, 2e-8, 0.0], [2e-8, 4e-8, 1e-8], [0.0, 1e-8, 4e-8]])
    found = IdentifiedChain(DriveChain(*mean), spread)
    matrix = found.compensation()
    product = DriveChain(*mean).matrix @ np.reshape(matrix, (2, 2))
    np.testing.assert_allclose(product, np.eye(2), atol=1e-14)
    left = found.behind(matrix)
    np.testing.assert_allclose(left.vector, 0.0, atol=1e-14)
    draws = rng.multivariate_normal(mean, spread, size=4000)
    matrices = np.array([IdentifiedChain(DriveChain(*draw), spread).compensation() for draw in draws])
    residuals = np.array([IdentifiedChain(DriveChain(*draw), spread).behind(matrix).vector for draw in draws])
    np.testing.assert_allclose(np.sqrt(np.diag(found.compensation_covariance())), matrices.std(axis=0), rtol=0.05)
    np.testing.assert_allclose(left.sd, residuals.std(axis=0), rtol=0.05)
    assert left.chi_square() == pytest.approx(0.0, abs=1e-12)
    assert IdentifiedChain(DriveChain(3e-3, 0.0, 0.0), np.diag([1e-6, 1e-6, 1e-6])).chi_square() == pytest.approx(9.0)


@pytest.fixture(scope="module")
def compensated() -> tuple[Gyro, Compensated]:
    gyro = Gyro()
    return gyro, compensate(gyro, gyro.plan(), gyro.plan())


def test_the_rounds_end_at_the_noise_and_the_gyro_keeps_its_compensation_until_told(compensated: tuple[Gyro, Compensated]) -> None:
    gyro, found = compensated
    before = gyro.left_by(IDENTITY)
    first, *_, last = found.rounds
    # the first round sees the errors of the chain, the last one nothing but noise
    np.testing.assert_allclose(first.residual.vector, before, atol=5e-6)
    assert not first.settled
    assert last.settled
    assert compensation_in_force(gyro) == IDENTITY
    assert found.mission.mode == "whole_angle"
    assert found.mission.compensation == last.compensation
    # what is truly left is within what the rounds say of it, and far below what there was
    left = gyro.left_by(found.mission.compensation)
    assert np.all(np.abs(left) < 5.0 * (first.identified.sd + last.identified.sd))
    assert np.all(np.abs(left) < 1e-3 * np.abs(before))

    record = record_from_result(found.result, found.campaign, run_id="r", mode="whole_angle", provenance={"rounds": len(found.rounds)})
    truth = truth_of(gyro.device, found.mission, RATE_RAD_S)
    raw = truth_of(gyro.device, replace(found.mission, compensation=IDENTITY), RATE_RAD_S)
    # the uneven damping is compensated with the drives: the rate does not depend on where the wave stands
    assert abs(record.parameters["drift_cos_4theta"].value) < 1e-3 * abs(raw.bias_rad_s)
    assert abs(record.parameters["drift_sin_4theta"].value) < 1e-3 * abs(raw.bias_rad_s)
    assert record.compensation == last.compensation
    assert abs(raw.bias_rad_s) > 3e-3
    assert abs(truth.bias_rad_s) < 1e-3 * abs(raw.bias_rad_s)
    assert abs(record.bias.value - truth.bias_rad_s) < 5.0 * record.bias.sd
    assert abs(record.scale_factor.value - truth.scale_factor) < 5.0 * record.scale_factor.sd
    sd = np.sqrt(np.reshape(record.compensation_covariance, (4, 4)).diagonal())
    assert np.all((sd > 1e-10) & (sd < 1e-5))
    assert parse_record(dump_record(record)) == record
    assert record.parameters["residual_delta_g"].sd < 1e-5


def test_a_driver_that_applies_something_else_is_refused_and_keeps_what_it_had(compensated: tuple[Gyro, Compensated]) -> None:
    gyro = Gyro(mistake=lambda matrix: (matrix[0], -matrix[1], -matrix[2], 2.0 - matrix[3]))
    plan = gyro.plan()

    def identified(campaign: Campaign) -> CalibrationResult:
        """A driver that records what was asked for, not what acts, hides its mistake: it looks like another chain."""
        asked_for = campaign.recordings[-1].command.compensation
        wanted, acted = np.reshape(asked_for, (2, 2)), np.reshape(gyro._mistake(asked_for), (2, 2))
        chain = drive_chain_of(gyro.device.slow_flow().G @ acted @ np.linalg.inv(wanted))
        return replace(compensated[1].result, drive_chain=IdentifiedChain(chain, 1e-12 * np.eye(3)))

    with pytest.raises(CalibrationRefused, match="must take the errors of the drive chain away"):
        compensate(gyro, replace(plan, steps=plan.steps[:2]), replace(plan, steps=plan.steps[:2]), estimate=identified)
    assert compensation_in_force(gyro) == IDENTITY


class Bench:
    """A run manager with the work of a run on a whole-angle gyro."""

    def __init__(self) -> None:
        self.seen: list[RunStatus] = []
        self.crashes: list[str] = []
        self.runs = RunManager(self.seen.append, self.crashes.append)
        self.gyro = Gyro()
        self.in_force: CalibrationRecord | None = None
        self.refuse_to_store = False

    def adopt(self, record: CalibrationRecord) -> None:
        if self.refuse_to_store:
            raise StoreError("Store must be writable, but the disk is full.")
        self.in_force = record

    def run(self, name: str) -> RunStatus:
        kind = RUNS[name]
        kind.check(self.gyro.factory)
        plan, verify = kind.plans(self.gyro.factory, quality="quick")
        options = {"kept": KeptRecordings(), "confirm": lambda: None, "adopt": self.adopt, "in_force": lambda: self.in_force}
        work = CalibrationRun(self.gyro, kind, plan, verify=verify, **options)  # type: ignore[arg-type]
        assert self.runs.request(name, work).accepted
        assert self.runs.wait(120.0)
        assert not self.crashes, self.crashes
        return self.runs.status


def test_a_run_puts_matrix_and_record_in_force_and_a_scale_factor_run_keeps_both(
    compensated: tuple[Gyro, Compensated], monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench()
    with monkeypatch.context() as patch:
        patch.setattr("gyro_calib.nodes.calibration_runs.calibrate", lambda campaign, **_: compensated[1].result)
        status = bench.run("run_virtual_precession")
    assert status.state is RunState.DONE, status.message
    record = bench.in_force
    assert record is not None
    assert compensation_in_force(bench.gyro) == record.compensation != IDENTITY
    assert bench.gyro.command.mode == "whole_angle"
    rounds = record.provenance["compensation_rounds"]
    assert len(rounds) >= 2
    told = [s.message for s in bench.seen if s.message.startswith(("round 1: residual", "round 2: residual"))]
    assert len(told) == len(rounds)
    assert "at its noise" in told[-1]
    assert abs(bench.seen[-2].results["round_1.residual_delta_g"].value - bench.gyro.left_by(IDENTITY)[0]) < 1e-5
    fractions = [s.fraction for s in bench.seen if s.state is RunState.RUNNING]
    assert fractions == sorted(fractions)

    # the gains have drifted: another scale factor, and a bias that a scale-factor run knows badly
    drifted = MissionChannel(1.0, 1.001, np.diag([1.0, 1e-10]), unit="rad/s")
    found = replace(compensated[1].result, mission={"whole_angle": drifted}, axis_scale_covariance=2e-9)
    monkeypatch.setattr("gyro_calib.nodes.calibration_runs.calibrate", lambda campaign, **_: found)
    status = bench.run("run_scale_factor")
    assert status.state is RunState.DONE, status.message
    renewed = bench.in_force
    assert renewed is not None
    assert compensation_in_force(bench.gyro) == record.compensation
    for name in ("bias", "bias_by_axis", "rate", "compensation", "compensation_covariance", "mode", "rate_noise_density"):
        assert getattr(renewed, name) == getattr(record, name), name
    assert renewed.record_id != record.record_id
    assert (renewed.scale_factor.value, renewed.scale_factor.sd) == (1.001, pytest.approx(1e-5))
    assert renewed.axis_scale_covariance == 2e-9
    assert renewed.provenance["bias_from"] == record.record_id


@pytest.mark.parametrize("why", ["cancel", "failure", "store"])
def test_whatever_ends_a_run_early_restores_the_previous_compensation(
    why: str, compensated: tuple[Gyro, Compensated], monkeypatch: pytest.MonkeyPatch
) -> None:
    # what is estimated is not the matter here
    monkeypatch.setattr("gyro_calib.nodes.calibration_runs.calibrate", lambda campaign, **_: compensated[1].result)
    bench = Bench()
    before = (1.0, -0.02, 0.01, 1.01)
    bench.gyro.configure(Command("whole_angle", compensation=before))
    tried: list[Matrix] = []

    def act(command: Command) -> None:
        if command.compensation != before:
            tried.append(command.compensation)
            if len(tried) == 4 and why == "cancel":
                bench.runs.cancel("enough")
            if len(tried) == 4 and why == "failure":
                raise ExperimentAborted("Stream stopped.")

    bench.gyro.at_configure = act
    bench.refuse_to_store = why == "store"
    status = bench.run("run_virtual_precession")
    assert status.state is (RunState.CANCELLED if why == "cancel" else RunState.FAILED), status.message
    assert tried, "the second round must have begun"
    assert bench.in_force is None
    assert bench.gyro.command.compensation == before
    assert bench.gyro.simulator.command.compensation == before
    assert bench.gyro.command.mode == "whole_angle"


def test_runs_are_refused_on_a_gyro_of_another_mission() -> None:
    ftr = {"kind": "ring", "mission_mode": "ftr_x"}
    for name in ("run_virtual_precession", "run_scale_factor"):
        with pytest.raises(DataError, match=r"must be whole_angle .* say ftr_x"):
            RUNS[name].check(ftr)
    with pytest.raises(DataError, match="must be ftr"):
        RUNS["run_sideband"].check(Gyro().factory)
    RUNS["self_calibrate"].check(ftr)
    RUNS["self_calibrate"].check(Gyro().factory)


def test_a_scale_factor_of_another_compensation_is_not_mixed_in() -> None:
    record = make_record("hrg", mode="whole_angle", compensation=(1.0, 0.01, 0.0, 1.0), axis_scale_covariance=1e-9)
    other = replace(record, compensation=IDENTITY)
    with pytest.raises(DataError, match="must have compensation"):
        with_scale_factor_of(other, record)
    previous = replace(record, bias=Quantity(1.0, 0.1, "rad/s"), bias_scale_covariance=0.0, scale_factor=Quantity(0.5, 0.1, "1"))
    merged = with_scale_factor_of(previous, record)
    assert (merged.bias, merged.scale_factor) == (previous.bias, record.scale_factor)
    assert merged.record_id not in (previous.record_id, record.record_id)


def test_a_compensation_that_holds_needs_no_second_round(compensated: tuple[Gyro, Compensated]) -> None:
    _, found = compensated
    # an independent estimate whose own noise is that of one identification
    chain = found.rounds[-1].identified
    result = replace(found.result, drive_chain=IdentifiedChain(chain.chain, chain.covariance, chain.aim))
    ready = Gyro()
    ready.configure(replace(found.mission, compensation=chain.compensation()))
    short = replace(ready.plan(), steps=ready.plan().steps[:2])
    again = compensate(ready, short, short, estimate=lambda campaign: result)
    assert len(again.rounds) == 1
    assert again.mission.compensation == chain.compensation() == compensation_in_force(ready)


def test_the_command_line_compensates_calibrates_and_stores_the_same(
    compensated: tuple[Gyro, Compensated], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    gyro, found = compensated
    recording, file, answer = tmp_path / "recording.h5", tmp_path / "record.yaml", tmp_path / "result.json"
    write_campaign_h5(recording, found.campaign)
    assert main(["calibrate", str(recording), "--json", str(answer), "--record", str(file)]) == 0
    document = json.loads(answer.read_text())
    record = read_record(file)
    assert list(record.compensation) == document["compensation"]["in_force"] == list(found.mission.compensation)
    assert (record.mode, record.bias.value) == ("whole_angle", document["rate_channel"]["whole_angle"]["bias"]["value"])
    for name, q in document["compensation"]["residual"].items():
        assert record.parameters[f"residual_{name}"].to_json() == q
        assert abs(q["value"]) < 5.0 * q["sd"] + 1e-6

    device = tmp_path / "device.yaml"
    dump_device(unbalanced_hrg(), device)
    simulate = ["simulate", str(device), "--quality", "quick", "--fidelity", "slow_flow", "--out", str(tmp_path / "out")]
    monkeypatch.setattr("gyro_calib.calibration.compensation_rounds.calibrate", lambda campaign, **_: found.result)
    capsys.readouterr()
    assert main([*simulate, "--plan", "virtual_precession", "--compensate"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith(f"round 1: residual delta_g {gyro.left_by(IDENTITY)[0]:.2e}")
    assert said[1].endswith("(at its noise)")
    campaign = load_campaign(tmp_path / "out" / "hrg_low_q_virtual_precession.h5")
    assert len({r.label for r in campaign}) == len(campaign)
    np.testing.assert_allclose(campaign.recordings[-1].command.compensation, record.compensation, atol=1e-5)
    # the matrix of a record is in force when the next plan is simulated
    matrix = [f"{c:.17g}" for c in record.compensation]
    assert main([*simulate, "--plan", "scale_factor", "--compensation", *matrix]) == 0
    campaign = load_campaign(tmp_path / "out" / "hrg_low_q_scale_factor.h5")
    assert {r.command.compensation for r in campaign} == {record.compensation}
    assert main([*simulate, "--plan", "scale_factor", "--compensation", *matrix, "--compensate"]) == 2
    with_side_bands = ["simulate", "ring_15k", "--plan", "sideband", "--quality", "quick", "--out", str(tmp_path / "ring"), "--compensate"]
    assert main(with_side_bands) == 1
    assert "must have virtual precession" in capsys.readouterr().err


def test_the_keeper_pays_once_only_a_fresh_gyro_unless_told_and_is_silent_meanwhile() -> None:
    record = make_record("hrg", mode="whole_angle", compensation=(1.0, 0.01, 0.0, 1.0))
    put: list[Mapping[str, Any]] = []
    keeper = CompensationKeeper(put.append, lambda text: None)
    fresh, other = Command("whole_angle"), Command("whole_angle", compensation=(1.0, 0.5, 0.0, 1.0))
    assert "must be [1.0, 0.01, 0.0, 1.0]" in keeper.problems(record, fresh)[0]
    keeper.pay(fresh)
    assert put == [], "nothing is owed"
    keeper.owe(record, only_fresh=True)
    assert keeper.problems(record, fresh) == ()
    keeper.pay(other)
    assert put == [], "somebody chose this one"
    keeper.owe(record, only_fresh=True)
    keeper.pay(fresh)
    assert put == [{"compensation": [1.0, 0.01, 0.0, 1.0]}]
    assert keeper.problems(record, fresh) == (), "the answer of the driver is from before"
    keeper.pay(replace(fresh, compensation=record.compensation))
    assert keeper.problems(record, replace(fresh, compensation=record.compensation)) == ()
    assert keeper.problems(record, other)
    keeper.owe(record, only_fresh=False)
    keeper.pay(other)
    assert len(put) == 2
