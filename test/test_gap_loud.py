"""A recording that is louder than others of its kind."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from gyro_calib.gap import loud as loud_module
from gyro_calib.gap.diagnosis import FoundEffect
from gyro_calib.gap.evidence import CHANNELS
from gyro_calib.gap.loud import Loud
from gyro_calib.gap.model import CampaignModel
from gyro_calib.gap.noise_law import Lines, NoiseLaw
from gyro_calib.gap.system import Solution

LINES = Lines(np.array([0.02, 0.1, 0.2]), np.array([0.01, 0.01, 0.04]), 1.0, np.array([True, False, False]))


@pytest.fixture(autouse=True)
def _with_open_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loud_module, "open_drive", lambda evidence: True)


def model(
    excess: dict[tuple[int, str], float],
    turned: int = -1,
    *,
    warmed: int = -1,
    louder: float = 1.0,
    read_every: int = 1,
    channels: tuple[str, ...] = CHANNELS,
) -> CampaignModel:
    warm = np.linspace(25.0, 33.0, 1000)
    recordings = [
        SimpleNamespace(
            index=k,
            signal=SimpleNamespace(lhs=np.zeros(20, dtype=complex)),
            recording=SimpleNamespace(
                label=f"run_{k}",
                extras={"applied_rate": {}} if k == turned else {},
                temperature_degc=np.repeat(warm[::read_every], read_every)[: warm.size],
                sample_rate_hz=100.0,
            ),
            is_warming=k == warmed,
            is_wave=True,
            parent_role="ftr_x",
            noise_key=lambda channel, k=k: ("ftr_x, warming" if k == warmed else "ftr_x", channel),
            lines=lambda channel: LINES,
        )
        for k in range(4)
    ]
    rest = NoiseLaw((1e-11, 0.0, 5e-11, 0.0))
    noise = {("ftr_x", channel): rest for channel in CHANNELS}
    noise |= {("ftr_x, warming", channel): rest.times(louder if channel in channels else 1.0) for channel in CHANNELS}
    base = SimpleNamespace(residual=np.ones(40 * len(recordings)))
    return cast(CampaignModel, SimpleNamespace(evidence=recordings, excess=excess, noise=noise, base=base))


def loudest(campaign: CampaignModel, left: float = 1.0, channel: str = "") -> Loud | None:
    """With effects that leave a share of the squares of a channel."""
    residual = campaign.base.residual.reshape(-1, 4, 10).copy()
    if channel:
        residual[:, ("amplitude", "precession", "frequency", "quadrature").index(channel)] *= np.sqrt(left)
    return loud_module.loudest(campaign, cast(Solution, SimpleNamespace(residual=residual.ravel())))


@pytest.mark.parametrize("excess", [{}, {(0, "amplitude"): 4.4, (3, "quadrature"): 7.9}])
def test_recordings_of_one_kind_differ_by_some_times_their_noise(excess: dict[tuple[int, str], float]) -> None:
    assert loudest(model(excess)) is None


def test_the_loudest_is_named_with_its_channel_and_what_to_do() -> None:
    loud = loudest(model({(1, "amplitude"): 42.9, (1, "quadrature"): 10.7, (2, "precession"): 3.9}))
    assert loud is not None
    assert "run_1 holds 43 times the noise of its kind (amplitude)" in loud.warning()
    assert "Record it again" in loud.warning()
    unknown = loud.unknown()
    assert (unknown.depends_on, unknown.nearest) == ("recording", "")


@pytest.mark.parametrize("changing", ["side band", "ring-down", ""])
@pytest.mark.parametrize("told", [False, True])
def test_what_a_delay_does_where_the_drive_changes_is_not_testable_without_an_open_one(
    changing: str, told: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a ring recorded eight times, with no open drive, a delay of 44 us was what one side band alone held, 39 times its noise."""
    monkeypatch.setattr(loud_module, "open_drive", lambda evidence: told)
    of_one = model({(1, "quadrature"): 39.2})
    kind, mode = "amplitude_modulation" if changing == "side band" else "none", "ring_down" if changing == "ring-down" else "ftr_y"
    cast(Any, of_one.evidence)[1].recording.command = SimpleNamespace(excitation=SimpleNamespace(kind=kind, axis="y"), mode=mode)
    loud = loudest(of_one)
    assert loud is not None
    assert loud.untested == bool(changing and not told)
    assert ("nothing tells those without an open drive of both axes" in loud.warning()) == loud.untested


def test_a_small_effect_beside_it_is_not_its_cause() -> None:
    """Of a preamplifier that changes its range one side band held 23 times its noise, and a dry friction of 69 was the verdict."""
    loud = loudest(model({(1, "amplitude"): 23.0}))
    assert loud is not None
    assert loud.gain == loud.unknown().gain == 23.0 * 20
    small, large = (cast(FoundEffect, SimpleNamespace(gain=gain)) for gain in (69.0, 1e4))
    assert [loud.may_be_of(effects) for effects in ([], [small], [small, large])] == [False, False, True]


def test_a_resonance_wanders_now_more_now_less() -> None:
    """One of eight records of a healthy unit of another plant held 9 times the noise of its frequency: 3 mK of the resonator."""
    assert loudest(model({(1, "frequency"): 9.2})) is None


def test_a_rate_table_does_things_besides_its_log() -> None:
    assert loudest(model({(2, "precession"): 50.0}, turned=2)) is None


def test_what_a_moving_temperature_holds_beyond_all_effects_is_no_noise() -> None:
    """Of one or two records each by itself the noise is what they hold: it is measured against the records at rest."""
    for healthy, channels in ((87.0, CHANNELS), (325.0, ("amplitude",))):
        assert loudest(model({}, warmed=2, louder=healthy, channels=channels)) is None
    strange = {(2, "amplitude"): 7.0}
    loud = loudest(model(strange, warmed=2, louder=780.0))
    assert loud is not None
    assert "run_2 holds 5460 times the noise of recordings at rest (amplitude)" in loud.warning()
    assert loud.unknown().depends_on == "temperature"
    # between readings of a second nobody knows how warm it was
    assert loudest(model(strange, warmed=2, louder=780.0, read_every=100)) is None


@pytest.mark.parametrize("across", ["precession", "quadrature"])
def test_across_a_wave_a_moving_temperature_makes_less_noise(across: str) -> None:
    """Along it a late thermometer shows in the damping. A damping that peaks at one temperature was noise, 443 times that at rest."""
    loud = loudest(model({}, warmed=2, louder=443.0, channels=(across,)))
    assert loud is not None
    assert (loud.channel, loud.warmed) == (across, True)
    assert loudest(model({}, warmed=2, louder=34.0, channels=(across,))) is None


def test_a_thermometer_may_err_in_a_frequency() -> None:
    at_rest = model({}, warmed=2, louder=1.0)
    loud_frequency = {**at_rest.noise, ("ftr_x, warming", "frequency"): at_rest.noise["ftr_x", "frequency"].times(1e6)}
    thermal = SimpleNamespace(evidence=at_rest.evidence, excess={}, noise=loud_frequency, base=at_rest.base)
    assert loudest(cast(CampaignModel, thermal)) is None


def test_what_an_effect_explains_of_a_recording_is_not_loud() -> None:
    """Beside a nonlinear damping that closed all of the gap the one loud amplitude was still a disturbance of 24 times its noise."""
    strange = {(1, "amplitude"): 24.0, (1, "quadrature"): 3.0}
    assert loudest(model(strange), 0.9, "amplitude") is not None
    assert loudest(model(strange), 0.04, "amplitude") is None
    assert loudest(model({}, warmed=2, louder=443.0, channels=("precession",)), 0.01, "precession") is None
