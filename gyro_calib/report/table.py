"""Tables for people, once: the terminal and the page render the same rows. Numbers carry as many digits as their uncertainty allows."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..quantity import Quantity

__all__ = ["Table", "number", "parameter_table", "quantity_cells", "to_rich"]

#: what a column takes of a line beside its cells: a space to each side, and one between columns
_BESIDE = 3
#: what is left of a word that must be broken, at least
_PIECE = 4
#: spaces but those of a value with its standard deviation
_AROUND = re.compile("(?<!±) (?!±)")
#: how a cell begins that is a number, whatever follows it
_NUMBER = re.compile(r"[−+<>≤≥-]?\s*[\d∞]")


@dataclass(frozen=True)
class Table:
    """Rows of text.

    Parameters
    ----------
    title : str
        Heading.
    header : tuple of str
        One cell per column.
    rows : tuple of tuple of str
        Cells; columns after the first are aligned as numbers, unless none of their cells begins with one (:attr:`words`).
    caption : str
        One line below.
    folded : bool
        On a page, starts closed.
    optional : tuple of int
        Columns that a narrow terminal may leave out, the least important first.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    folded: bool = False
    optional: tuple[int, ...] = ()

    @property
    def words(self) -> frozenset[int]:
        """Columns after the first that hold words: aligned left, and wrapped where there is no room."""
        return frozenset(k for k in range(1, len(self.header)) if not any(_NUMBER.match(row[k]) for row in self.rows if k < len(row)))


def number(value: float, sd: float = 0.0) -> str:
    """``value`` to the second significant digit of ``sd``, or to six significant digits; thin spaces between thousands, a true minus sign.

    >>> number(1215.3421, 0.62)
    '1 215.34'
    """
    if not math.isfinite(value):
        return "not observable" if math.isnan(value) else str(value).replace("inf", "∞")
    digits = 6
    if math.isfinite(sd) and sd > 0.0:
        places = 1 - math.floor(math.log10(sd))
        # + 0.0: a zero has no sign
        value = round(value, places) + 0.0
        digits = min(max(math.floor(math.log10(abs(value))) + places + 1, 1), digits) if value else 1
        text = f"{value:,.{max(0, min(places, 12))}f}" if abs(value) < 1e12 else f"{value:.{digits}g}"
    else:
        text = f"{value:.6g}"
    if len(text.lstrip("-")) > 13 or text.lstrip("-").startswith("0.00000"):
        text = f"{value:.{digits}g}"
    return text.replace(",", "\u202f").replace("-", "−")


def quantity_cells(quantity: Quantity) -> tuple[str, str, str]:
    """``(value, sd, unit)``; an infinite sd reads "not observable"."""
    if math.isinf(quantity.sd):
        return number(quantity.value), "not observable", quantity.unit
    return number(quantity.value, quantity.sd), f"{quantity.sd:.2g}".replace("-", "−"), quantity.unit


def parameter_table(parameters: Mapping[str, Quantity], title: str = "Fitted parameters", *, folded: bool = False) -> Table:
    """One row per named quantity."""
    rows = tuple((name, *quantity_cells(quantity)) for name, quantity in parameters.items())
    return Table(title, ("parameter", "value", "sd", "unit"), rows, folded=folded)


def to_rich(table: Table, width: int | None = None) -> Any:
    """The table for a terminal, as a ``rich.table.Table``.

    Parameters
    ----------
    table : Table
    width : int, optional
        Of the terminal: cells are broken between words only, and optional columns left out, where that is room enough; nothing is cut.
    """
    from rich import box
    from rich.table import Table as RichTable
    from rich.text import Text

    shown, widths = _columns(table, width)
    without = ", ".join(table.header[k] for k in range(len(table.header)) if k not in shown)
    said = " ".join(filter(None, [table.caption, f"No room here for: {without}." if without else ""]))
    # as Text, or rich would take units in brackets for markup
    title, caption = Text(table.title, style="bold"), Text(said)
    drawn = RichTable(title=title if table.title else None, caption=caption if said else None, box=box.SIMPLE_HEAD)
    drawn.title_justify = drawn.caption_justify = "left"
    for k in shown:
        cell = Text(_folded(table.header[k], widths[k]))
        drawn.add_column(cell, justify="left" if k == 0 or k in table.words else "right", width=widths[k], overflow="fold")
    for row in table.rows:
        drawn.add_row(*(Text(_folded(row[k], widths[k])) for k in shown if k < len(row)))
    return drawn


def _columns(table: Table, width: int | None) -> tuple[list[int], dict[int, int]]:
    """Columns to show and their widths."""
    shown = list(range(len(table.header)))
    cells = {k: [table.header[k], *(row[k] for row in table.rows if k < len(row))] for k in shown}
    widths = {k: max(map(len, column)) for k, column in cells.items()}
    if width is None:
        return shown, widths
    longest = {k: max(len(word) for cell in column for word in cell.split(" ")) for k, column in cells.items()}
    for k in table.optional:
        if sum(longest[j] + _BESIDE for j in shown) < width:
            break
        shown.remove(k)
    room = width - 1 - _BESIDE * len(shown)
    widths = {k: widths[k] for k in shown}
    of_words = table.words | {0}
    # the widest gives first, down to its longest word; where that is not enough words are broken, and figures last
    for least in (longest, {k: _PIECE if k in of_words else longest[k] for k in shown}, dict.fromkeys(shown, 1)):
        while sum(widths.values()) > room and (wide := [k for k in shown if widths[k] > least[k]]):
            widths[max(wide, key=lambda k: widths[k])] -= 1
    return shown, widths


def _folded(cell: str, width: int) -> str:
    """The cell in lines of a width, broken at spaces, before a standard deviation only if its value fills the line."""
    words = _AROUND.split(cell)
    if any(len(word) > width for word in words):
        words = [word[k : k + width] for word in cell.split(" ") for k in range(0, max(len(word), 1), width)]
    lines = [words[0]]
    for word in words[1:]:
        if len(lines[-1]) + 1 + len(word) <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return "\n".join(lines)
