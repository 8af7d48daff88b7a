"""First-order memories, carried from one recording to the next: what a charge, a relaxing stiffness or a warm frame still know of before.

A memory of seconds has not settled when a recording begins: it holds some of the setting before. Between two recordings what it remembers
is taken to have been as the second begins (a command is given at once), a temperature to have gone straight from the one to the other.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from .signals import Signals

__all__ = ["remembered"]

ComplexArray = NDArray[np.complex128]
#: time constants after which a memory is over
_FORGOTTEN = 6.0
#: rows at the ends of a recording whose mean is its value there [s]
_END_S = 0.1


def remembered(s: Signals, of: Callable[[Signals], ComplexArray], tau_s: float, *, steady: bool = True) -> ComplexArray:
    """A signal of a recording through a first-order low-pass that began long before it.

    Parameters
    ----------
    s : Signals
        Their ``before`` is the recording that came before, if any.
    of : callable
        Signals -> (n, k), complex.
    tau_s : float
        Time constant [s].
    steady : bool
        Between recordings the signal is as the later one begins; False: it goes straight there.
    """
    chain = [s]
    while (before := chain[-1].before) is not None and float(s.time_s[0] - chain[-1].time_s[0]) < _FORGOTTEN * tau_s:
        if before.time_s[-1] > chain[-1].time_s[0]:
            # clocks that begin anew say nothing of what came before
            break
        chain.append(before)
    out, state, earlier = np.zeros(0, complex), None, None
    for here in reversed(chain):
        x = of(here)
        first, last = _ends(here, x)
        if state is None or earlier is None:
            # the first that is known: settled to what it shows over its first time constant
            start = x[: max(1, min(len(x), round(tau_s / here.row_s)))].mean(axis=0)
        else:
            start = _across(state, earlier[1], first, float(here.time_s[0]) - earlier[0], tau_s, steady)
        out = _low_pass(x, here.row_s, tau_s, start)
        state, earlier = out[-1], (float(here.time_s[-1]), last)
    return out


def _ends(s: Signals, x: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    rows = max(1, min(len(x), round(_END_S / s.row_s)))
    return x[:rows].mean(axis=0), x[-rows:].mean(axis=0)


def _across(state: ComplexArray, last: ComplexArray, first: ComplexArray, gap_s: float, tau_s: float, steady: bool) -> ComplexArray:
    """The memory after a gap."""
    left = np.exp(-gap_s / tau_s)
    if steady or gap_s == 0.0:
        return np.asarray(first + (state - first) * left)
    behind = tau_s * (first - last) / gap_s
    return np.asarray(first - behind + (state - last + behind) * left)


def _low_pass(x: ComplexArray, row_s: float, tau_s: float, start: ComplexArray) -> ComplexArray:
    share = 1.0 - np.exp(-row_s / tau_s)
    out, _ = lfilter([share], [1.0, share - 1.0], x, axis=0, zi=((1.0 - share) * start)[None, :])
    return np.asarray(out)
