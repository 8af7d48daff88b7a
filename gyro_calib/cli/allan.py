"""Allan deviation of a rate, with confidence intervals and noise coefficients.

RECORDING is an HDF5 file or a ROS 2 bag (the longest recording at rest is used, or the one named by --label), or a text file with one rate
per line (--rate-hz and --unit say what it is, --column picks one of several columns). At rest is a force-rebalance recording without
excitation, or one of a free wave of a whole-angle gyro.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .console import print_table, print_warnings, progress_bar, say, spinner, write_json
from .outputs import check_outputs

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ..estimation.allan import AllanAnalysis
    from ..recording.recording import Recording

_TEXT_SUFFIXES = {".txt", ".csv", ".dat", ".tsv"}
#: rad/s per unit
_UNITS = {"rad/s": 1.0, "deg/s": math.pi / 180.0, "deg/h": math.pi / 180.0 / 3600.0}


#: a recording whose temperature moves more shows the temperature, not the noise [K]
_STEADY_K = 1.0


@dataclass(frozen=True)
class RateRecord:
    """A rate to analyse: samples [rad/s], their rate [Hz], and where they come from."""

    rate_rad_s: NDArray[np.float64]
    sample_rate_hz: float
    device_id: str
    label: str


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("recording", type=Path, metavar="RECORDING", help="HDF5 file, ROS 2 bag, or text file of a rate")
    parser.add_argument("--label", metavar="NAME", help="which recording of the file")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write coefficients and curve; - for stdout")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the curve (.png, .svg, .pdf)")
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a page with pictures")
    parser.add_argument("--min-tau", type=float, metavar="S", help="shortest averaging time of the fit [s] (default: found)")
    parser.add_argument("--rate-hz", type=float, metavar="HZ", help="text file: samples per second")
    parser.add_argument("--unit", choices=sorted(_UNITS), default="rad/s", help="text file: unit")
    parser.add_argument("--column", type=int, default=0, metavar="K", help="text file: column, counted from 0")
    parser.add_argument(
        "--scale-factor", type=float, metavar="V_PER_RAD_S", help="for recordings whose factory data lack the nominal one [V/(rad/s)]"
    )


def run(arguments: argparse.Namespace) -> int:
    """Read, analyse, report."""
    with spinner("loading"):
        from ..estimation.allan import analyse_allan
        from ..report.allan_page import MISFIT
        from ..report.noise_figures import allan_table, draw_allan
        from ..report.theme import PAPER, require_matplotlib, require_plot_suffix, save_figure

    if arguments.plot is not None:
        require_plot_suffix(arguments.plot)
    if arguments.html is not None:
        require_matplotlib()
    check_outputs(arguments, "json", "plot", "html")
    record = _read(arguments)
    with spinner("analysing"):
        analysis = analyse_allan(record.rate_rad_s, record.sample_rate_hz, min_tau_s=arguments.min_tau)
    to_stdout = arguments.json is not None and str(arguments.json) == "-"
    if not to_stdout:
        say(f"{record.device_id} {record.label}".strip())
        print_table(allan_table(analysis))
    if analysis.chi_square_per_dof > MISFIT:
        misfit = f"{analysis.chi_square_per_dof:.1f} times the noise"
        print_warnings([f"the noise model misses the curve by {misfit}: do not trust the coefficients, look at the curve (--plot)"])
    if arguments.json is not None:
        write_json(arguments.json, _document(record, analysis))
    if arguments.plot is not None:
        with spinner("drawing"):
            save_figure(draw_allan(analysis, PAPER).figure, arguments.plot)
        if not to_stdout:
            say(f"plot: {arguments.plot}")
    if arguments.html is not None:
        with spinner("drawing the report"):
            _write_page(arguments.html, record, analysis)
        if not to_stdout:
            say(f"report: {arguments.html}")
    return 0


def _write_page(path: Path, record: RateRecord, analysis: AllanAnalysis) -> None:
    from ..paths import package_version
    from ..report.allan_page import allan_page
    from ..report.page import write_page

    title = f"Noise of {record.device_id or record.label}"
    subtitle = f"Recording {record.label}, {analysis.duration_s:.0f} s at {record.sample_rate_hz:g} Hz, nothing turned."
    write_page(path, allan_page(analysis, record.rate_rad_s, title, subtitle, f"gyro_calib {package_version()}"))


def _read(arguments: argparse.Namespace) -> RateRecord:
    if arguments.recording.suffix.lower() in _TEXT_SUFFIXES:
        with spinner("reading"):
            return _read_text(arguments)
    return _read_recording(arguments)


def _read_text(arguments: argparse.Namespace) -> RateRecord:
    """One column of numbers; lines that start with # are skipped, commas and spaces separate."""
    import numpy as np

    from ..errors import DataError

    if arguments.rate_hz is None:
        raise DataError("A text file says nothing of its sample rate: --rate-hz must be given, but got none.")
    try:
        text = arguments.recording.read_text(encoding="utf-8").replace(",", " ").replace(";", " ")
        columns = np.loadtxt(text.splitlines(), ndmin=2)
    except (OSError, ValueError) as error:
        raise DataError(f"Text file must hold numbers in columns, but got: {error}.") from error
    if not -columns.shape[1] <= arguments.column < columns.shape[1]:
        raise DataError(f"Argument column must be below {columns.shape[1]}, but got {arguments.column}.")
    return RateRecord(columns[:, arguments.column] * _UNITS[arguments.unit], arguments.rate_hz, "", arguments.recording.name)


def _read_recording(arguments: argparse.Namespace) -> RateRecord:
    """The longest static recording with a rate channel, or the one asked for."""
    from ..errors import DataError
    from ..recording.load import load_campaign
    from ..recording.rate import raw_rate

    with progress_bar("reading") as report:
        campaign = load_campaign(arguments.recording, on_progress=report)
    static = [r for r in campaign if _is_static(r)] if arguments.label is None else [r for r in campaign if r.label == arguments.label]
    if not static:
        at_rest = "one at rest, in force-rebalance or whole-angle mode"
        wanted = at_rest if arguments.label is None else f"one labelled {arguments.label!r}"
        labels = ", ".join(r.label for r in campaign)
        raise DataError(f"Recordings must hold {wanted}, but got {labels or 'none'}. Choose one with --label.")
    recording = max(static, key=len)
    factory: dict[str, Any] = dict(campaign.factory)
    if arguments.scale_factor is not None:
        factory["nominal_scale_factor_v_per_rad_s"] = dict.fromkeys("xy", arguments.scale_factor)
    elif "nominal_scale_factor_v_per_rad_s" not in factory and recording.command.oscillator_axis is not None:
        raise DataError(
            "Factory data must hold nominal_scale_factor_v_per_rad_s to make a rate of volts, but got none. Give --scale-factor, e.g. from "
            "gyro-calib calibrate."
        )
    rate = raw_rate(recording.data, recording.command, factory)
    return RateRecord(rate, recording.sample_rate_hz, campaign.device_id, recording.label)


def _is_static(recording: Recording) -> bool:
    """At rest at one temperature, with a rate channel: rebalance drive, or turning of a wave that nothing turns."""
    turned = bool(recording.extras.get("applied_rate"))
    warmed = float(recording.temperature_degc.max() - recording.temperature_degc.min()) > _STEADY_K
    command = recording.command
    free = command.mode == "whole_angle" and command.setpoints.virtual_precession_v == 0.0
    return (free or bool(command.oscillator_axis)) and command.excitation.kind == "none" and not turned and not warmed


def _document(record: RateRecord, analysis: AllanAnalysis) -> dict[str, Any]:
    """JSON of the analysis, SI units."""
    from ..quantity import Quantity

    curve = analysis.curve
    tau, lowest = curve.minimum()
    return {
        "device_id": record.device_id,
        "recording": record.label,
        "sample_rate_hz": record.sample_rate_hz,
        "duration_s": analysis.duration_s,
        "coefficients": {name: quantity.to_json() for name, quantity in analysis.coefficients.items()},
        "upper_limits": {
            name: Quantity(limit, 0.0, analysis.coefficients[name].unit).to_json() for name, limit in analysis.upper_limits.items()
        },
        "not_observable": list(analysis.not_observable),
        "minimum": {"tau_s": tau, "deviation": lowest.to_json()},
        "chi_square_per_dof": analysis.chi_square_per_dof,
        "min_tau_s": analysis.min_tau_s,
        "curve": {
            "unit": "rad/s",
            "confidence": curve.confidence,
            "tau_s": curve.tau_s.tolist(),
            "deviation": curve.deviation.tolist(),
            "lower": curve.lower.tolist(),
            "upper": curve.upper.tolist(),
            "edf": curve.edf.tolist(),
        },
    }
