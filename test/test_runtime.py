"""Descriptors and quality of service of the nodes. What ``run_node`` does with signals and refusals: test_gyro_sim_node.py."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy")

from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from gyro_calib.nodes.runtime import LATCHED_QOS, SENSOR_PUB_QOS, SENSOR_SUB_QOS, describe


def test_ranges_are_of_the_parameter_s_type() -> None:
    integer = describe("seed", lo=0, hi=9)
    assert [(r.from_value, r.to_value, r.step) for r in integer.integer_range] == [(0, 9, 1)]
    assert not integer.floating_point_range
    floating = describe("volts [V]", lo=0.0, hi=9, step=0.5, read_only=True)
    assert [(r.from_value, r.to_value, r.step) for r in floating.floating_point_range] == [(0.0, 9.0, 0.5)]
    assert floating.read_only
    plain = describe("text")
    assert plain.description == "text"
    assert not plain.integer_range
    assert not plain.floating_point_range
    assert not plain.read_only


@pytest.mark.parametrize("ends", [{"lo": 1.0}, {"hi": 1.0}, {"lo": 2.0, "hi": 1.0}, {"lo": 0.0, "hi": float("nan")}])
def test_a_range_needs_both_ends_in_order(ends: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="lo and hi must both be given, lo <= hi"):
        describe("volts [V]", **ends)


def test_publishers_offer_what_subscribers_ask_for() -> None:
    assert (SENSOR_PUB_QOS.reliability, SENSOR_PUB_QOS.depth) == (ReliabilityPolicy.RELIABLE, 200)
    assert (SENSOR_SUB_QOS.reliability, SENSOR_SUB_QOS.depth) == (ReliabilityPolicy.BEST_EFFORT, 1000)
    assert LATCHED_QOS.durability == DurabilityPolicy.TRANSIENT_LOCAL
    assert (LATCHED_QOS.reliability, LATCHED_QOS.depth) == (ReliabilityPolicy.RELIABLE, 1)
