"""A drive that steps kicks the wave by its part at twice the carrier, at the phase that the carrier has just then."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np

from gyro_calib.gap.evidence import CampaignEvidence
from gyro_calib.gap.nuisance import SWITCHED, _kicks, _times_of
from gyro_calib.gap.parts import Linear
from gyro_calib.recording.columns import column_index
from gyro_calib.trial.plans import campaign_plan
from gyro_calib.trial.plant import record_unit
from gyro_calib.trial.units import draw_trial_unit


def test_every_step_of_a_drive_has_a_phase_of_its_own() -> None:
    """One for the whole record left a plant's ring-up short of what lies beyond 1 V, by 50 to 60 in chi-square."""
    unit, rng = draw_trial_unit("hemisphere", 79, 1), np.random.default_rng(1)
    plan = campaign_plan("hemisphere", unit.device.factory(), rng, "quick")
    down = next(k for k, step in enumerate(plan.steps) if step.command.mode == "ring_down")
    campaign = record_unit(unit, replace(plan, steps=plan.steps[down - 1 : down + 1]), {}, rng)
    factory = campaign.factory
    whole = CampaignEvidence.of(campaign.recordings, math.pi * factory["nominal_f0_hz"] / factory["nominal_q"])
    linear = cast(Linear, SimpleNamespace(G=-0.14j * np.eye(2)))
    before = next(r for r in whole if r.recording.command.mode == "ring_down")
    data = before.recording.data.copy()
    on = (np.arange(len(data)) >= len(data) // 3) & (np.arange(len(data)) < 2 * len(data) // 3)
    data[on, column_index("x_drive_c")] += 1.0
    evidence = whole.replaced({before.index: replace(before.recording, data=data)})
    found = [c for c in _kicks(evidence, linear) if c.name.startswith(f"kick_{before.index}_") and c.name.endswith("_re")]
    steps = [c for c in found if np.linalg.norm(c.signal[before.index]) > 1e-7]
    assert len(steps) >= 2
    r = evidence.recordings[before.index]
    assert r.recording.command.mode in SWITCHED
    step = np.diff(r.signals.drive, axis=0, prepend=r.signals.drive[:1])
    step[np.linalg.norm(step, axis=1) <= 10.0 * np.median(np.linalg.norm(step, axis=1))] = 0.0
    kick = (step @ linear.G.T).conj() / (2.0 * evidence.omega0_rad_s * r.signals.row_s)
    together = r.turn * r.signal_forms.plain([kick])[:, 0]
    np.testing.assert_allclose(sum(c.signal[before.index] for c in found), together, atol=1e-12)
    for c in found:
        others = [v for k, v in enumerate(c.signal) if k != before.index]
        assert not any(np.any(v) for v in others)


def test_rows_of_one_step_are_together_and_noise_is_one_time() -> None:
    abrupt = np.zeros(200, dtype=bool)
    abrupt[[20, 21, 22, 90, 150, 153]] = True
    assert [list(rows) for rows in _times_of(abrupt, 5.0)] == [[20, 21, 22], [90], [150, 153]]
    assert _times_of(np.zeros(50, dtype=bool), 5.0) == []
    noisy = np.zeros(400, dtype=bool)
    noisy[::20] = True
    (only,) = _times_of(noisy, 5.0)
    assert len(only) == 20
