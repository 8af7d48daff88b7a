"""The whole-angle studies, tiny: their trials run, say what they must, and draw."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from gyro_calib.device import load_device
from gyro_calib.quantity import Quantity
from gyro_calib.recording.recording import Recording
from gyro_calib.report.theme import PAPER, save_figure
from gyro_calib.study import find_study, run_study
from gyro_calib.study.studies import _wave, gain_ratio, precession_channels, precession_hardware, precession_table1

WHOLE_ANGLE = ("gain-ratio", "precession-channels", "precession-hardware", "precession-table1")


def _result(name: str, tmp_path: Any, seed: int = 0) -> Any:
    result = run_study(find_study(name), [seed])
    assert not result.failures
    assert np.isfinite(np.concatenate(list(result.figures.values()))).all()
    drawing = result.study.plot(result.figures, PAPER)
    save_figure(drawing.figure, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 5000
    return result


def _failed(result: Any) -> list[str]:
    return [gate.name for gate in result.gates if not gate.passed]


@pytest.mark.parametrize("name", WHOLE_ANGLE)
def test_is_found(name: str) -> None:
    assert find_study(name).name == name


def test_table1_beats_the_documents_method_on_the_same_recordings(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(precession_table1, "_PERIODS", 1)
    # with the axes of seed 0 the errors of the document's 2 lambda happen to cancel
    result = _result("precession-table1", tmp_path, seed=1)
    assert not _failed(result)
    for name in _wave.CHAIN:
        ours, document = (abs(float(result.figures[f"{name}/{who} [%]"][0])) for who in ("ours", "document's method"))
        assert document > 10.0 * ours


def test_channels_agree(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(precession_channels, "_PLAN", "quick")
    result = _result("precession-channels", tmp_path)
    # one seed and a fast wave say nothing of the ratio
    assert not [name for name in _failed(result) if "over" not in name]


@pytest.mark.slow
def test_hardware_compensates_and_calms(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(precession_hardware, "_FREE_S", 260.0)
    monkeypatch.setattr(precession_hardware, "_PRECESSING_S", 700.0)
    monkeypatch.setattr(
        precession_hardware, "_TAU_S", {"free": (16, 32, 64, 128), "precessing": (64, 128, 256, 330), "turned": (64, 128, 256, 330)}
    )
    monkeypatch.setattr(precession_hardware, "_ROUNDS", 2)
    result = _result("precession-hardware", tmp_path)
    device = load_device("hrg_hardware")
    for k, name in enumerate(_wave.CHAIN):
        assert abs(float(result.figures[f"{name}/residual 2"][0])) < 5e-6 < 1e-3 * abs(_wave.true_chain(device)[k]) * 2
    for test, calm in (("precessing", "compensated, drift out"), ("turned", "product")):
        before, after = (float(result.figures[f"allan/{test}/{state}/330"][0]) for state in ("before", calm))
        assert before > 30.0 * after
    assert float(result.figures["product/drift left [deg/h]"][0]) < 0.1


@pytest.mark.slow
def test_gain_ratio_follows_what_a_table_cannot(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gain_ratio, "_TURNS", 20)
    result = _result("gain-ratio", tmp_path)
    assert abs(float(result.figures["ring/table"][0])) > 9000.0
    for key in ("ring/stiffness", "hemisphere/amplitude"):
        assert abs(float(result.figures[key][0])) < 4.0 * float(result.figures[f"{key}/sd"][0]) < 200.0


def test_the_feedthrough_is_found_and_taken_out() -> None:
    device = load_device("ring_15k")
    campaign = _wave.record_plan(device, gain_ratio.Plan("open", tuple(gain_ratio._open_steps())), np.random.default_rng(1), noisy=False)
    for axis, name in enumerate("xy"):
        found = gain_ratio._feedthrough([r for r in campaign if r.label.startswith(f"open_{name}")], axis)
        assert found.imag == pytest.approx(device.feedthrough_matrix()[axis, axis].imag, abs=1e-5)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_binned_precession_of_a_known_wave(sense: float, turning: Callable[[float], Recording]) -> None:
    angle, rate = _wave.binned_precession(turning(sense), 12)
    np.testing.assert_allclose(rate, sense * 0.05 * (1.0 + 0.1 * np.cos(np.radians(angle))), rtol=2e-3)


@pytest.fixture
def turning() -> Callable[[float], Recording]:
    """A wave with theta' = 0.05 (1 + 0.1 cos 4 theta) rad/s of either sense, in steps far shorter than a row."""

    def made(sense: float) -> Recording:
        rows, fine, theta = 4000, 20, 0.3
        data = np.zeros((rows, 12))
        for k in range(rows):
            data[k, 0] = 0.01 * k
            data[k, 2], data[k, 4] = math.cos(2 * theta), math.sin(2 * theta)
            for _ in range(fine):
                theta += sense * 0.05 * (1.0 + 0.1 * math.cos(4 * theta)) * 0.01 / fine
        return Recording("wave", data, _wave.precession_command(sense), 100.0)

    return made


def test_the_worst_is_the_largest_magnitude() -> None:
    gate = _wave.worst("w", np.array([0.1, -0.3]), "1", upper=0.2)
    assert gate.value == Quantity(0.3, 0.0, "1")
    assert not gate.passed
