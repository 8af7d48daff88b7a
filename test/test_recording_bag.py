"""Bags: a campaign comes back exactly; what `ros2 bag record` makes of a gyro in company is taken apart; every lack has its message."""

from __future__ import annotations

import json

import numpy as np
import pytest
from recording_samples import FACTORY, make_campaign, make_rows, write_raw_bag

from gyro_calib.errors import DataError
from gyro_calib.recording import COLUMNS, Command, Excitation, Setpoints, load_campaign, read_campaign_bag, write_campaign_bag
from gyro_calib.recording.applied_rate import applied_rate, is_turned
from gyro_calib.recording.parameter_log import ParameterChange, command_of, states_of_segments

rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")
STORE = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
BLOCKS, EVENTS = "std_msgs/msg/Float64MultiArray", "rcl_interfaces/msg/ParameterEvent"
SIDE_BAND = Command("ftr_y", Excitation("amplitude_modulation", 0.5, 0.1))


class Recorder:
    """What `ros2 bag record` does, message by message."""

    def __init__(self, path):
        self.path, self.writer, self.connections, self.now_ns = path, None, {}, 5_000_000_000

    def __enter__(self):
        self.writer = rosbag2.Writer(self.path, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP)
        self.writer.__enter__()
        return self

    def __exit__(self, *error):
        return self.writer.__exit__(*error)

    def send(self, topic, kind, message):
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=STORE)
        self.now_ns += 1000
        self.writer.write(self.connections[topic], self.now_ns, STORE.serialize_cdr(message, kind))

    def parameters(self, node, values, *, new=False, deleted=()):
        types = STORE.types
        items = []
        for name, value in values.items():
            kind = {bool: 1, int: 2, float: 3, str: 4, list: 8}[type(value)]
            items.append(
                types["rcl_interfaces/msg/Parameter"](
                    name,
                    types["rcl_interfaces/msg/ParameterValue"](
                        type=kind,
                        bool_value=value if kind == 1 else False,
                        integer_value=value if kind == 2 else 0,
                        double_value=value if kind == 3 else 0.0,
                        string_value=value if kind == 4 else "",
                        **no_arrays() | {"double_array_value": np.array(value if kind == 8 else [], dtype=float)},
                    ),
                )
            )
        stamp = types["builtin_interfaces/msg/Time"](self.now_ns // 10**9, self.now_ns % 10**9)
        gone = [
            types["rcl_interfaces/msg/Parameter"](name, types["rcl_interfaces/msg/ParameterValue"](0, False, 0, 0.0, "", **no_arrays()))
            for name in deleted
        ]
        self.send("/parameter_events", EVENTS, types[EVENTS](stamp, node, items if new else [], [] if new else items, gone))

    def block(self, topic, rows, labels=COLUMNS):
        types, dimension = STORE.types, STORE.types["std_msgs/msg/MultiArrayDimension"]
        layout = types["std_msgs/msg/MultiArrayLayout"](
            [dimension("sample", len(rows), rows.size), dimension(",".join(labels), len(labels), len(labels))], 0
        )
        self.send(topic, BLOCKS, types[BLOCKS](layout, np.ascontiguousarray(rows).reshape(-1)))

    def blocks(self, topic, rows, labels=COLUMNS):
        for part in np.array_split(rows, max(len(rows) // 100, 1)):
            self.block(topic, part, labels)


def no_arrays():
    """Those of a parameter that holds none."""
    numbers = {"integer_array_value": np.empty(0, np.int64), "double_array_value": np.empty(0)}
    return {"byte_array_value": np.empty(0, np.uint8), "bool_array_value": np.empty(0, np.bool_), "string_array_value": []} | numbers


def stream(*modes, n=3000, start_segment=0):
    """Rows of one gyro that runs on while commands take effect: time counts through the segments."""
    return [make_rows(n, mode=mode, segment=start_segment + index, start_s=20.0 + index * n / 1000.0) for index, mode in enumerate(modes)]


def facts(device_id="ring-0001"):
    return {"device_id": device_id, "factory": json.dumps(FACTORY), "sample_rate_hz": 1000.0, "use_sim_time": False, "seed": 7}


def record_run(path, *, told=True, mode_events="whole"):
    """Driver, corrector and a second gyro in one bag; two commands."""
    first, second, third = stream("ftr_x", "ftr_y", "ftr_x")
    with Recorder(path) as bag:
        if told:
            bag.parameters("/left/gyro_sim", facts() | Command().to_parameters(), new=True)
        bag.parameters("/left/imu_corrector", {"mode": "total", "frame_id": "imu"}, new=True)
        bag.parameters("/right/gyro_sim", facts("ring-0002") | Command("ftr_y").to_parameters(), new=True)
        bag.blocks("/left/channels", first)
        bag.blocks("/right/channels", make_rows(2500, mode="ftr_y"))
        if mode_events == "whole":
            bag.parameters("/left/gyro_sim", SIDE_BAND.to_parameters())
        else:
            for name, value in SIDE_BAND.to_parameters().items():
                bag.parameters("/left/gyro_sim", {name: value})
        bag.parameters("/left/imu_corrector", {"mode": "white"})
        bag.blocks("/left/channels", second)
        bag.parameters("/left/gyro_sim", Command().to_parameters())
        bag.blocks("/left/channels", third)
    return first, second, third


def test_round_trip_is_exact(tmp_path):
    campaign = make_campaign(("ftr_x", "ftr_y", "ftr_x"))
    path = write_campaign_bag(tmp_path / "bag", campaign, namespace="a/b", block_rows=64)
    for source in (path, next(path.glob("*.mcap"))):
        back = load_campaign(source)
        assert (back.device_id, back.factory) == (campaign.device_id, campaign.factory)
        for ours, theirs in zip(campaign, back, strict=True):
            np.testing.assert_array_equal(theirs.data, ours.data)
            assert (theirs.command, theirs.label, theirs.extras) == (ours.command, ours.label, ours.extras)
            assert theirs.sample_rate_hz == ours.sample_rate_hz
    with rosbag2.Reader(path) as reader:
        topics = {c.topic: (c.msgtype, c.msgcount) for c in reader.connections}
        temperatures = [STORE.deserialize_cdr(d, c.msgtype).temperature for c, _, d in reader.messages() if c.topic == "/a/b/temperature"]
    assert topics["/a/b/channels"] == (BLOCKS, 3 * 32)
    assert topics["/parameter_events"] == (EVENTS, 3)
    assert temperatures == [25.0] * 6


def test_segments_that_do_not_increase_are_renumbered(tmp_path):
    campaign = make_campaign(("ftr_x", "ftr_y"))
    both = (*campaign.recordings, campaign.recordings[0])
    back = read_campaign_bag(write_campaign_bag(tmp_path / "bag", type(campaign)("ring-0001", both, FACTORY)))
    assert [r.column("segment")[0] for r in back] == [0.0, 1.0, 2.0]
    np.testing.assert_array_equal(back.recordings[2].pick, campaign.recordings[0].pick)


@pytest.mark.parametrize("mode_events", ["whole", "one by one"])
def test_bag_of_a_gyro_in_company_is_taken_apart(tmp_path, mode_events):
    rows = record_run(tmp_path / "bag", mode_events=mode_events)
    campaign = read_campaign_bag(tmp_path / "bag", topic="left/channels", settle_s=0.5)
    assert (campaign.device_id, campaign.factory) == ("ring-0001", FACTORY)
    assert [r.command for r in campaign] == [Command(), SIDE_BAND, Command()]
    assert [r.label for r in campaign] == ["segment_0_ftr_x", "segment_1_ftr_y", "segment_2_ftr_x"]
    for recording, recorded in zip(campaign, rows, strict=True):
        np.testing.assert_array_equal(recording.data, recorded[500:])
    assert load_campaign(tmp_path / "bag", topic="/right/channels").device_id == "ring-0002"


def test_bag_that_began_after_the_driver_needs_the_device_and_skips_the_unknown_segment(tmp_path):
    record_run(tmp_path / "bag", told=False)
    with pytest.raises(DataError, match=r"must tell the device id in /parameter_events, but got none. .* \(device_id=\)"):
        read_campaign_bag(tmp_path / "bag", topic="left/channels")
    campaign = load_campaign(tmp_path / "bag", topic="left/channels", device_id="ring-0001", factory=FACTORY)
    assert [r.command for r in campaign] == [SIDE_BAND, Command()]
    told = read_campaign_bag(tmp_path / "bag", topic="left/channels", device_id="ring-0001", initial=Command())
    assert [r.command for r in told] == [Command(), SIDE_BAND, Command()]


def test_columns_are_found_by_their_labels(tmp_path):
    rows = make_rows(2500)
    labels = [*reversed(COLUMNS), "humidity"]
    with Recorder(tmp_path / "bag") as bag:
        bag.parameters("/gyro_sim", facts() | Command().to_parameters(), new=True)
        bag.block("/matrix", np.eye(2), ("a", "b"))
        bag.blocks("/channels", np.column_stack([rows[:, ::-1], np.zeros(2500)]), labels)
    np.testing.assert_array_equal(read_campaign_bag(tmp_path / "bag", settle_s=0.0).recordings[0].data, rows)


def bad_bag(path, rows, *, parameters=None):
    with Recorder(path) as bag:
        bag.parameters("/g/gyro_sim", facts() | Command().to_parameters() if parameters is None else parameters, new=True)
        bag.blocks("/g/channels", rows)
    return path


def test_lost_and_repeated_blocks_are_named(tmp_path):
    rows = make_rows(3000)
    with pytest.raises(DataError, match=r"gap of 0.101 s before sample 1000 \(t = 2.1 s\): 100 samples are missing"):
        read_campaign_bag(bad_bag(tmp_path / "lost", np.delete(rows, slice(2000, 2100), axis=0)))
    with pytest.raises(DataError, match=r"step back of 0.099 s at sample 1000"):
        read_campaign_bag(bad_bag(tmp_path / "twice", np.insert(rows, 2000, rows[1900:2000], axis=0)))
    back_to_old = np.concatenate(stream("ftr_x", "ftr_x") + stream("ftr_x"))
    with pytest.raises(DataError, match=r"segment must increase through a bag, but got \[0, 1, 0\]"):
        read_campaign_bag(bad_bag(tmp_path / "restarted", back_to_old))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"device_id": "ring-0009"}, "Device id must be the bag's, 'ring-0001', but got 'ring-0009'"),
        ({"topic": "/other"}, r"must be one of the gyros' \(/g/channels\), but got /other"),
        ({"settle_s": 5.0}, "must hold a segment longer than 5 s whose command is known"),
    ],
)
def test_wrong_options_are_refused(tmp_path, options, message):
    with pytest.raises(DataError, match=message):
        read_campaign_bag(bad_bag(tmp_path / "bag", make_rows(3000)), **options)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        (facts() | {"excitation.volts": 0.0}, "whose command is known from /parameter_events, but got none"),
        (facts() | {"factory": "{torn", **Command().to_parameters()}, "factory must be a JSON object, but got '{torn'"),
        (facts() | Command().to_parameters() | {"excitation.colour": "red"}, "must be known names"),
        (facts() | Command(setpoints=Setpoints(amplitude_v=1000.0)).to_parameters(), "near its set point of 1000 V"),
    ],
)
def test_parameters_that_do_not_fit_are_refused(tmp_path, parameters, message):
    with pytest.raises(DataError, match=message):
        read_campaign_bag(bad_bag(tmp_path / "bag", make_rows(3000), parameters=parameters))


@pytest.mark.parametrize(
    ("words", "kind"),
    [("amplitude modulation", "amplitude_modulation"), ("open drive", "drive"), ("shaker", "body"), ("", "none"), ("Drive", "drive")],
)
def test_a_driver_words_its_excitation_as_a_file_does(words, kind):
    command = command_of({"mode": "loops_off", "excitation.kind": words, "setpoint.amplitude_v": 0.0})
    assert command is not None
    assert command.excitation.kind == kind
    assert command.setpoints.amplitude_v == 1.0


def test_words_that_leave_open_what_was_excited_are_refused():
    with pytest.raises(DataError, match=r"kind must be one of .* but got 'something'"):
        command_of({"mode": "ftr_x", "excitation.kind": "something"})
    with pytest.raises(DataError, match=r"amplitude_v must be > 0, but got 0\.0"):
        command_of({"mode": "ftr_x", "setpoint.amplitude_v": 0.0})


def test_no_gyro_and_several_gyros(tmp_path):
    record_run(tmp_path / "two")
    with pytest.raises(DataError, match=r"must hold one .* topic .* but got /left/channels, /right/channels. Choose one by topic="):
        read_campaign_bag(tmp_path / "two")
    with Recorder(tmp_path / "none") as bag:
        bag.parameters("/g/gyro_sim", facts(), new=True)
    with pytest.raises(DataError, match=r"but got none\. Record the topic channels"):
        read_campaign_bag(tmp_path / "none")


def test_torn_bag_is_refused(tmp_path):
    path = write_campaign_bag(tmp_path / "bag", make_campaign(("ftr_x",)))
    storage = next(path.glob("*.mcap"))
    content = storage.read_bytes()
    storage.write_bytes(content[: len(content) // 2])
    with pytest.raises(DataError, match=r"Bag must be readable, but got .* ros2 bag reindex"):
        read_campaign_bag(path)


def test_writer_refuses_what_it_cannot_do(tmp_path):
    campaign = make_campaign(("ftr_x",))
    path = write_campaign_bag(tmp_path / "bag", campaign)
    with pytest.raises(DataError, match="must be new, but got"):
        write_campaign_bag(path, campaign)
    with pytest.raises(DataError, match="block_rows must be >= 1, but got 0"):
        write_campaign_bag(tmp_path / "b", campaign, block_rows=0)
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="must be writable"):
        write_campaign_bag(tmp_path / "file" / "bag", campaign)


def test_events_and_segments_pair_by_order_or_by_time():
    def change(log_ns, **values):
        return ParameterChange(log_ns, "/gyro_sim", values)

    events = [change(0, mode="ftr_x"), change(10, mode="ftr_y"), change(25, mode="loops_off")]
    # the second event was logged after the block it belongs to: the counts still pair them
    late = states_of_segments([(3, 5), (4, 12), (5, 20)], events)
    assert [s["mode"] for s in late] == ["ftr_x", "ftr_y", "loops_off"]
    # a segment was lost: by time
    lost = states_of_segments([(3, 5), (5, 30)], events)
    assert [s["mode"] for s in lost] == ["ftr_x", "loops_off"]
    assert states_of_segments([], events) == []
    assert command_of({"device_id": "d"}) is None


def test_words_of_a_file_are_understood_as_parameters(tmp_path):
    """A driver that calls its precession, ring-down, open drive and rate table as its logger does: each in force while it has them."""
    node, rows = "/gyro/gyro_sim", stream("ftr_x", "ftr_x", "ftr_x", "ftr_x", n=4000)
    turned = {"kind": "steps from t after the start of the record", "t_s": [0.0, 2.5], "deg_s": [0.0, 50.0]}
    with Recorder(tmp_path / "bag") as bag:
        start = {"mode": "whole_angle", "setpoint.amplitude_v": 1.0, "excitation.kind": "none", "virtual_precession_V": 0.5}
        bag.parameters(node, facts() | start, new=True)
        bag.blocks("/gyro/channels", rows[0])
        bag.parameters(node, {"amplitude_control": json.dumps({"start": 24.0, "gain_down": -0.02})}, deleted=["virtual_precession_V"])
        bag.blocks("/gyro/channels", rows[1])
        drive = {
            "mode": "loops_off",
            "excitation.kind": "open_drive",
            "open_drive": json.dumps({"freq": 15010.0, "axis": "y", "volts": 0.5}),
        }
        bag.parameters(node, drive, deleted=["amplitude_control"])
        bag.blocks("/gyro/channels", rows[2])
        bag.parameters(node, {"mode": "whole_angle", "excitation.kind": "none", "applied_rate": json.dumps(turned)}, deleted=["open_drive"])
        bag.blocks("/gyro/channels", rows[3])
    free, ring, driven, table = load_campaign(tmp_path / "bag", check=False)
    assert free.command == Command("whole_angle", setpoints=Setpoints(1.0, virtual_precession_v=0.5))
    assert ring.command == Command("ring_down", setpoints=Setpoints(1.0, amplitude_gain_v_per_v=-0.02))
    assert driven.command == Command("loops_off", Excitation("drive", 15010.0, 0.0, 0.5, "y"))
    assert table.command == Command("whole_angle", setpoints=Setpoints(1.0))
    assert [is_turned(r) for r in (free, ring, driven, table)] == [False, False, False, True]
    # the first second is left out, and the table counts from the first row all the same
    rate, _ = applied_rate(table)
    begins = table.t[np.flatnonzero(rate > 0.0)[0]] - rows[3][0, 0]
    assert begins == pytest.approx(2.5, abs=2e-3)


def test_a_driver_declares_what_it_has_not_as_an_empty_text(tmp_path):
    node, rows = "/gyro/gyro_sim", stream("ftr_x", "ftr_x", n=3000)
    words = ("applied_rate", "open_drive", "body_excitation", "stiffness_control", "amplitude_control", "excitation", "excitation.kind")
    with Recorder(tmp_path / "bag") as bag:
        bag.parameters(node, facts() | {"mode": "ftr_x"} | dict.fromkeys(words, "") | {"duration_s": " "}, new=True)
        bag.blocks("/gyro/channels", rows[0])
        bag.parameters(node, {"applied_rate": json.dumps({"t_s": [0.0], "deg_s": [5.0]}), "device_id": ""})
        bag.blocks("/gyro/channels", rows[1])
    still, turned = load_campaign(tmp_path / "bag", check=False)
    assert still.command == Command("ftr_x")
    assert still.device_id == "ring-0001"
    assert not set(still.extras) & {*words, "duration_s"}
    assert [is_turned(r) for r in (still, turned)] == [False, True]
    assert not applied_rate(still)[0].any()


def test_words_that_are_wrong_are_told_with_their_recording(tmp_path):
    node, (rows,) = "/gyro/gyro_sim", stream("ftr_x", n=3000)
    with Recorder(tmp_path / "bag") as bag:
        bag.parameters(node, facts() | {"mode": "ftr_x", "recording.label": "table_x", "applied_rate": "{t_s"}, new=True)
        bag.blocks("/gyro/channels", rows)
    (table,) = load_campaign(tmp_path / "bag", check=False)
    with pytest.raises(DataError, match=r"Recording 'table_x': Attribute applied_rate must hold t_s and deg_s, but got '{t_s'"):
        applied_rate(table)
    with Recorder(tmp_path / "driven") as bag:
        bag.parameters(node, facts() | {"mode": "loops_off", "open_drive": "{freq"}, new=True)
        bag.blocks("/gyro/channels", rows)
    with pytest.raises(DataError, match=r"Recording 'segment_0': Attribute open_drive must be a JSON object, but got '{freq'"):
        load_campaign(tmp_path / "driven", check=False)
    with Recorder(tmp_path / "modeless") as bag:
        bag.parameters(node, facts() | {"mode": "", "excitation.kind": "none"}, new=True)
        bag.blocks("/gyro/channels", rows)
    with pytest.raises(DataError, match=r"Recording 'segment_0': Mode must be one of .* but got ''"):
        load_campaign(tmp_path / "modeless", check=False)


@pytest.mark.ros
def test_messages_of_rclpy_are_read(tmp_path):
    """Bytes as rclpy serialises them, not as rosbags does."""
    serialization = pytest.importorskip("rclpy.serialization")
    from rcl_interfaces.msg import ParameterEvent
    from rclpy.parameter import Parameter
    from std_msgs.msg import Float64MultiArray, MultiArrayDimension

    rows = make_rows(2500)
    values = facts() | SIDE_BAND.to_parameters() | {"mode": "ftr_x"}
    event = ParameterEvent(node="/g/gyro_sim", new_parameters=[Parameter(k, value=v).to_parameter_msg() for k, v in values.items()])
    block = Float64MultiArray(data=rows.reshape(-1).tolist())
    block.layout.dim = [
        MultiArrayDimension(label="sample", size=2500, stride=2500 * 12),
        MultiArrayDimension(label=",".join(COLUMNS), size=12, stride=12),
    ]
    messages = [
        (topic, kind, serialization.serialize_message(m))
        for topic, kind, m in (("/parameter_events", EVENTS, event), ("/g/channels", BLOCKS, block))
    ]
    write_raw_bag(tmp_path / "bag", messages)
    campaign = read_campaign_bag(tmp_path / "bag", settle_s=0.0)
    np.testing.assert_array_equal(campaign.recordings[0].data, rows)
    assert campaign.recordings[0].command == Command("ftr_x", SIDE_BAND.excitation)
    assert campaign.factory["unit"] == "ring-0001"
