"""Plots of a calibration. Each has units, a legend and one line that says what to conclude from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .series import Convergence, RateTrace, Residuals, ResponseRun
from .table import number
from .theme import Theme, figure

__all__ = ["Drawing", "draw_convergence", "draw_cross_response", "draw_heading", "draw_rate", "draw_residuals", "draw_response"]

#: how far a residual may stray when only noise is left: 99.7 % of a normal distribution
_PULL_LIMIT = 3.0


@dataclass(frozen=True)
class Drawing:
    """A figure with its words.

    Parameters
    ----------
    name : str
        Short, unique on a page.
    title : str
        What is drawn.
    conclusion : str
        What to conclude, one line.
    figure : matplotlib Figure
        The picture.
    """

    name: str
    title: str
    conclusion: str
    figure: Any


def draw_response(runs: Sequence[ResponseRun], theme: Theme) -> Drawing:
    """Oscillator pick-off per drive volt against side-band frequency: measured points on the fitted resonance."""
    with figure(theme) as (drawn, axes):
        for run in runs:
            _draw_run(axes, run, theme, np.abs(run.direct), np.abs(run.fit_direct))
        axes.set_xlabel("side-band frequency from the carrier [Hz]")
        axes.set_ylabel("pick-off per drive [V/V]")
        axes.set_ylim(bottom=0.0)
        _legend(axes, columns=2)
    fitted = [run for run in runs if run.fit_frequency_hz.size]
    conclusion = "Points on the line: the fitted resonator explains how each oscillator answers its drive."
    if fitted:
        worst = max(_relative_misfit(run) for run in fitted)
        conclusion = (
            f"Points lie within {100 * worst:.1g} % of the fitted resonance: the model explains how each oscillator answers its drive."
        )
    return Drawing("response", "Response of the side bands", conclusion, drawn)


def draw_cross_response(runs: Sequence[ResponseRun], theme: Theme) -> Drawing:
    """Rebalance drive per oscillator volt, the part in phase with velocity: the channel that carries the rate."""
    with figure(theme) as (drawn, axes):
        for run in runs:
            _draw_run(axes, run, theme, 1e3 * run.cross.imag, 1e3 * run.fit_cross.imag)
        axes.set_xlabel("side-band frequency from the carrier [Hz]")
        axes.set_ylabel("rebalance per pick-off [mV/V]")
        _legend(axes, columns=2)
    conclusion = (
        "Height at 0 is rate and cross damping, slope is drive misalignment; the swapped run changes their signs and so tells them apart."
    )
    return Drawing("cross", "Rate channel of both runs", conclusion, drawn)


def draw_residuals(residuals: Sequence[Residuals], theme: Theme) -> Drawing:
    """Residuals of the fit over their standard deviation: colour by what oscillates, shape by pick-off."""
    colours = {"x": theme.series[0], "y": theme.series[1], "": theme.series[2]}
    lines = sorted({float(f) for s in residuals if s.oscillator for f in s.frequency_hz})
    with figure(theme) as (drawn, axes):
        axes.axhspan(-_PULL_LIMIT, _PULL_LIMIT, color=theme.grid, alpha=0.5, linewidth=0.0, label="noise alone, 99.7 %")
        for series in residuals:
            # side by side, or the series would hide each other
            place = 0.3 * ("x", "y", "").index(series.oscillator) - 0.3 + (0.1 if series.pickoff == "y" else -0.05)
            at = [lines.index(float(f)) + place if series.oscillator else len(lines) + 0.2 * place for f in series.frequency_hz]
            what = f"{series.oscillator} oscillator" if series.oscillator else "loops off"
            marker = "o" if series.pickoff == "x" else "^"
            label = f"{what}, {series.pickoff} pick-off"
            axes.plot(
                np.repeat(at, 2), series.pull.ravel(), marker, color=colours[series.oscillator], markersize=3.5, alpha=0.8, label=label
            )
        names = ["carrier" if f == 0.0 else f"{f:g}" for f in lines] + (["loops off"] if any(not s.oscillator for s in residuals) else [])
        axes.set_xticks(range(len(names)), names)
        axes.set_xlabel("side band [Hz]")
        axes.set_ylabel("residual / its standard deviation")
        _legend(axes, columns=2)
    pulls = np.concatenate([s.pull.ravel() for s in residuals]) if residuals else np.empty(0)
    return Drawing("residuals", "Residuals of the fit", _residual_conclusion(pulls), drawn)


def draw_rate(trace: RateTrace, topic: str, true_rate_deg_h: float | None, theme: Theme, *, corrected: bool) -> Drawing:
    """One rate against time with the true rate; before and after are two panels, for they differ by orders of magnitude."""
    when = "after" if corrected else "before"
    with figure(theme) as (drawn, axes):
        axes.plot(trace.time_s - trace.time_s[0], trace.rate_deg_h, color=theme.series[0 if corrected else 1], label=topic)
        if true_rate_deg_h is not None:
            axes.axhline(true_rate_deg_h, color=theme.ink, linewidth=1.2, linestyle=(0, (4, 3)), label="true rate")
        axes.set_xlabel("time [s]")
        axes.set_ylabel(f"rate, mean over {trace.window_s:g} s [deg/h]")
        _legend(axes, columns=2)
    error = float(np.mean(trace.rate_deg_h)) - (true_rate_deg_h or 0.0)
    spread = float(np.std(trace.rate_deg_h)) / max(1.0, np.sqrt(trace.rate_deg_h.size))
    what = "Mean rate" if true_rate_deg_h is None else "Mean error"
    conclusion = f"{what} {number(error, spread)} ± {spread:.2g} deg/h"
    conclusion += ": what is left is noise that averages out." if corrected else ": bias and scale factor of the device as it came."
    return Drawing(f"rate_{when}", f"Rate {when} correction", conclusion, drawn)


def draw_heading(before: RateTrace, after: RateTrace, true_rate_deg_h: float, theme: Theme) -> Drawing:
    """Size of the heading error that a navigator collects by integrating either rate."""
    errors = []
    with figure(theme) as (drawn, axes):
        for trace, topic, colour in ((before, "rate_raw", theme.series[1]), (after, "imu/data_raw", theme.series[0])):
            error_deg = np.abs(np.cumsum(trace.rate_deg_h - true_rate_deg_h)) * trace.window_s / 3600.0
            axes.plot(trace.time_s - trace.time_s[0] + trace.window_s, error_deg, color=colour, label=f"from {topic}")
            errors.append(float(error_deg[-1]))
        axes.set_yscale("log")
        axes.set_xlabel("time [s]")
        axes.set_ylabel("heading error [deg]")
        _legend(axes, columns=2)
    lasted = before.rate_deg_h.size * before.window_s
    conclusion = f"After {lasted:.0f} s at rest a navigator is {errors[0]:.2g} deg off before calibration, {errors[1]:.1g} deg after."
    return Drawing("heading", "Heading error", conclusion, drawn)


def draw_convergence(series: Sequence[tuple[str, Convergence]], name: str, title: str, theme: Theme) -> Drawing:
    """Estimate minus reference against the duration of data used, with its standard deviation as a band.

    Parameters
    ----------
    series : sequence of (label, Convergence)
        Same unit.
    name, title : str
        Of the drawing.
    theme : Theme
        Look.
    """
    unit = series[0][1].unit
    truth = series[0][1].reference_is_truth
    with figure(theme) as (drawn, axes):
        axes.axhline(0.0, color=theme.ink, linewidth=1.2, linestyle=(0, (4, 3)), label="truth" if truth else "last estimate")
        for (label, data), colour in zip(series, theme.series, strict=False):
            errors = data.value - data.reference
            axes.fill_between(data.time_s, errors - data.sd, errors + data.sd, color=colour, alpha=0.18, linewidth=0.0)
            axes.plot(data.time_s, errors, "o-", color=colour, label=f"{label}, band = 1 sd")
        spread = max(float(np.max(np.abs(data.value - data.reference) + data.sd)) for _, data in series)
        settled = min(float(data.sd[-1]) for _, data in series)
        if spread > 50.0 * settled > 0.0:
            axes.set_yscale("symlog", linthresh=10.0 ** np.ceil(np.log10(settled)))
        axes.set_xlabel("device time [s]")
        axes.set_ylabel(f"estimate − {'truth' if truth else 'last'} [{unit}]")
        _legend(axes, columns=1)
    label, last = series[0]
    error = float(last.value[-1] - last.reference)
    start = f"{label}: {number(error, float(last.sd[-1]))} {unit} from the truth" if truth else f"{label}: settled"
    return Drawing(name, title, f"{start} with a claimed sd of {last.sd[-1]:.2g} {unit} after {last.time_s[-1]:.0f} s of data.", drawn)


def _draw_run(axes: Any, run: ResponseRun, theme: Theme, measured: NDArray[np.float64], fit: NDArray[np.float64]) -> None:
    """One oscillator; alike ones lie on each other, so x is drawn wide and hollow, y narrow and full above it."""
    wide = run.axis == "x"
    colour = theme.series[0 if wide else 1]
    label = f"{run.axis} oscillator"
    if run.fit_frequency_hz.size:
        axes.plot(
            run.fit_frequency_hz, fit, color=colour, linewidth=3.2 if wide else 1.2, alpha=0.5 if wide else 1.0, label=f"{label}, fit"
        )
    hollow = {"markersize": 7.5, "markerfacecolor": "none", "markeredgewidth": 1.6} if wide else {"markersize": 4.0}
    axes.plot(run.frequency_hz, measured, "o", color=colour, label=f"{label}, measured", **hollow)


def _legend(axes: Any, columns: int) -> None:
    """Above the axes, where it hides no data."""
    axes.legend(loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=columns, borderaxespad=0.1, handlelength=1.4, columnspacing=1.2)


def _relative_misfit(run: ResponseRun) -> float:
    """Largest distance of a measured point from the fit, relative."""
    model = np.interp(run.frequency_hz, run.fit_frequency_hz, run.fit_direct.real) + 1j * np.interp(
        run.frequency_hz, run.fit_frequency_hz, run.fit_direct.imag
    )
    return float(np.max(np.abs(run.direct - model) / np.abs(model)))


def _residual_conclusion(pulls: Any) -> str:
    """Verdict on the size of the residuals."""
    if pulls.size == 0:
        return "No residual has a known standard deviation."
    rms, far = float(np.sqrt(np.mean(np.square(pulls)))), int(np.sum(np.abs(pulls) > _PULL_LIMIT))
    if rms < 1.5:
        return f"Rms {rms:.2f} of the noise, {far} of {pulls.size} beyond 3: " + (
            "the model leaves nothing systematic."
            if far <= 0.01 * pulls.size + 1
            else "nearly all is noise, but look at the few that are not."
        )
    return f"Rms {rms:.1f} of the noise: something systematic is left over; the standard deviations are too small by about that factor."
