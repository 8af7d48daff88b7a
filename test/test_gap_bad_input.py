"""Bad recordings are named in plain words before any verdict, by the command, with exit code 1."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import h5py
import numpy as np
import pytest
from bench_data import BENCH, needs_bench

from gyro_calib.cli.main import main
from gyro_calib.device import draw_unit, load_device
from gyro_calib.errors import DataError
from gyro_calib.experiments import SimulatedInstrument, gap_ftr_plan, run_plan
from gyro_calib.gap.diagnose import diagnose
from gyro_calib.gap.odd_one_out import check_alike
from gyro_calib.gap.one_axis import holding_gain
from gyro_calib.gap.parts import Linear
from gyro_calib.gap.preflight import check_campaign, check_linear, usable
from gyro_calib.recording import Campaign, Recording
from gyro_calib.recording.columns import COLUMNS
from gyro_calib.recording.hdf5 import write_campaign_h5
from gyro_calib.recording.load import load_campaign
from gyro_calib.simulation import GyroSimulator

STEPS = (
    *("static_x_0", "static_x_1", "static_x_2", "static_y_0", "static_y_1", "table_x", "table_y", "locate", "feed_x_+20hz", "feed_y_+20hz"),
    *("side_x_a1_0.5hz", "side_y_a1_0.5hz", "side_x_a1_1.5hz", "side_y_a1_1.5hz"),
    *("side_x_a0.6_0.5hz", "side_x_a1.4_0.5hz", "side_x_a1.4_1.5hz"),
)
PICKS, DRIVES = COLUMNS[2:6], COLUMNS[6:10]


def simulated(seed):
    unit = draw_unit(load_device("ring_15k"), seed)
    plan = gap_ftr_plan(unit.factory(), quality="quick", abilities=("applied_rate",))
    plan = replace(plan, steps=tuple(s for s in plan.steps if s.label in STEPS))
    return run_plan(SimulatedInstrument(GyroSimulator(unit, rng=np.random.default_rng(seed), fidelity="slow_flow"), 1e-4), plan)


@pytest.fixture(scope="session")
def campaign():
    """A small campaign without fault; every test spoils a copy of it in one way."""
    found = simulated(7)
    assert {r.label for r in found} == set(STEPS)
    return found


@pytest.fixture
def refusal(campaign, tmp_path, capsys):
    """What the command says of a spoilt copy of the campaign; it must refuse it."""

    def run(spoil: Callable[[Recording], Recording], without: tuple[str, ...] = ()) -> str:
        recordings = tuple(spoil(r) for r in campaign if not r.label.startswith(without or "-"))
        path = write_campaign_h5(tmp_path / "spoilt.h5", replace(campaign, recordings=recordings))
        return refused(capsys, path)

    return run


def refused(capsys, *arguments):
    code = main(["diagnose", *map(str, arguments)])
    out = capsys.readouterr()
    assert code == 1, out.out
    assert out.out == ""
    assert out.err.startswith("gyro-calib diagnose: ")
    return out.err


def scaled(columns, factor, only=""):
    """Spoil: columns times a factor."""

    def spoil(r):
        data = r.data.copy()
        data[:, [COLUMNS.index(name) for name in columns]] *= factor
        return replace(r, data=data) if r.label.startswith(only) else r

    return spoil


def swapped(columns):
    """Spoil: the first half of the columns in the place of the second."""

    def spoil(r):
        data, half = r.data.copy(), len(columns) // 2
        places = [COLUMNS.index(name) for name in columns]
        data[:, places] = r.data[:, places[half:] + places[:half]]
        return replace(r, data=data)

    return spoil


def of(label, change):
    """Spoil: one recording's command."""
    return lambda r: replace(r, command=change(r.command)) if r.label == label else r


def excited(label, **changes):
    return of(label, lambda command: replace(command, excitation=replace(command.excitation, **changes)))


# -- files ------------------------------------------------------------------------------------------------------------------------------


def test_two_devices_are_refused(campaign, tmp_path, capsys):
    first = write_campaign_h5(tmp_path / "a.h5", campaign)
    twin = Campaign("other", tuple(replace(r, device_id="other") for r in campaign), {**campaign.factory, "unit": "other"})
    text = refused(capsys, first, write_campaign_h5(tmp_path / "b.h5", twin))
    assert "one device" in text
    assert "'other'" in text


def test_a_missing_column_is_named(campaign, tmp_path, capsys):
    path = write_campaign_h5(tmp_path / "a.h5", campaign)
    with h5py.File(path, "r+") as file:
        del next(iter(file.values()))["y_drive_s"]
    assert "y_drive_s" in refused(capsys, path)


def test_factory_data_without_angular_gain_are_refused(campaign, tmp_path, capsys):
    factory = {key: value for key, value in campaign.factory.items() if key != "angular_gain_kappa"}
    assert "angular_gain_kappa" in refused(capsys, write_campaign_h5(tmp_path / "a.h5", replace(campaign, factory=factory)))


# -- columns ----------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (scaled(PICKS, 1e3), "looks like mV"),
        (scaled(("ref_freq",), 2.0 * math.pi), "looks like rad/s"),
        (scaled(DRIVES, 1e3), "looks like mV"),
        (scaled(DRIVES, 1e-3), "unit of the drive columns"),
        (swapped(PICKS), "Swap the axes"),
        (swapped(DRIVES), "Swap the drive columns"),
    ],
)
def test_wrong_units_and_swapped_axes(refusal, spoil, words):
    assert words in refusal(spoil)


def test_kelvins_are_recognised(refusal):
    def kelvins(r):
        data = r.data.copy()
        data[:, COLUMNS.index("temperature")] += 273.15
        return replace(r, data=data)

    assert "kelvins" in refusal(kelvins)


def test_a_clipped_channel_is_named(refusal):
    def clipped(r):
        data, k = r.data.copy(), COLUMNS.index("x_pick_c")
        data[:, k] = np.minimum(data[:, k], np.quantile(data[:, k], 0.6))
        return replace(r, data=data) if r.label == "side_x_a1_0.5hz" else r

    text = refusal(clipped)
    assert "x_pick_c" in text
    assert "clips" in text


def in_one(spoil: Callable[[Recording], Recording], label: str) -> Callable[[Recording], Recording]:
    """Spoil one recording of a campaign."""
    return lambda r: spoil(r) if r.label == label else r


@pytest.mark.parametrize("label", ["static_x_1", "side_y_a1_0.5hz"])
@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (scaled(DRIVES, -1.0), "sign of the"),
        (scaled((*PICKS[1::2], *DRIVES[1::2]), -1.0), "have the wrong sign"),
        (swapped(DRIVES), "drive columns of x and y look swapped"),
        (scaled(DRIVES, 1e-3), "kV"),
    ],
)
def test_one_recording_that_is_unlike_the_others_is_named(refusal, spoil, words, label):
    text = refusal(in_one(spoil, label))
    assert words in text
    assert repr(label) in text


@pytest.mark.parametrize("label", ["table_x", "table_y"])
@pytest.mark.parametrize(
    ("spoil", "words"), [(scaled(DRIVES, -1.0), "sign of the"), (swapped(DRIVES), "drive columns of x and y look swapped")]
)
def test_columns_of_one_turned_recording_are_told_from_its_log(refusal, spoil, words, label):
    """Drives that only a table moves the other recordings tell nothing of: one device for all says that they are wrong."""
    text = refusal(in_one(spoil, label))
    assert words in text
    assert repr(label) in text


def test_one_recording_that_alone_tells_a_part_of_the_device_is_not_unlike(campaign):
    """x with but one side band: the others tell its loss over its drive alone, and y's equations fit it once the axes are swapped."""
    labels = ("static_x_0", "static_x_1", "locate", "static_y_0", "static_y_1", "side_y_a1_0.5hz", "side_y_a1_1.5hz")
    for own in ("side_x_a1_0.5hz", "side_x_a1_1.5hz"):
        few = [r for r in campaign if r.label in (*labels, own)]
        assert len(few) == len(labels) + 1
        check_alike(few, campaign.factory["angular_gain_kappa"])


@pytest.mark.parametrize(("columns", "axis"), [(DRIVES[:2], "x"), (DRIVES[2:], "y"), (PICKS[2:], "y")])
def test_a_wrong_sign_is_named(refusal, columns, axis):
    text = refusal(scaled(columns, -1.0))
    assert "sign" in text
    assert f" {axis} " in text


def test_swapped_drives_show_without_open_drive(refusal):
    assert "look swapped" in refusal(swapped(DRIVES), without=("feed",))


# -- attributes -------------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (excited("side_x_a1_0.5hz", index=0.2), ("side_x_a1_0.5hz", "20 %")),
        (excited("side_y_a1_1.5hz", frequency_hz=1.1), ("side_y_a1_1.5hz", "1.1 Hz")),
        (of("side_x_a1_0.5hz", lambda c: replace(c, mode="ftr_y")), ("side_x_a1_0.5hz", "y pick-off")),
        (excited("feed_x_+20hz", axis="y"), ("feed_x_+20hz", "the other drive")),
        (excited("feed_x_+20hz", frequency_hz=15500.0), ("feed_x_+20hz", "ref_freq")),
        (excited("feed_y_+20hz", volts=0.01), ("feed_y_+20hz", "0.01")),
    ],
)
def test_attributes_that_contradict_the_data(refusal, spoil, words):
    text = refusal(spoil)
    for word in words:
        assert word in text


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (-1.0, "sign of applied_rate"),
        (math.pi / 180.0, "to be in rad/s where deg/s is said. Correct its unit"),
        (180.0 / math.pi, "to be in deg/s where rad/s is said"),
    ],
)
def test_a_rate_that_the_wave_did_not_follow(refusal, factor, words):
    def spoil(r):
        if "applied_rate" not in r.extras:
            return r
        said = dict(r.extras["applied_rate"])
        said["deg_s"] = [factor * rate for rate in said["deg_s"]]
        return replace(r, extras={**r.extras, "applied_rate": said})

    assert words in refusal(spoil)


def test_two_steady_recordings_are_too_few_not_swapped(campaign):
    """Nothing tells a drive's gain from the damping there: both come out as next to nothing, the cross terms, too."""
    axes = {r.command.oscillator_axis: r for r in campaign if r.label.startswith("static")}
    assert set(axes) == {"x", "y"}
    assert diagnose(replace(campaign, recordings=tuple(axes.values()))).verdict == "not_testable"


def test_loops_off_alone_is_no_campaign(refusal):
    assert "loops closed" in refusal(lambda r: r, without=("static", "side", "table", "locate"))


# -- what is used in spite of it ----------------------------------------------------------------------------------------------------------


def test_a_recording_cut_short_is_a_warning(campaign):
    cut = tuple(replace(r, data=r.data[: len(r) // 3]) if r.label == "side_x_a1.4_1.5hz" else r for r in campaign)
    (warning,) = check_campaign(replace(campaign, recordings=cut))
    assert warning.startswith("side_x_a1.4_1.5hz is cut short: 1.33 s where 4 s")
    assert check_campaign(campaign) == []


# -- another plant's recordings ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="session")
def bench():
    return load_campaign(BENCH / "ring_a.h5")


@needs_bench
@pytest.mark.parametrize("kind", ["amplitude_modulation", "drive"])
def test_spoilt_attributes_of_another_plant(bench, kind):
    first = next(r for r in bench if r.command.excitation.kind == kind)
    change = {"frequency_hz": 3.0 * first.command.excitation.frequency_hz}
    spoilt = replace(bench, recordings=tuple(excited(first.label, **change)(r) for r in bench))
    with pytest.raises(DataError, match=f"Recording {first.label!r} says"):
        diagnose(spoilt)


@needs_bench
def test_another_plants_recordings_pass(bench):
    assert check_campaign(bench) == []


def test_a_loop_too_slow_for_its_side_band_is_no_wrong_attribute(campaign):
    """The set point is modulated, and the columns hold what the loop makes of it: the same in all recordings of one frequency."""
    stated = {"side_x_a1_1.5hz": 0.24, "side_y_a1_1.5hz": 0.24, "side_x_a1.4_1.5hz": 0.24}
    slow = tuple(excited(r.label, index=stated[r.label])(r) if r.label in stated else r for r in campaign)
    assert check_campaign(replace(campaign, recordings=slow)) == []
    alone = tuple(excited(r.label, index=0.24)(r) if r.label == "side_x_a1_1.5hz" else r for r in campaign)
    with pytest.raises(DataError, match="modulated by 24 %"):
        check_campaign(replace(campaign, recordings=alone))


def test_recordings_that_are_not_used_are_named(campaign):
    short = tuple(replace(r, data=r.data[:150]) if r.label in ("static_x_0", "locate") else r for r in campaign)
    assert any(
        w.startswith("Not used, for they hold fewer than 200 rows: ") and "static_x_0 (150)" in w and "locate (150)" in w
        for w in check_campaign(replace(campaign, recordings=short))
    )


@pytest.mark.parametrize("label", ["static_x_0", "side_y_a1_1.5hz"])
def test_a_reference_that_slips_half_a_cycle_takes_its_recording_away(campaign, label) -> None:
    """A ring of a twenty-ninth plant: its wave was at -1 V for six seconds of ten, and the noise of what turns a million times too loud."""

    def slipped(r: Recording) -> Recording:
        data = r.data.copy()
        data[: len(data) // 3, 2:10] *= -1.0
        return replace(r, data=data)

    assert len(usable(campaign)) == len(campaign)
    spoilt = replace(campaign, recordings=tuple(slipped(r) if r.label == label else r for r in campaign))
    assert {r.label for r in spoilt} - {r.label for r in usable(spoilt)} == {label}
    (said,) = check_campaign(spoilt)
    assert said.startswith("Not used, for the wave is held on both sides of its axis")
    assert label in said


def test_a_drive_that_little_is_told_of_has_no_sign(campaign) -> None:
    """Eight recordings, one of them on y: its drive's gain came out as a tenth of what holds a wave, in any phase."""
    recordings = usable(campaign)
    held = holding_gain(recordings, 1.5)

    def device(of_y: complex) -> Linear:
        return Linear(-1.5 * np.eye(2) + 0j, np.diag([-1j * held, of_y * held]), np.zeros((2, 2), complex), 0.8, 0.0)

    check_linear(device(0.1j), {}, recordings, 1.5)
    with pytest.raises(DataError, match="A positive y drive must push y"):
        check_linear(device(1j), {}, recordings, 1.5)
    # and one that the fit hardly knows points anywhere: -3.5 - 2.1i of a sd of 1.2
    check_linear(device(1j), {}, recordings, 1.5, (0.0, 0.3 * held))
    check_linear(device(1.0), {}, recordings, 1.5, (0.0, 0.3 * held))
