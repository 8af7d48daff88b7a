"""Every way a recording can be bad is refused by its own message: what, where, which value, what to do."""

from __future__ import annotations

import time

import numpy as np
import pytest
from recording_samples import FACTORY, make_recording, make_rows

from gyro_calib.errors import DataError
from gyro_calib.recording import COLUMNS, Command, Excitation, Setpoints, check_rows, validate


def column(name: str) -> int:
    return COLUMNS.index(name)


def spoiled(change) -> object:
    rows = make_rows()
    changed = change(rows)
    return make_recording(rows if changed is None else changed)


def set_at(name, sample, value):
    def change(rows):
        rows[sample, column(name)] = value

    return change


def freeze(name, start, count):
    def change(rows):
        rows[start : start + count, column(name)] = rows[start, column(name)]

    return change


def scale(factor, *names):
    def change(rows):
        for name in names:
            rows[:, column(name)] *= factor

    return change


def repeat_values(rows):
    rows[1000:1100, 2:10] = rows[500:600, 2:10]


def swap_axes(rows):
    rows[:, 2:6] = rows[:, [4, 5, 2, 3]]


PICKS = ("x_pick_c", "x_pick_s", "y_pick_c", "y_pick_s")


def flat_top(rows):
    rows[:, column("y_drive_s")] += np.sin(np.arange(len(rows)) / 30)
    rows[:, column("y_drive_s")] = np.minimum(rows[:, column("y_drive_s")], 0.8)


BAD = {
    "nan": (set_at("x_pick_s", 700, np.nan), r"Column x_pick_s .*'static' must be finite, but got nan at sample 700 \(t = 0.7 s\)"),
    "infinity": (set_at("temperature", 3, -np.inf), r"temperature .*must be finite, but got -inf at sample 3"),
    "nan in time": (set_at("t", 12, np.nan), r"Column t .*must be finite, but got nan at sample 12, 1 such"),
    "gap": (lambda r: np.delete(r, slice(600, 650), axis=0), r"gap of 0.051 s before sample 600 \(t = 0.65 s\): 50 samples are missing"),
    "repeated row": (lambda r: np.insert(r, 901, r[900], axis=0), r"but got 0 s before sample 901 \(t = 0.9 s\): a row is repeated"),
    "repeated block": (
        lambda r: np.insert(r, 500, r[400:500], axis=0),
        r"step back of 0.099 s at sample 500 \(t = 0.4 s\): a block is rep",
    ),
    "time runs back": (lambda r: r[::-1], r"must advance by 0.001 s a sample, but got a step back"),
    "milliseconds": (scale(1e3, "t"), r"Column t .*must be in seconds, but got steps of 1 .*milliseconds. Divide t by 1000"),
    "microseconds": (scale(1e6, "t"), r"looks like microseconds"),
    "wrong rate": (scale(1.02, "t"), r"Sample rate .*must agree with t, but got 1000 Hz stated and 980.392 Hz"),
    "segment changes": (lambda r: r.__setitem__((slice(800, None), 1), 1.0), r"but got 0 and then 1 at sample 800 .*Split the recording"),
    "adc clips": (set_at("x_pick_c", 77, 2.6), r"x_pick .*full scale of 2.5 V \(adc_full_scale_V\), but got 2.6 V at sample 77"),
    "dac clips": (set_at("y_drive_s", 78, -5.0), r"y_drive .*full scale of 5 V \(dac_full_scale_V\), but got 5 V at sample 78"),
    "flat top": (flat_top, r"Column y_drive_s .*must not sit at its extreme, but got \d+ samples of exactly 0.8 V"),
    "frozen": (freeze("y_pick_c", 300, 40), r"Column y_pick_c .*but got 40 equal samples of .* V from sample 300 \(t = 0.3 s\): .*frozen"),
    "dead": (scale(0.0, "y_pick_c", "y_pick_s"), r"Channel y_pick .*but got 0 V in all 2000 samples .*dead"),
    "repeated values": (repeat_values, r"must not repeat, but got 100 rows from sample 1000 .*already stood at sample 500"),
    "rad/s": (
        scale(2 * np.pi, "ref_freq"),
        r"ref_freq .*near the nominal 15000 Hz, but got 94128.* It looks like rad/s. Divide it by 2 pi",
    ),
    "kHz": (scale(1e-3, "ref_freq"), r"looks like kHz"),
    "other unit's frequency": (scale(0.4, "ref_freq"), r"Check that the factory data are this unit's"),
    "kelvins": (lambda r: r.__setitem__((slice(None), 11), 298.15), r"must be in degC, but got 298.15 .*kelvins"),
    "swapped axes": (swap_axes, r"Mode ftr_x .*on the x pick-off, but got .* V on x and 1 V on y .*Swap the axes"),
    "wrong amplitude": (scale(0.5, *PICKS), r"near its set point of 1 V, but got 0.5 .*Correct the set point"),
    "rms": (scale(np.sqrt(0.5), *PICKS), r"rms volts"),
    "one row": (lambda r: r[:1], r"must have at least 2 samples, but got 1"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_recording_is_refused_with_sample_value_and_remedy(name):
    change, message = BAD[name]
    recording = spoiled(change)
    with pytest.raises(DataError, match=message):
        validate(recording, FACTORY)


def test_a_drive_of_nothing_is_in_its_dead_zone_and_not_at_an_end_of_its_range():
    def dead(rows):
        rows[:, column("y_drive_s")] = np.maximum(rows[:, column("y_drive_s")] - rows[:, column("y_drive_s")].mean(), 0.0)
        rows[300:500, column("y_drive_s")] = 0.0

    recording = spoiled(dead)
    assert np.count_nonzero(recording.column("y_drive_s") == 0.0) > 200
    validate(recording, FACTORY)


def test_millivolts_are_recognised():
    with pytest.raises(DataError, match=r"but got 1000 .*looks like mV: divide the pick-off columns by 1000"):
        validate(spoiled(scale(1e3, *PICKS)), {"nominal_f0_hz": 15000.0})


def test_a_set_point_in_millivolts_is_not_a_pick_off_in_kilovolts():
    with pytest.raises(DataError, match=r"near its set point of 1000 V, but got 1 .*The set point looks like mV: divide it by 1000"):
        validate(make_recording(make_rows(), Command("ftr_x", setpoints=Setpoints(amplitude_v=1000.0))), FACTORY)


def noisy_rows():
    rows = make_rows()
    rows[:, 2:10] += 1e-4 * np.random.default_rng(5).standard_normal((len(rows), 8))
    return rows


def test_a_noisy_channel_that_clips_comes_to_one_value_again_and_again():
    """No run of them was eight long, and a healthy ring had another mode 10 Hz away."""
    rows = noisy_rows()
    validate(make_recording(rows, Command("ftr_x")), FACTORY)
    k = column("y_drive_s")
    rows[:, k] = np.minimum(rows[:, k], np.quantile(rows[:, k], 0.7))
    with pytest.raises(DataError, match=r"y_drive_s.*must not sit at its extreme.*no other value more than"):
        validate(make_recording(rows, Command("ftr_x")), FACTORY)
    # the steps of a coarse converter are no clipping
    rows[:, k] = np.round(noisy_rows()[:, k] / 5e-5) * 5e-5
    validate(make_recording(rows, Command("ftr_x")), FACTORY)


def test_one_quadrature_that_never_moves_is_frozen():
    rows = noisy_rows()
    rows[:, column("x_pick_s")] = -1.4e-4
    with pytest.raises(DataError, match=r"x_pick_s.*in all \d+ samples.*frozen"):
        validate(make_recording(rows, Command("ftr_x")), FACTORY)


@pytest.mark.parametrize("mode", ["ftr_x", "ftr_y"])
@pytest.mark.parametrize("factory", [None, FACTORY])
def test_good_recording_passes(mode, factory):
    validate(make_recording(make_rows(mode=mode), Command(mode)), factory)


def test_half_a_period_of_deep_modulation_is_not_a_wrong_unit():
    rows = make_rows()
    rows[:, column("x_pick_c")] *= 1.0 + 0.2 * np.sin(2 * np.pi * 0.25 * rows[:, 0])
    validate(make_recording(rows, Command("ftr_x", Excitation("amplitude_modulation", 0.25, 0.2))), FACTORY)
    with pytest.raises(DataError, match="set point"):
        validate(make_recording(rows, Command("ftr_x", setpoints=Setpoints(amplitude_v=2.0))), FACTORY)


def test_noise_free_convergence_is_neither_frozen_nor_repeated():
    rows = make_rows()
    rows[:, 2:10] = 0.0
    rows[:, column("x_pick_c")] = 1.0
    rows[:, column("y_pick_s")] = 1e-3 * np.exp(-np.arange(len(rows)) / 20.0)
    rows[600:, column("y_pick_s")] = rows[600, column("y_pick_s")]
    validate(make_recording(rows), FACTORY)


@pytest.mark.parametrize(("bursts", "fine"), [(12, True), (1, False)])
def test_an_axis_below_half_a_step_of_its_converter_is_not_frozen(bursts, fine):
    """It reads nothing, but where the noise takes it over the half, again and again; a cable that broke came back once."""
    rows = make_rows()
    still = slice(100, 1900)
    rows[still, column("y_pick_c")] = rows[still, column("y_pick_s")] = 0.0
    for start in np.linspace(150, 1800, bursts, dtype=int):
        rows[start : start + 5, column("y_pick_c")] = 1e-5
    if fine:
        validate(make_recording(rows), FACTORY)
    else:
        with pytest.raises(DataError, match=r"y_pick_[cs] .*frozen"):
            validate(make_recording(rows), FACTORY)


def test_open_drive_may_be_constant():
    rows = make_rows()
    rows[:, 6:10] = 0.0
    rows[:, column("x_drive_c")] = 2.0
    rows[:, 2] -= 0.95
    validate(make_recording(rows, Command("loops_off", Excitation("drive", 14921.0, volts=2.0))), FACTORY)


@pytest.mark.parametrize(
    ("change", "previous_t", "message"),
    [
        (set_at("y_pick_c", 5, np.nan), None, r"Column y_pick_c of the live block must be finite, but got nan at sample 5"),
        (lambda r: np.delete(r, 50, axis=0), None, r"gap of 0.002 s before sample 50 \(t = 0.051 s\): 1 samples"),
        (lambda r: None, -0.051, r"gap of 0.051 s before sample 0 \(t = 0 s\): 50 samples are missing"),
        (lambda r: None, 0.099, r"step back of 0.099 s at sample 0"),
        (lambda r: None, 0.0, r"but got 0 s before sample 0 .*repeated"),
        (lambda r: r[:0], None, r"shape \(n, 12\) with n >= 1, but got \(0, 12\)"),
        (lambda r: r[:, :11], None, r"but got \(100, 11\)"),
    ],
)
def test_bad_live_block_is_refused(change, previous_t, message):
    rows = make_rows(100)
    changed = change(rows)
    with pytest.raises(DataError, match=message):
        check_rows(rows if changed is None else changed, 1000.0, previous_t)


def test_live_blocks_in_sequence_pass():
    rows, last = make_rows(1000, start_s=5000.0), None
    for block in np.split(rows, 10):
        last = check_rows(block, 1000.0, last)
    assert last == rows[-1, 0]


def test_live_check_keeps_up_with_any_stream():
    rows = make_rows(100)
    check_rows(rows, 1000.0, -0.001)
    start = time.perf_counter()
    for _ in range(200):
        check_rows(rows, 1000.0, -0.001)
    device_s = 200 * len(rows) / 1000.0
    assert time.perf_counter() - start < 0.1 * device_s


def test_a_drive_that_never_moves_with_its_loop_closed_is_frozen_and_one_that_is_rounded_is_not():
    rows = noisy_rows()
    rows[:, column("x_drive_s")] = 0.17
    with pytest.raises(DataError, match=r"x_drive_s.*in all \d+ samples.*frozen"):
        validate(make_recording(rows, Command("ftr_x")), FACTORY)
    rows = noisy_rows()
    rows[:, 2:10] = np.round(rows[:, 2:10] / 3e-4) * 3e-4
    validate(make_recording(rows, Command("ftr_x")), FACTORY)
