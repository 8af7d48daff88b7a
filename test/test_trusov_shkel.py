"""Absolute amplitude from the lines of an electrostatic pick-off, against the carrier-level truth."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from gyro_calib.device import Device, draw_unit, load_device
from gyro_calib.errors import CalibrationRefused, DeviceError, ExperimentAborted
from gyro_calib.estimation.gap_lines import amplitude_in_gaps, ratio_of_lines
from gyro_calib.estimation.trusov_shkel import TrusovShkelResult, estimate_trusov_shkel
from gyro_calib.experiments import SimulatedInstrument, pickoff_phase_plan, plan_by_name, run_plan
from gyro_calib.recording.command import Command, Setpoints
from gyro_calib.recording.recording import Campaign
from gyro_calib.simulation import GyroSimulator

GAP_V = 10.0


def _unit(seed: int, **pickoff: float) -> Device:
    device = draw_unit(load_device("ring_15k"), seed)
    return replace(
        device,
        pickoff=replace(device.pickoff, **{"gap_amplitude_v": GAP_V, **pickoff}),
        electronics=replace(device.electronics, adc_full_scale_v=5.0),
    )


def _campaign(device: Device, *, noisy: bool = True) -> Campaign:
    simulator = GyroSimulator(device, rng=np.random.default_rng(3), noisy=noisy)
    return run_plan(SimulatedInstrument(simulator, 1e-4), pickoff_phase_plan(simulator.factory, quality="quick"))


def _estimate(device: Device, *, noisy: bool = True, gap_equality: float = 0.0) -> TrusovShkelResult:
    return estimate_trusov_shkel(_campaign(device, noisy=noisy), feedthrough=device.feedthrough.matrix(), gap_equality=gap_equality)


def test_the_series_of_a_gap_is_geometric() -> None:
    phase = 2 * np.pi * np.arange(4096) / 4096
    for s in (0.02, 0.2, 0.6):
        lines = np.fft.rfft(s * np.cos(phase) / (1 - s * np.cos(phase)))[1:4].real * 2 / 4096
        q = s / (1 + math.sqrt(1 - s * s))
        assert lines[1] / lines[0] == pytest.approx(q, rel=1e-10)
        assert lines[2] / lines[0] == pytest.approx(q * q, rel=1e-9)
        assert float(ratio_of_lines(np.array([lines[0]]))[0]) == pytest.approx(q, rel=1e-10)
        assert float(amplitude_in_gaps(q)) == pytest.approx(s, rel=1e-12)
    assert float(ratio_of_lines(np.array([-0.3]))[0]) == pytest.approx(-float(ratio_of_lines(np.array([0.3]))[0]))


def test_noise_free_gap_amplitude_and_ratio_are_exact() -> None:
    device = _unit(1)
    result = _estimate(device, noisy=False)
    r = 1 + device.pickoff.gain_mismatch
    assert result.axes["x"].gap_v.value == pytest.approx(GAP_V, rel=3e-6)
    assert result.axes["y"].gap_v.value == pytest.approx(GAP_V * r, rel=3e-6)
    assert result.pickoff_ratio.value == pytest.approx(r, rel=3e-6)
    volts, amplitude = result.axes["x"].steps[0]
    q = float(ratio_of_lines(np.array([volts / GAP_V]))[0])
    assert amplitude.value == pytest.approx(2 * q / (1 + q * q), rel=3e-6)
    assert not result.warnings


def test_noisy_estimates_lie_within_their_sd() -> None:
    errors = []
    for seed in (2, 3, 4):
        device = _unit(seed)
        result = _estimate(device)
        r = 1 + device.pickoff.gain_mismatch
        for found, true in (
            (result.axes["x"].gap_v, GAP_V),
            (result.axes["y"].gap_v, GAP_V * r),
            (result.pickoff_ratio, r),
        ):
            errors.append((found.value - true) / found.sd)
            assert found.sd < 1e-4 * true
    assert np.abs(errors).max() < 4.0
    assert np.sqrt(np.mean(np.square(errors))) < 2.0


def test_unequal_gaps_show_as_pick_off_ratio_and_the_sd_admits_it() -> None:
    device = _unit(1, gap_mismatch=2e-3)
    strict, honest = _estimate(device, noisy=False), _estimate(device, noisy=False, gap_equality=1e-3)
    r = 1 + device.pickoff.gain_mismatch
    assert strict.pickoff_ratio.value / r - 1 == pytest.approx(2e-3, rel=0.01)
    assert abs(honest.pickoff_ratio.value - r) < 3 * honest.pickoff_ratio.sd
    assert abs(strict.pickoff_ratio.value - r) > 10 * strict.pickoff_ratio.sd


def test_feedthrough_that_was_not_measured_stands_in_the_sd() -> None:
    device = _unit(3)
    campaign = _campaign(device)
    without = estimate_trusov_shkel(campaign, gap_equality=0.0)
    measured = estimate_trusov_shkel(campaign, feedthrough=device.feedthrough.matrix(), gap_equality=0.0)
    assert without.axes["x"].gap_v.sd > 5 * measured.axes["x"].gap_v.sd
    assert abs(without.axes["x"].gap_v.value - GAP_V) < 3 * without.axes["x"].gap_v.sd
    assert abs(without.axes["x"].gap_v.value - GAP_V) > 3 * measured.axes["x"].gap_v.sd
    assert any("feedthrough" in w for w in without.warnings)


def test_phase_is_said_to_be_unobservable_and_the_json_holds_quantities() -> None:
    result = _estimate(_unit(1), noisy=False)
    assert any(item.startswith("pickoff_phase") for item in result.not_observable)
    document = result.to_json()
    assert set(document["gap"]["x"]) == {"value", "sd", "unit"}
    assert document["gap"]["x"]["unit"] == "V"
    # a pure delay is invisible: phi(2 w) - 2 phi(w) = 0
    assert abs(result.axes["x"].phase_excess_rad.value) < 1e-4


def _bent(campaign: Campaign, quadratic: float) -> Campaign:
    """The same with a quadratic converter in place of a gap."""

    def bend(volts: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(volts + quadratic * volts**2)

    raws = [{**(r.raw or {}), "x_pick": bend((r.raw or {})["x_pick"]), "y_pick": bend((r.raw or {})["y_pick"])} for r in campaign]
    return replace(campaign, recordings=tuple(replace(r, raw=raw) for r, raw in zip(campaign, raws, strict=True)))


def test_a_quadratic_converter_is_not_taken_for_a_gap() -> None:
    device = _unit(1, gap_amplitude_v=0.0)
    result = estimate_trusov_shkel(_bent(_campaign(device), 0.05), feedthrough=device.feedthrough.matrix())
    assert any("geometric law" in w for w in result.warnings)
    assert result.axes["x"].chi2_per_dof > 10


def test_a_fixed_share_of_harmonics_is_separated_by_the_amplitudes() -> None:
    device = _unit(1)
    campaign = _campaign(device)
    recordings = []
    for r in campaign:
        raw = dict(r.raw or {})
        axis = r.command.oscillator_axis or "x"
        raw[f"{axis}_pick"] = raw[f"{axis}_pick"] + 2e-3 * r.command.setpoints.amplitude_v * np.cos(2 * raw["phase_ref"])
        recordings.append(replace(r, raw=raw))
    dirty = replace(campaign, recordings=tuple(recordings))
    E = device.feedthrough.matrix()
    assert estimate_trusov_shkel(dirty, feedthrough=E).axes["x"].gap_v.value == pytest.approx(GAP_V, rel=3e-4)
    one = replace(dirty, recordings=tuple(r for r in recordings if r.command.setpoints.amplitude_v == 1.0))
    alone = estimate_trusov_shkel(one, feedthrough=E)
    assert abs(alone.axes["x"].gap_v.value / GAP_V - 1) > 0.02
    assert any("fewer than three amplitudes" in w for w in alone.warnings)


def test_refusals_name_the_remedy() -> None:
    linear = _campaign(_unit(1, gap_amplitude_v=0.0))
    with pytest.raises(CalibrationRefused, match=r"Second harmonic .* Raise the amplitude"):
        estimate_trusov_shkel(linear)
    bent = _campaign(_unit(1))
    with pytest.raises(CalibrationRefused, match="raw recordings with y as the oscillator"):
        estimate_trusov_shkel(replace(bent, recordings=tuple(r for r in bent if r.command.mode == "ftr_x")))
    short = [replace(r, raw={k: v[:3000] for k, v in (r.raw or {}).items()}) for r in linear]
    with pytest.raises(CalibrationRefused, match="Record longer"):
        estimate_trusov_shkel(replace(linear, recordings=tuple(short)))


def test_an_instrument_without_raw_samples_is_refused_before_the_run() -> None:
    class Plain:
        def __init__(self, inner: SimulatedInstrument) -> None:
            self.device_id, self.factory, self.configure, self.record = inner.device_id, inner.factory, inner.configure, inner.record

    simulator = GyroSimulator(load_device("ring_15k"), rng=np.random.default_rng(0))
    plan = plan_by_name("pickoff_phase", simulator.factory, quality="quick")
    with pytest.raises(ExperimentAborted, match="keep converter samples"):
        run_plan(Plain(SimulatedInstrument(simulator)), plan)
    assert simulator.time_s == 0.0


def test_a_motion_near_the_gap_is_refused() -> None:
    simulator = GyroSimulator(_unit(1, gap_amplitude_v=2.0), rng=np.random.default_rng(0))
    with pytest.raises(DeviceError, match=r"below 0\.7 of the gap"):
        simulator.configure(Command(setpoints=Setpoints(1.6)))
