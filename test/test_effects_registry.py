"""Effects in the whole: the registry, device files, refusals, what the truth says of them, chambers and tables that some of them need."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from effect_samples import (
    compiled_only,
    plain_device,
)

from gyro_calib.device import Device, Feedthrough, device_from_dict, device_to_dict, draw_unit, dump_device, load_device
from gyro_calib.effects import EFFECTS, checked_sizes
from gyro_calib.errors import DeviceError, ExperimentAborted
from gyro_calib.experiments import Plan, SimulatedInstrument, Step, run_plan
from gyro_calib.recording.applied_rate import words_of_steps
from gyro_calib.recording.command import Command
from gyro_calib.recording.rate import raw_rate
from gyro_calib.simulation import GyroSimulator


@pytest.fixture(scope="module")
def plain() -> Device:
    return plain_device()


def test_registry_is_consistent() -> None:
    for name, effect in EFFECTS.items():
        assert name == effect.name
        assert set(effect.nearest) <= set(EFFECTS) - {name}
        assert checked_sizes({name: effect.typical}) == {name: effect.typical}
        assert len({p.name for p in effect.parameters}) == len(effect.parameters)
        for p in effect.parameters:
            assert p.typical < 0.51 * (p.upper - p.lower)


def test_device_with_effects_survives_its_file(plain: Device, tmp_path: Any) -> None:
    device = replace(plain, effects={name: effect.typical for name, effect in EFFECTS.items()})
    dump_device(device, tmp_path / "unit.yaml")
    assert load_device(tmp_path / "unit.yaml") == device
    assert hash(device) != 0
    assert draw_unit(device, 3).effects == device.effects
    assert "effects" not in device_to_dict(plain)
    document = {**device_to_dict(plain), "effects": {"duffing_axes": {"k_x": "1e-2"}}}
    assert device_from_dict(document).effects == {"duffing_axes": {"k_x": 0.01, "k_y": 0.0}}


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ({"dufing": {"k": 1.0}}, "Effect must be one of duffing, .* but got 'dufing'"),
        ({"duffing": {"kk": 1.0}}, "parameter must be one of k, but got 'kk'"),
        ({"duffing": 3}, "duffing must be a mapping"),
        ({"duffing": {"k": "much"}}, "duffing.k must be a number, but got 'much'"),
        ({"duffing": {"k": float("nan")}}, "duffing.k must be finite"),
        ({"duffing": {"k": 1e9}}, r"duffing.k must be within -20 and 20 rad/s/V\^2"),
        ({"drive_lag": {"tau": -1.0}}, "drive_lag.tau must be within 0 and"),
        ({"relaxation": {"c": 1.0}}, r"relaxation must have tau, but got \['c'\]"),
        ([1], "effects must be a mapping of effects"),
    ],
)
def test_wrong_effects_are_refused_by_name(plain: Device, effects: Any, message: str) -> None:
    with pytest.raises(DeviceError, match=message):
        replace(plain, effects=effects)


@pytest.mark.parametrize("name", ["spurious_mode", "relaxation", "drive_lag", "pickoff_quantisation", "thermal_feedthrough"])
def test_slow_flow_refuses_what_it_does_not_have(plain: Device, name: str) -> None:
    device = replace(plain, effects={name: EFFECTS[name].typical, "duffing": {"k": 0.1}})
    with pytest.raises(DeviceError, match=f"but got {name}. Simulate with fidelity carrier"):
        GyroSimulator(device, rng=np.random.default_rng(0), fidelity="slow_flow")


def test_effects_of_no_size_change_nothing(plain: Device) -> None:
    """Through the effect kernels instead of the plain samples: the same physics, to rounding."""
    device = replace(plain, feedthrough=Feedthrough(1e-3, 2e-3, 3e-4, 1e-4, -2e-4, 1e-4, 5e-4, 1e-3))
    answers = []
    for effects in ({}, {"drive_sag": {"d": 0.0}, "mains_pickup": {"frequency_hz": 50.0}}):
        simulator = GyroSimulator(replace(device, effects=effects), rng=np.random.default_rng(2))
        answers.append(simulator.advance(0.02, 0.1))
    np.testing.assert_allclose(answers[1], answers[0], rtol=1e-9, atol=1e-12)


# ---------------------------------------------------------------- truth, chamber


@compiled_only
@pytest.mark.parametrize(
    "name",
    [
        "cubic_cross_stiffness",
        "nonlinear_damping_axes",
        "spurious_mode",
        "parametric_pump",
        "pickoff_amplitude_phase",
        "thermal_drive_phase",
        "thermal_drive_coupling",
        "thermal_pickoff_coupling",
        "drive_delay",
        "pickoff_delay",
        "multiplexing_skew",
    ],
)
def test_truth_knows_what_effects_do_to_the_bias(name: str) -> None:
    unit = draw_unit(load_device("ring_15k"), 3)
    warm = replace(unit, environment=replace(unit.environment, temperature_degc=31.0))
    found = []
    for effects in ({}, {name: {key: 3.0 * size for key, size in EFFECTS[name].typical.items()}}):
        simulator = GyroSimulator(replace(warm, effects=effects), rng=np.random.default_rng(0), noisy=False)
        simulator.advance(3.0)
        rate = raw_rate(simulator.advance(0.3), simulator.command, simulator.factory).mean()
        found.append(rate)
        # 0.6 deg/h; of a bias of degrees a second, a thousandth
        assert rate == pytest.approx(simulator.truth().bias_rad_s, abs=3e-6, rel=1e-3)
    assert abs(found[1] - found[0]) > 1e-5


@pytest.mark.parametrize("over_s", [0.0, 0.4])
def test_chamber_moves_the_temperature_and_the_truth(plain: Device, over_s: float) -> None:
    simulator = GyroSimulator(plain, rng=np.random.default_rng(0), fidelity="slow_flow", noisy=False)
    simulator.advance(0.2)
    before = simulator.truth().bias_rad_s
    simulator.move_to_temperature(45.0, over_s)
    rows = simulator.advance(1.0)
    expected = 25.0 + 20.0 * np.clip(np.arange(500) / 500.0 / over_s, 0.0, 1.0) if over_s else np.full(500, 45.0)
    np.testing.assert_allclose(rows[:, 11], expected, atol=1e-9)
    assert rows[-1, 10] - 15003.7 == pytest.approx(-27e-6 * 20.0 * 15003.7, rel=0.3)
    assert simulator.truth().bias_rad_s != before
    for wrong in ((-300.0, 0.0), (30.0, -1.0)):
        with pytest.raises(DeviceError, match="must be"):
            simulator.move_to_temperature(*wrong)


def test_plan_takes_the_gyro_through_a_chamber_and_over_a_table() -> None:
    simulator = GyroSimulator(load_device("ring_15k"), rng=np.random.default_rng(0), fidelity="slow_flow")
    table = words_of_steps([0.0, 0.5], [0.0, 0.2])
    steps = (
        Step("cold", Command(), 0.4, 0.5),
        Step("warm", Command(), 0.4, 2.0, temperature_degc=35.0),
        Step("still warm", Command(), 1.0, 0.5, applied_rate=table),
    )
    campaign = run_plan(SimulatedInstrument(simulator), Plan("chamber", steps))
    cold, warm, still = campaign.recordings
    assert np.ptp(warm.temperature_degc) < 0.05
    assert warm.temperature_degc.mean() - cold.temperature_degc.mean() == pytest.approx(10.0, abs=0.05)
    assert still.temperature_degc.mean() == pytest.approx(35.0, abs=0.05)
    rates = raw_rate(still.data, still.command, dict(campaign.factory))
    assert rates[-100:].mean() - rates[100:200].mean() == pytest.approx(0.2, rel=0.1)
    with pytest.raises(ExperimentAborted, match="stand in a chamber"):
        run_plan(_NoChamber(simulator), Plan("chamber", steps[:2]))


class _NoChamber(SimulatedInstrument):
    abilities = frozenset({"applied_rate"})
