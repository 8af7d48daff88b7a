"""What a diagnosis says where little can be told, of what has no kin, and on a narrow terminal."""

from __future__ import annotations

import io
from dataclasses import replace

import pytest
from test_diagnose_cli import diagnosis

from gyro_calib.gap import Standing
from gyro_calib.gap.heldout import Shrinkage
from gyro_calib.gap.summary import summary_of
from gyro_calib.quantity import Quantity
from gyro_calib.report.gap_page import gap_page
from gyro_calib.report.gap_tables import before_after_table, effects_table, standings_table
from gyro_calib.report.page import render_page
from gyro_calib.report.table import to_rich


def test_what_could_not_be_tested_has_no_probability_of_being_absent():
    """ "None of any kind 81 %" contradicts a verdict that says that nothing can be told."""
    told = effects_table(diagnosis("not_testable"))
    assert told.rows == ()
    assert told.caption == "Nothing is told of any effect."
    assert "none of any kind" not in render_page(gap_page(diagnosis("not_testable")))


@pytest.mark.parametrize(("untested", "said"), [(20, False), (57, True)])
def test_none_found_says_how_much_was_not_looked_for(untested, said):
    lines = tuple(Standing(f"e{k}", "", "drive", "not testable" if k < untested else "excluded", None, 0.0, 0.0, 0.0) for k in range(83))
    summary = summary_of("none", (), None, Shrinkage(1.0, 1.0, 100, 0.0, 0.0), lines)
    assert summary.startswith("None: the linear device explains all 100 unseen figures")
    assert (f"{untested} of 83 effects cannot be tested" in summary) is said


def test_something_without_kin_is_null_for_programs_and_none_for_people():
    alone = diagnosis("unknown")
    alone = replace(alone, unknown=replace(alone.unknown, nearest=""))
    assert alone.to_json()["unknown"]["nearest"] is None
    assert diagnosis("unknown").to_json()["unknown"]["nearest"] == "drive_sag"
    assert "the nearest known effect is none" in render_page(gap_page(alone))


def test_figures_beyond_any_gyro_are_unknown():
    """Three side bands leave the rate open by 4.3e8 deg/h."""
    thin = diagnosis("none")
    open_rate = Quantity(0.0, 4.3e8, "deg/h")
    thin = replace(thin, gap=replace(thin.gap, bias_before=open_rate, bias_after=open_rate))
    rows = {row[0]: row[1:] for row in before_after_table(thin).rows}
    assert rows["rate left unexplained [deg/h]"] == ("unknown", "unknown", "")
    assert rows["bend of the scale factor [ppm]"] == ("900", "0", "20")
    assert {tile.label: tile.value for tile in gap_page(thin).tiles}["Rate left unexplained"] == "unknown"


@pytest.mark.parametrize("width", [120, 80, 60, 40])
def test_a_narrow_terminal_cuts_no_figure(width):
    from rich.console import Console

    wide = diagnosis("effects")
    sizes = {"c_x": Quantity(0.00079271335, 4.97e-6, "1/s/V^2"), "c_y": Quantity(1234.5, 0.62, "1/s/V^2")}
    group = ("nonlinear_damping", "nonlinear_damping_axes", "thermal_damping_anisotropy_lag")
    effect = replace(wide.effects[0], name=group[0], registry_name=group[1], group=group, parameters=sizes)
    wide = replace(wide, effects=(effect,))
    console = Console(width=width, record=True, file=io.StringIO())
    for table in (effects_table(wide), standings_table(wide)):
        console.print(to_rich(table, width))
    text = console.export_text()
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= width
    for figure in ("0.0007927", "5e−06", "1\u202f234.50", "0.62", "1/s/V^2", "97.0 %", "probability"):
        assert figure in text, figure
    # what has no room is said, and what matters most stays
    assert ("No room here for: acts in" in text) is (width < 120)
