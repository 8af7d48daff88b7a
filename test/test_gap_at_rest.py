"""What only turned recordings show must have to do with rate: a table does things besides its log."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from table_samples import looked_at, loudest, on_a_table

from gyro_calib.device import draw_unit, load_device
from gyro_calib.effects import EFFECTS
from gyro_calib.experiments import SimulatedInstrument, gap_ftr_plan, run_plan
from gyro_calib.gap import diagnose
from gyro_calib.gap.at_rest import seen_at_rest
from gyro_calib.gap.select import select_effects
from gyro_calib.recording.applied_rate import is_turned
from gyro_calib.recording.columns import COLUMNS
from gyro_calib.recording.recording import Campaign, Recording
from gyro_calib.simulation import GyroSimulator

LEANS_RAD_S_V2 = 3e-4

DRIVES = [COLUMNS.index(f"x_drive_{part}") for part in "cs"]


def drive_logged_too_large(recording: Recording) -> Recording:
    """3 % too large on x."""
    rows = recording.data.copy()
    rows[:, DRIVES] *= 1.03
    return replace(recording, data=rows)


@pytest.mark.slow
def test_an_effect_of_all_recordings_counts_without_the_turned_ones() -> None:
    model = looked_at(on_a_table("nonlinear_damping", c=3e-4))
    whole = loudest(model, "nonlinear_damping")
    still = model.at_rest(whole, ())
    assert still is not None
    assert 0.5 * whole.gain < still.gain < whole.gain
    # of the size that all recordings say those that stood still are the better for it, by hardly less than of their own
    assert 0.9 * still.gain < model.taken_at_rest(whole, ()) <= still.gain
    assert seen_at_rest(model, [whole], whole)


@pytest.mark.slow
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
    assert model.taken_at_rest(at_rest, ()) < 1.0
    assert all("rate" in EFFECTS[e.name].needs for e in select_effects(model).effects)


class Leaning(SimulatedInstrument):
    """A unit whose bias goes with the square of its amplitude: simulated as a base that turns as a healthy unit's amplitude has it."""

    def __init__(self, simulator: GyroSimulator, healthy: Campaign) -> None:
        super().__init__(simulator)
        self._healthy = iter(healthy)

    def record(self, *args: Any, **more: Any) -> Recording:
        pick = next(self._healthy).pick
        self._bias_rad_s = LEANS_RAD_S_V2 * np.sum(np.abs(pick) ** 2, axis=1)
        self._rate = float(self._bias_rad_s[0])
        return super().record(*args, **more)

    def _turned(self, duration_s: float, label: str, extras: dict[str, Any]) -> NDArray[np.float64]:
        return super()._turned(duration_s, label, extras) + self._bias_rad_s - self._rate


@pytest.mark.slow
def test_a_bias_that_goes_with_the_amplitude_is_unknown_in_the_dynamics() -> None:
    device = draw_unit(load_device("ring_15k"), 5)
    plan = gap_ftr_plan(device.factory(), quality="quick")

    def gyro() -> GyroSimulator:
        return GyroSimulator(device, rng=np.random.default_rng(3), fidelity="carrier")

    found = diagnose(run_plan(Leaning(gyro(), run_plan(SimulatedInstrument(gyro()), plan)), plan))
    assert found.verdict == "unknown"
    assert found.unknown is not None
    assert (found.unknown.location, found.unknown.phase) == ("dynamics", "in phase")
    # of a loop that holds its amplitude the drive goes with it
    assert found.unknown.form in ("|x|^2 x, crossed", "|u|^2 x, u the drives, crossed")
    # the term takes what the names leave
    assert found.chi2_after - found.unknown.gain < 1.1 * found.dof
