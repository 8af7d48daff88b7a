"""Lines beside an open drive's own: a ripple of the supply is found with its frequency and size; no noise, tone or other mode is one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from table_samples import on_a_table, table_model

from gyro_calib.device import draw_unit, load_device
from gyro_calib.experiments import SimulatedInstrument
from gyro_calib.gap.diagnose import diagnose
from gyro_calib.gap.open_lines import OpenLine, find_open_line
from gyro_calib.gap.parts import Linear
from gyro_calib.recording.columns import COLUMNS
from gyro_calib.recording.command import Command, Excitation
from gyro_calib.recording.recording import Campaign, Recording
from gyro_calib.simulation import GyroSimulator

RIPPLE_HZ, SHARE = 37.5, 2e-4
ROW_S, ROWS, RESONANCE_HZ = 1e-3, 2000, 15033.0
#: of a quiet ring whose axes are unlike, about its resonance
LINEAR = Linear(np.array([[-1.5 + 2.0j, 0.3j], [0.3j, -1.6 - 2.0j]]), np.diag([-8.0j, -8.4j]), np.full((2, 2), 1e-6 + 2e-6j), 0.4, 0.0)
Rippling = Callable[[NDArray[np.float64], float], NDArray[np.complex128]]


def opened(rng: np.random.Generator, away_hz: float, axis: int, more: Rippling, force_hz: float | None = None) -> Recording:
    """An open drive's record of :data:`LINEAR`, integrated in steps of a tenth of a row, with noise of the pick-offs and of the force.

    ``more(t, phase)`` times the drive is what it has beside its command; a force at ``force_hz`` from the resonance acts on the axis.
    """
    t, fine = ROW_S * np.arange(ROWS), 0.1 * ROW_S
    fine_t = fine * np.arange(10 * ROWS)
    flow = LINEAR.A - 2j * np.pi * away_hz * np.eye(2)
    drive = np.zeros((10 * ROWS, 2), dtype=complex)
    drive[:, axis] = 2.0 * (1.0 + more(fine_t, rng.uniform(0.0, 6.28)))
    drive += 1e-6 * (rng.standard_normal((10 * ROWS, 2)) + 1j * rng.standard_normal((10 * ROWS, 2)))
    if force_hz is not None:
        drive[:, axis] += 2e-4 * np.exp(2j * np.pi * (force_hz - away_hz) * fine_t)
    values, vectors = np.linalg.eig(flow)
    # exact for a force that is constant over a step
    growth = np.exp(values * fine)
    force = (drive @ LINEAR.G.T) @ np.linalg.inv(vectors).T
    state, modes = 1e-3 * (rng.standard_normal(2) + 1j * rng.standard_normal(2)), np.empty((ROWS, 2), dtype=complex)
    for k in range(10 * ROWS):
        if k % 10 == 0:
            modes[k // 10] = state
        state = growth * state + (growth - 1.0) / values * force[k]
    command = np.zeros((ROWS, 2), dtype=complex)
    command[:, axis] = 2.0
    pick = modes @ vectors.T + command @ LINEAR.E.T + 2e-7 * (rng.standard_normal((ROWS, 2)) + 1j * rng.standard_normal((ROWS, 2)))
    hertz = RESONANCE_HZ + away_hz
    data = np.column_stack([t, np.ones(ROWS), pick.view(float), command.view(float), np.full(ROWS, hertz), np.full(ROWS, 25.0)])
    excitation = Excitation("drive", hertz, 0.0, 2.0, "xy"[axis])
    return Recording("r", data, Command("loops_off", excitation), 1.0 / ROW_S, f"open_{'xy'[axis]}_{away_hz:g}")


def ring(seed: int, more: Rippling = lambda t, phase: np.zeros(t.size, dtype=complex), force_hz: float | None = None) -> list[Recording]:
    """Eight open drives of a campaign."""
    rng = np.random.default_rng(seed)
    return [opened(rng, away_hz, axis, more, force_hz) for away_hz in (-60.0, -40.0, 40.0, 60.0) for axis in (0, 1)]


def found(recordings: list[Recording]) -> OpenLine | None:
    return find_open_line(recordings, LINEAR, 2.0 * np.pi * RESONANCE_HZ, 25.0)


def gain(share: float, frequency_hz: float = RIPPLE_HZ) -> Rippling:
    return lambda t, phase: share * np.cos(2.0 * np.pi * frequency_hz * t + phase) + 0j


@pytest.mark.parametrize("of_phase", [False, True])
@pytest.mark.parametrize("frequency_hz", [37.5, 50.0, 12.3])
def test_a_ripple_is_told_with_its_frequency_size_and_kind(frequency_hz: float, of_phase: bool) -> None:
    line = found(ring(1, gain((1j if of_phase else 1.0) * SHARE, frequency_hz)))  # type: ignore[arg-type]
    assert line is not None
    assert abs(line.frequency_hz - frequency_hz) < 4.0 * line.frequency_sd_hz < 0.2
    assert abs(line.share - SHARE) < 0.1 * SHARE
    assert line.of_phase in (of_phase, None)
    # a side band near the resonance is a hundred times louder than the other one, and tells which of the two kinds it is with that alone
    assert (line.of_phase is None) <= (abs(frequency_hz - 37.5) < 3.0)


def test_no_noise_is_a_line() -> None:
    assert [found(ring(seed)) for seed in range(12)] == [None] * 12


@pytest.mark.parametrize("force_hz", [3.7, 0.6, -22.0])
def test_what_keeps_its_own_frequency_is_none(force_hz: float) -> None:
    """A tone of vibration stands at another distance from each drive; one at 20 Hz from resonance would be two of them to one."""
    assert found(ring(2, force_hz=force_hz)) is None


def test_what_rings_freely_at_another_temperature_is_none() -> None:
    """Of hemispheres recorded warm, 5 Hz lower, it stood 58 Hz beside drives that are 60 Hz from the resonance at rest."""
    rng = np.random.default_rng(3)
    warm = []
    for k, r in enumerate(ring(3)[4:]):
        data, t = r.data.copy(), r.t[:, None]
        freely = 3e-3 * np.exp((2j * np.pi * (58.0 if k % 2 else -58.0) - 0.5) * t) * rng.uniform(0.5, 1.0, 2)
        data[:, 2:6] += freely.view(float)
        data[:, COLUMNS.index("temperature")] = 35.0
        warm.append(replace(r, data=data))
    assert found(ring(3)[:4] + warm) is None
    still_warm = [column_25(r) for r in warm]
    assert found(ring(3)[:4] + still_warm) is not None


def column_25(r: Recording) -> Recording:
    data = r.data.copy()
    data[:, COLUMNS.index("temperature")] = 25.0
    return replace(r, data=data)


def test_one_drive_alone_tells_nothing() -> None:
    recordings = ring(1, gain(SHARE))
    assert found([r for r in recordings if r.label.endswith("_40")]) is None
    assert found([]) is None


@cache
def rippling() -> Campaign:
    """The healthy ring of the table with a supply that ripples: at the carrier, as what the same drive does at its side bands."""
    campaign = on_a_table()
    device = draw_unit(load_device("ring_15k"), 5)
    instrument = SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(7), fidelity="carrier"))
    recordings = []
    for k, r in enumerate(campaign.recordings):
        if r.command.excitation.kind == "drive":
            more = np.zeros((len(r), 4))
            for side in (1.0, -1.0):
                excitation = replace(r.command.excitation, frequency_hz=r.command.excitation.frequency_hz + side * RIPPLE_HZ)
                instrument.configure(replace(r.command, excitation=excitation))
                beside = instrument.record(len(r) / r.sample_rate_hz, settle_s=1.0).pick
                t = r.t - r.t[0]
                turned = 0.5 * SHARE * np.exp(1j * side * (2.0 * np.pi * RIPPLE_HZ * t + 0.7 * k))
                more += (turned[:, None] * beside).view(float)
            data = r.data.copy()
            data[:, 2:6] += more
            r = replace(r, data=data)
        recordings.append(r)
    return replace(campaign, recordings=tuple(recordings))


def test_a_ripple_of_the_supply_is_unknown_with_its_form_and_its_absence_is_none() -> None:
    """At the carrier: the side bands are recorded, with the converters, settling and feedthrough that a drive has there."""
    model = table_model()
    line = find_open_line(rippling().recordings, model.linear, model.evidence.omega0_rad_s, model.evidence.temperature_degc)
    assert line is not None
    assert abs(line.frequency_hz - RIPPLE_HZ) < 4.0 * line.frequency_sd_hz < 0.3
    assert abs(line.share - SHARE) < 4.0 * line.share_sd < 0.5 * SHARE
    assert find_open_line(on_a_table().recordings, model.linear, model.evidence.omega0_rad_s, model.evidence.temperature_degc) is None
    unknown = diagnose(rippling()).unknown
    assert unknown is not None
    assert unknown.form.startswith("u times a gain")
    assert "37" in unknown.form
