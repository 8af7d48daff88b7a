"""A headless browser for the tests of pages: what it measures of a page at a width, with light or dark settings, on screen and on paper."""

from __future__ import annotations

import html
import json
import os
import re
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

__all__ = ["PAPER_PX", "find_browser", "measure_pages", "print_pdf", "screenshot"]

NAMES = ("chromium-headless-shell", "chrome-headless-shell", "chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
#: width of A4 less the margins of the style sheet [CSS px]
PAPER_PX = 688

#: run inside each page: what sticks out, what is too small or too pale to read, what was fetched
_PROBE = """
function probe(frame) {
  const doc = frame.contentDocument, win = frame.contentWindow, wide = doc.documentElement.clientWidth;
  const shown = e => e.getClientRects().length > 0;
  const name = e => e.tagName + "." + (e.className.baseVal ?? e.className) + " " + e.textContent.trim().slice(0, 40);
  const all = [...doc.querySelectorAll("main *")].filter(shown);
  const scrolled = e => e.closest(".scroll") !== null;
  const sticking = all.filter(e => !scrolled(e) && !e.closest("svg") && e.getBoundingClientRect().right > wide + 0.5).map(name);
  const cut = [...doc.querySelectorAll(".scroll")].filter(e => shown(e) && e.scrollWidth > e.clientWidth + 1).map(name);
  const lum = c => { const v = c.match(/[0-9.]+/g).slice(0, 3).map(x => x / 255)
    .map(x => x <= 0.03928 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4); return 0.2126 * v[0] + 0.7152 * v[1] + 0.0722 * v[2]; };
  const ground = e => { for (let p = e; p; p = p.parentElement) { const c = win.getComputedStyle(p).backgroundColor;
    if (!/, 0\\)$|transparent/.test(c)) return c; } return "rgb(255, 255, 255)"; };
  const contrast = (a, b) => { const [x, y] = [lum(a), lum(b)].sort((p, q) => q - p); return (x + 0.05) / (y + 0.05); };
  const words = all.filter(e => !e.closest("svg") && [...e.childNodes].some(n => n.nodeType === 3 && n.textContent.trim()));
  const pale = words.filter(e => contrast(win.getComputedStyle(e).color, ground(e)) < 4.5).map(name);
  const texts = [...doc.querySelectorAll("svg text")].filter(shown);
  const faint = texts.filter(e => contrast(win.getComputedStyle(e).fill, ground(e.closest(".plot"))) < 4.5).map(name);
  const outside = texts.filter(e => { const a = e.getBoundingClientRect(), b = e.closest("svg").getBoundingClientRect();
    return a.left < b.left - 1 || a.right > b.right + 1 || a.top < b.top - 1 || a.bottom > b.bottom + 1; }).map(name);
  const small = words.map(e => parseFloat(win.getComputedStyle(e).fontSize));
  const zoom = svg => svg.clientWidth / svg.viewBox.baseVal.width;
  const labels = texts.map(e => parseFloat(win.getComputedStyle(e).fontSize) * zoom(e.closest("svg")));
  const fetched = win.performance.getEntriesByType("resource").map(e => e.name);
  return {width: wide, scroll_width: doc.documentElement.scrollWidth, sticking, cut, pale, faint, outside, fetched,
    smallest_px: Math.min(...small), smallest_label_px: Math.min(...labels, 99), plots: doc.querySelectorAll("svg").length,
    ground: lum(win.getComputedStyle(doc.body).backgroundColor)};
}
window.addEventListener("load", () => {
  const found = {};
  for (const frame of document.querySelectorAll("iframe")) found[frame.name] = probe(frame);
  document.getElementById("found").textContent = JSON.stringify(found);
});
"""


def find_browser() -> str | None:
    """Path of a Chromium of some kind; None when there is none."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


def measure_pages(
    browser: str, pages: Mapping[str, str], widths: tuple[int, ...], folder: Path, *, dark: bool
) -> tuple[dict[str, dict[str, Any]], str]:
    """Show every page at every width and look.

    Parameters
    ----------
    browser : str
        Path of the browser.
    pages : mapping of str to str
        HTML documents by name.
    widths : tuple of int
        Widths of the window [CSS px]; at :data:`PAPER_PX` the page is shown as it is printed.
    folder : Path
        For files.
    dark : bool
        The reader's setting.

    Returns
    -------
    tuple
        Measures by ``"<page> <width>"``, and what the browser logged from the pages.
    """
    look = "height:900px;border:0"
    frames = "".join(
        f'<iframe name="{name} {width}" style="width:{width}px;{look}" srcdoc="{html.escape(_shown(text, width))}"></iframe>\n'
        for name, text in pages.items()
        for width in widths
    )
    wrapper = folder / f"wrapper_{'dark' if dark else 'light'}.html"
    wrapper.write_text(
        '<!doctype html><html><head><meta charset="utf-8"><meta name="color-scheme" content="light dark"></head><body>'
        f'<script>{_PROBE}</script>\n{frames}<pre id="found"></pre></body></html>',
        encoding="utf-8",
    )
    setting = "--blink-settings=preferredColorScheme=0" if dark else "--blink-settings=preferredColorScheme=1"
    done = _run(browser, wrapper, folder, "--window-size=1400,1000", setting, "--dump-dom")
    match = re.search(r'<pre id="found">(.*?)</pre>', done.stdout, flags=re.DOTALL)
    assert match, f"The browser must run the page's script, but wrote: {done.stderr[-2000:]}"
    return json.loads(html.unescape(match[1])), "\n".join(line for line in done.stderr.splitlines() if "CONSOLE" in line)


def screenshot(browser: str, page: Path, width: int, folder: Path, *, dark: bool) -> Path:
    """Picture of the top of a page."""
    target = folder / f"{page.stem}_{width}_{'dark' if dark else 'light'}.png"
    setting = "--blink-settings=preferredColorScheme=0" if dark else "--blink-settings=preferredColorScheme=1"
    _run(browser, page, folder, f"--window-size={width},900", setting, f"--screenshot={target}")
    return target


def print_pdf(browser: str, page: Path, folder: Path) -> Path:
    """The page on paper."""
    target = folder / f"{page.stem}.pdf"
    _run(browser, page, folder, "--no-pdf-header-footer", f"--print-to-pdf={target}")
    return target


def _shown(text: str, width: int) -> str:
    """At the width of paper the rules for paper count."""
    if width != PAPER_PX:
        return text
    # folded tables are opened by a rule that no screen has
    opened = text.replace("<details>", "<details open>")
    return opened.replace("@media print", "@media all").replace("@media screen", "@media not all")


def _run(browser: str, page: Path, folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    profile = folder / "profile"
    flags = ["--headless", "--disable-gpu", "--hide-scrollbars", "--enable-logging=stderr", f"--user-data-dir={profile}"]
    # no network: nothing has a name, and a page that asks for something is told so on the console
    flags += ["--host-resolver-rules=MAP * ~NOTFOUND", "--no-first-run"]
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        flags.append("--no-sandbox")
    return subprocess.run([browser, *flags, *options, page.as_uri()], capture_output=True, text=True, timeout=60, check=True)
