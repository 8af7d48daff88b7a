"""What stands in the spectrum alone: a tone, a hum, a noisy gain; and what must not be taken for one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from flow_samples import quiet_flows
from scipy.integrate import solve_ivp
from spectra_samples import LINEAR, ROWS_HZ, records

from gyro_calib.gap.diagnose import _swaying_at_rest, _without_products
from gyro_calib.gap.noise_growth import noise_growth
from gyro_calib.gap.reference_spur import _standing
from gyro_calib.gap.screen import Candidate, Screened
from gyro_calib.gap.select import Selection
from gyro_calib.gap.spectra import is_image, pick_spectra
from gyro_calib.gap.spectral_effects import SpectralEffects, spectral_effects
from gyro_calib.gap.swings import Swing
from gyro_calib.gap.tones import Tone, _volts, find_tone
from gyro_calib.recording.command import Command, Excitation
from gyro_calib.recording.recording import Recording


def test_noise_alone_holds_neither_line_nor_growth() -> None:
    for seed in range(20):
        plain = records(np.random.default_rng(seed))
        assert find_tone(pick_spectra(plain), LINEAR) is None
        growth = noise_growth(plain)
        assert growth is not None
        assert abs(growth.gain_sigma) < 5.0
        assert growth.clock_sigma < 5.0


def test_a_hum_stands_at_one_distance_to_both_sides() -> None:
    tone = find_tone(pick_spectra(records(np.random.default_rng(1), hum=(50.0, 5e-6))), LINEAR)
    assert tone is not None
    assert (tone.name, tone.alike) == ("mains_pickup", ())
    assert tone.frequency_hz == pytest.approx(50.0, abs=0.02)


def test_a_gain_that_ripples_is_no_hum() -> None:
    """A supply's ripple on the pick-offs' gain stands where a hum would, but grows with the wave."""
    recordings = records(np.random.default_rng(1), ripple=(50.0, 1e-5))
    tone = find_tone(pick_spectra(recordings), LINEAR)
    assert tone is not None
    assert tone.of_wave
    found = spectral_effects(recordings, LINEAR)
    assert found.effects == ()
    assert found.unknown is not None
    assert "50 Hz" in found.unknown.form
    assert found.unknown.nearest == "mains_pickup"
    hum = find_tone(pick_spectra(records(np.random.default_rng(1), hum=(50.0, 1e-5))), LINEAR)
    assert hum is not None
    assert not hum.of_wave


@pytest.mark.parametrize("told", [True, False])
def test_a_line_that_the_drives_make_is_no_hum(told: bool) -> None:
    """An amplitude loop with a spur: the wave goes to and fro as the column of its drive says. If that says nothing, it is a hum."""
    hz, spur_v, found = 20.0, 2e-4, []
    for r in records(np.random.default_rng(2)):
        line = spur_v * np.exp(2j * np.pi * hz * r.t)
        data = r.data.copy()
        data[:, 2] += (8.0 * line / (2j * np.pi * hz + 1.5)).real
        data[:, 7] = 1.5 / 8.0 * r.command.setpoints.amplitude_v + told * line.real
        found.append(replace(r, data=data))
    said = spectral_effects(found, LINEAR)
    if not told:
        assert [e.name for e in said.effects] == ["mains_pickup"]
        return
    assert said.effects == ()
    assert said.unknown is not None
    assert said.unknown.form.startswith("drives that go to and fro at 20 Hz")
    sways = spectral_effects(found, LINEAR, (), [Swing("precession", 20.02, 75.0, 30, 1e-4, 4e-6, 1e-4, 0.3, 0.1)])
    assert [e.name for e in sways.effects] == ["base_sway"]
    assert sways.unknown is None


@pytest.mark.parametrize(("hz", "asked"), [(3.1, False), (6.0, False), (9.7, True)])
def test_a_side_band_with_a_harmonic_there_is_not_asked_who_makes_a_line(hz: float, asked: bool) -> None:
    """Its drive makes that one, a million times as loud: a reference's spur was drives that go to and fro (fourteenth plant)."""
    excitation = Excitation("amplitude_modulation", frequency_hz=1.5, index=0.3)
    found = [replace(r, command=replace(r.command, excitation=excitation)) for r in records(np.random.default_rng(2))]
    assert bool(list(_standing(found, hz))) is asked


@pytest.mark.parametrize(("channel", "more"), [("precession", 50.0), ("precession", -50.0), ("frequency", 50.0)])
def test_a_hum_of_which_the_slow_flow_says_more_is_none(channel: str, more: float) -> None:
    """What is added to a wave stands in all channels: a base that swayed was a hum of the axis that its wave swings to."""
    found = records(np.random.default_rng(0), hum=(7.0, 4e-6))
    tone = find_tone(pick_spectra(found), LINEAR)
    assert tone is not None
    said = spectral_effects(found, LINEAR, (), [Swing(channel, 7.02, tone.log_evidence + more, 9)])
    assert [e.name for e in said.effects] == (["mains_pickup"] if more < 0.0 else [])
    assert spectral_effects(found, LINEAR, (), [Swing(channel, 8.5, tone.log_evidence + more, 9)]).effects


def test_a_steady_swing_of_the_frequency_is_a_spur_of_the_reference() -> None:
    """A resonance that follows its temperature is slower; and a gain is something else."""
    found = records(np.random.default_rng(0))
    steady = Swing("frequency", 3.2, 53.0, 26, 1.8e-4, 1e-5, 1e-4)
    (spur,) = spectral_effects(found, LINEAR, (), [steady]).effects
    assert spur.name == "reference_spur"
    assert (spur.parameters["s"].value, spur.parameters["s"].sd) == pytest.approx((1.8e-4 / (6.4 * np.pi), 1e-5 / (6.4 * np.pi)))
    assert (spur.parameters["frequency_hz"].value, spur.parameters["frequency_hz"].sd) == (3.2, 1e-4)
    for other in (replace(steady, frequency_hz=0.4), replace(steady, channel="amplitude"), replace(steady, size=0.0)):
        assert spectral_effects(found, LINEAR, (), [other]).effects == ()
    assert spectral_effects(found, LINEAR, ["reference_spur"], [steady]).effects == ()


def test_a_steady_swing_of_the_precession_is_a_base_that_sways() -> None:
    """A wave turns by minus kappa times the rate. What has a size of its own in each recording is no sway of one base."""
    found = records(np.random.default_rng(0))
    steady = Swing("precession", 1.7, 75.0, 30, 1e-4, 4e-6, 1e-4, 0.3, 0.1)
    (sway,) = spectral_effects(found, LINEAR, (), [steady]).effects
    assert sway.name == "base_sway"
    kappa = LINEAR.angular_gain
    assert (sway.parameters["r"].value, sway.parameters["r"].sd) == pytest.approx((1e-4 / kappa, 4e-6 / kappa))
    assert sway.parameters["phase_rad"].value == pytest.approx(0.3 - np.pi)
    for other in (replace(steady, channel="quadrature"), replace(steady, size=0.0)):
        assert spectral_effects(found, LINEAR, (), [other]).effects == ()
    assert spectral_effects(found, LINEAR, ["base_sway"], [steady]).effects == ()


def test_a_tone_within_the_signal_is_one_of_vibration_and_no_swing() -> None:
    found = records(np.random.default_rng(0))
    tone = Tone("external_tone", ("pickoff_interference",), 15012.5, 0.01, np.array([4e-7, 2e-7]), np.array([1e-8, 1e-8]), 90.0, 1e-8)
    swing = Swing("precession", 2.5, 40.0, 9, 1e-4, 4e-6, 1e-4, 0.3, 0.1)
    said = spectral_effects(found, LINEAR, (), [swing], tone)
    assert [e.name for e in said.effects] == ["external_tone"]
    assert said.effects[0].parameters["a_x"].value == 4e-7
    # all recordings are near it, and none is the less of use
    assert said.near == ()
    assert spectral_effects(found, LINEAR, ("external_tone",), [], tone).effects == ()
    louder = records(np.random.default_rng(0), hum=(40.0, 4e-5))
    assert [e.name for e in spectral_effects(louder, LINEAR, (), [], replace(tone, log_evidence=11.0)).effects] == ["mains_pickup"]


@pytest.mark.parametrize("at_rest", [12, 5, 0])
def test_beside_other_effects_a_base_sways_in_waves_that_stand_still_too(at_rest: int) -> None:
    steady = Swing("precession", 1.7, 75.0, 30, 1e-4, 4e-6, 1e-4, 0.3, 0.1)
    beside = spectral_effects(records(np.random.default_rng(0)), LINEAR, (), [steady])
    flows = quiet_flows(np.random.default_rng(1), [3.0 + 17.3 * k for k in range(12)], 900)
    swayed = []
    for k, flow in enumerate(flows):
        t = flow.start_s + flow.row_s * np.arange(900)
        rate = {**flow.rate, "precession": flow.rate["precession"] + 2e-5 * np.cos(2.0 * np.pi * 1.7 * t)}
        swayed.append(replace(flow, rate=rate, excited_hz=0.0 if k < at_rest else 0.23))
    left = _swaying_at_rest(beside, swayed, [steady])
    assert [e.name for e in left.effects] == (["base_sway"] if at_rest else [])
    assert {s.name: s.status for s in left.standings}["base_sway"] == ("present" if at_rest else "excluded")


@pytest.mark.parametrize("hum_v", [0.0, 2e-5])
def test_of_a_line_that_the_reference_follows_only_the_hum_is_left(hum_v: float) -> None:
    """A phase-locked loop that swings moves what is read by ``-i (omega - omega0) p``, and its frequency says so."""
    (r, *_) = records(np.random.default_rng(0), carrier_hz=(15000.0,), of_each=1)
    hz, swing_rad_s, data = 6.0, 2e-3, r.data.copy()
    t = data[:, 0]
    # x rings at 1 V about the mean frequency, held by its drive
    shift = swing_rad_s * np.cos(2.0 * np.pi * hz * t)
    made = solve_ivp(lambda at, p: -1.5 * (p - 1.0) - 1j * np.interp(at, t, shift) * p, (t[0], t[-1]), [1.0 + 0j], t_eval=t, max_step=0.002)
    pick = made.y[0] + hum_v * np.cos(2.0 * np.pi * hz * t)
    data[:, 2:6], data[:, 7], data[:, 10] = 0.0, 1.5 / 8.0, 15000.0 + shift / (2.0 * np.pi)
    data[:, 2], data[:, 3] = pick.real, pick.imag
    left = _volts(replace(r, data=data), hz, LINEAR, hum=True)
    assert left == pytest.approx([hum_v, 0.0], abs=0.02 * swing_rad_s / (2.0 * np.pi * hz))


@pytest.mark.parametrize("inside_hz", [0.75, 0.9])
def test_the_skirt_of_what_stands_nearer_to_the_carrier_is_no_line(inside_hz: float) -> None:
    """Bins nearer than 1.2 Hz belong to the wave: what stands there is told by the slow flow, not by the skirt that reaches beyond."""
    assert find_tone(pick_spectra(records(np.random.default_rng(3), hum=(inside_hz, 1e-4))), LINEAR) is None
    beyond = find_tone(pick_spectra(records(np.random.default_rng(3), hum=(1.5, 1e-4))), LINEAR)
    assert beyond is not None
    assert beyond.frequency_hz == pytest.approx(1.5, abs=0.02)


def walking(rng: np.random.Generator, **lines: tuple[float, float]) -> list[Recording]:
    """Records of a gain that walks: its power falls as the square of the distance from the carrier, and is the noise's at 3 Hz."""
    found = []
    for r in records(rng, of_each=9, **lines):
        data = r.data.copy()
        data[:, 2:4] *= 1.0 + 1.2e-7 * np.cumsum(rng.standard_normal(len(data)))[:, None]
        found.append(replace(r, data=data))
    return found


def test_a_floor_that_rises_towards_the_carrier_is_no_line() -> None:
    """An eleventh plant's healthy hemisphere hummed at 1.06 Hz: slow gains, which the floor's median over 6 Hz does not follow."""
    for seed in range(12):
        assert find_tone(pick_spectra(walking(np.random.default_rng(seed))), LINEAR) is None
    tone = find_tone(pick_spectra(walking(np.random.default_rng(0), hum=(1.6, 2e-5))), LINEAR)
    assert tone is not None
    assert tone.frequency_hz == pytest.approx(1.6, abs=0.02)


def test_a_tone_keeps_its_frequency_while_the_carrier_moves() -> None:
    tone = find_tone(pick_spectra(records(np.random.default_rng(2), tone=(15041.7, 3e-6))), LINEAR)
    assert tone is not None
    assert (tone.name, "pickoff_interference" in tone.alike) == ("external_tone", True)
    assert tone.frequency_hz == pytest.approx(15041.7, abs=0.1)
    # what moves the pick-off by that much at 41.7 Hz from resonance
    assert tone.volts[0] == pytest.approx(3e-6 * 2 * np.pi * 41.55 / 8.0, rel=0.1)


def test_a_tone_within_two_hertz_of_the_carrier_is_one() -> None:
    tone = find_tone(pick_spectra(records(np.random.default_rng(2), tone=(15001.6, 3e-6))), LINEAR)
    assert tone is not None
    assert tone.name == "external_tone"
    assert tone.frequency_hz == pytest.approx(15001.6, abs=0.1)


def test_an_image_of_the_carrier_by_a_converter_is_no_tone() -> None:
    carrier = 14990.0
    assert find_tone(pick_spectra(records(np.random.default_rng(3), carrier_hz=(carrier,), tone=(30000.0 - carrier, 1e-5))), LINEAR) is None


def test_the_mirror_of_a_side_band_is_no_tone() -> None:
    """What is modulated shows in the image of a converter, and the carrier that stands does not: 1.5 Hz beside where that would be."""
    carriers = (7249.46, 7249.50)
    line = 14400.0 - carriers[0] + 1.5
    plain = records(np.random.default_rng(3), carrier_hz=carriers, tone=(line, 1e-5))
    tone = find_tone(pick_spectra(plain), LINEAR)
    assert tone is not None
    assert tone.frequency_hz == pytest.approx(line, abs=0.15)
    excited = [
        replace(r, command=replace(r.command, excitation=Excitation("amplitude_modulation", frequency_hz=1.5, index=0.1))) for r in plain
    ]
    assert find_tone(pick_spectra(excited), LINEAR) is None


def test_a_mirror_is_folded_at_the_rows_rate_as_well() -> None:
    """Two carriers to 10 kHz and a side band, 71.4 Hz below: 53.6 Hz above it in 125 rows a second."""
    line = np.array([53.583])
    assert is_image(line, 5034.955, 1.0 / 12.0, 1.5, 125.0).all()
    assert not (is_image(line, 5034.955, 1.0 / 12.0, 1.5, 500.0) | is_image(line, 5034.955, 1.0 / 12.0, 0.0, 125.0)).any()


def test_an_image_of_another_temperature_is_no_witness() -> None:
    """A click in one record stands where the images of the warm records are: they saw their carriers, not the click."""
    rng, cold, warm, image = np.random.default_rng(3), 14990.0, 14993.4, 30000.0 - 14993.4
    plain = records(rng, carrier_hz=(cold,))
    plain[1] = records(rng, carrier_hz=(cold,), tone=(image, 1e-5))[1]
    for k in (4, 7):
        plain[k] = records(rng, carrier_hz=(warm,), tone=(image, 1e-5))[k]
    assert find_tone(pick_spectra(plain), LINEAR) is None


def test_a_line_in_one_record_alone_is_no_finding() -> None:
    rng = np.random.default_rng(4)
    plain = records(rng)
    plain[3] = records(rng, tone=(15041.7, 1e-5))[3]
    assert find_tone(pick_spectra(plain), LINEAR) is None


def test_a_noisy_gain_grows_with_the_amplitude_and_has_its_size() -> None:
    per_row = 3e-6
    recordings = records(np.random.default_rng(5), gain=per_row)
    found = spectral_effects(recordings, LINEAR)
    assert [e.name for e in found.effects] == ["amplitude_noise"]
    assert found.unknown is None
    size = found.effects[0].parameters["s"]
    assert abs(size.value - per_row * np.sqrt(2.0 / ROWS_HZ)) < 2.0 * size.sd
    assert not spectral_effects(recordings, LINEAR, ("amplitude_noise",)).effects


def test_a_noisy_clock_is_not_in_the_catalogue() -> None:
    found = spectral_effects(records(np.random.default_rng(6), clock=5e-6), LINEAR)
    assert not found.effects
    assert found.unknown is not None
    assert (found.unknown.location, found.unknown.phase) == ("electronics", "in quadrature")


def test_one_amplitude_cannot_tell_and_says_so() -> None:
    one = [replace(r, command=Command("ftr_x")) for r in records(np.random.default_rng(7))]
    status = {s.name: s.status for s in spectral_effects(one, LINEAR).standings}
    assert status["amplitude_noise"] == status["pickoff_quantisation"] == "not testable"
    assert status["external_tone"] == "excluded"


def test_products_of_a_line_grow_with_its_share_of_the_wave() -> None:
    """A tone of 2 mV beside a volt may leave much in the slow flow, one of 3 uV nothing."""
    strong, weak = (spectral_effects(records(np.random.default_rng(4), tone=(15041.7, v)), LINEAR) for v in (2e-3, 3e-6))
    assert [e.name for e in strong.effects] == [e.name for e in weak.effects] == ["external_tone"]
    tone = find_tone(pick_spectra(records(np.random.default_rng(4), tone=(15041.7, 2e-3))), LINEAR)
    assert tone is not None
    assert tone.share == pytest.approx(2e-3, rel=0.05)
    assert strong.products > 100.0
    assert weak.products < 1.0
    assert spectral_effects(records(np.random.default_rng(4)), LINEAR).products == 0.0


def two_found() -> Selection:
    none = np.zeros(0)
    candidates = [Candidate(name, {}, (), none) for name in ("duffing", "relaxation")]
    large, small = (Screened(c, gain, 1, gain / 2.0, none, none, 0.0, none) for c, gain in zip(candidates, (900.0, 90.0), strict=True))
    return Selection((large, small), (("duffing",), ("relaxation",)), (0.9, 0.8), None, {}, 1100.0, 110.0, 10)


def model_of(found: Selection, without: Callable[..., Screened | None]) -> Any:
    """A campaign that leaves 200 with the first effect alone."""
    first = [found.effects[0].candidate]
    return SimpleNamespace(screener_with=lambda chosen: SimpleNamespace(chi2=1100.0 - 900.0 * (chosen == first)), seen_without=without)


def test_what_may_be_a_product_of_a_line_is_not_named() -> None:
    found = two_found()
    model = model_of(found, lambda recordings, effect, others: effect)
    assert _without_products(model, found, SpectralEffects((), None, ())) == found
    left = _without_products(model, found, SpectralEffects((), None, (), 200.0))
    assert (left.effects, left.groups, left.probabilities, left.chi2_after) == (found.effects[:1], (("duffing",),), (0.9,), 200.0)


def test_a_tone_beside_an_open_drive_is_no_other_mode() -> None:
    """A foreign carrier 0.33 Hz from an open drive stood in the means of its records: a mode at that distance fits them."""
    found = two_found()

    def without(recordings: tuple[int, ...], effect: Screened, others: list[Candidate]) -> Screened | None:
        assert effect.candidate not in others
        return effect if not recordings or effect.name == "duffing" else replace(effect, gain=4.0, log_evidence=2.0)

    model = model_of(found, without)
    assert _without_products(model, found, SpectralEffects((), None, ())) == found
    assert _without_products(model, found, SpectralEffects((), None, (), near=(3,))).effects == found.effects[:1]


def test_records_near_a_tone_are_told() -> None:
    made = records(np.random.default_rng(4), carrier_hz=(15000.0, 15020.0), tone=(15020.3, 3e-4))
    found = spectral_effects(made, LINEAR)
    assert [e.name for e in found.effects] == ["external_tone"]
    assert found.near == (1, 3, 5, 7)
