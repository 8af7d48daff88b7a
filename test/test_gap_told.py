"""Sizes as they are told, against the truth over many draws: a share hangs on the time it is found at; a healthy part is not told."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from gyro_calib.gap.column import Column
from gyro_calib.gap.diagnosis import FoundEffect
from gyro_calib.gap.model import CampaignModel
from gyro_calib.gap.screen import Candidate, Screener
from gyro_calib.gap.summary import said, summary_of
from gyro_calib.gap.system import Whitener, solve
from gyro_calib.gap.told import _of_its_tangent, told_sizes
from gyro_calib.quantity import Quantity

ROWS, DRAWS, SIGMAS = 60, 200, 1.96
T_S = np.linspace(0.0, 2.0, ROWS)
WHITE = Whitener(((np.eye(ROWS), np.eye(ROWS)),))
TIMES_S = (0.2, 0.5, 1.0, 2.0, 4.0)


def column(name: str, values: np.ndarray, prior_sd: float = math.inf) -> Column:
    return Column(name, (values.astype(complex),), (), prior_sd)


class Toy:
    """One recording whose rows are a constant and a memory ``share (1 - exp(-t/tau))``."""

    def __init__(self, target: np.ndarray, healthy_sd: float = 0.0) -> None:
        self.target = [target.astype(complex)]
        healthy = [column("pickoff_memory.share", self.shape(1.0), healthy_sd)] if healthy_sd else []
        self.nuisances = (column("one", np.ones(ROWS)), *healthy)
        self.candidates = {"pickoff_memory": [self.candidate("pickoff_memory", {"tau": tau}) for tau in TIMES_S]}
        self.screener = self.screener_with([])

    @staticmethod
    def shape(tau_s: float) -> np.ndarray:
        return np.asarray(1.0 - np.exp(-T_S / tau_s))

    def candidate(self, name: str, setting: Any) -> Candidate:
        return Candidate(name, setting, (column("share", self.shape(setting["tau"])),), np.array([100.0]), len(TIMES_S))

    def grid(self, name: str, key: str) -> list[Candidate]:
        return [c for c in self.candidates[name] if key in c.setting]

    def screener_with(self, candidates: list[Candidate]) -> Screener:
        return Screener(WHITE, [*self.nuisances[:1], *(c for e in candidates for c in e.columns)], self.target)

    def best(self) -> Candidate:
        def left(tau_s: float) -> float:
            found = self.screener.screen(self.candidate("pickoff_memory", {"tau": tau_s}))
            return -found.gain if found is not None else 0.0

        return self.candidate("pickoff_memory", {"tau": float(minimize_scalar(left, bounds=(0.2, 4.0), method="bounded").x)})


def told(toy: Toy) -> dict[str, tuple[float, float]]:
    best = toy.best()
    effect = toy.screener.screen(best)
    assert effect is not None
    columns = [toy.nuisances[0], column("pickoff_memory.share", best.columns[0].signal[0].real)]
    rich = solve(columns, WHITE.design(columns, 1), WHITE.rows(toy.target))
    return {name: (q.value, q.sd) for name, q in told_sizes(cast(CampaignModel, toy), (effect,), 0, rich).items()}


def test_intervals_of_a_share_and_its_time_hold_the_truth() -> None:
    rng = np.random.default_rng(5)
    truth = {"share": 80.0, "tau": 1.6}
    hit, alone = dict.fromkeys(truth, 0), 0
    for _ in range(DRAWS):
        toy = Toy(truth["share"] * Toy.shape(truth["tau"]) + rng.standard_normal(ROWS))
        found = told(toy)
        for name, true in truth.items():
            hit[name] += abs(found[name][0] - true) < SIGMAS * found[name][1]
        at_one_time = toy.screener.screen(toy.best())
        assert at_one_time is not None
        alone += abs(found["share"][0] - truth["share"]) < SIGMAS * float(at_one_time.sd[0])
    assert all(0.90 < count / DRAWS < 0.99 for count in hit.values()), hit
    assert alone / DRAWS < 0.70  # at the time that was found, as if it were known


class Dead(Toy):
    """A dead zone far below its drive: of it and of its share, which is one, a recording tells the product."""

    def candidate(self, name: str, setting: Any) -> Candidate:
        of_level = 2e4 * setting.get("level", 0.0) * self.shape(1.0)
        return Candidate(name, setting, (column("share", of_level),), np.array([10.0]), 2)

    def grid(self, name: str, key: str) -> list[Candidate]:
        return [self.candidate(name, {key: level}) for level in (0.02, 0.05)]

    def told(self, level: float) -> dict[str, Quantity]:
        effect = self.screener.screen(self.candidate("drive_dead_zone", {"level": level}))
        assert effect is not None
        columns = [self.nuisances[0], column("drive_dead_zone.share", effect.candidate.columns[0].signal[0].real)]
        rich = solve(columns, WHITE.design(columns, 1), WHITE.rows(self.target))
        return told_sizes(cast(CampaignModel, self), (effect,), 0, rich)


def test_a_level_that_shows_by_its_size_alone_is_known_as_well_as_that() -> None:
    """One of 2.85e-5 V in a chi-square of 1192 was 0 +- 0.0087 V: half of a step of the grid, for no bend told its shape."""
    rng, level, errors = np.random.default_rng(8), 1e-3, []
    for _ in range(DRAWS):
        toy = Dead(2e4 * level * Toy.shape(1.0) + rng.standard_normal(ROWS))
        there = toy.screener.screen(toy.candidate("drive_dead_zone", {"level": level}))
        assert there is not None
        # where the search ends: at the level of which all is taken
        told = toy.told(level * float(there.sizes()["share"][0]))
        assert set(told) == {"level"}
        errors.append((told["level"].value - level) / told["level"].sd)
    assert abs(float(np.mean(errors))) < 0.3
    assert float(np.std(errors)) == pytest.approx(1.0, abs=0.15)


def test_what_a_healthy_device_has_as_well_is_part_of_the_size() -> None:
    rng = np.random.default_rng(6)
    rows = 20.0 * Toy.shape(1.3) + rng.standard_normal(ROWS)
    sd, with_healthy = told(Toy(rows))["share"][1], told(Toy(rows, healthy_sd=0.7))["share"][1]
    assert with_healthy == pytest.approx(math.hypot(sd, 0.7), rel=1e-6)


@pytest.mark.parametrize(("y", "named"), [(-11.2e-6, True), (0.42e-6, False), (0.95e-6, False)])
def test_a_variant_by_axis_is_named_where_the_axes_are_unlike(y: float, named: bool) -> None:
    """A stiffness that softens on one electrode axis: the group holds the name that says so."""
    sizes = {"k_x": Quantity(0.4e-6, 3e-7, "1/s/V^2"), "k_y": Quantity(y, 3e-7, "1/s/V^2")}
    found = FoundEffect("duffing", "Stiffness", ("duffing",), 0.9, sizes, "dynamics", "duffing_axes", 80.0)
    assert found.to_json()["group"] == (["duffing", "duffing_axes"] if named else ["duffing"])


@pytest.mark.parametrize(("sd", "words"), [(0.1, "closes 46.7 %"), (28.5, "too few to tell")])
def test_a_share_that_nobody_knows_is_not_told(sd: float, words: str) -> None:
    """A healthy hemisphere's delay "closed 46.7 %" of the gap, give or take 2854 %."""
    effect = SimpleNamespace(name="drive_delay", group=("drive_delay",), parameters={"tau_x": Quantity(4e-5, 5e-6, "s")})
    said = summary_of("effects", (effect,), None, SimpleNamespace(told=0.467, told_sd=sd))  # type: ignore[arg-type]
    assert words in said
    assert said.startswith("Present: drive_delay (tau_x = 4e-05")


def test_what_no_residual_shows_is_said_to_stand_where_it_does() -> None:
    def effect(name: str) -> SimpleNamespace:
        return SimpleNamespace(name=name, group=(name,), parameters={"k": Quantity(0.1, 0.01, "rad/s")})

    def said(*names: str) -> str:
        return summary_of("effects", tuple(map(effect, names)), None, SimpleNamespace(told=0.5, told_sd=0.1))  # type: ignore[arg-type]

    assert "It stands in the spectra, and leaves the means" in said("base_sway")
    assert "It stands in what the loops ask for and in the constants of the linear device, and" in said(
        "loop_error", "circulatory_stiffness"
    )
    assert "It stands in the floors of the noise, and leaves the means" in said("pickoff_phase_flicker")
    assert "closes 50.0 %" in said("duffing", "base_sway")


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [(7.11e-6, 0.031, "0 ± 0.031 V"), (-7.11e-6, 0.031, "0 ± 0.031 V"), (3.6512e-5, 4e-7, "3.651e-05 ± 4e-07 V"), (1.5, 0.0, "1.5 ± 0 V")],
)
def test_a_size_is_said_to_the_second_digit_of_its_sd(value: float, sd: float, text: str) -> None:
    assert said(Quantity(value, sd, "V")) == text


def test_a_skew_is_told_by_the_angle_of_what_it_crosses() -> None:
    """Rate crosses the flow by kappa e^{i w tau}; the angular gain is read off its real part."""
    omega, tau, kappa = 2.0 * np.pi * 15000.0, -4.25e-6, 0.8
    crossed = kappa * np.exp(1j * omega * tau)
    as_fitted = Quantity(float(crossed.imag / crossed.real) / omega, 1.0e-7, "s")
    assert as_fitted.value == pytest.approx(1.06 * tau, rel=0.01)
    found = _of_its_tangent(as_fitted, omega)
    assert found.value == pytest.approx(tau, rel=1e-9)
    step = 1e-12
    moved = _of_its_tangent(Quantity(as_fitted.value + step, 0.0, "s"), omega).value - found.value
    assert found.sd == pytest.approx(as_fitted.sd * moved / step, rel=1e-4)
