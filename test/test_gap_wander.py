"""A resonance that wanders within a recording: it carries the motion along, and not what feeds through."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import cast
from unittest import mock

import numpy as np
import pytest
from table_samples import looked_at

from gyro_calib.device import draw_unit, load_device
from gyro_calib.estimation.projection import test_functions as functions_on
from gyro_calib.experiments import SimulatedInstrument, gap_whole_angle_plan, run_plan
from gyro_calib.gap import device_fit
from gyro_calib.gap.evidence import CampaignEvidence
from gyro_calib.gap.linear_device import linear_columns
from gyro_calib.gap.noise_law import Grams, Lines, NoiseLaw
from gyro_calib.gap.parts import Linear
from gyro_calib.gap.preflight import usable
from gyro_calib.gap.signals import Projector, Signals
from gyro_calib.gap.wander import wander_within
from gyro_calib.recording.columns import column_index
from gyro_calib.recording.recording import Campaign, Recording
from gyro_calib.simulation import GyroSimulator

#: wander of a half cosine [rad/s], twenty millikelvins of silica
SIZE_RAD_S = 0.08


def wandering(r: Recording, sign: float) -> Recording:
    """The recording of a device whose resonance did that: a reference that follows it is at another frequency, and all else as it was."""
    data = r.data.copy()
    place = math.pi * (np.arange(len(data)) + 0.5) / len(data)
    data[:, column_index("ref_freq")] += sign * SIZE_RAD_S * np.cos(2.0 * place) / (2.0 * math.pi)
    return replace(r, data=data)


@cache
def campaign() -> tuple[Campaign, dict[str, float]]:
    """A multiplexed hemisphere: what feeds through is a control period of the drive."""
    device, rng = draw_unit(load_device("hrg_hardware"), 5), np.random.default_rng(3)
    instrument = SimulatedInstrument(GyroSimulator(device, rng=rng, fidelity="carrier"), 2e-5)
    recorded = run_plan(instrument, gap_whole_angle_plan(device.factory(), quality="quick"))
    turning = [r for r in recorded if r.command.setpoints.virtual_precession_v and not r.label.startswith("thermal")]
    signs = {r.label: float(rng.choice([-1.0, 1.0])) for r in turning}
    assert len(signs) > 6
    changed = tuple(wandering(r, signs[r.label]) if r.label in signs else r for r in recorded)
    return replace(recorded, recordings=changed), signs


@cache
def known() -> tuple[CampaignEvidence, Linear]:
    """The recordings and the linear device of rough noise."""
    recorded, _ = campaign()
    f = recorded.factory
    evidence = CampaignEvidence.of(usable(recorded), math.pi * f["nominal_f0_hz"] / f["nominal_q"])
    wander = 5e-8 * evidence.omega0_rad_s
    linear, *_ = device_fit.first_linear(evidence, f["angular_gain_kappa"], wander)
    return evidence, linear


def test_the_course_is_told_by_the_recording_itself() -> None:
    (evidence, linear), (_, signs) = known(), campaign()
    found = wander_within(evidence, linear)
    for r in evidence:
        if r.recording.label in signs:
            place = math.pi * (np.arange(len(found[r.index])) + 0.5) / len(found[r.index])
            basis = np.cos(np.outer(place, np.arange(3)))
            size = float(np.linalg.lstsq(basis, found[r.index], rcond=None)[0][2])
            assert size == pytest.approx(signs[r.recording.label] * SIZE_RAD_S, rel=0.1)
        elif r.is_warming or r.recording.command.excitation.kind != "none":
            assert not found[r.index].any()


def test_a_resonance_far_away_lies_where_the_flow_counts_it() -> None:
    """A stiffness that grew moves it to ``sqrt(omega^2 + 2 omega0 s)``: eight kelvins of a hemisphere, 8 mrad/s short of s."""
    evidence, linear = known()
    stiffer_rad_s, omega0 = 22.0, evidence.omega0_rad_s

    def stiffened(r: Recording) -> Recording:
        data = r.data.copy()
        data[:, column_index("ref_freq")] = np.sqrt(r.ref_omega_rad_s**2 + 2.0 * omega0 * stiffer_rad_s) / (2.0 * math.pi)
        return replace(r, data=data)

    turning = {r.index: stiffened(r.recording) for r in evidence if r.recording.label in campaign()[1]}
    before, after = wander_within(evidence, linear), wander_within(evidence.replaced(turning), linear)
    for i in turning:
        # the flow is compared over two rows, in which the wave turns: a few millionths
        assert float(np.mean(after[i] - before[i])) == pytest.approx(stiffer_rad_s, abs=1e-4)


def test_the_column_of_what_feeds_through_stays_where_the_drive_is() -> None:
    evidence, linear = known()
    following = replace(linear, followed=device_fit.followed_of(evidence, *fit(evidence, linear)))
    assert following.followed is not None
    wander = wander_within(evidence, linear)
    moved = replace(following, followed=following.followed.with_wander(wander))
    before, after = ({c.name: c for c in linear_columns(evidence, d)}["E_yy_re"] for d in (following, moved))
    for r in evidence:
        expected = np.zeros((len(wander[r.index]), 2), complex)
        expected[:, 1] = -1j * wander[r.index] * r.signals.drive[:, 1]
        projected = r.turn * r.signal_forms.plain([expected])[:, 0]
        np.testing.assert_allclose(after.signal[r.index] - before.signal[r.index], projected, rtol=1e-9, atol=1e-15)


def fit(evidence: CampaignEvidence, linear: Linear) -> tuple[object, ...]:
    columns = device_fit.nuisances_of(evidence, linear, 1e-3, 1e-3)
    whitener = device_fit.Whitener.of(evidence, device_fit.first_noise(evidence))
    design = whitener.design(columns, len(evidence))
    target = whitener.rows(device_fit.target_of(evidence, linear.angular_gain))
    return device_fit.solve(columns, design, target), whitener, design


@pytest.mark.slow
def test_waves_that_precess_are_as_quiet_as_without_it() -> None:
    """Left out, lines across the precessing waves leave more than their noise, part of which is measured as noise then."""
    recorded, _ = campaign()
    models = [looked_at(recorded)]
    with mock.patch.object(device_fit, "wander_within", lambda e, d: tuple(np.zeros(len(r.signals.time_s)) for r in e)):
        models.append(looked_at(recorded))
    with_it, without = (m.screener.chi2 / m.screener.dof for m in models)
    assert with_it < 1.15
    # some thousand equations: three standard deviations of their chi-square are 0.13
    assert without > with_it + 0.1


def test_a_walk_is_alike_at_the_ends_of_its_record_on_every_line() -> None:
    """White noise's correlations in its place believed the top lines of a turned ring 3.4 times too well, and it stiffened."""
    row_s, rows = 0.01, 1000
    f = functions_on(np.arange(rows) * row_s, row_s, [0.1 * k for k in range(16)])
    projector = Projector(cast(Signals, SimpleNamespace(row_s=row_s)), f.frequency_hz, f.value, f.first, f.second)
    grams = Grams(row_s * (f.value @ f.value.T), projector.walk_gram)
    rng = np.random.default_rng(8)
    # of densities 1 and 1/f^2
    walk = 2.0 * np.pi * np.cumsum(rng.standard_normal((4000, rows)), axis=1) * np.sqrt(row_s)
    walk -= walk.mean(axis=1, keepdims=True)
    white = rng.standard_normal((4000, rows)) / np.sqrt(row_s)
    seen = row_s * (1.3 * walk + 2.0 * white) @ f.value.T
    is_mean = f.frequency_hz == 0.0
    lines = Lines(np.where(is_mean, 1.0, f.frequency_hz), np.zeros(31), 1.0, is_mean, np.diag(grams.walk))
    told = NoiseLaw((2.0**2, 0.0, 0.0, 1.3**2)).covariance(lines, grams)
    np.testing.assert_allclose(np.diag(told), NoiseLaw((2.0**2, 0.0, 0.0, 1.3**2)).density(lines))
    whitened = np.linalg.solve(np.linalg.cholesky(told[1:, 1:]), seen.T[1:])
    np.testing.assert_allclose(np.mean(whitened**2, axis=1), 1.0, atol=0.12)
    assert np.abs(np.corrcoef(whitened) - np.eye(len(whitened))).max() < 0.15
    # as it was: each line by itself, alike as white noise is
    walked = NoiseLaw((0.0, 0.0, 0.0, 1.0)).covariance(lines, grams)[1:, 1:]
    believed = grams.value[1:, 1:] / np.outer(f.frequency_hz[1:], f.frequency_hz[1:])
    factor = np.linalg.inv(np.linalg.cholesky(believed))
    assert np.diag(factor @ walked @ factor.T).max() > 3.0
