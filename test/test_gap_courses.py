"""Courses of time without a name: a gain that swings, steps or settles anew is seen as that, a healthy floor is not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from added_effects import with_effects

from gyro_calib.device import Device, draw_unit, load_device
from gyro_calib.effects import EFFECTS
from gyro_calib.experiments import SimulatedInstrument, gap_ftr_plan, run_plan
from gyro_calib.gap import diagnose
from gyro_calib.gap.anonymous import anonymous_candidates
from gyro_calib.gap.columns import form_columns
from gyro_calib.gap.evidence import CampaignEvidence
from gyro_calib.gap.floors import course_beside_floors
from gyro_calib.gap.forms import FORMS
from gyro_calib.gap.linear_device import frequency_columns, linear_columns
from gyro_calib.gap.model import CampaignModel, look_at
from gyro_calib.gap.noise import _repeated, with_repeats
from gyro_calib.gap.nuisance import following_columns, thermal_columns
from gyro_calib.gap.parts import Linear
from gyro_calib.gap.preflight import usable
from gyro_calib.gap.screen import Candidate, Screened
from gyro_calib.gap.select import select_effects
from gyro_calib.gap.signals import with_temperature
from gyro_calib.gap.slow import slow_drifts
from gyro_calib.gap.strangers import CHANGES, bank_terms, one_change_of_another_kind, worth_of
from gyro_calib.gap.system import NoiseByRole, Whitener, solve
from gyro_calib.gap.thermometer import own_columns, own_detuning_rad_s, thermometer_columns
from gyro_calib.recording.columns import column_index
from gyro_calib.recording.recording import Campaign, Recording
from gyro_calib.simulation import GyroSimulator

PERIOD_S = 33.0


@cache
def unit() -> Device:
    return draw_unit(load_device("ring_15k"), 5)


@cache
def clean() -> Campaign:
    return campaign_of(unit())


def campaign_of(device: Device) -> Campaign:
    return run_plan(
        SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(8), fidelity="carrier"), 2e-5),
        gap_ftr_plan(device.factory(), quality="quick"),
    )


def with_reading_gain(gain: Callable[[Recording, float], np.ndarray]) -> Campaign:
    """The campaign as a recorder has it whose y channel has a gain of its own, behind what the loops see."""
    start = min(float(r.t[0]) for r in clean())
    first = column_index("y_pick_c")

    def changed(r: Recording) -> Recording:
        data = r.data.copy()
        data[:, first : first + 2] *= (1.0 + gain(r, start))[:, None]
        return replace(r, data=data)

    return replace(clean(), recordings=tuple(changed(r) for r in clean()))


def model_of(campaign: Campaign) -> CampaignModel:
    f = campaign.factory
    return look_at(usable(campaign), np.pi * f["nominal_f0_hz"] / f["nominal_q"], f["angular_gain_kappa"])


@pytest.mark.slow
def test_what_grows_with_time_must_beat_a_floor_as_courses_do() -> None:
    """A reading whose gain drifts by 1e-5 is a floor's, by 3e-3 it is none; what does not go with time competes either way."""
    for drift, counts in ((1e-5, False), (3e-3, True)):
        model = model_of(with_reading_gain(lambda r, start, most=drift: most * (r.t - start) / 300.0))  # type: ignore[misc]
        terms = bank_terms(model, model.screener)
        of_time = [found for found, term in terms if term.depends_on == "time"]
        assert bool(of_time) == counts
        assert all(worth_of(found) > 25.0 for found in of_time)
        assert any(worth_of(found) < 25.0 for found, term in terms if term.depends_on != "time")


@pytest.mark.slow
def test_what_drifts_steadily_is_no_floor_whether_it_has_a_name_or_not() -> None:
    """Drive gains that part by 1e-6 a second: without its name the size of the floors took it in, and the device was healthy."""
    drifting = campaign_of(replace(unit(), effects={"drive_gain_drift": {"g_x": 6e-7, "g_y": -6e-7}}))
    for left_out, verdict in (((), "effects"), (("drive_gain_drift", "pickoff_gain_drift"), "unknown")):
        found = diagnose(drifting, without=left_out)
        assert found.verdict == verdict
    assert found.unknown is not None
    assert (found.unknown.form.split(",")[0], found.unknown.depends_on) == ("t x", "time")


@pytest.mark.slow
def test_a_reading_that_swings_is_unknown_with_its_period() -> None:
    found = diagnose(with_reading_gain(lambda r, start: 2e-4 * np.cos(2.0 * np.pi * (r.t - start) / PERIOD_S)))
    assert found.verdict == "unknown"
    assert found.unknown is not None
    # held where it is, a wave does not tell a reading that is larger from a drive that is
    assert found.unknown.location in ("pick-off", "drive")
    assert (found.unknown.phase, found.unknown.depends_on) == ("in phase", "time")
    assert found.unknown.form.startswith("x times what goes to and fro every ")
    assert float(found.unknown.form.split()[-2]) == pytest.approx(PERIOD_S, abs=3.0)


@pytest.mark.slow
def test_a_reading_that_steps_between_recordings_is_unknown_with_its_moment() -> None:
    ordered = sorted(clean(), key=lambda r: float(r.t[0]))
    moment = float(ordered[len(ordered) // 2].t[0])
    model = model_of(with_reading_gain(lambda r, start: 5e-4 * (r.t >= moment)))
    found = model.courses.best(model.screener, model.whitener)
    assert found is not None
    form, _, said = found[1].form.rpartition(" from ")
    assert form == "x times what is another"
    # the y reading is seen by recordings of that axis alone
    of_y = np.array([float(r.t[0]) for r in ordered if r.command.mode == "ftr_y"])
    stated = float(ordered[0].t[0]) + float(said.split()[0]) - 0.5
    np.testing.assert_array_equal(of_y >= stated, of_y >= moment)
    size, sd = max(found[0].sizes().values(), key=lambda pair: abs(pair[0] / pair[1]))
    assert abs(size) == pytest.approx(5e-4, abs=0.05 * 5e-4 + 4.0 * sd)
    assert select_effects(model).stranger is not None


@pytest.mark.slow
def test_a_floor_does_not_grow_until_it_holds_a_step() -> None:
    model = model_of(clean())
    drifts = slow_drifts(model.evidence, model.linear)
    assert course_beside_floors(model.courses, model.whitener, model.target, model.nuisances, drifts) is None
    steps = [k for k, (form, *_) in enumerate(model.courses.forms) if "another from" in form]
    step = model.courses._candidate(steps[len(steps) // 2], 0).columns[1]
    stepped = with_effects(model, [step], 40.0)
    found = course_beside_floors(stepped.courses, stepped.whitener, stepped.target, stepped.nuisances, drifts)
    assert found is not None
    assert "another from" in found.name


@pytest.mark.slow
def test_a_split_that_steps_between_recordings_is_dynamics_in_quadrature() -> None:
    """Recordings of two units that differ by 1 mHz of split, the ones before a moment and the others after it."""
    resonator = replace(unit().resonator, frequency_split_hz=unit().resonator.frequency_split_hz + 1e-3)
    other = campaign_of(replace(unit(), resonator=resonator))
    ordered = sorted(clean(), key=lambda r: float(r.t[0]))
    moment = float(ordered[len(ordered) // 2].t[0])
    changed = tuple(b if float(a.t[0]) >= moment else a for a, b in zip(clean(), other, strict=True))
    model = model_of(replace(clean(), recordings=changed))
    found = model.courses.best(model.screener, model.whitener)
    assert found is not None
    assert (found[1].location, found[1].phase, found[1].depends_on) == ("dynamics", "in quadrature", "time")
    form, _, said = found[1].form.rpartition(" from ")
    assert (form, said.split(" s on")[1]) == ("x times what is another", ", other on each axis or crossed")
    assert float(said.split()[0]) == pytest.approx(moment - float(ordered[0].t[0]), abs=3.0)
    assert select_effects(model).stranger is not None


@pytest.mark.slow
def test_a_split_that_saturates_is_unknown_with_its_course_where_the_registry_has_no_charge() -> None:
    """Beside a straight drift the rest of a course of 40 in strength was the floor, and the verdict none."""
    campaign = campaign_of(replace(unit(), effects={"charge_accumulation": {"k_c": 6e-3, "k_s": -4e-3, "tau": 60.0}}))
    named = diagnose(campaign)
    assert [e.name for e in named.effects] == ["charge_accumulation"]
    unknown = diagnose(campaign, without=("charge_accumulation",)).unknown
    assert unknown is not None
    assert (unknown.location, unknown.phase, unknown.depends_on) == ("dynamics", "in quadrature", "time")
    assert "what saturates over" in unknown.form


@pytest.mark.slow
def test_a_reading_that_is_another_in_every_recording_is_noise() -> None:
    """Of their means: that is where repeats differ, and no model of the device says by how much."""
    rng = np.random.default_rng(3)
    gains = {r.label: 1e-4 * rng.standard_normal() for r in clean()}
    model = model_of(with_reading_gain(lambda r, start: np.full(len(r.t), gains[r.label])))
    steady = {key: replace(law, mean=0.0) for key, law in model.noise.items()}

    def repeats_over_noise(noise: NoiseByRole) -> float:
        whitener = Whitener.of(model.evidence, noise, model.excess)
        design = whitener.design(model.nuisances, len(model.evidence))
        found = _repeated(model.evidence, solve(model.nuisances, design, whitener.rows(model.target)), noise)
        return sum(square for square, _, _ in found.values()) / sum(free for _, free, _ in found.values())

    heard = with_repeats(model.evidence, model.nuisances, steady, model.excess, model.target)
    assert repeats_over_noise(steady) > 3.0
    assert repeats_over_noise(heard) < 1.5


def test_three_changes_of_one_property_are_one_of_another_kind() -> None:
    """Two may be a pair; hysteresis took a drift, a lag and a charge for itself."""

    def found(*names: str, last: float = 4.0) -> list[Screened]:
        nothing = np.zeros(0)
        gains = [*[50.0] * (len(names) - 1), last]
        return [
            Screened(Candidate(n, {}, (), nothing), g, 1, 20.0, nothing, nothing, 0.0, nothing) for n, g in zip(names, gains, strict=True)
        ]

    assert one_change_of_another_kind(found("split_drift", "thermal_split_lag", "charge_accumulation"))
    assert not one_change_of_another_kind(found("split_drift", "thermal_split_lag", "damping_drift"))
    # one gradient made all three
    assert one_change_of_another_kind(found("thermal_drive_gain_lag", "thermal_damping_lag", "thermal_pickoff_gain_lag"))
    assert not one_change_of_another_kind(found("split_drift", "split_drift", "thermal_split"))
    # a late damping is late along its axes as well
    lags = ("thermal_split_lag", "thermal_damping_lag", "thermal_damping_anisotropy_lag")
    assert not one_change_of_another_kind(found(*lags, last=50.0))
    assert one_change_of_another_kind(found(*lags, "thermal_bias_lag", last=50.0))
    # of whatever kind, three that each take their share are one that is none of them; two are a pair
    assert one_change_of_another_kind(found("split_drift", "duffing", "damping_drift", last=10.0))
    assert not one_change_of_another_kind(found("split_drift", "duffing", last=50.0))


def test_the_names_of_one_property_s_changes_are_the_registry_s() -> None:
    assert all(name in EFFECTS for changes in CHANGES for name in changes)


def test_a_healthy_floor_is_no_course() -> None:
    assert diagnose(clean()).verdict == "none"


def test_a_thermometer_that_errs_moves_what_follows_the_temperature() -> None:
    """One kelvin in one record is the difference of the columns there, at the sizes found."""
    warmed = [r.data.copy() for r in clean()]
    for data in warmed:
        data[:, column_index("temperature")] += 0.05 * (data[:, 0] - clean().recordings[0].t[0])
    evidence = CampaignEvidence.of([replace(r, data=data) for r, data in zip(clean(), warmed, strict=True)], 1.5)
    linear = Linear(-1.5 * np.eye(2) + 0j, -8j * np.eye(2), np.zeros((2, 2), dtype=complex), 0.8, -2.5)
    values = {c.name: 1e-3 * (k + 1) for k, c in enumerate(following_columns(evidence, linear))}
    made = {c.name: c for c in thermometer_columns(evidence, linear, values, 1e-3)}
    k = next(k for k, r in enumerate(evidence) if r.is_wave)
    one = evidence.recordings[k]
    warmer = tuple(
        replace(r, signals=with_temperature(r.signals, r.signals.temperature_k + 1.0)) if r is one else r for r in evidence.recordings
    )
    columns = (following_columns(e, linear) for e in (replace(evidence, recordings=warmer), evidence))
    expected = sum(values[a.name] * (a.signal[k] - b.signal[k]) for a, b in zip(*columns, strict=True))
    np.testing.assert_allclose(made[f"thermometer_{one.index}"].signal[k], expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
    assert not any(np.any(v) for j, v in enumerate(made[f"thermometer_{one.index}"].signal) if j != k)
    assert {c.prior_sd for c in made.values()} == {1e-3}
    known = {c.name for c in [*linear_columns(evidence, linear), *frequency_columns(evidence), *thermal_columns(evidence, linear)]}
    assert not known & set(made)


def test_a_resonance_of_its_own_temperature_is_read_from_the_phase_of_its_wave() -> None:
    """A wave whose phase swings, its drive's with it, has a resonance that swings as fast; without a wave that is held nothing says so."""
    swing, period_s = 2e-3, 3.0
    held = next(r for r in usable(clean()) if r.command.mode == "ftr_x" and r.command.excitation.kind == "none" and r.duration_s > 3.0)
    data, angle = held.data.copy(), 2.0 * np.pi * (held.t - held.t[0]) / period_s
    turn = np.exp(1j * swing * np.sin(angle))
    for channel in ("x_pick", "y_pick", "x_drive", "y_drive"):
        c, s = column_index(f"{channel}_c"), column_index(f"{channel}_s")
        volts = (data[:, c] + 1j * data[:, s]) * turn
        data[:, c], data[:, s] = volts.real, volts.imag
    free = next(r for r in usable(clean()) if r.command.mode == "loops_off")
    evidence = CampaignEvidence.of([held, replace(held, data=data), free], 1.5)
    linear = Linear(-1.5 * np.eye(2) + 0j, -8j * np.eye(2), np.zeros((2, 2), dtype=complex), 0.8, -2.5)
    still, swung, gone = (own_detuning_rad_s(r, linear, {}) for r in evidence)
    t = evidence.recordings[0].signals.time_s
    expected = swing * 2.0 * np.pi / period_s * np.cos(2.0 * np.pi * (t - t[0]) / period_s)
    expected -= expected.mean()
    # smoothed over 0.4 s; at its ends a record knows half of that
    expected *= np.sinc(0.4 / period_s)
    inner = (t - t[0] > 0.3) & (t[-1] - t > 0.3)
    assert np.abs(swung - still - expected)[inner].max() < 0.05 * np.abs(expected).max()
    assert not gone.any()


def test_where_no_temperature_was_varied_a_gain_of_usual_size_follows_the_resonance() -> None:
    """A pick-off's gain of 3e-4/K and a resonance of 5e-6/K: sixty times the relative distance, on both axes alike."""
    evidence = CampaignEvidence.of(list(usable(clean())), 1.5)
    linear = Linear(-1.5 * np.eye(2) + 0j, -8j * np.eye(2), np.zeros((2, 2), dtype=complex), 0.8, 0.0)
    (own,) = own_columns(evidence, linear, {})
    away = [60.0 * own_detuning_rad_s(r, linear, {}) / evidence.omega0_rad_s for r in evidence]
    moved = replace(
        evidence, recordings=tuple(replace(r, signals=with_temperature(r.signals, a)) for r, a in zip(evidence, away, strict=True))
    )
    by_axis = form_columns(moved, FORMS["thermal_pickoff_gain"], linear, {})
    assert own.prior_sd == 1.0
    for k in range(len(evidence.recordings)):
        expected = sum(c.signal[k] for c in by_axis)
        np.testing.assert_allclose(own.signal[k], expected, rtol=1e-6, atol=1e-6 * max(np.abs(expected).max(), 1e-300))


def test_what_both_axes_have_alike_is_what_each_has() -> None:
    """A factor times x is the sum of the terms by axis, whatever it depends on; across, neither is it."""
    evidence = CampaignEvidence.of(list(clean()), 1.5)
    linear = Linear(-1.5 * np.eye(2) + 0j, -8j * np.eye(2), np.zeros((2, 2), dtype=complex), 0.8, -2.5)
    terms = {(a.location, a.phase, a.form): c.columns for a, c in anonymous_candidates(evidence, linear)}
    for form in ("T x", "(T - T of 20 s before) x", "t x", "|u of 3 s|^2 x, u the drives", "|u of 15 s|^2 x, u the drives"):
        alike, each, crossed = (terms["drive", "in phase", f"{form}{shape}"] for shape in ("", ", other on each axis", ", crossed"))
        assert len(each) == len(crossed) == 2 * len(alike)
        for k, column in enumerate(alike):
            for r in range(len(evidence)):
                together = each[2 * k].signal[r] + each[2 * k + 1].signal[r]
                np.testing.assert_allclose(together, column.signal[r], atol=1e-12 * max(np.abs(column.signal[r]).max(), 1e-300))
        assert any(not np.allclose(a.signal[r], b.signal[r]) for a, b in zip(each, crossed, strict=True) for r in range(len(evidence)))
