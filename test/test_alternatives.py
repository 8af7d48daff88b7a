"""Document 000's alternatives: plans that a simulator carries out, estimates that hit the truth where the document says they can."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyro_calib.device import Device, draw_unit, load_device
from gyro_calib.errors import CalibrationRefused, DataError
from gyro_calib.estimation.document_fit import document_fit, rough_start
from gyro_calib.estimation.slow_flow_estimate import SlowFlowEstimate
from gyro_calib.estimation.swept_drive import fit_swept_drive
from gyro_calib.experiments import Limits, SimulatedInstrument, run_plan
from gyro_calib.experiments.alternatives import ALTERNATIVES, SWEEP_HZ, alternative_plan
from gyro_calib.recording.command import Command, Setpoints
from gyro_calib.recording.recording import Campaign
from gyro_calib.simulation import GyroSimulator
from gyro_calib.study.studies.sideband_alternatives import summarise
from gyro_calib.units import DEG_H

RATE = 20.0 * DEG_H


@pytest.fixture(scope="module")
def device() -> Device:
    return draw_unit(load_device("ring_15k"), 5)


def _campaign(device: Device, name: str, *, noisy: bool) -> Campaign:
    simulator = GyroSimulator(device, rng=np.random.default_rng(3), noisy=noisy)
    plan = alternative_plan(name, simulator.factory, lines_hz=(0.5, 1.5), limits=Limits(temperature_k=20.0, base_rate_rad_s=1.0))
    return run_plan(SimulatedInstrument(simulator, RATE), plan)


def _swept(device: Device, campaign: Campaign) -> SlowFlowEstimate:
    omega0 = float(np.mean([r.ref_omega_rad_s.mean() for r in campaign if r.command.oscillator_axis]))
    return fit_swept_drive(list(campaign), omega0, device.resonator.decay_rate())


def _cross_error_deg_h(device: Device, found: SlowFlowEstimate) -> float:
    flow = device.slow_flow(RATE)
    error = np.array([found.values.A[0, 1] - flow.A[0, 1], found.values.A[1, 0] - flow.A[1, 0]])
    return float(np.max(np.abs(error.real))) / device.resonator.angular_gain / DEG_H


@pytest.mark.slow
def test_open_secondary_swings_freely_and_closes_again() -> None:
    device = draw_unit(load_device("ring_15k"), 3)
    for fidelity in ("carrier", "slow_flow"):
        simulator = GyroSimulator(device, rng=np.random.default_rng(0), fidelity=fidelity, noisy=False)
        simulator.configure(Command("ftr_x", setpoints=Setpoints(rebalance=0.0)))
        row = simulator.advance(12.0)[-1]
        volts, drive = np.array([row[2] + 1j * row[3], row[4] + 1j * row[5]]), np.array([row[6] + 1j * row[7], row[8] + 1j * row[9]])
        flow = device.slow_flow()
        p = volts - flow.E @ drive
        dynamics = flow.A - 1j * (2 * np.pi * row[10] - flow.omega0_rad_s) * np.eye(2)
        assert drive[1] == 0.0
        assert abs(volts[1]) > 0.1
        assert np.max(np.abs(dynamics @ p + flow.G @ drive)) < 1e-4
        simulator.configure(Command("ftr_x"))
        closed = simulator.advance(2.0)[-1]
        assert np.hypot(closed[4], closed[5]) < 1e-6


def test_rebalance_is_a_set_point_that_is_on_or_off() -> None:
    command = Command("ftr_y", setpoints=Setpoints(rebalance=0.0))
    assert Command.from_parameters(command.to_parameters()) == command
    assert Command().to_parameters()["setpoint.rebalance"] == 1.0
    with pytest.raises(DataError, match=r"rebalance must be 1 \(on\) or 0 \(off\), but got 0.5"):
        Setpoints(rebalance=0.5)


@pytest.mark.parametrize("name", [n for n in ALTERNATIVES if n != "swept_drive"])
def test_the_document_model_fits_every_alternative_without_noise(device: Device, name: str) -> None:
    campaign = _campaign(device, name, noisy=False)
    start = lambda model: 1.3 * rough_start(model, device.factory())  # noqa: E731
    fit = document_fit(list(campaign), start, weights="equal")
    assert fit.converged
    # an open secondary is as good as what is known of its resonance
    assert _cross_error_deg_h(device, fit.slow_flow()) < (60.0 if name == "open_secondary" else 5.0)
    flow = device.slow_flow(RATE)
    assert np.max(np.abs(fit.slow_flow().values.G - flow.G)) < 2e-5 * abs(flow.G[0, 0])


def test_a_swept_drive_finds_a_resonator_that_stands_still_but_not_one_that_moves(device: Device) -> None:
    still = _swept(device, _campaign(device, "swept_drive", noisy=True))
    assert _cross_error_deg_h(device, still) < 15.0
    assert abs(still.values.G[1, 1] / device.slow_flow().G[1, 1] - 1) < 1e-4
    assert np.max(np.abs(still.values.E - device.feedthrough.matrix())) < 5e-6
    duration = alternative_plan("swept_drive", device.factory()).duration_s
    drifting = replace(device, environment=replace(device.environment, temperature_degc=22.5, ramp_k_per_s=5.0 / duration))
    moving = _swept(drifting, _campaign(drifting, "swept_drive", noisy=True))
    assert _cross_error_deg_h(device, moving) > 100.0
    # and it says so
    size = still.covariance.shape[0] // 2
    assert np.sqrt(moving.covariance[size, size]) > 10.0 * np.sqrt(still.covariance[size, size])


def test_plans_have_the_same_open_records_and_step_through_resonance(device: Device) -> None:
    plans = {name: alternative_plan(name, device.factory()) for name in ALTERNATIVES}
    labels = {name: [s.label for s in plan.steps if s.label.startswith(("locate", "feed", "body"))] for name, plan in plans.items()}
    assert all(found == labels["amplitude"] for found in labels.values())
    sweep = [s for s in plans["swept_drive"].steps if s.label.startswith("sweep_y")]
    assert tuple(s.detuning_hz for s in sweep) == SWEEP_HZ
    # as many volts as the oscillator needs at resonance
    gain = abs(device.slow_flow().G[1, 1])
    assert sweep[0].command.excitation.volts * gain / device.resonator.decay_rate() == pytest.approx(1.0, rel=0.3)
    assert all(s.command.setpoints.rebalance == 0.0 for s in plans["open_secondary"].steps if s.label.startswith("open"))
    assert plans["frequency"].final == Command()


def test_unknown_names_and_missing_data_are_refused(device: Device) -> None:
    with pytest.raises(DataError, match="swept_drive, but got 'chirp'"):
        alternative_plan("chirp", device.factory())
    with pytest.raises(DataError, match="nominal_q"):
        alternative_plan("open_secondary", {"nominal_f0_hz": 15e3})
    with pytest.raises(DataError, match="nominal_scale_factor"):
        alternative_plan("swept_drive", {"nominal_f0_hz": 15e3, "nominal_q": 3e4, "angular_gain_kappa": 0.8})
    campaign = _campaign(device, "amplitude", noisy=False)
    driven_x = [r for r in campaign if r.command.excitation.axis != "y"]
    with pytest.raises(CalibrationRefused, match="open drive on y"):
        fit_swept_drive(driven_x, 1e5, 1.5)


def test_gates_of_the_comparison_fail_when_the_documents_way_is_no_better() -> None:
    names = ("amplitude", "amplitude, stiffening", "frequency", "secondary", "open_secondary", "swept_drive")
    alike = {
        f"{n}/{c}/{what}": np.array([1.0, -1.0])
        for n in names
        for c in ("still", "moving", "cubic")
        for what in ("bias", "scale", "bias/sd")
    }
    verdicts = {gate.name: gate.passed for gate in summarise(alike)}
    assert sum(not passed for passed in verdicts.values()) == 3
    assert not verdicts["a swept drive suffers from a moving resonance: bias error over the document's own way"]
