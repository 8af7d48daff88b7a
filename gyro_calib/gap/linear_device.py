"""The linear slow flow as columns of a campaign's equations: A, G, E, how the resonance follows its temperature.

What physics bounds (a feedthrough that follows frequency) has a prior of that size.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from ..estimation.wave_projection import WaveProjected
from .column import Column
from .columns import QUIET, SIGNAL
from .evidence import CampaignEvidence, RecordingEvidence
from .followed import Followed, followed_by
from .one_axis import of_both, untied
from .parts import Linear

__all__ = [
    "FEEDTHROUGH",
    "ROW_MOMENT",
    "TEMPERATURE_SPAN_K",
    "collected",
    "combined",
    "entry",
    "frequency_columns",
    "knows_its_resonance",
    "linear_columns",
    "linear_of",
    "quiet_target_of",
    "reaction_of",
    "span_k",
    "target_of",
]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
_Regressor = Callable[[RecordingEvidence, WaveProjected], ComplexArray]

#: curvature of the frequency [1/K^2]
_FREQUENCY_PER_K2 = 1e-7
#: change of E over a relative distance of one from resonance, and its curvature, over E: a delay of some cycles of the carrier
_DISPERSION, _BENT_DISPERSION = 5.0, 12.0
#: the same of multiplexed electronics, whose resonance rings on in the slots that do not drive it, as its answer to the drive does
_RINGING, _BENT_RINGING = 5e-3, 1e-2
#: feedthrough of a chain that nobody measured; second moment of a row's filter over the squared row
FEEDTHROUGH, ROW_MOMENT = 2e-3, 1.0
#: temperature's span over a campaign from which on what depends on it can be measured; more no resonator follows it [1/K]
TEMPERATURE_SPAN_K, _MOST_PER_K = 0.5, 3e-4


def collected(
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


def entry(field: str, a: int, b: int | None, weight: Callable[[RecordingEvidence], float] = lambda r: 1.0) -> _Regressor:
    """Regressor of one entry of the projected signals, weighed by recording."""

    def values(r: RecordingEvidence, p: WaveProjected) -> ComplexArray:
        array = getattr(p, field)
        return np.asarray(weight(r) * (array[:, a] if b is None else array[:, a, b]))

    return values


def _shaken_at(frequency_hz: float) -> Callable[[RecordingEvidence], float]:
    return lambda r: float(_body(r) == frequency_hz)


def combined(
    first: tuple[int, int],
    second: tuple[int, int],
    sign: float,
    field: str = "rate_pick",
    weight: Callable[[RecordingEvidence], float] = lambda r: 1.0,
) -> _Regressor:
    """Sum or difference of two entries of the response to rate, or of another of the projected signals, weighed by recording."""
    one, other = entry(field, *first, weight), entry(field, *second, weight)
    return lambda r, p: one(r, p) + sign * other(r, p)


def linear_columns(evidence: CampaignEvidence, linear: Linear | None = None) -> list[Column]:
    """A, G~, E, body, force that does not follow the wave.

    ``linear``: the device as far as it is known, for where its resonance lay: what feeds through does not follow it.
    """
    columns: list[Column] = []
    bodies = sorted({_body(r) for r in evidence if _body(r) > 0.0})
    open_drive = {round(_open(r), 3) for r in evidence if _open(r) > 0.0}
    driven = {r.recording.command.excitation.axis for r in evidence if _open(r) > 0.0}
    feeds = float(np.abs(linear.E).max()) if linear is not None else FEEDTHROUGH
    for a in range(2):
        for b in range(2):
            place = f"{'xy'[a]}{'xy'[b]}"
            columns += collected(f"A_{place}", evidence, entry("pick", a, b))
            columns += collected(f"G_{place}", evidence, entry("drive", a, b))
            # without open drive of its axis a feedthrough of usual size is allowed for, not taken to be absent
            known = np.inf if "xy"[b] in driven else FEEDTHROUGH
            columns += _feedthrough(place, evidence, linear, (a, b), known)
            if len(open_drive) > 1:
                for name, power, over_e in (("dispersion", 1, _DISPERSION), ("bent_dispersion", 2, _BENT_DISPERSION)):
                    by_distance = entry("drive_rate", a, b, lambda r, power=power: _away(r, evidence.omega0_rad_s) ** power)  # type: ignore[misc]
                    columns += collected(f"{name}_{place}", evidence, by_distance, over_e * feeds)
        for f in bodies:
            columns += collected(f"body_{'xy'[a]}_{f:.0f}", evidence, entry("body", a, None, _shaken_at(f)))
        if evidence.turns:
            columns += collected(f"force_{'xy'[a]}", evidence, entry("constant", a, None, lambda r: float(r.is_wave)))
    if linear is not None and len(open_drive) > 1:
        columns += _ringing(evidence, linear.G / np.abs(linear.G).max())
    return of_both(evidence, columns)


def _ringing(evidence: CampaignEvidence, direction: ComplexArray) -> list[Column]:
    """What multiplexed electronics feed through away from resonance: one function of the distance times G."""
    columns: list[Column] = []
    for name, power, size in (("ringing", 1, _RINGING), ("bent_ringing", 2, _BENT_RINGING)):

        def rung(r: RecordingEvidence, p: WaveProjected, power: int = power) -> ComplexArray:
            return np.asarray(_away(r, evidence.omega0_rad_s) ** power * np.einsum("nab,ab->n", p.drive_rate, direction))

        columns += collected(name, evidence, rung, size)
    return columns


def target_of(evidence: CampaignEvidence, angular_gain: float) -> list[ComplexArray]:
    """Left-hand sides by recording, turned by the wave's phase, less the response to the applied rate, ``-kappa Omega J V``."""
    return [r.turn * (r.signal.lhs - angular_gain * (r.signal.rate_pick[:, 0, 1] - r.signal.rate_pick[:, 1, 0])) for r in evidence]


def quiet_target_of(evidence: CampaignEvidence, angular_gain: float) -> list[ComplexArray]:
    """The same at the quiet lines."""
    return [r.turn * (r.quiet.lhs - angular_gain * (r.quiet.rate_pick[:, 0, 1] - r.quiet.rate_pick[:, 1, 0])) for r in evidence]


def _feedthrough(place: str, evidence: CampaignEvidence, linear: Linear | None, entry: tuple[int, int], prior_sd: float) -> list[Column]:
    """``L[u]``, less what temperature and rate moved: they move the motion ``V - E u``, not what feeds through.

    Ten kelvins of silica and E = 2e-4 are 1e-2 rad/s of the drive. In the column of E itself that holds for whatever E comes out, also
    once an effect that passed for a feedthrough is named.
    """
    a, b = entry
    sides = []
    for where in (SIGNAL, QUIET):
        vectors = []
        for r in evidence:
            projected = r.quiet if where.quiet else r.signal
            vector = projected.drive_rate[:, a, b]
            if linear is not None:
                vector = vector + (-1) ** a * linear.angular_gain * projected.rate_drive[:, 1 - a, b]
            if linear is not None and linear.followed is not None:
                still = np.zeros((len(r.signals.time_s), 2), complex)
                still[:, a] = 1j * linear.followed.rad_s[r.index] * r.signals.drive[:, b]
                vector = vector - where.projector(r).plain([still])[:, 0]
            vectors.append(r.turn * vector)
        sides.append(vectors)
    if not any(np.any(v) for v in sides[0]):
        return []
    return [
        Column(f"E_{place}_{name}", tuple(f * v for v in sides[0]), tuple(f * v for v in sides[1]), prior_sd)
        for name, f in (("re", 1.0 + 0j), ("im", 1j))
    ]


def frequency_columns(evidence: CampaignEvidence) -> list[Column]:
    """How the resonance follows its temperature: ``i T V``, what feeds through left to the column of E."""
    columns = collected("frequency_per_k", evidence, lambda r, p: 1j * p.terms["warm"][:, 0], real=True)
    if span_k(evidence) >= TEMPERATURE_SPAN_K:
        curvature = _FREQUENCY_PER_K2 * evidence.omega0_rad_s
        columns += collected("frequency_per_k2", evidence, lambda r, p: 1j * p.terms["warm2"][:, 0], curvature, real=True)
    return columns


def span_k(evidence: CampaignEvidence) -> float:
    """Span of the temperature over a campaign [K]."""
    return float(np.ptp(np.concatenate([r.signals.temperature_k for r in evidence])))


def linear_of(evidence: CampaignEvidence, values: Mapping[str, float], angular_gain: float, followed: Followed | None = None) -> Linear:
    """The linear device that a solution says; ``followed``: where the fit for the column of E found its resonance."""

    def matrix(letter: str) -> ComplexArray:
        entries = [values.get(f"{letter}_{p}_re", 0.0) + 1j * values.get(f"{letter}_{p}_im", 0.0) for p in ("xx", "xy", "yx", "yy")]
        return np.array(entries).reshape(2, 2)

    (A, reduced), E = untied(evidence, matrix("A"), matrix("G")), matrix("E")
    moved = tuple(_moved(r, values) for r in evidence)
    slope = values.get("frequency_per_k", 0.0)
    return Linear(A, reduced + A @ E, E, angular_gain, slope, moved, followed, reaction_of(values, angular_gain))


def reaction_of(values: Mapping[str, float], angular_gain: float) -> ComplexArray:
    """What a rate does to the volts over kappa, shape (2, 2), with what is symmetric in it as a solution says."""
    s, a = (complex(values.get(f"rate_{n}_re", 0.0), values.get(f"rate_{n}_im", 0.0)) / angular_gain for n in ("mismatch", "skew"))
    return np.array([[-a, -1.0 - s], [1.0 - s, a]])


def knows_its_resonance(evidence: CampaignEvidence, values: Mapping[str, float]) -> bool:
    """Whether a solution says where the resonance lay: of a temperature that is its sensor's noise the coefficient is any number."""
    return abs(values.get("frequency_per_k", 0.0)) < _MOST_PER_K * evidence.omega0_rad_s


def _moved(r: RecordingEvidence, values: Mapping[str, float]) -> ComplexArray:
    """What the diagonal of A gained row by row: a pick-off that errs is multiplied by that too."""
    warm = r.signals.temperature_k
    damping = values.get("damping_per_k2", 0.0) * warm**2 - values.get("thermal_damping.c", 0.0) * warm
    return np.asarray(damping + 1j * _detuning(r, values))


def _detuning(r: RecordingEvidence, values: Mapping[str, float]) -> FloatArray:
    """How far the resonance lay from the frequency of reference, row by row, by its temperature and its wander."""
    s, slope = r.signals, values.get("frequency_per_k", 0.0)
    late = -slope * values.get("thermal_lag.tau", 0.0) * np.gradient(s.reading_k, s.row_s)
    return np.asarray(followed_by(r, values) + late + values.get("frequency_ageing.k", 0.0) * s.time_s)


def _open(r: RecordingEvidence) -> float:
    excitation = r.recording.command.excitation
    return excitation.frequency_hz if excitation.kind == "drive" else 0.0


def _body(r: RecordingEvidence) -> float:
    excitation = r.recording.command.excitation
    return excitation.frequency_hz if excitation.kind == "body" else 0.0


def _away(r: RecordingEvidence, omega0_rad_s: float) -> float:
    return 2.0 * np.pi * _open(r) / omega0_rad_s - 1.0 if _open(r) > 0.0 else 0.0
