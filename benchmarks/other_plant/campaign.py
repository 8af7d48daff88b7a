"""A campaign: the timetable of a plan, its run through the plant, and the rows that a logger keeps."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import firwin

from environment import Scene, build_scene
from kernel import Array, Plant
from plan import Step
from unit import TWO_PI, Unit

FTR, WHOLE, OPEN, BRAKE = 0, 1, 2, 3
COLUMNS = ("x_pick_c", "x_pick_s", "y_pick_c", "y_pick_s", "x_drive_c", "x_drive_s", "y_drive_c", "y_drive_s")
TABLE = ((0.0, 0.0), (2.0, 50.0), (4.0, 0.0), (6.0, -50.0), (8.0, 0.0))


@dataclass
class Recording:
    """One recording as it is written."""

    step: Step
    columns: dict[str, Array]
    attributes: dict[str, object]
    rate: Array = field(default_factory=lambda: np.zeros(0))  # true rate at the rows; is not written


@dataclass(frozen=True)
class Slot:
    """Where a step lies in the campaign, in windows from its beginning."""

    step: Step
    start: int
    settle: int
    rows: int
    windows: int


def kernel_of(unit: Unit) -> Array:
    """Linear-phase filter of the rows: a windowed sinc, the same on every column."""
    taps = 5 * unit.decimation | 1
    return np.asarray(firwin(taps, unit.row_band * unit.row_rate, window=("kaiser", 7.5), fs=unit.loop_rate))


def timetable(unit: Unit, steps: list[Step]) -> list[Slot]:
    """When each step begins."""
    taps, slots, now = len(kernel_of(unit)), [], round(0.5 * unit.loop_rate)
    for step in steps:
        settle, rows = round(step.settle * unit.loop_rate), round(step.record * unit.row_rate)
        windows = (rows - 1) * unit.decimation + taps
        slots.append(Slot(step, now, settle, rows, windows))
        now += settle + windows
    return slots


def first_row(unit: Unit, slot: Slot) -> float:
    """Device time of the centre of the first row's kernel."""
    return (slot.start + slot.settle + (len(kernel_of(unit)) - 1) / 2 + 0.5) / unit.loop_rate - 0.5 / unit.adc_rate


def scene_of(unit: Unit, steps: list[Step], seed: int, quiet: bool = False) -> Scene:
    """The environment of a campaign, drawn from a seed."""
    slots = timetable(unit, steps)
    span = (slots[-1].start + slots[-1].settle + slots[-1].windows) / unit.loop_rate + 1.0
    ramps = [(first_row(unit, s), *s.step.ramp) for s in slots if s.step.ramp[1]]
    ramp, late = unit.table["ramp"], unit.table["late"]
    tables = []
    for slot in slots:
        if slot.step.table:
            corners, before = [], 0.0
            for at, rate in TABLE:
                start = first_row(unit, slot) + at + late
                corners += [(start, before), (start + ramp, math.radians(rate))]
                before = math.radians(rate)
            tables.append(np.array(corners))
    return build_scene(unit, span, ramps, tables, np.random.default_rng([seed, 1]), quiet)


def _attributes(unit: Unit, slot: Slot, open_hz: float) -> dict[str, object]:
    step = slot.step
    off = step.mode == "loops_off"
    start = slot.start / unit.loop_rate
    out: dict[str, object] = {
        "mode": step.mode,
        "label": step.label,
        "sample_rate_hz": unit.row_rate,
        "amplitude_set_V": step.amplitude,
        "adc_rate_hz": unit.adc_rate,
        "control_rate_hz": unit.loop_rate,
        "dac_zero_order_hold_s": 1.0 / unit.adc_rate,
        "firmware_drive_phase_advance_rad": unit.advance,
        "settle_s": step.settle,
        "t_run_start": start,
    }
    if step.nu:
        out["excitation"] = json.dumps({"kind": "amplitude modulation of the set point", "m": step.index, "nu_hz": step.nu})
    if off and step.drive == "body":
        out["body_excitation"] = json.dumps({"freq": open_hz, "volts": step.volts})
    elif off:
        out["open_drive"] = json.dumps({"freq": open_hz, "axis": step.drive, "volts": step.volts})
    if step.mode == "whole_angle":
        out["virtual_precession_V"] = precession_volts(unit, step)
    if step.stiffness:
        out["stiffness_control"] = json.dumps({"cr_V_per_V": [[start, step.stiffness]]})
    if step.gain:
        out["amplitude_control"] = json.dumps({"start": start, "gain_down" if step.gain < 0 else "gain_up": step.gain})
    if step.table:
        out["applied_rate"] = json.dumps({"t_s": [a for a, _ in TABLE], "deg_s": [b for _, b in TABLE]})
    return out


def precession_volts(unit: Unit, step: Step) -> float:
    """Volts for the wanted periods of 4 theta per second, from the gain on the data sheet."""
    return round(math.pi * step.amplitude * step.precession / unit.gain, 3)


def _commands(unit: Unit, step: Step, locked: float) -> tuple[list[tuple[float, dict[str, float]]], float]:
    """Commands of the settling time as (share, command), the last of which holds while it is recorded; frequency of an open drive."""
    if step.mode == "loops_off":
        hz = round(locked / TWO_PI + step.offset, 1)
        volts = {"VOLTX": step.volts * (step.drive == "x"), "VOLTY": step.volts * (step.drive == "y")}
        drive = {"MODE": OPEN, "FREQ": hz, "BODY": step.volts * (step.drive == "body"), **volts}
        return [(0.35, {"MODE": BRAKE}), (0.65, drive)], hz
    if step.mode == "whole_angle":
        return [(1.0, {"MODE": WHOLE, "AMP": step.amplitude, "VP": precession_volts(unit, step)})], 0.0
    osc = float(step.axis == "y")
    return [
        (
            1.0,
            {
                "MODE": FTR,
                "OSC": osc,
                "AMP": step.amplitude,
                "MOD": step.index,
                "NU": step.nu,
                "CR": step.stiffness,
                "GAIN": step.gain,
            },
        )
    ], 0.0


def _rows(unit: Unit, slot: Slot, raw: Array, scene: Scene, rng: np.random.Generator) -> tuple[dict[str, Array], Array]:
    taps = kernel_of(unit)
    view = np.lib.stride_tricks.sliding_window_view(raw, len(taps), axis=0)[:: unit.decimation]
    rows = view @ taps
    t = first_row(unit, slot) + np.arange(len(rows)) / unit.row_rate
    columns = {"t": t, **{name: rows[:, i] for i, name in enumerate(COLUMNS)}, "ref_freq": rows[:, 8] / TWO_PI}
    said = np.interp(t, scene.t, scene.reading) + unit.thermometer["noise"] * rng.normal(size=len(t))
    columns["temperature"] = np.round(said / unit.thermometer["step"]) * unit.thermometer["step"]
    centres = first_row(unit, slot) + (np.arange(len(raw)) - (len(taps) - 1) / 2) / unit.loop_rate
    rate = np.lib.stride_tricks.sliding_window_view(np.interp(centres, scene.t, scene.rate), len(taps))[:: unit.decimation] @ taps
    return columns, rate


def run(
    unit: Unit, steps: list[Step], seed: int, effect: Callable[[Scene], None] | None = None, noise: bool = True, quiet: bool = False
) -> list[Recording]:
    """Run a campaign.

    Parameters
    ----------
    unit : Unit
    steps : list of Step
    seed : int
        Of environment and noise.
    effect : callable, optional
        Changes the scene before the run.
    noise : bool
        Without it the fast noise is off, the slow wander stays: two such runs can be subtracted.
    quiet : bool
        No wander either.
    """
    scene = scene_of(unit, steps, seed, quiet)
    if effect is not None:
        effect(scene)
    if not noise or quiet:
        scene.par.update(SIGMA_V=0.0, SIGMA_W=0.0, DAC_LSB=0.0, ADC_LSB=0.0)
    plant = Plant(scene.par, unit.propagator(), scene.slow, seed)
    rng = np.random.default_rng([seed, 2])
    slots = timetable(unit, steps)
    plant.run({"MODE": FTR, "OSC": 0.0, "AMP": 1.0}, slots[0].start)
    out, locked = [], plant.frequency
    for slot in slots:
        if slot.step.mode != "loops_off":
            locked = plant.frequency
        parts, hz = _commands(unit, slot.step, locked)
        left = slot.settle
        for share, command in parts[:-1]:
            plant.run(command, round(share * slot.settle))
            left -= round(share * slot.settle)
        plant.run(parts[-1][1], left)
        raw = plant.run(parts[-1][1], slot.windows, keep=True)
        if slot.step.keep:
            columns, rate = _rows(unit, slot, raw, scene, rng)
            out.append(Recording(slot.step, columns, _attributes(unit, slot, hz), rate))
    return out
