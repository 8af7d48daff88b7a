"""Monomials that the symmetry of two modes allows: what an unnamed term may be a multiple of, and what must vary for it to show."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from .cubic_forms import conjugate_product
from .forms import AT_REST
from .memory import behind, remembered
from .parts import one_axis, turned
from .signals import Signals

__all__ = ["APART", "DIRECTED", "FED", "LATE", "MONOMIALS", "RISING", "WARM_FED", "Monomial", "remembers", "size_of"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Monomial = Callable[[Signals, ComplexArray], ComplexArray]
Factor = Callable[[Signals], FloatArray | ComplexArray]
#: rate from which on a wave turns [rad/s], over how long it is told [s], and square of an azimuth's phasor that is none
_TURNS_RAD_S, _SENSE_S, _LEAST_TURNED = 0.01, 0.15, 1e-6


def size_of(x: ComplexArray) -> FloatArray:
    """Of both axes together, shape (n, 1)."""
    return np.asarray(np.sqrt(np.sum(np.abs(x) ** 2, axis=1))[:, None])


def _of_axes(x: ComplexArray) -> FloatArray:
    """Size of the signal of each axis; of one that is crossed through rest, no less than what keeps its phase from jumping."""
    return np.asarray(np.sqrt(np.abs(x) ** 2 + (AT_REST * size_of(x)) ** 2)) + 1e-9


def _on_each(f: Monomial) -> list[Monomial]:
    """One axis of it, and the other."""
    return [lambda s, x, k=k: one_axis(f(s, x), k) for k in range(2)]  # type: ignore[misc]


def _by(f: Callable[[Signals], FloatArray]) -> Monomial:
    return lambda s, x: f(s)[:, None] * x


def _each(*factors: Factor) -> list[Monomial]:
    """Factors, each of shape (n, 1), times the signal of one axis and of the other."""
    return [each for f in factors for each in _on_each(lambda s, x, f=f: f(s) * x)]  # type: ignore[misc]


def _crossed(*factors: Factor) -> list[Monomial]:
    """Factors times the signal of the other axis."""
    return [each for f in factors for each in _on_each(lambda s, x, f=f: f(s) * x[:, ::-1])]  # type: ignore[misc]


def _shaped(text: str, depends: str, *factors: Factor) -> dict[tuple[str, str], list[Monomial]]:
    """Factors times the signal, alike on both axes, other on each, and across."""
    alike: list[Monomial] = [lambda s, x, f=f: f(s) * x for f in factors]  # type: ignore[misc]
    return {
        (text, depends): alike,
        (f"{text}, other on each axis", depends): _each(*factors),
        (f"{text}, crossed", depends): _crossed(*factors),
    }


def _split(factor: Factor) -> list[Monomial]:
    """A factor times what parts the two modes, along the axes and between them."""
    return [lambda s, x: factor(s) * x * np.array([1.0, -1.0]), lambda s, x: factor(s) * x[:, ::-1]]


def _in_step(x: ComplexArray) -> FloatArray:
    """Mean of the product of both axes over a cycle, twice."""
    return np.asarray((x[:, 0] * x[:, 1].conj()).real)


def _by_motion(p: ComplexArray, x: ComplexArray) -> ComplexArray:
    """Twice the fundamental of m^2 x, m the motion's volts of each axis: a force across a gap that closes."""
    return np.asarray(np.abs(p) ** 2 * x + 0.5 * p**2 * x.conj())


def _lobes(s: Signals, x: ComplexArray, count: int) -> ComplexArray:
    """cos k theta + i sin k theta of a turning wave, k its lobes over a turn of the case: 4 and its multiples, shape (n, 1).

    What a drive does goes with the motion's azimuth, not with its own.
    """
    v = s.pick if x is s.drive else x
    stokes = np.abs(v[:, 0]) ** 2 - np.abs(v[:, 1]) ** 2 + 2j * _in_step(v)
    return np.asarray((stokes / (np.sum(np.abs(v) ** 2, axis=1) + 1e-18)) ** (count // 4))[:, None]


def _sense(s: Signals) -> FloatArray:
    """Which way the wave turns, shape (n, 1): 1 or -1, 0 where it stands."""

    def told() -> FloatArray:
        lobes = _lobes(s, s.pick, 4)[:, 0]
        turns_rad_s = 0.5 * np.imag(lobes.conj() * np.gradient(lobes, s.row_s)) / np.maximum(np.abs(lobes) ** 2, _LEAST_TURNED)
        return np.tanh(uniform_filter1d(turns_rad_s, max(1, round(_SENSE_S / s.row_s))) / _TURNS_RAD_S)[:, None]

    return s.once("which way the wave turns", None, told)


def _by_azimuth(count: int) -> dict[tuple[str, str], list[Monomial]]:
    """The signal by its cosine and sine of so many lobes, and the same turned by a quarter."""
    parts: list[Callable[[ComplexArray], FloatArray]] = [np.real, np.imag]
    text = f"x cos {count}theta, x sin {count}theta"
    return {
        (text, "azimuth"): [lambda s, x, f=f: f(_lobes(s, x, count)) * x for f in parts],  # type: ignore[misc]
        (f"{text}, crossed", "azimuth"): [lambda s, x, f=f: f(_lobes(s, x, count)) * turned(x) for f in parts],  # type: ignore[misc]
    }


def remembers(form: str) -> bool:
    """Whether a term by its form is a memory of what went before a recording."""
    return any(memory in form for memory in _MEMORIES)


def _late(s: Signals, x: ComplexArray, tau_s: float) -> ComplexArray:
    """Through a low-pass, begun settled: what went before is not known of an unnamed signal."""
    return remembered(replace(s, before=None), lambda _: x, tau_s)


def _warmed(s: Signals, tau_s: float, power: Callable[[Signals], ComplexArray]) -> FloatArray:
    """How far a power through a low-pass is ahead of that of now [V^2], shape (n, 1)."""
    return s.once(("warmed", tau_s, power), None, lambda: np.asarray((remembered(s, power, tau_s) - power(s)).real))


def _of_drives(s: Signals) -> ComplexArray:
    """Their power [V^2], shape (n, 1)."""
    return (size_of(s.drive) ** 2).astype(np.complex128)


def _of_motion(s: Signals) -> ComplexArray:
    """Its energy [V^2], shape (n, 1)."""
    return (size_of(s.pick) ** 2).astype(np.complex128)


def _own(tau_s: float) -> list[Monomial]:
    """By the power of each axis' own drive, or how far it is ahead through a low-pass."""
    return _on_each(lambda s, x: ((remembered(s, _of_each, tau_s) - _of_each(s)).real if tau_s else np.abs(s.drive) ** 2) * x)


def _of_each(s: Signals) -> ComplexArray:
    """Power of each axis' drive [V^2], shape (n, 2)."""
    return (np.abs(s.drive) ** 2).astype(np.complex128)


def _turning(s: Signals) -> ComplexArray:
    return s.rate_rad_s[:, None].astype(np.complex128)


def _rising(s: Signals) -> FloatArray:
    return np.asarray(np.gradient(s.temperature_k, s.row_s)[:, None])


def _by_direction() -> list[Monomial]:
    """Of one size whatever the amplitude, another at each azimuth: a dry friction along one direction, which need not be an axis.

    ``|cos a|`` along the wave and its slope across it, a from that direction: 1, 4 and 8 lobes hold all but a twelfth of their power.
    """
    along: list[Monomial] = [lambda s, x: x / (size_of(x) + 1e-9)]
    for count in (4, 8):
        for f in (np.real, np.imag):
            for to in (np.asarray, turned):
                along.append(lambda s, x, f=f, to=to, count=count: f(_lobes(s, x, count)) * to(x) / (size_of(x) + 1e-9))  # type: ignore[misc]
    return along


#: of either axis, in step with the reference and a quarter of a cycle behind it: what is constant has no phase to grow from
_CONSTANTS = [lambda x, k=k, f=f: one_axis(np.full_like(x, f), k) for k in range(2) for f in (1.0, 1j)]
#: alike on both axes, in the frequency of the motion, it is a thermometer that lags, as every one does
LATE, LATE_S = "(T - T of 20 s before) x", 20.0
RISING = "dT/dt x"
#: what remembers for longer than records settle
_MEMORIES = (" of 3 s|", " of 15 s|", LATE)
DIRECTED = "x/|x| by 4theta and 8theta"
#: of these one axis against the other
APART: dict[str, Factor] = {
    f"{LATE}, other on each axis": lambda s: behind(s, LATE_S),
    f"{RISING}, other on each axis": _rising,
}
#: monomials of a signal x by what they depend on; those of one entry are tried together
MONOMIALS: dict[tuple[str, str], list[Monomial]] = {
    ("|x|^1/2 x", "amplitude"): [lambda s, x: size_of(x) ** 0.5 * x],
    ("|x| x", "amplitude"): [lambda s, x: size_of(x) * x],
    ("|x|^3/2 x", "amplitude"): [lambda s, x: size_of(x) ** 1.5 * x],
    ("|x|^2 x", "amplitude"): [lambda s, x: size_of(x) ** 2 * x, lambda s, x: conjugate_product(x)],
    ("|x_j|^2 x_j", "amplitude"): _on_each(lambda s, x: np.abs(x) ** 2 * x),
    ("|x_k|^2 x_k on the other axis", "amplitude"): _on_each(lambda s, x: (np.abs(x) ** 2 * x)[:, ::-1]),
    ("|x_k|^2 x_j, k the other axis", "amplitude"): _on_each(lambda s, x: np.abs(x[:, ::-1]) ** 2 * x),
    ("|x| x, as a split", "amplitude"): _split(lambda s: size_of(s.pick)),
    ("|x|^2 x, as a split", "amplitude"): _split(lambda s: size_of(s.pick) ** 2),
    ("x/|x|, as a split", "amplitude"): _split(lambda s: 1.0 / (size_of(s.pick) + 1e-9)),
    ("|x of 3 s|^2 x", "amplitude"): [lambda s, x: size_of(s.pick) ** 2 * x, lambda s, x: _warmed(s, 3.0, _of_motion) * x],
    ("|x of 15 s|^2 x", "amplitude"): [lambda s, x: size_of(s.pick) ** 2 * x, lambda s, x: _warmed(s, 15.0, _of_motion) * x],
    ("|x|^2 x, crossed", "amplitude"): _crossed(lambda s: size_of(s.pick) ** 2),
    ("|x|^3 x", "amplitude"): [lambda s, x: size_of(x) ** 3 * x],
    ("|x|^4 x", "amplitude"): [lambda s, x: size_of(x) ** 4 * x],
    ("x/|x|", "amplitude"): [lambda s, x: x / (size_of(x) + 1e-9)],
    (DIRECTED, "amplitude"): _by_direction(),
    ("x_j/|x_j|", "amplitude"): _on_each(lambda s, x: x / _of_axes(x)),
    ("|x_j| x_j", "amplitude"): _on_each(lambda s, x: x * _of_axes(x)),
    ("x*", "phase reference"): [lambda s, x: x.conj()],
    **_shaped("T x", "temperature", lambda s: s.temperature_k[:, None]),
    ("T^2 x", "temperature"): [_by(lambda s: s.temperature_k**2)],
    **_shaped(RISING, "temperature", _rising),
    **_shaped(LATE, "temperature", lambda s: behind(s, LATE_S)),
    **_shaped("t x", "time", lambda s: s.time_s[:, None]),
    ("Omega x", "rate"): [_by(lambda s: s.rate_rad_s)],
    ("Omega x, crossed", "rate"): _crossed(lambda s: s.rate_rad_s[:, None]),
    ("Omega^2 x", "rate"): [_by(lambda s: s.rate_rad_s**2)],
    ("Omega^2 x, crossed", "rate"): _crossed(lambda s: (s.rate_rad_s**2)[:, None]),
    ("Omega of 1 s before x, turned", "rate"): [lambda s, x: (remembered(s, _turning, 1.0) - _turning(s)) * turned(x)],
    ("dx/dt", "speed of change"): [lambda s, x: np.gradient(x, s.row_s, axis=0)],
    ("d^2x/dt^2", "speed of change"): [lambda s, x: np.gradient(np.gradient(x, s.row_s, axis=0), s.row_s, axis=0)],
    ("x of 0.1 s before", "speed of change"): [lambda s, x: _late(s, x, 0.1)],
    ("x of 1 s before", "speed of change"): [lambda s, x: _late(s, x, 1.0)],
    ("x/(1 + i 10 Hz away)", "frequency"): [lambda s, x: x / (1.0 + 0.1j * (s.omega_rad_s - s.omega0_rad_s) / (2.0 * np.pi))[:, None]],
    ("a constant", "reference"): [lambda s, x, c=c: float(s.recording.command.mode != "loops_off") * c(x) for c in _CONSTANTS],  # type: ignore[misc]
    ("a constant, also in open drive", "reference"): [lambda s, x, c=c: c(x) for c in _CONSTANTS],  # type: ignore[misc]
    ("|u|^2 x, u the drives", "drive"): [lambda s, x: size_of(s.drive) ** 2 * x],
    ("|u|^2 x, u the drives, crossed", "drive"): _crossed(lambda s: size_of(s.drive) ** 2),
    ("|u_j of 0.7 s|^2 x_j, u the drives", "drive's power"): [*_own(0.0), *_own(0.7)],
    **_shaped("|u of 3 s|^2 x, u the drives", "drive's power", lambda s: size_of(s.drive) ** 2, lambda s: _warmed(s, 3.0, _of_drives)),
    **_shaped("|u of 15 s|^2 x, u the drives", "drive's power", lambda s: size_of(s.drive) ** 2, lambda s: _warmed(s, 15.0, _of_drives)),
    ("|u_j|^2 x_j, u the drives", "drive"): _on_each(lambda s, x: np.abs(s.drive) ** 2 * x),
    ("u_x u_y x on the other axis, u the drives", "drive"): [lambda s, x: _in_step(s.drive)[:, None] * x[:, ::-1]],
    ("|p_j|^2 x_j, p the motion", "amplitude"): _on_each(lambda s, x: _by_motion(s.pick, x)),
    ("x by the sense in which the wave turns", "azimuth"): _on_each(lambda s, x: _sense(s) * x),
    **_by_azimuth(4),
    **_by_azimuth(8),
    **_by_azimuth(12),
    **_by_azimuth(16),
}
#: what feeds through and is not in proportion to the drive: a varactor, a stray capacitance that the motion moves; or grows with the warmth
WARM_FED = "T u, u the drives"
FED: dict[tuple[str, str], list[Monomial]] = {
    ("|u|^2 u, u the drives", "drive"): [lambda s, x: size_of(s.drive) ** 2 * s.drive],
    ("|u_j|^2 u_j, u the drives", "drive"): _on_each(lambda s, x: np.abs(s.drive) ** 2 * s.drive),
    ("|p|^2 u, p the motion, u the drives", "amplitude"): [lambda s, x: size_of(s.pick) ** 2 * s.drive],
    ("|p_j|^2 u_j, p the motion, u the drives", "amplitude"): _on_each(lambda s, x: np.abs(s.pick) ** 2 * s.drive),
    ("|p_k|^2 u_j, p the motion of the other axis", "amplitude"): _on_each(lambda s, x: np.abs(s.pick[:, ::-1]) ** 2 * s.drive),
    ("t u, u the drives", "time"): [lambda s, x: s.time_s[:, None] * s.drive],
    (WARM_FED, "temperature"): [
        *_on_each(lambda s, x: s.temperature_k[:, None] * s.drive),
        *_on_each(lambda s, x: s.temperature_k[:, None] * s.drive[:, ::-1]),
    ],
}
