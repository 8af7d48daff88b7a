"""Courses of what drifts with time: straight, or bent as a leak that fills its volume and as ageing that goes with the log of time are.

Each is the time of the campaign at its end, so that a drift's size is its mean per second whatever the course. Stiffness has its own bent
course, that of charge.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .parts import Part, Setting
from .signals import Signals

if TYPE_CHECKING:
    from .screen import Candidate, Screener

__all__ = ["BENT", "COURSES", "best_course", "drift_settings", "drifted", "drifting_feedthrough", "said_course", "without_bent"]

FloatArray = NDArray[np.float64]
#: settings: time constant of one that saturates, time from which on one that slows goes with the log; each with the end of the campaign
COURSES = ("saturates_s", "slows_s")
_END = "end_s"
#: what stands between an effect's title and its course, where that is bent
BENT = "; along a course that "
#: times to try, over that of the campaign: shorter ones are steps
_SATURATES, _SLOWS = (0.12, 0.25, 0.6), (0.01, 0.05, 0.25)


def drift_settings(signals: list[Signals]) -> list[Setting]:
    """A straight course, ones that saturate, ones that slow."""
    end = max(float(s.time_s[-1]) for s in signals)
    bent = [{key: share * end, _END: end} for key, shares in zip(COURSES, (_SATURATES, _SLOWS), strict=True) for share in shares]
    return [{}, *bent]


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
    best = [max(beside.screened(of_kind), key=lambda s: s.log_evidence).candidate for of_kind in bent]
    straight = [c for c in tried if not c.setting]
    ahead = math.log(sum(len(of_kind) for of_kind in bent))
    found = beside.screened(map(refined, (here, *straight, *best)))
    return max(found, key=lambda s: s.log_evidence + (0.0 if s.candidate.setting else ahead)).candidate


def said_course(setting: Setting) -> str:
    """Words on a course that is bent, after the title of an effect."""
    if "saturates_s" in setting:
        return f"{BENT}saturates, with a time constant of about {setting['saturates_s']:.2g} s"
    return f"{BENT}slows, as the log of time from about {setting['slows_s']:.2g} s on" if "slows_s" in setting else ""
