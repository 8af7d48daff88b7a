"""What goes with the azimuth of a turning wave by more lobes than a linear device has: a form of its own, on lines of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray
from table_samples import table_model

from gyro_calib.gap.diagnose import diagnose
from gyro_calib.gap.evidence import CampaignEvidence
from gyro_calib.gap.lines import lines_of
from gyro_calib.gap.monomials import DIRECTED, MONOMIALS
from gyro_calib.gap.signals import Signals
from gyro_calib.recording.recording import Campaign, Recording
from gyro_calib.trial.plans import campaign_plan
from gyro_calib.trial.plant import record_unit
from gyro_calib.trial.units import draw_trial_unit

#: share of a pick-off's gain that goes with the azimuth
SHARE = 3e-5


def hemisphere() -> Campaign:
    """A whole-angle campaign of a healthy unit."""
    unit, rng = draw_trial_unit("hemisphere", 79, 1), np.random.default_rng(1)
    return record_unit(unit, campaign_plan("hemisphere", unit.device.factory(), rng, "quick"), {}, rng)


def read_by_lobes(r: Recording, lobes: int) -> Recording:
    """The same wave, read by a gain that goes with the electrodes under its antinode."""
    v = r.pick
    stokes = np.abs(v[:, 0]) ** 2 - np.abs(v[:, 1]) ** 2 + 2j * (v[:, 0] * v[:, 1].conj()).real
    more = SHARE * np.cos(0.25 * lobes * np.angle(stokes) + 0.7)[:, None] * v
    data = r.data.copy()
    data[:, 2:6:2] += more.real
    data[:, 3:7:2] += more.imag
    return replace(r, data=data)


@dataclass
class Rows:
    """Signals as far as a monomial of the azimuth asks for them."""

    pick: NDArray[np.complex128]
    drive: NDArray[np.complex128]


def wave(psi: NDArray[np.float64], size: float = 0.7) -> NDArray[np.complex128]:
    return size * np.exp(0.4j) * np.stack([np.cos(psi), np.sin(psi)], axis=1).astype(complex)


@pytest.mark.parametrize("lobes", [4, 8, 12, 16])
def test_lobes_are_those_of_the_motion_whatever_is_driven(lobes: int) -> None:
    psi = np.linspace(0.0, 6.0, 50)
    rows = Rows(wave(psi), wave(psi + 1.1, 0.01))
    of_cos, of_sin = MONOMIALS[f"x cos {lobes}theta, x sin {lobes}theta", "azimuth"]
    for x in (rows.pick, rows.drive, 2.0 * rows.pick):
        # two lobes of theta are one of psi: the wave of n = 2 comes back after a quarter turn of the case
        assert of_cos(cast(Signals, rows), x) == pytest.approx(np.cos(0.5 * lobes * psi)[:, None] * x)
        assert of_sin(cast(Signals, rows), x) == pytest.approx(np.sin(0.5 * lobes * psi)[:, None] * x)
    crossed = MONOMIALS[f"x cos {lobes}theta, x sin {lobes}theta, crossed", "azimuth"][0](cast(Signals, rows), rows.pick)
    assert np.abs(np.sum(crossed * rows.pick.conj(), axis=1)) == pytest.approx(np.zeros(50), abs=1e-12)


@dataclass
class TimedRows(Rows):
    """And as one of the sense in which the wave turns does."""

    row_s: float

    def once(self, key: object, linear: object, made: Callable[[], NDArray[np.float64]]) -> NDArray[np.float64]:
        return made()


def test_the_sense_in_which_a_wave_turns_is_one_or_the_other_and_none_where_it_stands() -> None:
    """One way, standing but for its noise, and back; through every azimuth, and whatever is driven."""
    rate_rad_s = np.repeat([0.2, 0.0, -0.2], 500)
    psi = 0.01 * np.cumsum(rate_rad_s) + 1e-6 * np.random.default_rng(0).standard_normal(1500)
    rows = cast(Signals, TimedRows(wave(7.0 * psi), wave(psi + 1.1, 0.01), 0.01))
    of_x, of_y = MONOMIALS["x by the sense in which the wave turns", "azimuth"]
    sense = of_x(rows, rows.drive)[:, 0] / rows.drive[:, 0]
    np.testing.assert_array_equal(of_x(rows, rows.drive)[:, 1], 0.0)
    np.testing.assert_allclose(of_y(rows, rows.drive)[:, 1], sense * rows.drive[:, 1])
    for part, expected in zip(np.split(sense, 3), (1.0, 0.0, -1.0), strict=True):
        np.testing.assert_allclose(part[20:-20], expected, atol=0.03)


@pytest.mark.parametrize("direction_rad", [0.0, 0.3, 1.1, 2.5])
def test_a_dry_friction_along_any_direction_is_a_sum_of_its_terms(direction_rad: float) -> None:
    """Opposed to what of the motion lies along it, of one size: nothing along the axes says it unless it lies along one of them."""
    psi = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    p, n = wave(psi), np.array([np.cos(direction_rad), np.sin(direction_rad)])
    along = p @ n
    friction = (-along / np.abs(along))[:, None] * n
    rows = cast(Signals, Rows(p, p))

    def left(*forms: str) -> float:
        made = np.stack([f(rows, p).ravel() for form in forms for f in MONOMIALS[form, "amplitude"]], axis=1)
        parts = [np.concatenate([x.real, x.imag]) for x in (*made.T, friction.ravel())]
        design, target = np.stack(parts[:-1], axis=1), parts[-1]
        return float(np.sum((target - design @ np.linalg.lstsq(design, target, rcond=None)[0]) ** 2) / np.sum(target**2))

    # 12 lobes and more are left, of what jumps where the motion is square to it
    assert left(DIRECTED) < 0.09
    assert left("x/|x|", "x/|x|, as a split") > 0.18


def test_a_wave_that_turned_by_a_period_of_its_lobes_but_for_a_little_is_one_that_turns() -> None:
    """Of an eleventh plant every record held 0.98 of it, and nothing that goes with the azimuth was looked for."""
    campaign = hemisphere()
    turning = next(r for r in campaign if r.command.setpoints.virtual_precession_v > 0.0)
    still = [r for r in campaign if r.command.setpoints.virtual_precession_v == 0.0]

    def turns(share: float) -> bool:
        whole = CampaignEvidence.of([*still, turning], 0.01).recordings[-1].signal.turn_rad
        rows = int(share * np.pi / whole * len(turning))
        return CampaignEvidence.of([*still, replace(turning, data=turning.data[:rows])], 0.01).turns

    assert turns(0.98)
    assert not turns(0.5)


def test_a_turning_wave_has_lines_of_six_and_eight_turns_and_they_are_not_quiet() -> None:
    turning = next(r for r in hemisphere() if r.command.setpoints.virtual_precession_v > 0.0)
    turn_hz = 3.0 / turning.duration_s
    lines, step = lines_of(turning, 2.0 * np.pi * turn_hz), 1.0 / turning.duration_s
    for k in (6, 8):
        assert min(abs(f - k * turn_hz) for f in lines.signal) < 1e-6
        assert min(abs(f - k * turn_hz) for f in lines.quiet) > step


@pytest.mark.slow
@pytest.mark.parametrize("lobes", [8, 16])
def test_a_gain_of_many_lobes_is_found_by_its_form(lobes: int) -> None:
    """It was believed to be noise: as loud in its lines as everything else that the saturated model lacks."""
    campaign = hemisphere()
    found = diagnose(replace(campaign, recordings=tuple(read_by_lobes(r, lobes) for r in campaign)))
    assert found.verdict == "unknown"
    assert found.unknown is not None
    assert (found.unknown.location, found.unknown.depends_on) == ("pick-off", "azimuth")
    assert found.unknown.form == f"x cos {lobes}theta, x sin {lobes}theta"


@pytest.mark.slow
def test_of_a_wave_that_never_turns_nothing_goes_with_the_azimuth() -> None:
    model = table_model()
    assert model.bank
    assert not any(term.depends_on == "azimuth" for term, _ in model.bank)
