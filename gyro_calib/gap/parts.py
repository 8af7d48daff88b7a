"""What an envelope form is: parts of a signal that enter the flow, the drive or the pick-off of a linear device."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .followed import Followed
from .signals import Signals

__all__ = [
    "REST",
    "SKEW",
    "SPLIT",
    "UNEQUAL",
    "Form",
    "Kind",
    "Linear",
    "Part",
    "Setting",
    "beside",
    "motion",
    "one_axis",
    "read_at_once",
    "turned",
    "unexplained",
    "velocity",
]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: a part that is no parameter of its effect: what the unit's own pick-offs make of it
SKEW = "skew"
#: one that is as large as the effect itself, to either side, so that the effect is not seen without it
REST = f"{SKEW}_rest"
#: how unequal the pick-offs of a unit are
UNEQUAL = 0.03
#: what parts the two modes: along the axes, and between them, shape (2, 2) each
SPLIT = (np.diag([1.0, -1.0]), np.eye(2)[::-1])
#: J: what a rate does to the motion
QUARTER_TURN = np.array([[0.0, -1.0], [1.0, 0.0]], dtype=complex)
#: where a part enters: added to p', to the drive (through G), or to the pick-off's volts
Kind = Literal["flow", "drive", "output"]
#: values of the parameters that are not linear
Setting = Mapping[str, float]
#: share of the motion by which it is moved to see what follows of it
_STEP = 1e-4


@dataclass(frozen=True)
class Linear:
    """What the forms need to know of the linear device.

    Parameters
    ----------
    A, G, E : ndarray, shape (2, 2), complex
    angular_gain : float
        kappa of the factory, as the pick-offs read it where a table tells (`rate_table.gain_as_read`).
    frequency_slope_rad_s_k : float
        Change of the resonance with temperature.
    moved_rad_s : tuple of ndarray, complex
        By recording and row what the temperature and the resonance's wander add to the diagonal of A: damping, and i times how far the
        resonance lay from the frequency of reference; empty: as the slope says.
    followed : Followed or None
        Where the resonance lay before anything had a name: the column of E takes off what feeds through there. None: not known.
    reaction : ndarray, shape (2, 2), complex
        What a rate does to the volts over kappa, ``P J P^-1`` of the pick-offs P: of those that are square and alike a quarter turn.
    """

    A: ComplexArray
    G: ComplexArray
    E: ComplexArray
    angular_gain: float
    frequency_slope_rad_s_k: float
    moved_rad_s: tuple[ComplexArray, ...] = ()
    followed: Followed | None = None
    reaction: ComplexArray = field(default_factory=lambda: QUARTER_TURN)

    def acting(self, s: Signals, x: ComplexArray) -> ComplexArray:
        """A x, with A at each row's resonance, damping and applied rate, shape (n, 2)."""
        turning = self.angular_gain * s.rate_rad_s[:, None] * self.reacting(x)
        return np.asarray(x @ self.A.T + self.moved(s)[:, None] * x - turning)

    def reacting(self, x: ComplexArray) -> ComplexArray:
        """What a rate does to x, over kappa and the rate, shape (n, 2) as x: the reading of a bias, and of a table's steps."""
        return np.asarray(x @ self.reaction.T)

    def resting(self, s: Signals, x: ComplexArray) -> ComplexArray:
        """The same in the frame of the resonance, wherever that is, shape (n, 2)."""
        return np.asarray(self.acting(s, x) - 1j * self.moved(s).imag[:, None] * x)

    def moved(self, s: Signals) -> ComplexArray:
        """What is added to the diagonal of A [rad/s], shape (n,)."""
        return self.moved_rad_s[s.index] if self.moved_rad_s else np.asarray(1j * self.frequency_slope_rad_s_k * s.temperature_k)


@dataclass(frozen=True)
class Part:
    """Signal that one unit of a parameter adds, and where.

    Parameters
    ----------
    parameter : str
    kind : str
    signal : ndarray, shape (n, 2), complex
    speed : ndarray, shape (n, 2), complex, optional
        Of a pick-off's volts that follow the motion at once: how fast they change in the frame of the resonance.
    """

    parameter: str
    kind: Kind
    signal: ComplexArray
    speed: ComplexArray | None = None


@dataclass(frozen=True)
class Form:
    """Envelope form of an effect.

    Parameters
    ----------
    parts : callable
        (signals, linear device, setting) -> parts.
    settings : callable
        (all signals) -> settings to try (one empty setting where the effect is linear in all its parameters).
    per_axis : str or None
        Name in the registry of the variant whose setting has ``axes`` = 1.
    """

    parts: Callable[[Signals, Linear, Setting], list[Part]]
    settings: Callable[[list[Signals]], list[Setting]] = lambda signals: [{}]
    per_axis: str | None = None


def beside(name: str, kind: Kind, x: ComplexArray) -> Part:
    """What may come with an effect, as large as ``x`` for one unit of it, to either side."""
    return Part(f"{SKEW}_{name}", kind, x / UNEQUAL)


def one_axis(x: ComplexArray, axis: int) -> ComplexArray:
    """x of one axis, nothing on the other."""
    out = np.zeros_like(x)
    out[:, axis] = x[:, axis]
    return out


def motion(s: Signals, d: Linear) -> ComplexArray:
    """Motion in pick-off volts, ``V - E u``, shape (n, 2)."""
    return s.once("motion", d, lambda: np.asarray(s.pick - s.drive @ d.E.T))


def unexplained(s: Signals, d: Linear) -> ComplexArray:
    """What the linear device leaves of how its motion changes, ``L[m] - A m - G u`` [V/s], shape (n, 2)."""
    m = motion(s, d)
    return np.asarray(s.speed_of(m) - d.acting(s, m) - s.drive @ d.G.T)


def turned(x: ComplexArray) -> ComplexArray:
    """J x, a quarter turn of every row, shape (n, 2): what a rate does to the motion."""
    out = np.empty_like(x)
    out[:, 0], out[:, 1] = -x[:, 1], x[:, 0]
    return out


def velocity(s: Signals, d: Linear) -> ComplexArray:
    """What damping acts on, over i omega0: of a wave that turns or grows the velocity is not quite the motion a quarter period on."""
    p = motion(s, d)
    return s.once("velocity", d, lambda: np.asarray(p + np.gradient(p, s.row_s, axis=0) / (1j * s.omega0_rad_s)))


def read_at_once(parameter: str, s: Signals, d: Linear, f: Callable[[ComplexArray], ComplexArray]) -> Part:
    """Volts f(V) of a pick-off that follow the motion at once, row by row (both (n, 2) [V]), and how fast they change [V/s].

    ``L[o] - A o`` holds the resonance's distance from the reference twice, and it cancels where f turns with the phase of V. So the flow
    says how fast o changes, and nobody needs to know where the resonance was: to 1e-4 rad/s no thermometer knows that.
    """
    forth, back, step = s.once("beside the flow", d, lambda: _beside(s, d))
    read = f(s.pick)
    # how f itself changes with time: all of the change, but for what the recorded motion makes of it, what the flow does
    along = (f(forth) - f(back)) / (2.0 * step)
    return Part(parameter, "output", read, np.asarray(np.gradient(read, s.row_s, axis=0) + along))


def _beside(s: Signals, d: Linear) -> tuple[ComplexArray, ComplexArray, float]:
    """The pick-off's volts moved by what the flow says of their speed beyond what was recorded: forth, back, and for how long [s]."""
    v = s.pick
    flow = d.resting(s, v - s.drive @ d.E.T) + s.drive @ d.G.T + np.gradient(s.drive, s.row_s, axis=0) @ d.E.T
    speed = flow - np.gradient(v, s.row_s, axis=0)
    fastest = float(np.linalg.norm(speed))
    step = _STEP * float(np.linalg.norm(v)) / fastest if fastest > 0.0 else 1.0
    return np.asarray(v + step * speed), np.asarray(v - step * speed), step
