"""Recordings, results and pages for the tests of the report, without the minutes that real ones take."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from calibration_samples import make_record
from gap_samples import make_diagnosis

from gyro_calib.calibration import CalibrationRecord
from gyro_calib.calibration.run_changes import changes_between
from gyro_calib.estimation import CalibrationResult, ConvergencePoint, TableRow
from gyro_calib.estimation.allan import analyse_allan
from gyro_calib.gap.diagnosis import Diagnosis, Standing
from gyro_calib.gap.gap_map import Cell
from gyro_calib.quantity import Quantity
from gyro_calib.recording.command import Command, Excitation
from gyro_calib.recording.recording import Campaign, Recording
from gyro_calib.report.allan_page import allan_page
from gyro_calib.report.calibration_page import AxisTruth, Rates, RunFacts, calibration_page
from gyro_calib.report.comparison import compare
from gyro_calib.report.gap_page import gap_page
from gyro_calib.report.page import Page
from gyro_calib.report.run_changes_page import run_changes_page
from gyro_calib.report.series import averaged
from gyro_calib.units import DEG_H

A = np.array([[-1.5 + 0.2j, 0.02 + 0.05j], [-0.03 + 0.05j, -1.6 - 0.4j]])
G = -1j * np.array([[9.0, 0.15 + 0.01j], [-0.2, 9.5]])
E = np.array([[1e-3, 2e-4j], [-3e-4, 1e-3j]])
RATE_HZ = 100.0
INDEX = 0.1


def parameters() -> dict[str, Quantity]:
    """A, G and E of the recordings."""
    found = {}
    for name, matrix in (("A", A), ("G", G), ("E", E)):
        for i, row in enumerate("xy"):
            for k, column in enumerate("xy"):
                found[f"{name}_{row}{column}_re"] = Quantity(matrix[i, k].real, 1e-4, "1/s")
                found[f"{name}_{row}{column}_im"] = Quantity(matrix[i, k].imag, 1e-4, "1/s")
    return found


def side_band_recording(axis: str, frequency_hz: float) -> Recording:
    """Exact slow flow with the other axis held at zero volts: a recording whose response is known in closed form."""
    i = "xy".index(axis)
    t = np.arange(2000) / RATE_HZ
    detuned = A - 1j * A[i, i].imag * np.eye(2)
    pick, drive = np.zeros((t.size, 2), complex), np.zeros((t.size, 2), complex)
    for f, amplitude in ((0.0, 1.0), (frequency_hz, INDEX / 2j), (-frequency_hz, -INDEX / 2j)):
        volts = amplitude * np.eye(2)[i]
        force = 2j * np.pi * f * np.eye(2) - detuned
        wave = np.exp(2j * np.pi * f * t)[:, None]
        pick += wave * volts
        drive += wave * np.linalg.solve(G + force @ E, force @ volts)
    data = np.zeros((t.size, 12))
    data[:, 0] = t
    data[:, 2:6:2], data[:, 3:6:2] = pick.real, pick.imag
    data[:, 6:10:2], data[:, 7:10:2] = drive.real, drive.imag
    data[:, 10], data[:, 11] = 15000.0, 25.0
    command = Command(f"ftr_{axis}", Excitation("amplitude_modulation", frequency_hz, INDEX))
    return Recording("ring-1", data, command, RATE_HZ, f"side_{axis}")


def make_campaign() -> Campaign:
    """Both axes, two side bands each."""
    return Campaign("ring-1", tuple(side_band_recording(axis, f) for axis in "xy" for f in (0.2, 0.9)))


def make_result() -> CalibrationResult:
    """A result as :func:`gyro_calib.estimation.calibrate` gives one."""
    rng = np.random.default_rng(4)
    rows = []
    for axis in ("x", "y", ""):
        for f in (0.0, 0.2, 0.9) if axis else (0.0,):
            noise = rng.standard_normal((2, 2)) @ np.array([1.0, 1j])
            rows.append(TableRow("row", axis, f, (1.0, 0.0), (0.1, 0.2), tuple(2e-4 * noise), (2e-4, 2e-4)))
    points = tuple(
        ConvergencePoint(
            t,
            {a: Quantity((1000.0 + 3.0 / t) * DEG_H, 2.0 * DEG_H / t, "rad/s") for a in "xy"},
            {a: Quantity(0.1 * (1.0 + 50e-6 / t), 1e-6 / t, "V/(rad/s)") for a in "xy"},
        )
        for t in (10.0, 20.0, 40.0)
    )
    return CalibrationResult(
        device_id="ring-1",
        method="sideband",
        rate=Quantity(15.0 * DEG_H, 0.5 * DEG_H, "rad/s"),
        bias={"x": Quantity(1000.1 * DEG_H, 0.5 * DEG_H, "rad/s"), "y": Quantity(-800.0 * DEG_H, 0.5 * DEG_H, "rad/s")},
        scale_factor={"x": Quantity(0.1, 2e-6, "V/(rad/s)"), "y": Quantity(-0.1, 2e-6, "V/(rad/s)")},
        mission={},
        parameters=parameters(),
        rate_noise_density={},
        condition_number=12.0,
        chi2_per_dof=1.0,
        amplitude_v=1.0,
        temperature_degc=25.0,
        temperature_sd_k=0.01,
        reference_frequency_hz=15000.0,
        not_observable=("angular_gain_kappa: from the factory",),
        warnings=("a <b>bold</b> warning",),
        table=tuple(rows),
        convergence=points,
    )


def whole_page(result: CalibrationResult, campaign: Campaign) -> Page:
    """A page with everything that one can hold."""
    truth = SimpleNamespace(bias_rad_s=1000.0 * DEG_H, scale_factor=0.98)
    comparison = compare(truth, 15.0 * DEG_H, result.bias["x"], Quantity(0.98, 1e-5, "1"), result.rate)
    rng = np.random.default_rng(8)
    t = np.arange(3000) / 100.0
    rates = Rates(
        averaged(t, (1015.0 + rng.standard_normal(t.size)) * DEG_H), averaged(t, (15.0 + rng.standard_normal(t.size)) * DEG_H), 15.0
    )
    facts = RunFacts("Title & more", "subtitle", "footer", device_s=100.0, elapsed_s=10.0)
    truths = {a: AxisTruth(1000.0 * DEG_H, 0.1) for a in "xy"}
    return calibration_page(result, campaign, facts, comparison=comparison, rates=rates, truths=truths)


def every_page() -> dict[str, Page]:
    """One page of each kind, as full as real ones are: long names, many rows."""
    return {
        "calibration": whole_page(make_result(), make_campaign()),
        "gap": gap_page(_gap()),
        "allan": _noise(),
        "runs": run_changes_page(changes_between([make_record(), _later_record()]), "footer"),
    }


def _later_record() -> CalibrationRecord:
    return make_record(
        created_utc="2026-03-09T12:00:00Z",
        bias=Quantity(1290.0 * DEG_H, 1.0 * DEG_H, "rad/s"),
        temperature_degc=Quantity(38.0, 0.1, "degC"),
    )


def _gap() -> Diagnosis:
    found = make_diagnosis("ring-1", recordings=30)
    channels = ("amplitude", "frequency", "precession", "quadrature")
    cells = tuple(
        Cell(f"side_{'xy'[k % 2]}_a1.4_nu{k}.5", channel, "in phase with velocity", feature, 0.01, 10.0 * k, 9.0 * k)
        for k in range(20)
        for channel in channels
        for feature in ("mean", "side band 1 x 1.5 Hz")
    )
    standings = tuple(
        Standing(
            f"thermal_damping_anisotropy_{k}", "An effect", "environment", "excluded", Quantity(3.5e-4, 1e-5, "1/s/V^2"), -2.0, 0.1, 0.9
        )
        for k in range(40)
    )
    return replace(found, map=cells, map_after=tuple(replace(c, z=1.0, left_out=1.0) for c in cells), standings=standings)


def _noise() -> Page:
    rate = math.radians(0.05) / 60.0 * 10.0 * np.random.default_rng(1).standard_normal(6000)
    analysis = analyse_allan(rate, 100.0)
    return allan_page(analysis, rate, "Noise of ring-1", "Recording static_x, 60 s at 100 Hz, nothing turned.", "footer")
