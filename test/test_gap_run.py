"""The run that diagnoses the gap: what it records, says and leaves behind; with and without ROS. The diagnosis itself is replaced here."""

from __future__ import annotations

import hashlib
import json
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gap_samples import make_diagnosis

import gyro_calib.gap
from gyro_calib.device import draw_unit, load_device
from gyro_calib.errors import DataError
from gyro_calib.experiments import SimulatedInstrument, gap_plan
from gyro_calib.gap import Unknown
from gyro_calib.gap.healthy import HealthySpread
from gyro_calib.nodes.gap_run import GapRun, fleet_of_kind
from gyro_calib.nodes.run_manager import RunManager, RunState, RunStatus
from gyro_calib.quantity import Quantity
from gyro_calib.recording.command import Command
from gyro_calib.recording.load import load_campaign
from gyro_calib.recording.recording import Campaign
from gyro_calib.simulation import GyroSimulator

PATIENCE_S = 60.0
Diagnose = Callable[..., Any]


class Replaced:
    """Stands in for ``gyro_calib.gap.diagnose`` and keeps what it was given."""

    def __init__(self, verdict: str = "effects") -> None:
        self.verdict = verdict
        self.campaigns: list[Campaign] = []
        self.healthy: list[HealthySpread | None] = []
        self.before: Callable[[], None] = lambda: None

    def __call__(self, campaign: Campaign, *, healthy: HealthySpread | None, on_progress: Callable[[float, str], None]) -> Any:
        self.campaigns.append(campaign)
        self.healthy.append(healthy)
        on_progress(0.5, "noise")
        self.before()
        on_progress(1.0, "done")
        return make_diagnosis(campaign.device_id, self.verdict, len(campaign))


@pytest.fixture
def diagnose(monkeypatch: pytest.MonkeyPatch) -> Replaced:
    replaced = Replaced()
    monkeypatch.setattr(gyro_calib.gap, "diagnose", replaced)
    return replaced


class Bench:
    """A simulated gyro with nothing but itself, and a run manager."""

    def __init__(self, folder: Path) -> None:
        self.seen: list[RunStatus] = []
        self.runs = RunManager(self.seen.append)
        self.simulator = GyroSimulator(draw_unit(load_device("ring_15k"), 7), rng=np.random.default_rng(1), fidelity="slow_flow")
        self.instrument = SimulatedInstrument(self.simulator)
        self.plan = gap_plan(self.instrument.factory, quality="quick")
        self.records = folder / "store" / "unit.yaml"
        self.work = GapRun(self.instrument, self.plan, beside=self.records, artifacts=folder / "runs")
        self.folder = folder

    def run(self) -> RunStatus:
        assert self.runs.request("diagnose_gap", self.work).accepted
        assert self.runs.wait(PATIENCE_S)
        return self.runs.status


def test_the_campaign_is_recorded_diagnosed_and_kept(diagnose: Replaced, tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    status = bench.run()
    assert status.state is RunState.DONE, status.message
    (campaign,) = diagnose.campaigns
    assert [r.label for r in campaign] == [s.label for s in bench.plan.steps]
    assert {r.command.setpoints.amplitude_v for r in campaign if r.command.oscillator_axis} == {0.6, 1.0, 1.4}
    assert len(load_campaign(tmp_path / "runs" / status.run_id / "campaign.h5")) == len(campaign)
    assert status.message.startswith("effects: One effect. The campaign is without the temperature steps")
    assert status.attention
    assert status.facts["verdict"] == "effects"
    assert status.facts["effect_1.group"] == "nonlinear_damping, drive_nonlinearity"
    assert status.results["nonlinear_damping.c"].unit == "1/s/V^2"
    assert status.results["gap.closed_fraction"].value == 0.98
    document = json.loads(Path(status.facts["gap.json"]).read_text())
    assert Path(status.facts["gap.json"]) == bench.records.with_name("unit.gap.json")
    assert (document["verdict"], document["recordings"]) == ("effects", len(campaign))
    assert "nonlinear_damping" in Path(status.facts["gap.html"]).read_text()
    assert bench.simulator.command == Command(), "back in its mission"
    said = [s.message for s in bench.seen if s.state is RunState.ESTIMATING]
    assert f"diagnosing {len(campaign)} recordings, 50%: noise" in said
    assert [s.eta_s for s in bench.seen if s.state is RunState.ESTIMATING] == pytest.approx([60.0, 0.0, 0.0], abs=1.0)


def test_its_progress_goes_on_while_the_gap_is_diagnosed(diagnose: Replaced, tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.run()
    fractions = [s.fraction for s in bench.seen if s.state in (RunState.RUNNING, RunState.ESTIMATING)]
    assert fractions == sorted(fractions)
    recorded = max(s.fraction for s in bench.seen if s.state is RunState.RUNNING)
    assert recorded == pytest.approx(bench.plan.duration_s / (bench.plan.duration_s + 60.0), abs=0.01)
    diagnosing = [s.fraction for s in bench.seen if s.state is RunState.ESTIMATING]
    assert diagnosing == pytest.approx([recorded, (1.0 + recorded) / 2.0, 1.0], abs=0.01)


def test_a_clean_gyro_asks_for_no_attention(diagnose: Replaced, tmp_path: Path) -> None:
    diagnose.verdict = "none"
    status = Bench(tmp_path).run()
    assert (status.state, status.attention, status.facts["verdict"]) == (RunState.DONE, False, "none")


def test_figures_that_say_nothing_are_no_results_and_no_kin_is_none(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def thin(campaign: Campaign, **_: Any) -> Any:
        made = make_diagnosis(campaign.device_id, "unknown", len(campaign))
        gap = replace(made.gap, bias_after=Quantity(0.0, 4.3e8, "deg/h"))
        return replace(made, gap=gap, unknown=Unknown("drive", "in phase", "u", "recording", "", 50.0))

    monkeypatch.setattr(gyro_calib.gap, "diagnose", thin)
    status = Bench(tmp_path).run()
    assert status.facts["unknown.nearest"] == "none"
    assert {"gap.scale_factor.before", "gap.scale_factor.after"} <= set(status.results)
    assert not {"gap.bias.before", "gap.bias.after"} & set(status.results)
    assert json.loads(Path(status.facts["gap.json"]).read_text())["unknown"]["nearest"] is None


def test_a_cancel_during_the_diagnosis_leaves_nothing_beside_the_records(diagnose: Replaced, tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    diagnose.before = lambda: bench.runs.cancel("enough") and None  # type: ignore[func-returns-value]
    status = bench.run()
    assert (status.state, status.message) == (RunState.CANCELLED, "enough")
    assert not bench.records.parent.exists()
    assert bench.simulator.command == Command()


def test_a_disk_that_refuses_does_not_take_the_verdict_away(diagnose: Replaced, tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.records.parent.write_text("not a folder")
    status = bench.run()
    assert status.state is RunState.DONE
    assert status.facts["verdict"] == "effects"
    assert "gap.json" not in status.facts
    assert "could not be written in full" in status.message


def test_recordings_that_the_diagnosis_refuses_fail_the_run_and_stay_on_disk(diagnose: Replaced, tmp_path: Path) -> None:
    def refuse() -> None:
        raise DataError("Axes must not be swapped, but x and y are. Swap the leads.")

    diagnose.before = refuse
    bench = Bench(tmp_path)
    status = bench.run()
    assert (status.state, status.message) == (RunState.FAILED, "Axes must not be swapped, but x and y are. Swap the leads.")
    assert (tmp_path / "runs" / status.run_id / "campaign.h5").is_file()


def test_a_unit_is_judged_beside_its_fleet(diagnose: Replaced, tmp_path: Path) -> None:
    file = tmp_path / "fleet.yaml"
    file.write_text("nominal_f0_hz: 15000.0\nhealthy: {axis_gain_per_k: 2.0e-6}\n")
    bench = Bench(tmp_path)
    fleet = fleet_of_kind(str(file), bench.instrument.factory)
    bench.work = GapRun(bench.instrument, bench.plan, beside=bench.records, fleet=fleet)
    status = bench.run()
    assert (status.state, status.facts["fleet"]) == (RunState.DONE, "fleet.yaml")
    assert diagnose.healthy == [HealthySpread(axis_gain_per_k=2e-6)]
    document = json.loads(Path(status.facts["gap.json"]).read_text())
    assert document["provenance"]["fleet"] == {"name": "fleet.yaml", "sha256": hashlib.sha256(file.read_bytes()).hexdigest()}
    assert fleet_of_kind("", bench.instrument.factory) is None


# -- over ROS ---------------------------------------------------------------------------------------------------------------------------


@pytest.mark.ros
def test_diagnose_gap_over_topics_and_the_calibration_stays(diagnose: Replaced, ros: Any, tmp_path: Path) -> None:
    from calibration_rig import Rig, record_file, store_record

    record = store_record()
    stored = record_file().read_bytes()
    rig = Rig(ros, artifacts_dir=str(tmp_path / "runs"))
    rig.wait_value("calibration", record.record_id)
    run_id = rig.run("diagnose_gap")
    assert rig.wait_end(run_id, 120.0) == "done", rig.text
    (campaign,) = diagnose.campaigns
    assert {r.command.mode for r in campaign} == {"ftr_x", "ftr_y", "loops_off"}
    assert len({r.command.setpoints.amplitude_v for r in campaign if r.command.oscillator_axis}) == 3
    message, values = rig.status.messages[-1], rig.values
    assert message.level == b"\x01", "an effect is a warning"
    assert "One effect. The campaign is without the temperature steps (no chamber or heater)" in rig.text
    assert (values["verdict"], values["effect_1"]) == ("effects", "nonlinear_damping")
    assert float(values["nonlinear_damping.c [1/s/V^2]"]) == pytest.approx(0.021)
    path = Path(values["gap.json"])
    assert path.parent == record_file().parent
    assert json.loads(path.read_text())["verdict"] == "effects"
    assert Path(values["gap.html"]).is_file()
    fractions = [float(next(p.value for p in m.values if p.key == "fraction")) for m in rig.status.messages]
    assert len({f for f in fractions if 0.0 < f < 1.0}) > 5
    # nothing that the gyro or its corrector use has changed
    assert record_file().read_bytes() == stored
    assert rig.published_record == record
    assert rig.values["calibration"] == record.record_id
    assert rig.gyro_command == Command()


@pytest.mark.ros
def test_a_fleet_of_another_kind_is_refused_before_anything_is_recorded(diagnose: Replaced, ros: Any, tmp_path: Path) -> None:
    from calibration_rig import Rig

    file = tmp_path / "fleet.yaml"
    file.write_text("nominal_f0_hz: 5300.0\nhealthy: {axis_gain_per_k: 2.0e-6}\n")
    rig = Rig(ros, fleet=str(file))
    refused = rig.call("diagnose_gap")
    assert not refused.success
    assert "about 5300 Hz, but got 15000 Hz" in refused.message
    assert diagnose.campaigns == []
    assert rig.gyro_command == Command()


@pytest.mark.ros
def test_diagnose_gap_is_cancelled_while_it_records_and_while_it_diagnoses(diagnose: Replaced, ros: Any) -> None:
    from calibration_rig import Rig, record_file, store_record

    record = store_record()
    stored = record_file().read_bytes()
    rig = Rig(ros)
    run_id = rig.run("diagnose_gap")
    rig.wait_text("step 2 of")
    assert not rig.call("self_calibrate").success, "one run at a time"
    assert rig.call("cancel").success
    assert rig.wait_end(run_id) == "cancelled"
    assert diagnose.campaigns == []
    assert rig.gyro_command == Command()

    diagnosing, cancelled = threading.Event(), threading.Event()

    def wait() -> None:
        diagnosing.set()
        assert cancelled.wait(PATIENCE_S)
        time.sleep(0.05)

    diagnose.before = wait
    run_id = rig.run("diagnose_gap")
    assert diagnosing.wait(PATIENCE_S)
    rig.wait_value("state", "estimating")
    assert rig.call("cancel").success
    cancelled.set()
    assert rig.wait_end(run_id) == "cancelled"
    assert not list(record_file().parent.glob("*.gap.*"))
    assert record_file().read_bytes() == stored
    assert rig.published_record == record
