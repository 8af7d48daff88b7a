"""Is it one device, and does its thermometer say what its resonance does? Asked of the reference's frequency before anything is fitted.

A resonance goes with the temperature by the device's own coefficient. What stands elsewhere in one recording is another device, another
unit of a column, or a thermometer that is not read: none of them is an effect, and each had the name of one. Waves on one axis are
compared with each other, for the two modes of a ring may lie hertz apart.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..recording.recording import Recording
from .signals import WARMING_K

__all__ = ["check_one_device", "said_of_decay", "said_of_reference"]

FloatArray = NDArray[np.float64]
#: how far a resonance may stand from where its like have it at its temperature: relative, of a wave on one axis and of any other wave,
#: whose azimuth or control moves it; in kelvins of its own coefficient; and over the usual distance
_APART, _APART_WAVES, _APART_K, _TIMES_USUAL = 2e-4, 1e-3, 5.0, 10.0
#: a coefficient is known from pairs of times whose temperatures are so far apart [K]; parts of a recording that are looked at
_TOLD_K, _PARTS = 1.0, 8
#: nearer than this share of its distance a temperature that is read as degF is what the resonance says
_EXPLAINED = 0.2
#: a temperature so far from the factory's reference is worth a word [K]; a nominal frequency and quality factor so far off, relative
_FAR_K, _FAR_HZ, _FAR_Q = 40.0, 0.02, 2.0
_FEWEST = 3


@dataclass(frozen=True)
class _Course:
    """Of one recording: means of its parts.

    Parameters
    ----------
    recording : Recording
    hertz, kelvins : ndarray, shape (parts,)
    """

    recording: Recording
    hertz: FloatArray
    kelvins: FloatArray

    @property
    def kind(self) -> tuple[str, str | None]:
        """Those of one kind have one resonance at one temperature."""
        mode = self.recording.command.mode
        return ("ftr", self.recording.command.oscillator_axis) if mode.startswith("ftr") else ("wave", None)

    @property
    def allowed(self) -> float:
        """Relative distance from its like."""
        return _APART if self.kind[0] == "ftr" else _APART_WAVES


def check_one_device(recordings: Sequence[Recording]) -> None:
    """Refuse a recording whose resonance, at the temperature that it states, is not that of the others.

    Parameters
    ----------
    recordings : sequence of Recording

    Raises
    ------
    DataError
        Names the recording, both frequencies, and what to do.
    """
    kinds: dict[tuple[str, str | None], list[_Course]] = defaultdict(list)
    for r in recordings:
        if r.command.mode != "loops_off":
            kinds[_course(r).kind].append(_course(r))
    if len(kinds["wave", None]) >= _FEWEST:
        # one or two on an axis have no like but the waves, which may lie as far from them as from each other
        for few in [kind for kind, courses in kinds.items() if len(courses) < _FEWEST]:
            kinds["wave", None] += kinds.pop(few)
    alike = [courses for courses in kinds.values() if len(courses) >= _FEWEST]
    courses = [c for of_kind in alike for c in of_kind]
    if not courses:
        return
    _check_thermometer(courses)
    slope = _coefficient(alike)
    for of_kind in alike:
        _check_alike(of_kind, slope)


def said_of_reference(recordings: Sequence[Recording], factory: Mapping[str, Any]) -> list[str]:
    """Lines on factory data that the recordings contradict without harm to a verdict.

    Parameters
    ----------
    recordings : sequence of Recording
    factory : mapping
    """
    lines = []
    reference, nominal = factory.get("reference_temperature_degC"), factory.get("nominal_f0_hz")
    kelvins = float(np.median([np.median(r.temperature_degc) for r in recordings]))
    if isinstance(reference, int | float) and abs(kelvins - reference) > _FAR_K:
        lines.append(
            f"The recordings are at {kelvins:.4g} degC, but reference_temperature_degC of the factory is {reference:.4g}. If that is not "
            "so, one of them is in another unit (degF, K) or has the wrong sign."
        )
    found = float(np.median([np.median(r.column("ref_freq")) for r in recordings if r.command.mode != "loops_off"]))
    if isinstance(nominal, int | float) and nominal > 0.0 and abs(found / nominal - 1.0) > _FAR_HZ:
        lines.append(
            f"The resonance is at {found:.6g} Hz, but nominal_f0_hz of the factory is {nominal:.6g}: are the factory data this unit's?"
        )
    return lines


def said_of_decay(flow: NDArray[np.complex128], decay_rate: float) -> list[str]:
    """A line where the linear device decays otherwise than its factory data say.

    Parameters
    ----------
    flow : ndarray, shape (2, 2), complex
        A of the linear device [1/s].
    decay_rate : float
        1/tau of the factory [1/s].
    """
    found = -0.5 * float(np.trace(flow).real)
    if 1.0 / _FAR_Q < found / decay_rate < _FAR_Q or found <= 0.0:
        return []
    return [
        f"The wave decays at {found:.3g} 1/s, but nominal_q and nominal_f0_hz of the factory make it {decay_rate:.3g} 1/s: are the factory "
        "data this unit's?"
    ]


def _course(r: Recording) -> _Course:
    parts = np.array_split(np.arange(len(r)), min(_PARTS, len(r)))
    hertz, kelvins = r.column("ref_freq"), r.temperature_degc
    return _Course(r, np.array([np.mean(hertz[k]) for k in parts]), np.array([np.mean(kelvins[k]) for k in parts]))


def _check_thermometer(courses: Sequence[_Course]) -> None:
    """A column that never moves while a resonance does is not that of a thermometer."""
    kelvins = [c.recording.temperature_degc for c in courses]
    if len({float(k[0]) for k in kelvins}) > 1 or any(np.ptp(k) for k in kelvins):
        return
    moving = max(courses, key=lambda c: float(np.ptp(c.hertz)))
    by_hz = float(np.ptp(moving.hertz))
    if by_hz > _APART * float(moving.hertz.mean()):
        raise DataError(
            f"Column temperature must be that of the device, but it reads {kelvins[0][0]:.6g} degC in every row of every recording, while "
            f"ref_freq of {moving.recording.label!r} moves by {by_hz:.3g} Hz. Read the thermometer, or leave out what was warmed."
        )


def _coefficient(alike: Sequence[Sequence[_Course]]) -> float:
    """Change of the resonance with the temperature, relative [1/K]: the median over all pairs of parts that say it; 0 where none does."""
    slopes = []
    for courses in alike:
        for c in courses:
            if np.ptp(c.kelvins) > _TOLD_K:
                slopes.append(_steepness(c.kelvins, c.hertz))
        # between recordings, each with one that is usual
        usual = sorted(courses, key=lambda c: float(np.mean(c.kelvins)))[len(courses) // 2]
        for c in courses:
            by_k = float(np.mean(c.kelvins) - np.mean(usual.kelvins))
            if abs(by_k) > _TOLD_K:
                slopes.append((float(np.mean(c.hertz)) / float(np.mean(usual.hertz)) - 1.0) / by_k)
    return float(np.median(slopes)) if slopes else 0.0


def _steepness(kelvins: FloatArray, hertz: FloatArray) -> float:
    away = kelvins - kelvins.mean()
    return float(away @ (hertz / hertz.mean() - 1.0) / (away @ away))


def _check_alike(courses: Sequence[_Course], slope: float) -> None:
    hertz, kelvins = (np.array([np.mean(getattr(c, name)) for c in courses]) for name in ("hertz", "kelvins"))
    at_k = float(np.median(kelvins))
    usual_hz = float(np.median(hertz / (1.0 + slope * (kelvins - at_k))))
    apart = hertz / (usual_hz * (1.0 + slope * (kelvins - at_k))) - 1.0
    usual = float(np.median(np.abs(apart)))
    most = max(_TIMES_USUAL * usual, courses[0].allowed)
    moved_k = np.array([np.ptp(c.kelvins) for c in courses])
    strange = np.abs(apart) > most + abs(slope) * (_APART_K + moved_k)
    # a temperature that the resonance knows nothing of
    expected = np.abs(slope * (kelvins - at_k))
    unmoved = (np.abs(apart - slope * (at_k - kelvins)) < _EXPLAINED * expected) & (expected > courses[0].allowed)
    strange |= unmoved & (moved_k < WARMING_K) & (np.abs(kelvins - at_k) > _APART_K) & (np.abs(apart) > _TIMES_USUAL * usual)
    strange |= np.array([_begins_unmoved(c, usual_hz, at_k, usual) for c in courses])
    if not np.any(strange):
        return
    worst = int(np.argmax(np.where(strange, np.abs(apart), 0.0)))
    others = f" ({int(strange.sum()) - 1} others are apart as well)" if strange.sum() > 1 else ""
    raise DataError(
        f"Recording {courses[worst].recording.label!r} must hold the device of the others, but its ref_freq is {hertz[worst]:.7g} Hz at "
        f"{kelvins[worst]:.4g} degC, where they have {usual_hz * (1.0 + slope * (kelvins[worst] - at_k)):.7g} Hz{others}: "
        f"{_cause(courses[worst], usual_hz, at_k, slope)}"
    )


def _begins_unmoved(c: _Course, usual_hz: float, at_k: float, usual: float) -> bool:
    """Whether a recording that is warmed begins with the resonance of the others, at a temperature far from theirs: in another unit."""
    by_k = float(c.kelvins[0]) - at_k
    if abs(by_k) < _FAR_K or np.ptp(c.kelvins) < _TOLD_K:
        return False
    expected = abs(_steepness(c.kelvins, c.hertz) * by_k)
    return expected > max(c.allowed, _TIMES_USUAL * usual) and abs(float(c.hertz[0]) / usual_hz - 1.0) < _EXPLAINED * expected


def _cause(c: _Course, usual_hz: float, at_k: float, slope: float) -> str:
    """What may be wrong, and what to do."""
    hertz, kelvins = float(np.mean(c.hertz)), float(np.mean(c.kelvins))
    says_k = at_k + (hertz / usual_hz - 1.0) / slope if slope else at_k
    fahrenheit = abs((kelvins - 32.0) / 1.8 - says_k) < _EXPLAINED * abs(kelvins - says_k)
    # one that is warmed says by itself how the resonance goes, and begins where the others are
    first = float(c.kelvins[0])
    if fahrenheit or (np.ptp(c.kelvins) > WARMING_K and abs((first - 32.0) / 1.8 - at_k) < _EXPLAINED * abs(first - at_k)):
        return "its temperature looks like degF. Subtract 32 and divide by 1.8."
    if abs(hertz / usual_hz - 1.0) < _APART and abs(kelvins - at_k) > WARMING_K:
        return f"its temperature is wrong, for the resonance is that of {at_k:.4g} degC. Correct the column, or leave the recording out."
    return "it is of another device, or one of the two columns is wrong. Leave it out, or correct the column."
