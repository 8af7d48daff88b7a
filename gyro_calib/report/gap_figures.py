"""Pictures of a gap: where it lies, and what is left of it by channel."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..gap.gap_map import Cell
from .figures import Drawing
from .theme import PANEL_INCHES, Theme, figure

__all__ = ["draw_channels", "draw_map"]

_CHANNELS = ("amplitude", "frequency", "precession", "quadrature")
_LINES = ("mean", "line", "other")
_OPEN = ("x c", "x s", "y c", "y s")
#: rows of a map; a campaign's others are named in words
MOST_ROWS = 24
#: from which a cell counts, and where its colour is full; in units of noise
_SEEN, _FULL = 4.0, 300.0
#: how often noise alone takes a mean (one number) and a line (two) beyond that
_BY_CHANCE = {True: math.erfc(_SEEN / math.sqrt(2.0)), False: math.exp(-0.5 * _SEEN**2)}


def draw_map(cells: Sequence[Cell], rows: Sequence[str], theme: Theme, *, after: bool = False) -> Drawing:
    """Heat map, experiments x channel and line, in units of the measured noise.

    Parameters
    ----------
    cells : sequence of Cell
        Of one map.
    rows : sequence of str
        Experiments from top to bottom (:func:`rows_of`).
    theme : Theme
        Look.
    after : bool
        Whether the effects are in the model.
    """
    grid = _grid(cells, rows)
    columns = len(_CHANNELS) * len(_LINES) + len(_OPEN)
    with figure(theme) as (drawn, axes):
        drawn.set_size_inches(PANEL_INCHES[0], 1.3 + 0.19 * len(rows))
        for i in range(len(rows)):
            for k in range(columns):
                _cell(axes, k, i, grid[i, k], theme)
        axes.set_xlim(-0.5, columns - 0.5)
        axes.set_ylim(len(rows) - 0.5, -0.5)
        axes.grid(False)
        axes.set_yticks(range(len(rows)), [name if len(name) <= 20 else f"{name[:19]}…" for name in rows], fontsize=7.5)
        axes.set_xticks(range(columns), [*_LINES * len(_CHANNELS), *_OPEN], rotation=90, fontsize=7.5)
        axes.tick_params(length=0.0)
        for k, name in enumerate((*_CHANNELS, "loops off")):
            centre = 3 * k + (1.0 if k < len(_CHANNELS) else 1.5)
            axes.text(centre, -0.75, name, ha="center", va="bottom", fontsize=7.5, color=theme.muted)
            if k:
                axes.axvline(3 * k - 0.5, color=theme.muted, linewidth=0.8)
        axes.set_xlabel("figure: misfit / its noise, where it is above 4", fontsize=9.0)
    when = "after" if after else "before"
    title = "Where the gap lies, effects included" if after else "Where the gap lies, linear device"
    return Drawing(f"map_{when}", title, _map_conclusion(cells, rows, after=after), drawn)


def rows_of(cells: Sequence[Cell]) -> list[str]:
    """Experiments that a map shows: those with most of the gap, at most :data:`MOST_ROWS`, the worst first."""
    share: dict[str, float] = defaultdict(float)
    for cell in cells:
        share[cell.experiment] += cell.share
    return sorted(share, key=lambda name: -share[name])[:MOST_ROWS]


def draw_channels(before: Sequence[Cell], after: Sequence[Cell], theme: Theme) -> Drawing:
    """Root mean square misfit of each channel over its noise, before and (where there is a map of it) after."""
    sides = [("linear device", _by_channel(before), theme.series[1])]
    if after:
        sides.append(("effects included", _by_channel(after), theme.series[0]))
    names = [name for name in (*_CHANNELS, "x pick-off", "y pick-off") if name in sides[0][1]]
    width = 0.8 / len(sides)
    with figure(theme) as (drawn, axes):
        for s, (label, values, colour) in enumerate(sides):
            at = np.arange(len(names)) - 0.4 + (s + 0.5) * width
            heights = [values.get(name, 0.0) for name in names]
            axes.bar(at, heights, width=0.92 * width, color=colour, label=label)
            for x, height in zip(at, heights, strict=True):
                axes.annotate(f"{height:.2g}", (x, height), (0, 2), textcoords="offset points", ha="center", fontsize=7.5)
        axes.axhline(1.0, color=theme.ink, linewidth=1.2, linestyle=(0, (4, 3)), label="noise alone")
        highest = max(max(values.values(), default=1.0) for _, values, _ in sides)
        if highest > 5.0:
            axes.set_yscale("log")
            axes.set_ylim(0.3, 3.0 * highest)
        else:
            axes.set_ylim(0.0, 1.25 * max(highest, 1.0))
        axes.set_xticks(range(len(names)), [f"loops\noff, {name[0]}" if name.endswith("off") else name for name in names], fontsize=8.5)
        axes.grid(False, axis="x")
        axes.set_ylabel("rms misfit / noise")
        axes.legend(loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=3, borderaxespad=0.1, handlelength=1.2, columnspacing=1.0)
    worst = max(names, key=lambda name: sides[0][1][name])
    conclusion = f"Worst is {worst}: {sides[0][1][worst]:.3g} times its noise with the linear device"
    if after:
        left = max(sides[1][1].values(), default=0.0)
        conclusion += f", {sides[1][1].get(worst, 0.0):.3g} with the effects; no channel is left above {left:.3g}"
    return Drawing("channels", "Misfit by channel", conclusion + ".", drawn)


def _grid(cells: Sequence[Cell], rows: Sequence[str]) -> Any:
    """Largest misfit of what falls on one place of the picture, shape (rows, columns)."""
    grid = np.zeros((len(rows), len(_CHANNELS) * len(_LINES) + len(_OPEN)))
    place = {name: i for i, name in enumerate(rows)}
    for cell in cells:
        if cell.experiment in place:
            i, k = place[cell.experiment], _column(cell)
            grid[i, k] = max(grid[i, k], cell.left_out)
    return grid


def _column(cell: Cell) -> int:
    if cell.channel in _CHANNELS:
        return len(_LINES) * _CHANNELS.index(cell.channel) + _line(cell.feature)
    side, part = "xy".index(cell.channel[0]), int(cell.quadrature.endswith("displacement"))
    return len(_CHANNELS) * len(_LINES) + 2 * side + part


def _line(feature: str) -> int:
    """Mean, the line that was excited (or that a turning wave has from anisotropy), any other."""
    if feature == "mean":
        return 0
    if feature.endswith(" theta"):
        return 1 if abs(float(feature.split()[0]) - 4.0) < 1.0 else 2
    return 1 if feature.startswith("side band 1 ") else 2


def _cell(axes: Any, column: int, row: int, value: float, theme: Theme) -> None:
    from matplotlib.patches import Rectangle

    if value < _SEEN:
        axes.add_patch(Rectangle((column - 0.46, row - 0.44), 0.92, 0.88, facecolor=theme.grid, alpha=0.45, linewidth=0.0))
        return
    level = min(math.log(value / _SEEN) / math.log(_FULL / _SEEN), 1.0)
    axes.add_patch(Rectangle((column - 0.46, row - 0.44), 0.92, 0.88, facecolor=theme.series[1], alpha=0.25 + 0.6 * level, linewidth=0.0))
    words = f"{value:.0f}" if value < 999.5 else f"{value / 1000.0:.0f}k"
    axes.text(column, row, words, ha="center", va="center", fontsize=7.0, color=theme.ink)


def _by_channel(cells: Sequence[Cell]) -> dict[str, float]:
    """A cell holds one number of the mean, two of a line."""
    squares: dict[str, float] = defaultdict(float)
    count: dict[str, int] = defaultdict(int)
    for cell in cells:
        squares[cell.channel] += cell.z**2
        count[cell.channel] += 1 if cell.feature == "mean" else 2
    return {name: math.sqrt(square / count[name]) for name, square in squares.items()}


def _map_conclusion(cells: Sequence[Cell], rows: Sequence[str], *, after: bool) -> str:
    seen = [cell for cell in cells if cell.left_out > _SEEN]
    share: dict[str, float] = defaultdict(float)
    for cell in cells:
        share[cell.channel] += cell.share
    lines = "Line: the excited side band, or 4θ of a turning wave; c and s of loops off: in phase with velocity and with displacement. "
    hidden = [cell.left_out for cell in cells if cell.experiment not in set(rows)]
    rest = f" The {len({c.experiment for c in cells}) - len(rows)} experiments not shown reach {max(hidden):.3g}." if hidden else ""
    chance = sum(_BY_CHANCE[cell.feature == "mean"] for cell in cells)
    places = f"{len(seen)} of {len(cells)} places above 4 times their noise, by chance {chance:.1f}"
    if len(seen) <= chance + 3.0 * math.sqrt(chance) + 1.0:
        return f"{places}: {'nothing is left' if after else 'no gap'}. {lines}{rest}".strip()
    if after:
        return f"{places}: compare with the map before. {lines}{rest}".strip()
    worst = max(share, key=lambda name: share[name])
    return f"{places}; {100.0 * share[worst]:.0f} % of the gap is in {worst}: look there first. {lines}{rest}".strip()
