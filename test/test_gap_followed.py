"""What feeds through where the resonance lies: taken off once, whoever is to blame for the place."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gyro_calib.device import draw_unit, load_device
from gyro_calib.experiments import SimulatedInstrument, gap_whole_angle_plan, run_plan
from gyro_calib.gap.columns import form_columns
from gyro_calib.gap.forms import FORMS
from gyro_calib.gap.model import CampaignModel, look_at
from gyro_calib.gap.relinearise import relinearised
from gyro_calib.simulation import GyroSimulator

AGEING = -5e-4


@cache
def model() -> CampaignModel:
    """A multiplexed hemisphere (E is a control period of the drive) whose resonance ages by 0.2 rad/s."""
    base = draw_unit(load_device("hrg_hardware"), 5)
    device = replace(base, effects={"frequency_ageing": {"k": AGEING}})
    instrument = SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(3), fidelity="carrier"), 2e-5)
    campaign = run_plan(instrument, gap_whole_angle_plan(device.factory(), quality="quick"))
    f = campaign.factory
    return look_at(list(campaign), math.pi * f["nominal_f0_hz"] / f["nominal_q"], f["angular_gain_kappa"])


@pytest.mark.slow
def test_a_resonance_that_ages_leaves_no_phase_that_drifts() -> None:
    assert np.abs(model().linear.E).max() > 2e-4 * np.abs(model().linear.G).max()
    chosen = relinearised(model(), [model().candidates["frequency_ageing"][0]])
    fit = model().fitted(chosen)
    assert abs(fit.by_name()["frequency_ageing.k"] / AGEING - 1.0) < 0.05
    assert fit.chi2 < 1.3 * fit.residual.size
    drift = model().screener_with(chosen).screen(model().candidates["drive_phase_drift"][0])
    assert drift is not None
    assert drift.gain < 25.0


@pytest.mark.slow
def test_a_force_that_moves_the_resonance_is_one_on_the_volts() -> None:
    """What feeds through its column of E has taken off, at the place where the resonance was found."""
    m = model()
    (column,) = form_columns(m.evidence, FORMS["frequency_ageing"], m.linear, {})
    (on_motion,) = form_columns(m.evidence, FORMS["frequency_ageing"], replace(m.linear, followed=None), {})
    waves = [r for r in m.evidence if r.is_wave]
    volts, fed = (
        [r.turn * r.signal_forms.plain([x])[:, 0] for r, x in zip(waves, signals, strict=True)]
        for signals in (
            [1j * r.signals.time_s[:, None] * r.signals.pick for r in waves],
            [1j * r.signals.drive @ m.linear.E.T for r in waves],
        )
    )

    def apart(vectors: tuple[np.ndarray, ...]) -> float:
        """But for a constant distance, which is A's."""
        left, steady = (np.concatenate(x) for x in ([vectors[r.index] - v for r, v in zip(waves, volts, strict=True)], fed))
        return float(np.linalg.norm(left - steady * np.vdot(steady, left).real / np.vdot(steady, steady).real))

    assert apart(column.signal) < 0.1 * apart(on_motion.signal)
