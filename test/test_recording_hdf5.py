"""HDF5 campaigns: our own come back exactly, a stranger's are understood, junk is refused with a reason."""

from __future__ import annotations

import json

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recording_samples import FACTORY, make_campaign, make_rows

from gyro_calib.errors import DataError
from gyro_calib.recording import COLUMNS, Campaign, Command, Excitation, Recording, Setpoints, read_campaign_h5, write_campaign_h5
from gyro_calib.recording.applied_rate import is_turned


def write_plainly(path, rows=None, *, attributes=None, root=None, names=None, skip=(), group="recording_000", dtype="f8"):
    """What a script without this package writes: one group, one dataset per column."""
    rows = make_rows() if rows is None else rows
    with h5py.File(path, "w") as file:
        file.attrs.update({"device_id": "ring-0001", "factory": json.dumps(FACTORY), **(root or {})})
        target = file if group is None else file.create_group(group)
        target.attrs.update({"mode": "ftr_x"} if attributes is None else attributes)
        for index, column in enumerate(COLUMNS):
            if column not in skip:
                target[(names or {}).get(column, column)] = rows[:, index].astype("f8" if column == "t" else dtype)
    return path


def test_round_trip_is_exact(tmp_path):
    commands = (
        Command("ftr_x", Excitation("amplitude_modulation", 0.5, 0.1), Setpoints(amplitude_v=1.0), (1.0, 0.01, -0.02, 0.99)),
        Command("ftr_y", Excitation("frequency_modulation", 1.5, 0.02)),
        Command("loops_off", Excitation("drive", 14921.0, volts=2.0, axis="y")),
        Command("loops_off", Excitation("body", 14941.0, volts=4.0, axis="both")),
        Command("whole_angle", setpoints=Setpoints(virtual_precession_v=-2.4)),
        Command("stiffness", setpoints=Setpoints(stiffness_v_per_v=0.5)),
        Command("ring_up", setpoints=Setpoints(amplitude_gain_v_per_v=1.8)),
    )
    extras = {"applied_rate": {"t_s": [0.0, 2.0], "deg_s": [0.0, 50.0]}, "note": "späť", "count": 3, "flag": True, "nothing": None}
    recordings = tuple(
        Recording("ring-0001", make_rows(mode=c.mode, segment=i), c, 1000.0, f"r{i}", extras, {"t": np.arange(3.0), "x_pick": np.ones(3)})
        for i, c in enumerate(commands)
    )
    back = read_campaign_h5(write_campaign_h5(tmp_path / "c.h5", Campaign("ring-0001", recordings, FACTORY)))
    assert (back.device_id, back.factory, len(back)) == ("ring-0001", FACTORY, len(commands))
    for ours, theirs in zip(recordings, back, strict=True):
        np.testing.assert_array_equal(theirs.data, ours.data)
        assert (theirs.command, theirs.label, theirs.sample_rate_hz) == (ours.command, ours.label, ours.sample_rate_hz)
        assert {name: theirs.extras[name] for name in extras} == extras
        assert ours.raw is not None
        assert theirs.raw is not None
        np.testing.assert_array_equal(theirs.raw["x_pick"], ours.raw["x_pick"])
    again = read_campaign_h5(write_campaign_h5(tmp_path / "again.h5", back))
    assert [r.extras for r in again] == [r.extras for r in back]


def test_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = write_campaign_h5(tmp_path / "c.h5", make_campaign())
    whole, create, calls = path.read_bytes(), h5py.Group.create_dataset, []

    def full_disk(group, name, **options):
        calls.append(name)
        if len(calls) == 20:
            raise OSError("No space left on device")
        return create(group, name, **options)

    monkeypatch.setattr(h5py.Group, "create_dataset", full_disk)
    with pytest.raises(DataError, match=r"must be writable, but got No space left .* Choose another"):
        write_campaign_h5(path, make_campaign())
    assert len(calls) == 20
    assert path.read_bytes() == whole
    assert [p.name for p in tmp_path.iterdir()] == ["c.h5"]
    with pytest.raises(DataError, match="must be writable"):
        write_campaign_h5(tmp_path / "c.h5" / "below.h5", make_campaign())


def test_float32_envelopes_keep_their_precision(tmp_path):
    campaign = make_campaign()
    back = read_campaign_h5(write_campaign_h5(tmp_path / "c.h5", campaign, dtype="float32"))
    np.testing.assert_allclose(back.recordings[0].pick, campaign.recordings[0].pick, rtol=1e-7, atol=1e-12)
    np.testing.assert_array_equal(back.recordings[0].t, campaign.recordings[0].t)


@pytest.mark.parametrize("group", ["recording_000", None, "campaign/run 1"])
def test_groups_may_stand_anywhere(tmp_path, group):
    campaign = read_campaign_h5(write_plainly(tmp_path / "c.h5", group=group))
    np.testing.assert_array_equal(campaign.recordings[0].data, make_rows())


def test_recordings_come_in_the_order_of_their_numbers(tmp_path):
    with h5py.File(tmp_path / "c.h5", "w") as file:
        file.attrs["device_id"] = "d"
        for number in (10, 2, 1):
            group = file.create_group(f"run{number}")
            group.attrs["mode"] = "ftr_x"
            for index, column in enumerate(COLUMNS):
                group[column] = make_rows(segment=number)[:, index]
    assert [r.label for r in read_campaign_h5(tmp_path / "c.h5")] == ["run1", "run2", "run10"]


def test_with_loops_off_no_amplitude_is_held(tmp_path):
    open_drive = {"mode": "loops_off", "open_drive": '{"freq": 15020.0, "axis": "x", "volts": 2.0}', "amplitude_set_V": 0.0}
    recording = read_campaign_h5(write_plainly(tmp_path / "off.h5", attributes=open_drive)).recordings[0]
    assert recording.command.excitation.volts == 2.0
    with pytest.raises(DataError, match=r"amplitude_v must be > 0, but got 0\.0"):
        read_campaign_h5(write_plainly(tmp_path / "on.h5", attributes={"mode": "ftr_x", "amplitude_set_V": 0.0}))


@pytest.mark.parametrize(
    ("mode", "control", "expected", "gain"),
    [
        ("whole_angle", {"gain_down": -2.0}, "ring_down", -2.0),
        ("whole_angle", {"gain_up": 2.0}, "ring_up", 2.0),
        ("ring_up", {"start": 1.0, "gain_up": 2.0}, "ring_up", 2.0),
        ("ring_down", {"gain_down": -2.0, "gain_up": 2.0}, "ring_down", -2.0),
    ],
)
def test_a_wave_driven_up_is_not_one_driven_down(tmp_path, mode, control, expected, gain):
    attributes = {"mode": mode, "amplitude_set_V": 1.0, "amplitude_control": json.dumps(control)}
    command = read_campaign_h5(write_plainly(tmp_path / "c.h5", attributes=attributes)).recordings[0].command
    assert command.mode == expected
    assert command.setpoints.amplitude_gain_v_per_v == gain


def test_other_spellings_and_types_are_understood(tmp_path):
    spellings = {"t": "Time", "x_pick_c": "X_Pick_C", "y_pick_s": "yPickS", "x_drive_c": "x drive c", "y_pick_c": "y_pickoff_c"}
    spellings |= {"ref_freq": "Reference frequency (Hz)", "temperature": "TEMP_C"}
    attributes = {
        "mode": np.bytes_("FTR-X"),
        "label": b"static",
        "amplitude_set_V": np.float32(1.0),
        "compensation": np.array([[1.0, 0.1], [0.0, 1.0]]),
        "excitation": b'{"kind": "amplitude modulation of the oscillator position signal", "m": 0.1, "nu_hz": 0.5}',
        "operator": "[not json",
        "channels": np.array([b"a", b"b"]),
    }
    path = write_plainly(tmp_path / "c.h5", names=spellings, attributes=attributes, skip=("segment",), dtype="f4")
    recording = read_campaign_h5(path).recordings[0]
    assert recording.command == Command("ftr_x", Excitation("amplitude_modulation", 0.5, 0.1), compensation=(1.0, 0.1, 0.0, 1.0))
    assert recording.sample_rate_hz == 1000.0
    assert recording.label == "static"
    assert recording.extras["operator"] == "[not json"
    assert recording.extras["channels"] == ["a", "b"]
    assert recording.extras["excitation"]["m"] == 0.1
    np.testing.assert_allclose(recording.data, make_rows(), atol=1e-3)
    np.testing.assert_array_equal(recording.column("segment"), 0.0)


def test_mode_and_set_point_may_be_left_to_the_data(tmp_path):
    rows = make_rows(mode="ftr_y")
    rows[:, 2:6] *= 0.6
    recording = read_campaign_h5(write_plainly(tmp_path / "c.h5", rows, attributes={"oscillator_axis": "Y"})).recordings[0]
    assert recording.command.mode == "ftr_y"
    assert recording.command.setpoints.amplitude_v == pytest.approx(0.6, rel=1e-4)


def test_an_empty_attribute_says_nothing(tmp_path):
    words = dict.fromkeys(("applied_rate", "excitation", "open_drive", "compensation", "stiffness_control", "amplitude_set_V", "label"), "")
    path = write_plainly(tmp_path / "c.h5", attributes={"mode": "ftr_x", **words, "sample_rate_hz": b" "}, root={"factory": ""})
    (recording,) = (campaign := read_campaign_h5(path, check=False))
    assert campaign.factory == {}
    assert recording.command.excitation == Excitation()
    assert recording.label == "recording_000"
    assert not is_turned(recording)
    assert set(recording.extras) == {"mode"}


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"mode": "foo"}, "Attribute mode must be one of"),
        ({"mode": "ftr_x", "excitation": "{m:0.1"}, "Attribute excitation must be a JSON object"),
        ({"mode": "ftr_x", "compensation": "[1, 2, 3]"}, "Attribute compensation must be a 2x2 matrix"),
    ],
)
def test_an_attribute_that_is_wrong_is_told_with_its_recording(tmp_path, attributes, message):
    path = write_plainly(tmp_path / "c.h5", attributes={"label": "side_x", **attributes})
    with pytest.raises(DataError, match=f"c.h5: Recording 'side_x': {message}"):
        read_campaign_h5(path)


def test_constant_temperature_may_be_an_attribute(tmp_path):
    path = write_plainly(tmp_path / "c.h5", attributes={"mode": "ftr_x", "temperature_degC": 31.5}, skip=("temperature",))
    np.testing.assert_array_equal(read_campaign_h5(path).recordings[0].temperature_degc, 31.5)


def test_float32_time_is_put_back_on_its_grid(tmp_path):
    rows = make_rows(start_s=1000.0)
    with h5py.File(write_plainly(tmp_path / "c.h5", rows), "r+") as file:
        del file["recording_000/t"]
        file["recording_000/t"] = rows[:, 0].astype("f4")
        file["recording_000"].attrs["sample_rate_hz"] = 1000.0
    assert np.ptp(np.diff(rows[:, 0].astype("f4"))) > 1e-5
    back = read_campaign_h5(tmp_path / "c.h5").recordings[0].t
    np.testing.assert_allclose(np.diff(back), 1e-3, rtol=1e-9)
    assert abs(back[0] - 1000.0) < 1e-4


BAD_FILES = {
    "other format": ({"root": {"format": "other"}}, "format must be 'gyro_calib recording', but got 'other'"),
    "newer version": ({"root": {"format_version": 2}}, "format_version must be at most 1, but got 2. Update gyro_calib"),
    "no device": ({"root": {"device_id": "", "factory": "{}"}}, "device_id must name the unit"),
    "factory": ({"root": {"factory": "[1]"}}, "factory must be a JSON object, but got"),
    "no mode": ({"attributes": {}}, "mode must be one of .* but got None"),
    "unknown mode": ({"attributes": {"mode": "spin"}}, "but got 'spin'"),
    "axis against mode": ({"attributes": {"mode": "ftr_x", "oscillator_axis": "y"}}, "oscillator_axis must agree with mode 'ftr_x'"),
    "excitation": ({"attributes": {"mode": "ftr_x", "excitation": '{"kind": "thump"}'}}, "kind must be one of .* but got 'thump'"),
    "excitation text": ({"attributes": {"mode": "ftr_x", "excitation": "{torn"}}, "excitation must be a JSON object, but got '{torn'"),
    "number": ({"attributes": {"mode": "ftr_x", "amplitude_set_V": "one"}}, "amplitude_set_V must be a number, but got 'one'"),
    "compensation": ({"attributes": {"mode": "ftr_x", "compensation": "[1, 2]"}}, r"must be a 2x2 matrix, but got \[1, 2\]"),
    "missing columns": ({"skip": ("x_pick_c", "ref_freq")}, r"must have the columns x_pick_c \[V\], ref_freq \[Hz\], but got only"),
    "no temperature": ({"skip": ("temperature",)}, r"must have the column temperature \[degC\]"),
    "twice": ({"names": {"temperature": "temp", "segment": "temp_c"}}, "temperature of .* must stand once, but got 'temp"),
    "rate": ({"attributes": {"mode": "ftr_x", "sample_rate_hz": -1.0}}, "sample_rate_hz of .* must be > 0, but got -1"),
    "stated rate": ({"attributes": {"mode": "ftr_x", "sample_rate_hz": 500.0}}, "500 Hz stated and 1000 Hz in t"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_file_is_refused_with_its_name_and_remedy(tmp_path, name):
    spoil, message = BAD_FILES[name]
    path = write_plainly(tmp_path / "c.h5", **spoil)
    with pytest.raises(DataError, match=message) as caught:
        read_campaign_h5(path)
    assert str(caught.value).startswith(str(path))


def test_milliseconds_without_a_stated_rate_are_noticed(tmp_path):
    rows = make_rows()
    rows[:, 0] *= 1000.0
    with pytest.raises(DataError, match=r"at least 10 Hz, but got 1 Hz .* Give t in seconds"):
        read_campaign_h5(write_plainly(tmp_path / "c.h5", rows))


def test_unequal_wrong_and_coarse_columns_are_refused(tmp_path):
    def spoil(name, values, **attributes):
        with h5py.File(write_plainly(tmp_path / "c.h5"), "r+") as file:
            file["recording_000"].attrs.update(attributes)
            del file[f"recording_000/{name}"]
            file[f"recording_000/{name}"] = values
        return tmp_path / "c.h5"

    with pytest.raises(DataError, match=r"must be of one length, but got .*'y_pick_c': 7"):
        read_campaign_h5(spoil("y_pick_c", np.zeros(7)))
    with pytest.raises(DataError, match=r"y_pick_c of .* must hold numbers"):
        read_campaign_h5(spoil("y_pick_c", [b"a"] * 2000))
    with pytest.raises(DataError, match=r"must be one-dimensional, but got shape \(1000, 2\)"):
        read_campaign_h5(spoil("y_pick_c", np.zeros((1000, 2))))
    with pytest.raises(DataError, match="float32 with a resolution of"):
        read_campaign_h5(spoil("t", (1e5 + make_rows()[:, 0]).astype("f4"), sample_rate_hz=1000.0))
    with pytest.raises(DataError, match=r"must increase, but got steps of 0 s. State sample_rate_hz, or write t as float64"):
        read_campaign_h5(spoil("t", (1e5 + make_rows()[:, 0]).astype("f4")))


def test_damage_to_one_recording_can_be_read_unchecked(tmp_path):
    rows = make_rows()
    rows[5, 3] = np.nan
    path = write_plainly(tmp_path / "c.h5", rows)
    with pytest.raises(DataError, match="must be finite, but got nan at sample 5"):
        read_campaign_h5(path)
    assert np.isnan(read_campaign_h5(path, check=False).recordings[0].data[5, 3])


def test_error_of_the_progress_callback_is_the_callers(tmp_path):
    def report(fraction, name):
        raise ValueError("from the callback")

    with pytest.raises(ValueError, match="from the callback"):
        read_campaign_h5(write_plainly(tmp_path / "c.h5"), on_progress=report)


JUNK = st.one_of(
    st.text(st.characters(exclude_characters="\x00", exclude_categories=["Cs"]), max_size=20),
    st.binary(min_size=1, max_size=20).map(np.void),
    st.integers(-5, 2**40),
    st.floats(width=32),
    st.just('{"a": [1'),
    st.booleans(),
)
NAMES = st.sampled_from([*COLUMNS, "raw", "mode", "factory", "device_id", "excitation", "compensation", "sample_rate_hz", "q", "Time"])
FUZZ = settings(max_examples=80, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])


@FUZZ
@given(
    attributes=st.dictionaries(NAMES, JUNK, max_size=6),
    datasets=st.dictionaries(NAMES, st.one_of(JUNK, st.lists(st.floats(width=32), max_size=5)), max_size=14),
    root=st.dictionaries(NAMES, JUNK, max_size=3),
)
def test_junk_inside_hdf5_is_refused_not_crashed_on(tmp_path, attributes, datasets, root):
    path = tmp_path / "junk.h5"
    with h5py.File(path, "w") as file:
        group = file.create_group("recording_0")
        for target, words in ((file.attrs, root), (group.attrs, attributes), (group, datasets)):
            for key, value in words.items():
                target[key] = value
    with pytest.raises(DataError):
        read_campaign_h5(path)


def refusal(path):
    """Text of the refusal, or None if the file reads."""
    try:
        read_campaign_h5(path)
    except DataError as error:
        return str(error)
    return None


@FUZZ
@given(cut=st.integers(0, 10**6), at=st.integers(0, 10**6), value=st.binary(min_size=1, max_size=8))
def test_torn_or_overwritten_file_never_crashes(tmp_path, cut, at, value):
    original = tmp_path / "whole.h5"
    if not original.exists():
        write_campaign_h5(original, make_campaign(n=200))
    content = bytearray(original.read_bytes())
    at %= len(content)
    content[at : at + len(value)] = value
    damaged = tmp_path / "damaged.h5"
    damaged.write_bytes(content)
    text = refusal(damaged)
    assert text is None or text.startswith(str(damaged)) or str(damaged) in text
    damaged.write_bytes(original.read_bytes()[: cut % (original.stat().st_size - 1)])
    assert refusal(damaged)
