"""Which sizes of an effect a blind trial draws."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
from quick_looks import healthy

from gyro_calib.gap.columns import form_columns
from gyro_calib.gap.forms import FORMS
from gyro_calib.gap.select import best_of_each
from gyro_calib.gap.strangers import MARGIN
from gyro_calib.trial.sizing import imitators, size_effect


def test_a_thermometer_s_lag_is_seen_at_any_time() -> None:
    """Its share of a time that is tried grows with the third power of how far that is off: between two of them one must come near."""
    model = healthy("ring")
    sized = size_effect(model, "thermal_lag", 8.0, np.random.default_rng(1))
    assert sized is not None
    assert sized.snr == pytest.approx(8.0, rel=0.01)
    for tau in sized.sizes["tau"] * np.geomspace(1.0, 6.0, 7):
        columns, _ = model.screener.projected(form_columns(model.evidence, FORMS["thermal_lag"], model.linear, {"tau": float(tau)}))
        screener = copy.copy(model.screener)
        screener.left = columns[:, 0]
        (best,) = best_of_each(screener, {"thermal_lag": model.candidates["thermal_lag"]})
        assert best.log_evidence > MARGIN, tau


def test_what_changes_the_damping_can_be_drawn() -> None:
    """Its time constant is no damping."""
    for name in ("thermal_damping_curvature", "thermal_damping_lag", "thermal_damping_anisotropy", "thermal_damping_anisotropy_lag"):
        assert size_effect(healthy("ring"), name, 10.0, np.random.default_rng(1)) is not None, name


def test_a_pump_beyond_the_damping_is_not_drawn() -> None:
    """Such a hemisphere rings by itself: of eight recordings of one, its columns were refused as having the wrong sign."""
    model = healthy("ring")
    drawn = size_effect(model, "parametric_pump", 1.0, np.random.default_rng(1))
    assert drawn is not None
    pumped = float(np.hypot(drawn.sizes["h_c"], drawn.sizes["h_s"]))
    for share, drawn_too in ((0.4, True), (0.6, False)):
        slow = replace(model, evidence=replace(model.evidence, decay_rate=pumped / share))
        assert (size_effect(slow, "parametric_pump", 1.0, np.random.default_rng(1)) is not None) == drawn_too


def test_a_charge_of_hours_is_a_drift() -> None:
    """Where the registry lacks the drift a diagnosis finds the charge: of 40 the grid's longest time leaves 7."""
    model = healthy("ring")
    sized = size_effect(model, "split_drift", 40.0, np.random.default_rng(1))
    assert sized is not None
    assert imitators(model, sized, ("charge_accumulation",))["charge_accumulation"] < 1.0
