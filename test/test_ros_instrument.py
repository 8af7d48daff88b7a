"""RosInstrument against a gyro that runs well, and against every way a stream goes wrong."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

pytest.importorskip("rclpy")

from rclpy.parameter import Parameter
from ros_helpers import FakeGyro, PlainSimulator, RosSession, wait_for

from gyro_calib.errors import DataError, ExperimentAborted
from gyro_calib.experiments.instrument import Instrument
from gyro_calib.nodes.blocks import block_from_rows
from gyro_calib.nodes.ros_instrument import RosInstrument
from gyro_calib.recording.command import Command, Excitation

pytestmark = pytest.mark.ros


@pytest.fixture
def gyro(ros: RosSession) -> FakeGyro:
    return ros.add(FakeGyro(namespace="/left"))


@pytest.fixture
def instrument(ros: RosSession, gyro: FakeGyro) -> RosInstrument:
    notices: list[str] = []
    instrument = RosInstrument(ros.node(namespace="/left"), stall_s=3.0, notice=notices.append)
    instrument.notices = notices  # type: ignore[attr-defined]
    return instrument


def test_tells_who_the_gyro_is(instrument: RosInstrument, gyro: FakeGyro) -> None:
    assert isinstance(instrument, Instrument)
    assert instrument.device_id == "plain-0001"
    assert instrument.sample_rate_hz == 500.0
    assert instrument.factory == PlainSimulator().factory


def test_records_what_was_commanded_after_the_settling_time(instrument: RosInstrument, gyro: FakeGyro) -> None:
    command = Command("ftr_y", Excitation("amplitude_modulation", 0.7, 0.05))
    gyro.during_segment(1, lambda: setattr(gyro._sim, "temperature_degc", 31.0), after_s=0.75)
    instrument.configure(command)
    recording = instrument.record(2.0, settle_s=1.0, label="side_y")
    assert recording.command == command
    assert (recording.device_id, recording.label, len(recording)) == ("plain-0001", "side_y", 1000)
    np.testing.assert_allclose(np.diff(recording.t), 0.002, atol=1e-9)
    assert set(recording.column("segment")) == {1.0}
    # the temperature stepped before the settling time was over (and not before the command)
    assert set(recording.temperature_degc) == {31.0}
    np.testing.assert_allclose(recording.drive[:, 0].imag.mean(), -0.7 * 2e-3, atol=2e-6)


def test_settling_counts_from_the_first_row_of_the_segment(instrument: RosInstrument, gyro: FakeGyro) -> None:
    starts: list[float] = []
    gyro.when(lambda rows: rows[-1, 1] == 1, lambda: starts.append(gyro._sim.time_s))
    instrument.configure(Command("ftr_x"))
    recording = instrument.record(0.2, settle_s=0.5)
    # the watch fires in the block that has the segment's first row: at most one block of 0.1 s later
    assert starts[0] - 0.1 <= recording.t[0] - 0.5 <= starts[0]


def test_without_settling_a_recording_begins_with_the_segment(instrument: RosInstrument, gyro: FakeGyro) -> None:
    blocks: list[np.ndarray] = []
    gyro.when(lambda rows: bool(blocks.append(rows)), lambda: None)
    instrument.configure(Command("ftr_x"))
    recording = instrument.record(0.2)
    stream = np.concatenate(blocks)
    assert recording.t[0] == stream[stream[:, 1] == 1.0][0, 0]


def test_what_went_by_between_two_recordings_is_not_in_the_second(instrument: RosInstrument, gyro: FakeGyro) -> None:
    instrument.configure(Command("ftr_x"))
    end = instrument.record(0.5).t[-1]
    wait_for(lambda: gyro._sim.time_s > end + 0.3, what="blocks that nobody takes")
    gyro.drop_block()
    wait_for(lambda: not gyro._faults, what="the lost block")
    end = gyro._sim.time_s
    wait_for(lambda: gyro._sim.time_s > end + 0.3, what="later blocks")
    assert instrument.record(0.5).extras["attempts"] == 1


def test_a_second_recording_under_the_same_command_follows_the_first(instrument: RosInstrument, gyro: FakeGyro) -> None:
    instrument.configure(Command("ftr_x"))
    first = instrument.record(0.5, settle_s=0.3)
    second = instrument.record(0.5, settle_s=0.3)
    assert first.t[-1] < second.t[0]
    assert second.column("segment")[0] == 1.0


def test_a_single_lost_block_is_mended_and_told(instrument: RosInstrument, gyro: FakeGyro) -> None:
    gyro.during_segment(1, gyro.drop_block, after_s=0.5)
    instrument.configure(Command("ftr_x"))
    recording = instrument.record(1.0, settle_s=0.1, label="static")
    assert len(recording) == 500
    assert recording.extras["attempts"] == 2
    (notice,) = instrument.notices  # type: ignore[attr-defined]
    assert "'static' is made again (1 of 2)" in notice
    assert "50 samples are missing" in notice


def test_a_gap_while_settling_does_no_harm(instrument: RosInstrument, gyro: FakeGyro) -> None:
    gyro.during_segment(1, lambda: gyro.drop_block(3), after_s=0.2)
    instrument.configure(Command("ftr_x"))
    recording = instrument.record(0.5, settle_s=1.0)
    assert recording.extras["attempts"] == 1
    assert not instrument.notices  # type: ignore[attr-defined]


def test_a_stream_that_keeps_losing_blocks_is_refused(ros: RosSession, gyro: FakeGyro) -> None:
    instrument = RosInstrument(ros.node(namespace="/left"), retries=1)
    gyro.during_segment(1, lambda: [gyro.drop_block() if n % 4 == 0 else gyro._add(lambda rows: [rows]) for n in range(400)], after_s=0.3)
    instrument.configure(Command("ftr_x"))
    with pytest.raises(DataError, match=r"must advance by 0\.002 s a sample, but got a gap .* 50 samples are missing"):
        instrument.record(1.0, settle_s=0.1)


def publish_malformed(gyro: FakeGyro) -> None:
    message = block_from_rows(np.zeros((5, 12)))
    message.layout.dim[0].size = 6
    gyro._channels.publish(message)


def kelvins(gyro: FakeGyro) -> None:
    gyro._sim.temperature_degc = 300.0


def set_behind_its_back(gyro: FakeGyro) -> None:
    gyro._parameters["excitation.index"] = Parameter("excitation.index", value=0.3)


def set_parameter(gyro: FakeGyro) -> None:
    gyro.set_parameters([Parameter("excitation.index", value=0.3)])


@pytest.mark.parametrize(
    ("fault", "error", "text"),
    [
        (lambda gyro: gyro.spoil(9), DataError, r"y_drive_s of the live block must be finite, but got nan at sample 3 \(t = "),
        (lambda gyro: gyro.spoil(0), DataError, r"Column t of the live block must be finite, but got nan"),
        (FakeGyro.repeat_block, DataError, r"a step back of .* a block is repeated or out of order"),
        (publish_malformed, DataError, r"block of 6 samples x 12 must hold 72 numbers, but got 60"),
        (lambda gyro: gyro.become("other-0002"), DataError, r"must stay 'plain-0001' during a run, but is now 'other-0002'"),
        (kelvins, DataError, r"temperature of recording 'static' must be in degC, but got 300 .*subtract 273\.15"),
        (set_behind_its_back, ExperimentAborted, r"must stay in force during a run, but got excitation\.index = 0\.3\. Somebody else"),
        (
            set_parameter,
            ExperimentAborted,
            r"(Segment must stay 1 while recording, but got 2|Command must stay in force) .*Somebody else commands the gyro",
        ),
    ],
)
def test_a_bad_stream_is_refused_with_the_sample_and_the_remedy(
    instrument: RosInstrument, gyro: FakeGyro, fault: Callable[[FakeGyro], None], error: type[Exception], text: str
) -> None:
    gyro.during_segment(1, lambda: fault(gyro), after_s=0.5)
    instrument.configure(Command("ftr_x"))
    with pytest.raises(error, match=text):
        instrument.record(2.5, settle_s=0.1, label="static")
    # and the next run works, on whatever unit is there then
    gyro._sim.temperature_degc = 25.0
    instrument.connect()
    instrument.configure(Command("ftr_x"))
    assert len(instrument.record(0.5)) == 250


def test_blocks_out_of_order_are_never_joined(ros: RosSession, gyro: FakeGyro) -> None:
    instrument = RosInstrument(ros.node(namespace="/left"), retries=0)
    gyro.during_segment(1, gyro.swap_blocks, after_s=0.5)
    instrument.configure(Command("ftr_x"))
    with pytest.raises(DataError, match="must advance by"):
        instrument.record(2.0)


def test_a_stream_that_stops_ends_the_recording(ros: RosSession, gyro: FakeGyro) -> None:
    instrument = RosInstrument(ros.node(namespace="/left"), stall_s=1.0)
    gyro.during_segment(1, gyro.stop_stream, after_s=0.5)
    instrument.configure(Command("ftr_x"))
    with pytest.raises(ExperimentAborted, match=r"Stream /left/channels must deliver blocks, but none came for 1 s"):
        instrument.record(60.0)
    # putting the gyro back does not wait for it once more
    instrument._stall_s = 1000.0
    with pytest.raises(ExperimentAborted, match="must deliver blocks"):
        instrument.configure(Command("ftr_x"))
    gyro.resume_stream()
    instrument.configure(Command("ftr_x"))
    assert len(instrument.record(0.5)) == 250


def test_cancelling_ends_the_recording_but_lets_the_gyro_be_put_back(instrument: RosInstrument, gyro: FakeGyro) -> None:
    cancelled = threading.Event()
    instrument.cancelled = cancelled.is_set
    instrument.configure(Command("ftr_y"))
    gyro.during_segment(1, cancelled.set, after_s=0.5)
    began = time.monotonic()
    with pytest.raises(ExperimentAborted, match="cancelled while recording 'long'"):
        instrument.record(10_000.0, label="long")
    assert time.monotonic() - began < 20.0
    instrument.configure(Command("ftr_x"))
    assert gyro._sim.command == Command("ftr_x")


def test_a_refused_command_says_why_and_changes_nothing(instrument: RosInstrument, gyro: FakeGyro) -> None:
    instrument.connect()
    with pytest.raises(DataError, match=r"must take the command, but refused: .*frequency_hz must be in 0 to 250 Hz"):
        instrument.configure(Command("ftr_x", Excitation("amplitude_modulation", 300.0, 0.1)))
    assert gyro._sim.command == Command()


def test_an_unexpected_unit_is_refused(ros: RosSession, gyro: FakeGyro) -> None:
    instrument = RosInstrument(ros.node(namespace="/left"), expected_device_id="plain-0007")
    with pytest.raises(DataError, match="must be 'plain-0007', but got 'plain-0001'"):
        instrument.connect()


def test_no_gyro_is_said_with_the_remedy(ros: RosSession) -> None:
    instrument = RosInstrument(ros.node(namespace="/empty"), service_s=0.5)
    with pytest.raises(ExperimentAborted, match=r"service /empty/gyro_sim/get_parameters, but nobody does after 0\.5 s"):
        instrument.connect()


def test_a_recording_shorter_than_two_rows_is_refused(instrument: RosInstrument) -> None:
    with pytest.raises(DataError, match="duration_s must be at least"):
        instrument.record(0.001)
