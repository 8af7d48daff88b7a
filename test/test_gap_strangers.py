"""What no name of the registry fits, on a healthy ring's equations to which one effect's own were added."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from added_effects import with_effects
from table_samples import looked_at, table_model

from gyro_calib.gap.anonymous import HEATED
from gyro_calib.gap.column import Column
from gyro_calib.gap.columns import part_columns
from gyro_calib.gap.floors import beside_wander
from gyro_calib.gap.kin import nearest_known
from gyro_calib.gap.model import look_at
from gyro_calib.gap.one_recording import told_by_several
from gyro_calib.gap.parts import SKEW, Part
from gyro_calib.gap.preflight import usable
from gyro_calib.gap.screen import Candidate
from gyro_calib.gap.select import Selection, _best_refined, best_of_each, select_effects
from gyro_calib.gap.strangers import MARGIN, bank_terms, cancel, unnamed_counts, worth_of
from gyro_calib.trial.injected import with_columns
from gyro_calib.trial.plans import campaign_plan
from gyro_calib.trial.plant import record_unit
from gyro_calib.trial.units import draw_trial_unit

#: of an effect as loud as a practice device's, and of what its form may be short of it
LOUD, SHORT = 450.0, 8.0


def selected(columns: Sequence[Column], snrs: float | Sequence[float] = 25.0) -> Selection:
    return select_effects(with_effects(table_model(), columns, snrs))


def knee(phase: str) -> Candidate:
    """Of the motion, a little above the amplitude in the middle."""
    model = table_model()
    middle = float(np.median([np.median(np.linalg.norm(np.abs(r.signals.pick), axis=1)) for r in model.evidence]))
    knees = [c for term, c in model.bank if (term.location, term.phase) == ("dynamics", phase) and "beyond" in term.form]
    return min(knees, key=lambda c: abs(float(c.setting["level"]) - 1.1 * middle))


@pytest.mark.parametrize("phase", ["in phase", "in quadrature"])
def test_a_force_that_begins_at_a_level_is_in_the_bank(phase: str) -> None:
    """A loss of a subharmonic, an end stop: nothing below the level, in proportion to what lies beyond it above."""
    model, found = table_model(), knee(phase)
    level = float(found.setting["level"])
    sizes = np.array([np.linalg.norm(v) for v in found.columns[0].signal])
    largest = np.array([np.max(np.linalg.norm(np.abs(r.signals.pick), axis=1)) for r in model.evidence])
    assert 0 < np.sum(largest > level) < len(largest)
    assert np.all(sizes[largest < level] < 1e-2 * sizes.max())
    assert np.all(sizes[largest > 1.1 * level] > 1e-2 * sizes.max())


@pytest.mark.slow
def test_a_loss_that_begins_at_a_level_is_no_effect_of_the_registry() -> None:
    """Two losses of the registry, one of them negative, explain it nearly: one unnamed term does better."""
    selection = selected(knee("in phase").columns)
    assert selection.stranger is not None
    assert selection.stranger.term.location == "dynamics"
    assert "beyond" in selection.stranger.term.form


@pytest.mark.slow
def test_friction_of_each_axis_that_the_registry_lacks_is_no_loss_of_the_amplitude() -> None:
    """A loss of the amplitude's square takes a third of it, with the other sign: unnamed, it is what it is."""
    unit, rng, friction = draw_trial_unit("hemisphere", 79, 1), np.random.default_rng(1), "coulomb_friction_axes"
    plan = campaign_plan("hemisphere", unit.device.factory(), rng, "quick")
    campaign = record_unit(unit, plan, {friction: {"c_x": 5e-7, "c_y": 9e-7}}, rng)
    f = campaign.factory
    model = look_at(
        usable(campaign), math.pi * f["nominal_f0_hz"] / f["nominal_q"], f["angular_gain_kappa"], without=(friction, "coulomb_friction")
    )
    selection = select_effects(model)
    assert selection.stranger is not None
    assert (selection.stranger.term.location, selection.stranger.term.form) == ("dynamics", "x_j/|x_j|")


@pytest.mark.slow
def test_friction_of_each_axis_is_found_by_an_axis_at_rest_whose_pickoffs_are_not_square() -> None:
    """All of an axis's friction acts while it is held, to the side that its pick-offs lean: without that its size is false."""
    unit, rng, sizes = draw_trial_unit("ring", 79, 1), np.random.default_rng(1), {"c_x": 1.5e-3, "c_y": 9e-4}
    plan = campaign_plan("ring", unit.device.factory(), rng, "quick")
    model = looked_at(record_unit(unit, plan, {"coulomb_friction_axes": sizes}, rng))
    by_axis = next(c for c in model.candidates["coulomb_friction"] if c.setting["axes"])
    found = model.screener.screen(by_axis)
    assert found is not None
    assert found.log_evidence > MARGIN
    for name, size in sizes.items():
        value, sd = found.sizes()[name]
        assert value == pytest.approx(size, abs=4.0 * sd)
        assert sd < 0.2 * size
    own = [k for k, c in enumerate(by_axis.columns) if not c.name.startswith(SKEW)]
    alone = model.screener.screen(replace(by_axis, columns=tuple(by_axis.columns[k] for k in own), prior_sd=by_axis.prior_sd[own]))
    assert alone is not None
    # of the smaller one, and of the evidence: 3.6 sd and 99 on the day
    value, sd = alone.sizes()["c_y"]
    assert abs(value - sizes["c_y"]) > 3.0 * sd
    assert found.log_evidence > alone.log_evidence + 50.0


@pytest.mark.slow
def test_a_stiffness_that_holds_less_the_larger_the_motion_is_no_constant_force() -> None:
    """A split by the inverse of the amplitude: constants of drive and pick-off and another mode left but noise of it."""
    model = table_model()
    term = next(c for t, c in model.bank if (t.phase, t.form) == ("in quadrature", "x/|x|, as a split"))
    selection = selected([term.columns[0]], 60.0)
    assert selection.stranger is not None
    assert (selection.stranger.term.location, selection.stranger.term.form) == ("dynamics", "x/|x|, as a split")


@pytest.mark.slow
@pytest.mark.parametrize("form", ["|x of 3 s|^2 x", "|x of 15 s|^2 x"])
def test_a_frequency_that_follows_the_heat_of_the_vibration_is_no_wander(form: str) -> None:
    """It is in the shift of every record, whose size is measured: what goes as the energy of a quarter of a minute before is not that."""
    model = table_model()
    term = next(c for t, c in model.bank if (t.phase, t.form) == ("in quadrature", form))
    selection = selected([term.columns[1]])
    assert selection.stranger is not None
    assert (selection.stranger.term.location, selection.stranger.term.form) == ("dynamics", form)


@pytest.mark.parametrize(
    ("location", "form", "place"),
    [
        pytest.param("drive", "|u_j of 0.7 s|^2 x_j, u the drives", 2, marks=pytest.mark.slow),
        pytest.param("dynamics", "Omega of 1 s before x, turned", 0, marks=pytest.mark.slow),
    ],
)
def test_what_warms_or_creeps_in_a_second_has_a_form(location: str, form: str, place: int) -> None:
    """The output stage of a drive by its own power, and a mount by the rate that its table was just given."""
    model = table_model()
    term = next(c for t, c in model.bank if (t.location, t.phase, t.form) == (location, "in phase", form))
    selection = selected([term.columns[place]])
    assert selection.stranger is not None
    assert (selection.stranger.term.location, selection.stranger.term.form) == (location, form)


@pytest.mark.parametrize("several", [True, False])
def test_what_is_remembered_is_remembered_by_several_recordings(several: bool) -> None:
    """A ring-down that began before the wave had come to rest was a bias that lags, or what warmed drives do."""
    model = table_model()
    memory = next(c for t, c in model.bank if (t.location, t.phase, t.form) == ("drive", "in phase", "|u of 3 s|^2 x, u the drives"))
    column = memory.columns[1]
    # of one open drive the gains take 0.99, and what is left lies in the other recordings
    waves = [k for k, r in enumerate(model.evidence) if r.is_wave]
    first = max(waves, key=lambda k: float(np.linalg.norm(column.signal[k])))
    once = replace(column, signal=tuple(v if k == first else 0.0 * v for k, v in enumerate(column.signal)))
    added = column if several else once
    strange = with_columns(model, [(added, 25.0 / float(np.linalg.norm(model.screener.projected([added])[0])))])
    found = strange.screener.screen(memory)
    assert found is not None
    assert found.log_evidence > 2.0 * MARGIN
    assert any(s.candidate is memory for s, _ in bank_terms(strange, strange.screener)) is several
    for name, told in (("thermal_bias_lag", several), ("thermal_bias", True), ("drive_lag", True)):
        assert told_by_several(strange, replace(found, candidate=replace(memory, name=name)), []) is told


def test_a_drive_that_lags_beyond_a_level_is_in_the_bank() -> None:
    """An amplifier of one axis that cannot slew so fast: of 5120 a limiter of both took 3270, a cube of the pick-offs 4115."""
    model, slew_v = table_model(), 0.9 * max(float(np.abs(r.signals.drive[:, 1]).max()) for r in table_model().evidence)
    late = []
    for r in model.evidence:
        u = r.signals.drive[:, 1]
        over = np.maximum(1.0 - slew_v / np.maximum(np.abs(u), 1e-300), 0.0)
        late.append([Part("late", "drive", np.stack([0.0 * u, -1j * over**2 * u], axis=1))])
    strange = with_effects(model, part_columns(model.evidence, late, model.linear), 60.0)
    found = max(bank_terms(strange, strange.screener), key=lambda pair: worth_of(pair[0]))
    assert (found[1].location, found[1].phase) == ("drive", "of any phase")
    assert "beyond" in found[1].form
    sizes = dict(zip((c.name for c in found[0].candidate.columns), found[0].values, strict=True))
    assert sizes["c_1_late"] > 5.0 * abs(sizes["c_1"])


def test_what_lies_between_records_is_asked_beside_a_wander_of_any_size() -> None:
    """A clean ring's wander was half as large as it was, and what vibration warms 87 in chi-square beside it."""
    model = table_model()
    heated = next(c for t, c in model.bank if (t.location, t.phase, t.form) == ("dynamics", HEATED[1], HEATED[0]))
    rng = np.random.default_rng(8)
    shifts = [c for c in model.nuisances if c.name.startswith("shift_") and c.prior_sd < np.inf]
    wandering = with_columns(model, [(c, 30.0 * c.prior_sd * rng.normal()) for c in shifts])
    found = wandering.screener.screen(heated)
    assert found is not None
    assert found.gain > 60.0, "a wander thirty times as large as it is believed is told by whatever follows the amplitude"
    assert beside_wander(wandering, [], found) < 20.0
    assert not any((t.phase, t.form) == (HEATED[1], HEATED[0]) for _, t in bank_terms(wandering, wandering.screener))


@pytest.mark.parametrize(("share", "counts"), [(0.003, False), (0.015, True)])
def test_what_is_left_of_loud_names_is_first_order_or_something_else(share: float, counts: bool) -> None:
    """Right names left 0.0023 of what they took, three that imitated a soft knee of the pick-offs 0.015."""
    model = table_model()
    loud = model.screener.screen(model.candidates["nonlinear_damping"][0])
    left = model.screener.screen(next(c for t, c in model.bank if t.form == "|x|^4 x"))
    assert loud is not None
    assert left is not None
    assert unnamed_counts(replace(left, gain=share * LOUD**2), [replace(loud, gain=LOUD**2)]) is counts


@pytest.mark.slow
def test_two_effects_of_the_registry_are_no_stranger() -> None:
    model = table_model()
    of_one, of_other = model.candidates["nonlinear_damping"][0], model.candidates["pickoff_amplitude_phase"][0]
    selection = selected([of_one.columns[0], of_other.columns[0]])
    assert selection.stranger is None
    names = [set(group) for group in selection.groups]
    assert any("nonlinear_damping" in g for g in names)
    assert any("pickoff_amplitude_phase" in g for g in names)


@pytest.mark.slow
def test_an_effect_whose_form_is_short_of_a_thousandth_keeps_its_name() -> None:
    """A table of one speed hardly tells |Omega| from Omega^2: an unnamed term of both axes holds an asymmetry and what its form lacks."""
    model = table_model()
    asymmetry = model.candidates["rate_asymmetry"][0]
    term = next(c for t, c in model.bank if (t.location, t.phase, t.form) == ("dynamics", "in phase", "Omega^2 x, crossed"))
    own = model.screener.projected(asymmetry.columns)[0][:, 0]
    both = model.screener.projected(term.columns)[0]
    both /= np.linalg.norm(both, axis=0)
    beyond = np.linalg.norm(both - np.outer(own, own @ both) / float(own @ own), axis=0)
    k = int(np.argmax(beyond))
    selection = selected([asymmetry.columns[0], term.columns[k]], [LOUD, SHORT / float(beyond[k])])
    assert selection.stranger is None
    assert [e.name for e in selection.effects] == ["rate_asymmetry"]


def test_nearest_is_what_shows_the_same_not_what_explains_most() -> None:
    """Beside a Duffing far louder than it."""
    model = table_model()
    drift, duffing = model.candidates["drive_gain_drift"][0], model.candidates["duffing"][0]
    loud = with_effects(model, [*duffing.columns[:1], *drift.columns[:1]], [200.0, 15.0])
    unnamed = next(c for a, c in loud.bank if (a.location, a.phase, a.form) == ("drive", "in phase", "t x, other on each axis"))
    assert max(loud.screener.screened(c for tried in loud.candidates.values() for c in tried), key=lambda s: s.gain).name == "duffing"
    assert nearest_known(loud, unnamed) == "drive_gain_drift"


def test_two_effects_that_leave_a_fiftieth_of_each_other_are_one_thing() -> None:
    """Late gains of drives and of pick-offs, of 2.9e-3/K and -2.9e-3/K, were a damping that lags."""
    model = table_model()
    drive = model.screener.screen(model.candidates["drive_nonlinearity"][0])
    assert drive is not None
    drive = replace(drive, values=np.full_like(drive.values, 3e-3))
    # but for how fast they change both are one
    pickoff = replace(drive, candidate=replace(drive.candidate, name="pickoff_nonlinearity"), values=0.98 * drive.values)
    assert not cancel(model, [drive, pickoff])
    against = replace(pickoff, values=-pickoff.values)
    assert cancel(model, [drive, against])
    assert not cancel(model, [drive, replace(against, values=0.9 * against.values)])
    assert not cancel(model, [drive])


@pytest.mark.slow
def test_a_stiffness_by_the_drives_square_half_a_sample_late_has_its_name() -> None:
    """Where its mean over a cycle took more at first, what was left was a damping, a gap and unnamed (twenty-fifth plant)."""
    unit, rng = draw_trial_unit("hemisphere", 79, 1), np.random.default_rng(1)
    model = looked_at(record_unit(unit, campaign_plan("hemisphere", unit.device.factory(), rng, "quick"), {}, rng))
    k, late_rad = -1.3e-6, 0.71
    by_recording = []
    for r in model.evidence:
        u = r.signals.drive
        p = r.signals.pick - u @ model.linear.E.T
        by_recording.append([Part("k", "flow", 1j * (2.0 * np.abs(u) ** 2 * p + np.exp(1j * late_rad) * u**2 * p.conj()))])
    (column,) = part_columns(model.evidence, by_recording, model.linear)
    strange = with_columns(model, [(column, k)])
    mean = next(c for c in strange.candidates["drive_stiffness"] if c.setting["axes"] == 1.0)
    found = strange.screener.screen(mean)
    assert found is not None
    assert _best_refined(strange, [], [found]).setting == {"axes": 0.0}
    selection = select_effects(strange)
    assert [(e.name, e.candidate.setting) for e in selection.effects] == [("drive_stiffness", {"axes": 0.0})]
    assert selection.stranger is None
    assert selection.chi2_after < 1.1 * selection.dof < 0.9 * selection.chi2_before


@pytest.mark.slow
def test_an_effect_that_hardly_shows_is_asked_what_comes_with_it() -> None:
    """A stiffness by the drives' square may show by its phase alone: 34 and 217 in chi-square (plant 32: a cube and a mode)."""
    model, late_rad = table_model(), 1.2
    by_recording = []
    for r in model.evidence:
        u = r.signals.drive
        p = r.signals.pick - u @ model.linear.E.T
        by_recording.append([Part("k", "flow", 1j * (2.0 * np.abs(u) ** 2 * p + np.exp(1j * late_rad) * u**2 * p.conj()))])
    strange = with_effects(model, part_columns(model.evidence, by_recording, model.linear), 8.8)
    hidden = strange.screener.screen(next(c for c in strange.candidates["drive_stiffness"] if c.setting["axes"] == 0.0))
    (other,) = best_of_each(strange.screener, {"duffing": strange.candidates["duffing"]})
    assert hidden is not None
    assert 3.0 < hidden.log_evidence < MARGIN < other.log_evidence
    assert _best_refined(strange, [], [other, hidden]).name == "drive_stiffness"
