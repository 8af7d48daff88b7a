"""Every kind of page in a real browser: phone, desk and paper, light and dark, nothing fetched, nothing cut off."""

from __future__ import annotations

import re
import struct
import zlib
from pathlib import Path
from typing import Any

import pytest
from browser import NAMES, PAPER_PX, find_browser, measure_pages, print_pdf, screenshot
from report_samples import every_page

from gyro_calib.report.page import render_page

PHONE_PX, DESK_PX = 390, 1200
BROWSER = find_browser()
pytestmark = pytest.mark.skipif(BROWSER is None, reason=f"no headless browser on the PATH ({', '.join(NAMES[:3])}, …)")


@pytest.fixture(scope="module")
def pages() -> dict[str, str]:
    return {name: render_page(page) for name, page in every_page().items()}


@pytest.fixture(scope="module", params=["light", "dark"])
def looked(request: pytest.FixtureRequest, pages: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Setting, measures by page and width, console."""
    dark = request.param == "dark"
    return request.param, *measure_pages(BROWSER, pages, (PHONE_PX, DESK_PX, PAPER_PX), tmp_path_factory.mktemp("browser"), dark=dark)


def test_nothing_sticks_out_and_everything_can_be_read(looked: Any, pages: dict[str, str]) -> None:
    setting, measures, _ = looked
    assert len(measures) == 3 * len(pages)
    for name, seen in measures.items():
        assert seen["width"] == int(name.split()[1])
        assert seen["scroll_width"] <= seen["width"], name
        assert (seen["sticking"], seen["pale"], seen["faint"], seen["outside"]) == ([], [], [], []), (setting, name)
        assert seen["smallest_px"] >= 12.0, name
        assert seen["plots"] == pages[name.split()[0]].count("<svg")
        # figures of a heat map are the smallest, then the exponents of an axis; paper shows more than a screen
        on_paper = name.endswith(str(PAPER_PX))
        assert seen["smallest_label_px"] >= (5.5 if on_paper else 6.5 if name.startswith("gap") else 6.9), name


def test_setting_of_the_reader_is_followed_but_not_on_paper(looked: Any) -> None:
    setting, measures, _ = looked
    for name, seen in measures.items():
        on_paper = name.endswith(str(PAPER_PX))
        assert (seen["ground"] > 0.8) == (setting == "light" or on_paper), name
        assert seen["ground"] > 0.8 or seen["ground"] < 0.05


def test_tables_are_whole_on_paper(looked: Any) -> None:
    """A screen scrolls a wide table, paper does not."""
    for name, seen in looked[1].items():
        if not name.endswith(str(PHONE_PX)):
            assert seen["cut"] == [], name


def test_nothing_is_fetched_and_nothing_goes_wrong(looked: Any) -> None:
    _, measures, console = looked
    assert console == ""
    assert all(seen["fetched"] == [] for seen in measures.values())


def test_the_probe_sees_what_is_wrong(tmp_path: Path) -> None:
    """A page that breaks every rule: the test of the test."""
    broken = (
        '<!doctype html><html><head><meta name="viewport" content="width=device-width"></head><body><main>'
        '<div style="width:900px">wide</div><p style="color:#eee">pale</p><img src="http://example.invalid/x.png">'
        "<script>undefined_function();</script></main></body></html>"
    )
    measures, console = measure_pages(BROWSER, {"broken": broken}, (PHONE_PX,), tmp_path, dark=False)
    seen = measures[f"broken {PHONE_PX}"]
    assert seen["scroll_width"] > PHONE_PX
    assert len(seen["sticking"]) == 1
    assert [name for name in seen["pale"] if "pale" in name]
    assert seen["fetched"] or "ERR_NAME_NOT_RESOLVED" in console
    assert "undefined_function" in console


def test_a_page_is_painted_and_printed(pages: dict[str, str], tmp_path: Path) -> None:
    page = tmp_path / "gap.html"
    page.write_text(pages["gap"], encoding="utf-8")
    picture = screenshot(BROWSER, page, PHONE_PX, tmp_path, dark=True).read_bytes()
    assert picture[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">II", picture[16:24]) == (PHONE_PX, 900)
    assert len(zlib.decompress(b"".join(_chunks(picture, b"IDAT")))) > 3 * PHONE_PX * 900
    assert len(picture) > 20_000  # words and plots, not one colour
    paper = print_pdf(BROWSER, page, tmp_path).read_bytes()
    assert paper.startswith(b"%PDF")
    assert 2 <= len(re.findall(rb"/Type\s*/Page\b", paper)) <= 8


def _chunks(picture: bytes, kind: bytes) -> list[bytes]:
    found, at = [], 8
    while at < len(picture):
        (length,) = struct.unpack(">I", picture[at : at + 4])
        if picture[at + 4 : at + 8] == kind:
            found.append(picture[at + 8 : at + 8 + length])
        at += 12 + length
    return found
