"""What a bad link, a bad clock and a gyro at its end do to imu_corrector, a process of its own: nothing wrong is ever published."""

from __future__ import annotations

import json
import math
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from calibration_samples import make_record

pytest.importorskip("rclpy")

import rclpy
from corrector_bench import PERIOD_NS, Bench, StandIn, corrected, numbered, variance
from rclpy.signals import SignalHandlerOptions

pytestmark = pytest.mark.ros

RECORD = make_record(validity={})


@pytest.fixture(scope="module", autouse=True)
def ros_context(ros_domain: int) -> Iterator[None]:
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    yield
    rclpy.try_shutdown()


@pytest.fixture(scope="module")
def single(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Bench, StandIn]]:
    """One gyro and its corrector, kept for several tests."""
    bench = Bench(tmp_path_factory.mktemp("faults"))
    gyro = bench.gyro("/one")
    bench.listen("/one")
    bench.start("/one", stream_timeout_s=2.0)
    gyro.calibrate(RECORD)
    yield bench, gyro
    bench.close()


@pytest.fixture
def ready(single: tuple[Bench, StandIn]) -> tuple[Bench, StandIn]:
    """The same, its rate corrected and nothing amiss."""
    bench, gyro = single
    gyro.silent = False
    bench.until_rate(corrected(gyro.raw, RECORD))
    bench.until(lambda: bench.level == 0, "all must be well")
    gyro.silent = True
    bench.spin(0.2)
    bench.imu.clear()
    return bench, gyro


def stamp_ns(message: object) -> int:
    stamp = message.header.stamp  # type: ignore[attr-defined]
    return int(stamp.sec * 1_000_000_000 + stamp.nanosec)


def test_a_burst_after_a_stall_comes_out_complete_and_in_order(ready: tuple[Bench, StandIn]) -> None:
    """The process is stopped (a busy machine, a debugger), 300 samples queue up, it goes on."""
    bench, gyro = ready
    process = bench.processes[0]
    process.signal(signal.SIGSTOP)
    sent = {}
    for k in range(300):
        gyro.stamp_ns += PERIOD_NS
        sent[gyro.stamp_ns] = 1e-3 * k
        gyro.send(1e-3 * k)
        if k % 30 == 0:
            bench.spin(0.05)
    process.signal(signal.SIGCONT)
    bench.until(lambda: len(bench.imu) >= 300, "300 messages must come")
    assert [stamp_ns(m) for m in bench.imu] == list(sent)
    for message in bench.imu:
        assert message.angular_velocity.z == pytest.approx(corrected(sent[stamp_ns(message)], RECORD), abs=1e-15)


def test_a_mangled_stream_comes_out_in_order_and_right(ready: tuple[Bench, StandIn]) -> None:
    """A tenth lost, some repeated, some swapped, some not numbers or beyond all numbers; the covariance is that of the whole stream."""
    bench, gyro = ready
    rng = np.random.default_rng(5)
    start = gyro.stamp_ns
    samples = [(start + (k + 1) * PERIOD_NS, float(rng.uniform(-1.0, 1.0))) for k in range(400)]
    bad = {40: math.nan, 80: math.inf, 120: -math.inf, 160: 1e308, 200: -1e200}
    samples = [(stamp, bad.get(k, 5e-324 if k == 240 else raw)) for k, (stamp, raw) in enumerate(samples)]
    arriving = [sample for sample in samples if rng.random() >= 0.1 or sample[1] in bad.values()]
    for k in range(10, len(arriving) - 10, 37):
        arriving[k], arriving[k + 1] = arriving[k + 1], arriving[k]
        arriving.insert(k + 5, arriving[k + 4])
    before = {name: int(bench.facts[name]) for name in ("not_finite", "saturated", "repeated", "time_restarts")}
    for k, (stamp, raw) in enumerate(arriving):
        gyro.stamp_ns = stamp
        gyro.send(raw)
        if k % 10 == 0:
            bench.spin(0.02)
    good = {stamp: raw for stamp, raw in arriving if abs(raw) < 10.0}
    bench.until(lambda: bool(bench.imu) and stamp_ns(bench.imu[-1]) == max(good), "the last sample must come")
    stamps = [stamp_ns(m) for m in bench.imu]
    assert stamps == sorted(set(stamps))
    assert set(stamps) <= set(good)
    assert len(stamps) > 0.9 * len(good)
    for message in bench.imu:
        rate = corrected(good[stamp_ns(message)], RECORD)
        assert message.angular_velocity.z == pytest.approx(rate, abs=1e-15)
        assert message.angular_velocity_covariance[8] == pytest.approx(variance(RECORD, rate), rel=1e-6)
    gyro.silent = False
    nothing = sum(not math.isfinite(raw) for _, raw in arriving)
    beyond = sum(10.0 < abs(raw) < math.inf for _, raw in arriving)
    bench.until(lambda: int(bench.facts["not_finite"]) - before["not_finite"] == nothing, "what is no number must be counted")
    bench.until(lambda: int(bench.facts["saturated"]) - before["saturated"] == beyond, "what is beyond all numbers must be counted")
    assert int(bench.facts["repeated"]) > before["repeated"]
    assert int(bench.facts["time_restarts"]) == before["time_restarts"]


def test_clock_steps_change_nothing_but_the_stamps(ready: tuple[Bench, StandIn]) -> None:
    """An hour ahead, back again, a year ahead for a single stamp: samples go on with the right covariance."""
    bench, gyro = ready
    rate = corrected(gyro.raw, RECORD)
    restarts = int(bench.facts["time_restarts"])
    hour = 3_600_000_000_000
    wild = 365 * 24 * hour
    for step, restarted in ((hour, 0), (-hour, 1), (wild, 2)):
        gyro.stamp_ns += step
        if step == wild:
            gyro.send(gyro.raw)
            gyro.stamp_ns -= wild
        gyro.silent = False
        bench.imu.clear()
        # past the next tick, when the sample rate is measured again
        bench.until(lambda: len(bench.imu) > 110, "samples must go on")
        gyro.silent = True
        assert {m.angular_velocity.z for m in bench.imu} == {rate}
        covariances = [m.angular_velocity_covariance[8] for m in bench.imu]
        np.testing.assert_allclose(covariances, variance(RECORD, rate), rtol=1e-6)
        bench.until(lambda r=restarted: int(bench.facts["time_restarts"]) == restarts + r, "a step back must be counted")


def test_a_gyro_at_the_end_of_its_range_is_not_passed_on(ready: tuple[Bench, StandIn]) -> None:
    """What its driver says of its converter is its range; a saturated rate is an error and no measurement."""
    bench, gyro = ready
    facts = {"dac_full_scale_V": 5.0, "nominal_scale_factor_v_per_rad_s": {"x": 0.5, "y": -0.5}, "nominal_amplitude_v": 1.0}
    gyro.node.declare_parameter("factory", json.dumps(facts))
    gyro.node.declare_parameter("setpoint.amplitude_v", 1.0)
    mission = gyro.raw
    gyro.raw, gyro.silent = -10.0, False
    bench.until_says("Rate must stay below 9.8 rad/s, the range of the gyro")
    assert bench.level == 2
    bench.spin(0.3)
    bench.imu.clear()
    bench.spin(0.5)
    assert bench.imu == []
    gyro.raw = 9.5
    bench.until_rate(corrected(9.5, RECORD))
    bench.until(lambda: bench.level == 0, "the range must clear the error")
    saturated = int(bench.facts["saturated"])
    # twice the wave, half the range; while the wave settles nobody is told to turn slower, and nothing is passed on either
    gyro.set(**{"setpoint.amplitude_v": 2.0})
    bench.until(lambda: int(bench.facts["saturated"]) > saturated, "what is beyond the new range must be counted")
    bench.imu.clear()
    bench.spin(2.5)
    assert (bench.level, bench.imu) == (0, [])
    bench.until_says("Rate must stay below 4.9 rad/s")
    gyro.set(**{"setpoint.amplitude_v": 1.0})
    gyro.raw = mission
    bench.until_rate(corrected(mission, RECORD))


def test_two_gyros_on_different_clocks_are_said(tmp_path: Path) -> None:
    """Both send, nothing belongs together: silence with a reason; when their clocks agree again, so do they."""
    bench = Bench(tmp_path)
    try:
        records = [numbered(i, f"unit-{i}") for i in (1, 2)]
        gyros = [bench.gyro(f"/pair/g{i}", f"unit-{i}") for i in (1, 2)]
        for gyro, record in zip(gyros, records, strict=True):
            gyro.calibrate(record)
        bench.listen("/pair")
        bench.start("/pair", gyros=["g1", "g2"], axes=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0])
        bench.until(lambda: bool(bench.imu) and bench.level == 0, "both must be joined")
        for step in (7_000_000_000, -7_000_000_000):
            gyros[1].stamp_ns += step
            if step > 0:
                bench.until_says("Stamps of the gyros must be within 0.005 s of each other, but none are")
                assert bench.level == 2
            bench.imu.clear()
            if step < 0:
                bench.until(lambda: len(bench.imu) > 50 and bench.level == 0, "both must be joined again")
    finally:
        bench.close()
