"""Plans and their runner: what is commanded, when a run stops, and that the gyro always returns to its mission."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from wave_samples import unbalanced_hrg

from gyro_calib.device import Device, load_device
from gyro_calib.errors import DataError, ExperimentAborted
from gyro_calib.experiments import (
    PLANS,
    Instrument,
    Limits,
    Plan,
    Progress,
    SimulatedInstrument,
    Step,
    plan_by_name,
    run_plan,
    self_calibration_plan,
)
from gyro_calib.recording.command import Command, Excitation, Setpoints
from gyro_calib.simulation import GyroSimulator


def _instrument(device: Device | None = None, rate: float = 0.0) -> SimulatedInstrument:
    return SimulatedInstrument(GyroSimulator(device or load_device("ring_15k"), rng=np.random.default_rng(1), fidelity="slow_flow"), rate)


class _Spy:
    """Passes everything on and keeps the commands."""

    def __init__(self, inner: SimulatedInstrument, before_record: Callable[[int], None] = lambda _: None) -> None:
        self.inner = inner
        self.commands: list[Command] = []
        self.records = 0
        self.before_record = before_record

    @property
    def device_id(self) -> str:
        return self.inner.device_id

    @property
    def factory(self) -> dict[str, Any]:
        return self.inner.factory

    def configure(self, command: Command) -> None:
        self.commands.append(command)
        self.inner.configure(command)

    def record(self, duration_s: float, *, settle_s: float = 0.0, label: str = "") -> Any:
        self.before_record(self.records)
        self.records += 1
        return self.inner.record(duration_s, settle_s=settle_s, label=label)


def test_self_calibration_covers_both_axes_and_every_experiment_in_its_stated_time() -> None:
    instrument = _instrument()
    plan = self_calibration_plan(instrument.factory, quality="quick")
    seen: list[Progress] = []
    campaign = run_plan(instrument, plan, on_progress=seen.append)
    assert isinstance(instrument, Instrument)
    assert {r.command.mode for r in campaign} == {"ftr_x", "ftr_y", "loops_off"}
    assert {r.command.excitation.kind for r in campaign} == {"none", "amplitude_modulation", "drive", "body"}
    recorded = sum(r.duration_s for r in campaign)
    assert recorded == pytest.approx(sum(s.duration_s for s in plan.steps), abs=0.01)
    assert campaign.recordings[-1].t[-1] == pytest.approx(plan.duration_s, abs=0.1)
    fractions = [p.fraction for p in seen]
    assert fractions == sorted(fractions)
    assert fractions[0] == 0.0
    assert fractions[-1] == 1.0


def test_open_drive_is_placed_about_the_measured_resonance_not_the_nominal_one() -> None:
    base = load_device("ring_15k")
    device = replace(base, resonator=replace(base.resonator, frequency_hz=15040.0))
    campaign = run_plan(_instrument(device), plan_by_name("feedthrough", device.factory(), quality="quick"))
    offsets = {round(r.command.excitation.frequency_hz - 15040.0) for r in campaign if r.command.mode == "loops_off"}
    assert offsets == {-60, -40, -20, 20, 40, 60}


@pytest.mark.parametrize("name", sorted(PLANS))
def test_every_plan_ends_in_the_mission_mode(name: str) -> None:
    whole_angle = name in ("virtual_precession", "scale_factor")
    spy = _Spy(_instrument(load_device("hrg_hardware" if whole_angle else "ring_15k")))
    plan = plan_by_name(name, spy.factory, quality="quick")
    run_plan(spy, plan)
    assert spy.commands[-1] == plan.final
    assert plan.final.mode == ("whole_angle" if whole_angle else "ftr_x")


def test_cancel_stops_before_the_next_step_and_returns_to_the_mission() -> None:
    spy = _Spy(_instrument())
    plan = plan_by_name("sideband", spy.factory, quality="quick")
    with pytest.raises(ExperimentAborted, match=r"cancelled before step 3 of"):
        run_plan(spy, plan, cancelled=lambda: spy.records == 2)
    assert spy.commands[-1] == plan.final


def test_any_failure_returns_to_the_mission_and_keeps_its_own_reason() -> None:
    def fail(count: int) -> None:
        if count == 1:
            raise DataError("a gap")

    spy = _Spy(_instrument(), fail)
    plan = plan_by_name("sideband", spy.factory, quality="quick")
    with pytest.raises(DataError, match="a gap"):
        run_plan(spy, plan)
    assert spy.commands[-1] == plan.final


def test_a_moving_temperature_ends_the_run_with_its_size() -> None:
    base = load_device("ring_15k")
    device = replace(base, environment=replace(base.environment, ramp_k_per_s=0.12))
    plan = plan_by_name("sideband", device.factory(), quality="quick", limits=Limits(temperature_k=1.0))
    with pytest.raises(ExperimentAborted, match=r"within 1 K of its start .* but moved 1\."):
        run_plan(_instrument(device), plan)


def test_a_moving_base_ends_the_run_static_or_modulated() -> None:
    for excitation in (Excitation(), Excitation("amplitude_modulation", 1.0, 0.1)):
        spy = _Spy(_instrument())
        steps = tuple(Step(f"s{i}", Command("ftr_x", excitation), 3.0) for i in range(2))

        def bump(count: int, spy: _Spy = spy) -> None:
            # half a degree per second for the second half of the second record
            if count == 1:
                original = spy.inner._simulator.advance
                spy.inner._simulator.advance = lambda d, rate=0.0: original(d, np.repeat([0.0, 0.05], 50))  # type: ignore[method-assign]

        spy.before_record = bump
        with pytest.raises(ExperimentAborted, match="Hold the gyro still"):
            run_plan(spy, Plan("p", steps))


@pytest.mark.parametrize("precession_v", [0.0, 1.5, -3.5])
def test_a_moving_base_ends_a_whole_angle_run_with_or_without_precession(precession_v: float) -> None:
    device = unbalanced_hrg()
    command = Command("whole_angle", setpoints=Setpoints(virtual_precession_v=precession_v))
    steps = (Step("a", command, 12.0, 4.0), Step("b", command, 12.0, 2.0))
    moved = np.repeat([0.0, 0.08], 600)

    def run(limits: Limits, rate: Any) -> None:
        spy = _Spy(_instrument(device, 5e-3))

        def bump(count: int) -> None:
            if count == 1:
                original = spy.inner._simulator.advance
                spy.inner._simulator.advance = lambda d, _: original(d, rate if d > 5.0 else 5e-3)  # type: ignore[method-assign]

        spy.before_record = bump
        run_plan(spy, Plan("p", steps, limits))

    # a constant rate, and what unbalanced forcers do to the wave, are no motion of the base
    run(Limits(), 5e-3)
    with pytest.raises(ExperimentAborted, match="Hold the gyro still"):
        run(Limits(), 5e-3 + moved)
    run(Limits(base_rate_rad_s=0.2), 5e-3 + moved)


def test_a_base_that_turns_from_one_free_run_to_the_next_ends_the_run() -> None:
    free = Command("whole_angle")
    device = load_device("hrg_hardware")
    spy = _Spy(_instrument(device))

    def bump(count: int) -> None:
        if count == 1:
            spy.inner._rate = 0.03

    spy.before_record = bump
    with pytest.raises(ExperimentAborted, match=r"moved 1\.[5-7]\d* deg/s in step b"):
        run_plan(spy, Plan("p", (Step("a", free, 5.0, 4.0), Step("b", free, 5.0, 2.0))))


@pytest.mark.parametrize("name", ["hrg_sun2024", "hrg_hardware"])
def test_a_base_at_rest_never_ends_a_whole_angle_calibration(name: str) -> None:
    instrument = _instrument(load_device(name), 2e-3)
    for plan in ("virtual_precession", "scale_factor"):
        assert len(run_plan(instrument, plan_by_name(plan, instrument.factory, quality="quick")))


def test_wrong_plans_are_refused() -> None:
    with pytest.raises(DataError, match="Plan must be one of"):
        plan_by_name("sidebands", {})
    with pytest.raises(DataError, match="quality must be one of quick, standard, fine, but got 'best'"):
        plan_by_name("sideband", {}, quality="best")
    with pytest.raises(DataError, match="duration_s must be > 0"):
        Step("s", Command(), 0.0)
    with pytest.raises(ExperimentAborted, match="locates the resonance"):
        run_plan(_instrument(), Plan("p", (Step("s", Command("loops_off", Excitation("drive", volts=1.0)), 1.0, detuning_hz=20.0),)))
