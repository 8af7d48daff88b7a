"""The page of an Allan deviation: how noisy the rate is, and up to which averaging time averaging helps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..estimation.allan import AllanAnalysis
from ..units import DEG_H
from .noise_figures import allan_quantities, allan_table, draw_allan, draw_rest
from .page import Page, Panel, Tile
from .series import averaged
from .table import Table, quantity_cells
from .theme import PAGE, to_svg

__all__ = ["allan_page"]

#: chi-square per degree of freedom above which the coefficients mean little
MISFIT = 4.0
#: means drawn of a rate
_WINDOWS = 400


def allan_page(analysis: AllanAnalysis, rate_rad_s: NDArray[np.float64], title: str, subtitle: str, footer: str) -> Page:
    """Key figures, the curve, the rate itself, the coefficients.

    Parameters
    ----------
    analysis : AllanAnalysis
        What was found.
    rate_rad_s : ndarray, shape (n,)
        The rate that it is of [rad/s].
    title, subtitle, footer : str
        Words.
    """
    fits = analysis.chi_square_per_dof <= MISFIT
    time_s = np.arange(rate_rad_s.size) / analysis.sample_rate_hz
    window_s = max(1.0 / analysis.sample_rate_hz, analysis.duration_s / _WINDOWS)
    drawings = [draw_allan(analysis, PAGE), draw_rest(averaged(time_s, rate_rad_s, window_s), PAGE)]
    return Page(
        title=title,
        subtitle=subtitle,
        verdict=drawings[0].conclusion
        if fits
        else f"The noise model misses the curve {analysis.chi_square_per_dof:.1f}-fold: read the curve.",
        passed=None if fits else False,
        tiles=tuple(_tiles(analysis)),
        panels=tuple(Panel(d.title, to_svg(d.figure, d.name, f"{d.title}. {d.conclusion}"), d.conclusion) for d in drawings),
        tables=(allan_table(analysis), _curve_table(analysis)),
        notes=tuple(_notes(analysis, fits)),
        footer=footer,
    )


def _tiles(analysis: AllanAnalysis) -> list[Tile]:
    quantities = allan_quantities(analysis)
    tiles = []
    for name, label in (("angle_random_walk", "Angle random walk"), ("bias_instability", "Bias instability")):
        if name not in analysis.not_observable:
            value, sd, unit = quantity_cells(quantities[name])
            tiles.append(Tile(label, f"{value} {unit}", f"sd {sd} {unit}"))
    tau, lowest = analysis.curve.minimum()
    value, sd, unit = quantity_cells(lowest.scaled(1.0 / DEG_H, "deg/h"))
    tiles.append(Tile("Lowest deviation", f"{value} {unit}", f"averaged over {tau:.3g} s, sd {sd} {unit}"))
    return tiles


def _notes(analysis: AllanAnalysis, fits: bool) -> list[str]:
    notes = [
        f"{name.replace('_', ' ').capitalize()} does not show in these data: its 95 % limit is given." for name in analysis.not_observable
    ]
    if not fits:
        notes.append("The coefficients are not to be trusted: the noise is none of white angle, white rate, flicker and random walk.")
    return notes


def _curve_table(analysis: AllanAnalysis) -> Table:
    curve = analysis.curve
    rows = tuple(
        tuple(f"{value:.4g}" for value in (tau, *(np.array([deviation, lower, upper]) / DEG_H), edf))
        for tau, deviation, lower, upper, edf in zip(curve.tau_s, curve.deviation, curve.lower, curve.upper, curve.edf, strict=True)
    )
    share = f"{100 * curve.confidence:g} %"
    header = ("averaging time [s]", "deviation [deg/h]", f"{share} from", "to", "degrees of freedom")
    return Table("The curve", header, rows, folded=True)
