"""Plots of noise and of studies: Allan deviation, distributions over seeds."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..estimation.allan import AllanAnalysis
from ..quantity import Quantity
from ..units import DEG_H, deg_rth
from .figures import Drawing
from .series import RateTrace
from .table import Table, number, quantity_cells
from .theme import Theme, figure

__all__ = ["allan_table", "draw_allan", "draw_distributions", "draw_rest"]

#: name in the analysis -> (words, display unit, display units per SI unit)
_COEFFICIENTS = {
    "angle_noise": ("white angle noise", "arcsec", 180.0 / np.pi * 3600.0),
    "angle_random_walk": ("angle random walk", "deg/√h", deg_rth(1.0)),
    "bias_instability": ("bias instability", "deg/h", 1.0 / DEG_H),
    "rate_random_walk": ("rate random walk", "deg/h/√h", 60.0 / DEG_H),
}


def allan_quantities(analysis: AllanAnalysis) -> dict[str, Quantity]:
    """The four coefficients in the units of data sheets: arcsec, deg/√h, deg/h, deg/h/√h."""
    return {name: analysis.coefficients[name].scaled(factor, unit) for name, (_, unit, factor) in _COEFFICIENTS.items()}


def allan_table(analysis: AllanAnalysis) -> Table:
    """Coefficients with sd; one that the data do not show is given as its 95 % upper limit."""
    rows = []
    for name, quantity in allan_quantities(analysis).items():
        words, unit, factor = _COEFFICIENTS[name]
        if name in analysis.not_observable:
            rows.append((words, f"< {analysis.upper_limits[name] * factor:.2g}", "95 % limit", unit))
        else:
            rows.append((words, *quantity_cells(quantity)))
    tau, lowest = analysis.curve.minimum()
    rows.append((f"lowest deviation, at {tau:.3g} s", *quantity_cells(lowest.scaled(1.0 / DEG_H, "deg/h"))))
    misfit = f"misfit of the noise model {analysis.chi_square_per_dof:.2g} (1 = fits)"
    caption = f"{number(analysis.duration_s)} s at {analysis.sample_rate_hz:g} Hz, fitted from {analysis.min_tau_s:.3g} s; {misfit}."
    return Table("Noise from the Allan deviation", ("", "value", "sd", "unit"), tuple(rows), caption=caption)


def draw_allan(analysis: AllanAnalysis, theme: Theme) -> Drawing:
    """Allan deviation with its confidence band and the fitted model."""
    curve = analysis.curve
    fine = np.geomspace(analysis.min_tau_s, curve.tau_s[-1], 200)
    shaped = curve.tau_s < analysis.min_tau_s
    with figure(theme) as (drawn, axes):
        band = f"{100 * curve.confidence:g} % interval"
        axes.fill_between(
            curve.tau_s, curve.lower / DEG_H, curve.upper / DEG_H, color=theme.series[0], alpha=0.2, linewidth=0.0, label=band
        )
        axes.plot(curve.tau_s[~shaped], curve.deviation[~shaped] / DEG_H, "o", color=theme.series[0], label="overlapping Allan deviation")
        if shaped.any():
            look = {"color": theme.series[0], "markerfacecolor": "none", "label": "shaped by the filter"}
            axes.plot(curve.tau_s[shaped], curve.deviation[shaped] / DEG_H, "o", **look)
        axes.plot(fine, analysis.model_deviation(fine) / DEG_H, color=theme.series[1], label="fitted noise model")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel("averaging time τ [s]")
        axes.set_ylabel("Allan deviation [deg/h]")
        axes.legend(loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=2, borderaxespad=0.1, handlelength=1.4)
    walk = allan_quantities(analysis)["angle_random_walk"]
    value, sd, unit = quantity_cells(walk)
    tau, lowest = curve.minimum()
    conclusion = f"Angle random walk {value} ± {sd} {unit}; averaging helps up to {tau:.0f} s, down to {lowest.value / DEG_H:.2g} deg/h."
    if "angle_random_walk" in analysis.not_observable:
        conclusion = f"Averaging helps up to {tau:.0f} s, down to {lowest.value / DEG_H:.2g} deg/h."
    return Drawing("allan", "Allan deviation", conclusion, drawn)


def draw_rest(trace: RateTrace, theme: Theme) -> Drawing:
    """The rate that the deviation is of, as means over a window, mean taken off: drift and jumps that a deviation only hints at."""
    mean = float(np.mean(trace.rate_deg_h))
    with figure(theme) as (drawn, axes):
        axes.axhline(0.0, color=theme.ink, linewidth=1.2, linestyle=(0, (4, 3)), label="mean of all")
        axes.plot(
            trace.time_s - trace.time_s[0], trace.rate_deg_h - mean, color=theme.series[0], label=f"rate, means over {trace.window_s:.3g} s"
        )
        axes.set_xlabel("time [s]")
        axes.set_ylabel("rate − mean [deg/h]")
        axes.legend(loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=2, borderaxespad=0.1, handlelength=1.4)
    half = trace.rate_deg_h.size // 2
    first, last = trace.rate_deg_h[:half], trace.rate_deg_h[half:]
    sd = float(np.hypot(np.std(first) / np.sqrt(max(first.size, 1)), np.std(last) / np.sqrt(max(last.size, 1))))
    moved = float(np.mean(last) - np.mean(first)) if half else 0.0
    steady = abs(moved) <= 3.0 * sd
    conclusion = f"Second half minus first half {number(moved, sd)} ± {sd:.2g} deg/h: "
    conclusion += "noise that averages out." if steady else "it wanders, the right end of the Allan deviation says by how much."
    return Drawing("rest", f"Rate at rest, mean {number(mean, sd)} deg/h taken off", conclusion, drawn)


def draw_distributions(figures: Mapping[str, NDArray[np.float64]], title: str, conclusion: str, theme: Theme) -> Drawing:
    """Every figure of a study over its seeds, sorted, one axis each: median and spread at a glance.

    Parameters
    ----------
    figures : mapping of str to ndarray, shape (n,)
        Figures by name.
    title, conclusion : str
        Words.
    theme : Theme
        Look.
    """
    names = list(figures)
    with figure(theme, 1, len(names), squeeze=False) as (drawn, grid):
        for axes, name in zip(grid[0], names, strict=True):
            values = np.sort(figures[name][np.isfinite(figures[name])])
            share = 100.0 * (np.arange(values.size) + 0.5) / max(1, values.size)
            axes.plot(values, share, "o", color=theme.series[0], label="one seed each")
            if values.size:
                axes.axvline(float(np.median(values)), color=theme.series[1], label="median")
            axes.set_xlabel(name)
            axes.set_ylim(0.0, 100.0)
        grid[0][0].set_ylabel("share of seeds below [%]")
        grid[0][0].legend(loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=2, borderaxespad=0.1)
    return Drawing("study", title, conclusion, drawn)
