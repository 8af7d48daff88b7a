"""Recordings that are louder than others of their kind: what happened in one of them alone has no form, and is no noise either.

Of recordings whose temperature moves there are two or three, each by itself, so what they hold beyond every effect is their noise: of a
damping that peaks where a resonance of the gas is passed, 80 and 1200 times the noise at rest was believed, and there was seven times that.

A small effect beside it is none of its cause: of a preamplifier that changes its range one side band held 23 times its noise, 460 in
squares, and a dry friction of 69 was the verdict.

The frequency is that of a resonator whose own temperature wanders by millikelvins, now more, now less: the loudest of eight records of a
healthy hemisphere held nine times what all of them did.

Where the drive changes, its delay and its feedthrough do so as well, and only an open drive of both axes tells those: without one a side
band that is loud has no name because nobody could ask, not because there is none (a delay of 44 us, 39 times the noise).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..recording.applied_rate import is_turned
from .diagnosis import FoundEffect, Unknown
from .evidence import CHANNELS, RecordingEvidence
from .missing import drive_changes
from .model import CampaignModel
from .saturated import open_drive
from .signals import held_readings
from .system import Solution

__all__ = ["Loud", "loudest"]

FloatArray = NDArray[np.float64]
#: power over that of its kind from which on a recording is not of its kind; those of some forty healthy campaigns came to 4.4
_LOUD = 8.0
#: power of a warmed recording over that of its mode at rest from which on it holds more than noise; along a wave, where the damping acts,
#: one healthy hemisphere of trials came to 325, across it 27 healthy units to 7 and a practice hemisphere to 34
_WARMED, _WARMED_ACROSS = 1000.0, 150.0


@dataclass(frozen=True)
class Loud:
    """A recording that no model follows.

    Parameters
    ----------
    label, channel : str
    ratio : float
        Power of what is left over the noise of its kind.
    equations : int
        Of that channel.
    warmed : bool
        The noise of its kind is that of recordings at rest.
    untested : bool
        What a changing drive does here is not told without an open one, which there is not.
    """

    label: str
    channel: str
    ratio: float
    equations: int
    warmed: bool = False
    untested: bool = False

    @property
    def gain(self) -> float:
        """What it is worth: squares of its channel, over the noise of its kind."""
        return self.ratio * self.equations

    def may_be_of(self, effects: Sequence[FoundEffect]) -> bool:
        """Whether one of them is worth more, so that its form, of first order, may have left this."""
        return any(e.gain > self.gain for e in effects)

    def warning(self) -> str:
        """For the reader of any verdict."""
        if self.untested:
            return f"R{self.not_testable()[1:]}. Record open drives of both axes."
        return (
            f"Recording {self.label} holds {self.ratio:.0f} times the noise of {self._kind} ({self.channel}), "
            "and nothing here has its form. Record it again: what comes back is of the device, what does not was a disturbance."
        )

    def not_testable(self) -> str:
        """Why it is no finding."""
        return (
            f"recording {self.label} holds {self.ratio:.0f} times the noise of {self._kind} ({self.channel}), as a drive's delay or "
            "feedthrough may make it, and nothing tells those without an open drive of both axes"
        )

    @property
    def _kind(self) -> str:
        return "recordings at rest" if self.warmed else "its kind"

    def unknown(self) -> Unknown:
        """As a finding."""
        holds = "holds while its temperature moves" if self.warmed else "alone holds"
        form = f"what recording {self.label} {holds} ({self.channel}, {self.ratio:.0f} times the noise of {self._kind})"
        depends = "temperature" if self.warmed else "recording"
        return Unknown("environment", "phase not told", form, depends, "", self.gain)


def loudest(model: CampaignModel, solution: Solution) -> Loud | None:
    """The loudest recording, if one is not of its kind; not of a rate table, which does things besides its log.

    Parameters
    ----------
    model : CampaignModel
    solution : Solution
        With the effects that were chosen: what they explain of a recording is not loud.
    """
    found, first, untold = [], 0, not open_drive(model.evidence)
    for r in model.evidence:
        rows = slice(first, first := first + 2 * r.signal.lhs.size)
        for channel in CHANNELS:
            if channel == "frequency":
                continue
            left = _left(solution.residual[rows], model.base.residual[rows], channel)
            if not is_turned(r.recording) and (own := left * model.excess.get((r.index, channel), 0.0)) > _LOUD:
                found.append(
                    Loud(r.recording.label, channel, own, r.signal.lhs.size, untested=untold and drive_changes(r.recording.command))
                )
            warmed = left * _over_rest(model, r, channel) if _is_told_warming(r) else 0.0
            if warmed > (_WARMED if channel == "amplitude" else _WARMED_ACROSS):
                found.append(Loud(r.recording.label, channel, warmed, r.signal.lhs.size, warmed=True))
    return max(found, key=lambda loud: loud.ratio, default=None)


def _left(residual: FloatArray, before: FloatArray, channel: str) -> float:
    """Share of the squares of a wave's channel that effects leave; 1 at most."""
    quarter = residual.size // 4
    place = ("amplitude", "precession", "frequency", "quadrature").index(channel)
    own = slice(place * quarter, (place + 1) * quarter)
    return min(float(np.sum(residual[own] ** 2)) / max(float(np.sum(before[own] ** 2)), 1e-300), 1.0)


def _is_told_warming(r: RecordingEvidence) -> bool:
    """Whether a wave's temperature moved and was read often enough: between two readings of a second it is known to some 50 mK."""
    return r.is_warming and r.is_wave and not len(held_readings(r.recording))


def _over_rest(model: CampaignModel, r: RecordingEvidence, channel: str) -> float:
    """Power of a recording over the noise of its mode at rest."""
    rest = model.noise.get((r.parent_role, channel))
    if rest is None:
        return 0.0
    lines = r.lines(channel)
    louder = model.noise[r.noise_key(channel)].density(lines) / rest.density(lines)
    return float(louder.mean()) * model.excess.get((r.index, channel), 1.0)
