"""Drifts whose course is bent keep their name: a leak that fills its volume, ageing that goes with the log of time."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from test_gap_courses import clean, with_reading_gain

from gyro_calib.gap import diagnose
from gyro_calib.gap.drifts import (
    best_course,
    drift_settings,
    drifted,
    drifting_damping,
    drifting_gains,
    parameter_of,
    said_course,
    walk_sizes,
    without_bent,
)
from gyro_calib.gap.parts import SKEW, UNEQUAL

SIGNALS: Any = SimpleNamespace(time_s=np.linspace(0.0, 400.0, 401), drive=np.ones((401, 2), dtype=complex))
#: what may walk as well
WALKING = drifting_gains(1.0, of_drive=True)


def test_a_course_is_the_time_of_the_campaign_at_its_end() -> None:
    straight, *bent = drift_settings([SIGNALS])
    np.testing.assert_array_equal(drifted(SIGNALS, straight), SIGNALS.time_s)
    assert said_course(straight) == ""
    for setting in bent:
        course = drifted(SIGNALS, setting)
        assert course[0] == 0.0
        assert course[-1] == pytest.approx(400.0)
        # it grows all the while, ever more slowly
        assert np.all(np.diff(course) > 0.0)
        assert np.all(np.diff(course, 2) < 0.0)
        assert said_course(setting)


def test_courses_are_those_of_a_leak_and_of_ageing() -> None:
    t = SIGNALS.time_s
    leak = drifted(SIGNALS, {"saturates_s": 80.0, "end_s": 400.0})
    np.testing.assert_allclose(leak / leak[-1], (1.0 - np.exp(-t / 80.0)) / (1.0 - math.exp(-5.0)))
    ageing = drifted(SIGNALS, {"slows_s": 8.0, "end_s": 400.0})
    np.testing.assert_allclose(ageing / ageing[-1], np.log(1.0 + t / 8.0) / math.log(51.0), atol=1e-14)


def test_the_noise_is_measured_beside_straight_drifts_alone() -> None:
    """With all courses of all drifts in its design what several recordings remember had no name of its own (`test_gap_strangers.py`)."""
    settings = [*drift_settings([SIGNALS]), {"tau": 30.0}]
    of_all = {"bias_drift": [SimpleNamespace(setting=s) for s in settings], "charge_accumulation": [SimpleNamespace(setting={"tau": 30.0})]}
    kept = without_bent(cast(Any, of_all))
    assert [c.setting for c in kept["bias_drift"]] == [{}, {"tau": 30.0}]
    assert len(kept["charge_accumulation"]) == 1


@pytest.mark.parametrize(("better", "bends"), [(0.4, False), (-3.0, False), (3.0, True)])
def test_a_course_bends_where_that_is_more_than_the_chance_of_many(better: float, bends: bool) -> None:
    """A straight drift of a feedthrough (8) had 20.6 in log evidence, and along one of six courses that bend 21.0 and twice its size."""
    tried = [SimpleNamespace(setting=s) for s in drift_settings([SIGNALS])]
    best = next(c for c in tried if "slows_s" in c.setting)

    def screened(candidates: Any) -> list[Any]:
        return [SimpleNamespace(candidate=c, log_evidence=20.0 + (better if c is best else -9.0 if c.setting else 0.0)) for c in candidates]

    beside: Any = SimpleNamespace(screened=screened)
    for here in (tried[0], best):
        assert (best_course(beside, cast(Any, tried), cast(Any, here), lambda c: c) is best) is bends


def test_a_walk_is_a_wiener_process() -> None:
    """Its mean per second and its sines, equally uncertain, have the covariance min(s, t) but for what is faster than the last sine."""
    *_, walks = WALKING.settings([SIGNALS])
    parts = WALKING.parts(SIGNALS, cast(Any, None), walks)
    assert {parameter_of(p.parameter) for p in parts} == {"g_x", "g_y"}
    assert "walks" in said_course(walks)
    of_x = np.array([p.signal[:, 0].real / SIGNALS.drive[:, 0].real for p in parts if parameter_of(p.parameter) == "g_x"])
    t, end = SIGNALS.time_s, SIGNALS.time_s[-1]
    covariance = of_x.T @ of_x / end
    assert np.max(np.abs(covariance - np.minimum.outer(t, t))) < 0.03 * end


def test_a_damping_that_drifts_may_take_its_anisotropy_along(monkeypatch: pytest.MonkeyPatch) -> None:
    """A leak that scales all of a damping is its drift and, as large as it, what comes with that."""
    moved = np.array([[1.0, 0.0], [0.0, 1.0], [0.6, 0.8]]) + 0j
    monkeypatch.setattr("gyro_calib.gap.drifts.velocity", lambda s, d: moved)
    damping = 0.08 * np.array([[1.02, 0.01], [0.01, 0.98]])
    s: Any = SimpleNamespace(time_s=np.array([1.0, 2.0, 3.0]))
    alike, anisotropy = drifting_damping(s, cast(Any, SimpleNamespace(A=-damping + 0.3j * np.eye(2))), {})
    assert (alike.parameter, anisotropy.parameter) == ("c", f"{SKEW}_anisotropy")
    np.testing.assert_allclose(alike.signal + UNEQUAL * anisotropy.signal, -s.time_s[:, None] * (moved @ damping.T) / 0.08)


def test_the_size_of_a_walk_is_that_of_its_steps() -> None:
    """Over many walks: its mean, and its scatter as it claims; an axis that stands has none beyond the noise."""
    *_, walks = WALKING.settings([SIGNALS])
    columns = [p.parameter for p in WALKING.parts(SIGNALS, cast(Any, None), walks)]
    rng = np.random.default_rng(3)
    size, sd = 2e-4, 1e-6
    told = []
    for _ in range(400):
        own = {c: size / math.sqrt(walks["end_s"]) if "x" in c else 0.0 for c in columns}
        drawn = {c: (float(rng.normal(0.0, math.hypot(s, sd))), sd) for c, s in own.items()}
        told.append(walk_sizes(walks, drawn, "rad/s"))
    of_x = np.array([t["walk_x"].value for t in told])
    assert told[0]["walk_x"].unit == "rad/sqrt(s)"
    assert np.sqrt(np.mean(of_x**2)) == pytest.approx(size, rel=0.05)
    assert np.std(of_x) == pytest.approx(np.mean([t["walk_x"].sd for t in told]), rel=0.15)
    assert np.median([t["walk_y"].value / t["walk_y"].sd for t in told]) < 2.0
    assert walk_sizes({}, {}, "1/s") == {}


@pytest.mark.slow
def test_a_gain_that_walks_has_its_name() -> None:
    """Its floor within the records is no second effect, nor is what it does faster than its sines something without a name."""
    start = min(float(r.t[0]) for r in clean())
    time_s = np.arange(0.0, max(float(r.t[-1]) for r in clean()) - start, 0.05)
    steps = np.random.default_rng(6).standard_normal(time_s.size)
    walk = 3e-5 * np.cumsum(steps) * math.sqrt(0.05)
    found = diagnose(with_reading_gain(lambda r, begun: np.interp(r.t - begun, time_s, walk)))
    assert [e.name for e in found.effects] == ["pickoff_gain_drift"]
    assert found.verdict == "effects"
    assert "walks" in found.effects[0].title
    size = found.effects[0].parameters["walk_y"]
    assert abs(size.value - 3e-5) < 3.0 * size.sd < 6e-5


@pytest.mark.slow
@pytest.mark.parametrize(("words", "time_s"), [("saturates", 70.0), ("slows", 8.0)])
def test_a_gain_that_drifts_along_a_bent_course_has_its_name(words: str, time_s: float) -> None:
    """Without the courses a fourteenth plant's ageing by the log of time was another drive from 106 s on, without a name."""
    start = min(float(r.t[0]) for r in clean())
    end = max(float(r.t[-1]) for r in clean()) - start

    def gain(t: np.ndarray) -> np.ndarray:
        return np.asarray(-np.expm1(-t / time_s) if words == "saturates" else np.log1p(t / time_s))

    found = diagnose(with_reading_gain(lambda r, begun: 3e-3 * gain(r.t - begun)))
    assert [e.name for e in found.effects] == ["pickoff_gain_drift"]
    assert words in found.effects[0].title
    size = found.effects[0].parameters["g_y"]
    assert abs(size.value - 3e-3 * float(gain(np.array([end]))[0]) / end) < 0.02 * abs(size.value)
