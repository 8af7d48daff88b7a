"""What only turned recordings show must have to do with rate: a table does things besides its log."""

from __future__ import annotations

from dataclasses import replace

from table_samples import looked_at, loudest, on_a_table

from gyro_calib.effects import EFFECTS
from gyro_calib.gap.select import seen_at_rest, select_effects
from gyro_calib.recording.applied_rate import is_turned
from gyro_calib.recording.columns import COLUMNS
from gyro_calib.recording.recording import Recording

DRIVES = [COLUMNS.index(f"x_drive_{part}") for part in "cs"]


def drive_logged_too_large(recording: Recording) -> Recording:
    """3 % too large on x."""
    rows = recording.data.copy()
    rows[:, DRIVES] *= 1.03
    return replace(recording, data=rows)


def test_an_effect_of_all_recordings_counts_without_the_turned_ones() -> None:
    model = looked_at(on_a_table(c=3e-4))
    whole = loudest(model, "nonlinear_damping")
    still = model.at_rest(whole, ())
    assert still is not None
    assert 0.5 * whole.gain < still.gain < whole.gain
    assert seen_at_rest(model, [whole], whole)


def test_what_only_the_table_shows_is_no_effect_of_a_device_at_rest() -> None:
    healthy = on_a_table()
    assert any(is_turned(r) for r in healthy)
    model = looked_at(replace(healthy, recordings=tuple(drive_logged_too_large(r) if is_turned(r) else r for r in healthy)))
    shown = loudest(model, "angular_gain_error")
    assert shown.log_evidence > 20.0
    assert seen_at_rest(model, [shown], shown)
    # the same signal under the name of an effect that would be there at rest too
    at_rest = replace(shown, candidate=replace(shown.candidate, name="nonlinear_damping"))
    assert not seen_at_rest(model, [at_rest], at_rest)
    assert all("rate" in EFFECTS[e.name].needs for e in select_effects(model).effects)
