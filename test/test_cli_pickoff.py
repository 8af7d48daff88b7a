"""``gyro-calib pickoff`` on recordings that ``gyro-calib simulate`` made of a device with electrostatic pick-offs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from gyro_calib.cli.main import main
from gyro_calib.device import device_to_dict, load_device


def test_gap_and_relative_magnitude_from_simulated_recordings(tmp_path: Path) -> None:
    document = device_to_dict(load_device("ring_15k"))
    document["device_id"] = "ring_gap"
    document["pickoff"]["gap_amplitude_v"] = 20.0
    (tmp_path / "ring_gap.yaml").write_text(yaml.safe_dump(document))
    assert main(["simulate", str(tmp_path / "ring_gap.yaml"), "--plan", "pickoff_phase", "--out", str(tmp_path / "out")]) == 0
    recordings = [str(p) for p in (tmp_path / "out").glob("*.h5")]
    assert main(["pickoff", *recordings, "--json", str(tmp_path / "found.json")]) == 0
    found = json.loads((tmp_path / "found.json").read_text())
    ratio, gap = found["pickoff_ratio"], found["gap"]["x"]
    assert abs(ratio["value"] - (1.0 + document["pickoff"]["gain_mismatch"])) < 3 * ratio["sd"]
    assert gap["value"] == pytest.approx(20.0, abs=4 * gap["sd"])


def test_recordings_without_raw_blocks_are_refused_with_the_remedy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "ring_15k", "--plan", "static", "--quality", "quick", "--out", str(tmp_path)]) == 0
    assert main(["pickoff", *map(str, tmp_path.glob("*.h5"))]) == 1
    assert "Record the plan pickoff_phase" in capsys.readouterr().err
