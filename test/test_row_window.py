"""Rows of one recording picked from a stream, and the stream itself."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from gyro_calib.errors import DataError, ExperimentAborted
from gyro_calib.nodes.row_window import LostRows, RowWindow
from gyro_calib.nodes.stream import BlockStream

RATE_HZ = 100.0


def rows(first: int, count: int, segment: int = 1) -> np.ndarray:
    data = np.random.default_rng(first).normal(size=(count, 12))
    data[:, 0] = np.arange(first, first + count) / RATE_HZ
    data[:, 1] = segment
    return data


def window(wanted: int = 20, settle_s: float = 0.0, first_s: float | None = None) -> RowWindow:
    return RowWindow(1, wanted, RATE_HZ, settle_s, first_s)


@pytest.mark.parametrize("size", [1, 3, 7, 40])
def test_the_window_starts_after_settling_from_the_segment_s_first_row(size: int) -> None:
    stream = np.concatenate([rows(0, 13, 0), rows(13, 60)])
    picked = window(20, settle_s=0.1)
    for at in range(0, len(stream), size):
        picked.add(stream[at : at + size])
    assert picked.full
    assert picked.fraction == 1.0
    assert picked.first_s == 0.13
    np.testing.assert_array_equal(picked.rows(), stream[23:43])


def test_settling_counts_from_a_first_row_seen_before() -> None:
    picked = window(5, settle_s=0.5, first_s=0.1)
    picked.add(rows(50, 30))
    np.testing.assert_allclose(picked.rows()[:, 0], 0.6 + np.arange(5) / RATE_HZ)


def test_a_gap_before_the_recording_does_no_harm() -> None:
    picked = window(10, settle_s=0.2)
    for block in (rows(0, 5), rows(15, 5), rows(20, 30)):
        picked.add(block)
    assert picked.rows()[0, 0] == 0.2


def test_lost_rows_between_blocks_and_inside_one() -> None:
    picked = window(50)
    picked.add(rows(0, 10))
    with pytest.raises(LostRows, match="5 samples are missing"):
        picked.add(rows(15, 10))
    picked = window(50)
    with pytest.raises(LostRows, match="3 samples are missing"):
        picked.add(np.concatenate([rows(0, 5), rows(8, 5)]))


@pytest.mark.parametrize("settle_s", [0.0, 0.3])
def test_rows_that_come_again_are_refused_also_while_settling(settle_s: float) -> None:
    picked = window(50, settle_s)
    picked.add(rows(0, 10))
    with pytest.raises(DataError, match="repeated or out of order") as refusal:
        picked.add(rows(0, 10))
    assert not isinstance(refusal.value, LostRows)


@pytest.mark.parametrize("column", [0, 1, 2, 11])
@pytest.mark.parametrize("first", [0, 30])
def test_a_number_that_is_not_finite_is_refused(column: int, first: int) -> None:
    picked = window(50)
    if first:
        picked.add(rows(0, first))
    bad = rows(first, 10)
    bad[4, column] = np.nan
    with pytest.raises(DataError, match="must be finite, but got nan at sample 4") as refusal:
        picked.add(bad)
    assert not isinstance(refusal.value, LostRows)


def test_a_gap_beside_worse_is_not_mended_by_recording_again() -> None:
    bad = np.concatenate([rows(0, 5), rows(8, 5)])
    bad[2, 5] = np.nan
    with pytest.raises(DataError) as refusal:
        window(50).add(bad)
    assert not isinstance(refusal.value, LostRows)
    bad = np.concatenate([rows(0, 5), rows(8, 5), rows(8, 5)])
    with pytest.raises(DataError) as refusal:
        window(50).add(bad)
    assert not isinstance(refusal.value, LostRows)


def test_a_segment_that_ends_too_early_says_that_somebody_else_commands() -> None:
    picked = window(20)
    picked.add(rows(0, 10))
    with pytest.raises(ExperimentAborted, match=r"Segment must stay 1 while recording, but got 2 at t = 0\.1500 s"):
        picked.add(np.concatenate([rows(10, 5), rows(15, 5, 2)]))


def test_a_segment_that_ends_with_the_recording_is_complete() -> None:
    picked = window(15)
    picked.add(np.concatenate([rows(0, 15), rows(15, 5, 2)]))
    assert len(picked.rows()) == 15


def test_rows_after_a_full_window_are_nobody_s_concern() -> None:
    picked = window(10)
    picked.add(rows(0, 10))
    picked.add(rows(0, 10))
    assert len(picked.rows()) == 10


def test_the_stream_gives_blocks_in_order_and_forgets_the_oldest_when_full() -> None:
    stream = BlockStream(max_rows=25)
    for at in range(0, 50, 10):
        stream.put(rows(at, 10))
    assert [block[0, 0] for block in stream.take(0.0)] == [0.3, 0.4]
    assert stream.take(0.0) == []
    assert stream.latest is not None
    assert stream.latest[0] == 0.49


def test_a_block_larger_than_the_queue_is_still_given() -> None:
    stream = BlockStream(max_rows=5)
    stream.put(rows(0, 10))
    assert len(stream.take(0.0)[0]) == 10


def test_errors_and_empty_blocks_do_not_fill_the_memory() -> None:
    stream = BlockStream(max_rows=5)
    for _ in range(100):
        stream.put(DataError("bad"))
        stream.put(np.zeros((0, 12)))
    count = 0
    while True:
        try:
            blocks = stream.take(0.0)
        except DataError:
            count += 1
            continue
        if not blocks:
            break
        count += len(blocks)
    assert count == 5


def test_an_unusable_block_is_raised_in_its_place() -> None:
    stream = BlockStream()
    for block in (rows(0, 1), DataError("torn"), rows(1, 1)):
        stream.put(block)
    assert len(stream.take(0.0)) == 1
    with pytest.raises(DataError, match="torn"):
        stream.take(0.0)
    assert len(stream.take(0.0)) == 1


def test_taking_waits_for_another_thread() -> None:
    stream = BlockStream()
    timer = threading.Timer(0.05, stream.put, [rows(0, 1)])
    timer.start()
    assert len(stream.take(30.0)) == 1
    timer.join()


def test_silence_counts_from_the_last_block_or_from_when_one_began_to_listen() -> None:
    now = [100.0]
    stream = BlockStream(now=lambda: now[0])
    assert stream.silence_s(98.0) == 2.0
    stream.put(rows(0, 1))
    now[0] = 107.0
    assert stream.silence_s(98.0) == 7.0
    assert stream.silence_s(106.0) == 1.0
