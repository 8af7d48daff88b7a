"""What a turned recording says of its table and of kappa: clock, delay and shape of the table's steps, the response to rate as columns.

A table turns later than its log says: by its motor, its clock, and by where a recorder counts its rows from. For a wave that turns, the
rate's derivatives tell it badly, for its speed jumps where the table moves, not where the log does. The log is mended first (`in_time`).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects, label

from ..estimation.wave_projection import WaveProjected
from ..recording.applied_rate import is_straight, is_turned
from ..recording.recording import Recording
from .column import Column
from .columns import QUIET, SIGNAL
from .evidence import CampaignEvidence, RecordingEvidence
from .linear_device import FEEDTHROUGH, ROW_MOMENT, collected, combined, entry, reaction_of
from .parts import QUARTER_TURN, Linear

__all__ = ["gain_as_read", "healthy_phases", "in_time", "rate_columns", "said_late", "shifted", "step_rows", "steps_of"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

#: a table's clock, and its lag behind what was commanded [s]
_CLOCK_S, _LAG_S = 1e-3, 2e-2
#: what rounds a step of the table, from the second moment on
_MOMENTS = ("blur", "skew", "tails", "fifth_moment")
#: how far kappa of a unit is from its factory's (latency of the loops, clock of the table)
_KAPPA = 3e-4
#: how far the feedthrough of a turned recording is from that of the others
_UNTURNED = 3e-5
#: delay of which the user is told [s]
_TOLD_S = 0.05
#: reaction of the diagonal of A to rate over kappa
_SKEWED_RATE = 0.05
#: how far the phases of the pick-offs of a healthy unit differ; effects.md 19 says to 0.01, of 15 units of four plants none came to 0.005
_PHASE_RAD = 0.01
#: a step is what changes within so long [s], as the thinned log has it (a motor of 15 ms takes 0.11 s); a log of more of them is a course
_STEP_S, _MOST_STEPS = 0.25, 12
#: share of the fastest change below which a table stands still
_STILL = 1e-6
#: what a step leaves over ``kappa dOmega / 2 w``, sd: the cosine of a phase nobody knows
_OF_PHASE = 0.7
#: growth of a wave by the square of the applied rate [s], sd: of a plant whose Coriolis force is a kick once a sample kappa^2 times that
_KICKED_S = 2e-5
#: by how much each step of a table is early or late by itself [s]
_SERVO_S = 1e-4


def rate_columns(evidence: CampaignEvidence, linear: Linear | None = None) -> list[Column]:
    """Response of A to rate: its antisymmetric part is kappa, the rest is the pick-offs' mismatch and non-orthogonality; the table's steps.

    With a ``linear`` device as far as it is known, the target already lacks the response to rate of kappa (`linear_device.target_of`), and
    what is sought is how far the unit is from it; otherwise all of it.
    """
    rate_known, reaction = linear is not None, QUARTER_TURN if linear is None else linear.reaction
    if not any(is_turned(r.recording) for r in evidence):
        return []
    columns = collected("rate_anti", evidence, combined((0, 1), (1, 0), -1.0), _KAPPA if rate_known else np.inf)
    # a motor takes its time, and a log begins anew with every recording
    for r in evidence:
        if is_turned(r.recording):
            columns += collected(f"table_lag_{r.index}", evidence, _late(reaction, r.index), _LAG_S, real=True)
    for name, f in (
        ("rate_mismatch", combined((0, 1), (1, 0), 1.0)),
        ("rate_sum", combined((0, 0), (1, 1), 1.0)),
        ("rate_skew", combined((0, 0), (1, 1), -1.0)),
    ):
        columns += collected(name, evidence, f, _SKEWED_RATE)
    for a in range(2):
        for b in range(2):
            place = f"{'xy'[a]}{'xy'[b]}"
            columns += collected(f"table_{place}", evidence, entry("jerk", a, b), _CLOCK_S)
            # what feeds through does not turn: -kappa Omega J (V - E u), of which the columns of E hold all but its dispersion
            columns += collected(f"rate_feed_{place}", evidence, entry("rate_drive", a, b), _UNTURNED if rate_known else FEEDTHROUGH)
    return [*columns, _kicked(evidence), *_rounded_steps(evidence, reaction), *_carrier_phases(evidence, reaction)]


def _late(reaction: ComplexArray, index: int) -> Callable[[RecordingEvidence, WaveProjected], ComplexArray]:
    """Of one recording, what a rate's change does to the volts."""
    return lambda r, p: -float(r.index == index) * np.tensordot(p.jerk, reaction, axes=2)


def healthy_phases(columns: Sequence[Column], angular_gain: float, values: Mapping[str, float]) -> list[Column]:
    """The same, with pick-offs whose phases differ as those of a healthy unit do: the imaginary part of the mismatch alone has that.

    A linear device is fitted with any: of one that is far from that kappa as it is read was short by the square of it. Of such a unit it
    is read in quadrature, too, by the product of phase and mismatch: 0.0023 of 0.22 rad and 0.01.
    """
    sizes = {
        "rate_mismatch_im": _PHASE_RAD * angular_gain,
        "rate_anti_im": math.hypot(_KAPPA, (angular_gain * _stretched(angular_gain, values)).imag),
    }
    return [replace(c, prior_sd=sizes.get(c.name, c.prior_sd)) for c in columns]


def _kicked(evidence: CampaignEvidence) -> Column:
    """A wave that grows as ``Omega^2``: what the forward rule makes of a Coriolis force, ``kappa^2 / 76 500 Hz`` of one plant."""
    signal, quiet = (
        tuple(r.turn * place.projector(r).plain([(r.signals.rate_rad_s**2)[:, None] * r.signals.pick])[:, 0] for r in evidence)
        for place in (SIGNAL, QUIET)
    )
    return Column("rate_kicked", signal, quiet, _KICKED_S)


def gain_as_read(angular_gain: float, values: Mapping[str, float]) -> float:
    """Kappa as pick-offs P see it that are not square to each other, or not alike: ``P J P^-1`` is J stretched one way.

    Its square is -1 whatever P, so with the symmetric parts s and a of what a table shows, over kappa, its antisymmetric part is
    ``sqrt(1 + s^2 + a^2)``: of a hemisphere whose axes are 3 degrees askew and 6 % apart 0.4 % more than the factory's. Of pick-offs that
    are sampled 0.22 rad of the carrier apart s is imaginary, and it is 2.4 % less.
    """
    return angular_gain * _stretched(angular_gain, values).real


def _stretched(angular_gain: float, values: Mapping[str, float]) -> complex:
    reaction = reaction_of(values, angular_gain)
    return cmath.sqrt(1.0 + (0.5 * (reaction[0, 1] + reaction[1, 0])) ** 2 + reaction[1, 1] ** 2)


def _rounded_steps(evidence: CampaignEvidence, reaction: ComplexArray) -> list[Column]:
    """A step of the table as its motor and the recorder's filter round it: the rate's derivatives times the moments of what rounds it.

    `1 / (1 + i w tau)`, a motor of time constant tau, is the series of `(-i w tau)^n`; that of a ramp falls faster. What a filter of the
    record does to volts and drives is one of them too, and with a quarter turn for what unlike pick-offs make of a rate it would not be:
    of a hemisphere whose channels are 6 us apart, 0.3 rad of its carrier, that was a reading by ``Omega^2`` of 54 in chi-square.
    """
    sides = []
    for place in (SIGNAL, QUIET):
        vectors = []
        for r in evidence:
            s = r.signals
            derivatives = [np.gradient(np.gradient(s.rate_rad_s, s.row_s), s.row_s)]
            while len(derivatives) < len(_MOMENTS):
                derivatives.append(np.gradient(derivatives[-1], s.row_s))
            turning = s.pick @ reaction.T
            vectors.append(r.turn * place.projector(r).plain([d[:, None] * turning for d in derivatives]))
        sides.append(vectors)
    row_s = max(1.0 / r.recording.sample_rate_hz for r in evidence)
    size_s = math.sqrt(ROW_MOMENT * row_s**2 + _LAG_S**2)
    signal, quiet = sides
    return [
        Column(f"table_{name}", tuple(v[:, k] for v in signal), tuple(v[:, k] for v in quiet), size_s ** (k + 2))
        for k, name in enumerate(_MOMENTS)
    ]


def _carrier_phases(evidence: CampaignEvidence, reaction: ComplexArray) -> list[Column]:
    """What a step that takes less than a period leaves, by the carrier's phase phi at that moment: each step of each recording by itself.

    Motion and velocity go on, but the velocity is ``i w p + p'``, and p' is another after the step. So p jumps by
    ``-i (kappa dOmega / 2 w) (1 + e^{-2 i phi})`` times its reaction, of which averaging holds the mean. A slower step leaves nothing.
    """
    columns = []
    for r in evidence:
        s = r.signals
        for k, change in enumerate(_changes(s.rate_rad_s, s.row_s) if is_turned(r.recording) else ()):
            jump = (change / (2.0 * s.omega0_rad_s))[:, None] * (s.pick @ reaction.T)
            alone = [
                tuple(
                    r.turn * place.projector(r).plain([jump])[:, 0] if e is r else np.zeros_like(lhs)
                    for e, lhs in zip(evidence, of_all, strict=True)
                )
                for place, of_all in ((SIGNAL, [e.signal.lhs for e in evidence]), (QUIET, [e.quiet.lhs for e in evidence]))
            ]
            # a servo that takes its steps by the millisecond turns by a little more or less: of the same form, and larger
            servo = 2.0 * s.omega0_rad_s * _SERVO_S
            for name, factor, size in (("re", 1.0, math.hypot(_OF_PHASE, servo)), ("im", 1j, _OF_PHASE)):
                signal, quiet = (tuple(factor * v for v in side) for side in alone)
                columns.append(Column(f"table_step_{r.index}_{k}_{name}", signal, quiet, size))
    return columns


def _changes(rate: FloatArray, row_s: float) -> list[FloatArray]:
    """How fast a rate changes [rad/s^2], step by step; nothing of a course that is none of steps."""
    slope, rows = np.gradient(rate, row_s), np.arange(rate.size)
    return [np.where((rows >= place.start) & (rows < place.stop), slope, 0.0) for place in step_rows(rate, row_s)]


def step_rows(rate: FloatArray, row_s: float) -> list[slice]:
    """Rows in which each step of a rate [rad/s] takes place; nothing of a course that is none of steps."""
    slope = np.gradient(rate, row_s)
    moves = np.abs(slope) > _STILL * float(np.abs(slope).max(initial=0.0))
    steps = [place for (place,) in find_objects(label(moves)[0])]
    if len(steps) > _MOST_STEPS or any((place.stop - place.start) * row_s > _STEP_S for place in steps):
        return []
    return steps


def steps_of(values: Mapping[str, float], angular_gain: float) -> tuple[dict[int, float], float]:
    """How late the table's steps were, by recording, and how long they took [s], by a fit with the factory's response to rate taken off.

    ``Omega(t - tau) = Omega - tau Omega'``; a ramp of length T about its middle is ``Omega + T^2 / 24 Omega''``.
    """
    kappa = angular_gain + values.get("rate_anti_re", 0.0)
    late = {int(name.rsplit("_", 1)[1]): -value / kappa for name, value in values.items() if name.startswith("table_lag_")}
    square = max((x**2 for x in late.values()), default=0.0)
    return late, math.sqrt(max(-24.0 * values.get("table_blur", 0.0) / kappa - 12.0 * square, 0.0))


def in_time(evidence: CampaignEvidence, late_s: Mapping[int, float], length_s: float) -> CampaignEvidence:
    """The same recordings with the table's log later by this, by index, and its steps ramps of this length."""
    logged = {i: evidence.recordings[i].recording for i in late_s}
    return evidence.replaced(
        {i: shifted(r, late_s[i], length_s) for i, r in logged.items() if isinstance(r.extras["applied_rate"], Mapping)}
    )


def said_late(evidence: CampaignEvidence, late_s: Mapping[int, float]) -> list[str]:
    """One line per recording whose table was later, or earlier, than a motor is."""
    names = [(evidence.recordings[i].recording.label, x) for i, x in late_s.items() if abs(x) > _TOLD_S]
    return [
        f"The table of recording {label!r} turned {1e3 * abs(x):.0f} ms {'later' if x > 0.0 else 'earlier'} than its applied_rate says: "
        "taken off. Check the clock of the table's log and the delay of the recorder's filter."
        for label, x in names
    ]


def shifted(recording: Recording, late_s: float, length_s: float) -> Recording:
    """A recording with its table's log later by ``late_s`` and its steps ramps of ``length_s`` (both s)."""
    words: dict[str, Any] = dict(recording.extras["applied_rate"])
    unit = "deg_s" if "deg_s" in words else "rad_s"
    begun, *edges = (float(t) for t in words["t_s"])
    first, *heights = (float(rate) for rate in words[unit])
    # what the table did before its first step it had done all the time
    times, rates = [begun], [first]
    if is_straight(words):
        times += [t + late_s for t in edges]
        rates += heights
    else:
        # a log of many small steps is a course already
        half = 0.5 * min([length_s, *np.diff([begun, *edges])])
        for t, rate in zip(edges, heights, strict=True):
            times += [t + late_s - half, t + late_s + half]
            rates += [rates[-1], rate]
        words["kind"] = "linear"
    in_order = [float(t) for t in np.maximum.accumulate(np.maximum(times, begun))]
    return replace(recording, extras={**recording.extras, "applied_rate": {**words, "t_s": in_order, unit: rates}})
