"""Trim check of the feedthrough: silent when E is as measured, and tells by how much when it is not (document 000, step 2)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench_data import BENCH, needs_bench

from gyro_calib.device import Device, draw_unit, load_device
from gyro_calib.device.chains import Feedthrough
from gyro_calib.estimation import CalibrationResult, calibrate
from gyro_calib.experiments import SimulatedInstrument, run_plan, self_calibration_plan
from gyro_calib.recording import load_campaign
from gyro_calib.recording.recording import Campaign
from gyro_calib.simulation import GyroSimulator
from gyro_calib.units import DEG_H

#: what the trim of the drive lines has changed since the open drive was recorded
SINCE = Feedthrough(xx_re=0.0, xx_im=6e-5, xy_re=5e-5, xy_im=0.0, yx_re=-4e-5, yx_im=8e-5, yy_re=0.0, yy_im=0.0)


def _campaign(device: Device, seed: int) -> Campaign:
    simulator = GyroSimulator(device, rng=np.random.default_rng([seed, 11]), fidelity="carrier")
    return run_plan(SimulatedInstrument(simulator, 5.0 * DEG_H), self_calibration_plan(simulator.factory, quality="quick"))


def _is_open(recording) -> bool:
    return recording.command.excitation.kind == "drive"


@pytest.fixture(scope="module")
def device() -> Device:
    return draw_unit(load_device("ring_15k"), 6)


@pytest.fixture(scope="module")
def campaign(device: Device) -> Campaign:
    return _campaign(device, 6)


@pytest.fixture(scope="module")
def right(campaign: Campaign) -> CalibrationResult:
    return calibrate(campaign, with_convergence=False)


@pytest.fixture(scope="module")
def stale(device: Device, campaign: Campaign) -> CalibrationResult:
    """The open drive of the unit before its feedthrough changed, the rest of it after."""
    names = Feedthrough.__dataclass_fields__
    before = Feedthrough(**{n: getattr(device.feedthrough, n) - getattr(SINCE, n) for n in names})
    opened = [r for r in _campaign(replace(device, feedthrough=before), 6) if _is_open(r)]
    return calibrate(replace(campaign, recordings=(*opened, *(r for r in campaign if not _is_open(r)))), with_convergence=False)


def test_feedthrough_as_measured_is_called_consistent(right: CalibrationResult) -> None:
    check = right.feedthrough
    assert check is not None
    assert check.measured
    assert check.consistent
    assert np.median(check.sd.view(float)) < 6e-6, "a check that knows nothing would always agree"
    assert right.verdicts[0].startswith("feedthrough as measured is consistent")
    assert not any("feedthrough" in text for text in right.warnings)


def test_feedthrough_that_changed_is_told_with_size_and_uncertainty(right: CalibrationResult, stale: CalibrationResult) -> None:
    check = stale.feedthrough
    assert check is not None
    assert check.measured
    assert not check.consistent
    off = check.off_by - SINCE.matrix()
    assert np.all(np.abs(off.real) < 4 * check.sd.real)
    assert np.all(np.abs(off.imag) < 4 * check.sd.imag)
    # what was changed by more than its sd is seen
    assert abs(check.off_by[1, 0].imag) > 10 * check.sd[1, 0].imag
    assert "is off, most E_" in stale.verdicts[0]
    assert "run_feedthrough" in stale.verdicts[0]
    assert stale.verdicts[0] in stale.warnings
    # and it matters: this is what the check is for
    assert abs(stale.bias["x"].value - right.bias["x"].value) > 5 * right.bias["x"].sd


def test_feedthrough_that_was_not_measured_widens_the_sd_to_cover_it(device: Device, campaign: Campaign, right: CalibrationResult) -> None:
    """The side bands alone hardly tell E from the drive gains: what may be of it must stand in the sd, not in the error."""
    closed = replace(campaign, recordings=tuple(r for r in campaign if not _is_open(r)))
    result = calibrate(closed, with_convergence=False)
    assert result.feedthrough is not None
    assert not result.feedthrough.measured
    assert "was not measured" in result.verdicts[0]
    assert any("feedthrough E was not measured" in text for text in result.warnings)
    for axis in "xy":
        assert abs(result.bias[axis].value - right.bias[axis].value) < 4 * result.bias[axis].sd
        assert abs(result.scale_factor[axis].value - right.scale_factor[axis].value) < 4 * result.scale_factor[axis].sd
    assert abs(result.rate.value - 5.0 * DEG_H) < 4 * result.rate.sd
    assert result.bias["x"].sd > 100 * right.bias["x"].sd
    off = result.feedthrough.off_by - device.feedthrough.matrix()
    assert np.all(np.abs(off.real) < 4 * result.feedthrough.sd.real)
    assert np.all(np.abs(off.imag) < 4 * result.feedthrough.sd.imag)


@pytest.mark.slow
def test_chance_is_honest_over_units() -> None:
    """The chance of a right E is spread evenly: neither always small (false alarms) nor always large (blind)."""
    chances = []
    for seed in range(20, 28):
        unit = draw_unit(load_device("ring_15k"), seed)
        simulator = GyroSimulator(unit, rng=np.random.default_rng([seed, 12]), fidelity="carrier")
        campaign = run_plan(SimulatedInstrument(simulator), self_calibration_plan(simulator.factory, quality="quick"))
        check = calibrate(campaign, with_convergence=False).feedthrough
        assert check is not None
        chances.append(check.chance)
    assert min(chances) > 1e-3
    assert 0.2 < np.mean(chances) < 0.8


def test_json_holds_the_check_and_the_shares(right: CalibrationResult) -> None:
    document = right.to_json()
    check = document["feedthrough_check"]
    assert check["consistent"] is True
    assert set(check["off_by"]) == {f"{i}{j}_{part}" for i in "xy" for j in "xy" for part in ("re", "im")}
    shares = document["variance_shares"]
    assert set(shares) == {"rate", "bias_x", "bias_y", "scale_x", "scale_y"}
    for name, found in shares.items():
        assert 0.9 < sum(found.values()) <= 1.0 + 1e-9, name
    # the ratio is taken as constant to 15 ppm, the noise of a quick run is less
    assert next(iter(shares["scale_x"])) == "constancy of the factory's drive-gain ratio (prior)"
    assert next(iter(shares["rate"])) == "noise of the recordings"


@needs_bench
@pytest.mark.parametrize("name", ["ring_a", "ring_b"])
def test_no_false_alarm_on_another_plant(name: str) -> None:
    result = calibrate(load_campaign(BENCH / f"{name}.h5"), with_convergence=False)
    assert result.feedthrough is not None
    assert result.feedthrough.consistent, result.feedthrough.verdict
