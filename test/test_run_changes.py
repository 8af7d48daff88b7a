"""Runs beside each other: the change, its sd, and what is said of it; the command on stored records."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from calibration_samples import make_record

from gyro_calib.calibration import RecordStore
from gyro_calib.calibration.run_changes import changes_between
from gyro_calib.cli.main import main
from gyro_calib.errors import DataError
from gyro_calib.quantity import Quantity
from gyro_calib.report.run_changes_page import run_changes_page, run_changes_table
from gyro_calib.units import DEG_H, PPM


def later(day: int = 9, **changes):
    return make_record(created_utc=f"2026-03-{day:02d}T12:00:00Z", **changes)


def test_change_by_hand():
    moved = later(bias=Quantity(1204.0 * DEG_H, 1.0 * DEG_H, "rad/s"), scale_factor=Quantity(1.03 * (1.0 + 40.0 * PPM), 30.0 * PPM, "1"))
    changes = changes_between([moved, make_record()])  # any order
    assert [r.created.day for r in changes.records] == [1, 9]
    bias = changes.figure("bias").change
    assert bias.value == pytest.approx(4.0 * DEG_H)
    assert bias.sd == pytest.approx(math.sqrt(2.0) * DEG_H)
    assert changes.figure("bias").pull == pytest.approx(4.0 / math.sqrt(2.0))
    assert changes.moved == ()  # 2.8 and 0.9 standard deviations
    rows = {row[0]: row for row in run_changes_table(changes).rows}
    assert rows["bias"][3] == "4.0"
    assert rows["bias"][6] == "2.8"
    assert rows["scale factor"][3] == "40"  # ppm of the first run


def test_what_moved_is_named_and_colours_the_page():
    moved = later(bias=Quantity(1206.0 * DEG_H, 1.0 * DEG_H, "rad/s"))
    changes = changes_between([make_record(), moved])
    assert [entry.name for entry in changes.moved] == ["bias"]
    page = run_changes_page(changes, "")
    assert page.passed is False
    assert page.verdict.startswith("More than noise: the bias.")
    assert run_changes_page(changes_between([make_record(), later()]), "").passed is True


def test_a_negative_scale_factor_grows_when_its_size_does():
    first = make_record(scale_factor_by_axis={"y": Quantity(-0.5, 1e-6, "V/(rad/s)")})
    last = later(scale_factor_by_axis={"y": Quantity(-0.5 * (1.0 + 1e-3), 1e-6, "V/(rad/s)")})
    row = next(row for row in run_changes_table(changes_between([first, last])).rows if row[0] == "scale factor, y")
    assert float(row[3].replace("\u202f", "")) == pytest.approx(1000.0)


def test_cautions_name_what_is_not_alike():
    other = later(mode="ftr_y", method="document", compensation=(1.01, 0.0, 0.0, 1.0), temperature_degc=Quantity(35.0, 0.1, "degC"))
    text = " ".join(changes_between([make_record(), other]).cautions)
    for words in ("ftr_x, ftr_y", "drive compensation differs", "document, sideband", "25.0 to 35.0 degC"):
        assert words in text


def test_figures_without_sd_are_not_judged():
    changes = changes_between([make_record(), later()])
    assert math.isnan({e.name: e for e in changes.parameters}["pickoff_phase"].pull)


def test_refuses_one_record_twice_and_two_devices():
    with pytest.raises(DataError, match="two different records at least, but got 1"):
        changes_between([make_record(), make_record()])
    with pytest.raises(DataError, match="of one device, but got ring-a, ring-b"):
        changes_between([make_record("ring-a"), later(device_id="ring-b")])


def test_command_takes_a_store_with_its_previous_versions(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    store = RecordStore(tmp_path / "ring.yaml", "ring_15k-0007")
    for day, bias in ((1, 1200.0), (2, 1201.0), (5, 1250.0)):
        store.save(later(day, bias=Quantity(bias * DEG_H, DEG_H, "rad/s")))
    document, page = tmp_path / "runs.json", tmp_path / "runs.html"
    assert main(["compare", str(store.path), "--json", str(document), "--html", str(page)]) == 0
    shown = capsys.readouterr().out
    assert "More than noise: the bias" in shown
    found = json.loads(document.read_text())
    assert found["moved"] == ["bias"]
    values = [q["value"] / DEG_H for q in found["figures"]["bias"]["values"]]
    assert values == pytest.approx([1200.0, 1201.0, 1250.0])
    assert page.read_text().count("<svg") == 4
    assert main(["compare", str(tmp_path / "none.yaml")]) == 1
    assert "none.yaml" in capsys.readouterr().err
