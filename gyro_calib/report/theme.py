"""One look for every plot: colours by role, drawn for the page (follows the reader's light or dark setting) or for paper."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

from ..errors import DataError

__all__ = ["PAGE", "PAPER", "Theme", "figure", "require_matplotlib", "require_plot_suffix", "save_figure", "to_svg"]

#: width and height of one panel [inch]; text of 10 pt then stays readable when a phone shrinks the panel to its width
PANEL_INCHES = (5.0, 3.3)

#: formats that ``--plot`` writes
PLOT_SUFFIXES = (".pdf", ".png", ".svg")


@dataclass(frozen=True)
class Theme:
    """Colour of each role.

    Parameters
    ----------
    ink, muted, grid : str
        Text and axes, secondary text, grid lines.
    series : tuple of str
        Colours of data series, distinct also to colour-blind readers.
    good, bad : str
        A gate that holds, one that does not.
    background : str
        ``"none"`` for transparent.
    """

    ink: str
    muted: str
    grid: str
    series: tuple[str, str, str, str]
    good: str
    bad: str
    background: str


#: real colours on white
PAPER = Theme("#1b1f24", "#59636e", "#dfe3e8", ("#1f6feb", "#d1670a", "#0f8a6a", "#8250c4"), "#0f8a6a", "#c4352b", "#ffffff")
#: place holders that :func:`to_svg` turns into CSS variables of the page
PAGE = Theme("#010101", "#010102", "#010103", ("#010111", "#010112", "#010113", "#010114"), "#010121", "#010122", "none")

_CSS_VARIABLES = {
    PAGE.ink: "var(--ink)",
    PAGE.muted: "var(--muted)",
    PAGE.grid: "var(--grid)",
    PAGE.series[0]: "var(--s1)",
    PAGE.series[1]: "var(--s2)",
    PAGE.series[2]: "var(--s3)",
    PAGE.series[3]: "var(--s4)",
    PAGE.good: "var(--good)",
    PAGE.bad: "var(--bad)",
}


def _settings(theme: Theme) -> dict[str, Any]:
    """matplotlib settings of the look."""
    return {
        "font.size": 10.0,
        "font.family": "sans-serif",
        "axes.edgecolor": theme.muted,
        "axes.facecolor": theme.background,
        "axes.grid": True,
        "axes.axisbelow": True,
        "axes.labelcolor": theme.ink,
        "axes.linewidth": 0.8,
        "axes.spines.right": False,
        "axes.spines.top": False,
        "axes.unicode_minus": True,
        "figure.facecolor": theme.background,
        "grid.color": theme.grid,
        "grid.linewidth": 0.8,
        "legend.fontsize": 9.0,
        "legend.frameon": False,
        "legend.labelcolor": theme.ink,
        "lines.linewidth": 1.6,
        "lines.markersize": 4.5,
        "savefig.facecolor": theme.background,
        "svg.fonttype": "none",
        "svg.hashsalt": "gyro_calib",
        "text.color": theme.ink,
        "xtick.color": theme.muted,
        "xtick.labelcolor": theme.ink,
        "ytick.color": theme.muted,
        "ytick.labelcolor": theme.ink,
    }


def require_matplotlib() -> None:
    """Ask before an hour of work whether its result can be drawn.

    Raises
    ------
    DataError
        matplotlib is not installed.
    """
    if importlib.util.find_spec("matplotlib") is None:
        raise DataError("Plots need matplotlib, but it is not installed. Install it with: pip install 'gyro_calib[viz]'.")


def require_plot_suffix(path: Path) -> None:
    """Ask for the suffix of a plot file before an hour of work.

    Raises
    ------
    DataError
        The suffix is not one of :data:`PLOT_SUFFIXES`, or matplotlib is not installed.
    """
    if path.suffix.lower() not in PLOT_SUFFIXES:
        raise DataError(f"Plot file must end in {', '.join(PLOT_SUFFIXES)}, but got {path.name!r}.")
    require_matplotlib()


@contextmanager
def figure(theme: Theme, rows: int = 1, columns: int = 1, **options: Any) -> Iterator[tuple[Any, Any]]:
    """``(figure, axes)`` in the look of ``theme``; without pyplot, so nothing global is touched.

    Parameters
    ----------
    theme : Theme
        :data:`PAGE` or :data:`PAPER`.
    rows, columns : int
        Grid of axes.
    **options
        For ``Figure.subplots``.

    Raises
    ------
    DataError
        matplotlib is not installed.
    """
    require_matplotlib()
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_settings(theme)):
        drawn = Figure(figsize=(PANEL_INCHES[0] * columns, PANEL_INCHES[1]), layout="constrained")
        yield drawn, drawn.subplots(rows, columns, **options)


def to_svg(drawn: Any, name: str, description: str) -> str:
    """Inline SVG of a figure drawn with :data:`PAGE`.

    Parameters
    ----------
    drawn : matplotlib Figure
        What to write.
    name : str
        Prefix of every id inside, so that several pictures share one page.
    description : str
        What the picture shows, for readers who do not see it.

    Returns
    -------
    str
        ``<svg …>…</svg>`` that scales to the width of its container and takes its colours from the page.
    """
    import matplotlib

    stream = BytesIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        drawn.savefig(stream, format="svg", transparent=True, metadata={"Date": None})
    text = stream.getvalue().decode()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', text)
    text = re.sub(r'(url\(#|xlink:href="#)', rf"\g<1>{name}-", text)
    for colour, variable in _CSS_VARIABLES.items():
        text = text.replace(colour, variable)
    # the page's own font; the size of each text stays
    text = re.sub(r"(font: [0-9.]+px)[^;\"]*", r"\1 var(--font)", text)
    text = re.sub(r'<svg([^>]*?) width="[^"]*"', r"<svg\1", text, count=1)
    text = re.sub(r'<svg([^>]*?) height="[^"]*"', r"<svg\1", text, count=1)
    label = description.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    return text.replace("<svg", f'<svg role="img" aria-label="{label}"', 1).strip()


def save_figure(drawn: Any, path: Path) -> None:
    """Write a figure drawn with :data:`PAPER`.

    Raises
    ------
    DataError
        The suffix is not one of :data:`PLOT_SUFFIXES`, or the file cannot be written.
    """
    require_plot_suffix(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        drawn.savefig(path, dpi=150)
    except OSError as error:
        raise DataError(f"Plot file must be writable, but got {error}. Choose another path.") from error
