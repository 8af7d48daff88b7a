"""Courses of what drifts with time: straight, or bent as a leak that fills its volume and as ageing that goes with the log of time are.

Each is the time of the campaign at its end, so that a drift's size is its mean per second whatever the course. Stiffness has its own bent
course, that of charge. A gain or a phase may walk as well (effects.md 31, 45): its mean per second, and about that line a bridge whose
sines ``sqrt(2) sin(pi k t/T)/(pi k)`` are as large as the end of the walk, which makes them a Wiener process to that order.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..quantity import Quantity
from .parts import Form, Linear, Part, Setting, beside, one_axis, read_at_once, velocity
from .signals import Signals

if TYPE_CHECKING:
    from .screen import Candidate, Screener

__all__ = [
    "BENT",
    "COURSES",
    "best_course",
    "drift_settings",
    "drifted",
    "drifting_damping",
    "drifting_feedthrough",
    "drifting_gains",
    "parameter_of",
    "said_course",
    "walk_sizes",
    "walks_in",
    "without_bent",
]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: settings: time constant of one that saturates, time from which on one that slows goes with the log; each with the end of the campaign
COURSES = ("saturates_s", "slows_s")
_END = "end_s"
#: setting of a course that walks, sines of its bridge, and what stands between a parameter's name and their number
_WALKS, _SINES, _SINE = "walks", 8, ".sine"
#: where what may walk stands
_PLACES = {
    "drive_gain_drift": ("drive", "in phase"),
    "drive_phase_drift": ("drive", "in quadrature"),
    "pickoff_gain_drift": ("pick-off", "in phase"),
    "pickoff_phase_drift": ("pick-off", "in quadrature"),
}
#: what stands between an effect's title and its course, where that is bent
BENT = "; along a course that "
#: times to try, over that of the campaign: shorter ones are steps
_SATURATES, _SLOWS = (0.12, 0.25, 0.6), (0.01, 0.05, 0.25)


def drift_settings(signals: list[Signals]) -> list[Setting]:
    """A straight course, ones that saturate, ones that slow."""
    end = max(float(s.time_s[-1]) for s in signals)
    bent = [{key: share * end, _END: end} for key, shares in zip(COURSES, (_SATURATES, _SLOWS), strict=True) for share in shares]
    return [{}, *bent]


def _walking_settings(signals: list[Signals]) -> list[Setting]:
    """The same, and one that walks."""
    return [*drift_settings(signals), {_WALKS: 1.0, _END: max(float(s.time_s[-1]) for s in signals)}]


def without_bent(candidates: Mapping[str, Sequence[Candidate]]) -> dict[str, Sequence[Candidate]]:
    """Effects without the bent courses: of those the noise is measured beside the loudest, a course without a name."""
    return {name: [c for c in tried if _END not in c.setting] for name, tried in candidates.items()}


def drifted(s: Signals, setting: Setting) -> FloatArray:
    """Course of a drift [s], shape (n,)."""
    end = setting.get(_END, 1.0)
    if "saturates_s" in setting:
        tau = setting["saturates_s"]
        return np.asarray(end * np.expm1(-s.time_s / tau) / np.expm1(-end / tau))
    if "slows_s" in setting:
        first = setting["slows_s"]
        return np.asarray(end * np.log1p(np.maximum(s.time_s, 0.0) / first) / np.log1p(end / first))
    return s.time_s


def drifting_gains(factor: complex, *, of_drive: bool) -> Form:
    """Gains (``factor`` 1) or phases (1j) of drives or pick-offs that drift or walk, by axis."""

    def parts(s: Signals, d: Linear, setting: Setting) -> list[Part]:
        return [
            part
            for sine, course in _courses(s, setting)
            for part in _by_axis(s, d, sine, np.asarray(factor * course[:, None], dtype=complex), of_drive)
        ]

    return Form(parts, _walking_settings)


def _courses(s: Signals, setting: Setting) -> list[tuple[str, FloatArray]]:
    """The course of a drift [s], and the sines that go with it where it walks."""
    walked = range(1, _SINES + 1) if _WALKS in setting else ()
    end = setting.get(_END, 1.0)
    bridge = [(f"{_SINE}{k}", end * math.sqrt(2.0) / (math.pi * k) * np.sin(math.pi * k * s.time_s / end)) for k in walked]
    return [("", drifted(s, setting)), *bridge]


def _by_axis(s: Signals, d: Linear, sine: str, course: ComplexArray, of_drive: bool) -> list[Part]:
    if of_drive:
        return [Part(f"g_{n}{sine}", "drive", one_axis(course * s.drive, k)) for k, n in enumerate("xy")]
    return [read_at_once(f"g_{n}{sine}", s, d, lambda v, k=k: one_axis(course * v, k)) for k, n in enumerate("xy")]  # type: ignore[misc]


def walks_in(candidates: Iterable[Candidate]) -> set[tuple[str, str]]:
    """Location and phase of what walks among effects: faster than the sines it does so too, and makes a floor of what flickers."""
    return {_PLACES[c.name] for c in candidates if _WALKS in c.setting}


def walk_sizes(setting: Setting, sizes: Mapping[str, tuple[float, float]], unit: str) -> dict[str, Quantity]:
    """How far a course that walks goes, by axis: the sd of its steps over the square root of their time; nothing of other courses.

    Its mean per second and every sine of its bridge are as large as that over the square root of the campaign's time.

    Parameters
    ----------
    setting : mapping
    sizes : mapping
        Value and sd of every column.
    unit : str
        Of the mean per second.
    """
    if _WALKS not in setting:
        return {}
    told = {}
    for axis in "xy":
        of_axis = [size for column, size in sizes.items() if parameter_of(column) == f"g_{axis}"]
        if not of_axis:
            continue
        square = float(np.mean([value**2 for value, _ in of_axis]))
        beyond = max(square - float(np.mean([sd**2 for _, sd in of_axis])), 0.0)
        size, sd = (math.sqrt(setting[_END] * x) for x in (beyond, square / (2.0 * len(of_axis))))
        told[f"walk_{axis}"] = Quantity(size, sd, f"{unit.removesuffix('/s')}/sqrt(s)")
    return told


def parameter_of(column: str) -> str:
    """Parameter whose prior a column has: its own, or that of the walk that it is a sine of."""
    return column.split(_SINE)[0]


def drifting_damping(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    """Damping that drifts alike along all directions, and its anisotropy, which may do so in proportion."""
    lost = -drifted(s, setting)[:, None] * velocity(s, d)
    damping = -0.5 * (d.A + d.A.conj().T).real
    anisotropy = damping / (0.5 * np.trace(damping)) - np.eye(2)
    return [Part("c", "flow", lost), beside("anisotropy", "flow", lost @ anisotropy.T)]


def drifting_feedthrough(s: Signals, setting: Setting, *, across: bool) -> list[Part]:
    """What feeds through of an axis' own drive, or ``across`` of the other one's: in phase (c) and a quarter of a cycle off (s)."""
    fed = drifted(s, setting)[:, None] * (s.drive[:, ::-1] if across else s.drive)
    return [Part(f"e_{n}{q}", "output", f * fed * np.eye(2)[k]) for k, n in enumerate("xy") for q, f in (("c", 1.0), ("s", 1j))]


def best_course(beside: Screener, tried: Sequence[Candidate], here: Candidate, refined: Callable[[Candidate], Candidate]) -> Candidate:
    """An effect at its best settings; a drift along the course that explains most: as it was found it had the others' share in its own.

    A straight line is one course and bent ones are many: of these the best must be better by what their number makes of chance. One that
    was by 0.4 in log evidence had twice the size, for at its beginning a bent one goes faster.

    Parameters
    ----------
    beside : Screener
        Of all other effects that were found.
    tried : sequence of Candidate
        The effect at every setting of its grid.
    here : Candidate
        As it was found.
    refined : callable
        A candidate at its best settings near its own. Between their grids' points courses of two kinds can be as good.
    """
    bent = [[c for c in tried if key in c.setting] for key in COURSES]
    if not all(bent):
        return refined(here)
    bent += [[c] for c in tried if _WALKS in c.setting]
    best = [max(beside.screened(of_kind), key=lambda s: s.log_evidence).candidate for of_kind in bent]
    straight = [c for c in tried if not c.setting]
    ahead = math.log(sum(len(of_kind) for of_kind in bent))
    found = beside.screened(map(refined, (here, *straight, *best)))
    return max(found, key=lambda s: s.log_evidence + (0.0 if s.candidate.setting else ahead)).candidate


def said_course(setting: Setting) -> str:
    """Words on a course that is bent, after the title of an effect."""
    if _WALKS in setting:
        return f"{BENT}walks at random about its mean"
    if "saturates_s" in setting:
        return f"{BENT}saturates, with a time constant of about {setting['saturates_s']:.2g} s"
    return f"{BENT}slows, as the log of time from about {setting['slows_s']:.2g} s on" if "slows_s" in setting else ""
