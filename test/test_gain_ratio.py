"""Document 003 on carrier-level recordings: both ways to the drive gain, drives at twice the frequency, what biases them, claimed sd."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from wave_samples import low_q_hrg, simulate, whole_angle

from gyro_calib.device import Device, Nonlinearity, load_device
from gyro_calib.errors import CalibrationRefused, DataError
from gyro_calib.estimation.drive_chain import DriveChain, drive_chain_of
from gyro_calib.estimation.gain_ratio import off_axis, reference_ratio, ring_gain, scale_factor, stiffness_gain, without_feedthrough
from gyro_calib.experiments import Limits, Plan, SimulatedInstrument, run_plan
from gyro_calib.experiments.whole_angle_plans import (
    LEAST_RINGS_UP,
    LONGEST_LEG_S,
    MOST_SHARE,
    RING_SHARE,
    RINGS_UP,
    nominal_gain,
    scale_factor_steps,
)
from gyro_calib.quantity import Quantity
from gyro_calib.recording.command import Command
from gyro_calib.recording.recording import Recording
from gyro_calib.simulation import GyroSimulator

AXES = pytest.mark.parametrize(("axis", "k"), [("x", 0), ("y", 1)])
#: metres of motion per pick-off volt of the packaged hemisphere
METRE_PER_V = 1e-6


def hrg() -> Device:
    errors = {"gain_mismatch": -0.03, "two_delta_rad": 3.6e-3, "two_lambda_rad": -0.02}
    return low_q_hrg(**errors, damping_anisotropy=0.01, frequency_split_hz=3e-3)


def on_axis(device: Device, axis: str, **options: object) -> SimulatedInstrument:
    instrument = SimulatedInstrument(simulate(device, **options), 0.0)  # type: ignore[arg-type]
    if axis != "x":
        instrument.configure(Command(f"ftr_{axis}"))
        instrument.record(1.0, settle_s=12.0)
    return instrument


def legs(device: Device, axis: str = "x", *, fidelity: str = "carrier", **options: object) -> list[Recording]:
    """Ring-down to half the amplitude and ring-up, at 2 V/V."""
    instrument, found = on_axis(device, axis, fidelity=fidelity, **options), []
    for mode, gain, duration in (("ring_down", -2.0, 2.6), ("ring_up", 2.0, 5.5)):
        instrument.configure(whole_angle(mode, amplitude_gain_v_per_v=gain))
        found.append(instrument.record(duration, label=mode))
    return found


def stiffness_steps(device: Device, axis: str = "x", mode: str = "stiffness", *, fidelity: str = "carrier", **options: object):
    instrument, found = on_axis(device, axis, fidelity=fidelity, **options), []
    for k in range(4):
        instrument.configure(whole_angle(mode, stiffness_v_per_v=1.0 - 2.0 * (k % 2)))
        found.append(instrument.record(1.5, settle_s=0.0 if k else 1.0))
    return found


def known(device: Device) -> tuple[DriveChain, float]:
    flow = device.slow_flow()
    return drive_chain_of(flow.G), float((flow.A[0, 1] + flow.A[1, 0]).real)


@AXES
def test_ring_down_and_up_give_the_gain_of_either_axis_and_its_damping(axis: str, k: int) -> None:
    device, (chain, cross) = hrg(), known(hrg())
    flow, recordings = device.slow_flow(), legs(hrg(), axis)
    assert all(abs(off_axis(r, axis)) < 2e-2 for r in recordings)
    found = ring_gain(recordings, axis, chain=chain, cross_damping=cross)
    assert found.gain.value == pytest.approx(abs(flow.G[k, k]), rel=2e-6)
    assert found.decay_rate.value == pytest.approx(-flow.A[k, k].real, rel=2e-5)
    assert found.nonlinear_damping is None
    assert found.pickoff_cubic is None
    # a wave that drifts off the axis feels the couplings: without the chain that is an uncertainty
    blind = ring_gain(recordings, axis)
    assert abs(blind.gain.value / abs(flow.G[k, k]) - 1) < 2e-4
    assert 1.0 / found.t1_s > 1.0 / found.t2_s > 0.0


def test_the_short_legs_of_a_ring_give_its_gain_with_the_feedthrough_taken_out() -> None:
    device = load_device("ring_15k")
    steps = [s for s in scale_factor_steps(device.factory(), "quick") if s.label in ("place_x", "ring_down_x", "ring_up_x")]
    plan = Plan("ring", (*steps, *steps, *steps), Limits(base_rate_rad_s=10.0))
    campaign = run_plan(SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(3), fidelity="carrier")), plan)
    recordings = [r for r in campaign if r.command.mode.startswith("ring_")]
    assert max(r.duration_s for r in recordings) < 0.6
    flow, (chain, cross) = device.slow_flow(), known(device)
    found = ring_gain(recordings, "x", chain=chain, cross_damping=cross, feedthrough=device.feedthrough_matrix())
    true = abs(flow.G[0, 0])
    assert abs(found.gain.value - true) < 60e-6 * true
    assert found.gain.sd < 40e-6 * true
    assert found.decay_rate.value == pytest.approx(-flow.A[0, 0].real, rel=2e-4)
    # what the drives put straight onto the pick-offs is four parts in ten thousand of the drive, and gone
    clean = without_feedthrough(recordings[0], device.feedthrough_matrix())
    np.testing.assert_allclose(clean.pick + clean.drive @ device.feedthrough_matrix().T, recordings[0].pick, atol=1e-14)
    np.testing.assert_array_equal(clean.drive, recordings[0].drive)


def test_a_wave_that_decays_fast_takes_more_of_its_drives_and_one_that_they_cannot_hold_is_refused() -> None:
    """A unit whose usual drive rings it up at 1.18 times its decay had no plan."""
    factory = load_device("hrg_hardware").factory()
    gain, full, amplitude = nominal_gain(factory), factory["dac_full_scale_V"], factory["nominal_amplitude_v"]

    def ring_up(over_decay: float) -> tuple[float, float]:
        """Drive's rate at the usual share over the decay -> share of the converter and length of the leg [s]."""
        quality = math.pi * factory["nominal_f0_hz"] * over_decay / (RING_SHARE * full / amplitude * gain)
        step = next(s for s in scale_factor_steps({**factory, "nominal_q": quality}, "quick") if s.label == "ring_up_x")
        return step.command.setpoints.amplitude_gain_v_per_v * amplitude / full, step.duration_s

    assert ring_up(3.0)[0] == pytest.approx(RING_SHARE)
    share, leg_s = ring_up(1.18)
    assert share == pytest.approx(RING_SHARE * RINGS_UP / 1.18)
    assert 0.5 < leg_s < LONGEST_LEG_S
    with pytest.raises(DataError, match="able to ring the wave up"):
        ring_up(0.99 * LEAST_RINGS_UP * RING_SHARE / MOST_SHARE)


def test_commanded_control_is_off_by_the_latency_of_the_loop_and_the_recorded_one_is_not() -> None:
    device = low_q_hrg()
    found, true = ring_gain(legs(device), "x"), abs(device.slow_flow().G[0, 0])
    late = device.loop_latency_s * device.resonator.decay_rate()
    assert found.document_gain / true - 1 == pytest.approx(late, rel=0.2)
    assert abs(found.gain.value / true - 1) < 0.05 * late


def test_threshold_is_half_of_the_amplitude_and_both_legs_must_be_there() -> None:
    down, up = legs(hrg())
    low = np.linalg.norm(down.pick, axis=1).min()
    assert low == pytest.approx(0.5, abs=1e-3)
    with pytest.raises(CalibrationRefused, match="leg down and a leg up, but got down"):
        ring_gain([down], "x")
    with pytest.raises(CalibrationRefused, match="must change during the recordings"):
        stiffness_gain([up], "x")


def test_drives_at_twice_the_frequency_make_exponentials_of_constant_volts() -> None:
    base = low_q_hrg()
    device = replace(base, drive=replace(base.drive, at_twice_frequency=True))
    recordings = legs(device)
    found = ring_gain(recordings, "x", drive_amplitude_v=device.factory_data.nominal_amplitude_v)
    assert found.gain.value == pytest.approx(abs(device.slow_flow().G[0, 0]), rel=1e-6)
    falling = np.linalg.norm(recordings[0].pick, axis=1) > 0.55
    assert np.ptp(np.linalg.norm(recordings[0].drive, axis=1)[falling][10:]) < 1e-3


@pytest.mark.parametrize("share", [0.01, 0.1])
def test_nonlinear_damping_is_found_and_leaves_the_gain_alone(share: float) -> None:
    """``c |z|^2 z'`` that adds a share of 1/tau at full amplitude: an eighth of its coefficient acts on the envelope along a line."""
    base = low_q_hrg()
    decay = base.resonator.decay_rate()
    coefficient = share * 8.0 * decay / METRE_PER_V**2
    device = replace(base, nonlinearity=Nonlinearity(damping_quadratic=coefficient))
    found = ring_gain(legs(device), "x")
    true = abs(device.slow_flow().G[0, 0])
    assert found.nonlinear_damping is not None
    assert found.nonlinear_damping.value == pytest.approx(share * decay, rel=1e-3)
    assert found.decay_rate.value == pytest.approx(decay, rel=2e-5)
    assert found.gain.value == pytest.approx(true, rel=2e-6)
    # the document's mean of both legs is shifted: their times at each amplitude differ
    assert 1e-5 < abs(found.document_gain / true - 1) < 3e-3


@pytest.mark.parametrize("shift_hz", [0.01, 0.1])
def test_duffing_moves_the_frequency_and_not_the_gain(shift_hz: float) -> None:
    base = low_q_hrg()
    w = base.resonator.omega0_rad_s
    stiffening = 2.0 * w * 2.0 * math.pi * shift_hz * 4.0 / 3.0 / METRE_PER_V**2
    recordings = legs(replace(base, nonlinearity=Nonlinearity(cubic_isotropic=stiffening)))
    moved = recordings[0].column("ref_freq")
    assert moved[5] - moved[-1] == pytest.approx(0.75 * shift_hz, rel=0.1)
    found = ring_gain(recordings, "x")
    assert found.gain.value == pytest.approx(abs(base.slow_flow().G[0, 0]), rel=2e-6)


def test_a_cubic_pick_off_biases_the_document_and_is_found() -> None:
    base = low_q_hrg()
    device = replace(base, pickoff=replace(base.pickoff, cubic_per_v2=1e-3))
    found, true = ring_gain(legs(device), "x"), abs(base.slow_flow().G[0, 0])
    assert abs(found.document_gain / true - 1) > 5e-4
    assert found.pickoff_cubic is not None
    assert found.gain.value == pytest.approx(true, rel=1e-5)


@AXES
def test_stiffness_control_gives_the_same_gain(axis: str, k: int) -> None:
    chain, _ = known(hrg())
    true = abs(hrg().slow_flow().G[k, k])
    recordings = stiffness_steps(hrg(), axis)
    assert stiffness_gain(recordings, axis, chain=chain).value == pytest.approx(true, rel=5e-5)
    # the loops take back on the other axis what the couplings leak there, and the couplings return some of it
    leak = (chain.matrix[0, 1] * chain.matrix[1, 0]) / (1.0 + chain.delta_g)
    assert stiffness_gain(recordings, axis).value / true - 1 == pytest.approx(-leak, abs=1.5e-4)


def test_stiffness_control_runs_beside_the_mission() -> None:
    chain, _ = known(hrg())
    gain = stiffness_gain(stiffness_steps(hrg(), "x", "ftr_x"), "x", chain=chain)
    assert gain.value == pytest.approx(abs(hrg().slow_flow().G[0, 0]), rel=5e-6)


@AXES
def test_the_corrected_scale_factor_follows_gains_that_aged(axis: str, k: int) -> None:
    """Reference ratio from the young unit; later every gain is per cents off and Q 30 % lower."""
    young = low_q_hrg(gain_mismatch=-0.03)
    chain, cross = known(young)
    gains = [ring_gain(legs(young, a, fidelity="slow_flow"), a, chain=chain, cross_damping=cross).gain for a in "xy"]
    ratio = reference_ratio(*gains, Quantity(1.0, 1e-6, "1"))
    assert ratio.value == pytest.approx(1.0 / 0.97, rel=5e-6)
    old = replace(
        young,
        drive=replace(young.drive, gain_m_s2_per_v=0.95 * young.drive.gain_m_s2_per_v),
        pickoff=replace(young.pickoff, gain_v_per_m=1.03 * young.pickoff.gain_v_per_m),
        resonator=replace(young.resonator, quality_factor=0.7 * young.resonator.quality_factor),
    )
    flow, kappa = old.slow_flow(), old.resonator.angular_gain
    gain = ring_gain(legs(old, axis), axis, chain=chain, cross_damping=cross).gain
    found = scale_factor(gain, axis, ratio, kappa, 1.0)
    # theory.md Eq. 7: the gain of the axis that rebalances
    true = (1.0, -1.0)[k] * kappa / abs(flow.G[1 - k, 1 - k])
    assert found.value == pytest.approx(true, rel=8e-6)
    before = (1.0, -1.0)[k] * kappa / abs(young.slow_flow().G[1 - k, 1 - k])
    assert abs(before / true - 1) > 0.02
    assert found.sd == pytest.approx(abs(found.value) * math.hypot(gain.sd / gain.value, ratio.sd / ratio.value), rel=1e-6)


@pytest.mark.parametrize("method", ["ring", "stiffness"])
def test_claimed_uncertainty_is_the_scatter_over_seeds(method: str) -> None:
    device = low_q_hrg()
    found = []
    for seed in range(14):
        options = {"noisy": True, "seed": seed, "fidelity": "slow_flow"}
        found.append(
            ring_gain(legs(device, **options), "x").gain if method == "ring" else stiffness_gain(stiffness_steps(device, **options), "x")
        )
    values, sds = np.array([q.value for q in found]), np.array([q.sd for q in found])
    true = abs(device.slow_flow().G[0, 0])
    pulls = (values - true) / sds
    assert 0.4 < float(np.sqrt(np.mean(pulls**2))) < 1.7
    assert float(np.sqrt(np.mean(sds**2))) / true < 1e-3
