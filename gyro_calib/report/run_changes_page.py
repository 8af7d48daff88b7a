"""Runs of one device beside each other: table, pictures, page."""

from __future__ import annotations

import math

import numpy as np

from ..calibration.run_changes import SIGNIFICANT, RunChange, RunChanges
from ..quantity import Quantity
from ..units import DEG_H, PPM
from .figures import Drawing
from .page import Page, Panel, Tile, Words
from .table import Table, number, quantity_cells
from .theme import PAGE, Theme, figure, to_svg

__all__ = ["run_changes_drawings", "run_changes_page", "run_changes_table"]

#: a difference over its sd is drawn up to here, an arrow marks what lies beyond
_PULL_SHOWN = 12.0
#: figures drawn, those that moved most
_MOST_PULLS = 16
RATE_NOTE = "The input rate is not the device's: it may differ between runs, and with it the elements A xy and A yx, which hold it."
COMMON_NOTE = (
    "The sd of a change takes the runs as independent. What they share, such as the drive-gain ratio of the factory data, cancels in the "
    "change: a true change of the scale factor may be seen better than its sd says."
)


def run_changes_table(changes: RunChanges) -> Table:
    """First and last run and the change, in deg/h and ppm."""
    rows: list[tuple[str, ...]] = []
    for entry in changes.figures:
        shown = _displayed(entry)
        first, last = (number(q.value, q.sd) for q in (shown.values[0], shown.values[-1]))
        value, sd, unit = quantity_cells(shown.change)
        rows.append((_words(entry.name), first, last, value, sd, unit, _times(entry)))
    runs = changes.records
    temperatures = [runs[k].temperature_degc for k in (0, -1)]
    warmer = temperatures[1].value - temperatures[0].value
    rows.append(("temperature", *(f"{t.value:.2f}" for t in temperatures), number(warmer, 0.1), "", "K", ""))
    caption = f"First: {runs[0].record_id}. Last: {runs[-1].record_id}."
    header = ("", "first", "last", "change", "sd of change", "unit", "change / sd")
    return Table(f"Runs of {changes.device_id}", header, tuple(rows), caption=caption)


def run_changes_drawings(changes: RunChanges, theme: Theme) -> list[Drawing]:
    """Bias and scale factor over the runs, every figure's change over its sd, temperature of the runs."""
    return [
        _draw_over_runs(changes, "bias", theme),
        _draw_over_runs(changes, "scale_factor", theme),
        _draw_temperature(changes, theme),
        _draw_pulls(changes, theme),
    ]


def run_changes_page(changes: RunChanges, footer: str) -> Page:
    """The whole page of a comparison of runs."""
    drawings = run_changes_drawings(changes, PAGE)
    runs = changes.records
    listed = Table(
        "Runs, oldest first",
        ("record", "made [UTC]", "method", "mode", "temperature [degC]"),
        tuple((r.record_id, f"{r.created:%Y-%m-%d %H:%M}", r.method, r.mode, f"{r.temperature_degc.value:.2f}") for r in runs),
    )
    return Page(
        title=f"Calibrations of {changes.device_id} compared",
        subtitle=f"{len(runs)} runs from {runs[0].created:%Y-%m-%d %H:%M} to {runs[-1].created:%Y-%m-%d %H:%M} UTC.",
        verdict=verdict(changes),
        passed=not changes.moved,
        tiles=tuple(_tile(changes.figure(name), label) for name, label in (("bias", "Bias"), ("scale_factor", "Scale factor"))),
        panels=tuple(Panel(d.title, to_svg(d.figure, d.name, f"{d.title}. {d.conclusion}"), d.conclusion) for d in drawings),
        tables=(run_changes_table(changes), listed, _parameter_changes(changes)),
        notes=(*changes.cautions, COMMON_NOTE, RATE_NOTE),
        footer=footer,
        words=(Words("What to do", (_advice(changes),)),),
    )


def verdict(changes: RunChanges) -> str:
    """One sentence: what moved from the first run to the last."""
    bias, scale = (_displayed(changes.figure(name)).change for name in ("bias", "scale_factor"))
    sizes = (
        f"From the first run to the last the bias moved by {number(bias.value, bias.sd)} ± {bias.sd:.2g} {bias.unit}, "
        f"the scale factor by {number(scale.value, scale.sd)} ± {scale.sd:.2g} {scale.unit}."
    )
    if not changes.moved:
        return f"The runs agree within three standard deviations. {sizes}"
    return f"More than noise: the {' and the '.join(_words(entry.name) for entry in changes.moved)}. {sizes}"


def _advice(changes: RunChanges) -> str:
    if not changes.moved:
        return "Nothing: the calibration in force holds as well as any of these."
    if any("degC" in caution for caution in changes.cautions):
        return "Calibrate at the temperature of use; repeat a run at the first temperature to tell ageing from temperature."
    return "Keep the newest record in force and calibrate again soon: what moved once without a change of temperature is ageing or a shock."


def _displayed(entry: RunChange) -> RunChange:
    """In the units that a person reads; scale factors as ppm from the first run."""
    first = entry.values[0]
    if entry.name.startswith("scale_factor"):
        shares = [((q.value / first.value - 1.0) / PPM, q.sd / abs(first.value) / PPM) for q in entry.values]
        return RunChange(entry.name, tuple(Quantity(value, sd, "ppm") for value, sd in shares))
    if first.unit.startswith("rad/s"):
        return RunChange(entry.name, tuple(q.scaled(1.0 / DEG_H, first.unit.replace("rad/s", "deg/h")) for q in entry.values))
    return entry


def _draw_over_runs(changes: RunChanges, name: str, theme: Theme) -> Drawing:
    """Figure of every run with its sd, from the first run on."""
    shown = _displayed(changes.figure(name))
    start, change = shown.values[0].value, shown.change
    at = np.arange(1, len(shown.values) + 1)
    with figure(theme) as (drawn, axes):
        values, spread = (np.array([getattr(q, part) for q in shown.values]) for part in ("value", "sd"))
        axes.axhline(0.0, color=theme.ink, linewidth=1.2, linestyle=(0, (4, 3)), label="first run")
        axes.errorbar(at, values - start, yerr=spread, fmt="o-", color=theme.series[0], capsize=3.0, label="run, bar = 1 sd")
        _run_axis(axes, at.size)
        axes.set_ylabel(f"{_words(name)} − first [{change.unit}]")
        axes.legend(loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=2, borderaxespad=0.1, handlelength=1.4)
    held = abs(shown.pull) <= SIGNIFICANT
    conclusion = f"Last minus first {number(change.value, change.sd)} ± {change.sd:.2g} {change.unit}: "
    conclusion += "no more than the runs' own noise." if held else f"{abs(shown.pull):.1f} standard deviations, it moved."
    return Drawing(f"runs_{name}", f"{_words(name).capitalize()} over the runs", conclusion, drawn)


def _draw_temperature(changes: RunChanges, theme: Theme) -> Drawing:
    found = [r.temperature_degc for r in changes.records]
    at = np.arange(1, len(found) + 1)
    with figure(theme) as (drawn, axes):
        values = np.array([q.value for q in found])
        spread = np.array([q.sd if math.isfinite(q.sd) else 0.0 for q in found])
        axes.errorbar(at, values, yerr=spread, fmt="o-", color=theme.series[2], capsize=3.0, label="mean of the run, bar = its spread")
        _run_axis(axes, at.size)
        axes.set_ylabel("temperature [degC]")
        axes.legend(loc="lower left", bbox_to_anchor=(-0.02, 1.0), borderaxespad=0.1, handlelength=1.4)
    span = float(np.ptp(values))
    conclusion = f"The runs lie within {span:.2g} K: " + (
        "temperature explains no change." if span <= 1.0 else "look here first for the cause of a change."
    )
    return Drawing("runs_temperature", "Temperature of the runs", conclusion, drawn)


def _draw_pulls(changes: RunChanges, theme: Theme) -> Drawing:
    """Every figure's and parameter's change over its sd: which part of the device moved."""
    known = [e for e in (*changes.figures, *changes.parameters) if math.isfinite(e.pull) and e.name != "rate"]
    entries = sorted(known, key=lambda e: -abs(e.pull))[:_MOST_PULLS]
    pulls = np.clip([e.pull for e in entries], -_PULL_SHOWN, _PULL_SHOWN)
    with figure(theme) as (drawn, axes):
        axes.axvspan(-SIGNIFICANT, SIGNIFICANT, color=theme.grid, alpha=0.5, linewidth=0.0, label="noise alone, 99.7 %")
        colours = [theme.bad if abs(e.pull) > SIGNIFICANT else theme.series[0] for e in entries]
        axes.barh(range(len(entries)), pulls, color=colours, height=0.7, label="last minus first")
        axes.set_yticks(range(len(entries)), [_words(e.name) for e in entries], fontsize=8.0)
        axes.set_ylim(len(entries) - 0.4, -0.6)
        axes.set_xlim(-_PULL_SHOWN, _PULL_SHOWN)
        axes.grid(False, axis="y")
        axes.set_xlabel(f"change / its standard deviation (drawn up to {_PULL_SHOWN:g})")
        legend = axes.legend(loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=2, borderaxespad=0.1, handlelength=1.4)
        legend.legend_handles[-1].set_color(theme.series[0])
    beyond = [e for e in known if abs(e.pull) > SIGNIFICANT]
    conclusion = f"{len(beyond)} of {len(known)} figures and parameters moved by more than three standard deviations"
    conclusion += f", most {', '.join(_words(e.name) for e in entries[:3])}." if beyond else ": the device is the same."
    return Drawing("runs_pulls", "What moved", conclusion, drawn)


def _parameter_changes(changes: RunChanges) -> Table:
    rows = []
    for entry in changes.parameters:
        value, sd, unit = quantity_cells(entry.change)
        first, last = (number(q.value, q.sd) for q in (entry.values[0], entry.values[-1]))
        rows.append((entry.name, first, last, value, sd, unit, _times(entry)))
    header = ("parameter", "first", "last", "change", "sd of change", "unit", "change / sd")
    return Table("Fitted parameters", header, tuple(rows), folded=True)


def _tile(entry: RunChange, label: str) -> Tile:
    shown = _displayed(entry)
    value, sd, unit = quantity_cells(shown.change)
    return Tile(f"{label}, last − first", f"{value} {unit}", f"sd {sd} {unit}, {_times(entry) or 'unknown'} sd")


def _times(entry: RunChange) -> str:
    return number(entry.pull, 1.0) if math.isfinite(entry.pull) else ""


def _run_axis(axes: object, count: int) -> None:
    axes.set_xlim(0.5, count + 0.5)  # type: ignore[attr-defined]
    axes.set_xticks(range(1, count + 1))  # type: ignore[attr-defined]
    axes.set_xlabel("run, oldest first")  # type: ignore[attr-defined]


def _words(name: str) -> str:
    return name.replace("scale_factor_", "scale factor, ").replace("bias_", "bias, ").replace("_", " ")
