"""Gains, phases and damping that follow the clock as no registry has it: to and fro, another from a moment on, anew in each recording.

A thermostat's cycle, a supply that is refreshed, a contact that moved, a stage that is muted between recordings: their
sources are without number, their courses of time are few. And those of the temperature: a mode of the mount or of the gas that crosses
the wave's frequency at one temperature makes a peak there, a bond that softens a step. Within a recording a course is a parabola, where
the temperature moves a polynomial of degree eight, so a handful of projected columns makes them all: each kind of signal times the first
Legendre polynomials of the recording's time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from .anonymous import Anonymous
from .column import Column
from .columns import part_columns
from .evidence import CampaignEvidence
from .linear_device import TEMPERATURE_SPAN_K, span_k
from .parts import SPLIT, Linear, Part, read_at_once
from .screen import Candidate, Screened, Screener, worth
from .signals import Signals
from .system import Whitener

__all__ = ["Courses", "courses_of"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: polynomials of a recording's time: of one whose temperature stands, and of one whose temperature moves
_MOMENTS, _WARMING_MOMENTS = 3, 9
#: temperatures that are tried over the campaign's span, and half a peak's width over their distance
_PLACES_K, _HALF_WIDTH = 8, 0.6
#: shortest period [s]; steps of the frequency over one by the campaign's time; longest period over that time
_SHORTEST_S, _FINER, _LONGEST = 15.0, 0.5, 0.5
#: how soon what is switched on with a recording settles [s]
_SETTLING_S = (2.0, 5.0, 15.0)
#: time constants of what charges, warms up or ages from the beginning of the campaign on, over its time
_SATURATES = (0.12, 0.25, 0.5)
#: size of an unnamed course over the gain or the damping that it changes, sd: one of order one would wipe out an axis that holds but noise
_SIZE = 0.01
#: where, in which phase, and of what shape, each an unknown: of an axis, of both alike, of what makes one axis unlike the other,
#: of a rate
_AXES, _ALIKE = (np.diag([1.0, 0.0]), np.diag([0.0, 1.0])), (np.eye(2),)
_CROSSED = (np.array([[0.0, -1.0], [1.0, 0.0]]),)
_PLACES = (
    *((location, phase, _AXES) for location in ("drive", "pick-off") for phase in ("in phase", "in quadrature")),
    ("dynamics", "in phase", _ALIKE),
    ("dynamics", "in phase", SPLIT),
    ("dynamics", "in quadrature", SPLIT),
    ("dynamics", "in phase", _CROSSED),
)


@dataclass(frozen=True)
class _Worth:
    """What a course of one place explains."""

    log_evidence: float
    gain: float
    rank: int
    course: int
    place: int


@dataclass(frozen=True)
class _Course:
    """A course: what it is, how many were tried of its kind, its functions, each of rows of a recording, and of what it is one."""

    form: str
    choices: int
    functions: tuple[Callable[[Signals], FloatArray], ...]
    depends_on: str = "time"


@dataclass(frozen=True)
class Courses:
    """All courses of a campaign, ready to be screened.

    Parameters
    ----------
    base : tuple of Column
        Of every place, axis and polynomial.
    places : tuple of int
        Place of each base column: location, phase and shape.
    forms : tuple of (str, int, str)
        Courses, how many of the kind were tried, and on what they depend.
    weights : ndarray, shape (functions, recordings, polynomials)
        Courses by recording in Legendre polynomials.
    of_course : ndarray of int, shape (functions,)
    """

    base: tuple[Column, ...]
    places: tuple[int, ...]
    forms: tuple[tuple[str, int, str], ...]
    weights: FloatArray
    of_course: NDArray[np.intp]

    def best(self, screener: Screener, whitener: Whitener, depends_on: str | None = None) -> tuple[Screened, Anonymous] | None:
        """The course that is worth most beside what a screener holds; of those alone that depend on something."""
        told = (w for w in self._worths(screener, whitener) if depends_on in (None, self.forms[w.course][2]))
        best = max(told, key=lambda w: w.log_evidence, default=None)
        if best is None:
            return None
        found = screener.screen(self._candidate(best.course, best.place))
        if found is None:
            return None
        location, phase, shape = _PLACES[best.place]
        form, _, depends = self.forms[best.course]
        return replace(found, gain=best.gain, rank=best.rank), Anonymous(location, phase, form + _of_shape(shape), depends)

    def _worths(self, screener: Screener, whitener: Whitener) -> Iterator[_Worth]:
        """Every course of every place that may be larger than the noise."""
        rows = whitener.design(self.base, self.weights.shape[1])
        recording = np.repeat(np.arange(self.weights.shape[1]), [2 * v.size for v in self.base[0].signal])
        for place in dict.fromkeys(self.places):
            block = rows[:, [k for k, other in enumerate(self.places) if other == place]].reshape(len(rows), -1, self.weights.shape[2])
            # rows, functions, axes
            made = np.einsum("rfm,ram->rfa", self.weights.transpose(1, 0, 2)[recording], block)
            clean = screener.cleaned(made.reshape(len(rows), -1)).reshape(-1, *made.shape[1:])
            for k, (_, choices, _) in enumerate(self.forms):
                columns = clean[:, self.of_course == k].reshape(len(clean), -1)
                gain, rank = _explained(columns, screener.left)
                if rank:
                    yield _Worth(worth(gain, rank, choices), gain, rank, k, place)

    def _candidate(self, course: int, place: int) -> Candidate:
        """A course as an effect."""
        base = [column for column, other in zip(self.base, self.places, strict=True) if other == place]
        columns: list[Column] = []
        for f in np.flatnonzero(self.of_course == course):
            for first in range(0, len(base), self.weights.shape[2]):
                signal, quiet = (
                    tuple(np.tensordot(w, parts, 1) for w, parts in zip(self.weights[f], side, strict=True))
                    for side in _sides(base[first : first + self.weights.shape[2]])
                )
                columns.append(Column(f"c_{len(columns)}", signal, quiet))
        form, choices, _ = self.forms[course]
        return Candidate(f"{_PLACES[place][0]} {form}", {}, tuple(columns), np.full(len(columns), _SIZE), choices)


def _of_shape(shape: tuple[FloatArray, ...]) -> str:
    if shape is SPLIT:
        return ", other on each axis or crossed"
    return ", crossed" if shape is _CROSSED else ""


def _sides(columns: Sequence[Column]) -> tuple[list[ComplexArray], list[ComplexArray]]:
    """Signal and quiet lines by recording, columns one below the other."""
    recordings = range(len(columns[0].signal))
    return [np.stack([c.signal[r] for c in columns]) for r in recordings], [np.stack([c.quiet[r] for c in columns]) for r in recordings]


def courses_of(evidence: CampaignEvidence, linear: Linear, *, read_late: bool = False) -> Courses:
    """Project what the courses of a campaign are made of; none of a temperature that was ``read_late``: it begins and ends elsewhere."""
    moves = span_k(evidence) >= TEMPERATURE_SPAN_K and not read_late
    most = _WARMING_MOMENTS if moves else _MOMENTS
    moments = [most if r.is_warming else _MOMENTS for r in evidence]
    base = part_columns(evidence, [_parts(r.signals, linear, own, most) for r, own in zip(evidence, moments, strict=True)], linear)
    courses = [*_courses(evidence), *(_of_temperature(evidence) if moves else ())]
    functions = [function for course in courses for function in course.functions]
    weights = np.stack([_moments(r.signals, functions, own, most) for r, own in zip(evidence, moments, strict=True)], axis=1)
    of_course = np.repeat(np.arange(len(courses)), [len(course.functions) for course in courses])
    places = tuple(int(c.name.split(".")[0]) for c in base)
    forms = tuple((c.form, c.choices, c.depends_on) for c in courses)
    return Courses(tuple(base), places, forms, weights, of_course)


def _parts(s: Signals, d: Linear, moments: int, most: int) -> list[Part]:
    """Every kind of signal times so many polynomials, and nothing times the rest of the most that any recording has."""
    motion = s.pick - s.drive @ d.E.T
    decay = 0.5 * abs(float(np.trace(d.A).real))
    parts = []
    for k, (location, phase, shape) in enumerate(_PLACES):
        factor = 1.0 + 0j if phase == "in phase" else 1j
        for j, matrix in enumerate(shape):
            for m in range(most):
                name = f"{k}.{j}.{m}"
                if m >= moments:
                    parts.append(Part(name, "flow", np.zeros_like(motion)))
                    continue
                w = factor * _polynomial(s, m, most)[:, None]
                if location == "dynamics":
                    parts.append(Part(name, "flow", -decay * w * (motion @ matrix)))
                elif location == "drive":
                    parts.append(Part(name, "drive", w * (s.drive @ matrix)))
                else:
                    parts.append(read_at_once(name, s, d, lambda v, w=w, matrix=matrix: w * (v @ matrix)))  # type: ignore[misc]
    return parts


def _courses(evidence: CampaignEvidence) -> Iterator[_Course]:
    """All courses that are tried."""
    starts = sorted(float(r.signals.time_s[0]) for r in evidence)
    span = max(float(r.signals.time_s[-1]) for r in evidence) - starts[0]
    frequencies = np.arange(1.0 / (_LONGEST * span), 1.0 / _SHORTEST_S, _FINER / span)
    for f in frequencies:
        functions = tuple(lambda s, f=f, wave=wave: wave(2.0 * math.pi * f * s.time_s) for wave in (np.cos, np.sin))  # type: ignore[misc]
        yield _Course(f"x times what goes to and fro every {1.0 / f:.0f} s", len(frequencies), functions)
    for start in starts[1:]:
        step = (lambda s, start=start: 1.0 * (s.time_s >= start - 1e-6),)  # type: ignore[misc]
        yield _Course(f"x times what is another from {start:.0f} s on", len(starts) - 1, step)
    for share in _SATURATES:
        tau = share * span
        saturating = (lambda s, tau=tau: -np.expm1(-s.time_s / tau),)  # type: ignore[misc]
        yield _Course(f"x times what saturates over {tau:.2g} s", len(_SATURATES), saturating)
    for tau in _SETTLING_S:
        settling = (lambda s, tau=tau: np.exp(-(s.time_s - s.time_s[0]) / tau),)  # type: ignore[misc]
        yield _Course(f"x times what settles anew in each recording over {tau:.0f} s", len(_SETTLING_S), settling)


def _of_temperature(evidence: CampaignEvidence) -> Iterator[_Course]:
    """Peaks, steps and bends about temperatures of the campaign's span."""
    lowest = min(float(r.signals.temperature_k.min()) for r in evidence)
    apart = (max(float(r.signals.temperature_k.max()) for r in evidence) - lowest) / _PLACES_K
    for k in range(2 * _PLACES_K - 1):
        about = lowest + 0.5 * (k + 1) * apart
        degc = about + evidence.temperature_degc
        # peaks between the steps
        if k % 2 == 0:
            peak = (lambda s, about=about: 1.0 / (1.0 + ((s.temperature_k - about) / (_HALF_WIDTH * apart)) ** 2),)  # type: ignore[misc]
            yield _Course(f"x times what peaks about {degc:.1f} degC", _PLACES_K, peak, "temperature")
        else:
            step = (lambda s, about=about: np.tanh((s.temperature_k - about) / (_HALF_WIDTH * apart)),)  # type: ignore[misc]
            yield _Course(f"x times what is another above {degc:.1f} degC", _PLACES_K - 1, step, "temperature")
            bend = (lambda s, about=about: np.maximum(s.temperature_k - about, 0.0) / apart,)  # type: ignore[misc]
            yield _Course(f"x times what grows above {degc:.1f} degC alone", _PLACES_K - 1, bend, "temperature")


def _polynomial(s: Signals, degree: int, count: int) -> FloatArray:
    """Legendre polynomial of a recording's time."""
    return np.asarray(legendre.legval(np.linspace(-1.0, 1.0, len(s.time_s)), np.eye(count)[degree]))


def _moments(s: Signals, functions: Sequence[Callable[[Signals], FloatArray]], own: int, most: int) -> FloatArray:
    """Functions of one recording in its own Legendre polynomials, shape (functions, most)."""
    place = np.linspace(-1.0, 1.0, len(s.time_s))
    fitted = legendre.legfit(place, np.stack([function(s) for function in functions], axis=1), own - 1).T
    return np.pad(fitted, ((0, 0), (0, most - own)))


def _explained(columns: FloatArray, left: FloatArray) -> tuple[float, int]:
    """Chi-square that columns take away with sizes that they can have, and in how many directions they may be larger than the noise."""
    inside = _SIZE * (columns.T @ left)
    w, v = np.linalg.eigh(_SIZE**2 * (columns.T @ columns))
    w = np.maximum(w, 0.0)
    return float(np.sum((v.T @ inside) ** 2 / (1.0 + w))), int(np.sum(w > 1.0))
