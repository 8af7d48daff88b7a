"""Factory on a rate table: Bryant factor, pick-off frame, mounting, fixed rate difference; its record, apart from the field's."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench_data import BENCH, needs_bench, truth
from calibration_samples import make_record

from gyro_calib.calibration import FactoryRecord, FactoryStore, RecordStore, factory_record_from_result, with_factory_record
from gyro_calib.cli.main import main
from gyro_calib.device import Device, draw_unit, load_device
from gyro_calib.errors import CalibrationRefused, DataError, StoreError
from gyro_calib.estimation import calibrate
from gyro_calib.estimation.factory import FactoryResult, calibrate_factory
from gyro_calib.estimation.rate_table import fit_rate_table
from gyro_calib.experiments import SimulatedInstrument, factory_plan, run_plan, self_calibration_plan
from gyro_calib.quantity import Quantity
from gyro_calib.recording import write_campaign_h5
from gyro_calib.recording.applied_rate import applied_rate, table_axis, words_of_steps
from gyro_calib.recording.command import Command
from gyro_calib.recording.recording import Campaign, Recording
from gyro_calib.simulation import GyroSimulator
from gyro_calib.units import DEG_H

KAPPA, RATE = 0.80123, 9.3 * DEG_H
TILT_X, TILT_Y = 2e-3, -3e-3


def _unit(seed: int) -> Device:
    """A unit whose Bryant factor its own factory data do not know."""
    device = draw_unit(load_device("ring_15k"), seed)
    return replace(device, resonator=replace(device.resonator, angular_gain=KAPPA))


def _campaign(device: Device, orientations: tuple[str, ...] = ("z",), *, noisy: bool = True, fidelity: str = "carrier") -> Campaign:
    simulator = GyroSimulator(device, rng=np.random.default_rng(4), noisy=noisy, fidelity=fidelity)
    axis = (0.0, 0.0, 1.0)
    if len(orientations) > 1:
        axis = (math.sin(TILT_Y), -math.sin(TILT_X) * math.cos(TILT_Y), math.cos(TILT_X) * math.cos(TILT_Y))
    plan = factory_plan(simulator.factory, quality="quick", orientations=orientations)
    return run_plan(SimulatedInstrument(simulator, RATE, sense_axis=axis), plan)


@pytest.fixture(scope="module")
def device() -> Device:
    return _unit(1)


@pytest.fixture(scope="module")
def campaign(device: Device) -> Campaign:
    return _campaign(device, ("z", "x", "y"))


@pytest.fixture(scope="module")
def result(campaign: Campaign) -> FactoryResult:
    return calibrate_factory(campaign, known_rate=Quantity(RATE, 0.1 * DEG_H, "rad/s"))


def _frame(device: Device) -> tuple[float, float, float]:
    """r, n and eps of the true pick-off chain, as the metric of separation.py defines them."""
    bare = np.abs(device.pickoff.matrix()) * np.sign(device.pickoff.matrix().real)
    metric = bare @ bare.T
    phase = device.pickoff.phase_y_rad - device.pickoff.phase_x_rad
    return math.sqrt(metric[1, 1] / metric[0, 0]), 0.5 * metric[0, 1] / metric[0, 0], phase


def test_kappa_frame_and_mounting_lie_within_their_sd(device: Device, result: FactoryResult) -> None:
    r, n, phase = _frame(device)
    tilt = result.misalignment or {}
    for found, true, wanted_sd in (
        (result.angular_gain_kappa, KAPPA, 30e-6),
        (result.pickoff_ratio, r, 30e-6),
        (result.pickoff_non_orthogonality, n, 20e-6),
        (result.pickoff_phase, phase, 30e-6),
        (tilt["about_x"], TILT_X, 30e-6),
        (tilt["about_y"], TILT_Y, 30e-6),
    ):
        assert found.sd < wanted_sd
        assert abs(found.value - true) < 4 * found.sd
    # the factory data said 0.8: three hundred standard deviations off
    assert abs(result.angular_gain_kappa.value - 0.8) > 30 * result.angular_gain_kappa.sd


def test_the_fixed_difference_is_what_a_field_calibration_is_off_by(result: FactoryResult) -> None:
    difference = result.rate_difference
    assert difference is not None
    assert abs(difference.value) < 4 * difference.sd
    assert 0.1 * DEG_H < difference.sd < 2 * DEG_H


def test_noise_free_kappa_is_exact_at_both_fidelities() -> None:
    for fidelity, limit in (("carrier", 3e-6), ("slow_flow", 20e-6)):
        device = _unit(2)
        campaign = _campaign(device, noisy=False, fidelity=fidelity)
        found = calibrate_factory(campaign)
        assert found.angular_gain_kappa.value == pytest.approx(KAPPA, rel=limit)
        assert found.pickoff_ratio.value == pytest.approx(_frame(device)[0], rel=10e-6)
        assert found.rate_difference is None
        assert found.misalignment is None
        assert any("not observable" in w for w in found.warnings)


@needs_bench
@pytest.mark.parametrize("name", ["ring_a", "ring_b", "hrg_a", "hrg_b"])
def test_kappa_of_another_plants_table_runs(name: str) -> None:
    """Force to rebalance and whole angle, with nonlinear damping and pick-offs that the model does not hold: within two sd."""
    from gyro_calib.recording import load_campaign

    true = truth(name)
    found = calibrate_factory(load_campaign(BENCH / f"{name}.h5", check=False))
    assert abs(found.angular_gain_kappa.value - true["angular_gain_kappa"]) < 2 * found.angular_gain_kappa.sd
    assert found.angular_gain_kappa.sd < 300e-6
    assert abs(found.pickoff_ratio.value - abs(true["ratio"])) < 3 * found.pickoff_ratio.sd
    assert abs(found.pickoff_ratio.value - abs(true["ratio"])) < 100e-6


def test_a_tables_clock_that_is_off_by_milliseconds_does_no_harm(campaign: Campaign) -> None:
    def late(recording: Recording) -> Recording:
        words = recording.extras.get("applied_rate")
        if words is None:
            return recording
        moved = {**words, "t_s": [t + 2e-3 if t > 0 else t for t in words["t_s"]]}
        return replace(recording, extras={**recording.extras, "applied_rate": moved})

    shifted = replace(campaign, recordings=tuple(map(late, campaign)))
    found = calibrate_factory(shifted).angular_gain_kappa
    assert abs(found.value - KAPPA) < 4 * found.sd
    assert found.sd < 150e-6


def test_refusals_name_the_remedy(campaign: Campaign) -> None:
    still = replace(campaign, recordings=tuple(r for r in campaign if "applied_rate" not in r.extras))
    with pytest.raises(CalibrationRefused, match="rate-table run"):
        calibrate_factory(still)
    with pytest.raises(CalibrationRefused, match="Turn the gyro"):
        fit_rate_table(list(still), 1.5)
    one = replace(campaign, recordings=tuple(r for r in campaign if "applied_rate" not in r.extras or r.command.mode == "ftr_x"))
    with pytest.raises(CalibrationRefused, match="axes swapped"):
        calibrate_factory(one)
    two = replace(campaign, recordings=tuple(r for r in campaign if not r.label.endswith("about_y")))
    with pytest.raises(CalibrationRefused, match="one, or three that span space"):
        calibrate_factory(two)
    with pytest.raises(CalibrationRefused, match="rad/s"):
        calibrate_factory(campaign, known_rate=Quantity(1.0, 0.0, "deg/h"))

    def turned(recording: Recording) -> Recording:
        words = recording.extras.get("applied_rate")
        if words is None:
            return recording
        return replace(recording, extras={**recording.extras, "applied_rate": {**words, "deg_s": [-w for w in words["deg_s"]]}})

    main_axis = tuple(r for r in campaign if "about" not in r.label)
    with pytest.raises(CalibrationRefused, match="sign of applied_rate"):
        calibrate_factory(replace(campaign, recordings=tuple(map(turned, main_axis))))
    with pytest.raises(DataError, match="orientations among"):
        factory_plan(campaign.factory, orientations=("w",))


# --- the applied rate -------------------------------------------------------------------------------------------------------------------


def _still(extras: dict[str, Any], rows: int = 100) -> Recording:
    data = np.zeros((rows, 12))
    data[:, 0] = 5.0 + (np.arange(rows) + 0.5) * 0.01
    return Recording("u", data, Command(), 100.0, extras=extras)


def test_applied_rate_in_all_its_words() -> None:
    steps = _still({"applied_rate": words_of_steps([0.0, 0.255, 0.5], [0.0, 1.0, -0.5], (1.0, 0.0, 1.0))})
    rate, slope = applied_rate(steps)
    np.testing.assert_allclose(rate[[0, 24, 25, 26, 49, 50, 99]], [0, 0, 0.5, 1, 1, -0.5, -0.5], atol=1e-9)
    assert np.flatnonzero(slope).tolist() == [25, 49] or np.flatnonzero(slope).tolist() == [25, 50]
    assert slope.sum() * 0.01 == pytest.approx(-0.5)
    np.testing.assert_allclose(table_axis(steps), [2**-0.5, 0.0, 2**-0.5])
    ramp, _ = applied_rate(_still({"applied_rate": {"kind": "linear", "t_s": [0.0, 1.0], "rad_s": [0.0, 2.0]}}))
    np.testing.assert_allclose(ramp, 2.0 * (np.arange(100) + 0.5) * 0.01, atol=1e-9)
    constant, none = applied_rate(_still({"applied_rate": 90.0}))
    np.testing.assert_allclose(constant, math.pi / 2)
    assert not none.any()
    assert not applied_rate(_still({}))[0].any()
    begun = _still({"applied_rate": words_of_steps([0.0, 0.5], [0.0, 1.0]), "t_run_start": 4.0, "settle_s": 0.8})
    assert np.flatnonzero(applied_rate(begun)[0])[0] in (29, 30)
    for wrong in (
        {"t_s": [0.0]},
        {"t_s": [0.0, 1.0], "deg_s": [1.0]},
        {"t_s": [0.0], "deg_s": ["fast"]},
        "fast",
        {"t_s": [0.0], "deg_s": [math.nan]},
    ):
        with pytest.raises(DataError, match="applied_rate"):
            applied_rate(_still({"applied_rate": wrong}))
    with pytest.raises(DataError, match="axis"):
        table_axis(_still({"applied_rate": {**words_of_steps([0.0], [1.0]), "axis": [0, 0, 0]}}))


# --- the record -------------------------------------------------------------------------------------------------------------------------


def _record(device_id: str = "ring_15k-0001") -> FactoryRecord:
    return FactoryRecord(
        device_id=device_id,
        created_utc="2026-01-02T03:04:05+00:00",
        angular_gain_kappa=Quantity(0.8012, 1e-5, "1"),
        pickoff_ratio=Quantity(0.99, 1e-5, "1"),
        pickoff_non_orthogonality=Quantity(1e-3, 1e-5, "rad"),
        pickoff_phase=Quantity(2e-3, 1e-5, "rad"),
        misalignment={"about_x": Quantity(1e-3, 1e-5, "rad"), "about_y": Quantity(2e-3, 1e-5, "rad")},
        rate_difference=Quantity(3 * DEG_H, 0.5 * DEG_H, "rad/s"),
        temperature_degc=25.0,
        provenance={"known_rate": None},
    )


def test_the_record_survives_the_disk_and_refuses_what_is_not_it(tmp_path: Path) -> None:
    record = _record()
    store = FactoryStore(tmp_path, record.device_id)
    assert store.load() is None
    path = store.save(record)
    assert path == tmp_path / "ring_15k-0001.factory.yaml"
    assert store.load() == record
    assert path.stat().st_mode & 0o222 == 0
    with pytest.raises(StoreError, match="must not be overwritten"):
        store.save(replace(record, temperature_degc=30.0))
    assert store.load() == record
    store.save(replace(record, temperature_degc=30.0), replace_existing=True)
    loaded = store.load()
    assert loaded is not None
    assert loaded.temperature_degc == 30.0
    assert path.with_name(path.name + ".before").exists()
    with pytest.raises(StoreError, match="must belong to device 'other'"):
        FactoryStore(path, "other").load()
    with pytest.raises(StoreError, match="its own record"):
        FactoryStore(tmp_path, "other").save(record)
    path.chmod(0o644)
    path.write_text(path.read_text().replace("0.8012", "0.8013"))
    with pytest.raises(StoreError, match="checksum"):
        store.load()


def test_a_field_calibration_never_overwrites_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    field = make_record()
    factory = FactoryStore(None, field.device_id)
    path = factory.save(_record(field.device_id))
    text = path.read_text()
    own = RecordStore(None, field.device_id)
    assert own.save(field) != path
    with pytest.raises(StoreError, match="never overwrites"):
        RecordStore(path, field.device_id).save(field)
    assert path.read_text() == text
    assert own.load().record_id == field.record_id


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("pickoff_phase"), "pickoff_phase"),
        (lambda d: d["angular_gain_kappa"].update(value=-1.0), "must be > 0"),
        (lambda d: d["pickoff_phase"].update(unit="deg"), "quantity in rad"),
        (lambda d: d.update(temperature_degc="warm"), "types"),
        (lambda d: d.update(device_id=""), "device_id"),
    ],
)
def test_impossible_records_are_refused(change: Callable[[dict[str, Any]], Any], message: str) -> None:
    document = json.loads(json.dumps(_record().to_dict()))
    assert FactoryRecord.from_dict(document) == _record()
    change(document)
    with pytest.raises(DataError, match=message):
        FactoryRecord.from_dict(document)


def test_a_field_calibration_uses_kappa_and_the_fixed_difference(device: Device, result: FactoryResult, campaign: Campaign) -> None:
    simulator = GyroSimulator(device, rng=np.random.default_rng(9))
    field = run_plan(SimulatedInstrument(simulator, RATE), self_calibration_plan(simulator.factory, quality="quick"))
    record = factory_record_from_result(result, campaign, created=datetime(2026, 1, 2, tzinfo=timezone.utc))
    shifted = replace(record, rate_difference=Quantity(7 * DEG_H, 2 * DEG_H, "rad/s"))
    plain = calibrate(field, with_convergence=False)
    known = calibrate(with_factory_record(field, shifted), with_convergence=False)
    scale = known.scale_factor["x"].value / plain.scale_factor["x"].value
    assert scale == pytest.approx(record.angular_gain_kappa.value / 0.8, rel=1e-9)
    # the rate moves by the difference (and by kappa), the bias the other way
    assert known.rate.value == pytest.approx(plain.rate.value * 0.8 / record.angular_gain_kappa.value - 7 * DEG_H, abs=1e-9)
    assert known.bias["x"].value - plain.bias["x"].value * 0.8 / record.angular_gain_kappa.value == pytest.approx(7 * DEG_H, rel=0.05)
    assert known.rate.sd == pytest.approx(math.hypot(plain.rate.sd, 2 * DEG_H), rel=0.01)
    true = simulator.truth()
    volts = field.factory["nominal_scale_factor_v_per_rad_s"]["x"]
    assert abs(plain.mission["x"].volts_per_rad_s / volts / true.scale_factor - 1) > 1e-3
    own = calibrate(with_factory_record(field, record), with_convergence=False).mission["x"]
    error = own.volts_per_rad_s / volts - true.scale_factor
    assert abs(error) < 4 * math.sqrt(own.covariance[1, 1]) / volts
    assert with_factory_record(field, None) is field
    with pytest.raises(DataError, match="must belong to device"):
        with_factory_record(field, _record("other"))


def test_the_command_estimates_stores_and_calibrate_reads_it(
    campaign: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ROS_HOME", str(tmp_path / "ros"))
    path = write_campaign_h5(tmp_path / "table.h5", campaign)
    out = tmp_path / "factory.json"
    assert main(["factory", str(path), "--json", str(out), "--known-rate", "9.3", "--store"]) == 0
    document = json.loads(out.read_text())
    assert document["angular_gain_kappa"]["value"] == pytest.approx(KAPPA, rel=60e-6)
    assert document["bryant_factor"]["value"] == pytest.approx(0.5 * KAPPA, rel=60e-6)
    assert set(document["rate_difference"]) == {"value", "sd", "unit"}
    assert "factory record:" in capsys.readouterr().out
    assert main(["factory", str(path), "--store"]) == 1
    assert "--replace" in capsys.readouterr().err
    for url, kappa in (("", KAPPA), ("none", 0.8)):
        target = tmp_path / f"field{url}.json"
        assert main(["calibrate", str(path), "--json", str(target), "--factory-record", url]) == 0
        found = json.loads(target.read_text())
        gain = (
            found["parameters"]["G_yy_abs"]["value"] * found["scale_factor"]["x"]["value"] / found["parameters"]["pickoff_ratio"]["value"]
        )
        assert gain == pytest.approx(kappa, rel=2e-4)
    assert main(["calibrate", str(path), "--factory-record", str(tmp_path / "absent.yaml")]) == 1
