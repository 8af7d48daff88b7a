"""A stream between gyro and recorder that loses, repeats and reorders blocks: what is recorded is what the gyro sent, or nothing is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from recording_samples import FACTORY, make_rows

from gyro_calib.errors import DataError, GyroCalibError
from gyro_calib.nodes.row_window import LostRows, RowWindow
from gyro_calib.nodes.stamps import SampleClock
from gyro_calib.recording import COLUMNS, Command, Recording
from gyro_calib.recording.integrity import validate

FloatArray = NDArray[np.float64]
RATE_HZ, BLOCK, WANTED, SETTLE_S = 1000.0, 25, 400, 0.1
#: a segment before, which settles into the one that is recorded
SENT = np.concatenate([make_rows(200, segment=0), make_rows(800, segment=1, start_s=0.2)])
FIRST = 200 + round(SETTLE_S * RATE_HZ)
EXPECTED = SENT[FIRST : FIRST + WANTED]
BLOCKS = [SENT[i : i + BLOCK] for i in range(0, len(SENT), BLOCK)]


def recorded(blocks: Sequence[FloatArray]) -> FloatArray | None:
    """Rows of a recording, checked as the live instrument checks them; None when there are not enough."""
    window = RowWindow(1, WANTED, RATE_HZ, SETTLE_S, first_s=0.2)
    for block in blocks:
        window.add(block)
        if window.full:
            validate(Recording("ring-0001", window.rows(), Command(), RATE_HZ, "static"), FACTORY)
            return window.rows()
    return None


def as_sent(rows: FloatArray) -> bool:
    """Whether the rows are a whole stretch of what the gyro sent, of the right segment and after its settling time."""
    start = int(np.searchsorted(SENT[:, 0], rows[0, 0] - 0.5 / RATE_HZ))
    return start >= FIRST and np.array_equal(rows, SENT[start : start + WANTED])


FAULTS = st.lists(
    st.tuples(st.sampled_from(["lose", "repeat", "swap", "delay", "halve", "value"]), st.integers(0, len(BLOCKS) - 2)), max_size=4
)


def spoil(faults: list[tuple[str, int]], value: float, column: int) -> list[FloatArray]:
    """The blocks as they arrive."""
    blocks = list(BLOCKS)
    for fault, at in faults:
        if at + 1 >= len(blocks):
            continue
        if fault == "lose":
            del blocks[at]
        elif fault == "repeat":
            blocks.insert(at, blocks[at])
        elif fault == "swap":
            blocks[at], blocks[at + 1] = blocks[at + 1], blocks[at]
        elif fault == "delay":
            blocks.insert(min(at + 5, len(blocks) - 1), blocks.pop(at))
        elif fault == "halve":
            blocks[at] = blocks[at][::2]
        else:
            blocks[at] = blocks[at].copy()
            blocks[at][3, column] = value
    return blocks


@settings(max_examples=300, deadline=None, derandomize=True)
@given(
    faults=FAULTS,
    value=st.sampled_from([np.nan, np.inf, -np.inf, 1e308, 2.6, -2.6]),
    column=st.sampled_from(range(2, 6)),
)
def test_a_recording_is_exact_or_refused(faults: list[tuple[str, int]], value: float, column: int) -> None:
    try:
        rows = recorded(spoil(faults, value, column))
    except GyroCalibError as error:
        message = str(error)
    else:
        assert rows is None or as_sent(rows)
        return
    assert len(message) > 20


@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10_000))
def test_ten_percent_of_the_blocks_lost_never_goes_unnoticed(seed: int) -> None:
    kept = np.random.default_rng(seed).random(len(BLOCKS)) >= 0.1
    blocks = [block for block, keep in zip(BLOCKS, kept, strict=True) if keep]
    try:
        rows = recorded(blocks)
    except LostRows as error:
        message = str(error)
    else:
        assert rows is None or as_sent(rows)
        return
    assert "samples are missing" in message


def test_an_unspoiled_stream_is_recorded_from_the_settling_time_on() -> None:
    rows = recorded(BLOCKS)
    assert rows is not None
    assert np.array_equal(rows, EXPECTED)


def test_denormals_are_numbers() -> None:
    rows = EXPECTED.copy()
    rows[5, COLUMNS.index("y_drive_c")] = 5e-324
    validate(Recording("ring-0001", rows, Command(), RATE_HZ, "static"), FACTORY)


@pytest.mark.parametrize(
    ("column", "value", "reason"),
    [
        ("x_pick_c", 2.5, "x_pick .*must stay below its full scale of 2.5 V"),
        ("y_drive_s", -5.0, "y_drive .*must stay below its full scale of 5 V"),
    ],
)
def test_a_saturated_channel_is_refused_with_the_sample(column: str, value: float, reason: str) -> None:
    rows = EXPECTED.copy()
    rows[100:130, COLUMNS.index(column)] = value
    with pytest.raises(DataError, match=f"{reason}.*sample 100"):
        validate(Recording("ring-0001", rows, Command(), RATE_HZ, "static"), FACTORY)


# -- stamps of the rate ----------------------------------------------------------------------------------------------------------------

MS = 1_000_000


def rate_of(stamps: Sequence[int]) -> float:
    clock = SampleClock()
    for stamp in stamps:
        clock.accept(stamp)
    found = clock.rate_hz()
    assert found is not None
    return found


def test_lost_samples_and_jumps_of_time_do_not_make_the_noise_smaller() -> None:
    """The variance of a sample goes with the rate at which the gyro samples, however many arrive and whatever the clock does meanwhile."""
    rng = np.random.default_rng(3)
    stamps = [k * MS for k in range(1000)]
    tenth_lost = [stamp for stamp in stamps if rng.random() >= 0.1]
    assert rate_of(stamps) == pytest.approx(1000.0)
    assert rate_of(tenth_lost) == pytest.approx(1000.0)
    assert rate_of([*stamps[:500], *(stamp + 3_600_000 * MS for stamp in stamps[500:])]) == pytest.approx(1000.0)
    assert rate_of([*stamps[:500], *(stamp + 86_400_000 * MS for stamp in stamps[:10]), *stamps[500:]]) == pytest.approx(1000.0)
    # a clock that ticks in whole milliseconds at 300 Hz
    assert rate_of([round(k / 0.3) * MS for k in range(3000)]) == pytest.approx(300.0, rel=1e-3)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(order=st.permutations(range(40)), again=st.lists(st.integers(0, 39), max_size=10))
def test_reordered_and_repeated_samples_come_out_once_and_in_order(order: list[int], again: list[int]) -> None:
    clock = SampleClock()
    accepted: list[int] = [k for k in [*order, *again] if clock.accept(k * MS)]
    assert accepted == sorted(set(accepted))
    assert clock.repeated == 40 + len(again) - len(accepted)
    assert clock.jumps == 0
