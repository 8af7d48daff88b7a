"""One self-contained HTML page: words, key figures, pictures, tables. No network, light and dark, screen, phone and paper."""

from __future__ import annotations

import html
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import DataError
from .style import STYLE
from .table import Table

__all__ = ["Page", "Panel", "Tile", "Words", "render_page", "write_page"]


@dataclass(frozen=True)
class Tile:
    """A key figure.

    Parameters
    ----------
    label : str
        What it is.
    value : str
        The figure, with unit.
    note : str
        One line below.
    before : str
        The same figure before; empty for none.
    """

    label: str
    value: str
    note: str = ""
    before: str = ""


@dataclass(frozen=True)
class Panel:
    """A picture: ``svg`` inline, ``conclusion`` the one line to take home."""

    title: str
    svg: str
    conclusion: str


@dataclass(frozen=True)
class Words:
    """A section of sentences: ``title``, ``lines``."""

    title: str
    lines: tuple[str, ...]


@dataclass(frozen=True)
class Page:
    """Everything on a page, in order.

    Parameters
    ----------
    title, subtitle : str
        Head of the page.
    verdict : str
        The result in one sentence.
    passed : bool or None
        Colour of the verdict; None is neutral.
    tiles, panels, tables : tuple
        Parts.
    notes : tuple of str
        Warnings and limits.
    footer : str
        Where it comes from.
    words : tuple of Words
        Sections of sentences below the panels.
    """

    title: str
    subtitle: str
    verdict: str
    passed: bool | None = None
    tiles: tuple[Tile, ...] = ()
    panels: tuple[Panel, ...] = ()
    tables: tuple[Table, ...] = ()
    notes: tuple[str, ...] = ()
    footer: str = ""
    words: tuple[Words, ...] = ()


def render_page(page: Page) -> str:
    """The page as one HTML document."""
    state = {True: " good", False: " bad", None: ""}[page.passed]
    parts = [
        f'<header><p class="kind">gyro_calib</p><h1>{_text(page.title)}</h1><p class="subtitle">{_text(page.subtitle)}</p></header>',
        f'<p class="verdict{state}">{_text(page.verdict)}</p>',
        _block("tiles", [_tile(t) for t in page.tiles]),
        _block("panels", [_panel(p) for p in page.panels]),
        *(_words(w) for w in page.words),
        _words(Words("Read this too", page.notes)),
        *(_table(t) for t in page.tables),
        f"<footer>{_text(page.footer)}</footer>" if page.footer else "",
    ]
    body = "\n".join(part for part in parts if part)
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n<meta name="color-scheme" content="light dark">\n'
        f"<title>{_text(page.title)}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


def write_page(path: Path, page: Page) -> None:
    """Write the page; a reader never sees half of it.

    Raises
    ------
    DataError
        The file cannot be written.
    """
    document = render_page(page)
    try:
        _replace(path, document)
    except OSError as error:
        raise DataError(f"Page must be writable, but got {error.strerror or error} for {path}. Choose another path.") from error


def _replace(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(text)
        Path(temporary).chmod(0o644)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def _text(words: str) -> str:
    return html.escape(words, quote=True)


def _name(words: str) -> str:
    """A name that may be broken after an underscore, and nowhere else inside."""
    return _text(words).replace("_", "_<wbr>")


def _block(name: str, items: Sequence[str]) -> str:
    return f'<section class="{name}">\n' + "\n".join(items) + "\n</section>" if items else ""


def _tile(tile: Tile) -> str:
    lines = [f"before {tile.before}" if tile.before else "", tile.note]
    notes = "".join(f'<p class="note">{_text(line)}</p>' for line in lines if line)
    return f'<div class="tile"><h2>{_text(tile.label)}</h2><p class="figure">{_text(tile.value)}</p>{notes}</div>'


def _panel(panel: Panel) -> str:
    return (
        f'<figure class="panel"><h2>{_text(panel.title)}</h2><div class="plot">{panel.svg}</div>'
        f"<figcaption>{_text(panel.conclusion)}</figcaption></figure>"
    )


def _words(words: Words) -> str:
    if not words.lines:
        return ""
    items = "".join(f"<li>{_text(line)}</li>" for line in words.lines)
    return f'<section class="notes"><h2>{_text(words.title)}</h2><ul>{items}</ul></section>'


def _table(table: Table) -> str:
    kinds = [' class="words"' if k in table.words else "" for k in range(len(table.header))]
    head = "".join(f'<th scope="col"{kind}>{_text(cell)}</th>' for kind, cell in zip(kinds, table.header, strict=True))
    rows = "\n".join(
        "<tr>"
        + "".join(f'<th scope="row">{_name(c)}</th>' if k == 0 else f"<td{kinds[k]}>{_text(c)}</td>" for k, c in enumerate(row))
        + "</tr>"
        for row in table.rows
    )
    caption = f'<p class="note">{_text(table.caption)}</p>' if table.caption else ""
    grid = f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>\n{rows}\n</tbody></table></div>{caption}'
    if table.folded:
        return f"<details><summary>{_text(table.title)}</summary>{grid}</details>"
    return f'<section class="table"><h2>{_text(table.title)}</h2>{grid}</section>'
