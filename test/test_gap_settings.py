"""Settings of the effects' grids: levels near the top, and the times of two effects that only their times tell apart."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.optimize import minimize
from table_samples import table_model

from gyro_calib.gap import settings_together
from gyro_calib.gap.column import Column
from gyro_calib.gap.forms import FORMS
from gyro_calib.gap.levels import clipped
from gyro_calib.gap.model import CampaignModel
from gyro_calib.gap.parts import REST, SKEW
from gyro_calib.gap.physical import _ROUGH_SHARES
from gyro_calib.gap.screen import Candidate
from gyro_calib.gap.select import _refined
from gyro_calib.gap.settings_together import is_accompanied, places_of, settled_together, with_slopes
from gyro_calib.gap.system import Solution, Whitener, solve
from gyro_calib.gap.told import told_sizes
from gyro_calib.trial.injected import with_columns

ROWS, DRAWS, SIGMAS = 80, 60, 1.96
T_S = np.linspace(0.0, 90.0, ROWS)
WHITE = Whitener(((np.eye(ROWS), np.eye(ROWS)),))
DRIVE, PICKOFF = "thermal_drive_gain_lag", "thermal_pickoff_gain_lag"
TRUE_TAUS = {DRIVE: 28.0, PICKOFF: 20.0}


@pytest.mark.parametrize("beyond", np.geomspace(2.2e-4, 0.2, 40))
def test_some_level_of_the_grid_has_a_share_that_a_level_can_have(beyond: float) -> None:
    """Noise makes one recording's amplitude the largest: what lies beyond a level changes faster than its distance from that one."""
    amplitudes = np.array([*[0.7] * 40, *[1.0 - 9e-5] * 40, 1.0])
    recorded = [SimpleNamespace(pick=np.full((200, 2), a, dtype=complex)) for a in amplitudes]
    true = clipped(amplitudes.astype(complex), 1.0 - beyond)
    shares = []
    for setting in FORMS["pickoff_saturation"].settings(recorded):  # type: ignore[arg-type]
        form = clipped(amplitudes.astype(complex), setting["level"])
        if np.any(form):
            shares.append(float((form.conj() @ true).real / (form.conj() @ form).real))
    low, high = _ROUGH_SHARES
    assert any(low < share < high for share in shares), shares


class Toy:
    """One recording: what lags in the drives less nearly the same that lags in the pick-offs, each with a size of its own."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.evidence = [None]
        self.whitener = WHITE
        rows = 4000.0 * self.shape(DRIVE, TRUE_TAUS[DRIVE]) - 3000.0 * self.shape(PICKOFF, TRUE_TAUS[PICKOFF])
        self.target = [(rows + rng.standard_normal(ROWS)).astype(complex)]

    @staticmethod
    def shape(name: str, tau_s: float) -> np.ndarray:
        late = np.exp(-T_S / tau_s)
        return late * (1.0 + 0.4 * T_S / 90.0) if name == PICKOFF else late

    def candidate(self, name: str, setting: Any) -> Candidate:
        column = Column("g", (self.shape(name, setting["tau"]).astype(complex),), (np.zeros(0, dtype=complex),))
        return Candidate(name, setting, (column,), np.array([np.inf]), 5)

    def fitted(self, chosen: list[Candidate]) -> Solution:
        columns = [Column(f"{c.name}.g", c.columns[0].signal, ()) for c in chosen]
        return solve(columns, WHITE.design(columns, 1), WHITE.rows(self.target))

    def at(self, *taus: float) -> list[Candidate]:
        return [self.candidate(name, {"tau": float(tau)}) for name, tau in zip((DRIVE, PICKOFF), taus, strict=True)]


def test_two_times_are_found_together_and_their_intervals_hold_the_truth() -> None:
    rng = np.random.default_rng(8)
    hit = dict.fromkeys(TRUE_TAUS, 0)
    for _ in range(DRAWS):
        toy = Toy(rng)
        model = cast(CampaignModel, toy)
        begun = toy.at(36.0, 14.0)
        found = settled_together(model, begun)
        fit = toy.fitted(found)
        best = minimize(lambda x, toy=toy: toy.fitted(toy.at(*np.exp(x))).chi2, np.log(list(TRUE_TAUS.values())), method="Nelder-Mead")
        assert fit.chi2 < best.fun + 0.05 < toy.fitted(begun).chi2
        places = places_of(found)
        sd_log = np.sqrt(np.diag(with_slopes(model, found, places, fit).covariance)[-2:])
        for (k, key), sd in zip(places, sd_log, strict=True):
            tau, name = found[k].setting[key], found[k].name
            hit[name] += abs(tau - TRUE_TAUS[name]) < SIGMAS * sd * tau
    assert all(count / DRAWS > 0.88 for count in hit.values()), hit


def test_what_is_there_from_the_first_is_no_company() -> None:
    """It has its prior from the registry, and the effect is made again as it was."""
    none = (np.zeros(0, complex),)
    for name, accompanied in ((REST, False), (f"{REST}_damped", False), (f"{SKEW}_damped", True)):
        columns = (Column("g", none, none), Column(name, none, none))
        assert is_accompanied(Candidate(DRIVE, {}, columns, np.full(2, np.inf), 5)) is accompanied


class Accompanied(Toy):
    """One late gain and what comes with it, as late and of a size of its own."""

    linear, true_tau = None, 24.0

    def __init__(self, rng: np.random.Generator) -> None:
        super().__init__(rng)
        rows = sum(size * self.of(self.true_tau)[k] for k, size in enumerate((4000.0, -2500.0)))
        self.target = [(rows + rng.standard_normal(ROWS)).astype(complex)]

    def of(self, tau_s: float) -> list[np.ndarray]:
        late = self.shape(DRIVE, tau_s)
        return [late, late * np.cos(T_S / 30.0)]

    def at_tau(self, tau_s: float) -> Candidate:
        names = ("g", f"{SKEW}_damped")
        columns = tuple(Column(n, (x.astype(complex),), (np.zeros(0, complex),)) for n, x in zip(names, self.of(tau_s), strict=True))
        return Candidate(DRIVE, {"tau": tau_s}, columns, np.full(2, np.inf), 5)

    def fitted(self, chosen: list[Candidate]) -> Solution:
        columns = [Column(f"{c.name}.{column.name}", column.signal, ()) for c in chosen for column in c.columns]
        return solve(columns, WHITE.design(columns, 1), WHITE.rows(self.target))


def test_a_time_is_found_beside_what_comes_with_its_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    """What damps as a gradient splits was left out when the time was sought: 5.1 s of 5.9."""
    toy = Accompanied(np.random.default_rng(3))
    monkeypatch.setattr(settings_together, "candidate_at", lambda *of, **_: toy.at_tau(of[3]["tau"]))
    model, begun = cast(CampaignModel, toy), [toy.at_tau(19.0)]
    found = settled_together(model, begun)
    fit = toy.fitted(found)
    (place,) = places_of(found)
    sd_log = float(np.sqrt(with_slopes(model, found, [place], fit).covariance[-1, -1]))
    tau = found[0].setting["tau"]
    assert abs(tau - toy.true_tau) < 3.0 * sd_log * tau < 0.1
    assert toy.fitted(begun).chi2 > fit.chi2 + 100.0


def test_what_has_no_second_setting_stays_as_it_is() -> None:
    toy = Toy(np.random.default_rng(1))
    alone = toy.at(36.0, 14.0)[:1]
    assert places_of(alone) == []
    assert settled_together(cast(CampaignModel, toy), alone) == alone


@pytest.mark.slow
def test_settings_of_two_kinds_are_refined_and_told_each_by_its_own() -> None:
    """A dead zone by its level, or by the noise beside it: there was a zone of another plant that no diagnosis came out of."""
    model = table_model()
    kinds = {tuple(c.setting): c for c in model.candidates["drive_dead_zone"]}
    assert kinds.keys() == {("level",), ("noise",)}
    by_level = next(c for c in model.grid("drive_dead_zone", "level") if c.setting["level"] > 3e-3)
    with_zone = with_columns(model, [(by_level.columns[0], 1.0)])
    found = with_zone.screener.screened(with_zone.grid("drive_dead_zone", "level"))
    best = max(found, key=lambda s: s.log_evidence)
    refined = _refined(with_zone, with_zone.screener, best.candidate)
    assert refined.setting.keys() == {"level"}
    screened = with_zone.screener.screen(refined)
    assert screened is not None
    told = told_sizes(with_zone, (screened,), 0, with_zone.fitted([refined]))
    assert told["level"].value == pytest.approx(by_level.setting["level"], abs=4.0 * told["level"].sd)
