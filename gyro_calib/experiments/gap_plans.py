"""The campaigns from which a gap between device and model is diagnosed: everything that tells one effect from another, in a drawn order.

An effect shows in what is varied: amplitude, side band, azimuth, volts, temperature, rate, distance of an open drive from resonance. So
each is varied on its own, both axes alike, and static or free records are repeated from beginning to end: what they differ by is noise,
and what they drift by is not taken for an effect of whatever happened to be recorded late. For the same reason the order is drawn, and
every recording says from which seed.

What needs a chamber or a rate table is left out on an instrument without (``abilities``), and said in ``Plan.left_out``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import DataError
from ..recording.applied_rate import words_of_steps
from ..recording.command import Command, Excitation, Setpoints
from .plan import Limits, Plan, Step
from .plans import CUBIC_AMPLITUDES, FEEDTHROUGH_HZ, QUALITIES, mission_mode, open_steps
from .whole_angle_plans import (
    ABOVE_DRIFT,
    MARGIN,
    MOST_SHARE,
    PLACE_SETTLE_S,
    UNBALANCE,
    nominal_decay,
    nominal_gain,
    precession_step,
    scale_factor_steps,
)

__all__ = ["GAP_ABILITIES", "GAP_PLANS", "gap_ftr_plan", "gap_plan", "gap_whole_angle_plan"]


@dataclass(frozen=True)
class GapQuality:
    """Durations of a campaign [s].

    Parameters
    ----------
    lines_hz : tuple of float
        Side bands; a record holds whole periods of each.
    side_s, static_s, thermal_s, dwell_s : float
        A side-band record, a static one, one in which the temperature moves, one rate of the table.
    speed_deg_s : float
        Precession of the wave [deg/s].
    """

    lines_hz: tuple[float, ...]
    side_s: float
    static_s: float
    thermal_s: float
    dwell_s: float
    speed_deg_s: float


_QUALITIES: dict[str, GapQuality] = {
    "quick": GapQuality((0.5, 1.5), 4.0, 4.0, 8.0, 1.0, 10.0),
    "standard": GapQuality((0.1, 0.5, 1.0, 1.5), 10.0, 10.0, 16.0, 2.0, 7.5),
    "fine": GapQuality((0.1, 0.5, 1.0, 1.5), 20.0, 30.0, 30.0, 5.0, 3.0),
}
#: abilities of an instrument that a campaign makes use of, and what is lost without
GAP_ABILITIES: dict[str, str] = {
    "temperature": "the temperature steps (no chamber or heater): effects of temperature cannot be tested",
    "applied_rate": "the rate steps (no rate table): effects of rotation cannot be tested",
}
#: modulation index of the side bands, times that static records are repeated, temperature step [K], largest rate of the table [rad/s]
INDEX, REPEATS, STEP_K, TABLE_RAD_S = 0.1, 3, 8.0, math.radians(50.0)
#: a gyro with an effect turns its rate by more than one without as its drives change, and the campaign must not end for that
_LIMITS = Limits(base_rate_rad_s=5.0 * Limits().base_rate_rad_s)
#: share of the converters' ranges that amplitude and rebalance may take
_MOST_OF_ADC, _MOST_OF_DAC = 0.9, 0.4
#: the wave's conditions, each in both senses: amplitude and volts over the nominal ones; the nominal one is repeated
WAVE_CONDITIONS = ((1.0, 1.0), (1.0, 1.0), (0.6, 1.0), (1.4, 1.0), (1.0, 0.5), (1.0, 1.5))
#: by how much of a period of 4 theta one sense of a pair turns further than the other, so that the next free run has another azimuth
_ONWARD = 0.25
#: for the loops after a change of the oscillator axis and after another command; of a resonator that rings on for minutes [s]
_SETTLE_S, _SLOW_SETTLE_S = (3.0, 1.5), (PLACE_SETTLE_S, 4.0)
#: turns from axis to axis that a wave is given: its drive is not at the end of its range all the way
_TURNS = 2.0


def gap_plan(factory: Mapping[str, Any], **options: Any) -> Plan:
    """The campaign that the mission of ``factory`` needs: :func:`gap_ftr_plan` or :func:`gap_whole_angle_plan`, ``options`` as of these."""
    return (gap_whole_angle_plan if mission_mode(factory) == "whole_angle" else gap_ftr_plan)(factory, **options)


def gap_ftr_plan(
    factory: Mapping[str, Any],
    *,
    quality: str = "standard",
    limits: Limits | None = None,
    seed: int = 0,
    abilities: Collection[str] = (),
    temperature_degc: float | None = None,
) -> Plan:
    """Force to rebalance: static and side-band records of both axes at three amplitudes, loops off, temperature and rate steps.

    Parameters
    ----------
    factory : mapping
        Factory data of the unit.
    quality : {"quick", "standard", "fine"}
    limits : Limits, optional
        Abort conditions.
    seed : int
        Draws the order.
    abilities : collection of str
        Of the instrument: ``"temperature"``, ``"applied_rate"``. What needs another is left out.
    temperature_degc : float, optional
        Where the unit stands, from which the temperature steps go up and come back [degC]; default: the factory's reference.

    Raises
    ------
    DataError
        Unknown quality, or a nominal amplitude that the converter does not take.
    """
    q, rng = _quality(quality), np.random.default_rng(seed)
    shares = _amplitude_shares(factory)
    modulated = [_side(factory, axis, share, line, q) for axis in "xy" for share in shares for line in q.lines_hz]
    rounds = [
        _drawn([*steps, *(_static(factory, axis, q, f"static_{axis}_{k}") for axis in "xy")], rng)
        for k, steps in enumerate(_dealt(modulated, rng))
    ]
    blocks = [_open_block(factory, quality, rng)]
    if "temperature" in abilities:
        low, high = _temperatures(factory, temperature_degc)
        ramp = 0.75 * q.thermal_s
        a, b = _drawn("xy", rng)
        blocks.append(
            [
                replace(_static(factory, a, q, f"thermal_{a}_up"), duration_s=q.thermal_s, temperature_degc=high, temperature_ramp_s=ramp),
                *(_static(factory, axis, q, f"thermal_{axis}_hot") for axis in (b, a)),
                *_warm(blocks[0])[1:],
                replace(_static(factory, b, q, f"thermal_{b}_down"), duration_s=q.thermal_s, temperature_degc=low, temperature_ramp_s=ramp),
            ]
        )
    if "applied_rate" in abilities:
        rate = min(TABLE_RAD_S, _MOST_OF_DAC * _dac_v(factory) / _nominal_scale_factor(factory))
        blocks.append([_turned(_static(factory, axis, q, f"table_{axis}"), q, rate) for axis in _drawn("xy", rng)])
    steps = _settled(_between(rounds, blocks, rng), factory)
    return _plan("gap-ftr", steps, factory, quality, limits, seed, abilities)


def gap_whole_angle_plan(
    factory: Mapping[str, Any],
    *,
    quality: str = "standard",
    limits: Limits | None = None,
    seed: int = 0,
    abilities: Collection[str] = (),
    temperature_degc: float | None = None,
) -> Plan:
    """Whole angle: free runs at four azimuths, precession of both senses at several amplitudes and volts over whole periods of 4 theta,
    ring-down, ring-up, stiffness steps, static force to rebalance, loops off, temperature and rate steps.

    Parameters
    ----------
    factory, quality, limits, seed, abilities, temperature_degc
        As of :func:`gap_ftr_plan`.

    Raises
    ------
    DataError
        Unknown quality, factory data without nominal scale factor, or a drive that cannot ring the wave up.
    """
    q, rng = _quality(quality), np.random.default_rng(seed)
    speed = _speed_deg_s(factory, q)
    pairs = _dealt(list(enumerate(WAVE_CONDITIONS)), rng, parts=2)
    rounds = [
        _wave_round(factory, axis, onward, pair, q, speed, rng)
        for axis, onward, pair in zip(_drawn("xy", rng), (1.0, -1.0), pairs, strict=True)
    ]
    blocks = [_open_block(factory, quality, rng, body=False), *_ring_blocks(factory, quality, q)]
    if "temperature" in abilities:
        low, high = _temperatures(factory, temperature_degc)
        up, hot, down = (
            precession_step(factory, f"thermal_{name}", sign * speed, 1) for name, sign in (("up", 1.0), ("hot", -1.0), ("down", 1.0))
        )
        up = replace(up, temperature_degc=high, temperature_ramp_s=0.75 * up.duration_s)
        down = replace(down, temperature_degc=low, temperature_ramp_s=0.75 * down.duration_s)
        warm = [up, _free(factory, "thermal_free", q), hot, *_warm(blocks[0])]
        blocks.append([_static(factory, "x", q, "static_x_thermal"), *warm, down])
    if "applied_rate" in abilities:
        blocks.append([_turned(_free(factory, f"table_{k}", q), q, TABLE_RAD_S) for k in range(2)])
    steps = _settled(_between(rounds, blocks, rng), factory)
    return _plan("gap-whole-angle", steps, factory, quality, limits, seed, abilities)


GAP_PLANS: dict[str, Callable[..., Plan]] = {"gap-ftr": gap_ftr_plan, "gap-whole-angle": gap_whole_angle_plan}


# -- steps ------------------------------------------------------------------------------------------------------------------------------


def _static(factory: Mapping[str, Any], axis: str, q: GapQuality, label: str) -> Step:
    return Step(label, Command(f"ftr_{axis}", setpoints=Setpoints(_amplitude(factory))), q.static_s)


def _side(factory: Mapping[str, Any], axis: str, share: float, line: float, q: GapQuality) -> Step:
    excitation = Excitation("amplitude_modulation", line, INDEX)
    command = Command(f"ftr_{axis}", excitation, Setpoints(share * _amplitude(factory)))
    return Step(f"side_{axis}_a{share:.3g}_{line:g}hz", command, q.side_s)


def _free(factory: Mapping[str, Any], label: str, q: GapQuality) -> Step:
    return Step(label, Command("whole_angle", setpoints=Setpoints(_amplitude(factory))), q.static_s)


def _turned(step: Step, q: GapQuality, rate_rad_s: float) -> Step:
    """The step on a table that stands, turns one way, stands, turns the other way, stands."""
    words = words_of_steps([k * q.dwell_s for k in range(5)], [0.0, rate_rad_s, 0.0, -rate_rad_s, 0.0])
    return replace(step, duration_s=5.0 * q.dwell_s, applied_rate=words)


def _open_block(factory: Mapping[str, Any], quality: str, rng: np.random.Generator, *, body: bool = True) -> list[Step]:
    """Loops off, after the record that locates the resonance."""
    locate, *steps = open_steps(replace(QUALITIES[quality], open_s={"quick": 1.0, "standard": 2.0, "fine": 5.0}[quality]), factory)
    # a wave that was brought down to be opened says nothing but where its resonance is
    locate = replace(locate, kept=locate.command.setpoints.amplitude_v > 0.5 * _amplitude(factory))
    return [locate, *_drawn([s for s in steps if body or s.command.excitation.kind == "drive"], rng)]


def _warm(block: Sequence[Step]) -> list[Step]:
    """The open drives farthest from the resonance, to be recorded again while warm, behind the record that locates it.

    A feedthrough that follows the temperature shows off resonance alone, and on both sides: on one a drive's gain that follows it is
    the same.
    """
    locate, *opened = block
    far = [s for s in opened if s.command.excitation.kind == "drive" and s.detuning_hz in (FEEDTHROUGH_HZ[0], FEEDTHROUGH_HZ[-1])]
    return [replace(s, label=f"hot_{s.label}") for s in (locate, *far)]


def _ring_blocks(factory: Mapping[str, Any], quality: str, q: GapQuality) -> list[list[Step]]:
    """Ring-down, ring-up and stiffness steps of each axis, behind a static record of it."""
    blocks: list[list[Step]] = []
    for step in scale_factor_steps(factory, quality):
        if step.command.oscillator_axis is not None:
            axis = step.command.oscillator_axis
            blocks.append([replace(step, label=f"static_{axis}_ring", duration_s=q.static_s)])
        else:
            blocks[-1].append(step)
    return blocks


def _wave_round(
    factory: Mapping[str, Any],
    axis: str,
    onward: float,
    pairs: Iterable[tuple[int, tuple[float, float]]],
    q: GapQuality,
    speed_deg_s: float,
    rng: np.random.Generator,
) -> list[Step]:
    """A static record puts the wave on an axis; then free runs with a pair of precessions between each two, one sense a quarter further."""
    steps = [_static(factory, axis, q, f"static_{axis}_round"), _free(factory, f"free_{axis}_0", q)]
    for k, (number, (amplitude, volts)) in enumerate(pairs, 1):
        for sense in _drawn((1.0, -1.0), rng):
            label = f"vir_{'p' if sense > 0.0 else 'n'}_a{amplitude:g}_x{volts:g}_{number}"
            periods = 1.0 + (_ONWARD / MARGIN if sense == onward else 0.0)
            steps.append(precession_step(factory, label, sense * volts * speed_deg_s, periods, share=amplitude))
        steps.append(_free(factory, f"free_{axis}_{k}", q))
    return steps


# -- order ------------------------------------------------------------------------------------------------------------------------------


def _drawn(items: Sequence[Any], rng: np.random.Generator) -> list[Any]:
    return [items[k] for k in rng.permutation(len(items))]


def _dealt(items: Sequence[Any], rng: np.random.Generator, parts: int = REPEATS) -> list[list[Any]]:
    """The items in drawn order, dealt to so many rounds."""
    drawn = _drawn(items, rng)
    return [drawn[k::parts] for k in range(parts)]


def _between(rounds: Sequence[list[Step]], blocks: Sequence[list[Step]], rng: np.random.Generator) -> list[Step]:
    """The blocks, in drawn order, between the rounds: each has rounds before it and after it."""
    drawn, gaps = _drawn(blocks, rng), len(rounds) - 1
    steps = list(rounds[0])
    for k, later in enumerate(rounds[1:]):
        steps += [step for block in drawn[k::gaps] for step in block]
        steps += later
    return steps


def _settled(steps: Iterable[Step], factory: Mapping[str, Any]) -> list[Step]:
    """Settling times that the order asks for: longer where the wave must be put elsewhere; steps that count from their command keep
    theirs.
    """
    slow = nominal_decay(factory) * _SETTLE_S[0] < 1.0
    moved_s, else_s = _SLOW_SETTLE_S if slow else _SETTLE_S
    moved_s = max(moved_s, else_s + _TURNS * _turn_s(factory))
    settled: list[Step] = []
    before: Command | None = None
    for step in steps:
        mode = step.command.mode
        if mode in ("ftr_x", "ftr_y", "whole_angle"):
            # a wave goes on from where a static record has put it
            stays = before is not None and (before.mode == mode or (mode == "whole_angle" and before.mode != "loops_off"))
            step = replace(step, settle_s=max(step.settle_s, else_s if stays else moved_s))
        settled.append(step)
        before = step.command
    return settled


def _turn_s(factory: Mapping[str, Any]) -> float:
    """Time in which a drive at the end of its range turns a wave from one axis to the other; zero where the factory does not tell."""
    scale = factory.get("nominal_scale_factor_v_per_rad_s") or {}
    most = max((abs(float(v)) for v in scale.values()), default=0.0)
    return 0.25 * math.pi * most / (_dac_v(factory) * float(factory.get("angular_gain_kappa", 1.0)))


# -- numbers ----------------------------------------------------------------------------------------------------------------------------


def _plan(
    name: str, steps: list[Step], factory: Mapping[str, Any], quality: str, limits: Limits | None, seed: int, abilities: Collection[str]
) -> Plan:
    left_out = tuple(f"The campaign is without {text}." for ability, text in GAP_ABILITIES.items() if ability not in abilities)
    words = {"plan": {"name": name, "quality": quality, "order_seed": int(seed), "left_out": list(left_out)}}
    final = Command(mission_mode(factory), setpoints=Setpoints(_amplitude(factory)))
    return Plan(name, tuple(steps), limits or _LIMITS, final, words, left_out)


def _quality(name: str) -> GapQuality:
    if name not in _QUALITIES:
        raise DataError(f"Plan quality must be one of {', '.join(_QUALITIES)}, but got {name!r}.")
    return _QUALITIES[name]


def _amplitude(factory: Mapping[str, Any]) -> float:
    return float(factory.get("nominal_amplitude_v", 1.0))


def _dac_v(factory: Mapping[str, Any]) -> float:
    return float(factory.get("dac_full_scale_V", 5.0))


def _amplitude_shares(factory: Mapping[str, Any]) -> list[float]:
    """Amplitudes over the nominal one; all lower by one factor where the converter would not take the highest."""
    highest = (1.0 + INDEX) * max(CUBIC_AMPLITUDES) * _amplitude(factory)
    room = _MOST_OF_ADC * float(factory.get("adc_full_scale_V", math.inf))
    if not 0.0 < _amplitude(factory) < room:
        raise DataError(
            f"Factory data must have a nominal_amplitude_v within 0 and {room:.3g} V ({_MOST_OF_ADC:g} of adc_full_scale_V), "
            f"but got {_amplitude(factory):g}. Correct the factory data."
        )
    return [share * min(1.0, room / highest) for share in CUBIC_AMPLITUDES]


def _nominal_scale_factor(factory: Mapping[str, Any]) -> float:
    nominal = factory.get("nominal_scale_factor_v_per_rad_s")
    return abs(float(nominal["x"])) if isinstance(nominal, Mapping) and "x" in nominal else 1e-9


def _temperatures(factory: Mapping[str, Any], stands_degc: float | None) -> tuple[float, float]:
    low = float(factory.get("reference_temperature_degC", 25.0)) if stands_degc is None else stands_degc
    return low, low + STEP_K


def _speed_deg_s(factory: Mapping[str, Any], q: GapQuality) -> float:
    """Precession at nominal volts: at the fewest volts the drift of unbalanced forcers must not stop it, the most must be there."""
    fewest, most = min(v for _, v in WAVE_CONDITIONS), max(max(v, a * v) for a, v in WAVE_CONDITIONS)
    drift = math.degrees(0.5 * UNBALANCE * nominal_decay(factory))
    limit = math.degrees(MOST_SHARE * _dac_v(factory) * 0.5 * nominal_gain(factory) / _amplitude(factory))
    return min(max(q.speed_deg_s, ABOVE_DRIFT * drift / fewest), limit / most)
