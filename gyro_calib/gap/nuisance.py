"""What any healthy device has beside its linear slow flow and no one calls a gap: a resonance that wanders, what follows the temperature.

Nuisances that physics bounds (temperature coefficients, the lag of a record) have priors of that size: an effect of the same form shows
only where it is larger than a healthy device has it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .column import Column
from .columns import QUIET, SIGNAL, form_columns, part_columns
from .evidence import CampaignEvidence
from .forms import FORMS
from .images import image_columns
from .linear_device import ROW_MOMENT, collected, span_k
from .parts import Linear, Part, read_at_once
from .ripple import ripple_columns
from .signals import SMOOTH_S

__all__ = [
    "BOTH_DRIVES_LATE",
    "BOTH_PICKOFFS",
    "NOTICED_K",
    "SWITCHED",
    "following_columns",
    "slow_columns",
    "thermal_columns",
    "wander_columns",
]

FloatArray = NDArray[np.float64]

#: how the name of what both axes have alike begins
_BOTH = "both_"
BOTH_PICKOFFS, BOTH_DRIVES_LATE = f"{_BOTH}thermal_pickoff_gain", f"{_BOTH}drive_delay"
#: damping that does not go as all of it does, of the damping, over what it is of its anisotropy
_OTHERWISE_OF_ALL = 1e-3
#: least damping of a device over the factory's
_LEAST_DAMPING = 0.5
#: how equal drives are that shift the reference and that turn an envelope, gain and phase [rad]
_OF_STIFFNESS = 1e-5
#: drift of the resonance over a campaign in units of its wander; constant volts that reach a drive besides the command [V]
_SLOW, _STRAY_DRIVE_V = 3.0, 5e-6
#: modes in which a drive is switched within a recording, and over its median change a step
SWITCHED, _ABRUPT = ("ring_down", "ring_up", "stiffness"), 10.0
#: rows of one step lie within that time [s]; more steps than this in a recording are noise
_TOGETHER_S, _MOST_STEPS = 0.05, 12
#: temperature's span over a campaign from which on a healthy device's coefficients are allowed for [K]
NOTICED_K = 0.02


def _blurred_records(evidence: CampaignEvidence, linear: Linear) -> list[Column]:
    """Rows that are slow for what they hold: a pick-off's filtered otherwise than the drives', a switched drive's folded at the rows' rate.

    To second order each is its signal's curvature times a second moment of the size of a row.
    """
    by_recording = []
    for r in evidence:
        s = r.signals
        bent = [np.gradient(np.gradient(x, s.row_s, axis=0), s.row_s, axis=0) for x in (s.pick, s.drive)]
        by_recording.append([Part("record_blur", "output", bent[0]), Part("drive_blur", "drive", bent[1])])
    row_s = max(1.0 / r.recording.sample_rate_hz for r in evidence)
    return [replace(c, prior_sd=ROW_MOMENT * row_s**2) for c in part_columns(evidence, by_recording, linear)]


def _kicks(evidence: CampaignEvidence, linear: Linear) -> list[Column]:
    """A drive that steps kicks the wave by its part at twice the carrier, ``conj(G du) / 2 omega`` turned by the carrier's phase then.

    No envelope holds that phase, and it is another at every step: a complex unknown for each time that a drive was switched.
    """
    columns = []
    for r in evidence:
        s = r.signals
        if r.recording.command.mode not in SWITCHED:
            continue
        step = np.diff(s.drive, axis=0, prepend=s.drive[:1])
        size = np.linalg.norm(step, axis=1)
        for event, rows in enumerate(_times_of(size > _ABRUPT * np.median(size), _TOGETHER_S / s.row_s)):
            at_once = np.zeros_like(step)
            at_once[rows] = step[rows]
            kick = (at_once @ linear.G.T).conj() / (2.0 * evidence.omega0_rad_s * s.row_s)
            sides = []
            for place in (SIGNAL, QUIET):
                kicked = r.turn * place.projector(r).plain([kick])[:, 0]
                sides.append([kicked if o is r else np.zeros_like((o.quiet if place.quiet else o.signal).lhs) for o in evidence])
            for name, turn in (("re", 1.0), ("im", 1j)):
                label = f"kick_{r.index}_{event}_{name}"
                columns.append(Column(label, tuple(turn * v for v in sides[0]), tuple(turn * v for v in sides[1]), 1.0))
    return columns


def _times_of(abrupt: NDArray[np.bool_], apart: float) -> list[NDArray[np.int_]]:
    """Rows of each time that something was abrupt, ``apart`` rows or more from the last; of one time where there are too many to tell."""
    rows = np.flatnonzero(abrupt)
    times = np.split(rows, np.flatnonzero(np.diff(rows) > apart) + 1) if rows.size else []
    return times if len(times) <= _MOST_STEPS else [rows]


def _blurred_temperature(evidence: CampaignEvidence, linear: Linear) -> list[Column]:
    """A temperature that was smoothed over t: its corners are rounder than the resonator's by t^2/24 of its curvature."""
    by_recording = []
    for r in evidence:
        s = r.signals
        curvature = np.gradient(np.gradient(s.temperature_k, s.row_s), s.row_s)[:, None]
        motion = s.pick - s.drive @ linear.E.T
        by_recording.append([Part("temperature_blur", "flow", 1j * linear.frequency_slope_rad_s_k * curvature * motion)])
    return [replace(c, prior_sd=SMOOTH_S**2 / 24.0) for c in part_columns(evidence, by_recording, linear)]


def _in_stiffness_control(evidence: CampaignEvidence, linear: Linear) -> list[Column]:
    """Gain and phase of drives that shift the reference, over those of drives that turn an envelope.

    Loops whose window holds no whole number of carrier periods see a turning envelope's image at twice the carrier, and answer it. Of
    the answer a share falls back on the carrier: a force in proportion to the turning, which the rows' filter keeps from the log. A
    plant of another maker shows 1e-5 of it; a quarter, with a quarter of its loops' bandwidth (doc/gap.md, Noise).
    """
    by_recording = []
    for r in evidence:
        drive = r.signals.drive * float(r.recording.command.mode == "stiffness")
        by_recording.append([Part("stiffness_gain", "drive", drive), Part("stiffness_phase", "drive", 1j * drive)])
    found = part_columns(evidence, by_recording, linear)
    return [replace(c, prior_sd=_OF_STIFFNESS) for c in found if any(np.any(v) for v in c.signal)]


def _damping(evidence: CampaignEvidence, linear: Linear) -> float:
    """Damping [1/s], as the fit says; a pump that undoes it is in A, and what follows the temperature is of what it undoes."""
    return max(abs(np.trace(linear.A).real) / 2.0, _LEAST_DAMPING * evidence.decay_rate)


def thermal_columns(evidence: CampaignEvidence, linear: Linear) -> list[Column]:
    """How a healthy device follows its temperature, and a record that is late."""
    columns: list[Column] = []
    columns += _form(evidence, linear, "drive_lag", {"tau": evidence.healthy.envelope_lag_s})
    columns += ripple_columns(evidence, linear)
    columns += _blurred_records(evidence, linear)
    columns += _kicks(evidence, linear)
    columns += _in_stiffness_control(evidence, linear)
    columns += image_columns(evidence, linear)
    if span_k(evidence) < NOTICED_K:
        return columns
    # the carrier is as late as its envelope, and its phase follows the frequency: 1e-4 rad/K of a hemisphere
    columns += _of_both(evidence, linear, "drive_delay", evidence.healthy.drive_lag_s)
    columns += _form(evidence, linear, "thermal_lag", {"tau": evidence.healthy.sensor_lag_s})
    columns += _blurred_temperature(evidence, linear)
    bent = evidence.healthy.damping_per_k2 * _damping(evidence, linear)
    columns += collected("damping_per_k2", evidence, lambda r, p: p.terms["warm2"][:, 0], bent, real=True)
    return columns + _warm_feedthrough(evidence, linear) + following_columns(evidence, linear)


def _warm_feedthrough(evidence: CampaignEvidence, linear: Linear) -> list[Column]:
    """Each element of the feedthrough follows the temperature by a share of itself, in phase and a quarter of a cycle off."""
    by_recording = []
    for r in evidence:
        warm, drive = r.signals.temperature_k[:, None], r.signals.drive
        parts = []
        for j, k in np.ndindex(2, 2):
            fed = abs(linear.E[j, k]) * warm * drive[:, [k]] * np.eye(2)[j]
            parts += [Part(f"fed_per_k_{'xy'[j]}{'xy'[k]}{name}", "output", q * fed) for name, q in (("c", 1.0), ("s", 1j))]
        by_recording.append(parts)
    return [replace(c, prior_sd=evidence.healthy.feedthrough_per_k) for c in part_columns(evidence, by_recording, linear)]


def following_columns(evidence: CampaignEvidence, linear: Linear) -> list[Column]:
    """What follows the temperature of the moment, but for the resonance."""
    damping, healthy = _damping(evidence, linear), evidence.healthy
    unequal = linear.A - np.eye(2) * np.trace(linear.A) / 2.0
    anisotropy, lossy = np.abs(unequal).max(), float(np.abs(unequal.real).max())
    columns = _form(evidence, linear, "thermal_damping", {"c": healthy.damping_per_k * damping})
    columns += _scaled(evidence, linear, unequal.real, "anisotropy_per_k", healthy.damping_per_k)
    columns += _scaled(evidence, linear, 1j * _split_of(linear), "split_per_k", healthy.split_per_k)
    sd = healthy.damping_axis_per_k * (lossy + _OTHERWISE_OF_ALL * damping)
    columns += _form(evidence, linear, "thermal_damping_anisotropy", {"c_c": sd, "c_s": sd})
    columns += _form(evidence, linear, "thermal_split", dict.fromkeys(("k_c", "k_s"), healthy.split_axis_per_k * anisotropy))
    for name in ("thermal_drive_gain", "thermal_pickoff_gain"):
        columns += _form(evidence, linear, name, dict.fromkeys(("g_x", "g_y"), healthy.axis_gain_per_k))
        columns += _of_both(evidence, linear, name, healthy.gain_per_k)
    for name in ("thermal_drive_phase", "thermal_pickoff_phase"):
        columns += _form(evidence, linear, name, dict.fromkeys(("g_x", "g_y"), healthy.phase_per_k))
    return columns + _gradient_columns(evidence, linear, unequal.real, healthy.damping_per_k * (lossy + _OTHERWISE_OF_ALL * damping))


def _scaled(evidence: CampaignEvidence, linear: Linear, unequal: NDArray[Any], name: str, per_k: float) -> list[Column]:
    """What is unequal of the damping or of the stiffness goes with the temperature: its pattern stays, its size does not."""
    by_recording = [
        [Part(name, "flow", r.signals.temperature_k[:, None] * ((r.signals.pick - r.signals.drive @ linear.E.T) @ unequal.T))]
        for r in evidence
    ]
    return [replace(c, prior_sd=per_k) for c in part_columns(evidence, by_recording, linear)]


def _split_of(linear: Linear) -> FloatArray:
    """Half the split, by axis and across [rad/s], shape (2, 2)."""
    return np.asarray(linear.A.imag - np.eye(2) * np.trace(linear.A.imag) / 2.0)


def _of_both(evidence: CampaignEvidence, linear: Linear, name: str, sd: float) -> list[Column]:
    """What both axes have alike of an effect by axis: no effect takes its place."""
    by_recording = [[replace(part, parameter=f"{_BOTH}{name}") for part in FORMS[name].parts(r.signals, linear, {})] for r in evidence]
    return [replace(c, prior_sd=sd) for c in part_columns(evidence, by_recording, linear)]


def _gradient_columns(evidence: CampaignEvidence, linear: Linear, unequal: FloatArray, rate_per_k: float) -> list[Column]:
    """Gains, phases, damping and split while the temperature moves: their places are not the sensor's, tenths of a second before or behind.

    And the bias in rate that follows the temperature as the damping's anisotropy does, which healthy devices have as well.
    """
    by_recording = []
    for r in evidence:
        slope = np.gradient(r.signals.temperature_k, r.signals.row_s)[:, None]
        motion = r.signals.pick - r.signals.drive @ linear.E.T
        parts = [
            Part(f"gradient_{name}_{a}", "drive", factor * slope * r.signals.drive * np.eye(2)[k])
            for name, factor in (("gain", 1.0), ("phase", 1j))
            for k, a in enumerate("xy")
        ]
        parts += [
            read_at_once(f"gradient_pickoff_{name}_{a}", r.signals, linear, lambda v, w=factor * slope * axis: w * v)  # type: ignore[misc]
            for name, factor in (("gain", 1.0), ("phase", 1j))
            for axis, a in zip(np.eye(2), "xy", strict=True)
        ]
        across = -r.signals.temperature_k[:, None] * linear.reacting(motion)
        parts += [
            Part("gradient_split", "flow", 1j * slope * (motion @ _split_of(linear).T)),
            Part("gradient_anisotropy", "flow", slope * (motion @ unequal.T)),
            Part("gradient_damping", "flow", -slope * motion),
            Part("rate_per_k", "flow", across),
        ]
        by_recording.append(parts)
    healthy, lag_s = evidence.healthy, evidence.healthy.gradient_lag_s
    sizes = {"gradient_damping": healthy.damping_per_k * _damping(evidence, linear) * lag_s, "rate_per_k": rate_per_k}
    sizes |= {"gradient_split": healthy.split_per_k * lag_s, "gradient_anisotropy": healthy.damping_per_k * lag_s}
    phases = ("gradient_phase_x", "gradient_phase_y", "gradient_pickoff_phase_x", "gradient_pickoff_phase_y")
    sizes |= dict.fromkeys(phases, healthy.phase_per_k * lag_s)
    found = part_columns(evidence, by_recording, linear)
    return [replace(c, prior_sd=sizes.get(c.name, healthy.gain_per_k * lag_s)) for c in found]


def slow_columns(evidence: CampaignEvidence, linear: Linear, wander_rad_s: float) -> list[Column]:
    """What wanders slower than a campaign, and what reaches the drives besides the command: a floor of every device."""
    times = [float(r.signals.time_s.mean()) for r in evidence]
    span = max(max(times) - min(times), 1.0)
    ageing = _form(evidence, linear, "frequency_ageing", {"k": _SLOW * wander_rad_s / span})
    stray = _form(evidence, linear, "constant_force", dict.fromkeys(("f_xc", "f_xs", "f_yc", "f_ys"), _STRAY_DRIVE_V))
    return ageing + stray


def wander_columns(evidence: CampaignEvidence, wander_rad_s: float, open_drive_rad_s: float) -> list[Column]:
    """Every recording's own distance of its resonance, and how it moved steadily meanwhile; of waves, and under an open drive."""
    columns = []
    for r in evidence:
        for k, name in enumerate(("shift", "slide")):
            columns.append(
                Column(
                    f"{name}_{r.index}",
                    tuple(r.turn * 1j * o.signal.resonance[:, k] if o is r else np.zeros(o.signal.lhs.size, complex) for o in evidence),
                    tuple(r.turn * 1j * o.quiet.resonance[:, k] if o is r else np.zeros(o.quiet.lhs.size, complex) for o in evidence),
                    wander_rad_s if r.is_wave else open_drive_rad_s,
                )
            )
    return columns


def _form(evidence: CampaignEvidence, linear: Linear, name: str, sizes: dict[str, float]) -> list[Column]:
    columns = form_columns(evidence, FORMS[name], linear, {})
    return [Column(f"{name}.{c.name}", c.signal, c.quiet, sizes[c.name]) for c in columns if c.name in sizes]
