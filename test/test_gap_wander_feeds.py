"""A slope of the resonance of each record's own, for what feeds through."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from test_gap_wander import campaign, fit, known

from gyro_calib.gap import device_fit
from gyro_calib.gap.column import Column
from gyro_calib.gap.linear_device import linear_columns
from gyro_calib.gap.parts import Linear
from gyro_calib.gap.wander import tells_its_wander, wander_within
from gyro_calib.gap.wander_feeds import wander_feeds


@cache
def followed() -> tuple[Linear, list[Column]]:
    evidence, linear = known()
    followed = device_fit.followed_of(evidence, *fit(evidence, linear)).with_wander(wander_within(evidence, linear))
    linear = replace(linear, followed=followed)
    return linear, wander_feeds(evidence, linear)


def test_every_record_that_tells_its_wander_has_a_slope_of_its_own() -> None:
    (evidence, _), (_, columns) = known(), followed()
    indices = [r.index for r in evidence if tells_its_wander(r)]
    assert {c.name for c in columns} == {f"wander_feeds_{i}_{part}" for i in indices for part in ("re", "im")}
    assert len(indices) > len(campaign()[1])
    for c in columns:
        assert [i for i, v in enumerate(c.signal) if np.any(v)] == [int(c.name.split("_")[2])]


def test_a_slope_is_what_the_columns_of_e_have_of_a_resonance_that_slides_further() -> None:
    (evidence, _), (linear, columns) = known(), followed()
    assert linear.followed is not None
    slides = tuple(np.linspace(-1.0, 1.0, len(r.signals.time_s)) for r in evidence)
    further = replace(linear, followed=linear.followed.with_wander(slides))
    before, after = ({c.name: c for c in linear_columns(evidence, d) if c.name.startswith("E_")} for d in (linear, further))
    entries = {f"E_{a}{b}_re": linear.E[i, j] for i, a in enumerate("xy") for j, b in enumerate("xy")}
    by_name = {c.name: c for c in columns}
    for r in evidence:
        if r.recording.label in campaign()[1]:
            moved = sum(e * (after[name].signal[r.index] - before[name].signal[r.index]) for name, e in entries.items())
            found = by_name[f"wander_feeds_{r.index}_re"].signal[r.index]
            assert np.linalg.norm(found - moved) < 1e-9 * np.linalg.norm(moved)
            assert np.linalg.norm(moved) > 0.0


def test_without_a_resonance_that_is_followed_there_is_none() -> None:
    evidence, linear = known()
    assert wander_feeds(evidence, replace(linear, followed=None)) == []
