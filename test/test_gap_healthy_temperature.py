"""What a healthy device does with the temperature: its size, its form, and what it may not hide."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from added_effects import with_effects

from gyro_calib.device import draw_unit, load_device
from gyro_calib.effects import EFFECTS
from gyro_calib.experiments import SimulatedInstrument, gap_ftr_plan, run_plan
from gyro_calib.gap.columns import form_columns
from gyro_calib.gap.forms import FORMS
from gyro_calib.gap.model import CampaignModel, look_at
from gyro_calib.gap.nuisance import following_columns
from gyro_calib.gap.parts import Form, Linear, Part, Setting
from gyro_calib.gap.screen import Candidate
from gyro_calib.gap.select import select_effects
from gyro_calib.gap.signals import Signals
from gyro_calib.gap.standing import _status, standings
from gyro_calib.simulation import GyroSimulator
from gyro_calib.trial.injected import with_columns


@cache
def model() -> CampaignModel:
    """A healthy ring with its temperature run."""
    device = draw_unit(load_device("ring_15k"), 5)
    instrument = SimulatedInstrument(GyroSimulator(device, rng=np.random.default_rng(3), fidelity="slow_flow"), 2e-5)
    campaign = run_plan(instrument, gap_ftr_plan(device.factory(), quality="quick", abilities=("temperature",)))
    f = campaign.factory
    return look_at(list(campaign), math.pi * f["nominal_f0_hz"] / f["nominal_q"], f["angular_gain_kappa"])


@pytest.mark.slow
def test_a_record_early_by_a_sample_of_the_converters_is_a_healthy_one() -> None:
    """Every ring of an eleventh plant led by 8.3 us, and drives with a memory were found."""
    m = model()
    (lag,) = m.candidates["drive_lag"]

    def gain(tau_s: float) -> float:
        late = with_columns(m, [(lag.columns[0], tau_s)])
        return max(
            s.gain for s in late.screener.screened(c for n in ("drive_lag", "drive_memory", "pickoff_memory") for c in m.candidates[n])
        )

    before = gain(0.0)
    assert gain(-8.3e-6) < before + 10.0
    assert gain(-1e-4) > before + 60.0


@pytest.mark.slow
def test_a_feedthrough_that_follows_the_temperature_by_300_ppm_of_itself_is_a_healthy_one() -> None:
    m = model()
    (fed,) = m.candidates["thermal_feedthrough"]

    def gain(e_per_k: float) -> float:
        (found,) = with_columns(m, [(fed.columns[0], e_per_k)]).screener.screened([fed])
        return found.gain

    before = gain(0.0)
    assert gain(3e-4 * abs(m.linear.E[0, 0])) < before + 5.0
    assert gain(6e-3 * abs(m.linear.E[0, 0])) > before + 60.0


def test_losses_that_keep_their_pattern_are_one_column() -> None:
    """Re A's unequal part as it is, which is what the two components of an anisotropy make at its size and direction."""
    m = model()
    (kept,) = (c for c in following_columns(m.evidence, m.linear) if c.name == "anisotropy_per_k")
    components = form_columns(m.evidence, FORMS["thermal_damping_anisotropy"], m.linear, {})
    a = m.linear.A.real
    sizes = {"c_c": (a[0, 0] - a[1, 1]) / 2.0, "c_s": (a[0, 1] + a[1, 0]) / 2.0}
    signs = {name: np.sign(np.vdot(c.signal[-1], kept.signal[-1]).real * sizes[name]) for name, c in zip(sizes, components, strict=True)}
    assert len(set(signs.values())) == 1, "the two components of one matrix have one sign convention"
    made = [sum(sizes[n] * signs[n] * c.signal[k] for n, c in zip(sizes, components, strict=True)) for k in range(len(kept.signal))]
    largest = max(np.abs(x).max() for x in kept.signal)
    assert largest > 0.0
    # what is not symmetric of Re A is a rotation, no loss: it goes with the temperature besides
    turned = abs(a[0, 1] - a[1, 0]) / 2.0 / max(abs(s) for s in sizes.values())
    for one, other in zip(kept.signal, made, strict=True):
        assert np.abs(one - other).max() < (1e-6 + 2.0 * turned) * largest


def test_a_split_that_moves_across_its_own_direction_shows_from_some_thousandths_of_it() -> None:
    """Axes of healthy devices turn by half a milliradian per kelvin: 2e-4 rad/s/K, 6e-4/K of this split, are no more than that."""
    m = model()
    (split,) = m.candidates["thermal_split"]
    clean, _ = m.screener.projected(split.columns)
    own, across = _own_direction(m)
    assert (2e-3 * np.linalg.norm(clean @ across)) ** 2 > 25.0 > 9.0 > (2e-4 * np.linalg.norm(clean @ across)) ** 2
    assert np.linalg.norm(clean @ across) > 1.1 * np.linalg.norm(clean @ own)


def test_a_split_that_keeps_its_direction_may_move_by_thousandths_of_itself() -> None:
    """Nine of fourteen healthy units of a sixth plant, whose splits moved by 0.3 %/K, had a thermal split."""
    m = model()
    (split,) = m.candidates["thermal_split"]
    own, across = _own_direction(m)
    half = np.linalg.norm(m.linear.A.imag - np.eye(2) * np.trace(m.linear.A.imag) / 2.0) / np.sqrt(2.0)
    for direction, per_k, named in ((own, 3e-3, False), (across, 1e-3, False), (across, 8e-3, True)):
        column = replace(split.columns[0], signal=_along(split, direction, "signal"), quiet=_along(split, direction, "quiet"))
        names = [e.name for e in select_effects(with_columns(m, [(column, per_k * half)])).effects]
        assert ("thermal_split" in names) is named


def _own_direction(m: CampaignModel) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (c, s) along the device's split and across it."""
    stiff = m.linear.A.imag
    own = np.array([stiff[0, 0] - stiff[1, 1], stiff[0, 1] + stiff[1, 0]])
    own /= np.linalg.norm(own)
    return own, np.array([-own[1], own[0]])


def _along(split: Candidate, direction: np.ndarray, where: str) -> tuple[np.ndarray, ...]:
    c, s = (getattr(column, where) for column in split.columns)
    return tuple(direction[0] * a + direction[1] * b for a, b in zip(c, s, strict=True))


def test_the_temperature_of_a_healthy_unit_is_no_effect() -> None:
    """It has coefficients of its own, all drawn, and none is blamed."""
    m = model()
    found = [m.screener.screen(c) for name, tried in m.candidates.items() if name.startswith("thermal_") for c in tried]
    assert found
    assert max(s.gain for s in found if s is not None) < 25.0


def test_axes_of_one_design_part_by_tens_of_parts_per_million() -> None:
    """Both gains alike are believed to be 3e-4/K, what one axis does by itself a quarter of it, and no phase more than 1.5e-5 rad/K."""
    sds = {c.name: c.prior_sd for c in following_columns(model().evidence, model().linear)}
    assert sds["thermal_drive_gain.g_x"] <= 0.25 * sds["both_thermal_drive_gain"] * (1 + 1e-12)
    assert max(sds[f"thermal_{side}_phase.g_{axis}"] for side in ("drive", "pickoff") for axis in "xy") <= 1.5e-5


def test_a_pump_that_undoes_the_damping_does_not_take_what_follows_the_temperature() -> None:
    """It is in A, whose trace may be hardly anything then; the losses that it undoes are warmed as ever (a chi-square of 907)."""
    m = model()
    pumped = replace(m.linear, A=m.linear.A - 0.98 * np.eye(2) * np.trace(m.linear.A).real / 2.0)
    before, sds = ({c.name: c.prior_sd for c in following_columns(m.evidence, x)} for x in (m.linear, pumped))
    assert 0.4 < sds["thermal_damping.c"] / before["thermal_damping.c"] < 0.7


def test_gains_that_part_while_it_warms_are_no_effect_of_the_registry() -> None:
    """One pick-off by how fast the temperature moves, a gradient across the electronics: *with the temperature of before* comes near."""
    m = model()
    term = next(c for t, c in m.bank if (t.location, t.phase, t.form) == ("pick-off", "in phase", "dT/dt x, other on each axis"))
    selection = select_effects(with_effects(m, [term.columns[0]], 60.0))
    assert selection.stranger is not None
    assert (selection.stranger.term.location, selection.stranger.term.depends_on) == ("pick-off", "temperature")


def test_drives_that_are_late_by_some_samples_are_healthy() -> None:
    """Their carrier's phase follows the frequency: three healthy hemispheres of a third plant, 41 us late, had a delay."""
    m = model()
    (delay,) = m.candidates["drive_delay"]
    clean, _ = m.screener.projected(delay.columns)
    assert "both_drive_delay" in {c.name for c in m.nuisances}
    assert np.linalg.norm(clean.sum(axis=1)) * 4e-5 < 2.0


def peaking(about_k: float, width_k: float) -> Form:
    """Damping that peaks about a temperature."""

    def parts(s: Signals, d: Linear, setting: Setting) -> list[Part]:
        peak = 1.0 / (1.0 + ((s.temperature_k - about_k) / width_k) ** 2)
        return [Part("c", "flow", -peak[:, None] * s.pick)]

    return Form(parts)


def test_a_mode_that_crosses_at_one_temperature_is_told_with_where() -> None:
    """It lasts a second or two of the records that are warmed; three numbers of a curve in T are not that."""
    m = model()
    temperatures = np.concatenate([r.signals.temperature_k for r in m.evidence])
    about = float(temperatures.min() + 0.31 * np.ptp(temperatures))
    (column,) = form_columns(m.evidence, peaking(about, 0.07 * float(np.ptp(temperatures))), m.linear, {})
    found = select_effects(with_effects(m, [column], 30.0)).stranger
    assert found is not None
    assert (found.term.location, found.term.phase, found.term.depends_on) == ("dynamics", "in phase", "temperature")
    assert found.term.form.startswith("x times what peaks about ")
    assert abs(float(found.term.form.split()[-2]) - m.evidence.temperature_degc - about) < 0.15 * float(np.ptp(temperatures))


def test_a_healthy_temperature_run_has_no_peak() -> None:
    m = model()
    found = m.courses.best(m.screener, m.whitener, "temperature")
    assert found is None or found[0].gain < 25.0


def test_a_limit_beyond_any_device_is_none() -> None:
    """Three side bands left a damping by the square of the velocity open above 21 778 1/s/V^2, where a device has five at most."""
    m = model()
    (split,) = m.screener.screened(m.candidates["thermal_split"])
    bound = EFFECTS["thermal_split"].parameters[0].upper
    status, limit = _status(replace(split, sd=np.full_like(split.sd, bound)))
    assert (status, limit) == ("not testable", None)
    assert _status(split)[1] is not None


def test_an_effect_is_excluded_above_what_its_worst_parameter_leaves() -> None:
    """A split of 5e-4 rad/s/K in its worse direction stood in a ring's data where 1.85e-4 was excluded, and a pump above a fiftieth."""
    m = model()
    (split,) = m.screener.screened(m.candidates["thermal_split"])
    lines = {s.name: s for s in standings(m, select_effects(m))}
    limit = lines["thermal_split"].excluded_above
    assert limit is not None
    assert limit.sd == max(split.sd)
    assert limit.value > 5.0 * max(split.sd)
    assert lines["parametric_pump"].status == "not testable"
