"""Envelope forms of the effects: what each adds to the slow flow, to the drive or to the pick-off, for one unit of each of its parameters.

First order of averaging, written for pick-off volts V, motion p = V - E u and drive volts u (shape (n, 2), x and y); the registry
(:mod:`..effects`) names the same effects and parameters, and the simulator applies them to the carrier, which checks these forms. A form is
linear in its parameters. What is not (a level, a time constant, a frequency) is laid out on a grid, the settings of a form.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .cubic_forms import across_axes, conjugate_product, cube, isotropic_cubic, of_turned_axes, square
from .drifts import drift_settings, drifted, drifting_damping, drifting_feedthrough, drifting_gains
from .electrostatic import across_gap, softened
from .levels import clipped, dead_drive, dead_settings, limit_settings
from .memory import behind, remembered
from .own_modes import mode_parts, modes
from .parts import REST, SKEW, UNEQUAL, Form, Kind, Linear, Part, Setting, beside, motion, one_axis, read_at_once, turned, velocity
from .pumps import driven_pump, steady_pump
from .signals import Signals
from .warm_forms import bent_damping, turned_drive, turned_reading

__all__ = ["AT_REST", "FORMS", "GRADIENT_DAMPS"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: setting of a variant by axis whose axes are not the electrodes'
_TURNED = 2.0
#: how pick-offs differ: gain and phase of one over the other, and what each reads of the other's motion
_UNLIKE: dict[str, ComplexArray] = {
    "gain": np.diag([-0.5, 0.5]).astype(np.complex128),
    "phase": 0.5j * np.diag([-1.0, 1.0]),
    "mixed": np.array([[0.0, 0.5], [0.5, 0.0]], dtype=np.complex128),
    "late": np.array([[0.0, 0.5j], [0.5j, 0.0]]),
}
#: what may come with an effect, over it: damping that a gradient of temperature makes unequal, over the split that it makes; gain of a
#: drive or of a pick-off, which goes as the charged bias, over the half split [s/rad]; what feeds through to the other axis, over what does
#: to its own
_DAMPED, _CHARGED_S, _ACROSS = 0.3, 3.0, 0.3
#: damping alike along all directions that a gradient makes: its column in a fit, and `thermal_damping_lag.c` [1/s/K] for one unit of that
GRADIENT_DAMPS = (f"thermal_split_lag.{REST}_damped", -_DAMPED / UNEQUAL)
#: what lets one axis see the other; of that a turn leaves a force alone that is alike in all directions
_TURN = {"turn": np.array([[0.0, -0.5], [0.5, 0.0]], dtype=np.complex128)}
_CROSSED = {name: _UNLIKE[name] for name in ("mixed", "late")} | _TURN
_STEP = 1e-4
#: share of the wave below which an axis rests
AT_REST = 3e-3


def _quadratic(p: ComplexArray) -> ComplexArray:
    """Fundamental of |v| v: the quadrature of an elliptic wave is damped half as much as its amplitude."""
    size = np.sqrt(square(p)) + 1e-9
    return (3.0 * size * p + conjugate_product(p) / size) / 4.0


def _dry(p: ComplexArray) -> ComplexArray:
    """Fundamental of v/|v|: along the wave its direction, across it ``ln(4 a/q) - 1`` times the quadrature over the amplitude."""
    size = np.sqrt(square(p)) + 1e-9
    turned = conjugate_product(p) / size**2
    along, across = 0.5 * (p + turned), 0.5 * (p - turned)
    widths = [np.sqrt(square(x)) + 1e-9 * size for x in (along, across)]
    return (along + (np.log(4.0 * widths[0] / widths[1]) - 1.0) * across) / size


def _swapped(x: ComplexArray) -> ComplexArray:
    return np.asarray(x[:, ::-1])


def _by_axis(kind: Kind, letter: str, x: ComplexArray) -> list[Part]:
    return [Part(f"{letter}_{name}", kind, one_axis(x, axis)) for axis, name in enumerate("xy")]


def _anisotropy(letter: str, x: ComplexArray, factor: complex) -> list[Part]:
    """By axis, across, and as unequal pick-offs show the latter: other from x to y than from y to x."""
    return [
        Part(f"{letter}_c", "flow", factor * x * np.array([1.0, -1.0])),
        Part(f"{letter}_s", "flow", factor * _swapped(x)),
        Part(SKEW, "flow", factor * turned(x)),
    ]


def _lag(s: Signals, x: ComplexArray) -> ComplexArray:
    return np.asarray(-np.gradient(x, s.row_s, axis=0))


def _times(low: float, high: float, count: int) -> Callable[[list[Signals]], list[Setting]]:
    return lambda signals: [{"tau": float(tau)} for tau in np.geomspace(low, high, count)]


def _campaign_times(signals: list[Signals]) -> list[Setting]:
    span = max(float(s.time_s[-1]) for s in signals)
    return [{"tau": float(tau)} for tau in span * np.array([0.05, 0.15, 0.4, 1.0])]


def _reading(s: Signals) -> ComplexArray:
    """It is the sensor that is ahead or late; corners that a reference tells of are the resonator's own."""
    return s.reading_k[:, None].astype(np.complex128)


def _thermal_lag(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    """A lag that is short against the ramps is linear in its time; a longer one rounds their corners, and is tried as what it is."""
    if "tau" in setting:
        late = remembered(s, _reading, setting["tau"], steady=False) - _reading(s)
        return [Part("share", "flow", 1j * d.frequency_slope_rad_s_k * late * motion(s, d))]
    slope = np.gradient(s.reading_k, s.row_s)[:, None]
    return [Part("tau", "flow", -1j * d.frequency_slope_rad_s_k * slope * motion(s, d))]


def _lagging_pickoff(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    late = behind(s, setting["tau"])
    return _of_each_reading("g", s, d, lambda v: late * v)


def _charge(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    rise = (1.0 - np.exp(-s.time_s / setting["tau"]))[:, None]
    p = motion(s, d)
    # what it does to the mean frequency is not told from a resonance that drifts: the two anisotropies alone name it; the electrodes
    # of either axis may be those that charge, and what drives may be what reads
    gain = _CHARGED_S * rise
    driven = [beside(f"gain_{a}", "drive", gain * one_axis(s.drive, k)) for k, a in enumerate("xy")]
    return [*_anisotropy("k", rise * p, 1j), *driven, *_of_each_reading(f"{SKEW}_read", s, d, lambda v: gain * v / UNEQUAL)]


def _constant(kind: Kind, letter: str) -> Callable[[Signals, Linear, Setting], list[Part]]:
    """In step with the reference while the loops run; ``open``: also with an open drive, whose generator is then the reference."""

    def parts(s: Signals, d: Linear, setting: Setting) -> list[Part]:
        closed = setting.get("open", 0.0) if s.recording.command.mode == "loops_off" else 1.0
        one = np.full((len(s.time_s), 2), closed, dtype=complex)
        return [Part(f"{letter}_{n}{q}", kind, f * one_axis(one, a)) for a, n in enumerate("xy") for q, f in (("c", 1.0), ("s", 1j))]

    return parts


def _with_or_without_open_drive(signals: list[Signals]) -> list[Setting]:
    return [{"open": 0.0}, {"open": 1.0}]


def _flow(parameter: str, f: Callable[[ComplexArray], ComplexArray], factor: complex) -> Form:
    return Form(lambda s, d, g: [Part(parameter, "flow", factor * f(motion(s, d))), *_skewed(motion(s, d), f, factor)])


def _skewed(
    p: ComplexArray, f: Callable[[ComplexArray], ComplexArray], factor: complex, unlike: Mapping[str, ComplexArray] = _UNLIKE
) -> list[Part]:
    """How an effect of the motion looks in the volts of pick-offs P = 1 + e that are not alike: ``P f(P^-1 p) - f(p)``, per unit of e."""
    parts = []
    for name, e in unlike.items():
        turned = p @ e.T
        bent = (f(p + _STEP * turned) - f(p - _STEP * turned)) / (2.0 * _STEP)
        parts.append(Part(f"{SKEW}_{name}", "flow", factor * (f(p) @ e.T - bent)))
    return parts


def _cubic(letter: str, factor: complex, per_axis: str, *, turns: bool = False) -> Form:
    """A cubic force, isotropic or along each axis: one effect in two variants, the second, whose axes may be turned, with its own name."""

    def parts(s: Signals, d: Linear, setting: Setting) -> list[Part]:
        p = motion(s, d)
        if not setting["axes"]:
            return [Part(letter, "flow", factor * isotropic_cubic(p)), *_skewed(p, isotropic_cubic, factor)]
        # gains and phases of single axes leave a cube of that axis what it is
        crossed = [
            replace(part, parameter=f"{part.parameter}_{a}")
            for axis, a in zip(np.eye(2), "xy", strict=True)
            for part in _skewed(p, lambda v, axis=axis: axis * cube(v), factor, _CROSSED)  # type: ignore[misc]
        ]
        # of a stiffness these are an effect of their own
        return [
            *_by_axis("flow", letter, factor * cube(p)),
            *(of_turned_axes(letter, p, factor) if setting["axes"] == _TURNED else crossed),
        ]

    return Form(parts, lambda signals: [{"axes": axes} for axes in (0.0, 1.0, _TURNED)[: 3 if turns else 2]], per_axis)


def _coupled(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    """Cubes of each axis on the other; or the forces of the potentials ``x^3 y`` and ``x y^3``."""
    p = motion(s, d)
    if not setting["axes"]:
        return [Part("k", "flow", 1j * _swapped(cube(p))), *_skewed(p, lambda v: _swapped(cube(v)), 1j)]
    return [replace(part, parameter=f"k_{part.parameter[2]}") for part in across_axes("k", p, 1j)]


def _friction(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    """Dry friction, against the velocity or of each axis by itself.

    An axis that is held at rest goes with the other by as much as the pick-offs are not square to each other: that is all of its friction,
    to either side. In open drive it goes as it is driven, with a phase of its own.
    """
    p = motion(s, d)
    if setting["axes"]:
        size = np.sqrt(square(p))
        against = -p / np.sqrt(np.abs(p) ** 2 + (AT_REST * size) ** 2)
        at_rest = -(1.0 - np.abs(against)) * _swapped(p) / (size + 1e-12) / UNEQUAL
        driven = float(s.recording.command.mode == "loops_off") * at_rest
        skewed = {REST: at_rest, f"{SKEW}_driven": driven, f"{SKEW}_driven_late": 1j * driven}
        return [*_by_axis("flow", "c", against), *(part for n, x in skewed.items() for part in _by_axis("flow", n, x))]
    return [Part("c", "flow", -_dry(p)), *_skewed(p, _dry, -1.0)]


def _stiffness(parameter: str, x: Callable[[Signals], FloatArray]) -> Form:
    return Form(lambda s, d, g: [Part(parameter, "flow", 1j * x(s)[:, None] * motion(s, d))])


def _centrifugal(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    pulled = 1j * s.rate_rad_s[:, None] ** 2 * motion(s, d)
    if not setting["axes"]:
        return [Part("k", "flow", pulled)]
    _, across, skewed = _anisotropy("k", pulled, 1.0)
    return [*_by_axis("flow", "k", pulled), across, skewed]


def _damping(parameter: str, x: Callable[[Signals], FloatArray]) -> Form:
    return Form(lambda s, d, g: [Part(parameter, "flow", -x(s)[:, None] * velocity(s, d))])


def _as_rate(parameter: str, s: Signals, d: Linear, rate_rad_s: FloatArray) -> list[Part]:
    """What turns the wave as an input does."""
    return [Part(parameter, "flow", -d.angular_gain * rate_rad_s[:, None] * d.reacting(motion(s, d)))]


def _warm(s: Signals) -> FloatArray:
    return s.temperature_k


def _warm_squared(s: Signals) -> FloatArray:
    return s.temperature_k**2


def _late(s: Signals) -> FloatArray:
    return s.time_s


def _scaled_drive(kind: Kind, letter: str, x: Callable[[Signals], FloatArray], factor: complex) -> Form:
    return Form(lambda s, d, g: _by_axis(kind, letter, factor * x(s)[:, None] * s.drive))


def _driven_cube(letter: str, factor: complex) -> Form:
    return Form(lambda s, d, g: _by_axis("drive", letter, factor * cube(s.drive)))


def _delayed(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    """A carrier that is late: its envelope is, and its phase follows the reference away from the nominal frequency."""
    away = -1j * (s.omega_rad_s - s.omega0_rad_s)[:, None]
    late = _lag(s, s.pick)
    turned = _of_each_reading("tau", s, d, lambda v: away * v)
    return [*turned, *(Part(f"tau_{n}", "output", one_axis(late, k)) for k, n in enumerate("xy"))]


def _read_in_turns(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    """y is late with the phase of its carrier: ``P J P^-1`` has ``-e^{i w tau}`` and ``e^{-i w tau}`` beside its diagonal."""
    away = -1j * (s.omega_rad_s - s.omega0_rad_s)[:, None]
    crossed = 1j * s.omega0_rad_s * d.angular_gain * s.rate_rad_s[:, None] * _swapped(motion(s, d))
    return [
        Part("tau", "flow", crossed),
        read_at_once("tau", s, d, lambda v: one_axis(away * v, 1)),
        Part("tau", "output", one_axis(_lag(s, s.pick), 1)),
    ]


def _driven_late(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    return _by_axis("drive", "tau", _lag(s, s.drive) - 1j * (s.omega_rad_s - s.omega0_rad_s)[:, None] * s.drive)


def _gradient(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    """What a shell that is not warm throughout does: it splits the frequency and damps, alike from the first and then unequally."""
    late = behind(s, setting["tau"])
    damped = _DAMPED * late * velocity(s, d)
    equal = Part(f"{REST}_damped", "flow", damped / UNEQUAL)
    unequal = [beside("damped_c", "flow", damped * np.array([1.0, -1.0])), beside("damped_s", "flow", _swapped(damped))]
    return [*_anisotropy("k", late * motion(s, d), 1j), equal, *unequal]


def _fed_by_warmth(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    """Of the axis' own drive in phase; as much in quadrature, and across what feeds through there, may come with that."""
    fed, own = _warm(s)[:, None] * s.drive, np.abs(np.diag(d.E))
    crossed = np.clip(np.abs(np.array([d.E[0, 1], d.E[1, 0]])) / np.maximum(own, 1e-12), _ACROSS, 1.0 / _ACROSS)
    late = [beside(f"late_{n}", "output", 1j * one_axis(fed, k)) for k, n in enumerate("xy")]
    across = [
        beside(f"across_{n}{q}", "output", crossed[k] * f * one_axis(_swapped(fed), k))
        for k, n in enumerate("xy")
        for q, f in (("c", 1.0), ("s", 1j))
    ]
    return [*_by_axis("output", "e", fed), *late, *across]


def _of_each_reading(letter: str, s: Signals, d: Linear, f: Callable[[ComplexArray], ComplexArray]) -> list[Part]:
    return [read_at_once(f"{letter}_{n}", s, d, lambda v, k=k: one_axis(f(v), k)) for k, n in enumerate("xy")]  # type: ignore[misc]


def _read_by_axis(letter: str, f: Callable[[Signals, ComplexArray], ComplexArray]) -> Form:
    return Form(lambda s, d, g: _of_each_reading(letter, s, d, lambda v: f(s, v)))


def _rate(s: Signals) -> FloatArray:
    return s.rate_rad_s


#: time constants of what warms late
_WARM_UP = _times(2.0, 100.0, 5)

FORMS: dict[str, Form] = {
    # dynamics
    "duffing": _cubic("k", 1j, "duffing_axes"),
    "cubic_cross_stiffness": Form(_coupled, lambda signals: [{"axes": 0.0}, {"axes": 1.0}], "cubic_cross_stiffness_axes"),
    "nonlinear_damping": _cubic("c", -1.0, "nonlinear_damping_axes", turns=True),
    "quadratic_damping": _flow("c", _quadratic, -1.0),
    "coulomb_friction": Form(_friction, lambda signals: [{"axes": 0.0}, {"axes": 1.0}], "coulomb_friction_axes"),
    "spurious_mode": Form(mode_parts, modes),
    "relaxation": Form(
        lambda s, d, g: [Part("c", "flow", 1j * (remembered(s, lambda of: motion(of, d), g["tau"]) - motion(s, d)))], _times(0.02, 5.0, 7)
    ),
    "parametric_pump": Form(steady_pump, lambda signals: [{"axes": 0.0}, {"axes": 1.0}], "parametric_pump_axes"),
    "driven_pump": Form(driven_pump),
    "constant_force": Form(_constant("drive", "f"), _with_or_without_open_drive),
    # drive
    "drive_nonlinearity": _driven_cube("d", 1.0),
    "drive_amplitude_phase": _driven_cube("d", 1j),
    "drive_cross_nonlinearity": Form(lambda s, d, g: [Part("d", "drive", np.abs(_swapped(s.drive)) ** 2 * _swapped(s.drive))]),
    "drive_stiffness": Form(softened, lambda signals: [{"axes": 0.0}, {"axes": 1.0}], "drive_stiffness_mean"),
    "drive_gap": Form(across_gap),
    "drive_sag": Form(lambda s, d, g: [Part("d", "drive", square(s.drive) * s.drive)]),
    "drive_saturation": Form(lambda s, d, g: [Part("share", "drive", clipped(s.drive, g["level"]))], limit_settings("drive")),
    "drive_dead_zone": Form(dead_drive, dead_settings),
    "drive_lag": Form(lambda s, d, g: [Part("tau", "drive", _lag(s, s.drive))]),
    "drive_delay": Form(_driven_late),
    "drive_memory": Form(lambda s, d, g: [Part("share", "drive", remembered(s, lambda of: of.drive, g["tau"]))], _times(0.05, 5.0, 5)),
    # pick-off
    "pickoff_nonlinearity": _read_by_axis("c", lambda s, v: cube(v)),
    "pickoff_amplitude_phase": _read_by_axis("c", lambda s, v: 1j * cube(v)),
    "pickoff_cross_nonlinearity": Form(lambda s, d, g: [read_at_once("c", s, d, lambda v: _swapped(cube(v)))]),
    "pickoff_saturation": Form(lambda s, d, g: [read_at_once("share", s, d, lambda v: clipped(v, g["level"]))], limit_settings("pick")),
    "pickoff_lag": Form(lambda s, d, g: [Part("tau", "output", _lag(s, s.pick))]),
    "pickoff_delay": Form(_delayed),
    "pickoff_memory": Form(lambda s, d, g: [Part("share", "output", remembered(s, lambda of: of.pick, g["tau"]))], _times(0.05, 5.0, 5)),
    "pickoff_interference": Form(_constant("output", "v"), _with_or_without_open_drive),
    "multiplexing_skew": Form(_read_in_turns),
    "channel_skew": Form(lambda s, d, g: [Part("tau", "output", one_axis(_lag(s, s.pick), 1))]),
    # environment
    "thermal_damping": _damping("c", _warm),
    "thermal_damping_curvature": Form(bent_damping),
    "thermal_damping_anisotropy": Form(lambda s, d, g: _anisotropy("c", _warm(s)[:, None] * velocity(s, d), -1.0)),
    "thermal_frequency_curvature": _stiffness("k", _warm_squared),
    "thermal_bias": Form(lambda s, d, g: _as_rate("b", s, d, _warm(s))),
    "thermal_split": Form(lambda s, d, g: _anisotropy("k", _warm(s)[:, None] * motion(s, d), 1j)),
    "thermal_split_curvature": Form(lambda s, d, g: _anisotropy("k", _warm_squared(s)[:, None] * motion(s, d), 1j)),
    "thermal_lag": Form(_thermal_lag, _times(0.03, 100.0, 17)),
    "thermal_drive_gain": _scaled_drive("drive", "g", _warm, 1.0),
    "thermal_drive_phase": Form(turned_drive),
    "thermal_pickoff_gain": _read_by_axis("g", lambda s, v: _warm(s)[:, None] * v),
    "thermal_drive_coupling": Form(lambda s, d, g: _by_axis("drive", "c", _warm(s)[:, None] * _swapped(s.drive))),
    "thermal_pickoff_coupling": Form(lambda s, d, g: _of_each_reading("c", s, d, lambda v: _warm(s)[:, None] * _swapped(v))),
    "thermal_drive_gain_curvature": _scaled_drive("drive", "g", _warm_squared, 1.0),
    "thermal_pickoff_gain_curvature": _read_by_axis("g", lambda s, v: _warm_squared(s)[:, None] * v),
    "thermal_pickoff_phase": Form(turned_reading),
    "thermal_frequency_lag": Form(lambda s, d, g: [Part("k", "flow", 1j * behind(s, g["tau"]) * motion(s, d))], _WARM_UP),
    "thermal_damping_lag": Form(lambda s, d, g: [Part("c", "flow", -behind(s, g["tau"]) * velocity(s, d))], _WARM_UP),
    "thermal_damping_anisotropy_lag": Form(lambda s, d, g: _anisotropy("c", behind(s, g["tau"]) * velocity(s, d), -1.0), _WARM_UP),
    "thermal_bias_lag": Form(lambda s, d, g: _as_rate("b", s, d, behind(s, g["tau"])[:, 0].real), _WARM_UP),
    "thermal_split_lag": Form(_gradient, _WARM_UP),
    "thermal_drive_gain_lag": Form(lambda s, d, g: _by_axis("drive", "g", behind(s, g["tau"]) * s.drive), _WARM_UP),
    "thermal_pickoff_gain_lag": Form(_lagging_pickoff, _WARM_UP),
    "thermal_feedthrough": Form(_fed_by_warmth),
    "frequency_ageing": _stiffness("k", _late),
    "damping_drift": Form(drifting_damping, drift_settings),
    "bias_drift": Form(lambda s, d, g: _as_rate("b", s, d, drifted(s, g)), drift_settings),
    "split_drift": Form(lambda s, d, g: _anisotropy("k", _late(s)[:, None] * motion(s, d), 1j)),
    "charge_accumulation": Form(_charge, _campaign_times),
    "drive_gain_drift": drifting_gains(1.0, of_drive=True),
    "drive_phase_drift": drifting_gains(1j, of_drive=True),
    "pickoff_gain_drift": drifting_gains(1.0, of_drive=False),
    "pickoff_phase_drift": drifting_gains(1j, of_drive=False),
    "drive_coupling_drift": Form(lambda s, d, g: _by_axis("drive", "c", drifted(s, g)[:, None] * _swapped(s.drive)), drift_settings),
    "pickoff_coupling_drift": Form(
        lambda s, d, g: _of_each_reading("c", s, d, lambda v: drifted(s, g)[:, None] * _swapped(v)), drift_settings
    ),
    "feedthrough_drift": Form(lambda s, d, g: drifting_feedthrough(s, g, across=False), drift_settings),
    "cross_feedthrough_drift": Form(lambda s, d, g: drifting_feedthrough(s, g, across=True), drift_settings),
    "centrifugal_stiffness": Form(_centrifugal, lambda signals: [{"axes": 0.0}, {"axes": 1.0}], "centrifugal_stiffness_axes"),
    "rate_dependent_damping": _damping("c", _rate),
    "angular_gain_error": Form(lambda s, d, g: _as_rate("e", s, d, s.rate_rad_s)),
    "rate_nonlinearity": Form(lambda s, d, g: _as_rate("e", s, d, s.rate_rad_s * np.abs(s.rate_rad_s))),
    "rate_asymmetry": Form(lambda s, d, g: _as_rate("e", s, d, s.rate_rad_s**2)),
}
