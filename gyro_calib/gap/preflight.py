"""Do the recordings hold what their attributes say? Named in plain words before any verdict."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..recording.applied_rate import is_turned
from ..recording.recording import Campaign, Recording
from .one_axis import holding_gain
from .parts import Linear
from .signals import WARMING_K, held_readings

__all__ = ["check_campaign", "check_linear", "usable"]

#: a modulation's index over the stated one; the least of it at the largest amplitude, where a drive that clips does not reach it, or where
#: a slow loop leaves as much of it in all recordings of one frequency, to such a share; an open drive's volts over the stated ones (a
#: multiplexed drive acts for a share of the time)
_INDEX_RANGE, _LEAST_INDEX, _ALIKE_INDEX, _VOLTS_RANGE = (0.6, 1.6), 0.05, 0.35, (0.2, 3.0)
#: a reference further from the frequency of an open drive than this [Hz] is not the drive's
_REFERENCE_HZ = 0.5
#: a recording shorter than this share of its like is cut short
_CUT_SHORT = 0.7
#: what the response to rate is multiplied by when applied_rate is in another unit, and how near it must be to that
_RATE_UNITS = (
    (57.29578, "to be in deg/s where rad/s is said"),
    (1.0 / 57.29578, "to be in rad/s where deg/s is said"),
    (3600.0, "to be in deg/h"),
)
_RATE_TOLERANCE = 0.15
_FEWEST_RECORDINGS = 2
#: noise from row to row over the wave; the quietest of twelve recorded and simulated devices has 3e-6
_NO_NOISE = 1e-8
#: fewest rows of a recording; excitations that the equations do not describe
_FEWEST_ROWS, _NOT_DESCRIBED = 200, ("frequency_modulation", "secondary_modulation")
#: a wave held at this share of its largest volts or more, for this share of the rows, was there; a modulation leaves more
_HELD_VOLTS, _SLIPPED = 0.05, 0.01
#: a drive acts on an axis by this share at least of what holds a wave there
_ACTS = 0.2
#: and by so many of its own sd, from which on its direction is known: that sd is of rough noise
_KNOWN = 10.0
#: rate of growth over the decay that the factory states, from which on columns are wrong and not the gyro; share of a drive's gain in the
#: phase that it should have, and a quarter of a cycle from there, from which on it is right and wrong
_GROWS, _PUSHES, _ASIDE = 0.2, 0.5, 0.8
#: share of a wave's power on an axis from which on it is held there
_HELD_SHARE = 0.25


def usable(campaign: Campaign) -> list[Recording]:
    """Recordings with something to say: long enough, of a mode that the equations describe, with one wave from end to end."""
    return [r for r in campaign if len(r) >= _FEWEST_ROWS and r.command.excitation.kind not in _NOT_DESCRIBED and not _slips(r)]


def _slips(r: Recording) -> bool:
    """Whether force to rebalance held its wave on both sides of nothing: the reference slipped by half a cycle."""
    axis = r.command.oscillator_axis
    if axis is None or r.command.mode == "loops_off":
        return False
    held = r.pick[:, "xy".index(axis)].real
    share = float(np.mean(held[np.abs(held) > _HELD_VOLTS * np.abs(held).max()] > 0.0))
    return _SLIPPED < share < 1.0 - _SLIPPED


def _not_used(campaign: Campaign) -> list[str]:
    """A line on recordings that are too short to be used, and one on those of another method."""
    short = [f"{r.label} ({len(r)})" for r in campaign if len(r) < _FEWEST_ROWS]
    other = [r.label for r in campaign if len(r) >= _FEWEST_ROWS and r.command.excitation.kind in _NOT_DESCRIBED]
    slipped = [r.label for r in campaign if len(r) >= _FEWEST_ROWS and _slips(r)]
    lines = []
    if slipped:
        said = f"Not used, for the wave is held on both sides of its axis, the reference slipped by half a cycle: {', '.join(slipped)}"
        lines.append(f"{said}. Record them again.")
    if short:
        lines.append(f"Not used, for they hold fewer than {_FEWEST_ROWS} rows: {', '.join(short)}. Record them for longer, or faster.")
    if other:
        lines.append(f"Not used, for the diagnosis knows side bands of the amplitude only: {', '.join(other)}.")
    return lines


def check_campaign(campaign: Campaign) -> list[str]:
    """Refuse attributes that the data contradict; give warnings in plain words.

    Raises
    ------
    DataError
        Fewer than two recordings with a vibration; an excitation, a drive or a reference that is not in the data.
    """
    waves = [r for r in campaign if r.command.mode != "loops_off"]
    if len(waves) < _FEWEST_RECORDINGS:
        raise DataError(
            f"A diagnosis needs at least {_FEWEST_RECORDINGS} recordings with the loops closed, but got {len(waves)}. "
            "Record the campaign gap-ftr or gap-whole-angle, or part of it."
        )
    _check_modulation([(r, index) for r in campaign if (index := _index(r)) is not None], waves)
    for r in campaign:
        _check_open_drive(r)
    return [*_not_used(campaign), *_cut_short(campaign), *_rarely_read(campaign), *_without_noise(waves)]


def _without_noise(waves: Sequence[Recording]) -> list[str]:
    """A line on recordings that no device made: beside no noise what the models leave out themselves is an effect."""
    noises = [_row_noise(r) for r in waves if r.command.mode.startswith("ftr") or r.command.mode == "whole_angle"]
    if not noises or float(np.median(noises)) > _NO_NOISE:
        return []
    return [
        f"The pick-offs hold no noise ({np.median(noises):.1g} of the wave from row to row, a device has 1e-6 and more): a simulation "
        "without it. Effects that are named beside none may be what a model rounds off. Give the device description its noise."
    ]


def _row_noise(r: Recording) -> float:
    """Third difference of the quietest pick-off column over the wave's amplitude."""
    amplitude = float(np.sqrt(np.mean(np.sum(np.abs(r.pick) ** 2, axis=1))))
    moving = [part for axis in r.pick.T for part in (axis.real, axis.imag) if np.ptp(part)]
    quietest = min((float(np.median(np.abs(np.diff(part, 3)))) for part in moving), default=0.0)
    return quietest / max(amplitude, 1e-300)


def _index(r: Recording) -> float | None:
    """Index of a modulation at its frequency as the pick-off shows it."""
    excitation, axis = r.command.excitation, r.command.oscillator_axis
    if excitation.kind != "amplitude_modulation" or axis is None or excitation.frequency_hz * r.duration_s < 0.9:
        return None
    phase = 2.0 * np.pi * excitation.frequency_hz * r.t
    design = np.column_stack([np.ones(len(r)), np.cos(phase), np.sin(phase)])
    mean, c, s = np.linalg.lstsq(design, np.abs(r.pick[:, "xy".index(axis)]), rcond=None)[0]
    return float(np.hypot(c, s) / mean)


def _check_modulation(found: Sequence[tuple[Recording, float]], waves: Sequence[Recording]) -> None:
    largest_v = max(r.command.setpoints.amplitude_v for r in waves)
    ratios = [index / abs(r.command.excitation.index or 1.0) for r, index in found]
    for (r, index), ratio in zip(found, ratios, strict=True):
        nu_hz = r.command.excitation.frequency_hz
        others = [
            x for (o, _), x in zip(found, ratios, strict=True) if o is not r and abs(o.command.excitation.frequency_hz / nu_hz - 1.0) < 0.1
        ]
        slow = bool(others) and abs(ratio / float(np.median(others)) - 1.0) < _ALIKE_INDEX
        least = _LEAST_INDEX if slow or r.command.setpoints.amplitude_v > 0.99 * largest_v else _INDEX_RANGE[0]
        if not least <= ratio <= _INDEX_RANGE[1]:
            raise DataError(
                f"Recording {r.label!r} says that its oscillator is modulated by {100 * r.command.excitation.index:.3g} % at "
                f"{nu_hz:g} Hz, but the {r.command.oscillator_axis} pick-off shows {100 * index:.3g} % there. "
                "Correct the attribute excitation, or the axis."
            )


def _check_open_drive(r: Recording) -> None:
    excitation = r.command.excitation
    if excitation.kind not in ("drive", "body") or r.command.mode != "loops_off":
        return
    reference = float(np.median(r.column("ref_freq")))
    if abs(reference - excitation.frequency_hz) > _REFERENCE_HZ:
        raise DataError(
            f"Recording {r.label!r} says that it is excited at {excitation.frequency_hz:.6g} Hz, but its reference ref_freq is at "
            f"{reference:.6g} Hz. Demodulate it at the excitation's frequency, or correct the attribute."
        )
    if excitation.kind == "drive":
        volts = np.median(np.abs(r.drive), axis=0)
        wanted, other = "xy".index(excitation.axis), 1 - "xy".index(excitation.axis)
        if volts[other] > volts[wanted]:
            raise DataError(
                f"Recording {r.label!r} says that {excitation.axis} is driven, but the other drive carries {volts[other]:.4g} V and "
                f"{excitation.axis} only {volts[wanted]:.4g} V. Swap the drive columns, or correct the attribute."
            )
        if not _VOLTS_RANGE[0] <= volts[wanted] / max(abs(excitation.volts), 1e-300) <= _VOLTS_RANGE[1]:
            raise DataError(
                f"Recording {r.label!r} says that {excitation.axis} is driven with {excitation.volts:.4g} V, but its column shows "
                f"{volts[wanted]:.4g} V. Correct the attribute or the unit of the drive columns."
            )


def _rarely_read(campaign: Campaign) -> list[str]:
    """A line on a temperature that is read once in a while where it moves."""
    moving = ((r, held_readings(r)) for r in campaign if np.ptp(r.temperature_degc) > WARMING_K)
    apart_s = {r.label: float(np.median(np.diff(rows))) / r.sample_rate_hz for r, rows in moving if len(rows)}
    if not apart_s:
        return []
    return [
        f"While it moves the temperature is read every {max(apart_s.values()):.2g} s only ({', '.join(apart_s)}): taken to go straight "
        "from reading to reading, with the reference's corners. Read it ten times a second, so that what depends on it is told."
    ]


def _cut_short(campaign: Campaign) -> list[str]:
    lengths: dict[tuple[object, ...], list[Recording]] = defaultdict(list)
    for r in campaign:
        # a faster precession is through its turn earlier
        volts = round(abs(r.command.setpoints.virtual_precession_v), 2)
        lengths[r.command.mode, r.command.excitation.kind, volts, is_turned(r)].append(r)
    out = []
    for alike in lengths.values():
        usual = float(np.median([r.duration_s for r in alike]))
        regular = sum(abs(r.duration_s / usual - 1.0) < 0.02 for r in alike) >= max(4, 0.7 * len(alike))
        for r in alike:
            stated = r.extras.get("duration_s")
            wanted = float(stated) if isinstance(stated, int | float) else usual if regular else 0.0
            if r.duration_s < _CUT_SHORT * wanted and len(r) >= _FEWEST_ROWS:
                out.append(f"{r.label} is cut short: {r.duration_s:.3g} s where {wanted:.3g} s are usual. What it holds is used.")
    return out


def _swings(axis: int, recordings: Sequence[Recording]) -> bool:
    """Whether a wave was held on an axis: otherwise nothing tells its damping."""
    shares = [np.sum(np.abs(r.pick[:, axis]) ** 2) / np.sum(np.abs(r.pick) ** 2) for r in recordings if r.command.mode != "loops_off"]
    return bool(max(shares, default=0.0) > _HELD_SHARE)


def check_linear(
    linear: Linear,
    values: dict[str, float],
    recordings: Sequence[Recording],
    decay_rate: float,
    drives_sd: Sequence[float] | NDArray[np.float64] = (0.0, 0.0),
) -> None:
    """Refuse a linear device that no gyro can be: columns with a wrong sign, swapped, or in other units.

    Parameters
    ----------
    linear : Linear
    values : dict
        Of the fit that told it.
    recordings : sequence of Recording
    decay_rate : float
        Rough 1/tau [1/s].
    drives_sd : sequence of float, optional
        How well the fit knows the gain of each drive on its own axis [1/s]: one that it hardly knows points anywhere.

    Raises
    ------
    DataError
    """
    G, A = linear.G, linear.A
    straight, crossed = np.abs(np.diag(G)), np.abs([G[0, 1], G[1, 0]])
    # two steady recordings leave both at nothing, one that of its own axis
    acts = _ACTS * holding_gain(recordings, decay_rate)
    if crossed.min() > max(straight.max(), acts):
        raise DataError(
            f"Each drive must move its own axis, but x drive acts on y by {crossed[1]:.3g} and on x by {straight[0]:.3g} 1/s. "
            "The drive columns (or the pick-off columns) of x and y look swapped."
        )
    growing = [k for k in range(2) if A[k, k].real > _GROWS * decay_rate and _swings(k, recordings)]
    if len(growing) == 2 and np.all(np.diag(G).imag < -_PUSHES * straight):
        raise DataError(
            f"Both modes must be damped, but got {A[0, 0].real:+.3g} and {A[1, 1].real:+.3g} 1/s with drives that push as they should: the "
            "s of all columns look to have the wrong sign (c + i s, signal = c cos phi - s sin phi). Turn them. If they are right, "
            "the device rings by itself, as one does that is pumped at twice its frequency by more than its damping."
        )
    for k, axis in enumerate("xy"):
        pushes = straight[k] > max(acts, _KNOWN * drives_sd[k])
        if pushes and abs(G[k, k].real) > _ASIDE * straight[k]:
            raise DataError(
                f"A positive {axis} drive must push {axis} as theory.md Eq. 4 has it (G_{axis}{axis} near -i), but got {G[k, k]:.3g} 1/s, "
                f"a quarter of a cycle away: c and s of the {axis} drive or of the {axis} pick-off columns look swapped. Swap them back."
            )
        if pushes and G[k, k].imag > 0.5 * straight[k]:
            raise DataError(
                f"A positive {axis} drive must push {axis} as theory.md Eq. 4 has it (G_{axis}{axis} near -i), but got {G[k, k]:.3g} 1/s: "
                f"the sign of the {axis} drive or of the {axis} pick-off columns looks wrong (c and s swapped, or negative)."
            )
        if k in growing:
            raise DataError(
                f"The {axis} mode must be damped, but got {A[k, k].real:+.3g} 1/s. Check the signs of c and of s, and the unit, of the "
                f"columns of {axis}: one of the {axis} drive's is turned, or c and s are swapped."
            )
    if any(is_turned(r) for r in recordings) and all(_swings(k, recordings) for k in range(2)):
        response = values.get("rate_anti_re", linear.angular_gain)
        if response < 0.0:
            raise DataError(
                f"The wave must lag behind the table by kappa = {linear.angular_gain:.4g}, but got {response:+.4g}: the sign of "
                "applied_rate (or of one axis) is wrong. Turn its sign."
            )
        for factor, unit in _RATE_UNITS:
            if abs(response / linear.angular_gain * factor - 1.0) < _RATE_TOLERANCE:
                raise DataError(
                    f"The response to the table must be near kappa = {linear.angular_gain:.4g} of the factory, but got {response:.4g}: "
                    f"applied_rate looks {unit}. Correct its unit."
                )
