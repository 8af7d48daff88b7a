"""The page of a diagnosis: where device and simulation differ, which effect it is, how far the gap shrinks, what to record next."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..gap.diagnosis import Diagnosis
from ..gap.gap_map import Cell
from .figures import Drawing
from .gap_figures import draw_channels, draw_map, rows_of
from .gap_tables import as_healthy_table, before_after_table, effects_table, places_table, sentences_of_next, standings_table
from .page import Page, Panel, Tile, Words, write_page
from .table import Table, number
from .theme import PAGE, Theme, to_svg

__all__ = ["gap_drawings", "gap_page", "write_gap_page"]

#: rows of the table of places
_PLACES = 12


def write_gap_page(path: Path, diagnosis: Diagnosis) -> None:
    """Write the page of a diagnosis: one HTML file that needs nothing else."""
    write_page(path, gap_page(diagnosis))


def gap_page(diagnosis: Diagnosis) -> Page:
    """Everything that the page says."""
    drawings = gap_drawings(diagnosis, PAGE)
    panels = tuple(Panel(d.title, to_svg(d.figure, d.name, f"{d.title}. {d.conclusion}"), d.conclusion) for d in drawings)
    named = ", ".join(str(item.get("name", "")) for item in diagnosis.provenance.get("inputs", ()))
    version = diagnosis.provenance.get("package_version")
    return Page(
        title=f"Gap between {diagnosis.device_id} and its simulation",
        subtitle=f"From {diagnosis.recordings} recordings{f' in {named}' if named else ''}, diagnosed in {diagnosis.elapsed_s:.0f} s.",
        verdict=diagnosis.summary,
        passed={"none": True, "effects": True, "unknown": False}.get(diagnosis.verdict),
        tiles=tuple(_tiles(diagnosis)),
        panels=panels,
        words=(Words("Next experiment", tuple(sentences_of_next(diagnosis))), *_ambiguity(diagnosis)),
        notes=tuple(_notes(diagnosis)),
        tables=tuple(_tables(diagnosis)),
        footer=" · ".join(filter(None, [f"gyro_calib {version}" if version else "gyro_calib", *_hashes(diagnosis)])),
    )


def gap_drawings(diagnosis: Diagnosis, theme: Theme) -> list[Drawing]:
    """Map before and after, and misfit by channel."""
    after: Sequence[Cell] = getattr(diagnosis, "map_after", ())
    rows = rows_of(diagnosis.map)
    drawings = [draw_map(diagnosis.map, rows, theme)]
    if after and diagnosis.effects:
        drawings.append(draw_map(after, rows, theme, after=True))
    return [*drawings, draw_channels(diagnosis.map, after if diagnosis.effects else (), theme)]


def _tiles(diagnosis: Diagnosis) -> list[Tile]:
    gap = diagnosis.gap
    found = bool(diagnosis.effects)
    tiles = []
    if found:
        closed = gap.closed_fraction
        share = f"{100.0 * closed.value:.1f} %"
        tiles.append(Tile("Gap closed, unseen experiments", share, f"sd {100.0 * closed.sd:.2g} %"))
    before = f"{gap.rms_before:.3g}" if found else ""
    tiles.append(Tile("Misfit over noise, rms", f"{gap.rms_after if found else gap.rms_before:.3g}", "1: noise alone", before))
    for kind, label, first, last in (
        ("bias", "Rate left unexplained", gap.bias_before, gap.bias_after),
        ("scale", "Bend of the scale factor", gap.scale_before, gap.scale_after),
    ):
        shown = last if found else first
        if kind in gap.untold():
            tiles.append(Tile(label, "unknown", "not told by these recordings"))
            continue
        tiles.append(
            Tile(
                label,
                f"{number(shown.value, max(shown.sd, 1e-2))} {shown.unit}",
                f"sd {shown.sd:.2g} {shown.unit}",
                f"{number(first.value, max(first.sd, 1e-2))} {first.unit}" if found else "",
            )
        )
    return tiles


def _tables(diagnosis: Diagnosis) -> list[Table]:
    return [
        effects_table(diagnosis),
        before_after_table(diagnosis),
        as_healthy_table(diagnosis),
        places_table(diagnosis, _PLACES),
        standings_table(diagnosis),
    ]


def _ambiguity(diagnosis: Diagnosis) -> tuple[Words, ...]:
    lines = [
        f"{e.name} cannot be told from {', '.join(name for name in e.group if name != e.name)} with these recordings: "
        f"the probability of {100.0 * e.probability:.1f} % is that of the group."
        for e in diagnosis.effects
        if len(e.group) > 1
    ]
    harmless = [e.name for e in diagnosis.effects if e.harmless]
    lines += [f"{name} is present, but moves neither bias nor scale factor by more than their noise." for name in harmless]
    words = [Words("What the data cannot tell apart", tuple(lines))] if lines else []
    if (unknown := diagnosis.unknown) is not None:
        said = f"What is not in the catalogue acts {unknown.words()}; the nearest known effect is {unknown.nearest or 'none'}."
        words.append(Words("What is not in the catalogue", (said,)))
    return tuple(words)


def _notes(diagnosis: Diagnosis) -> list[str]:
    notes = list(diagnosis.warnings)
    if diagnosis.not_testable:
        notes.append(f"Not testable with these recordings: {', '.join(diagnosis.not_testable)}.")
    for effect in diagnosis.effects:
        notes.append(f"{effect.name}: {effect.title[:1].lower()}{effect.title[1:]}; or anything these data cannot tell from it.")
    return notes


def _hashes(diagnosis: Diagnosis) -> list[str]:
    fleet = diagnosis.provenance.get("fleet")
    read = [*diagnosis.provenance.get("inputs", ()), *([{**fleet, "name": f"judged beside the fleet of {fleet['name']}"}] if fleet else [])]
    return [f"{item.get('name')}: sha256 {str(item.get('sha256', ''))[:16]}" for item in read]
