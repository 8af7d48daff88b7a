"""The gates of gap.md on finished trials, confusion, reliability, baselines."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ..effects import EFFECTS
from .baselines import BASELINES
from .intervals import Share
from .labels import LADDER
from .trial import LIKE, Outcome
from .verdicts import Found

__all__ = ["TrialGate", "baseline_rows", "by_severity", "confusion", "gates", "reliability"]

#: effective signal-to-noise ratio from which on the gates hold
STRONG = 7.999
_RMS = 1.2
_SIGMAS = 1.959964


@dataclass(frozen=True)
class TrialGate:
    """A figure with its interval and limit.

    Parameters
    ----------
    name : str
    value, low, high : float
        Figure and its 95 % interval (shares: Wilson, and Clopper-Pearson in ``exact``).
    count : int
        Trials that it rests on.
    lower, upper : float
        Limits.
    judged : float
        What is held against the limits: the figure itself, or an upper bound where gap.md says so.
    exact : tuple of float
        Clopper-Pearson interval of a share; the interval again otherwise.
    """

    name: str
    value: float
    low: float
    high: float
    count: int
    lower: float = -math.inf
    upper: float = math.inf
    judged: float = math.nan
    exact: tuple[float, float] = (math.nan, math.nan)

    @property
    def passed(self) -> bool | None:
        """Whether the limits hold; None without trials."""
        return self.lower <= self.judged <= self.upper if self.count else None

    @property
    def limit(self) -> str:
        """For a reader."""
        if math.isinf(self.lower):
            return f"≤ {self.upper:g}"
        return f"≥ {self.lower:g}" if math.isinf(self.upper) else f"{self.lower:g} … {self.upper:g}"

    def to_json(self) -> dict[str, Any]:
        """Plain types; what is not finite becomes None."""
        numbers = {"value": self.value, "low": self.low, "high": self.high, "lower": self.lower, "upper": self.upper, "judged": self.judged}
        plain: dict[str, Any] = {k: v if math.isfinite(v) else None for k, v in numbers.items()}
        return {
            "name": self.name,
            "count": self.count,
            "passed": self.passed,
            "clopper_pearson": [x if math.isfinite(x) else None for x in self.exact],
            **plain,
        }


def gates(outcomes: Sequence[Outcome]) -> list[TrialGate]:
    """Every gate of gap.md."""
    clean = [o for o in outcomes if o.label.stratum == "clean"]
    single = [o for o in outcomes if o.label.stratum in ("one", "drift") and len(o.label.snr) == 1]
    strong = [o for o in single if o.label.snr[0] >= STRONG]
    removed = [o for o in outcomes if o.label.stratum == "removed" and o.label.snr and o.label.snr[0] >= STRONG]
    pairs = [o for o in outcomes if o.label.stratum == "two" and len(o.label.snr) == 2]
    known = [*clean, *single, *pairs]
    poor = [o for o in outcomes if o.label.stratum == "poor"]
    named = [o for o in strong if o.verdict.verdict == "effects"]
    right = [o for o in named if is_top(o)]
    return [
        _share("detection", strong, lambda o: o.verdict.found_something, lower=0.95),
        _share("group, first named", strong, is_top, lower=0.95),
        _share("set covers the truth", strong, is_covered, lower=0.95),
        _mean("mean size of the set", [len(reported_set(o)) for o in named], upper=1.5),
        _alarms("false alarms on clean devices (upper bound)", clean),
        _share("unknown recognised", removed, lambda o: o.verdict.verdict == "unknown", lower=0.90),
        _share("false unknowns", known, lambda o: o.verdict.verdict == "unknown", upper=0.05),
        _share("two effects, exact", pairs, is_exact, lower=0.85),
        _coverage(right),
        _closed(right),
        _share("RMS over noise at most 1.2 on unseen experiments", right, lambda o: o.verdict.rms_after <= _RMS, lower=0.95),
        _share("added effect makes unseen data worse", named, lambda o: o.verdict.rms_after > o.verdict.rms_before, upper=0.02),
        _share("poor plans: no false name", poor, is_not_false, lower=0.95),
        _share("diagnosis failed", outcomes, lambda o: o.verdict.verdict == "failed", upper=0.0),
    ]


def asked(o: Outcome) -> list[Found]:
    """What was named besides the drifts that the unit has on top."""
    besides = set(o.label.drifts) - set(o.label.names)
    return [e for e in o.verdict.effects if not besides & {e.name, *e.group}]


def is_top(o: Outcome) -> bool:
    """Whether the first group that is named holds the truth."""
    first = max(asked(o), key=lambda e: e.gain, default=None)
    return o.verdict.verdict == "effects" and first is not None and bool(set(o.label.names) & set(first.group))


def reported_set(o: Outcome) -> set[str]:
    """Everything that the verdict names."""
    return {name for e in asked(o) for name in (e.name, *e.group)}


def is_covered(o: Outcome) -> bool:
    """Whether every true effect is among what is named."""
    return o.verdict.verdict == "effects" and set(o.label.names) <= reported_set(o)


def is_exact(o: Outcome) -> bool:
    """As many groups as effects, each with its own effect."""
    truth, found = o.label.names, asked(o)
    if o.verdict.verdict != "effects" or len(found) != len(truth):
        return False
    # of two, one order or the other
    return any(all(name in e.group for name, e in zip(order, found, strict=True)) for order in (truth, truth[::-1]))


def is_not_false(o: Outcome) -> bool:
    """Whether no wrong effect is named: none, unknown and not testable are no name."""
    return all(set(e.group) & set(o.label.names) for e in o.verdict.effects)


def _share(
    name: str, outcomes: Sequence[Outcome], hit: Callable[[Outcome], bool], *, lower: float = -math.inf, upper: float = math.inf
) -> TrialGate:
    share = Share(sum(map(hit, outcomes)), len(outcomes))
    return _gate(name, share, share.value, lower, upper)


def _alarms(name: str, clean: Sequence[Outcome]) -> TrialGate:
    share = Share(sum(o.verdict.found_something for o in clean), len(clean))
    return _gate(name, share, share.upper, -math.inf, 0.05)


def _gate(name: str, share: Share, judged: float, lower: float, upper: float) -> TrialGate:
    low, high = share.wilson
    return TrialGate(name, share.value, low, high, share.count, lower, upper, judged, share.clopper_pearson)


def _mean(name: str, values: Sequence[float], *, upper: float) -> TrialGate:
    if not values:
        return TrialGate(name, math.nan, math.nan, math.nan, 0, upper=upper)
    data = np.asarray(values, dtype=float)
    mean, half = float(data.mean()), _SIGMAS * float(data.std(ddof=1)) / math.sqrt(data.size) if data.size > 1 else math.inf
    return TrialGate(name, mean, mean - half, mean + half, data.size, upper=upper, judged=mean, exact=(mean - half, mean + half))


def _coverage(right: Sequence[Outcome]) -> TrialGate:
    """Of the effects that were named by their own name, of linear sizes: whether the truth lies in the 95 % interval."""
    inside = [abs(value - true) <= _SIGMAS * sd for o in right for value, sd, true in _sizes(o)]
    share = Share(sum(inside), len(inside))
    return _gate("95 % intervals hold the true size", share, share.value, 0.91, 0.98)


def _sizes(o: Outcome) -> Iterable[tuple[float, float, float]]:
    for name, sizes in o.label.effects.items():
        found: Found | None = next((e for e in o.verdict.effects if e.registry_name == name), None)
        if found is not None:
            for key, true in sizes.items():
                value, sd = found.parameters.get(key, (math.nan, 0.0))
                if sd > 0.0 and math.isfinite(value) and key in {p.name for p in EFFECTS[name].parameters}:
                    yield value, sd, true


def _closed(right: Sequence[Outcome]) -> TrialGate:
    """Closed fraction on unseen experiments, all trials together: each weighs with the gap that it had."""
    name = "closed fraction of the gap, unseen experiments"
    shrunk = [(o.verdict.rms_before**2 - o.verdict.rms_after**2, o.verdict.closed, o.verdict.closed_sd) for o in right]
    told = np.array([(gain / closed, gain, sd) for gain, closed, sd in shrunk if closed != 0.0])
    if not len(told):
        return TrialGate(name, math.nan, math.nan, math.nan, 0, lower=0.90)
    gaps, gains, sds = told.T
    closed = float(gains.sum() / gaps.sum())
    half = _SIGMAS * float(np.sqrt(np.sum((gaps * sds) ** 2)) / gaps.sum())
    return TrialGate(name, closed, closed - half, closed + half, len(told), lower=0.90, judged=closed, exact=(closed - half, closed + half))


def by_severity(outcomes: Sequence[Outcome], ladder: Sequence[float] = LADDER) -> list[dict[str, Any]]:
    """Detection and first name along the ladder."""
    rows = []
    for snr in ladder:
        trials = [o for o in outcomes if o.label.stratum in ("one", "drift") and o.label.snr and abs(o.label.snr[0] / snr - 1.0) < 0.02]
        rows.append(
            {
                "snr": snr,
                "count": len(trials),
                "detected": sum(o.verdict.found_something for o in trials),
                "first": sum(map(is_top, trials)),
                "unknown": sum(o.verdict.verdict == "unknown" for o in trials),
            }
        )
    return rows


def confusion(outcomes: Sequence[Outcome]) -> dict[str, dict[str, int]]:
    """Truth against what was said; a group that holds the truth counts as the truth."""
    table: dict[str, Counter[str]] = {}
    for o in outcomes:
        truth = o.label.names[0] if len(o.label.names) == 1 else "none" if not o.label.names else "two effects"
        if o.label.stratum == "removed":
            truth = "removed"
        if truth == "two effects" or o.label.stratum == "poor":
            continue
        table.setdefault(truth, Counter())[_said(o)] += 1
    return {truth: dict(row) for truth, row in sorted(table.items())}


def _said(o: Outcome) -> str:
    if o.verdict.verdict != "effects":
        return o.verdict.verdict
    return o.label.names[0] if is_top(o) and len(o.label.names) == 1 else max(o.verdict.effects, key=lambda e: e.gain).name


def reliability(outcomes: Sequence[Outcome], edges: Sequence[float] = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0)) -> list[dict[str, Any]]:
    """Probability that was stated against how often it was right: of every named group, and of every `none`."""
    pairs = []
    for o in outcomes:
        if o.label.stratum == "poor":
            continue
        # those that stand beside something unknown, too
        there = set(o.label.names) if o.label.stratum != "removed" else set()
        pairs += [(e.probability, bool(there & set(e.group))) for e in o.verdict.effects]
        if o.verdict.verdict == "none":
            pairs.append((o.verdict.probability_none, not o.label.names))
        elif o.verdict.verdict == "unknown":
            pairs.append((o.verdict.probability_unknown, o.label.stratum == "removed"))
    rows = []
    for low, high in pairwise(edges):
        inside = [(p, hit) for p, hit in pairs if low <= p < high or (high == edges[-1] and p >= high)]
        share = Share(sum(hit for _, hit in inside), len(inside))
        stated = float(np.mean([p for p, _ in inside])) if inside else None
        rows.append({"from": low, "to": high, "count": len(inside), "stated": stated, "right": share.hits, "interval": list(share.wilson)})
    return rows


def baseline_rows(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Diagnosis and baselines on the same trials: alarms on clean units, detection and first name at a ratio of 8 and more.

    A baseline says one name: it counts as right when that is the truth or what no campaign of this unit tells from it.
    """
    asked = [o for o in outcomes if o.baselines]
    clean = [o for o in asked if o.label.stratum == "clean"]
    strong = [o for o in asked if o.label.snr and o.label.snr[0] >= STRONG]
    rows = [
        {
            "name": "diagnosis",
            "clean": len(clean),
            "false_alarms": sum(o.verdict.found_something for o in clean),
            "strong": len(strong),
            "detected": sum(o.verdict.found_something for o in strong),
            "first": sum(map(is_top, strong)),
        }
    ]
    for name in BASELINES:
        rows.append(
            {
                "name": name,
                "clean": len(clean),
                "false_alarms": sum(o.baselines[name] is not None for o in clean),
                "strong": len(strong),
                "detected": sum(o.baselines[name] is not None for o in strong),
                "first": sum(o.baselines[name] in _fair(o) for o in strong),
            }
        )
    return rows


def _fair(o: Outcome) -> set[str | None]:
    """The truth with what imitates it."""
    return {n for name in o.label.names for n in (name, *(k for k, left in o.label.like.get(name, {}).items() if left < LIKE))}
