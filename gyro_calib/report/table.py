"""Tables for people, once: the terminal and the page render the same rows. Numbers carry as many digits as their uncertainty allows."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..quantity import Quantity

__all__ = ["Table", "number", "parameter_table", "quantity_cells", "to_rich"]

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
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    folded: bool = False

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
    if math.isfinite(sd) and sd > 0.0:
        places = 1 - math.floor(math.log10(sd))
        # + 0.0: a zero has no sign
        text = f"{round(value, places) + 0.0:,.{max(0, min(places, 12))}f}" if abs(value) < 1e12 else f"{value:.6g}"
    else:
        text = f"{value:.6g}"
    if len(text.lstrip("-")) > 13 or text.lstrip("-").startswith("0.00000"):
        text = f"{value:.6g}"
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


def to_rich(table: Table) -> Any:
    """The table for a terminal, as a ``rich.table.Table``."""
    from rich import box
    from rich.table import Table as RichTable
    from rich.text import Text

    # as Text, or rich would take units in brackets for markup
    title, caption = Text(table.title, style="bold"), Text(table.caption)
    drawn = RichTable(title=title if table.title else None, caption=caption if table.caption else None, box=box.SIMPLE_HEAD)
    drawn.title_justify = drawn.caption_justify = "left"
    for k, cell in enumerate(table.header):
        drawn.add_column(Text(cell), justify="left" if k == 0 or k in table.words else "right", no_wrap=k == 0)
    for row in table.rows:
        drawn.add_row(*map(Text, row))
    return drawn
