"""Rows to live blocks and back."""

from __future__ import annotations

import array

import numpy as np
import pytest

pytest.importorskip("std_msgs")

from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from gyro_calib.errors import DataError
from gyro_calib.nodes.blocks import block_columns, block_from_rows, rows_from_block
from gyro_calib.recording.columns import COLUMNS

ROWS = np.random.default_rng(0).normal(size=(7, 12))


def test_block_has_the_contract_s_layout() -> None:
    message = block_from_rows(ROWS)
    sample, columns = message.layout.dim
    assert (sample.label, sample.size, sample.stride) == ("sample", 7, 84)
    assert (columns.label, columns.size, columns.stride) == (",".join(COLUMNS), 12, 12)
    assert message.layout.data_offset == 0
    assert list(message.data) == ROWS.ravel().tolist()


@pytest.mark.parametrize("rows", [ROWS, ROWS[:0], ROWS[::2], np.asfortranarray(ROWS), ROWS.astype(np.float32)])
def test_round_trip(rows: np.ndarray) -> None:
    np.testing.assert_array_equal(rows_from_block(block_from_rows(rows)), rows)


def test_rows_are_a_read_only_view_of_the_message() -> None:
    message = block_from_rows(ROWS)
    rows = rows_from_block(message)
    message.data[0] = 42.0
    assert rows[0, 0] == 42.0
    with pytest.raises(ValueError, match="read-only"):
        rows[0, 0] = 1.0


def test_columns_are_found_by_name_in_any_order_among_others() -> None:
    names = ("pressure", *reversed(COLUMNS))
    message = block_from_rows(np.column_stack([np.full(7, 9.9), ROWS[:, ::-1]]), names)
    assert block_columns(message) == names
    np.testing.assert_array_equal(rows_from_block(message), ROWS)


def test_trailing_columns_are_left_out() -> None:
    message = block_from_rows(np.column_stack([ROWS, np.full(7, 9.9)]), (*COLUMNS, "pressure"))
    np.testing.assert_array_equal(rows_from_block(message), ROWS)


def test_a_subset_can_be_asked_for() -> None:
    message = block_from_rows(ROWS[:, [0, 11]], ("t", "temperature"))
    np.testing.assert_array_equal(rows_from_block(message, ("temperature",))[:, 0], ROWS[:, 11])


def test_padding_offset_and_absent_strides_are_understood() -> None:
    message = Float64MultiArray()
    message.layout.data_offset = 2
    message.layout.dim = [MultiArrayDimension(label="sample", size=3), MultiArrayDimension(label="t, segment", size=2, stride=3)]
    message.data = array.array("d", [-1, -1, 0, 1, 99, 2, 3, 99, 4, 5, 99])
    np.testing.assert_array_equal(rows_from_block(message, ("t", "segment")), [[0, 1], [2, 3], [4, 5]])
    message.layout.dim[1].stride = 0
    message.layout.data_offset = 0
    message.data = array.array("d", [0, 1, 2, 3, 4, 5])
    np.testing.assert_array_equal(rows_from_block(message, ("t", "segment")), [[0, 1], [2, 3], [4, 5]])


def spoiled(**changes: object) -> Float64MultiArray:
    message = block_from_rows(ROWS)
    for place, value in changes.items():
        dim, field = place.split("_")
        setattr(message.layout.dim[int(dim[1])], field, value)
    return message


@pytest.mark.parametrize(
    ("message", "text"),
    [
        (Float64MultiArray(), "must have 2 dimensions .*, but got 0"),
        (spoiled(d1_label="t,t"), "must be distinct names joined by commas, but got 't,t'"),
        (spoiled(d1_label=""), "must be distinct names"),
        (spoiled(d1_label="t,segment"), "as many columns as names, but got 12 columns and 2 names"),
        (spoiled(d1_stride=11), r"stride \(dim\[1\]\.stride\) must be >= 12, but got 11"),
        (spoiled(d0_size=8), "8 samples x 12 must hold 96 numbers, but got 84"),
        (spoiled(d1_label=",".join(COLUMNS).replace("ref_freq", "f")), r"must have the columns .*, but got no ref_freq\. Add"),
    ],
)
def test_a_contradiction_is_refused(message: Float64MultiArray, text: str) -> None:
    with pytest.raises(DataError, match=text):
        rows_from_block(message)


@pytest.mark.parametrize("rows", [ROWS[:, :11], ROWS[0]])
def test_rows_of_another_shape_are_refused(rows: np.ndarray) -> None:
    with pytest.raises(DataError, match=r"must have shape \(n, 12\)"):
        block_from_rows(rows)
