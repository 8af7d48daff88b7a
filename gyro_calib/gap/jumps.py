"""Something jumps within a recording: a gain, a loss, a cross coupling is another from one row to the next, though no command says so.

A force that jumps bends the sum of what the linear device leaves of the slow flow (:mod:`.flow_left`): from there on it has another
slope. A pick-off's gain that jumps kicks the wave, whose loops then bring the reading back to where it was: the sum itself steps. About a
row ``|t|`` tells the one and ``sign t`` the other, each beside a straight line, and neither is moved by the other; both are looked for
over several windows in units of their usual size, in recordings of the kind and in that one. So a relay with two resistances, a contact
that opens, a cell that flips are told from a knock on the bench, which is a kick and comes alone. Where the frequency jumps it may be the
resonator's millikelvins.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .diagnosis import Unknown
from .flow_left import FlowLeft

__all__ = ["Jumps", "find_jumps"]

FloatArray = NDArray[np.float64]
#: windows before and after a row [s]; they fit into a recording that is so many times as long
_WINDOWS_S, _TIMES = (0.5, 1.5, 4.0), 3.0
#: so many deviations of so many usual sizes are a finding: 16 healthy campaigns have one of 6.2 at most, a hemisphere five of 4.5 and more
_FINDINGS = ((3, 8.0), (6, 6.0))
_LEAST = min(size for _, size in _FINDINGS)
#: usual size of a normal deviate over the median of its magnitude
_MEDIAN = 1.4826
#: share of the largest one from which on others are counted
_COUNTED = 0.3
#: one of a force of so many usual sizes is a finding, too: a knock is an impulse, and comes alone
_ALONE = 12.0
#: what jumps, by channel, for a force and for an impulse
_WORDS = {
    "amplitude": ("drive or pick-off", "in phase", "x times a gain or a loss that jumps"),
    "precession": ("dynamics", "in phase", "x times a rate or a cross coupling that jumps"),
    "quadrature": ("dynamics", "in quadrature", "x times a cross stiffness that jumps"),
}
_KICKED = ("pick-off or environment", "phase not told", "kicks of the wave, as of a pick-off whose gain jumps")


@dataclass(frozen=True)
class Jumps:
    """What jumps.

    Parameters
    ----------
    channel : str
    kicks : bool
        Impulses, not forces that stay.
    count : int
    largest : float
        In units of the usual difference.
    records : tuple of str
        In which they were seen.
    """

    channel: str
    kicks: bool
    count: int
    largest: float
    records: tuple[str, ...]

    def unknown(self) -> Unknown:
        """As a finding."""
        location, phase, form = _KICKED if self.kicks else _WORDS[self.channel]
        seen = f"{self.count} times, in {', '.join(self.records[:4])}{' …' if len(self.records) > 4 else ''}"
        return Unknown(location, phase, f"{form} ({seen})", "time", "", self.largest**2)


def find_jumps(flows: Sequence[FlowLeft]) -> Jumps | None:
    """The jumps that are most, if they are a finding.

    Parameters
    ----------
    flows : sequence of FlowLeft
    """
    kinds: dict[tuple[object, ...], list[FlowLeft]] = defaultdict(list)
    for flow in flows:
        condition = (*flow.kind, flow.excited_hz)
        kinds[condition].append(flow)
    found = [jumps for channel in _WORDS for window_s in _WINDOWS_S for jumps in _of_channel(list(kinds.values()), channel, window_s)]
    return max(found, key=lambda jumps: jumps.largest, default=None)


@dataclass(frozen=True)
class _Event:
    """One jump."""

    label: str
    kick: bool
    size: float


def _of_channel(kinds: Sequence[Sequence[FlowLeft]], channel: str, window_s: float) -> list[Jumps]:
    """Forces that jump, and kicks."""
    events: list[_Event] = []
    for members in kinds:
        held = [flow for flow in members if flow.duration_s >= _TIMES * window_s and window_s >= 2.0 * flow.row_s]
        if held:
            events += _events(held, channel, window_s)
    found = []
    for kicks in (False, True):
        largest = max((e.size for e in events if e.kick is kicks), default=0.0)
        some = [e for e in events if e.kick is kicks and e.size > _COUNTED * largest]
        several = any(sum(e.size > size for e in some) >= count for count, size in _FINDINGS)
        if several or (largest > _ALONE and not kicks):
            found.append(Jumps(channel, kicks, len(some), largest, tuple(dict.fromkeys(e.label for e in some))))
    return found


def _events(members: Sequence[FlowLeft], channel: str, window_s: float) -> list[_Event]:
    """Where either deviation is largest, each event as what it is most."""
    deviations = [np.abs(_deviations(flow.rate[channel], round(window_s / flow.row_s))) for flow in members]
    of_all = _MEDIAN * np.median(np.concatenate(deviations, axis=1), axis=1, keepdims=True)
    if not np.all(of_all > 0.0):
        return []
    events = []
    for flow, deviation in zip(members, deviations, strict=True):
        # a recording that moves all the time has no jumps
        usual = np.maximum(of_all, _MEDIAN * np.median(deviation, axis=1, keepdims=True))
        size, apart = deviation / usual, round(2.0 * window_s / flow.row_s)
        while (largest := float(size.max())) > _LEAST:
            kick, place = np.unravel_index(int(np.argmax(size)), size.shape)
            events.append(_Event(flow.label, bool(kick), largest))
            size[:, max(0, place - apart) : place + apart + 1] = 0.0
    return events


def _deviations(rate: FloatArray, width: int) -> FloatArray:
    """Bend and step of the sum about every row that has a window to either side, shape (2, n)."""
    tau = np.arange(-width, width + 1) / width
    even, odd = np.abs(tau) - np.mean(np.abs(tau)), np.sign(tau)
    odd = odd - tau * float(tau @ odd) / float(tau @ tau)
    level = np.cumsum(rate)
    return np.stack([np.convolve(level, kernel[::-1] / np.linalg.norm(kernel), mode="valid") for kernel in (even, odd)])
