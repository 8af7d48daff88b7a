"""A rate that rings after each step of a table: what carries the gyro is a spring, and the table's log does not hold it.

What the linear device leaves across the wave after a step of the log is asked for ``exp(-s t)`` times a cosine and a sine of one frequency,
as large as the step and of its sign, at every frequency and decay that rings for some cycles. A table's motor is late, takes its time,
creeps and may overshoot once; it does not ring. How far the steps differ from one another is the noise: of N of them the common size z has
``(N - 1) ln(1 + W |z|^2 / S)`` of log likelihood, W the weights' sum and S that of the weighed squares about it (an F test with 2 and
2 N - 2 degrees of freedom, whose chance that is). Steps that are followed by too little, and recordings of a straight course, say nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..recording.applied_rate import is_turned
from .diagnosis import Unknown
from .evidence import CampaignEvidence
from .flow_left import rows_left
from .parts import Linear
from .rate_table import step_rows

__all__ = ["Ringing", "find_ringing"]

FloatArray = NDArray[np.float64]
#: what is left to a motor after a step, and before the next one [s]; shortest and longest time that is asked after it
_MOTOR_S, _BEFORE_S, _LEAST_S, _MOST_S = 0.15, 0.05, 0.7, 4.0
#: how a motor creeps to its speed: decays that have a size of their own after each step [s]
_CREEPS_S = (0.05, 0.2, 0.8)
#: cycles until it is 1/e; distance of the frequencies over what the time after a step tells apart; fewest cycles in it; most over the rows'
#: rate
_CYCLES, _STEP, _FEWEST_CYCLES, _HIGHEST = (1.5, 3.0, 6.0, 12.0), 0.2, 2.0, 0.2
#: log evidence beyond the search from which on it rings, fewest steps, share of the common size within which all but one of them are
_MARGIN, _FEWEST, _ALIKE = 15.0, 4, 0.3


@dataclass(frozen=True)
class Ringing:
    """What rings.

    Parameters
    ----------
    frequency_hz, decay_s : float
    share : float
        Of a step, at its time.
    steps : int
    gain : float
        Twice the log likelihood.
    power : float
        Sum of its squares.
    """

    frequency_hz: float
    decay_s: float
    share: float
    steps: int
    gain: float
    power: float

    def unknown(self) -> Unknown:
        """As something that is not in the catalogue."""
        form = f"a rate of {self.share:.2g} of each step of the table that rings at {self.frequency_hz:.3g} Hz for {self.decay_s:.2g} s"
        return Unknown("environment", "in phase", form, "rate", "base_sway", self.gain)


def find_ringing(evidence: CampaignEvidence, linear: Linear) -> Ringing | None:
    """What rings after the steps of a table, or None.

    Parameters
    ----------
    evidence : CampaignEvidence
        With the table's log as the fit mended it.
    linear : Linear
    """
    after = _after_steps(evidence, linear)
    if len(after) < _FEWEST:
        return None
    rows_hz = 1.0 / float(after[0].time_s[1] - after[0].time_s[0])
    lasts_s = float(np.median([np.ptp(a.time_s) for a in after]))
    frequencies = np.arange(_FEWEST_CYCLES / lasts_s, _HIGHEST * rows_hz, _STEP / lasts_s)
    tried = [_rung(after, f, cycles / f, linear.angular_gain) for f in frequencies for cycles in _CYCLES]
    found = [t for t in tried if t is not None and t.gain / 2.0 - math.log(len(tried)) > _MARGIN]
    # what is small may be alike to a thousandth: of those that ring the one that is most of what is left
    return max(found, key=lambda t: t.power, default=None)


@dataclass(frozen=True)
class _After:
    """What is left across the wave after one step.

    Parameters
    ----------
    time_s, left : ndarray, shape (n,)
        Since the step; relative rate [1/s].
    beside : ndarray, shape (n, k)
        Orthonormal: its mean, its slope, and how a motor creeps.
    steps_rad_s, since_s : ndarray, shape (m,)
        It and those before it, and how long before it they were.
    """

    time_s: FloatArray
    left: FloatArray
    beside: FloatArray
    steps_rad_s: FloatArray
    since_s: FloatArray

    def size(self, frequency_hz: float, decay_s: float) -> tuple[complex, float]:
        """Size of what rings over the steps, and its weight."""
        turning = 2j * math.pi * frequency_hz - 1.0 / decay_s
        rings = np.exp(turning * self.time_s) * complex(self.steps_rad_s @ np.exp(turning * self.since_s))
        columns = np.stack([rings.real, rings.imag], axis=1)
        columns = columns - self.beside @ (self.beside.T @ columns)
        (c, s), *_ = np.linalg.lstsq(columns, self.left, rcond=None)
        return complex(c, s), float(np.sum(columns**2))


def _rung(after: Sequence[_After], frequency_hz: float, decay_s: float, angular_gain: float) -> Ringing | None:
    """What rings at a frequency, if the steps agree on it but for one."""
    found = [a.size(frequency_hz, decay_s) for a in after]
    sizes, weights = np.array([z for z, _ in found]), np.array([w for _, w in found])
    z = complex(weights @ sizes / weights.sum())
    apart = np.abs(sizes - z)
    if np.count_nonzero(apart < _ALIKE * abs(z)) < len(after) - 1:
        return None
    power = float(weights.sum()) * abs(z) ** 2
    gain = 2.0 * (len(after) - 1) * math.log1p(power / float(weights @ apart**2))
    return Ringing(float(frequency_hz), float(decay_s), abs(z) / angular_gain, len(after), gain, power)


def _after_steps(evidence: CampaignEvidence, linear: Linear) -> list[_After]:
    found = []
    for r in evidence:
        s = r.signals
        if not is_turned(r.recording):
            continue
        across = rows_left(s, linear)[2].real
        # a course has none
        places = step_rows(s.rate_rad_s, s.row_s)
        middles_s = np.array([0.5 * (place.start + place.stop) * s.row_s for place in places])
        rises = np.array([s.rate_rad_s[min(p.stop, across.size - 1)] - s.rate_rad_s[max(p.start - 1, 0)] for p in places])
        ends = [*(place.start for place in places[1:]), across.size][: len(places)]
        for k, (place, end) in enumerate(zip(places, ends, strict=True)):
            begin = place.stop + math.ceil(_MOTOR_S / s.row_s)
            end = min(end - math.ceil(_BEFORE_S / s.row_s), begin + int(_MOST_S / s.row_s))
            if (end - begin) * s.row_s < _LEAST_S:
                continue
            time = np.arange(begin, end) * s.row_s - middles_s[k]
            creeps = [np.ones_like(time), time, *(np.exp(-time / tau) for tau in _CREEPS_S)]
            beside = np.linalg.qr(np.stack(creeps, axis=1))[0]
            found.append(_After(time, across[begin:end], beside, rises[: k + 1], middles_s[k] - middles_s[: k + 1]))
    return found
