"""What feeds through and is not in proportion to the drive: nothing of the catalogue, and told as what it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from table_samples import looked_at, on_a_table

from gyro_calib.device import draw_unit, load_device
from gyro_calib.experiments import SimulatedInstrument, gap_ftr_plan, run_plan
from gyro_calib.gap import diagnose
from gyro_calib.gap.relinearise import relinearised
from gyro_calib.recording.columns import column_index
from gyro_calib.recording.recording import Campaign, Recording
from gyro_calib.simulation import GyroSimulator
from gyro_calib.trial.plans import campaign_plan
from gyro_calib.trial.plant import record_unit
from gyro_calib.trial.units import draw_trial_unit

ComplexArray = NDArray[np.complex128]


def read_with(campaign: Campaign, added: list[ComplexArray]) -> Campaign:
    """The campaign with volts (n, 2) added to what the pick-offs read, recording by recording."""
    found = []
    for r, volts in zip(campaign, added, strict=True):
        data = r.data.copy()
        for axis, letter in enumerate("xy"):
            data[:, column_index(f"{letter}_pick_c")] += volts[:, axis].real
            data[:, column_index(f"{letter}_pick_s")] += volts[:, axis].imag
        found.append(replace(r, data=data))
    return replace(campaign, recordings=tuple(found))


def moved(r: Recording) -> ComplexArray:
    return np.asarray(np.sum(np.abs(r.pick) ** 2, axis=1)[:, None] * r.drive)


def bent(r: Recording) -> ComplexArray:
    return np.asarray(np.abs(r.drive) ** 2 * r.drive)


def of_the_reference(r: Recording) -> ComplexArray:
    return np.full((len(r), 2), (0.6 + 0.8j, -0.8 + 0.6j))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "volts", "form"),
    [
        (3e-4, moved, "|p|^2 u, p the motion, u the drives"),
        (5e-4, bent, "u the drives"),
        (3e-4, of_the_reference, "a constant"),
    ],
    ids=["a stray capacitance that moves", "a varactor", "the reference, of any phase"],
)
def test_what_feeds_through_out_of_proportion_is_unknown(share: float, volts: object, form: str) -> None:
    campaign = on_a_table()
    # the catalogue has a name for the reference in a pick-off
    verdict = diagnose(read_with(campaign, [share * volts(r) for r in campaign]), without=("pickoff_interference",))  # type: ignore[operator]
    assert verdict.verdict == "unknown"
    assert verdict.unknown is not None
    assert verdict.unknown.location == "pick-off"
    assert form in verdict.unknown.form


@pytest.mark.slow
def test_each_axis_of_a_hemisphere_feeds_through_by_its_own_motion_and_at_its_own_phase() -> None:
    """A drive late by 0.4 rad: a stiffness by the drives and a damping of the amplitude's square explained most of it together."""
    unit, rng = draw_trial_unit("hemisphere", 79, 1), np.random.default_rng(1)
    campaign = record_unit(unit, campaign_plan("hemisphere", unit.device.factory(), rng, "quick"), {}, rng)
    volts = [4e-6 * np.exp(-0.4j) * np.abs(r.pick) ** 2 * r.drive for r in campaign]
    verdict = diagnose(read_with(campaign, volts))
    assert verdict.verdict == "unknown"
    assert verdict.unknown is not None
    assert (verdict.unknown.location, verdict.unknown.phase) == ("pick-off", "of any phase")
    assert "u_j, " in verdict.unknown.form


def with_hot_open_drives() -> Campaign:
    """A ring whose open drives are recorded at two temperatures."""
    device = draw_unit(load_device("ring_15k"), 5)
    instrument = SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(3), fidelity="carrier"), 2e-5)
    return run_plan(instrument, gap_ftr_plan(device.factory(), quality="quick", abilities=("temperature",)))


@pytest.mark.slow
def test_a_feedthrough_by_warmth_that_was_found_alone_is_formed_anew() -> None:
    """What may come with it has no size then: that ended a diagnosis with a KeyError."""
    model = looked_at(with_hot_open_drives())
    (alone,) = model.candidates["thermal_feedthrough"]
    (again,) = relinearised(model, [alone])
    assert [c.name for c in alone.columns] == ["e_x", "e_y"]
    assert {"e_x", "e_y", "skew_late_x"} <= {c.name for c in again.columns}


@pytest.mark.slow
def test_a_feedthrough_that_grows_with_warmth_as_a_whole_has_its_name() -> None:
    """Through any element and at any phase: what the catalogue's form has beside it is no noise of the hot open drives."""
    campaign = with_hot_open_drives()
    grown = np.array([[-1.0 - 0.3j, -0.7 - 0.4j], [0.1, 0.2 - 0.3j]]) * 2e-6
    volts = [(r.data[:, column_index("temperature")] - 25.0)[:, None] * (r.drive @ grown.T) for r in campaign]
    verdict = diagnose(read_with(campaign, volts))
    assert [e.name for e in verdict.effects] == ["thermal_feedthrough"]
    assert verdict.unknown is None
    size = verdict.effects[0].parameters["e_x"]
    assert abs(size.value + 2e-6) < 3.0 * size.sd + 1e-7
