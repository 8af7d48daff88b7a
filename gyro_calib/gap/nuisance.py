"""What any healthy device has and no one calls a gap: the linear slow flow, its resonance's wander, its known dependence on temperature.

Nuisances that physics bounds (temperature coefficients, the lag of a record, a feedthrough that follows frequency) have priors of that
size: an effect of the same form shows only where it is larger than a healthy device has it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..estimation.wave_projection import WaveProjected
from .columns import QUIET, SIGNAL, Column, form_columns, part_columns
from .evidence import CampaignEvidence, RecordingEvidence
from .forms import FORMS
from .parts import Linear, Part
from .signals import SMOOTH_S

__all__ = [
    "TEMPERATURE_SPAN_K",
    "frequency_columns",
    "linear_columns",
    "linear_of",
    "quiet_target_of",
    "slow_columns",
    "span_k",
    "target_of",
    "thermal_columns",
    "wander_columns",
    "with_wander",
]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
_Regressor = Callable[[RecordingEvidence, WaveProjected], ComplexArray]

#: temperature coefficients of healthy devices, sd [1/K]: gains, their differences and phases; damping relative; all small against 1
_GAIN_PER_K, _PHASE_PER_K, _PICKOFF_PHASE_PER_K, _DAMPING_PER_K = 3e-4, 1e-4, 3e-5, 5e-3
#: relative curvature of the damping [1/K^2], of the frequency [1/K^2]
_DAMPING_PER_K2, _FREQUENCY_PER_K2 = 3e-5, 1e-7
#: a record that is late by some samples of the converters [s]; a rate table's clock [s]
_LAG_S, _TABLE_CLOCK_S = 3e-5, 1e-3
#: change of E over a relative distance of one from resonance, and its curvature, which multiplexed electronics have (a resonance rings on
#: in the slots that do not drive it); reaction of the diagonal of A to rate over kappa
_DISPERSION, _BENT_DISPERSION, _SKEWED_RATE = 5e-3, 1e-2, 0.05
#: how far kappa of a unit is from its factory's (latency of the loops, clock of the table)
_KAPPA = 3e-4
#: drift of the resonance over a campaign in units of its wander; constant volts that reach a drive besides the command [V]
_SLOW, _STRAY_DRIVE_V = 3.0, 5e-6
#: how late a temperature sensor is behind the resonator, and behind what warms elsewhere [s]
_SENSOR_LAG_S, _GRADIENT_LAG_S = 0.03, 0.3
#: feedthrough of a chain that nobody measured; second moment of a row's filter over the squared row
_FEEDTHROUGH, _ROW_MOMENT = 2e-3, 1.0
_TURNED_RAD = np.pi
#: temperature's span over a campaign from which on a healthy device's coefficients are allowed for, and from which on they can be measured
_NOTICED_K, TEMPERATURE_SPAN_K = 0.02, 0.5


def _collected(
    name: str,
    evidence: CampaignEvidence,
    f: Callable[[RecordingEvidence, WaveProjected], ComplexArray],
    prior_sd: float = np.inf,
    *,
    real: bool = False,
) -> list[Column]:
    """A complex unknown as two real ones (or its real part alone); nothing when no recording holds it."""
    signal = [r.turn * f(r, r.signal) for r in evidence]
    quiet = [r.turn * f(r, r.quiet) for r in evidence]
    if not any(np.any(v) for v in signal):
        return []
    columns = [Column(name if real else f"{name}_re", tuple(signal), tuple(quiet), prior_sd)]
    if not real:
        columns.append(Column(f"{name}_im", tuple(1j * v for v in signal), tuple(1j * v for v in quiet), prior_sd))
    return columns


def _entry(field: str, a: int, b: int | None, weight: Callable[[RecordingEvidence], float] = lambda r: 1.0) -> _Regressor:
    """Regressor of one entry of the projected signals, weighed by recording."""

    def values(r: RecordingEvidence, p: WaveProjected) -> ComplexArray:
        array = getattr(p, field)
        return np.asarray(weight(r) * (array[:, a] if b is None else array[:, a, b]))

    return values


def _shaken_at(frequency_hz: float) -> Callable[[RecordingEvidence], float]:
    return lambda r: float(_body(r) == frequency_hz)


def _combined(first: tuple[int, int], second: tuple[int, int], sign: float) -> _Regressor:
    """Sum or difference of two entries of the response to rate."""
    return lambda r, p: p.rate_pick[:, first[0], first[1]] + sign * p.rate_pick[:, second[0], second[1]]


def linear_columns(evidence: CampaignEvidence, *, rate_known: bool = True) -> list[Column]:
    """A, G~, E, body, response to rate, force that does not follow the wave.

    With ``rate_known`` the target already lacks the response to rate of the factory's kappa (:func:`target_of`), and what is sought is how
    far the unit is from it; otherwise all of it.
    """
    columns: list[Column] = []
    bodies = sorted({_body(r) for r in evidence if _body(r) > 0.0})
    turned = any("applied_rate" in r.recording.extras for r in evidence)
    open_drive = {round(_open(r), 3) for r in evidence if _open(r) > 0.0}
    for a in range(2):
        for b in range(2):
            place = f"{'xy'[a]}{'xy'[b]}"
            columns += _collected(f"A_{place}", evidence, _entry("pick", a, b))
            columns += _collected(f"G_{place}", evidence, _entry("drive", a, b))
            # without open drive a feedthrough of usual size is allowed for, not taken to be absent
            known = np.inf if open_drive else _FEEDTHROUGH
            columns += _collected(f"E_{place}", evidence, _entry("drive_rate", a, b), known)
            if len(open_drive) > 1:
                for name, power, size in (("dispersion", 1, _DISPERSION), ("bent_dispersion", 2, _BENT_DISPERSION)):
                    by_distance = _entry("drive_rate", a, b, lambda r, power=power: _away(r, evidence.omega0_rad_s) ** power)  # type: ignore[misc]
                    columns += _collected(f"{name}_{place}", evidence, by_distance, size)
            if turned:
                columns += _collected(f"table_{place}", evidence, _entry("jerk", a, b), _TABLE_CLOCK_S)
        for f in bodies:
            columns += _collected(f"body_{'xy'[a]}_{f:.0f}", evidence, _entry("body", a, None, _shaken_at(f)))
        if any(r.signal.turn_rad > _TURNED_RAD for r in evidence):
            columns += _collected(f"force_{'xy'[a]}", evidence, _entry("constant", a, None, lambda r: float(r.is_wave)))
    return columns + (_rate_columns(evidence, rate_known) if turned else [])


def _rate_columns(evidence: CampaignEvidence, known: bool) -> list[Column]:
    """Response of A to rate: its antisymmetric part is kappa, the rest is the pick-offs' mismatch and non-orthogonality."""
    columns = _collected("rate_anti", evidence, _combined((0, 1), (1, 0), -1.0), _KAPPA if known else np.inf)
    for name, f in (
        ("rate_mismatch", _combined((0, 1), (1, 0), 1.0)),
        ("rate_sum", _combined((0, 0), (1, 1), 1.0)),
        ("rate_skew", _combined((0, 0), (1, 1), -1.0)),
    ):
        columns += _collected(name, evidence, f, _SKEWED_RATE)
    # what feeds through does not turn: -kappa Omega J (V - E u)
    for a in range(2):
        for b in range(2):
            columns += _collected(f"rate_feed_{'xy'[a]}{'xy'[b]}", evidence, _entry("rate_drive", a, b), _FEEDTHROUGH)
    return columns + _blurred_steps(evidence)


def _blurred_steps(evidence: CampaignEvidence) -> list[Column]:
    """A step of the table as the recorder's filter blurs it: to second order its curvature times half the filter's second moment."""
    sides = []
    for place in (SIGNAL, QUIET):
        vectors = []
        for r in evidence:
            s = r.signals
            curvature = np.gradient(np.gradient(s.rate_rad_s, s.row_s), s.row_s)[:, None]
            vectors.append(
                r.turn * place.projector(r).plain((curvature * np.stack([-s.pick[:, 1], s.pick[:, 0]], axis=1))[:, None, :])[:, 0]
            )
        sides.append(tuple(vectors))
    row_s = max(1.0 / r.recording.sample_rate_hz for r in evidence)
    return [Column("table_blur", sides[0], sides[1], _ROW_MOMENT * row_s**2)]


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
    return [replace(c, prior_sd=_ROW_MOMENT * row_s**2) for c in part_columns(evidence, by_recording, linear)]


def target_of(evidence: CampaignEvidence, angular_gain: float) -> list[ComplexArray]:
    """Left-hand sides by recording, turned by the wave's phase, less the response to the applied rate, ``-kappa Omega J V``."""
    return [r.turn * (r.signal.lhs - angular_gain * (r.signal.rate_pick[:, 0, 1] - r.signal.rate_pick[:, 1, 0])) for r in evidence]


def quiet_target_of(evidence: CampaignEvidence, angular_gain: float) -> list[ComplexArray]:
    """The same at the quiet lines."""
    return [r.turn * (r.quiet.lhs - angular_gain * (r.quiet.rate_pick[:, 0, 1] - r.quiet.rate_pick[:, 1, 0])) for r in evidence]


def frequency_columns(evidence: CampaignEvidence, feedthrough: ComplexArray | None = None) -> list[Column]:
    """How the resonance follows its temperature: ``i T (V - E u)``, for what feeds through does not resonate.

    Far from the temperature of reference that is no small matter: 10 K of silica and E = 2e-4 are 1e-2 rad/s of the drive.
    """
    columns = _warming("frequency_per_k", "warm", evidence, feedthrough, np.inf)
    if span_k(evidence) >= TEMPERATURE_SPAN_K:
        columns += _warming("frequency_per_k2", "warm2", evidence, feedthrough, _FREQUENCY_PER_K2 * evidence.omega0_rad_s)
    return columns


def _blurred_temperature(evidence: CampaignEvidence, linear: Linear) -> list[Column]:
    """A temperature that was smoothed over t: its corners are rounder than the resonator's by t^2/24 of its curvature."""
    by_recording = []
    for r in evidence:
        s = r.signals
        curvature = np.gradient(np.gradient(s.temperature_k, s.row_s), s.row_s)[:, None]
        motion = s.pick - s.drive @ linear.E.T
        by_recording.append([Part("temperature_blur", "flow", 1j * linear.frequency_slope_rad_s_k * curvature * motion)])
    return [replace(c, prior_sd=SMOOTH_S**2 / 24.0) for c in part_columns(evidence, by_recording, linear)]


def _warming(name: str, term: str, evidence: CampaignEvidence, feedthrough: ComplexArray | None, prior_sd: float) -> list[Column]:
    sides = []
    for place in (SIGNAL, QUIET):
        vectors = []
        for r in evidence:
            vector = (r.quiet if place.quiet else r.signal).terms[term][:, 0]
            if feedthrough is not None:
                rise = r.signals.temperature_k[:, None] ** (1 if term == "warm" else 2)
                vector = vector - place.projector(r).plain((rise * (r.signals.drive @ feedthrough.T))[:, None, :])[:, 0]
            vectors.append(r.turn * 1j * vector)
        sides.append(tuple(vectors))
    return [Column(name, sides[0], sides[1], prior_sd)] if any(np.any(v) for v in sides[0]) else []


def span_k(evidence: CampaignEvidence) -> float:
    """Span of the temperature over a campaign [K]."""
    return float(np.ptp(np.concatenate([r.signals.temperature_k for r in evidence])))


def thermal_columns(evidence: CampaignEvidence, linear: Linear) -> list[Column]:
    """How a healthy device follows its temperature, and a record that is late."""
    columns: list[Column] = []
    columns += _form(evidence, linear, "drive_lag", {"tau": _LAG_S})
    columns += _blurred_records(evidence, linear)
    if span_k(evidence) < _NOTICED_K:
        return columns
    columns += _form(evidence, linear, "thermal_lag", {"tau": _SENSOR_LAG_S})
    columns += _blurred_temperature(evidence, linear)
    damping = abs(np.trace(linear.A).real) / 2.0
    split = 2.0 * abs(linear.frequency_slope_rad_s_k / evidence.omega0_rad_s)
    anisotropy = np.abs(linear.A - np.eye(2) * np.trace(linear.A) / 2.0).max()
    columns += _form(evidence, linear, "thermal_damping", {"c": _DAMPING_PER_K * damping})
    columns += _collected("damping_per_k2", evidence, lambda r, p: p.terms["warm2"][:, 0], _DAMPING_PER_K2 * damping, real=True)
    sd = _DAMPING_PER_K * float(np.abs(linear.A.real - np.eye(2) * np.trace(linear.A).real / 2.0).max()) + 1e-3 * damping * _DAMPING_PER_K
    columns += _form(evidence, linear, "thermal_damping_anisotropy", {"c_c": sd, "c_s": sd})
    columns += _form(evidence, linear, "thermal_split", {"k_c": split * anisotropy, "k_s": split * anisotropy})
    for name, size in (
        ("thermal_drive_gain", _GAIN_PER_K),
        ("thermal_drive_phase", _PHASE_PER_K),
        ("thermal_pickoff_gain", _GAIN_PER_K),
        ("thermal_pickoff_phase", _PICKOFF_PHASE_PER_K),
    ):
        columns += _form(evidence, linear, name, {"g_x": size, "g_y": size})
    return columns + _gradient_columns(evidence, linear, sd)


def _gradient_columns(evidence: CampaignEvidence, linear: Linear, rate_per_k: float) -> list[Column]:
    """Gains and damping while the temperature moves: their places are not the sensor's, and lag behind it by tenths of a second.

    And the bias in rate that follows the temperature as the damping's anisotropy does, which healthy devices have as well.
    """
    by_recording = []
    for r in evidence:
        slope = np.gradient(r.signals.temperature_k, r.signals.row_s)[:, None]
        motion = r.signals.pick - r.signals.drive @ linear.E.T
        parts = [Part(f"gradient_gain_{a}", "drive", slope * r.signals.drive * np.eye(2)[k]) for k, a in enumerate("xy")]
        turned = r.signals.temperature_k[:, None] * np.stack([motion[:, 1], -motion[:, 0]], axis=1)
        by_recording.append([*parts, Part("gradient_damping", "flow", -slope * motion), Part("rate_per_k", "flow", turned)])
    damping = abs(np.trace(linear.A).real) / 2.0
    sizes = {"gradient_damping": _DAMPING_PER_K * damping * _GRADIENT_LAG_S, "rate_per_k": rate_per_k}
    found = part_columns(evidence, by_recording, linear)
    return [replace(c, prior_sd=sizes.get(c.name, _GAIN_PER_K * _GRADIENT_LAG_S)) for c in found]


def with_wander(columns: Sequence[Column], wander_rad_s: Mapping[str, float]) -> list[Column]:
    """The same columns with another wander, by ``shift`` and ``slide``."""
    return [replace(c, prior_sd=wander_rad_s[kind]) if (kind := c.name.split("_")[0]) in wander_rad_s else c for c in columns]


def slow_columns(evidence: CampaignEvidence, linear: Linear, wander_rad_s: float) -> list[Column]:
    """What wanders slower than a campaign, and what reaches the drives besides the command: a floor of every device."""
    times = [float(r.signals.time_s.mean()) for r in evidence]
    span = max(max(times) - min(times), 1.0)
    ageing = _form(evidence, linear, "frequency_ageing", {"k": _SLOW * wander_rad_s / span})
    stray = _form(evidence, linear, "constant_force", dict.fromkeys(("f_xc", "f_xs", "f_yc", "f_ys"), _STRAY_DRIVE_V))
    return ageing + stray


def wander_columns(evidence: CampaignEvidence, wander_rad_s: float) -> list[Column]:
    """Every recording's own distance of its resonance, and how it moved steadily meanwhile."""
    columns = []
    for r in evidence:
        for k, name in enumerate(("shift", "slide")):
            columns.append(
                Column(
                    f"{name}_{r.index}",
                    tuple(r.turn * 1j * o.signal.resonance[:, k] if o is r else np.zeros(o.signal.lhs.size, complex) for o in evidence),
                    tuple(r.turn * 1j * o.quiet.resonance[:, k] if o is r else np.zeros(o.quiet.lhs.size, complex) for o in evidence),
                    wander_rad_s,
                )
            )
    return columns


def linear_of(evidence: CampaignEvidence, values: Mapping[str, float], angular_gain: float) -> Linear:
    """The linear device that a solution says."""

    def matrix(letter: str) -> ComplexArray:
        entries = [values.get(f"{letter}_{p}_re", 0.0) + 1j * values.get(f"{letter}_{p}_im", 0.0) for p in ("xx", "xy", "yx", "yy")]
        return np.array(entries).reshape(2, 2)

    A, reduced, E = matrix("A"), matrix("G"), matrix("E")
    moved = tuple(_moved(r, values) for r in evidence)
    return Linear(A, reduced + A @ E, E, angular_gain, values.get("frequency_per_k", 0.0), moved)


def _moved(r: RecordingEvidence, values: Mapping[str, float]) -> ComplexArray:
    """What the diagonal of A gained row by row: a pick-off that errs is multiplied by that too."""
    warm = r.signals.temperature_k
    damping = values.get("damping_per_k2", 0.0) * warm**2 - values.get("thermal_damping.c", 0.0) * warm
    return np.asarray(damping + 1j * _detuning(r, values))


def _detuning(r: RecordingEvidence, values: Mapping[str, float]) -> FloatArray:
    """How far the resonance lay from the frequency of reference, row by row, by its temperature and its wander."""
    s, slope = r.signals, values.get("frequency_per_k", 0.0)
    warm = slope * s.temperature_k + values.get("frequency_per_k2", 0.0) * s.temperature_k**2
    late = -slope * values.get("thermal_lag.tau", 0.0) * np.gradient(s.temperature_k, s.row_s)
    wander = values.get(f"shift_{r.index}", 0.0) + values.get(f"slide_{r.index}", 0.0) * np.linspace(-1.0, 1.0, len(s.time_s))
    return np.asarray(warm + late + wander + values.get("frequency_ageing.k", 0.0) * s.time_s)


def _form(evidence: CampaignEvidence, linear: Linear, name: str, sizes: dict[str, float]) -> list[Column]:
    columns = form_columns(evidence, FORMS[name], linear, {})
    return [Column(f"{name}.{c.name}", c.signal, c.quiet, sizes[c.name]) for c in columns if c.name in sizes]


def _open(r: RecordingEvidence) -> float:
    excitation = r.recording.command.excitation
    return excitation.frequency_hz if excitation.kind == "drive" else 0.0


def _body(r: RecordingEvidence) -> float:
    excitation = r.recording.command.excitation
    return excitation.frequency_hz if excitation.kind == "body" else 0.0


def _away(r: RecordingEvidence, omega0_rad_s: float) -> float:
    return 2.0 * np.pi * _open(r) / omega0_rad_s - 1.0 if _open(r) > 0.0 else 0.0
