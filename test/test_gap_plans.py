"""The campaigns for a diagnosis: what they hold, in which order, on which bench, and that they run and can be read back."""

from __future__ import annotations

import math
import os
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyro_calib.cli.main import main
from gyro_calib.device import Device, dump_device, load_device
from gyro_calib.errors import DataError, ExperimentAborted
from gyro_calib.experiments import (
    GAP_ABILITIES,
    GAP_PLANS,
    Limits,
    Plan,
    SimulatedInstrument,
    Step,
    gap_ftr_plan,
    gap_plan,
    gap_whole_angle_plan,
    plan_by_name,
    run_plan,
)
from gyro_calib.recording.command import Command, Setpoints
from gyro_calib.recording.load import load_campaign
from gyro_calib.recording.rate import wave_azimuth
from gyro_calib.recording.recording import Recording
from gyro_calib.report.plan_table import plan_table, to_markdown, with_tables
from gyro_calib.simulation import GyroSimulator

DOC = Path(__file__).resolve().parents[1] / "doc" / "gap_campaign.md"
DEVICES = {"gap-ftr": "ring_15k", "gap-whole-angle": "hrg_hardware"}
BENCH = tuple(GAP_ABILITIES)


def plan_of(name: str, **options: object) -> Plan:
    return plan_by_name(name, load_device(DEVICES[name]).factory(), **{"abilities": BENCH, **options})


def kinds(plan: Plan) -> Counter[tuple[str, str]]:
    return Counter((step.command.mode, step.command.excitation.kind) for step in plan.steps)


def test_force_rebalance_varies_everything_on_both_axes() -> None:
    plan = plan_of("gap-ftr")
    sides = {
        (s.command.mode, s.command.setpoints.amplitude_v, s.command.excitation.frequency_hz)
        for s in plan.steps
        if s.command.excitation.kind == "amplitude_modulation"
    }
    assert sides == {(f"ftr_{axis}", a, nu) for axis in "xy" for a in (0.6, 1.0, 1.4) for nu in (0.1, 0.5, 1.0, 1.5)}
    opened = {(s.command.excitation.axis, s.detuning_hz) for s in plan.steps if s.command.excitation.kind == "drive"}
    assert opened == {(axis, df) for axis in "xy" for df in (-60.0, -20.0, 20.0, 60.0)}
    assert {s.detuning_hz for s in plan.steps if s.command.excitation.kind == "body"} == {-40.0, 40.0}
    ramps = [s for s in plan.steps if s.temperature_ramp_s]
    assert {s.command.mode for s in ramps} == {"ftr_x", "ftr_y"}
    assert [s.temperature_degc for s in ramps] == [33.0, 25.0], "up, then back"
    assert {s.command.mode for s in plan.steps if s.applied_rate} == {"ftr_x", "ftr_y"}
    assert 40 <= len(plan.steps) <= 55
    assert 300.0 < plan.duration_s < 600.0


@pytest.mark.parametrize("name", GAP_PLANS)
def test_open_drives_on_both_sides_of_the_resonance_are_recorded_again_while_warm(name: str) -> None:
    """What feeds through by the temperature shows there alone; on one side a drive's gain by the temperature is the same."""
    plan = plan_of(name)
    (up,) = [k for k, s in enumerate(plan.steps) if s.temperature_ramp_s and s.temperature_degc == 33.0]
    (down,) = [k for k, s in enumerate(plan.steps) if s.temperature_ramp_s and s.temperature_degc == 25.0]
    warm = plan.steps[up + 1 : down]
    opened = {(s.command.excitation.axis, s.detuning_hz) for s in warm if s.command.excitation.kind == "drive"}
    assert opened == {(axis, df) for axis in "xy" for df in (-60.0, 60.0)}
    assert not any(s.label.startswith("hot") for s in plan_of(name, abilities=("applied_rate",)).steps)


def test_records_hold_whole_periods_of_their_side_band() -> None:
    for quality in ("quick", "standard", "fine"):
        for step in plan_of("gap-ftr", quality=quality).steps:
            if step.command.excitation.kind == "amplitude_modulation":
                periods = step.duration_s * step.command.excitation.frequency_hz
                assert periods == pytest.approx(round(periods)), step.label


def test_static_records_are_repeated_from_beginning_to_end() -> None:
    for seed in range(5):
        plan = plan_of("gap-ftr", seed=seed)
        for axis in "xy":
            places = [k / len(plan.steps) for k, s in enumerate(plan.steps) if s.label.startswith(f"static_{axis}")]
            assert len(places) == 3
            assert places[0] < 0.35
            assert places[-1] > 0.65


def test_whole_angle_varies_amplitude_volts_and_sense_over_whole_periods() -> None:
    plan = plan_of("gap-whole-angle")
    turning = [s for s in plan.steps if s.label.startswith("vir_")]
    conditions = Counter((s.command.setpoints.amplitude_v, math.copysign(1.0, s.command.setpoints.virtual_precession_v)) for s in turning)
    assert conditions == {(1.0, +1.0): 4, (1.0, -1.0): 4, (0.6, +1.0): 1, (0.6, -1.0): 1, (1.4, +1.0): 1, (1.4, -1.0): 1}
    volts = {round(abs(s.command.setpoints.virtual_precession_v) / s.command.setpoints.amplitude_v, 6) for s in turning}
    assert len(volts) == 3, "three speeds"
    gain = 0.55 / 4.8792  # kappa Ac / S of this design [1/s per V]
    for step in turning:
        speed = 0.5 * gain * abs(step.command.setpoints.virtual_precession_v) / step.command.setpoints.amplitude_v
        assert speed * step.duration_s >= 0.5 * math.pi, f"{step.label}: a period of 4 theta is a quarter turn"
    modes = Counter(s.command.mode for s in plan.steps)
    assert modes["ring_down"] == modes["ring_up"] == 2
    assert modes["stiffness"] == 8
    assert modes["ftr_x"] >= 3
    assert modes["ftr_y"] >= 2
    assert sum(s.label.startswith("free_") for s in plan.steps) == 8
    assert max(abs(s.command.setpoints.virtual_precession_v) for s in plan.steps) <= 0.7 * 5.0 + 1e-12
    assert 40 <= len(plan.steps) <= 60
    assert 300.0 < plan.duration_s < 700.0


@pytest.mark.parametrize("name", GAP_PLANS)
def test_the_order_is_drawn_from_the_seed_and_recorded(name: str) -> None:
    first, again, other = plan_of(name, seed=1), plan_of(name, seed=1), plan_of(name, seed=2)
    assert first == again
    assert [s.label for s in first.steps] != [s.label for s in other.steps]
    assert kinds(first) == kinds(other)
    assert max(Counter(s.label for s in first.steps).values()) == 1, "labels are names"
    assert first.words["plan"] == {"name": name, "quality": "standard", "order_seed": 1, "left_out": []}


@pytest.mark.parametrize("name", GAP_PLANS)
def test_without_chamber_or_table_those_steps_are_left_out_and_said(name: str) -> None:
    full = plan_of(name)
    for ability, word in (("temperature", "no chamber"), ("applied_rate", "no rate table")):
        plan = plan_of(name, abilities=set(BENCH) - {ability})
        assert not any(ability in s.needs for s in plan.steps)
        assert len(plan.steps) < len(full.steps)
        (sentence,) = plan.left_out
        assert word in sentence
        assert plan.words["plan"]["left_out"] == [sentence]
    bare = plan_of(name, abilities=())
    assert frozenset().union(*(s.needs for s in bare.steps)) == frozenset()
    assert len(bare.left_out) == 2


def test_the_mission_chooses_the_campaign() -> None:
    assert gap_plan(load_device("ring_15k").factory()).name == "gap-ftr"
    assert gap_plan(load_device("hrg_hardware").factory()).name == "gap-whole-angle"


def test_amplitudes_stay_within_the_converter() -> None:
    factory = load_device("ring_15k").factory() | {"adc_full_scale_V": 1.5}
    amplitudes = sorted({s.command.setpoints.amplitude_v for s in gap_ftr_plan(factory).steps if s.command.excitation.index})
    assert len(amplitudes) == 3
    assert amplitudes[-1] * 1.1 <= 0.9 * 1.5 + 1e-12
    with pytest.raises(DataError, match=r"nominal_amplitude_v within 0 and 0\.45 V"):
        gap_ftr_plan(factory | {"adc_full_scale_V": 0.5})
    with pytest.raises(DataError, match="quick, standard, fine"):
        gap_whole_angle_plan(load_device("hrg_hardware").factory(), quality="hasty")


def test_the_table_of_a_gyro_whose_rebalance_is_weak_turns_slower() -> None:
    def fastest(device: str) -> float:
        plan = gap_ftr_plan(load_device(device).factory(), abilities=BENCH)
        return max(abs(rate) for s in plan.steps if s.applied_rate for rate in s.applied_rate["deg_s"])

    assert fastest("ring_15k") == pytest.approx(50.0)
    assert math.radians(fastest("hrg_hardware")) * 4.8792 == pytest.approx(0.4 * 5.0)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Both campaigns, simulated by the command."""
    folder = tmp_path_factory.mktemp("campaigns")
    for name, device in DEVICES.items():
        arguments = ["--plan", name, "--quality", "quick", "--fidelity", "slow_flow", "--seed", "5", "--out", str(folder)]
        assert main(["simulate", device, *arguments]) == 0
    return {name: folder / f"{device}-0005_{name}.h5" for name, device in DEVICES.items()}


@pytest.mark.parametrize("name", GAP_PLANS)
def test_a_simulated_campaign_is_read_back_with_what_a_reader_needs(recorded: dict[str, Path], name: str) -> None:
    campaign = load_campaign(recorded[name])
    plan = plan_of(name, quality="quick", seed=5)
    assert [r.label for r in campaign] == [s.label for s in plan.steps if s.kept]
    for recording, step in zip(campaign, (s for s in plan.steps if s.kept), strict=True):
        assert recording.command.setpoints == step.command.setpoints
        assert recording.command.excitation.kind == step.command.excitation.kind
        assert recording.duration_s == pytest.approx(step.duration_s, abs=0.02)
        assert recording.extras["settle_s"] == step.settle_s
        assert recording.extras["plan"]["order_seed"] == 5
    turned = [r for r in campaign if "applied_rate" in r.extras]
    assert len(turned) == 2
    assert all("t_run_start" in r.extras for r in turned)
    up = next(r for r in campaign if r.label.startswith("thermal") and r.label.endswith("up"))
    assert up.temperature_degc[-1] - up.temperature_degc[0] == pytest.approx(8.0, abs=0.2)
    assert campaign.recordings[-1].temperature_degc.mean() == pytest.approx(25.0, abs=0.1)


def test_free_runs_have_the_wave_at_four_azimuths(recorded: dict[str, Path]) -> None:
    campaign = load_campaign(recorded["gap-whole-angle"])
    turn = [4.0 * float(np.mean(wave_azimuth(r.data))) / (2.0 * math.pi) % 1.0 for r in campaign if r.label.startswith("free_")]
    # in periods of 4 theta; real gains turn it by some percent more or less
    assert Counter(round(4.0 * t) % 4 for t in turn) == {0: 2, 1: 2, 2: 2, 3: 2}


def test_a_step_that_is_not_kept_is_done_but_not_in_the_campaign() -> None:
    instrument = SimulatedInstrument(GyroSimulator(load_device("ring_15k"), rng=np.random.default_rng(1), fidelity="slow_flow"))
    quiet = Command(setpoints=Setpoints(0.01))
    plan = Plan("p", (Step("hush", quiet, 0.5, kept=False), Step("seen", Command(), 0.5)))
    campaign = run_plan(instrument, plan)
    assert [r.label for r in campaign] == ["seen"]
    assert campaign.recordings[0].t[0] > 2.0, "the time for the first step was taken"


def short_run(device: Device, *steps: Step, **limits: float) -> list[Recording]:
    instrument = SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(1), fidelity="slow_flow"))
    return list(run_plan(instrument, Plan("p", steps, Limits(**limits))))


def test_a_ramp_on_purpose_does_not_end_a_run_and_another_does() -> None:
    device = load_device("ring_15k")
    up = Step("up", Command(), 4.0, temperature_degc=33.0, temperature_ramp_s=3.0)
    before, after = Step("before", Command(), 1.0), Step("after", Command(), 1.0)
    assert short_run(device, before, up, after, temperature_k=0.5)[-1].temperature_degc.mean() == pytest.approx(33.0, abs=0.1)
    warming = replace(device, environment=replace(device.environment, ramp_k_per_s=0.5))
    with pytest.raises(ExperimentAborted, match=r"Temperature must stay within 2 K .* in step after"):
        short_run(warming, before, replace(after, settle_s=5.0))
    with pytest.raises(DataError, match="temperature_ramp_s"):
        Step("up", Command(), 4.0, temperature_ramp_s=3.0)


def test_rates_of_another_amplitude_are_not_held_against_the_base() -> None:
    """A drive that feeds its cube to the other axis makes a bias that grows with amplitude, while the body stands still."""
    device = replace(load_device("ring_15k"), effects={"drive_cross_nonlinearity": {"d": 0.5}})
    steps = [Step(f"a{a:g}", Command(setpoints=Setpoints(a)), 2.0, 3.0) for a in (0.6, 1.0, 1.4)]
    rates = [r.column("y_drive_s").mean() / r.command.setpoints.amplitude_v / 0.0952 for r in short_run(device, *steps)]
    assert np.ptp(rates) > Limits().base_rate_rad_s, "else this shows nothing"


# -- the command line -------------------------------------------------------------------------------------------------------------------


def simulate(folder: Path, *options: str) -> int:
    return main(["simulate", "ring_15k", "--fidelity", "slow_flow", "--quality", "quick", "--out", str(folder), *options])


def test_an_effect_is_put_into_the_device_that_is_simulated(tmp_path: Path) -> None:
    shift = {}
    for name, options in (("plain", ()), ("with", ("--effect", "duffing.k=2", "--effect", "pickoff_nonlinearity.c_x=1e-4"))):
        assert simulate(tmp_path / name, "--plan", "static", *options) == 0
        (path,) = (tmp_path / name).iterdir()
        shift[name] = float(np.mean(load_campaign(path).recordings[0].column("ref_freq")))
    assert 2.0 * math.pi * (shift["with"] - shift["plain"]) == pytest.approx(2.0, rel=0.02), "k |p|^2 at 1 V, rad/s"


def test_effects_of_the_file_stay_and_the_ones_given_are_added(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dump_device(replace(load_device("ring_15k"), effects={"duffing": {"k": 2.0}}), tmp_path / "own.yaml")
    arguments = ["simulate", str(tmp_path / "own.yaml"), "--plan", "static", "--fidelity", "slow_flow", "--quality", "quick"]
    assert main([*arguments, "--out", str(tmp_path / "a")]) == 0
    assert main([*arguments, "--out", str(tmp_path / "b"), "--effect", "duffing.k=4"]) == 0
    first, second = (
        float(np.mean(load_campaign(next((tmp_path / name).iterdir())).recordings[0].column("ref_freq"))) for name in ("a", "b")
    )
    assert 2.0 * math.pi * (second - first) == pytest.approx(2.0, rel=0.02)


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ("duffing=1", 2, "must be NAME.PARAM=VALUE"),
        ("duffing.k=much", 2, "must be NAME.PARAM=VALUE"),
        ("duffing.q=1", 1, "Effect duffing parameter must be one of k, but got 'q'"),
        ("dufing.k=1", 1, "Effect must be one of duffing,"),
        ("duffing.k=1e9", 1, "Effect duffing.k must be within"),
    ],
)
def test_an_effect_that_does_not_exist_is_refused_with_what_does(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: str, code: int, said: str
) -> None:
    assert simulate(tmp_path, "--plan", "static", "--effect", words) == code
    assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_steps_are_printed_and_nothing_is_simulated(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "ring_15k", "--plan", "gap-ftr", "--steps", "--without", "temperature", "--seed", "2"]) == 0
    out = capsys.readouterr().out
    assert "The campaign is without the temperature steps" in out
    assert "table_x" in out
    assert "thermal" not in out
    assert main(["simulate", "ring_15k", "--plan", "static", "--steps", "--without", "temperature"]) == 1
    assert "--without must go with a plan of gap-ftr" in capsys.readouterr().err
    assert main(["simulate", "ring_15k", "--plan", "gap-ftr"]) == 2


def test_the_documents_tables_are_the_plans() -> None:
    """``GYRO_CALIB_WRITE_DOC=1`` in the environment writes them anew."""
    text = DOC.read_text(encoding="utf-8")
    made = with_tables(text, {name: to_markdown(plan_table(plan_of(name))) for name in GAP_PLANS})
    if os.environ.get("GYRO_CALIB_WRITE_DOC"):
        DOC.write_text(made, encoding="utf-8")
    assert made == text, "run this test once with GYRO_CALIB_WRITE_DOC=1"
    assert made.count("| static_x_") >= 3
