"""The drop-one analysis as a table: a row per source, a column per figure."""

from __future__ import annotations

from ..estimation.drop_one import DropOne
from ..units import DEG_H
from .table import Table, number

__all__ = ["drop_one_table"]


def drop_one_table(found: DropOne) -> Table:
    """Changes in deg/h (rate, bias) and ppm (scale factors), with the sd that each should have and the growth of the figure's own."""
    rows = []
    for left in found.left_out:
        cells = []
        for name, figure in found.figures.items():
            if left.refused:
                cells.append("no estimate")
                continue
            unit = DEG_H if figure.unit == "rad/s" else 1e-6 * abs(figure.value)
            change = left.change[name]
            value, sd = change.value / unit, change.sd / unit
            cells.append(f"{number(value, sd)} ± {sd:.2g}, sd × {left.growth[name]:.2f}")
        rows.append((left.source, *cells, "" if left.refused else f"{left.chi2_per_dof:.2f}"))
    caption = "Change of each figure without the source [deg/h, ppm], and by how much its sd grows."
    against = "; ".join(
        f"{name} by {', '.join(d.source for d in group)}" for name in found.figures if (group := found.contradicted_by(name))
    )
    if against:
        caption += f" Contradicted: {against}."
    if found.misfit_of is not None:
        caption += f" The model does not fit the {found.misfit_of.source}: χ²/dof {found.chi2_per_dof:.2f} with it."
    return Table("Drop-one analysis", ("without", *found.figures, "χ²/dof"), tuple(rows), caption=caption)
