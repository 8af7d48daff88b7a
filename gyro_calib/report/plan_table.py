"""A plan as a table for people: what is commanded in every step, how long it settles and how long it is recorded."""

from __future__ import annotations

from ..experiments import Plan, Step
from .table import Table

__all__ = ["plan_table", "to_markdown", "with_tables"]

_HEADER = ("#", "label", "mode", "amplitude [V]", "excitation and conditions", "settle [s]", "record [s]")


def plan_table(plan: Plan) -> Table:
    """One row per step, in order."""
    rows = tuple(
        (
            str(number),
            step.label,
            step.command.mode,
            f"{step.command.setpoints.amplitude_v:.3g}" if step.command.mode != "loops_off" else "",
            "; ".join(_conditions(step)),
            f"{step.settle_s:g}",
            f"{step.duration_s:.4g}",
        )
        for number, step in enumerate(plan.steps, 1)
    )
    kept = sum(step.kept for step in plan.steps)
    return Table(f"{plan.name}: {kept} recordings, {plan.duration_s:.0f} s of device time", _HEADER, rows, " ".join(plan.left_out))


def to_markdown(table: Table) -> str:
    """The rows of a table as Markdown, without its title."""
    lines = [table.header, ("---",) * len(table.header), *table.rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines) + "\n"


def _conditions(step: Step) -> list[str]:
    excitation, setpoints = step.command.excitation, step.command.setpoints
    said = []
    if excitation.kind.endswith("modulation"):
        said.append(f"{excitation.kind.replace('_', ' ')}, {excitation.frequency_hz:g} Hz, index {excitation.index:g}")
    elif excitation.kind != "none":
        where = "absolute" if step.detuning_hz is None else f"{step.detuning_hz:+g} Hz from resonance"
        said.append(f"{excitation.kind}, axis {excitation.axis}, {excitation.volts:g} V, {where}")
    if setpoints.virtual_precession_v:
        said.append(f"virtual precession {setpoints.virtual_precession_v:+.3g} V")
    if setpoints.stiffness_v_per_v:
        said.append(f"stiffness control {setpoints.stiffness_v_per_v:+.3g} V/V")
    if setpoints.amplitude_gain_v_per_v:
        said.append(f"amplitude control {setpoints.amplitude_gain_v_per_v:+.3g} V/V")
    if step.temperature_degc is not None:
        over = f"in the first {step.temperature_ramp_s:.3g} s" if step.temperature_ramp_s else "while it settles"
        said.append(f"to {step.temperature_degc:g} degC {over}")
    if step.applied_rate:
        pairs = zip(step.applied_rate["t_s"], step.applied_rate["deg_s"], strict=True)
        said.append("rate table " + ", ".join(f"{rate:+.3g} deg/s from {t:g} s" for t, rate in pairs))
    if not step.kept:
        said.append("only to bring the wave down: not recorded")
    return said


def with_tables(text: str, tables: dict[str, str]) -> str:
    """The text with what stands between ``<!-- NAME -->`` and ``<!-- end NAME -->`` replaced."""
    for name, table in tables.items():
        begin, end = f"<!-- {name} -->\n", f"<!-- end {name} -->"
        head, _, rest = text.partition(begin)
        text = head + begin + "\n" + table + "\n" + end + rest.partition(end)[2]
    return text
