"""What the report shows is what the data say, and the page stands alone."""

from __future__ import annotations

import io
import math
import re
from html.parser import HTMLParser
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
from report_samples import RATE_HZ, G, make_campaign, make_result, parameters, whole_page

from gyro_calib.errors import DataError
from gyro_calib.estimation import TableRow
from gyro_calib.estimation.allan import analyse_allan
from gyro_calib.quantity import Quantity
from gyro_calib.recording.recording import Campaign
from gyro_calib.report.calibration_page import RunFacts, calibration_drawings, calibration_page, result_table
from gyro_calib.report.comparison import compare, comparison_table
from gyro_calib.report.figures import draw_residuals
from gyro_calib.report.page import Page, Panel, Tile, render_page, write_page
from gyro_calib.report.series import Residuals, averaged, convergence_series, residual_series, response_runs, side_band_amplitudes
from gyro_calib.report.table import Table, number, quantity_cells, to_rich
from gyro_calib.units import DEG_H, PPM


@pytest.fixture(scope="module")
def campaign():
    return make_campaign()


@pytest.fixture(scope="module")
def result():
    return make_result()


def test_side_band_amplitudes_are_recovered():
    t = np.arange(1500) / RATE_HZ
    signal = 2.0 - 1.0j + (0.3 + 0.1j) * np.exp(2j * np.pi * 0.7 * t) + (0.2j) * np.exp(-2j * np.pi * 0.7 * t) + 0.01 * t
    below, carrier, above = side_band_amplitudes(signal[:, None], t, 0.7)[:, 0]
    turn = np.exp(2j * np.pi * 0.7 * t.mean())
    assert above == pytest.approx((0.3 + 0.1j) * turn, abs=1e-9)
    assert below == pytest.approx(0.2j / turn, abs=1e-9)
    assert carrier == pytest.approx(2.0 - 1.0j + 0.01 * t.mean(), abs=1e-9)


def test_measured_response_lies_on_the_model(campaign):
    """Measured from recordings, modelled from parameters: two ways to the same numbers, feedthrough included."""
    runs = response_runs(campaign, parameters())
    assert [run.axis for run in runs] == ["x", "y"]
    for run in runs:
        assert run.frequency_hz == pytest.approx([-0.9, -0.2, 0.2, 0.9])
        for measured, model in ((run.direct, run.fit_direct), (run.cross, run.fit_cross)):
            expected = np.interp(run.frequency_hz, run.fit_frequency_hz, model.real) + 1j * np.interp(
                run.frequency_hz, run.fit_frequency_hz, model.imag
            )
            assert np.abs(measured - expected).max() < 2e-4 * np.abs(expected).max()
    # Lorentzian: 3 dB at the half-width
    assert abs(runs[0].fit_direct).max() == pytest.approx(abs(G[0, 0]) / 1.5, rel=0.02)


def test_response_without_parameters_has_no_line(campaign):
    assert all(run.fit_frequency_hz.size == 0 and run.direct.size == 4 for run in response_runs(campaign, {}))


def test_residuals_are_scaled_by_their_sd():
    row = TableRow("r", "y", 0.5, (0, 0), (0, 0), (3e-4 - 1e-4j, 2e-4j), (1e-4, 2e-4))
    unknown = TableRow("r", "y", 0.5, (0, 0), (0, 0), (1.0, 1.0), (math.nan, 0.0))
    x_pick, y_pick = residual_series([row, unknown])
    assert (x_pick.oscillator, x_pick.pickoff, y_pick.pickoff) == ("y", "x", "y")
    assert x_pick.pull == pytest.approx(np.array([[3.0, -1.0]]))
    assert y_pick.pull == pytest.approx(np.array([[0.0, 1.0]]))


@pytest.mark.parametrize(("size", "words"), [(1.0, "nothing systematic"), (6.0, "something systematic is left over")])
def test_residual_plot_judges_what_it_shows(size, words):
    from gyro_calib.report.theme import PAPER

    pull = size * np.random.default_rng(0).standard_normal((60, 2))
    drawing = draw_residuals([Residuals("x", "y", np.repeat([0.0, 0.5, 1.5], 20), pull)], PAPER)
    assert words in drawing.conclusion


def test_averages_are_of_whole_windows():
    t = 5.0 + np.arange(250) / 100.0
    trace = averaged(t, np.where(t < 6.0, 1.0, 3.0) * DEG_H)
    assert trace.rate_deg_h == pytest.approx([1.0, 3.0])  # the half window at the end is left out
    assert trace.time_s[0] == pytest.approx(5.495)
    assert averaged([], []).rate_deg_h.size == 0


def test_convergence_in_display_units(result):
    found = convergence_series(result.convergence, "bias", "x", 1.0 / DEG_H, "deg/h", 1000.0)
    assert found.value == pytest.approx([1000.3, 1000.15, 1000.075])
    assert found.sd == pytest.approx([0.2, 0.1, 0.05])
    assert (found.reference, found.reference_is_truth) == (1000.0, True)
    towards_last = convergence_series(result.convergence, "bias", "x", 1.0 / DEG_H, "deg/h")
    assert towards_last.reference == pytest.approx(1000.075)
    assert not towards_last.reference_is_truth
    assert convergence_series(result.convergence[:1], "bias", "x", 1.0, "rad/s") is None


def test_comparison_by_hand():
    truth = SimpleNamespace(bias_rad_s=1000.0 * DEG_H, scale_factor=0.98)
    bias, rate = Quantity(999.0 * DEG_H, 0.8 * DEG_H, "rad/s"), Quantity(21.0 * DEG_H, DEG_H, "rad/s")
    found = compare(truth, 20.0 * DEG_H, bias, Quantity(0.98001, 2e-5, "1"), rate)
    assert found.before_bias.value == pytest.approx(1000.0)
    assert found.before_scale_factor.value == pytest.approx(-20000.0)
    assert found.after_bias.value == pytest.approx(1.0 / 0.98001)
    assert found.after_scale_factor.value == pytest.approx((0.98 / 0.98001 - 1.0) / PPM)
    assert (found.error_bias.value, found.error_bias.sd) == pytest.approx((-1.0, 0.8))
    assert (found.error_scale_factor.value, found.error_scale_factor.sd) == pytest.approx((10.0, 20.0))
    assert found.error_rate.value == pytest.approx(1.0)
    document = found.to_json()
    assert set(document) == {"before", "after", "error"}
    assert document["before"]["bias"] == {"value": pytest.approx(1000.0), "sd": 0.0, "unit": "deg/h"}
    assert document["after"]["scale_factor_error"]["unit"] == "ppm"
    assert "1\u202f000×" not in comparison_table(found).rows[0][-1]  # better by 980, not by a rounder number
    assert comparison_table(found).rows[0][-1] == "980×"


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [
        (1215.3421, 0.62, "1\u202f215.34"),
        (-0.0123456, 2.3e-5, "−0.012346"),
        (31234.0, 120.0, "31\u202f230"),
        (0.0883207, 1.4e-6, "0.0883207"),
        (math.nan, 1.0, "not observable"),
        (12.3456789, 0.0, "12.3457"),
        (1.43413e-6, 8.4e-6, "1.4e−06"),
        (-2.3456e-7, 1.2e-9, "−2.346e−07"),
    ],
)
def test_numbers_carry_the_digits_they_deserve(value, sd, text):
    assert number(value, sd) == text


def test_infinite_sd_is_said():
    assert quantity_cells(Quantity(2.0, math.inf, "1"))[1] == "not observable"


class _Balance(HTMLParser):
    def __init__(self):
        super().__init__()
        self.open = []

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "wbr"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_page_stands_alone(result, campaign, tmp_path):
    path = tmp_path / "deep" / "page.html"
    write_page(path, whole_page(result, campaign))
    text = path.read_text(encoding="utf-8")
    assert path.stat().st_mode & 0o444 == 0o444
    assert list(path.parent.iterdir()) == [path]  # no temporary file is left
    parser = _Balance()
    parser.feed(text)
    assert parser.open == []
    links = re.findall(r'(?:src|href)="([^"]*)"', text)
    assert all(link.startswith("#") for link in links)  # nothing is fetched
    assert "url(" not in re.sub(r"url\(#", "", text)
    assert "@import" not in text
    assert "prefers-color-scheme: dark" in text
    assert "@media print" in text
    assert 'name="viewport"' in text
    assert "Title &amp; more" in text
    assert "&lt;b&gt;bold&lt;/b&gt; warning." in text
    assert text.count("<svg") == 8


def test_pictures_follow_the_page_and_say_what_they_show(result, campaign):
    page = whole_page(result, campaign)
    names = [panel.title for panel in page.panels]
    assert names == [
        "Rate before correction",
        "Rate after correction",
        "Heading error",
        "Convergence of the bias",
        "Convergence of the scale factor",
        "Response of the side bands",
        "Rate channel of both runs",
        "Residuals of the fit",
    ]
    seen = set()
    for panel in page.panels:
        root = ElementTree.fromstring(panel.svg)
        assert root.attrib["role"] == "img"
        assert panel.conclusion[:20] in root.attrib["aria-label"]
        assert "width" not in root.attrib
        assert "#0101" not in panel.svg  # every place holder has become a colour of the page
        assert {"var(--ink)", "var(--muted)", "var(--grid)"} <= set(re.findall(r"var\(--\w+\)", panel.svg))
        ids = re.findall(r'\bid="([^"]+)"', panel.svg)
        assert len(ids) == len(set(ids))
        assert not seen & set(ids)
        seen |= set(ids)
        for reference in re.findall(r'(?:href="|url\()#([^")]+)', panel.svg):
            assert reference in ids
        texts = " ".join("".join(e.itertext()) for e in root.iter("{http://www.w3.org/2000/svg}text"))
        assert re.search(r"\[.+\]|standard deviation", texts), panel.title  # units on the axes
        assert panel.conclusion.endswith(".")


def test_verdict_follows_the_claim(result, campaign):
    good = whole_page(result, campaign)
    assert good.passed
    assert "within three claimed standard deviations" in good.verdict
    truth = SimpleNamespace(bias_rad_s=1010.0 * DEG_H, scale_factor=0.98)
    comparison = compare(truth, 15.0 * DEG_H, result.bias["x"], Quantity(0.98, 1e-5, "1"), result.rate)
    bad = calibration_page(result, campaign, RunFacts("t", "s", "f"), comparison=comparison)
    assert bad.passed is False
    assert "outside three claimed standard deviations" in bad.verdict


def test_result_without_pictures_still_makes_a_page(result):
    from dataclasses import replace

    bare = replace(result, table=(), convergence=(), parameters={})
    page = calibration_page(bare, Campaign("ring-1", ()), RunFacts("t", "s", "f"))
    assert page.panels == ()
    assert "<svg" not in render_page(page)
    assert result_table(bare).rows[1][1] == "1\u202f000.10"


def test_paper_has_real_colours_and_known_suffixes(result, campaign, tmp_path):
    from gyro_calib.report.theme import PAPER, save_figure

    drawing = calibration_drawings(result, campaign, PAPER)[0]
    for suffix in (".png", ".svg", ".pdf"):
        save_figure(drawing.figure, tmp_path / f"plot{suffix}")
        assert (tmp_path / f"plot{suffix}").stat().st_size > 1000
    with pytest.raises(DataError, match=r"must end in \.pdf, \.png, \.svg, but got 'plot\.xyz'"):
        save_figure(drawing.figure, tmp_path / "plot.xyz")


def test_noise_pictures():
    from gyro_calib.report.noise_figures import allan_table, draw_allan, draw_distributions
    from gyro_calib.report.theme import PAGE, to_svg

    rng = np.random.default_rng(1)
    # 0.05 deg/sqrt(h) at 100 Hz
    arw = math.radians(0.05) / 60.0
    analysis = analyse_allan(arw * 10.0 * rng.standard_normal(3000), 100.0)
    row = next(row for row in allan_table(analysis).rows if row[0] == "angle random walk")
    assert float(row[1]) == pytest.approx(0.05, rel=0.05)
    assert row[3] == "deg/√h"
    limit = next(row for row in allan_table(analysis).rows if row[0] == "rate random walk")
    assert limit[1].startswith("<")
    assert "Angle random walk 0.0" in draw_allan(analysis, PAGE).conclusion
    figures = {"a [deg/h]": rng.standard_normal(20), "b [ppm]": np.array([1.0, math.nan])}
    svg = to_svg(draw_distributions(figures, "study", "none", PAGE).figure, "study", "x")
    assert "a [deg/h]" in svg
    assert "b [ppm]" in svg


def test_terminal_shows_the_same_cells():
    """Brackets are text, not markup."""
    from rich.console import Console

    console = Console(width=100, record=True, file=io.StringIO())
    console.print(to_rich(Table("title [V]", ("", "error [deg]"), (("a [b]", "−1.5"),), "caption [x]")))
    text = console.export_text()
    for words in ("title [V]", "error [deg]", "a [b]", "−1.5", "caption [x]"):
        assert words in text


@pytest.mark.parametrize(("width", "said"), [(None, ""), (40, ""), (24, "No room here for: remark.")])
def test_a_narrow_terminal_leaves_out_what_is_optional(width, said):
    """Cells fold between words only as long as that is enough."""
    from rich.console import Console

    table = Table("", ("name", "value", "remark"), (("scale_factor", "0.00079271 ± 5e-06 V", "a word or two"),), optional=(2,))
    console = Console(width=width or 100, record=True, file=io.StringIO())
    console.print(to_rich(table, width))
    text = " ".join(console.export_text().split())
    assert "…" not in text
    assert ("remark" in text.split("No room")[0], said in text) == (not said, True)
    for words in ("scale_factor", "0.00079271", "5e-06"):
        assert (words in text) is (words != "scale_factor" or width != 24)


def test_plain_page_parts():
    page = Page(
        "t", "s", "v", None, (Tile("l", "1 V", "note", "2 V"),), (Panel("p", "<svg></svg>", "c"),), (Table("T", ("a", "b"), (("x", "1"),)),)
    )
    text = render_page(page)
    assert '<p class="verdict">v</p>' in text
    assert "before 2 V" in text
    assert '<th scope="row">x</th><td>1</td>' in text
    assert "Read this too" not in text
