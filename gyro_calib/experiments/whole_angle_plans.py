"""The plans of a whole-angle gyro: virtual precession (document 004) and the gain that document 003 measures.

Durations follow from the factory's nominal scale factor: |G| = kappa Ac/|S| is the electromechanical rate per volt, k_vir = |G|/(2 Ac) the
precession per volt, and a period of 4 theta is a quarter turn of the wave. At the document's 0.1 deg/s that takes a quarter of an hour a
sense; the estimator needs no particular speed, so only the bench plan is that slow.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..errors import DataError
from ..recording.command import Command, Setpoints
from .plan import Limits, Plan, Step

__all__ = [
    "SPEEDS",
    "WaveQuality",
    "nominal_decay",
    "nominal_gain",
    "precession_step",
    "scale_factor_plan",
    "scale_factor_steps",
    "virtual_precession_plan",
    "virtual_precession_steps",
]


@dataclass(frozen=True)
class WaveQuality:
    """Durations of a whole-angle plan.

    Parameters
    ----------
    speed_deg_s : float
        Precession theta' of the pair [deg/s].
    periods : int
        Whole periods of 4 theta of each sense.
    free_s, stiffness_s : float
        Duration of a free run and of one value of the stiffness control [s].
    rounds : int
        How often the pair is repeated, the senses in alternating order so that a linear drift cancels.
    """

    speed_deg_s: float
    periods: int
    free_s: float
    stiffness_s: float
    rounds: int


SPEEDS: dict[str, WaveQuality] = {
    "quick": WaveQuality(8.0, 2, 8.0, 2.0, 1),
    "standard": WaveQuality(2.0, 2, 20.0, 3.0, 1),
    "fine": WaveQuality(0.1, 1, 60.0, 5.0, 1),
}
#: amplitudes of the virtual precession over the pair's, of one sense: three give k_vir (document 004, step 4)
SHARES = (1.0, 1.5, 2.0)
#: how much longer than a nominal period, and how far above a drift of unbalanced forcers (their errors over tau) the precession is
MARGIN, ABOVE_DRIFT, UNBALANCE = 1.08, 3.0, 0.03
#: share of the converters' range for precession and ring-down at most, for ring-down and for stiffness control
MOST_SHARE, RING_SHARE, STIFFNESS_SHARE = 0.7, 0.4, 0.2
#: rate of a ring-down's drive over the decay that a wave needs to come up soon, and to come up at all
RINGS_UP, LEAST_RINGS_UP = 1.5, 1.2
#: time for the wave to come up and the loops to settle after loops off or a change of axis, and after another command [s]
PLACE_SETTLE_S, SETTLE_S = 8.0, 2.0
#: for the loops to follow a step of the stiffness control [s]; recorded from the step on, a hemisphere's gain comes out 0.6 % high
STIFFNESS_SETTLE_S = 0.5
#: longest leg of a ring-down [s]
LONGEST_LEG_S = 60.0


def virtual_precession_plan(factory: Mapping[str, Any], *, quality: str = "standard", limits: Limits | None = None) -> Plan:
    """Free runs, precession of three amplitudes, and the pair of both senses over whole periods of 4 theta (document 004).

    Parameters
    ----------
    factory : mapping
        Factory data of the unit.
    quality : {"quick", "standard", "fine"}
        Duration.
    limits : Limits, optional
        When to abort.

    Raises
    ------
    DataError
        Unknown quality, or factory data without nominal scale factor.
    """
    return Plan("virtual_precession", tuple(virtual_precession_steps(factory, quality)), limits or Limits(), _mission(factory))


def scale_factor_plan(factory: Mapping[str, Any], *, quality: str = "standard", limits: Limits | None = None) -> Plan:
    """Ring-down, ring-up and stiffness control on both axes (document 003), with a short free run and a short pair of precessions.

    Parameters
    ----------
    factory : mapping
        Factory data of the unit.
    quality : {"quick", "standard", "fine"}
        Duration.
    limits : Limits, optional
        When to abort.

    Raises
    ------
    DataError
        Unknown quality, or factory data without nominal scale factor.
    """
    q, pair = _quality(quality), []
    speed = SPEEDS["quick"].speed_deg_s
    for sign, name in ((1.0, "p"), (-1.0, "n")):
        pair.append(precession_step(factory, f"vir_{name}", sign * speed, 1))
    steps = [*scale_factor_steps(factory, quality), Step("free", _wave(factory), q.free_s, SETTLE_S), *pair]
    return Plan("scale_factor", tuple(steps), limits or Limits(), _mission(factory))


def virtual_precession_steps(factory: Mapping[str, Any], quality: str) -> list[Step]:
    """Steps of :func:`virtual_precession_plan`."""
    q = _quality(quality)
    speed = _speed(factory, q)
    steps = [
        Step("place_x", Command("ftr_x", setpoints=Setpoints(_amplitude(factory))), 2.0, PLACE_SETTLE_S),
        Step("free_0", _wave(factory), q.free_s, SETTLE_S),
    ]
    # an eighth of a turn on, where the axes of damping and stiffness that the first free run did not see have their part
    steps += [precession_step(factory, "turn", speed, 0.5), Step("free_1", _wave(factory), q.free_s, SETTLE_S)]
    for share in SHARES[1:]:
        steps.append(precession_step(factory, f"vir_x{share:g}", share * speed, 1))
    for turn in range(q.rounds):
        senses = ((1.0, "p"), (-1.0, "n")) if turn % 2 == 0 else ((-1.0, "n"), (1.0, "p"))
        steps += [precession_step(factory, f"vir_{name}_{turn}", sign * speed, q.periods) for sign, name in senses]
    return steps


def scale_factor_steps(factory: Mapping[str, Any], quality: str) -> list[Step]:
    """Ring-down, ring-up and stiffness control with the wave on x, then on y.

    Raises
    ------
    DataError
        Drives too weak to ring the wave up, or factory data that lack what this is computed from.
    """
    q = _quality(quality)
    amplitude, gain, full = _amplitude(factory), nominal_gain(factory), _full_scale(factory)
    decay = nominal_decay(factory)
    # a wave that decays fast takes more of its drives than the usual share, if they have it
    ratio = min(max(RING_SHARE * full / amplitude, RINGS_UP * decay / gain), MOST_SHARE * full / amplitude)
    if ratio * gain < LEAST_RINGS_UP * decay:
        raise DataError(
            f"Drive must be able to ring the wave up, but {ratio:.3g} V/V make {ratio * gain:.3g} /s against a decay of {decay:.3g} /s. "
            "Check nominal_q, dac_full_scale_V and nominal_scale_factor_v_per_rad_s in the factory data."
        )
    down = min(MARGIN * math.log(2.0) / (ratio * gain + decay) + 0.5, LONGEST_LEG_S)
    up = min(MARGIN * math.log(2.0) / (ratio * gain - decay) + 0.5, LONGEST_LEG_S)
    stiffness = STIFFNESS_SHARE * full / amplitude
    steps = []
    for axis in "xy":
        steps.append(Step(f"place_{axis}", Command(f"ftr_{axis}", setpoints=Setpoints(amplitude)), 2.0, PLACE_SETTLE_S))
        # the legs are recorded from their first moment on: what happens before is what counts
        for mode, sign, duration in (("ring_down", -1.0, down), ("ring_up", 1.0, up)):
            command = Command(mode, setpoints=Setpoints(amplitude, amplitude_gain_v_per_v=sign * ratio))
            steps.append(Step(f"{mode}_{axis}", command, duration, 0.0))
        for turn, sign in enumerate((1.0, -1.0, 1.0, -1.0)):
            command = Command("stiffness", setpoints=Setpoints(amplitude, stiffness_v_per_v=sign * stiffness))
            steps.append(Step(f"stiffness_{axis}_{turn}", command, q.stiffness_s, STIFFNESS_SETTLE_S if turn else SETTLE_S))
    return steps


def nominal_gain(factory: Mapping[str, Any]) -> float:
    """|G| of the nominal unit [1/s per V]: kappa Ac over the nominal scale factor.

    Raises
    ------
    DataError
        Factory data without kappa or nominal scale factor.
    """
    nominal, kappa = factory.get("nominal_scale_factor_v_per_rad_s"), factory.get("angular_gain_kappa")
    if not isinstance(nominal, Mapping) or "x" not in nominal or not isinstance(kappa, int | float):
        raise DataError(
            f"Factory data must hold angular_gain_kappa and nominal_scale_factor_v_per_rad_s, but got {kappa!r}, {nominal!r}. "
            "Without them nobody knows how far a volt turns the wave."
        )
    return float(kappa) * _amplitude(factory) / abs(float(nominal["x"]))


def precession_step(factory: Mapping[str, Any], label: str, speed_deg_s: float, periods: float, *, share: float = 1.0) -> Step:
    """Virtual precession at about this speed for so many periods of 4 theta, at a share of the mission's amplitude."""
    amplitude = share * _amplitude(factory)
    k_vir = 0.5 * nominal_gain(factory) / amplitude
    speed = math.radians(speed_deg_s)
    most = MOST_SHARE * _full_scale(factory) * k_vir
    speed = math.copysign(min(abs(speed), most), speed)
    command = Command("whole_angle", setpoints=Setpoints(amplitude, virtual_precession_v=speed / k_vir))
    return Step(label, command, MARGIN * periods * 0.5 * math.pi / abs(speed), SETTLE_S)


def _speed(factory: Mapping[str, Any], q: WaveQuality) -> float:
    """Speed of the pair: the quality's, but never so slow that the drift of unbalanced forcers stops the wave [deg/s]."""
    return max(q.speed_deg_s, ABOVE_DRIFT * math.degrees(0.5 * UNBALANCE * nominal_decay(factory)))


def _wave(factory: Mapping[str, Any]) -> Command:
    return Command("whole_angle", setpoints=Setpoints(_amplitude(factory)))


def _mission(factory: Mapping[str, Any]) -> Command:
    mode = str(factory.get("mission_mode", "whole_angle"))
    return Command(mode, setpoints=Setpoints(_amplitude(factory)))


def _amplitude(factory: Mapping[str, Any]) -> float:
    return float(factory.get("nominal_amplitude_v", 1.0))


def _full_scale(factory: Mapping[str, Any]) -> float:
    return float(factory.get("dac_full_scale_V", 5.0))


def nominal_decay(factory: Mapping[str, Any]) -> float:
    """Nominal 1/tau [1/s]."""
    return math.pi * float(factory.get("nominal_f0_hz", 0.0)) / float(factory.get("nominal_q", math.inf))


def _quality(name: str) -> WaveQuality:
    if name not in SPEEDS:
        raise DataError(f"Plan quality must be one of {', '.join(SPEEDS)}, but got {name!r}.")
    return SPEEDS[name]
