"""imu_corrector as a process of its own, over DDS: a stand-in publishes the raw rate and the record, a consumer reads sensor_msgs/Imu."""

from __future__ import annotations

import math
import signal
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibration_samples import make_record

pytest.importorskip("rclpy")

import rclpy
from corrector_bench import DEVICE, PERIOD_NS, WAIT_S, Bench, StandIn, corrected, numbered, variance
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Imu

from gyro_calib.calibration import RecordStore, dump_record
from gyro_calib.nodes.calibration_messages import calibration_message
from gyro_calib.nodes.runtime import SENSOR_PUB_QOS
from gyro_calib.quantity import Quantity
from gyro_calib.units import DEG_H

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module", autouse=True)
def ros_context(ros_domain: int) -> Iterator[None]:
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    yield
    rclpy.try_shutdown()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    yield bench
    bench.close()


@pytest.fixture(scope="module")
def single(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Bench, StandIn]]:
    """One gyro and its corrector, kept for several tests; each begins with its own record."""
    bench = Bench(tmp_path_factory.mktemp("single"))
    gyro = bench.gyro("/one")
    bench.listen("/one")
    # these tests compute what is claimed by hand, at other temperatures too
    bench.start(
        "/one", accel_max_age_s=1.0, stream_timeout_s=2.0, bias_temperature_sd_rad_s_per_k=0.0, scale_factor_temperature_sd_per_k=0.0
    )
    yield bench, gyro
    bench.close()


def test_from_raw_to_calibrated_when_the_record_comes(single) -> None:
    bench, gyro = single
    first = bench.until_rate(gyro.raw)
    assert first.header.frame_id == "gyro_frame"
    assert first.orientation_covariance[0] == -1.0
    assert first.linear_acceleration_covariance[0] == -1.0
    assert first.angular_velocity_covariance[8] > (1000.0 * DEG_H) ** 2
    bench.until_says("there is no calibration record")
    assert bench.level == 1
    record = make_record(validity={})
    gyro.calibrate(record)
    expected = corrected(gyro.raw, record)
    message = bench.until_rate(expected)
    covariance = np.reshape(message.angular_velocity_covariance, (3, 3))
    np.testing.assert_allclose(covariance, np.diag([1e6, 1e6, variance(record, expected)]), rtol=1e-9)
    stamps = [m.header.stamp.sec * 1_000_000_000 + m.header.stamp.nanosec for m in bench.imu]
    assert set(np.diff(stamps)) <= {PERIOD_NS}  # every sample, in order, with its own stamp
    bench.until(lambda: bench.level == 0 and record.record_id in bench.message, "a verified record must be all right")
    assert bench.facts["device_verified"] == "True"
    assert bench.facts["record_id"] == record.record_id
    (status,) = bench.node.get_publishers_info_by_topic("/one/imu_corrector/status")
    (output,) = bench.node.get_publishers_info_by_topic("/one/imu/data_raw")
    assert status.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL  # whoever joins late learns it
    assert output.qos_profile.reliability == ReliabilityPolicy.RELIABLE
    arrays: list[Any] = []
    subscription = bench.node.create_subscription(DiagnosticArray, "/diagnostics", arrays.append, 10)
    bench.until(lambda: bool(arrays), "/diagnostics must come")
    assert arrays[0].status[0].name == "one/imu_corrector: correction"
    bench.node.destroy_subscription(subscription)


def test_new_record_takes_over_between_two_samples(single) -> None:
    bench, gyro = single
    old, new = numbered(1), numbered(2)
    gyro.calibrate(old)
    bench.until_rate(corrected(gyro.raw, old))
    gyro.calibrate(new)
    rates = {corrected(gyro.raw, r): variance(r, corrected(gyro.raw, r)) for r in (old, new)}
    bench.until_rate(corrected(gyro.raw, new))
    for message in bench.imu:
        z = min(rates, key=lambda r: abs(r - message.angular_velocity.z))
        assert message.angular_velocity.z == pytest.approx(z, abs=1e-15)
        assert message.angular_velocity_covariance[8] == pytest.approx(rates[z], rel=1e-9)


def test_records_that_must_not_be_applied_leave_the_old_one(single) -> None:
    bench, gyro = single
    good = make_record(validity={})
    gyro.calibrate(good)
    bench.until_rate(corrected(gyro.raw, good))
    gyro.calibrate(numbered(5, "ring_15k-0008"))
    bench.until_says("must belong to device 'ring_15k-0007', but got")
    assert bench.level == 2
    message = calibration_message(numbered(6), gyro.node.get_clock().now().to_msg())
    (document,) = [pair for pair in message.status[0].values if pair.key == "record_yaml"]
    document.value = document.value.replace("0.006", "0.007")
    gyro._calibration.publish(message)
    bench.until_says("must have the checksum of its content")
    bench.imu.clear()
    bench.spin(0.3)
    assert {m.angular_velocity.z for m in bench.imu} == {corrected(gyro.raw, good)}
    gyro.calibrate(None)  # a calibration node that starts without a record takes nothing away
    gyro.calibrate(good)
    bench.until(lambda: bench.level == 0, "a good record must clear the error")


def test_enable_switches_the_correction(single) -> None:
    bench, gyro = single
    record = make_record(validity={})
    gyro.calibrate(record)
    calibrated = bench.until_rate(corrected(gyro.raw, record))
    assert bench.call("/one/imu_corrector/enable", False).success
    raw = bench.until_rate(gyro.raw)
    assert raw.angular_velocity_covariance[8] > 100.0 * calibrated.angular_velocity_covariance[8]
    bench.until_says("switched off")
    assert bench.call("/one/imu_corrector/enable", True).success
    bench.until_rate(corrected(gyro.raw, record))


def test_operating_point_and_temperature_decide_what_is_applied(single) -> None:
    bench, gyro = single
    record = make_record(validity={"temperature_min_degc": 20.0, "temperature_max_degc": 30.0})
    gyro.calibrate(record)
    bench.until_rate(corrected(gyro.raw, record))
    gyro.set(mode="ftr_y")
    bench.until_rate(gyro.raw)
    bench.until_says("Mode must be 'ftr_x'")
    gyro.set(**{"mode": "ftr_x", "excitation.kind": "amplitude_modulation"})
    bench.until_says("the gyro is excited")
    gyro.set(**{"excitation.kind": "none"})
    inside = bench.until_rate(corrected(gyro.raw, record)).angular_velocity_covariance[8]
    assert inside == pytest.approx(variance(record, corrected(gyro.raw, record)), rel=1e-9)
    gyro.warm(40.0)
    bench.until_says("Temperature must be 20 to 30 degC, but got 40 degC")
    doubted = replace(
        record,
        bias=Quantity(record.bias.value, 10.0 * record.bias.sd, "rad/s"),
        scale_factor=Quantity(record.scale_factor.value, 10.0 * record.scale_factor.sd, "1"),
        bias_scale_covariance=100.0 * record.bias_scale_covariance,
    )
    outside = bench.until_rate(corrected(gyro.raw, record)).angular_velocity_covariance[8]
    assert outside == pytest.approx(variance(doubted, corrected(gyro.raw, record)), rel=1e-9)
    assert outside > 1.1 * inside
    gyro.warm(25.0)
    bench.until(lambda: bench.level == 0, "the right temperature must clear the warning")


def test_bad_samples_are_not_passed_on(single) -> None:
    bench, gyro = single
    record = make_record(validity={})
    gyro.calibrate(record)
    bench.until_rate(corrected(gyro.raw, record))
    before = int(bench.facts["not_finite"]), int(bench.facts["repeated"]), int(bench.facts["time_restarts"])
    bench.imu.clear()
    gyro.send(123.0)  # the stamp of the last one again
    gyro.stamp_ns += PERIOD_NS
    gyro.send(math.nan)
    gyro.stamp_ns += PERIOD_NS
    gyro.send(math.inf)
    gyro.stamp_ns -= 500_000_000_000  # a simulation starts anew
    after = (before[0] + 2, before[1] + 1, before[2] + 1)
    names = ("not_finite", "repeated", "time_restarts")
    bench.until(lambda: tuple(int(bench.facts[n]) for n in names) == after, f"counts must become {after}")
    assert {m.angular_velocity.z for m in bench.imu} == {corrected(gyro.raw, record)}
    gyro.silent = True
    bench.until_says("No rate on /one/rate_raw for more than 2 s")
    assert bench.level == 2
    gyro.silent = False
    bench.until(lambda: bench.level == 0, "samples must clear the error")


def test_acceleration_goes_along_if_it_is_in_the_same_frame(single) -> None:
    bench, gyro = single
    accel = bench.node.create_publisher(Imu, "/one/imu/accel_in", SENSOR_PUB_QOS)
    sent = Imu()
    sent.linear_acceleration.x, sent.linear_acceleration.z = 0.5, 9.81
    sent.linear_acceleration_covariance[:] = np.arange(9.0)

    def send(frame: str) -> None:
        sent.header.frame_id = frame
        sent.header.stamp.sec, sent.header.stamp.nanosec = divmod(gyro.stamp_ns, 1_000_000_000)
        accel.publish(sent)

    def arrives(frame: str, covariance: float) -> None:
        def arrived() -> bool:
            send(frame)
            return bool(bench.imu) and bench.imu[-1].linear_acceleration_covariance[0] == covariance

        bench.imu.clear()
        bench.until(arrived, f"acceleration of {frame} must give covariance[0] {covariance}")

    arrives("gyro_frame", 0.0)
    assert (bench.imu[-1].linear_acceleration.x, bench.imu[-1].linear_acceleration.z) == (0.5, 9.81)
    assert list(bench.imu[-1].linear_acceleration_covariance) == list(range(9))
    arrives("other_frame", -1.0)
    assert bench.imu[-1].linear_acceleration.z == 0.0
    bench.until_says("Acceleration left out: its frame is 'other_frame'")
    arrives("gyro_frame", 0.0)
    gyro.stamp_ns += 2_000_000_000  # older than allowed now
    bench.until(lambda: bench.imu[-1].linear_acceleration_covariance[0] == -1.0, "old acceleration must not go along")
    bench.node.destroy_publisher(accel)


def test_covariance_is_a_parameter(single) -> None:
    bench, gyro = single
    record = make_record(validity={})
    gyro.calibrate(record)
    rate = corrected(gyro.raw, record)
    bench.until_rate(rate)
    client = AsyncParameterClient(bench.node, "/one/imu_corrector")

    def put(name: str, value: Any) -> Any:
        future = client.set_parameters([Parameter(name, value=value)])
        bench.until(future.done, "parameter service must answer")
        return future.result().results[0]

    refused = put("covariance_mode", "best")
    assert not refused.successful
    assert "must be one of white, total, horizon, but got 'best'" in refused.reason
    assert not put("covariance_horizon_s", -1.0).successful
    white = record.rate_noise_density.value**2 * 50.0 / 1.03**2
    constant = variance(record, rate) - white
    for mode, expected in (("white", white), ("horizon", white + constant * 60.0 * 100.0), ("total", white + constant)):
        assert put("covariance_mode", mode).successful
        # a message that was on its way when the service answered may still come
        wanted = pytest.approx(expected, rel=1e-6)
        bench.until(lambda w=wanted: bench.until_rate(rate).angular_velocity_covariance[8] == w, f"variance of mode {mode} must come")


def test_triad_with_alignment(bench: Bench) -> None:
    """Three gyros in three namespaces, skewed axes, each with its record; then one of them stops."""
    axes = np.array([[1.0, 0.02, 0.0], [0.0, -1.0, 0.05], [0.1, 0.0, 1.0]])
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    omega = np.array([0.2, -0.3, 0.4])
    records = [numbered(i, f"unit-{i}") for i in (1, 2, 3)]
    gyros = [bench.gyro(f"/robot/g{i}", f"unit-{i}") for i in (1, 2, 3)]
    for gyro, record, axis in zip(gyros, records, axes, strict=True):
        gyro.raw = record.scale_factor.value * float(axis @ omega) + record.bias.value
        gyro.calibrate(record)
    gyros[1].stamp_ns += 3_000_000
    gyros[2].stamp_ns -= 2_000_000
    bench.listen("/robot")
    flat = [float(a) for a in axes.ravel()]
    bench.start("/robot", gyros=["g1", "g2", "g3"], axes=flat, frame_id="imu_link", stream_timeout_s=2.0)

    def right() -> bool:
        v = bench.imu[-1].angular_velocity if bench.imu else None
        return v is not None and np.allclose([v.x, v.y, v.z], omega, rtol=0.0, atol=1e-12)

    bench.until(right, f"angular velocity must become {omega}")
    bench.until(lambda: bench.level == 0, "all three must be well")
    bench.imu.clear()
    bench.until(right, f"angular velocity must stay {omega}")
    message = bench.imu[-1]
    assert message.header.frame_id == "imu_link"
    assert (message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec - gyros[0].stamp_ns) % PERIOD_NS == 0
    inverse = np.linalg.inv(axes)
    variances = [variance(r, float(a @ omega)) for r, a in zip(records, axes, strict=True)]
    expected = inverse @ np.diag(variances) @ inverse.T
    np.testing.assert_allclose(np.reshape(message.angular_velocity_covariance, (3, 3)), expected, rtol=1e-4, atol=1e-4 * expected.max())
    assert all(record.record_id in bench.message for record in records)
    assert [bench.facts[f"g{i}/device_id"] for i in (1, 2, 3)] == ["unit-1", "unit-2", "unit-3"]
    gyros[2].silent = True
    bench.until_says("g3: No rate on /robot/g3/rate_raw")
    bench.imu.clear()
    bench.spin(0.2)
    assert bench.imu == []  # an axis that is missing is not an axis at rest


def test_rate_that_is_corrected_already_is_refused(bench: Bench) -> None:
    bench.gyro("/twice", name="imu_corrector_upstream").calibrate(make_record(validity={}))
    bench.listen("/twice")
    bench.start("/twice")
    bench.until_says("/twice/imu_corrector_upstream corrected it already")
    assert bench.level == 2
    bench.spin(0.5)
    assert bench.imu == []


def test_stored_record_of_a_gyro_that_does_not_say_who_it_is(bench: Bench, tmp_path: Path) -> None:
    """A driver without device_id: the named file is applied, and the doubt said; a torn file falls back to the previous version."""
    path = tmp_path / "gyro.yaml"
    path.write_text(dump_record(make_record(validity={})))
    gyro = bench.gyro("/plain", None)
    bench.listen("/plain")
    process = bench.start("/plain", record_urls=[f"file://{path}"])
    bench.until_rate(corrected(gyro.raw, make_record()))
    bench.until_says("Device not verified")
    assert bench.level == 1
    assert bench.facts["device_verified"] == "False"
    process.signal(signal.SIGTERM)
    assert process.wait_exit(WAIT_S) == 0

    store = RecordStore(path, DEVICE)
    store.save(numbered(2))
    path.write_text(path.read_text()[:500])
    bench.start("/plain", record_urls=[f"file://{path}"], device_ids=[DEVICE])
    bench.until_rate(corrected(gyro.raw, make_record()))
    bench.until_says("is used instead")
    assert bench.level == 1


def test_default_store_and_a_gyro_that_is_exchanged(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """The record of the device is found by itself; when another unit takes its place it goes, and with 'hold' so does the output."""
    monkeypatch.setenv("ROS_HOME", str(bench.ros_home))
    RecordStore(None, DEVICE).save(make_record(validity={}))
    gyro = bench.gyro("/swap")
    bench.listen("/swap")
    bench.start("/swap", uncalibrated_policy="hold")
    bench.until_rate(corrected(gyro.raw, make_record()))
    bench.remove(gyro)
    bench.gyro("/swap", "ring_15k-0008")
    bench.until_says("Held: there is no calibration record")
    assert "must belong to device 'ring_15k-0008'" in bench.message
    bench.spin(0.2)
    bench.imu.clear()
    bench.spin(0.3)
    assert bench.imu == []


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"axes": [1.0, 0.0]}, "Parameter axes must have 3 numbers for each of 1 gyros, but got 2"),
        ({"gyros": ["a", "a"]}, "Parameter gyros must name one to three different namespaces"),
        ({"covariance_mode": "best"}, "Parameter covariance_mode must be one of white, total, horizon, but got 'best'"),
    ],
)
def test_parameters_that_contradict_end_the_start(bench: Bench, parameters: dict[str, Any], reason: str) -> None:
    process = bench.start("/bad", **parameters)
    assert process.wait_exit(WAIT_S) == 1
    assert reason in process.output
    assert "Traceback" not in process.output
