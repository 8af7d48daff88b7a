"""First-order memories, carried from one recording to the next: what a charge, a relaxing stiffness or a warm frame still know of before.

A memory of seconds has not settled when a recording begins: it holds some of the setting before. Between two recordings what it remembers
is taken to have been as the second begins (a command is given at once), and a wave that precesses then to have precessed before; a
temperature to have gone straight from the one to the other. Where it would have had to go faster than it ever does, the clock stood between
them, and the second begins settled: the practice campaigns are at 35 degC at the end of a warmed recording and at 25 degC a second later.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from .signals import Signals

__all__ = ["behind", "remembered"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: time constants after which a memory is over
_FORGOTTEN = 6.0
#: rows at the ends of a recording whose mean is its value there; over which a wave's precession is read [s]
_END_S, _TURN_S = 0.1, 1.0
#: signals of two axes as what turns with the pattern and against it
_CIRCULAR = np.array([[1.0, 1.0], [1j, -1j]])
_AXES = np.linalg.inv(_CIRCULAR)


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
    signals = [of(here) for here in reversed(chain)]
    turning = steady and signals[0].shape[1] == _AXES.shape[0]
    out, state, earlier = np.zeros(0, complex), None, None
    for here, axes in zip(reversed(chain), signals, strict=True):
        x = axes @ _CIRCULAR if turning else axes
        speed = _speed(x, here.row_s) if turning else np.zeros(x.shape[1])
        # what goes straight is smooth, and may be on its way where a recording begins and ends
        rows = _rows(_END_S, here) if steady else 1
        first = _begun(x[:rows], here.row_s, speed)
        if state is None or earlier is None:
            # the first that is known: settled to what it shows over its first time constant, and what goes straight, to where it begins
            known = _rows(tau_s if steady else _END_S, here)
            start = _begun(x[:known], here.row_s, speed) / (1.0 + 1j * speed * tau_s)
        elif steady:
            start = _held(state, first, float(here.time_s[0]) - earlier[0], tau_s, speed)
        else:
            start = _straight(state, earlier[1], first, float(here.time_s[0]) - earlier[0], tau_s)
        out = _low_pass(x, here.row_s, tau_s, start)
        state, earlier = out[-1], (float(here.time_s[-1]), x[-rows:].mean(axis=0))
    return out @ _AXES if turning else out


def behind(s: Signals, tau_s: float) -> ComplexArray:
    """By how much the temperature is ahead of itself through a low-pass [K], shape (n, 1).

    Parameters
    ----------
    s : Signals
    tau_s : float
        Time constant [s].
    """
    return s.once(("behind", tau_s), None, lambda: np.asarray(_temperature(s) - remembered(s, _temperature, tau_s, steady=False)))


def _temperature(s: Signals) -> ComplexArray:
    return s.temperature_k[:, None].astype(np.complex128)


def _speed(x: ComplexArray, row_s: float) -> FloatArray:
    """Angular frequency of each column as it begins [rad/s]."""
    rows = min(len(x), round(_TURN_S / row_s))
    lag = max(rows // 2, 1)
    return np.asarray(np.angle(np.sum(x[: rows - lag].conj() * x[lag:rows], axis=0)) / (lag * row_s))


def _begun(x: ComplexArray, row_s: float, speed: FloatArray) -> ComplexArray:
    """Mean of some rows, turned back to the first of them."""
    back = np.exp(-1j * speed * (np.arange(len(x)) * row_s)[:, None])
    return np.asarray((x * back).mean(axis=0))


def _rows(span_s: float, s: Signals) -> int:
    return max(1, min(len(s.time_s), round(span_s / s.row_s)))


def _held(state: ComplexArray, first: ComplexArray, gap_s: float, tau_s: float, speed: FloatArray) -> ComplexArray:
    """The memory after a gap in which the signal was as it begins then, but for its turning."""
    return np.asarray(
        state * np.exp(-gap_s / tau_s) + first * (1.0 - np.exp(-gap_s * (1.0 / tau_s + 1j * speed))) / (1.0 + 1j * speed * tau_s)
    )


def _straight(state: ComplexArray, last: ComplexArray, first: ComplexArray, gap_s: float, tau_s: float) -> ComplexArray:
    """The memory after a gap in which the signal went straight."""
    if gap_s == 0.0:
        return state
    behind = tau_s * (first - last) / gap_s
    return np.asarray(first - behind + (state - last + behind) * np.exp(-gap_s / tau_s))


def _low_pass(x: ComplexArray, row_s: float, tau_s: float, start: ComplexArray) -> ComplexArray:
    share = 1.0 - np.exp(-row_s / tau_s)
    out, _ = lfilter([share], [1.0, share - 1.0], x, axis=0, zi=((1.0 - share) * start)[None, :])
    return np.asarray(out)
