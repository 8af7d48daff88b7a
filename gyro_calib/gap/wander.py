"""How a resonance wandered within a recording, told by the recording itself, for what feeds through and does not wander with it.

A millikelvin moves the resonance of a hemisphere by 4 mrad/s. On the wave that is the noise of its frequency channel, which is known as
such; but of the volts ``V = m + E u`` only m goes with it. What feeds through is, with 2.4 V of virtual precession and E = 2e-4, half a
thousandth of the wave, and comes out across it: four standard deviations at the lowest lines of a ninth plant's precessing waves, healthy
ones, which were *unknown* for it. The frequency channel itself tells the course a hundred times as well as that asks for.

Where the temperature or the rate moves, or the amplitude is modulated, effects move the resonance as well and have their own column there;
those recordings are left alone, and so is what goes with the turning wave.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..recording.applied_rate import is_turned
from .evidence import CampaignEvidence, RecordingEvidence
from .flow_left import rows_left
from .nuisance import SWITCHED
from .parts import Linear

__all__ = ["wander_within"]

FloatArray = NDArray[np.float64]
#: half cosines of a recording's time; of a wave that turns as many as stay below what goes with twice its azimuth; of one that turns too
#: little for three, two
_COSINES, _BELOW_TURN, _FEWEST = 8, 0.7, 2
#: azimuth that a wave at rest keeps to [rad]; harmonics of the azimuth that belong to the device
_AT_REST, _HARMONICS = 0.3, (2.0, 4.0)


def wander_within(evidence: CampaignEvidence, linear: Linear) -> tuple[FloatArray, ...]:
    """Distance of the resonance beyond what ``linear`` knows of it [rad/s], by recording, shape (n,) each; zero where it is left alone."""
    return tuple(_wander(r, linear) if _is_told(r) else np.zeros(len(r.signals.time_s)) for r in evidence)


def _is_told(r: RecordingEvidence) -> bool:
    command = r.recording.command
    still = command.excitation.kind == "none" and command.mode not in SWITCHED
    return r.is_wave and still and not r.is_warming and not is_turned(r.recording)


def _wander(r: RecordingEvidence, linear: Linear) -> FloatArray:
    azimuth, along, _ = rows_left(r.signals, linear)
    turned_rad = abs(float(azimuth[-1] - azimuth[0]))
    below = int(_BELOW_TURN * 4.0 * turned_rad / (2.0 * math.pi))
    count = _COSINES if turned_rad < _AT_REST else min(_COSINES, max(below, _FEWEST))
    place = math.pi * (np.arange(len(azimuth)) + 0.5) / len(azimuth)
    slow = np.cos(np.outer(place, np.arange(count + 1)))
    fast = [f(h * azimuth) for h in _HARMONICS for f in (np.cos, np.sin)] if below > _FEWEST else []
    sizes, *_ = np.linalg.lstsq(np.column_stack([slow, *fast]), along.imag, rcond=None)
    return np.asarray(slow @ sizes[: count + 1])
