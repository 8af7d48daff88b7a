"""``gyro-calib allan`` on recordings and bags of a whole-angle gyro: what nobody drives is taken, noise comes out as it went in."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from wave_samples import design_gain, simulate, whole_angle

from gyro_calib.cli.main import main
from gyro_calib.device import load_device
from gyro_calib.experiments import SimulatedInstrument
from gyro_calib.recording.bag_writer import write_campaign_bag
from gyro_calib.recording.hdf5 import write_campaign_h5
from gyro_calib.recording.recording import Campaign


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    """Ten minutes of a free wave, and a minute of one that is turned."""
    instrument = SimulatedInstrument(simulate(load_device("hrg_hardware"), noisy=True, seed=4), 0.0)
    instrument.configure(whole_angle())
    free = instrument.record(600.0, settle_s=3.0, label="free")
    instrument.configure(whole_angle(virtual_precession_v=0.5))
    turned = instrument.record(60.0, settle_s=3.0, label="turned")
    return Campaign(instrument.device_id, (turned, free), instrument.factory)


def allan_of(path: Path, folder: Path, *options: str) -> dict[str, object]:
    document = folder / f"{path.stem}.json"
    assert main(["allan", str(path), "--json", str(document), *options]) == 0
    return json.loads(document.read_text())


def test_recording_of_a_free_wave(campaign: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "wave.h5"
    write_campaign_h5(path, campaign)
    found = allan_of(path, tmp_path)
    assert "bias instability" in capsys.readouterr().out
    assert found["recording"] == "free"
    # the flicker of the drives is where the curve is lowest, its coefficient at most about that
    device = load_device("hrg_hardware")
    floor = device.noise.drive_flicker_v * design_gain(device) / device.resonator.angular_gain
    assert found["minimum"]["deviation"]["value"] == pytest.approx(floor, rel=0.3)
    assert found["upper_limits"]["bias_instability"]["value"] < 2.5 * floor
    assert found["curve"]["lower"][0] < found["curve"]["deviation"][0] < found["curve"]["upper"][0]


def test_angle_random_walk_comes_out_as_the_drives_noise_went_in(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base = load_device("hrg_hardware")
    device = replace(base, noise=replace(base.noise, drive_flicker_v=0.0, pickoff_v_rthz=0.0))
    instrument = SimulatedInstrument(simulate(device, noisy=True, seed=5), 0.0)
    instrument.configure(whole_angle())
    free = instrument.record(300.0, settle_s=5.0, label="free")
    write_campaign_h5(tmp_path / "quiet.h5", Campaign(instrument.device_id, (free,), instrument.factory))
    found = allan_of(tmp_path / "quiet.h5", tmp_path)["coefficients"]["angle_random_walk"]
    capsys.readouterr()
    walk = base.noise.drive_v_rthz * design_gain(base) / base.resonator.angular_gain
    assert abs(found["value"] - walk) < 4.0 * found["sd"]
    assert found["sd"] < 0.08 * walk


def test_bag_gives_the_same_curve(campaign: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rosbags")
    write_campaign_h5(tmp_path / "wave.h5", campaign)
    bag = write_campaign_bag(tmp_path / "wave.mcap", campaign)
    ours, theirs = (allan_of(path, tmp_path, "--label", "free") for path in (tmp_path / "wave.h5", bag))
    capsys.readouterr()
    assert theirs["curve"]["tau_s"] == pytest.approx(ours["curve"]["tau_s"])
    assert theirs["curve"]["deviation"] == pytest.approx(ours["curve"]["deviation"], rel=1e-3)
    for name, quantity in ours["coefficients"].items():
        assert theirs["coefficients"][name]["value"] == pytest.approx(quantity["value"], rel=0.02, abs=0.1 * quantity["sd"])


def test_without_a_recording_at_rest_it_says_what_there_is(campaign: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    turned = Campaign(campaign.device_id, campaign.recordings[:1], campaign.factory)
    write_campaign_h5(tmp_path / "turned.h5", turned)
    assert main(["allan", str(tmp_path / "turned.h5")]) == 1
    assert "one at rest, in force-rebalance or whole-angle mode, but got turned" in capsys.readouterr().err


def test_a_free_wave_needs_no_scale_factor(campaign: Campaign, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    factory = {k: v for k, v in campaign.factory.items() if k != "nominal_scale_factor_v_per_rad_s"}
    path = tmp_path / "stranger.h5"
    write_campaign_h5(path, Campaign(campaign.device_id, campaign.recordings, factory))
    found = allan_of(path, tmp_path)
    capsys.readouterr()
    assert math.isfinite(found["coefficients"]["angle_random_walk"]["value"])
