"""A pick-off's gain with a 1/f floor: what it brings to the equations, its size from a campaign, and what no longer hides in it."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from table_samples import looked_at

from gyro_calib.gap.evidence import CampaignEvidence
from gyro_calib.gap.model import CampaignModel
from gyro_calib.gap.noise_law import NoiseLaw, beside_floors, fit_law, gain_floors
from gyro_calib.gap.preflight import usable
from gyro_calib.recording.columns import column_index
from gyro_calib.recording.recording import Campaign, Recording
from gyro_calib.trial.plans import campaign_plan
from gyro_calib.trial.plant import record_unit
from gyro_calib.trial.units import draw_trial_unit

#: density of the y pick-off's gain at 1 Hz [1/sqrt(Hz)], about that of the practice devices
FLOOR = 3e-6


def flickering(rng: np.random.Generator, rows: int, rate_hz: float, slowest_hz: float) -> NDArray[np.float64]:
    """A noise of density 1/f from ``slowest_hz`` on, drawn frequency by frequency over eight times as long."""
    whole = 8 * rows
    f = np.fft.rfftfreq(whole, 1.0 / rate_hz)
    size = np.where(f >= slowest_hz, np.sqrt(whole * rate_hz / (2.0 * np.maximum(f, slowest_hz))), 0.0)
    drawn = size * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size)) / math.sqrt(2.0)
    start = int(rng.integers(0, whole - rows))
    return np.asarray(np.fft.irfft(drawn, whole)[start : start + rows])


def read_by(r: Recording, gain: NDArray[np.float64]) -> Recording:
    """The recording as a y pick-off of that relative gain reads it."""
    data = r.data.copy()
    for part in "cs":
        data[:, column_index(f"y_pick_{part}")] *= 1.0 + gain
    return replace(r, data=data)


@cache
def quick_hemisphere() -> Campaign:
    unit, rng = draw_trial_unit("hemisphere", 79, 1), np.random.default_rng(1)
    return record_unit(unit, campaign_plan("hemisphere", unit.device.factory(), rng, "quick"), {}, rng)


@cache
def hemisphere(floor: float) -> CampaignModel:
    return looked_at(with_floor(quick_hemisphere(), floor))


def with_floor(campaign: Campaign, floor: float) -> Campaign:
    draw = np.random.default_rng(5)
    gains = [floor * flickering(draw, len(r.data), r.sample_rate_hz, 0.5 / r.duration_s) for r in campaign]
    return replace(campaign, recordings=tuple(read_by(r, g) for r, g in zip(campaign, gains, strict=True)))


def test_a_floor_of_a_gain_is_what_its_noise_brings_to_the_equations_of_a_wave_that_turns() -> None:
    """Drawn row by row, through L: amplitude and precession hear it as far as the wave is on y."""
    rng, found = np.random.default_rng(4), []
    campaign = quick_hemisphere()
    f = campaign.factory
    evidence = CampaignEvidence.of(usable(campaign), math.pi * f["nominal_f0_hz"] / f["nominal_q"])
    turning = [r for r in evidence if r.is_wave and r.signal.turn_rad > math.pi][:1]
    assert turning
    for r in turning:
        s = r.signals
        drawn = [flickering(rng, s.time_s.size, 1.0 / s.row_s, 0.5 / (s.row_s * s.time_s.size)) for _ in range(200)]
        seen = np.real(r.turn * r.signal_forms.through_flow([g[:, None] * s.pick * np.array([0.0, 1.0]) for g in drawn]))
        count = len(seen) // 2
        for channel, side in (("amplitude", slice(0, count)), ("precession", slice(count, None))):
            told = NoiseLaw((1e-22, 0.0, 0.0, 0.0), floors=(0.0, 1.0)).covariance(r.lines(channel), r.grams)
            ratio = np.mean(seen[side] ** 2, axis=1) / np.diag(told)
            # half-cosines of a record are nearly what a stationary noise has there
            assert np.median(ratio) == pytest.approx(1.0, abs=0.15)
            # beside noise of its own, as every kind of record has it
            own = 0.1 * float(np.median(np.diag(told)))
            heard = seen[side] + math.sqrt(own) * np.linalg.cholesky(r.grams.value) @ rng.standard_normal((count, len(drawn)))
            told = NoiseLaw((own, 0.0, 0.0, 0.0), floors=(0.0, 1.0)).covariance(r.lines(channel), r.grams)
            found.append(np.mean(np.linalg.solve(np.linalg.cholesky(told), heard) ** 2))
    assert np.mean(found) == pytest.approx(1.0, abs=0.2)


@pytest.mark.slow
def test_a_campaign_tells_the_floor_of_each_gain() -> None:
    quiet, loud = (
        {law.floors for (_, channel), law in hemisphere(floor).noise.items() if channel == "amplitude"} for floor in (0.0, FLOOR)
    )
    assert max(math.sqrt(g) for gains in quiet for g in gains) < 0.1 * FLOOR
    assert max(math.sqrt(x) for x, _ in loud) < 0.2 * FLOOR
    assert float(np.median([math.sqrt(y) for _, y in loud])) == pytest.approx(FLOOR, rel=0.2)


@pytest.mark.slow
def test_beside_a_floor_a_wave_on_the_other_axis_is_as_quiet_as_it_was() -> None:
    """The floor of y was white noise of every record of its kind, on whichever axis."""
    told = {}
    for floor in (0.0, FLOOR):
        model = hemisphere(floor)
        for r in model.evidence:
            if r.recording.command.mode == "whole_angle" and r.signal.turn_rad < 0.1:
                on_x = np.abs(r.signals.pick[:, 0]).mean() > 30.0 * np.abs(r.signals.pick[:, 1]).mean()
                lines = r.lines("amplitude")
                told.setdefault((floor, bool(on_x)), []).append(float(np.median(model.noise[r.noise_key("amplitude")].density(lines))))
    assert np.median(told[FLOOR, True]) < 3.0 * np.median(told[0.0, True])
    assert np.median(told[FLOOR, False]) > 10.0 * np.median(told[0.0, False])


def test_floors_are_of_one_size_in_all_kinds_and_none_is_seen_where_there_is_none() -> None:
    rng = np.random.default_rng(6)
    kinds = []
    for white in (1e-12, 5e-12):
        f = np.linspace(0.1, 5.0, 400)
        basis = np.column_stack([np.ones(400), 1.0 / f, f**2, f**-2, np.zeros(400), 40.0 * f])
        kinds.append((basis, (white + 2e-13 * f**2 + FLOOR**2 * basis[:, 5]) * rng.chisquare(1.0, 400)))
    as_given = [([basis], [squares]) for basis, squares in kinds]
    x, y = gain_floors(as_given)
    assert x == 0.0
    assert math.sqrt(y) == pytest.approx(FLOOR, rel=0.1)
    law = fit_law(*kinds[0], floors=(x, y))
    assert law.floors == (x, y)
    assert law.coefficients[0] < 1e-11
    without = [([basis], [1e-12 * rng.chisquare(1.0, 400)]) for basis, _ in kinds]
    assert gain_floors(without) == (0.0, 0.0)
    assert gain_floors([]) == (0.0, 0.0)


def test_a_law_with_gains_is_scaled_and_bounded_as_a_whole() -> None:
    law = NoiseLaw((1.0, 2.0, 3.0, 4.0), 5.0, (6.0, 7.0))
    assert law.times(2.0).floors == (12.0, 14.0)
    assert law.floor(0.5).floors == (3.0, 3.5)
    assert law.slow_part.floors == (0.0, 0.0), "it goes on from record to record as the slow drifts do"
    assert law.not_below(NoiseLaw((0.0, 0.0, 0.0, 0.0), floors=(1.0, 9.0))).floors == (6.0, 9.0)


def test_beside_a_floor_a_kind_has_noise_of_its_own_as_the_others_have() -> None:
    """Ring-ups without any of it left directions without noise: three rounds of the measurement returned to the first."""
    floor = (0.0, FLOOR**2)
    laws = {
        k: NoiseLaw((white, 0.0, pickoff, 0.0), floors=floor)
        for k, (white, pickoff) in enumerate(((1e-12, 2e-12), (3e-12, 0.0), (0.0, 0.0)))
    }
    laws[3] = NoiseLaw((0.0, 0.0, 0.0, 0.0))
    found = beside_floors(laws)
    assert found[2].coefficients == pytest.approx((0.3 * 2e-12, 0.0, 0.3 * 2e-12, 0.0))
    assert found[0].coefficients == laws[0].coefficients
    assert found[3] == laws[3], "of a channel that hears no floor nothing is known of it"
