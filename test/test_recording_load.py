"""Whatever it was recorded in, a campaign loads by content; files of different devices do not mix; the bench files read."""

from __future__ import annotations

import builtins
from dataclasses import replace

import numpy as np
import pytest
from recording_samples import BENCH, FACTORY, make_campaign

from gyro_calib.errors import DataError
from gyro_calib.recording import Campaign, load_campaign, write_campaign_h5
from gyro_calib.recording.bag import import_rosbags


def of_device(campaign, device_id):
    return Campaign(device_id, tuple(replace(r, device_id=device_id) for r in campaign), campaign.factory)


def test_files_of_one_device_merge_in_the_order_given(tmp_path):
    first = write_campaign_h5(tmp_path / "b.dat", make_campaign(("ftr_x",)))
    second = write_campaign_h5(tmp_path / "a.h5", Campaign("ring-0001", make_campaign(("ftr_y", "ftr_x")).recordings, {"nominal_q": 3e4}))
    seen = []
    merged = load_campaign(first, second, on_progress=lambda fraction, name: seen.append((round(fraction, 6), name)))
    assert [r.label for r in merged] == ["ftr_x_0", "ftr_y_0", "ftr_x_1"]
    assert merged.factory == {**FACTORY, "nominal_q": 3e4}
    assert seen == [(0.5, "ftr_x_0"), (0.75, "ftr_y_0"), (1.0, "ftr_x_1")]


def test_folder_of_files_loads_sorted(tmp_path):
    write_campaign_h5(tmp_path / "2.h5", make_campaign(("ftr_y",)))
    write_campaign_h5(tmp_path / "1.hdf5", make_campaign(("ftr_x",)))
    assert [r.label for r in load_campaign(tmp_path)] == ["ftr_x_0", "ftr_y_0"]


def test_other_device_or_other_factory_data_are_refused(tmp_path):
    first = write_campaign_h5(tmp_path / "1.h5", make_campaign())
    other = write_campaign_h5(tmp_path / "2.h5", of_device(make_campaign(), "ring-0002"))
    with pytest.raises(DataError, match=r"of one device, 'ring-0001' .*but got 'ring-0002' .*2.h5"):
        load_campaign(first, other)
    wrong = write_campaign_h5(tmp_path / "3.h5", Campaign("ring-0001", make_campaign().recordings, {"nominal_f0_hz": 14999.0}))
    with pytest.raises(DataError, match=r"must agree among the files, but got nominal_f0_hz = 14999.0 .* and 15000.0"):
        load_campaign(first, wrong)


def test_what_is_no_recording_is_refused(tmp_path):
    (tmp_path / "notes.h5").write_text("not HDF5 at all")
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match=r"must be an HDF5 file or a ROS 2 bag .* begins with b'not HDF5 at all'"):
        load_campaign(tmp_path / "notes.h5")
    with pytest.raises(DataError, match="must exist, but got"):
        load_campaign(tmp_path / "none.h5")
    with pytest.raises(DataError, match=r"must be a bag .* or hold HDF5 files"):
        load_campaign(tmp_path / "empty")
    with pytest.raises(DataError, match="At least one recording must be given"):
        load_campaign()


def test_bag_without_rosbags_names_the_extra(tmp_path, monkeypatch):
    real = builtins.__import__

    def without_rosbags(name, *args, **kwargs):
        if name.split(".")[0] == "rosbags":
            raise ImportError("No module named 'rosbags'")
        return real(name, *args, **kwargs)

    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {}")
    monkeypatch.setattr(builtins, "__import__", without_rosbags)
    # other tests of this process may have loaded it
    import_rosbags.cache_clear()
    with pytest.raises(DataError, match=r"pip install 'gyro_calib\[bags\]'"):
        load_campaign(tmp_path)


@pytest.mark.skipif(not (BENCH / "truth.json").is_file(), reason="no bench recordings (GYRO_CALIB_BENCH)")
@pytest.mark.parametrize(("name", "count"), [("ring_a", 40), ("ring_b", 40), ("hrg_a", 22), ("hrg_b", 22)])
def test_bench_campaign_reads(name, count):
    campaign = load_campaign(BENCH / f"{name}.h5")
    assert len(campaign) == count
    assert campaign.device_id == campaign.factory["unit"]
    by_label = {recording.label: recording for recording in campaign}
    for recording in campaign:
        assert recording.sample_rate_hz == 1000.0
        assert recording.extras["mode"] in ("ftr_x", "ftr_y", "whole_angle", "loops_off")
        assert recording.extras["compensation"] == [[1.0, 0.0], [0.0, 1.0]]
    raw = campaign.recordings[0].raw
    assert raw is not None
    assert set(raw) == {"t", "x_pick", "y_pick", "x_drive", "y_drive", "phase_ref"}
    # the phase reference agrees with the envelopes: demodulating the carrier-rate block gives the same amplitude
    envelope = 2.0 * np.mean(raw["x_pick"] * np.exp(-1j * raw["phase_ref"]))
    row = np.searchsorted(campaign.recordings[0].t, raw["t"].mean())
    assert abs(envelope - campaign.recordings[0].pick[row, 0]) < 0.02
    if name.startswith("ring"):
        excitation = by_label["side_y_a1.4_nu0.5"].command.excitation
        assert (excitation.kind, excitation.index, excitation.frequency_hz) == ("amplitude_modulation", 0.1, 0.5)
        assert by_label["side_y_a1.4_nu0.5"].command.setpoints.amplitude_v == 1.4
        drive, body = by_label["feed_y_-60"].command.excitation, by_label["body_+40"].command.excitation
        assert (drive.kind, drive.axis, drive.volts) == ("drive", "y", 2.0)
        assert drive.frequency_hz == pytest.approx(by_label["feed_y_-60"].column("ref_freq")[0])
        assert (body.kind, body.axis, body.volts) == ("body", "both", 4.0)
        assert by_label["table_x"].extras["applied_rate"]["deg_s"] == [0.0, 50.0, 0.0, -50.0, 0.0]
    else:
        assert by_label["vir_n_a1"].command.setpoints.virtual_precession_v == pytest.approx(-2.4429, abs=2e-4)
        assert (by_label["stiff_x"].command.mode, by_label["ring_y"].command.mode) == ("stiffness", "ring_down")
        assert by_label["stiff_x"].extras["stiffness_control"]["cr_V_per_V"][1][1] == 0.5
        assert by_label["ring_y"].command.setpoints.amplitude_gain_v_per_v == -1.8
