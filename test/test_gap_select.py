"""What counts beside a loud effect, whose first order leaves something, but little that goes with time; by which term it is told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from gyro_calib.gap import counting, strangers
from gyro_calib.gap.anonymous import Anonymous
from gyro_calib.gap.column import Column
from gyro_calib.gap.counting import beyond_complete, completes, enough
from gyro_calib.gap.model import CampaignModel
from gyro_calib.gap.physical import physical
from gyro_calib.gap.saturated import _with_room, with_twins
from gyro_calib.gap.screen import Candidate, Screened

LOUD = 2.5e7


def screened(name: str, gain: float) -> Screened:
    candidate = Candidate(name, {}, (), np.zeros(0))
    return Screened(candidate, gain, 1, 0.5 * gain, np.zeros(1), np.ones(1), 0.0, cast(np.ndarray, np.zeros((1, 1))))


@pytest.mark.parametrize(
    ("name", "share", "beside", "counts"),
    [
        ("pickoff_nonlinearity", 0.0045, "nonlinear_damping", False),
        ("pickoff_nonlinearity", 0.006, "nonlinear_damping", True),
        # a charge of 113 000 beside a damping of 25 million was none
        ("charge_accumulation", 0.0045, "nonlinear_damping", True),
        ("charge_accumulation", 0.0003, "nonlinear_damping", False),
        ("charge_accumulation", 0.0045, "drive_gain_drift", False),
        ("nonlinear_damping", 0.0045, "charge_accumulation", True),
        ("nonlinear_damping", 0.0003, "charge_accumulation", False),
        # what is left of an effect of temperature may lag behind it
        ("thermal_damping_lag", 0.0045, "thermal_damping", False),
        # and is still while the temperature is: of a late damping 23 000 beside a charge of 16 million
        ("thermal_damping_lag", 0.0015, "charge_accumulation", True),
        ("charge_accumulation", 0.0015, "thermal_damping_lag", True),
    ],
)
def test_what_first_order_leaves_keeps_to_no_time(name: str, share: float, beside: str, counts: bool) -> None:
    assert enough(screened(name, share * LOUD), screened(beside, LOUD)) is counts


@pytest.mark.parametrize(
    ("name", "gain", "chi2", "counts"),
    [
        # a scale factor of one sense of rotation beside a damping of thousands of standard deviations
        ("rate_asymmetry", 158.0, 1600.0, True),
        ("thermal_bias", 158.0, 1600.0, True),
        ("pickoff_nonlinearity", 158.0, 1600.0, False),
        # a cubic damping beside a Duffing of ten thousand standard deviations: all that was left
        ("pickoff_nonlinearity", 1396.0, 2647.0, True),
        ("pickoff_nonlinearity", 900.0, 2647.0, False),
        # a centrifugal stiffness of 960 where a charge of 7487 was missing
        ("centrifugal_stiffness", 960.0, 8348.0, False),
    ],
)
def test_what_moves_with_something_else_counts_by_all_that_is_left(name: str, gain: float, chi2: float, counts: bool) -> None:
    assert enough(screened(name, gain), screened("nonlinear_damping", LOUD), beyond_complete(chi2, 1395)) is counts


@pytest.mark.parametrize(
    ("gain", "others", "unnamed", "counts"),
    [
        (632.0, 3.0, 5.0, True),
        # as much is left of others as well
        (632.0, 40.0, 5.0, False),
        (632.0, 3.0, 90.0, False),
        # or in no form at all
        (400.0, 3.0, 5.0, False),
    ],
)
def test_what_leaves_nothing_beside_a_loud_one_counts(
    monkeypatch: pytest.MonkeyPatch, gain: float, others: float, unnamed: float, counts: bool
) -> None:
    """A soft limit of the drives beside an unequal Duffing of 8e5 in chi-square, on a hemisphere of a twenty-ninth plant."""
    left = SimpleNamespace(screened=lambda _: [screened("pickoff_nonlinearity", 2.0 * others)])
    model = SimpleNamespace(candidates={"pickoff_nonlinearity": []}, screener_with=lambda _: left)
    monkeypatch.setattr(counting, "bank_terms", lambda *_: [(screened("x", unnamed), None)])
    found, rest = screened("drive_nonlinearity", gain), beyond_complete(2988.0, 2679)
    assert not enough(found, screened("duffing", 8e5), rest)
    assert completes(model, (), found, rest) is counts  # type: ignore[arg-type]


def test_alone_an_effect_counts_by_its_evidence() -> None:
    assert enough(screened("duffing", 40.0))
    assert not enough(screened("duffing", 20.0))


def columns(name: str, count: int) -> Candidate:
    made = tuple(Column(f"{k}", (np.ones(3),), (np.ones(3),)) for k in range(count))
    return Candidate(name, {}, made, np.ones(count))


def test_what_may_be_there_is_held_before_what_hardly_is() -> None:
    """Where there are no equations for all; one effect more in the registry left no room for a hot feedthrough, which then was noise."""
    named = [columns("duffing", 2), columns("thermal_bias", 1), columns("rate_asymmetry", 1)]
    assert [c.name for c in _with_room(named, {"rate_asymmetry"}, 4)] == ["duffing", "thermal_bias", "rate_asymmetry"]
    assert [c.name for c in _with_room(named, {"rate_asymmetry"}, 3)] == ["duffing", "rate_asymmetry"]
    assert [c.name for c in _with_room(named, {"rate_asymmetry"}, 0)] == ["rate_asymmetry"]


SAID = {
    # location, phase, form: chi-square
    Anonymous("pick-off", "in phase", "|x|^2 x", "amplitude"): 7250.0,
    Anonymous("dynamics", "in quadrature", "T x, other on each axis", "temperature"): 5990.0,
    Anonymous("dynamics", "in phase", "T x", "temperature"): 6500.0,
}
SPLIT = ("thermal_split_lag", "split_drift", "charge_accumulation")


def heard(monkeypatch: pytest.MonkeyPatch, said: Mapping[Anonymous, float]) -> CampaignModel:
    """A model, of which only what its unnamed terms take is asked."""
    monkeypatch.setattr(strangers, "_unnamed", lambda *_: [(screened(a.name, gain), a) for a, gain in said.items()])
    monkeypatch.setattr(strangers, "nearest_known", lambda *_: "")
    before, after = SimpleNamespace(chi2=10_000.0), SimpleNamespace(chi2=2_000.0)
    return cast(CampaignModel, SimpleNamespace(screener=before, screener_with=lambda chosen: after))


def test_three_changes_of_one_property_are_told_by_a_term_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """A split that a gradient moved was a cube of the pick-offs, which says a little more."""

    def told(names: Sequence[str], said: Mapping[Anonymous, float]) -> str:
        found = strangers._said_of_their_kind(heard(monkeypatch, said), [screened(name, 1000.0) for name in names])
        assert found is not None
        return found[1].form

    assert told(SPLIT, SAID) == "T x, other on each axis"
    assert told(SPLIT[:2], SAID) == "|x|^2 x"
    faint = {a: gain * (0.3 if a.phase == "in quadrature" else 1.0) for a, gain in SAID.items()}
    assert told(SPLIT, faint) == "|x|^2 x"


@pytest.mark.parametrize(("alone", "form"), [(7_500.0, "x/|x|"), (5_000.0, "u^2 x")])
def test_a_term_that_says_nearly_all_that_an_effect_does_is_what_is_unknown(
    monkeypatch: pytest.MonkeyPatch, alone: float, form: str
) -> None:
    """Of 8 000 that the effect takes; what it leaves has the form of nothing."""
    whole, rest = Anonymous("dynamics", "in phase", "x/|x|", "amplitude"), Anonymous("drive", "in phase", "u^2 x", "drive")
    model = heard(monkeypatch, {})

    def unnamed(of: object, screener: object, *_: object) -> list[tuple[Screened, Anonymous]]:
        return [(screened("", alone), whole)] if screener is model.screener else [(screened("", 300.0), rest)]

    monkeypatch.setattr(strangers, "_unnamed", unnamed)
    found = strangers.unnamed_rest(model, [])
    assert found is not None
    assert found.term.form == form


def test_a_mode_whose_line_covers_the_resonance_is_none() -> None:
    """A drive that changes its range was a mode 0.14 Hz away and 0.52 Hz wide: a memory of a third of a second."""

    def mode(separation_hz: float, half_width_hz: float) -> Screened:
        candidate = Candidate("spurious_mode", {"separation_hz": separation_hz, "half_width_hz": half_width_hz}, (), np.zeros(0))
        return Screened(candidate, 126.0, 1, 50.0, np.zeros(0), np.zeros(0), 0.0, cast(np.ndarray, np.zeros((1, 1))))

    assert not physical(mode(-0.14, 0.52))
    assert physical(mode(-126.0, 4.8))


def test_beside_one_of_twins_the_other_is_not_tried() -> None:
    assert with_twins(["pickoff_delay", "duffing"]) == {"pickoff_delay", "drive_delay", "duffing"}
    assert with_twins(["drive_memory"]) == {"drive_memory", "pickoff_memory"}
