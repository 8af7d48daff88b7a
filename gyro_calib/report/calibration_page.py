"""The page of one calibration run, from its result; with a truth and rates when they are known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ..estimation.result import CalibrationResult
from ..quantity import Quantity
from ..recording.recording import Campaign
from ..units import DEG_H, PPM
from .comparison import Comparison, comparison_table
from .figures import Drawing, draw_convergence, draw_cross_response, draw_heading, draw_rate, draw_residuals, draw_response
from .page import Page, Panel, Tile
from .series import Convergence, RateTrace, convergence_series, residual_series, response_runs
from .table import Table, number, parameter_table, quantity_cells
from .theme import PAGE, Theme, to_svg

__all__ = ["AxisTruth", "Rates", "RunFacts", "calibration_drawings", "calibration_page", "result_table"]

KAPPA_NOTE = "The scale factor is relative to the angular gain κ (Bryant factor) of the factory data, which no self-calibration sees."


@dataclass(frozen=True)
class AxisTruth:
    """Truth with one axis as the oscillator, in the units of the result: ``bias`` [rad/s], ``scale_factor`` [V per rad/s]."""

    bias: float
    scale_factor: float


@dataclass(frozen=True)
class RunFacts:
    """What a page says about the run: ``title``, ``subtitle``, ``footer``; device time and wall time in seconds, None when not known."""

    title: str
    subtitle: str
    footer: str
    device_s: float | None = None
    elapsed_s: float | None = None


@dataclass(frozen=True)
class Rates:
    """Rates at rest after the calibration, and the true rate [deg/h] when it is known."""

    before: RateTrace
    after: RateTrace
    true_rate_deg_h: float | None = None


def result_table(result: CalibrationResult) -> Table:
    """Rate, bias and scale factor of a result, by oscillator axis, in deg/h and V per rad/s."""
    rows = [("constant input rate", *quantity_cells(in_deg_h(result.rate)))]
    for axis, bias in result.bias.items():
        rows.append((f"bias, {axis} oscillator", *quantity_cells(in_deg_h(bias))))
    for axis, scale in result.scale_factor.items():
        rows.append((f"scale factor, {axis} oscillator", *quantity_cells(scale)))
    if result.drive_chain is not None:
        channel, sd = result.mission["whole_angle"], result.mission["whole_angle"].covariance.diagonal() ** 0.5
        rows.append(("bias, whole angle", *quantity_cells(in_deg_h(Quantity(channel.bias_v, float(sd[0]), channel.unit)))))
        rows.append(("scale factor, whole angle", *quantity_cells(Quantity(channel.volts_per_rad_s, float(sd[1]), "1"))))
        for name, left in result.drive_chain.behind(result.compensation).quantities().items():
            rows.append((f"{name} behind the compensation", *quantity_cells(left)))
    return Table(f"Calibration of {result.device_id}", ("", "value", "sd", "unit"), tuple(rows))


def calibration_drawings(
    result: CalibrationResult,
    campaign: Campaign,
    theme: Theme,
    *,
    rates: Rates | None = None,
    truths: Mapping[str, AxisTruth] | None = None,
) -> list[Drawing]:
    """Every picture that the result supports.

    Parameters
    ----------
    result : CalibrationResult
        ``table``, ``convergence``, ``parameters`` are used.
    campaign : Campaign
        The recordings it comes from.
    theme : Theme
        Look.
    rates : Rates or None
        Adds before and after.
    truths : mapping of str to AxisTruth or None
        By oscillator axis; without them convergence is drawn towards the last estimate.
    """
    drawings = []
    if rates is not None:
        drawings.append(draw_rate(rates.before, "rate_raw", rates.true_rate_deg_h, theme, corrected=False))
        drawings.append(draw_rate(rates.after, "imu/data_raw", rates.true_rate_deg_h, theme, corrected=True))
        if rates.true_rate_deg_h is not None:
            drawings.append(draw_heading(rates.before, rates.after, rates.true_rate_deg_h, theme))
    for name, title in (("bias", "Convergence of the bias"), ("scale_factor", "Convergence of the scale factor")):
        series = _convergence(result, name, truths)
        if series:
            drawings.append(draw_convergence(series, f"convergence_{name}", title, theme))
    runs = response_runs(campaign, result.parameters)
    if runs:
        drawings += [draw_response(runs, theme), draw_cross_response(runs, theme)]
    residuals = residual_series(result.table)
    if any(series.pull.size for series in residuals):
        drawings.append(draw_residuals(residuals, theme))
    return drawings


def calibration_page(
    result: CalibrationResult,
    campaign: Campaign,
    facts: RunFacts,
    *,
    comparison: Comparison | None = None,
    rates: Rates | None = None,
    truths: Mapping[str, AxisTruth] | None = None,
) -> Page:
    """The whole page; parameters as :func:`calibration_drawings`, and the comparison with the truth when there is one."""
    drawings = calibration_drawings(result, campaign, PAGE, rates=rates, truths=truths)
    verdict, passed = _verdict(result, comparison)
    tables = [comparison_table(comparison)] if comparison is not None else []
    tables += [result_table(result), parameter_table(result.parameters, folded=True)]
    return Page(
        title=facts.title,
        subtitle=facts.subtitle,
        verdict=verdict,
        passed=passed,
        tiles=tuple(_tiles(result, facts, comparison, rates)),
        panels=tuple(Panel(d.title, to_svg(d.figure, d.name, f"{d.title}. {d.conclusion}"), d.conclusion) for d in drawings),
        tables=tuple(tables),
        notes=tuple(_notes(result)),
        footer=facts.footer,
    )


def in_deg_h(quantity: Quantity) -> Quantity:
    """A rate [rad/s] in deg/h."""
    return quantity.scaled(1.0 / DEG_H, "deg/h")


def _convergence(result: CalibrationResult, name: str, truths: Mapping[str, AxisTruth] | None) -> list[tuple[str, Convergence]]:
    """Bias in deg/h, or scale factor in ppm of its reference, by oscillator axis."""
    found = []
    for axis in ("x", "y"):
        estimates = getattr(result, name)
        if axis not in estimates or (truths is not None and axis not in truths):
            continue
        truth = None if truths is None else getattr(truths[axis], name)
        if name == "bias":
            scale, unit = 1.0 / DEG_H, "deg/h"
        else:
            scale, unit = 1.0 / abs(estimates[axis].value if truth is None else truth) / PPM, "ppm"
        series = convergence_series(result.convergence, name, axis, scale, unit, None if truth is None else truth * scale)
        if series is not None:
            found.append((f"{axis} oscillator", series))
    return found


def _verdict(result: CalibrationResult, comparison: Comparison | None) -> tuple[str, bool | None]:
    """One sentence, and whether it is good news."""
    if comparison is None:
        bias = in_deg_h(result.bias["x"]) if "x" in result.bias else None
        text = "Calibrated without turning the device"
        text += f": the bias is known to {bias.sd:.2g} deg/h (one standard deviation)." if bias is not None else "."
        # what only the factory can tell is missing from every calibration: no reason to doubt this one
        return text, None if [item for item in result.not_observable if "kappa" not in item] else True
    bias, scale = comparison.after_bias, comparison.after_scale_factor
    honest = abs(bias.value) <= 3.0 * bias.sd and abs(scale.value) <= 3.0 * scale.sd
    text = (
        f"A bias of {number(comparison.before_bias.value, 10.0)} deg/h is down to {number(bias.value, bias.sd)} deg/h, "
        f"a scale-factor error of {number(comparison.before_scale_factor.value, 100.0)} ppm to {number(scale.value, scale.sd)} ppm, "
        "without turning the device"
    )
    return text + (", within three claimed standard deviations." if honest else ", but outside three claimed standard deviations."), honest


def _tiles(result: CalibrationResult, facts: RunFacts, comparison: Comparison | None, rates: Rates | None) -> Sequence[Tile]:
    """Key figures."""
    tiles = []
    if comparison is not None:
        for label, before, after, digits in (
            ("Bias error", comparison.before_bias, comparison.after_bias, 1.0),
            ("Scale-factor error", comparison.before_scale_factor, comparison.after_scale_factor, 10.0),
        ):
            value, sd, unit = quantity_cells(after)
            tiles.append(Tile(label, f"{value} {unit}", f"claimed sd {sd} {unit}", f"{number(before.value, digits)} {unit}"))
    elif "x" in result.bias:
        value, sd, unit = quantity_cells(in_deg_h(result.bias["x"]))
        tiles.append(Tile("Bias, x oscillator", f"{value} {unit}", f"sd {sd} {unit}"))
    value, sd, unit = quantity_cells(in_deg_h(result.rate))
    true_rate = rates.true_rate_deg_h if rates is not None else None
    note = f"sd {sd} {unit}" if true_rate is None else f"sd {sd} {unit}, truly {number(true_rate, 1.0)} {unit}"
    tiles.append(Tile("Input rate found", f"{value} {unit}", note))
    if facts.device_s is not None:
        note = "" if facts.elapsed_s is None else f"in {facts.elapsed_s:.0f} s on this computer"
        tiles.append(Tile("Device time", f"{facts.device_s:.0f} s", note))
    return tiles


def _notes(result: CalibrationResult) -> Sequence[str]:
    """Limits first, then warnings."""
    known = any("kappa" in item for item in result.not_observable)
    return [
        *([] if known else [KAPPA_NOTE]),
        *(_sentence(f"not observable: {item}") for item in result.not_observable),
        *map(_sentence, result.warnings),
    ]


def _sentence(text: str) -> str:
    """With a capital and a full stop."""
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")
