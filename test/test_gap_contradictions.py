"""Recordings that contradict each other, their thermometer or what they say was commanded are named; what is sound passes all of it."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from gyro_calib.device import draw_unit, load_device
from gyro_calib.errors import DataError
from gyro_calib.experiments import SimulatedInstrument, gap_ftr_plan, gap_whole_angle_plan, run_plan
from gyro_calib.gap.commanded import check_commanded
from gyro_calib.gap.diagnose import diagnose
from gyro_calib.gap.lines import lines_of
from gyro_calib.gap.odd_one_out import check_alike
from gyro_calib.gap.one_clock import on_one_clock
from gyro_calib.gap.one_device import check_one_device, said_of_decay, said_of_reference
from gyro_calib.gap.parts import Linear
from gyro_calib.gap.preflight import check_campaign, check_linear
from gyro_calib.recording import Campaign, Recording
from gyro_calib.recording.columns import COLUMNS
from gyro_calib.recording.command import Command, Excitation
from gyro_calib.simulation import GyroSimulator

ODD = "side_x_a1_0.5hz"


@cache
def ring() -> Campaign:
    """A ring's campaign with a chamber."""
    unit = draw_unit(load_device("ring_15k"), 7)
    plan = gap_ftr_plan(unit.factory(), quality="quick", abilities=("temperature",))
    return run_plan(SimulatedInstrument(GyroSimulator(unit, rng=np.random.default_rng(7), fidelity="slow_flow"), 1e-4), plan)


@cache
def hemisphere() -> Campaign:
    """Turned waves of a hemisphere."""
    unit = draw_unit(load_device("hrg_hardware"), 3)
    plan = gap_whole_angle_plan(unit.factory(), quality="quick")
    plan = replace(plan, steps=tuple(s for s in plan.steps if s.label.startswith(("place", "vir", "free", "turn"))))
    return run_plan(SimulatedInstrument(GyroSimulator(unit, rng=np.random.default_rng(3), fidelity="slow_flow"), 1e-4), plan)


@cache
def warmed_hemisphere() -> Campaign:
    """All that a hemisphere's plan holds, with a chamber."""
    unit = draw_unit(load_device("hrg_hardware"), 3)
    plan = gap_whole_angle_plan(unit.factory(), quality="quick", abilities=("temperature",))
    return run_plan(SimulatedInstrument(GyroSimulator(unit, rng=np.random.default_rng(3), fidelity="slow_flow"), 1e-4), plan)


def changed(label: str, change: Callable[[Recording], Recording], of: Campaign | None = None) -> list[Recording]:
    recordings = [change(r) if r.label == label else r for r in of or ring()]
    assert any(r.label == label for r in recordings)
    return recordings


def column(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Recording], Recording]:
    def made(r: Recording) -> Recording:
        data = r.data.copy()
        data[:, COLUMNS.index(name)] = change(data[:, COLUMNS.index(name)])
        return replace(r, data=data)

    return made


def decay(campaign: Campaign) -> float:
    return math.pi * campaign.factory["nominal_f0_hz"] / campaign.factory["nominal_q"]


@pytest.mark.parametrize("campaign", [ring, hemisphere])
def test_a_sound_campaign_passes(campaign: Callable[[], Campaign]) -> None:
    recordings, said = on_one_clock(list(campaign()))
    assert said == []
    assert [r.data is s.data for r, s in zip(recordings, campaign(), strict=True)] == [True] * len(recordings)
    check_one_device(recordings)
    check_commanded(recordings, decay(campaign()))
    check_alike(recordings, campaign().factory["angular_gain_kappa"])
    assert said_of_reference(recordings, campaign().factory) == []


def test_recordings_of_a_clock_that_is_set_back_stand_behind_each_other() -> None:
    """A healthy ring whose times all began at zero had a flicker of its drives."""
    zeroed = [replace(column("t", lambda t: t - t[0])(r), extras={**r.extras, "t_run_start": 700.0, "settle_s": 0.0}) for r in ring()]
    recordings, said = on_one_clock(zeroed)
    assert len(said) == 1
    assert zeroed[0].label in said[0]
    assert all(a.t[-1] < b.t[0] for a, b in pairwise(recordings))
    # a table's log that counts from another clock counts from the record's first row
    assert all("t_run_start" not in r.extras for r in recordings)
    np.testing.assert_array_equal(recordings[3].data[:, 1:], zeroed[3].data[:, 1:])


def test_a_recording_that_is_there_twice_is_named() -> None:
    recordings = list(ring())
    with pytest.raises(DataError, match=rf"{recordings[4].label}.*Leave one of them out"):
        on_one_clock([*recordings, recordings[4]])


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("temperature", lambda k: 1.8 * k + 32.0, "degF"),
        ("temperature", lambda k: k + 12.0, "its temperature is wrong"),
        ("ref_freq", lambda f: f + 29.0, "another device"),
    ],
)
def test_what_the_resonance_contradicts_is_named(name: str, change: Callable[[np.ndarray], np.ndarray], words: str) -> None:
    with pytest.raises(DataError, match=rf"{ODD}.*{words}"):
        check_one_device(changed(ODD, column(name, change)))


def test_the_only_recording_that_is_warmed_tells_its_unit() -> None:
    """By itself it says how the resonance goes with its column; it begins where the others are, whatever the column says."""
    label = next(r.label for r in hemisphere() if r.label.startswith("vir"))

    def warmed(r: Recording) -> Recording:
        rise = np.linspace(0.0, 8.0, len(r))
        return column("ref_freq", lambda f: f * (1.0 + 88e-6 * rise))(column("temperature", lambda k: k + rise)(r))

    recordings = changed(label, warmed, hemisphere())
    check_one_device(recordings)
    with pytest.raises(DataError, match=rf"{label}.*degF"):
        check_one_device([column("temperature", lambda k: 1.8 * k + 32.0)(r) if r.label == label else r for r in recordings])


def test_a_thermometer_that_is_not_read_is_named() -> None:
    still = [column("temperature", lambda k: np.full_like(k, 25.0))(r) for r in ring()]
    resting = [r for r in still if not r.label.startswith("thermal")]
    check_one_device(resting)
    warmed = [column("ref_freq", lambda f: f + np.linspace(0.0, 5.0, f.size))(r) if r is resting[0] else r for r in resting]
    with pytest.raises(DataError, match=r"every row of every recording.*Read the thermometer"):
        check_one_device(warmed)


def test_factory_data_of_another_unit_are_said() -> None:
    factory = ring().factory
    assert "298.1" in said_of_reference(list(ring()), {**factory, "reference_temperature_degC": 298.15})[0]
    assert "16000" in said_of_reference(list(ring()), {**factory, "nominal_f0_hz": 16000.0})[0]
    flow = -np.diag([1.5, 1.6]) + 0j
    assert said_of_decay(flow, 1.0) == []
    assert "nominal_q" in said_of_decay(flow, 15.0)[0]


def open_label(kind: str) -> str:
    return next(r.label for r in ring() if r.command.excitation.kind == kind)


@pytest.mark.parametrize(
    ("label", "command", "words"),
    [
        ("feed_x_+20hz", lambda c: Command("loops_off"), "x drive carries.*open_drive"),
        ("feed_x_+20hz", lambda c: replace(c, excitation=replace(c.excitation, volts=3.0 * c.excitation.volts)), "other open drives"),
        (ODD, lambda c: replace(c, excitation=Excitation()), "swings by .*attribute excitation"),
        ("static_x_0", lambda c: replace(c, mode="loops_off"), "drive carries"),
    ],
)
def test_what_moves_a_wave_must_be_said(label: str, command: Callable[[Command], Command], words: str) -> None:
    with pytest.raises(DataError, match=rf"{label[:6]}.*{words}".replace("+", r"\+")):
        check_commanded(changed(label, lambda r: replace(r, command=command(r.command))), decay(ring()))


def test_a_shaker_that_is_not_said_is_seen_in_a_wave_that_does_not_decay() -> None:
    rows, decays = 3000, np.exp(-1.5 * np.linspace(0.0, 3.0, 3000))
    for course, named in ((np.ones(rows), True), (decays, False)):
        data = np.zeros((rows, len(COLUMNS)))
        data[:, 0], data[:, 2], data[:, COLUMNS.index("ref_freq")] = 1e-3 * np.arange(rows), 0.08 * course, 15e3
        free = Recording("r", data, Command("loops_off"), 1000.0, "shaken")
        if named:
            with pytest.raises(DataError, match=r"shaken.*does not decay.*body_excitation"):
                check_commanded([*ring(), free], 1.5)
        else:
            check_commanded([*ring(), free], 1.5)


def test_a_wave_that_turns_against_its_attribute_is_named() -> None:
    turned = [r for r in hemisphere() if r.command.setpoints.virtual_precession_v != 0.0]
    label = max(turned, key=lambda r: abs(r.command.setpoints.virtual_precession_v)).label

    def against(r: Recording) -> Recording:
        setpoints = replace(r.command.setpoints, virtual_precession_v=-r.command.setpoints.virtual_precession_v)
        return replace(r, command=replace(r.command, setpoints=setpoints))

    with pytest.raises(DataError, match=f"{label}.*turns the other way"):
        check_commanded(changed(label, against, hemisphere()), decay(hemisphere()))


def test_small_columns_that_mean_something_else_are_told_by_the_change_that_leaves_least() -> None:
    """c and s of the x pick-off, swapped, had the remedy of another column, which mends most of it as well."""
    gain = ring().factory["angular_gain_kappa"]
    for name, words in (("x_pick", "x pick-off columns look swapped"), ("y_drive", "y drive columns look swapped")):
        c, s = (COLUMNS.index(f"{name}_{q}") for q in "cs")

        def swapped(r: Recording, c: int = c, s: int = s) -> Recording:
            data = r.data.copy()
            data[:, [c, s]] = data[:, [s, c]]
            return replace(r, data=data)

        with pytest.raises(DataError, match=rf"{ODD}.*{words}"):
            check_alike(changed(ODD, swapped), gain)


@pytest.mark.parametrize(("factor", "words"), [(0.5, "half as large"), (math.sqrt(0.5), "rms volts"), (2.0, "twice as large")])
@pytest.mark.parametrize("of", [ring, hemisphere])
def test_drives_of_another_size_in_one_recording_are_told_by_how_much(of: Callable[[], Campaign], factor: float, words: str) -> None:
    label = ODD if of is ring else next(r.label for r in of() if r.label.startswith("vir"))

    def scaled(r: Recording) -> Recording:
        for name in COLUMNS[5:9]:
            r = column(name, lambda x: factor * x)(r)
        return r

    with pytest.raises(DataError, match=rf"{label}.*drive columns.*{words}"):
        check_alike(changed(label, scaled, of()), of().factory["angular_gain_kappa"])


def test_the_small_part_of_one_drive_has_a_sign() -> None:
    """The drive of a wave that precesses is nearly in quadrature: what is in phase is a hundredth of it, and was believed either way."""
    label = next(r.label for r in hemisphere() if r.label.startswith("vir"))
    with pytest.raises(DataError, match=rf"{label}.*the c of the y drive columns"):
        check_alike(changed(label, column("y_drive_c", np.negative), hemisphere()), hemisphere().factory["angular_gain_kappa"])


@pytest.mark.parametrize("q", "cs")
@pytest.mark.parametrize("axis", "xy")
def test_one_part_of_a_drive_that_has_the_wrong_sign_in_all_recordings_is_named(axis: str, q: str) -> None:
    """The gain of that drive is turned as well, which tells it from the other part and from the two swapped."""
    all_wrong = [column(f"{axis}_drive_{q}", np.negative)(r) for r in hemisphere()]
    with pytest.raises(DataError, match=f"one device.*the {q} of the {axis} drive columns look to have the wrong sign"):
        check_alike(all_wrong, hemisphere().factory["angular_gain_kappa"])


@pytest.mark.parametrize("axis", "xy")
def test_a_conjugate_pick_off_meets_the_same_reference(axis: str) -> None:
    """In volts it is next to nothing; but the reference stands off the resonance while that moves, and one axis turned the other way."""
    all_wrong = [column(f"{axis}_pick_s", np.negative)(r) for r in warmed_hemisphere()]
    with pytest.raises(DataError, match=f"one device.*the s of the {axis} pick-off columns look to have the wrong sign"):
        check_alike(all_wrong, warmed_hemisphere().factory["angular_gain_kappa"])
    check_alike(list(warmed_hemisphere()), warmed_hemisphere().factory["angular_gain_kappa"])


def test_a_warm_recording_has_signs_too_and_a_drive_that_another_damping_needs() -> None:
    gain = ring().factory["angular_gain_kappa"]

    def turned(r: Recording) -> Recording:
        return column("y_drive_c", np.negative)(column("y_drive_s", np.negative)(r))

    def damped(r: Recording) -> Recording:
        """What a damping twice as large when warm would take, nearly."""
        for name in COLUMNS[5:9]:
            r = column(name, lambda x: 2.0 * x)(r)
        return r

    with pytest.raises(DataError, match=r"thermal_y_hot.*sign of the y drive columns"):
        check_alike(changed("thermal_y_hot", turned), gain)
    check_alike(changed("thermal_x_hot", damped), gain)


def test_a_device_whose_columns_all_have_one_fault_is_told_which() -> None:
    """Conjugate envelopes were a table with the wrong sign, and a drive's swapped columns as well."""
    A, G = np.diag([-1.5 + 1j, -1.5 - 1j]), np.diag([-8j, -8.2j])
    recordings = list(ring())

    def refused(flow: np.ndarray, drive: np.ndarray, words: str) -> None:
        with pytest.raises(DataError, match=words):
            check_linear(Linear(flow, drive, np.zeros((2, 2), dtype=complex), 0.8, 0.0), {"rate_anti_re": -0.8}, recordings, 1.5)

    refused(-A.conj(), G, "s of all columns")
    refused(np.diag([1.5 + 1j, -1.5 - 1j]), np.diag([-8.0, -8.2j]), "quarter of a cycle.*x drive")
    refused(np.diag([1.5 + 1j, -1.5 - 1j]), G, "x mode must be damped")
    check_linear(Linear(A, G, np.zeros((2, 2), dtype=complex), 0.8, 0.0), {"rate_anti_re": 0.8}, recordings, 1.5)


def test_recordings_without_noise_are_said_to_be_no_device_s() -> None:
    """A packaged device without noise had four effects, each the order to which a model goes."""
    assert not any("no noise" in line for line in check_campaign(ring()))
    smooth = [replace(r, data=np.concatenate([r.data[:, :2], _smoothed(r.data[:, 2:10]), r.data[:, 10:]], axis=1)) for r in ring()]
    assert sum("no noise" in line for line in check_campaign(replace(ring(), recordings=tuple(smooth)))) == 1


def _smoothed(columns: np.ndarray) -> np.ndarray:
    """Their lowest lines."""
    lines = np.fft.rfft(columns, axis=0)
    lines[40:] = 0.0
    return np.fft.irfft(lines, len(columns), axis=0)


def test_a_recording_twice_is_named_though_its_clock_ran_on() -> None:
    again = column("t", lambda t: t + 1e4)(ring().recordings[4])
    with pytest.raises(DataError, match="Leave one of them out"):
        on_one_clock([*ring(), again])


def test_a_gyro_at_rest_is_not_shaken_and_unequal_pick_offs_are_no_modulation() -> None:
    rows = 3000
    data = np.zeros((rows, len(COLUMNS)))
    data[:, 0], data[:, COLUMNS.index("ref_freq")] = 1e-3 * np.arange(rows), 15e3
    data[:, 2:6] = 3e-6 * np.random.default_rng(1).standard_normal((rows, 4))
    check_commanded([*ring(), Recording("r", data, Command("loops_off"), 1000.0, "dark")], 1.5)
    unequal = []
    for r in hemisphere():
        held = r.data.copy()
        held[:, 4:6] *= 1.1
        unequal.append(replace(r, data=held))
    check_commanded(unequal, decay(hemisphere()))


def test_a_resonance_without_a_coefficient_is_no_wrong_temperature() -> None:
    """A warm wave stood elsewhere by its azimuth: that was the coefficient, of which another warm one knew nothing."""
    recordings = list(hemisphere())
    elsewhere, unmoved = [k for k, r in enumerate(recordings) if r.command.mode == "whole_angle"][:2]
    for k in (elsewhere, unmoved):
        recordings[k] = column("temperature", lambda t: t + 8.0)(recordings[k])
    recordings[elsewhere] = column("ref_freq", lambda f: 1.0001 * f)(recordings[elsewhere])
    check_one_device(recordings)


def test_what_takes_an_axis_away_mends_no_small_miss() -> None:
    """A base that swayed by 1e-3 rad/s was a pick-off in millivolts."""
    gain = hemisphere().factory["angular_gain_kappa"]
    label = next(r.label for r in hemisphere() if r.label.startswith("free"))

    def swaying(r: Recording) -> Recording:
        angle = 3e-3 * np.sin(2.0 * np.pi * 2.0 * r.t)
        turn = np.moveaxis(np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]), 2, 0)
        pick = np.einsum("nij,nj->ni", turn, r.pick)
        data = r.data.copy()
        data[:, 2:6] = np.stack([pick[:, 0].real, pick[:, 0].imag, pick[:, 1].real, pick[:, 1].imag], axis=1)
        return replace(r, data=data)

    check_alike(changed(label, swaying, hemisphere()), gain)


def test_equations_without_a_solution_are_refused_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*args: object, **kwargs: object) -> None:
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(sys.modules["gyro_calib.gap.diagnose"], "look_at", fails)
    with pytest.raises(DataError, match=r"no solution \(Singular matrix\).*few values"):
        diagnose(ring())


def test_a_recording_of_three_periods_of_its_side_band_has_quiet_lines() -> None:
    """Between its side bands there is nothing, and the diagnosis of a recording that was cut short ended in a traceback."""
    whole = next(r for r in ring() if r.label == "side_x_a1_1.5hz")
    for periods in (1.5, 2.5, 3.3, 20.0):
        rows = round(periods / whole.command.excitation.frequency_hz * whole.sample_rate_hz)
        cut = replace(whole, data=whole.data[:rows])
        lines = lines_of(cut, 0.0)
        assert lines.quiet
        busy = whole.command.excitation.frequency_hz * np.arange(1, 8)
        assert min(float(np.abs(busy - f).min()) for f in lines.quiet) > 1.6 / cut.duration_s
