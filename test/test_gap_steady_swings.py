"""What goes to and fro with one phase through a whole campaign: told by all recordings together, and by no noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from flow_samples import ROW_S, WALK, quiet_flows
from numpy.typing import NDArray
from scipy.signal import lfilter

from gyro_calib.gap import steady_swings
from gyro_calib.gap.evidence import CHANNELS
from gyro_calib.gap.flow_left import FlowLeft
from gyro_calib.gap.steady_swings import find_steady_swing, swings_at_rest
from gyro_calib.gap.swings import Kind, find_swing

ROWS, COUNT = 900, 12
#: about every seventeen seconds a recording of nine
STARTS_S = 3.21 + 17.0 * np.arange(COUNT) + 3.0 * np.sin(7.0 * np.arange(COUNT))
SWING_HZ = 0.43


def flows(rng: np.random.Generator) -> list[FlowLeft]:
    """Recordings at rest of two kinds."""
    return quiet_flows(rng, STARTS_S.tolist(), ROWS)


def swinging(of: list[FlowLeft], channel: str, size: float, phases: NDArray[np.float64], hz: float = SWING_HZ) -> list[FlowLeft]:
    """With a swing of these phases at the zero of the device's clock, as those recordings that ``phases`` has numbers for hold it."""
    found = []
    for flow, phase in zip(of, phases, strict=True):
        t = flow.start_s + ROW_S * np.arange(ROWS)
        more = 0.0 if np.isnan(phase) else size * np.sin(2.0 * np.pi * hz * t + phase)
        found.append(replace(flow, rate={**flow.rate, channel: flow.rate[channel] + more}))
    return found


def test_noise_alone_goes_nowhere() -> None:
    for seed in range(12):
        assert find_steady_swing(flows(np.random.default_rng(seed))) is None


@pytest.mark.parametrize("channel", CHANNELS)
def test_all_recordings_together_tell_what_none_of_them_does(channel: str) -> None:
    """A bench that rocked every 2.3 s was *none*: in records of eight seconds it is near their mean and twice their noise."""
    rocked = swinging(flows(np.random.default_rng(1)), channel, 6e-6, np.full(COUNT, 0.6))
    assert find_swing(rocked) is None
    found = find_steady_swing(rocked)
    assert found is not None
    assert found.channel == channel
    assert found.records == COUNT
    # as fine as the campaign is long, not as a recording is
    assert found.frequency_hz == pytest.approx(SWING_HZ, abs=0.3 / (STARTS_S[-1] - STARTS_S[0]))
    assert "to and fro every 2.3" in found.unknown().form


def test_what_begins_anew_in_each_recording_is_not_steady() -> None:
    """A hundred times as large it is a floor that stands higher there, whatever it is about."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        anew = rng.uniform(0.0, 2.0 * np.pi, COUNT)
        assert find_steady_swing(swinging(flows(rng), "precession", 1e-4, anew)) is None


def test_one_disturbed_recording_is_not_the_campaign() -> None:
    phases = np.full(COUNT, np.nan)
    phases[4] = 0.6
    assert find_steady_swing(swinging(flows(np.random.default_rng(3)), "precession", 4e-5, phases)) is None


def told_again(size_at_rest: float, at_rest: int, seed: int) -> tuple[bool, bool]:
    """Whether recordings at rest find a swing of all others by themselves, and whether they tell it again."""
    moved = [replace(f, excited_hz=0.0 if k < at_rest else 1.3) for k, f in enumerate(flows(np.random.default_rng(seed)))]
    everywhere = swinging(moved, "precession", 2e-5, np.full(COUNT, 0.6))
    swing = find_steady_swing(everywhere)
    assert swing is not None
    held = swinging(moved, "precession", size_at_rest, np.full(COUNT, 0.6))[:at_rest] + everywhere[at_rest:]
    return find_steady_swing([f for f in held if f.is_still]) is not None, swings_at_rest(held, swing)


def test_few_recordings_at_rest_tell_again_what_all_tell() -> None:
    """A pedestal that swayed by 6.7e-5 rad/s was dropped beside a small Duffing: six at rest, less the loudest, found nothing."""
    for seed in range(6):
        assert told_again(2e-5, 5, seed) == (False, True)


def test_what_swings_in_moved_waves_alone_is_not_at_rest() -> None:
    assert sum(told_again(0.0, 5, seed)[1] for seed in range(12)) <= 1
    assert told_again(2e-5, 3, 1) == (False, False)


def test_two_recordings_of_a_kind_whose_floor_is_mistaken_are_not_the_campaign() -> None:
    """Near their mean all wander alike, but of two of twelve no bin that tells the floor says so: their phases agree, within a tenth."""
    rng = np.random.default_rng(6)
    quiet = flows(rng)
    for k in range(10):
        wander = quiet[k].rate["frequency"] + 100.0 * WALK * np.cumsum(rng.standard_normal(ROWS))
        quiet[k] = replace(quiet[k], rate={**quiet[k].rate, "frequency": wander})
    for k in (10, 11):
        quiet[k] = replace(quiet[k], kind=("ftr_y", 0.0, False))
    phases = np.full(COUNT, np.nan)
    phases[10:] = 0.6, 0.7
    assert find_steady_swing(swinging(quiet, "frequency", 5e-5, phases, 0.3)) is None


def test_a_campaign_of_days_is_asked_for_no_more_frequencies_than_one_of_minutes() -> None:
    """All that one tells apart up to 12 Hz would be a hundred million."""
    days = [replace(f, start_s=1e4 * f.start_s) for f in flows(np.random.default_rng(5))]
    assert find_steady_swing(days) is None
    hours = [replace(f, start_s=60.0 * f.start_s) for f in flows(np.random.default_rng(5))]
    found = find_steady_swing(swinging(hours, "precession", 1e-5, np.full(COUNT, 0.6)))
    assert found is not None
    # recordings at even distances tell it but for a multiple of one over these
    assert found.frequency_hz == pytest.approx(SWING_HZ, abs=0.5 / (ROW_S * ROWS))


def test_few_recordings_tell_nothing() -> None:
    rocked = swinging(flows(np.random.default_rng(4)), "precession", 1e-4, np.full(COUNT, 0.6))
    assert find_steady_swing(rocked) is not None
    assert find_steady_swing(rocked[:5]) is None


def test_size_frequency_and_phase_are_told_with_their_sd() -> None:
    errors = []
    for seed in range(16):
        found = find_steady_swing(swinging(flows(np.random.default_rng(seed)), "precession", 8e-6, np.full(COUNT, 0.6)))
        assert found is not None
        late = math.remainder(found.phase_rad - 0.6 + 0.5 * math.pi, 2.0 * math.pi)
        differences = found.size - 8e-6, found.frequency_hz - SWING_HZ, late
        errors.append(np.divide(differences, (found.size_sd, found.frequency_sd_hz, found.phase_sd_rad)))
    assert np.all(np.abs(np.mean(errors, axis=0)) < 1.0)
    assert np.all((np.std(errors, axis=0) > 0.3) & (np.std(errors, axis=0) < 2.0))


@pytest.mark.parametrize("excited_hz", [0.1, 0.5, 1.0])
def test_a_side_band_hides_no_swing_between_its_harmonics(excited_hz: float) -> None:
    """Its harmonics are a thousand times as loud: a reference's spur at 3.2 Hz lay within three bins of some of them."""
    t = ROW_S * np.arange(ROWS)
    harmonics = sum((1e-2 * np.cos(2.0 * np.pi * k * excited_hz * t + k) for k in (1, 2, 3)), np.zeros(ROWS))
    hz = 1.62
    loud = [
        replace(flow, excited_hz=excited_hz, rate={c: x + harmonics for c, x in flow.rate.items()})
        for flow in swinging(flows(np.random.default_rng(5)), "frequency", 2e-5, np.full(COUNT, 1.1), hz)
    ]
    found = find_steady_swing(loud)
    assert found is not None
    assert found.channel == "frequency"
    assert found.frequency_hz == pytest.approx(hz, abs=0.3 / (STARTS_S[-1] - STARTS_S[0]))
    assert found.size == pytest.approx(2e-5, abs=6.0 * found.size_sd)


def test_a_wave_that_turns_hides_no_swing_and_is_none() -> None:
    """What goes with its azimuth has a size of its own in each recording, even of a wave that turns on between them: that one is steady."""
    turning = []
    for flow in flows(np.random.default_rng(6)):
        azimuth = 2.0 * np.pi * 0.23 * (flow.start_s + ROW_S * np.arange(ROWS))
        more = 1e-5 * np.cos(2.0 * azimuth) + 1e-5 * np.sin(4.0 * azimuth)
        rate = {c: x + more for c, x in flow.rate.items()}
        turning.append(replace(flow, turning_hz=0.23, azimuth_rad=azimuth, rate=rate))
    assert find_steady_swing(turning) is None
    assert find_steady_swing([replace(flow, turning_hz=0.0) for flow in turning]) is not None
    found = find_steady_swing(swinging(turning, "precession", 1e-5, np.full(COUNT, 0.6), 1.17))
    assert found is not None
    assert (found.channel, found.frequency_hz) == ("precession", pytest.approx(1.17, abs=0.3 / (STARTS_S[-1] - STARTS_S[0])))


def test_a_floor_that_is_lower_than_its_law_hides_no_swing() -> None:
    """White down to where a loop's hump is, and a quarter of that below, where a pier sways every few seconds."""
    rng = np.random.default_rng(8)
    pole = 0.985 * np.exp(2j * np.pi * 1.2 * ROW_S)
    humps = [lfilter([1.2e-7], [1.0, -2.0 * pole.real, abs(pole) ** 2], rng.standard_normal(ROWS)) for _ in range(COUNT)]
    pairs = zip(flows(rng), humps, strict=True)
    humped = [replace(flow, rate={**flow.rate, "precession": flow.rate["precession"] + hump}) for flow, hump in pairs]
    assert find_steady_swing(humped) is None
    found = find_steady_swing(swinging(humped, "precession", 8e-6, np.full(COUNT, 0.6), 0.21))
    assert found is not None
    assert found.frequency_hz == pytest.approx(0.21, abs=0.3 / (STARTS_S[-1] - STARTS_S[0]))


def test_records_whose_floor_is_believed_far_too_high_do_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """They tell next to nothing, and that all are below their law is the law's: three whose noise agrees are three."""
    floors_of = steady_swings.floors_of

    def mistaken(kinds: Sequence[Kind], grid: NDArray[np.float64]) -> NDArray[np.float64]:
        labels = [flow.label for kind in kinds for flow in kind.flows]
        return floors_of(kinds, grid) * np.array([1.0 if label in ("run_0", "run_1", "run_2") else 300.0 for label in labels])[:, None]

    monkeypatch.setattr(steady_swings, "floors_of", mistaken)
    for seed in range(4):
        assert find_steady_swing(flows(np.random.default_rng(seed))) is None
    monkeypatch.setattr(steady_swings, "_TELLS", 0.0)
    assert find_steady_swing(flows(np.random.default_rng(0))) is not None


def turned(of: list[FlowLeft], turns_hz: float) -> list[FlowLeft]:
    """Waves that stand at azimuths of all kinds or turn from there."""
    t = ROW_S * np.arange(ROWS)
    return [
        replace(flow, azimuth_rad=0.7 * k + 2.0 * np.pi * turns_hz * t, turning_hz=turns_hz, kind=(*flow.kind[:2], bool(turns_hz)))
        for k, flow in enumerate(of)
    ]


@pytest.mark.parametrize("turns_hz", [0.0, 0.02])
@pytest.mark.parametrize(("channel", "shape"), [("quadrature", "sin 2 psi"), ("quadrature", "cos 2 psi"), ("frequency", "cos 2 psi")])
def test_what_swings_on_one_axis_is_told_by_waves_of_all_azimuths(channel: str, shape: str, turns_hz: float) -> None:
    """A ripple of the x bias at 0.37 Hz was none: across a wave its stiffness goes as ``sin 2 psi``, of no one sign through a turn."""
    course = np.sin if shape.startswith("sin") else np.cos
    rippling = []
    for flow in turned(flows(np.random.default_rng(4)), turns_hz):
        t = flow.start_s + ROW_S * np.arange(ROWS)
        more = 2.5e-5 * course(2.0 * flow.azimuth_rad) * np.cos(2.0 * np.pi * SWING_HZ * t + 0.4)
        rippling.append(replace(flow, rate={**flow.rate, channel: flow.rate[channel] + more}))
    found = find_steady_swing(rippling)
    assert found is not None
    assert (found.channel, found.shape) == (channel, shape)
    assert found.frequency_hz == pytest.approx(SWING_HZ, abs=0.3 / (STARTS_S[-1] - STARTS_S[0]))
    assert abs(found.size - 2.5e-5) < 4.0 * found.size_sd < 2.5e-5
    assert abs(math.remainder(found.phase_rad - 0.4, 2.0 * math.pi)) < 4.0 * found.phase_sd_rad
    assert not found.swings_the_phase
    assert "a split that goes to and fro every 2.3" in found.unknown().form
    assert shape in found.unknown().form


@pytest.mark.parametrize("turns_hz", [0.0, 0.02])
def test_noise_in_waves_of_all_azimuths_goes_nowhere(turns_hz: float) -> None:
    for seed in range(8):
        assert find_steady_swing(turned(flows(np.random.default_rng(seed)), turns_hz)) is None


def on_two_axes(of: list[FlowLeft], louder: float) -> list[FlowLeft]:
    """Waves along x and along y in turn, those along x with a louder floor."""
    of_axis = [(k % 2, flow) for k, flow in enumerate(of)]
    along = [(y, replace(flow, azimuth_rad=np.full(ROWS, 0.5 * np.pi * y), kind=(f"ftr_{'xy'[y]}", 0.0, False))) for y, flow in of_axis]
    return [replace(flow, rate={c: x if y else louder * x for c, x in flow.rate.items()}) for y, flow in along]


def test_a_gain_that_ripples_on_one_axis_is_told_by_the_waves_along_it() -> None:
    """Half of a ring's waves lie on the other axis, which is quieter and holds nothing: neither alike nor of opposite sign is it there."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        starts_s = np.concatenate([STARTS_S, STARTS_S + 240.0])
        waves = on_two_axes(quiet_flows(rng, starts_s.tolist(), ROWS), 2.5)
        assert find_steady_swing(waves) is None
        rippling = []
        for flow in waves:
            t = flow.start_s + ROW_S * np.arange(ROWS)
            more = 2.5e-5 * np.cos(flow.azimuth_rad) ** 2 * np.cos(2.0 * np.pi * 0.85 * t + 0.4)
            rippling.append(replace(flow, rate={**flow.rate, "amplitude": flow.rate["amplitude"] + more}))
        found = find_steady_swing(rippling)
        assert found is not None
        assert (found.channel, found.shape, found.records) == ("amplitude", "cos^2 psi", COUNT)
        assert abs(found.size - 2.5e-5) < 4.0 * found.size_sd
        assert "gain or loss of the axes that goes to and fro every 1.18 s, in waves of azimuth psi as cos^2 psi" in found.unknown().form
