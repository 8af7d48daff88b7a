"""Each self-check fails for its own reason, with its remedy, and for no other; without ROS."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from calibration_samples import make_record

from gyro_calib.calibration import RecordStore
from gyro_calib.device import draw_unit, load_device
from gyro_calib.nodes.self_checks import SelfCheck, check_device, check_record, check_store, check_stream
from gyro_calib.recording.command import Command, Excitation, Setpoints
from gyro_calib.simulation import GyroSimulator

DEVICE = "ring_15k-0007"


@pytest.fixture(scope="module")
def rows() -> np.ndarray:
    """One second of a gyro at rest, carrier level."""
    simulator = GyroSimulator(draw_unit(load_device("ring_15k"), 7), rng=np.random.default_rng(1), fidelity="carrier")
    simulator.advance(0.5)
    return simulator.advance(1.0)


def stream(rows: np.ndarray | None, **changes: object) -> dict[str, SelfCheck]:
    options: dict = {"age_s": 0.1, "timeout_s": 2.0, "sample_rate_hz": 500.0, "command": Command(), **changes}
    return {check.name: check for check in check_stream(rows, options.pop("age_s"), options.pop("timeout_s"), **options)}


def test_a_good_gyro_passes_everything(rows: np.ndarray) -> None:
    checks = stream(rows)
    assert list(checks) == ["stream", "finite", "sample_rate", "temperature", "amplitude", "loops"]
    assert all(check.passed for check in checks.values()), checks
    assert checks["sample_rate"].values["measured [Hz]"] == pytest.approx(500.0, rel=1e-6)


@pytest.mark.parametrize(
    ("given", "options", "text"),
    [
        (None, {}, "No block has arrived. Start the gyro's driver"),
        ("rows", {"age_s": 3.0}, r"3.0 s old, the limit is 2 s. Restart"),
        ("few", {}, "Only 5 rows have arrived, 20 are needed"),
        ("rows", {"problem": "A block must have 2 dimensions"}, "A block must have 2 dimensions"),
    ],
)
def test_a_stream_that_cannot_be_judged_fails_alone(rows: np.ndarray, given: str | None, options: dict, text: str) -> None:
    checks = stream({None: None, "rows": rows, "few": rows[:5]}[given], **options)
    assert list(checks) == ["stream"]
    assert not checks["stream"].passed
    assert text in checks["stream"].message


def nan(rows: np.ndarray) -> None:
    rows[7, 6] = math.nan


def cold(rows: np.ndarray) -> None:
    rows[:, 11] = -273.0


def gap(rows: np.ndarray) -> None:
    rows[200:, 0] += 0.004


def wrong_rate(rows: np.ndarray) -> None:
    rows[:, 0] *= 1.01


def weak(rows: np.ndarray) -> None:
    rows[:, 2:4] *= 0.9


def open_rebalance(rows: np.ndarray) -> None:
    rows[:, 4] += 0.1


def growing(rows: np.ndarray) -> None:
    rows[:, 2:4] *= np.linspace(0.99, 1.01, rows.shape[0])[:, None]


def hunting(rows: np.ndarray) -> None:
    rows[:, 10] += np.linspace(0.0, 1.0, rows.shape[0])


@pytest.mark.parametrize(
    ("spoil", "failed", "text"),
    [
        (nan, "finite", "x_drive_c hold NaN"),
        (cold, "temperature", "Connect the thermometer"),
        (gap, "sample_rate", "1 gaps or repeats"),
        (wrong_rate, "sample_rate", "must come at 500 Hz, but come at 495.05 Hz"),
        (weak, "amplitude", "0.9 V of 1 V"),
        (open_rebalance, "amplitude", "closed axis at 0.1 V"),
        (growing, "loops", "Wait for the loops to settle"),
        (hunting, "loops", "the reference by 0.5 Hz"),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_one_fault_fails_one_check(rows: np.ndarray, spoil: Callable[[np.ndarray], None], failed: str, text: str) -> None:
    rows = rows.copy()
    spoil(rows)
    checks = stream(rows)
    assert [name for name, check in checks.items() if not check.passed] == [failed]
    assert text in checks[failed].message


@pytest.mark.parametrize(
    ("command", "text"),
    [
        (None, "has not told its command"),
        (Command("loops_off"), "is in loops_off with excitation none"),
        (Command("ftr_x", Excitation("amplitude_modulation", 0.5, 0.1)), "with excitation amplitude_modulation"),
        (Command("ftr_x", setpoints=Setpoints(0.5)), "1 V of 0.5 V"),
        (Command("ftr_y"), "Oscillator at"),
    ],
)
def test_what_is_commanded_decides_what_is_right(rows: np.ndarray, command: Command | None, text: str) -> None:
    check = stream(rows, command=command)["amplitude"]
    assert not check.passed
    assert text in check.message


def test_an_untold_sample_rate_fails(rows: np.ndarray) -> None:
    assert "has not told its sample_rate_hz" in stream(rows, sample_rate_hz=None)["sample_rate"].message


def test_the_device_must_say_who_it_is_and_be_the_expected_one() -> None:
    assert check_device(DEVICE, "").passed
    assert check_device(DEVICE, DEVICE).passed
    assert "has not told its device_id" in check_device("", DEVICE).message
    wrong = check_device("other-1", DEVICE)
    assert not wrong.passed
    assert "must be device 'ring_15k-0007', but is 'other-1'" in wrong.message


def test_the_store_is_really_written_to_and_left_clean(tmp_path: Path) -> None:
    store = RecordStore(tmp_path / "deep" / "er" / "record.yaml", DEVICE)
    assert check_store(store).passed
    assert list(tmp_path.iterdir()) == [], "the probe is taken away, and no folder is made"


def test_a_store_that_cannot_be_written_fails(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    check = check_store(RecordStore(blocked / "record.yaml", DEVICE))
    assert not check.passed
    assert "could not be saved" in check.message
    assert "set record_url" in check.message


def test_the_record_must_be_readable_and_of_this_device(tmp_path: Path) -> None:
    store = RecordStore(tmp_path / "record.yaml", DEVICE)
    missing = check_record(store)
    assert missing.passed
    assert missing.warning
    assert "Call self_calibrate" in missing.message
    store.save(make_record(DEVICE))
    good = check_record(store)
    assert good.passed
    assert not good.warning
    foreign = check_record(RecordStore(tmp_path / "record.yaml", "other-1"))
    assert not foreign.passed
    assert "must belong to device 'other-1'" in foreign.message
    store.path.write_text("torn")
    assert not check_record(store).passed
