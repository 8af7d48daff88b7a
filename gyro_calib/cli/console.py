"""What a person sees: tables on stdout, progress and warnings on stderr, JSON in files."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..errors import DataError

__all__ = [
    "at_least",
    "non_negative_int",
    "positive_int",
    "print_table",
    "print_warnings",
    "progress_bar",
    "progress_lines",
    "say",
    "spinner",
    "write_json",
]


def say(text: str) -> None:
    """One line on stdout, as it is (no markup)."""
    print(text, flush=True)


def print_table(table: Any) -> None:
    """A :class:`gyro_calib.report.table.Table` on stdout."""
    from rich.console import Console

    from ..report.table import to_rich

    # a pipe or a log has no width of its own, and 80 columns would fold every figure
    console = Console(width=None if sys.stdout.isatty() else 120)
    console.print(to_rich(table, console.width))


def print_warnings(warnings: Iterable[str]) -> None:
    """Each on a line of stderr."""
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr, flush=True)


@contextmanager
def progress_bar(title: str, *, lines: bool = False) -> Iterator[Callable[[float, str], None]]:
    """A bar on stderr, gone when done; gives ``report(fraction, what)``.

    Parameters
    ----------
    title : str
        What is in progress.
    lines : bool
        Without a terminal: a line of text at each tenth instead of silence.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    console = Console(stderr=True)
    words = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    shown = -1
    with Progress(*words, TextColumn("{task.fields[what]}"), console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(title, total=1.0, what="")

        def report(fraction: float, what: str = "") -> None:
            nonlocal shown
            if not math.isfinite(fraction):
                return
            progress.update(task, completed=min(max(fraction, 0.0), 1.0), what=what)
            if lines and not console.is_terminal and int(10 * fraction) > shown:
                shown = int(10 * fraction)
                print(f"{title}: {10 * shown} % {what}".rstrip(), file=sys.stderr, flush=True)

        yield report


@contextmanager
def progress_lines(title: str) -> Iterator[None]:
    """A spinner on stderr for what has no measure; one line without a terminal."""
    if not sys.stderr.isatty():
        print(title, file=sys.stderr, flush=True)
    with spinner(title):
        yield


@contextmanager
def spinner(title: str) -> Iterator[None]:
    """A spinner on stderr for what has no measure and is short where the data are few; without a terminal nothing."""
    from rich.console import Console

    console = Console(stderr=True)
    if console.is_terminal:
        with console.status(title):
            yield
    else:
        yield


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Standard JSON (no NaN), indented; ``-`` is stdout.

    Raises
    ------
    DataError
        The file cannot be written.
    """
    text = json.dumps(document, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    if str(path) == "-":
        sys.stdout.write(text)
        return
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise DataError(f"JSON file must be writable, but got {error}. Choose another path.") from error


def at_least(lowest: int) -> Callable[[str], int]:
    """Argument type: an integer not below ``lowest``."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"must be an integer, but got {text!r}") from None
        if value < lowest:
            raise argparse.ArgumentTypeError(f"must be >= {lowest}, but got {value}")
        return value

    return parse


positive_int = at_least(1)
non_negative_int = at_least(0)
