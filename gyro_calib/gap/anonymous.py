"""Anonymous terms: what an effect that nobody has named looks like, by location, phase, symmetry and what it depends on.

{dynamics, drive, output} x {in phase, in quadrature} x monomials that the symmetry of the two modes allows. A gap that they close and the
registry does not is *something not in the catalogue*, and the term that closes most of it describes it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .columns import forms_columns
from .evidence import CampaignEvidence
from .forms import AT_REST, FORMS, behind, conjugate_product
from .memory import remembered
from .parts import Form, Kind, Linear, Part, Setting, read_at_once
from .screen import Candidate
from .signals import Signals

__all__ = ["Anonymous", "anonymous_candidates"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Monomial = Callable[[Signals, ComplexArray], ComplexArray]
Factor = Callable[[Signals], FloatArray | ComplexArray]
#: where a term enters, as it is told to people
LOCATIONS: dict[Kind, str] = {"flow": "dynamics", "drive": "drive", "output": "pick-off"}


@dataclass(frozen=True)
class Anonymous:
    """Description of a term.

    Parameters
    ----------
    location : str
        ``"dynamics"``, ``"drive"`` or ``"pick-off"``.
    phase : str
        ``"in phase"`` or ``"in quadrature"`` with what it grows from; ``"of any phase"`` with the reference.
    form : str
        Monomial.
    depends_on : str
        What must vary for it to show.
    """

    location: str
    phase: str
    form: str
    depends_on: str

    @property
    def name(self) -> str:
        """One line."""
        return f"{self.location}, {self.phase}: {self.form}"


def _norm(x: ComplexArray) -> FloatArray:
    return np.asarray(np.sqrt(np.sum(np.abs(x) ** 2, axis=1))[:, None])


def _axis(x: ComplexArray, axis: int) -> ComplexArray:
    out = np.zeros_like(x)
    out[:, axis] = x[:, axis]
    return out


def _of_axes(x: ComplexArray) -> FloatArray:
    """Size of the signal of each axis; of one that is crossed through rest, no less than what keeps its phase from jumping."""
    return np.asarray(np.sqrt(np.abs(x) ** 2 + (AT_REST * _norm(x)) ** 2)) + 1e-9


def _by(f: Callable[[Signals], FloatArray]) -> Monomial:
    return lambda s, x: f(s)[:, None] * x


def _each(*factors: Factor) -> list[Monomial]:
    """Factors, each of shape (n, 1), times the signal of one axis and of the other."""
    return [lambda s, x, f=f, k=k: f(s) * _axis(x, k) for f in factors for k in range(2)]  # type: ignore[misc]


def _crossed(*factors: Factor) -> list[Monomial]:
    """Factors times the signal of the other axis."""
    return [lambda s, x, f=f, k=k: f(s) * _axis(x[:, ::-1], k) for f in factors for k in range(2)]  # type: ignore[misc]


def _shaped(text: str, depends: str, *factors: Factor) -> dict[tuple[str, str], list[Monomial]]:
    """Factors times the signal, alike on both axes, other on each, and across."""
    alike: list[Monomial] = [lambda s, x, f=f: f(s) * x for f in factors]  # type: ignore[misc]
    return {
        (text, depends): alike,
        (f"{text}, other on each axis", depends): _each(*factors),
        (f"{text}, crossed", depends): _crossed(*factors),
    }


def _in_step(x: ComplexArray) -> FloatArray:
    """Mean of the product of both axes over a cycle, twice."""
    return np.asarray((x[:, 0] * x[:, 1].conj()).real)


def _by_motion(p: ComplexArray, x: ComplexArray) -> ComplexArray:
    """Twice the fundamental of m^2 x, m the motion's volts of each axis: a force across a gap that closes."""
    return np.asarray(np.abs(p) ** 2 * x + 0.5 * p**2 * x.conj())


def _late(s: Signals, x: ComplexArray, tau_s: float) -> ComplexArray:
    """Through a low-pass, begun settled: what went before is not known of an unnamed signal."""
    return remembered(replace(s, before=None), lambda _: x, tau_s)


def _warmed(s: Signals, tau_s: float) -> FloatArray:
    """How far the drives' power of some time is behind that of now, shape (n, 1)."""
    now = _norm(s.drive) ** 2
    return s.once(("warmed", tau_s), None, lambda: np.asarray(remembered(s, _power, tau_s).real - now))


def _power(s: Signals) -> ComplexArray:
    return (_norm(s.drive) ** 2).astype(np.complex128)


#: of either axis, in step with the reference and a quarter of a cycle behind it: what is constant has no phase to grow from
_CONSTANTS = [lambda x, k=k, f=f: _axis(np.full_like(x, f), k) for k in range(2) for f in (1.0, 1j)]
#: alike on both axes, in the frequency of the motion, it is a thermometer that lags, as every one does
_LATE, _LATE_S = "(T - T of 20 s before) x", 20.0
_RISING = "dT/dt x"
_LATE_APART = f"{_LATE}, other on each axis"
#: monomials of a signal x by what they depend on; those of one entry are tried together
_MONOMIALS: dict[tuple[str, str], list[Monomial]] = {
    ("|x| x", "amplitude"): [lambda s, x: _norm(x) * x],
    ("|x|^2 x", "amplitude"): [lambda s, x: _norm(x) ** 2 * x, lambda s, x: conjugate_product(x)],
    ("|x_j|^2 x_j", "amplitude"): [lambda s, x: _axis(np.abs(x) ** 2 * x, 0), lambda s, x: _axis(np.abs(x) ** 2 * x, 1)],
    ("|x_k|^2 x_k on the other axis", "amplitude"): [
        lambda s, x: _axis((np.abs(x) ** 2 * x)[:, ::-1], 0),
        lambda s, x: _axis((np.abs(x) ** 2 * x)[:, ::-1], 1),
    ],
    ("|x_k|^2 x_j, k the other axis", "amplitude"): [
        lambda s, x: _axis(np.abs(x[:, ::-1]) ** 2 * x, 0),
        lambda s, x: _axis(np.abs(x[:, ::-1]) ** 2 * x, 1),
    ],
    ("|x|^2 x, crossed", "amplitude"): _crossed(lambda s: _norm(s.pick) ** 2),
    ("|x|^4 x", "amplitude"): [lambda s, x: _norm(x) ** 4 * x],
    ("x/|x|", "amplitude"): [lambda s, x: x / (_norm(x) + 1e-9)],
    ("x_j/|x_j|", "amplitude"): [lambda s, x, k=k: _axis(x / _of_axes(x), k) for k in range(2)],  # type: ignore[misc]
    ("|x_j| x_j", "amplitude"): [lambda s, x, k=k: _axis(x * _of_axes(x), k) for k in range(2)],  # type: ignore[misc]
    ("x*", "phase reference"): [lambda s, x: x.conj()],
    **_shaped("T x", "temperature", lambda s: s.temperature_k[:, None]),
    ("T^2 x", "temperature"): [_by(lambda s: s.temperature_k**2)],
    (_RISING, "temperature"): [_by(lambda s: np.gradient(s.temperature_k, s.row_s))],
    **_shaped(_LATE, "temperature", lambda s: behind(s, _LATE_S)),
    **_shaped("t x", "time", lambda s: s.time_s[:, None]),
    ("Omega x", "rate"): [_by(lambda s: s.rate_rad_s)],
    ("Omega x, crossed", "rate"): _crossed(lambda s: s.rate_rad_s[:, None]),
    ("Omega^2 x", "rate"): [_by(lambda s: s.rate_rad_s**2)],
    ("Omega^2 x, crossed", "rate"): _crossed(lambda s: (s.rate_rad_s**2)[:, None]),
    ("dx/dt", "speed of change"): [lambda s, x: np.gradient(x, s.row_s, axis=0)],
    ("d^2x/dt^2", "speed of change"): [lambda s, x: np.gradient(np.gradient(x, s.row_s, axis=0), s.row_s, axis=0)],
    ("x of 0.1 s before", "speed of change"): [lambda s, x: _late(s, x, 0.1)],
    ("x of 1 s before", "speed of change"): [lambda s, x: _late(s, x, 1.0)],
    ("x/(1 + i 10 Hz away)", "frequency"): [lambda s, x: x / (1.0 + 0.1j * (s.omega_rad_s - s.omega0_rad_s) / (2.0 * np.pi))[:, None]],
    ("a constant", "reference"): [lambda s, x, c=c: float(s.recording.command.mode != "loops_off") * c(x) for c in _CONSTANTS],  # type: ignore[misc]
    ("a constant, also in open drive", "reference"): [lambda s, x, c=c: c(x) for c in _CONSTANTS],  # type: ignore[misc]
    ("|u|^2 x, u the drives", "drive"): [lambda s, x: _norm(s.drive) ** 2 * x],
    ("|u|^2 x, u the drives, crossed", "drive"): _crossed(lambda s: _norm(s.drive) ** 2),
    **_shaped("|u of 3 s|^2 x, u the drives", "drive's power", lambda s: _norm(s.drive) ** 2, lambda s: _warmed(s, 3.0)),
    **_shaped("|u of 15 s|^2 x, u the drives", "drive's power", lambda s: _norm(s.drive) ** 2, lambda s: _warmed(s, 15.0)),
    ("|u_j|^2 x_j, u the drives", "drive"): [
        lambda s, x, k=k: _axis(np.abs(s.drive) ** 2 * x, k)
        for k in range(2)  # type: ignore[misc]
    ],
    ("u_x u_y x on the other axis, u the drives", "drive"): [lambda s, x: _in_step(s.drive)[:, None] * x[:, ::-1]],
    ("|p_j|^2 x_j, p the motion", "amplitude"): [
        lambda s, x: _axis(_by_motion(s.pick, x), 0),
        lambda s, x: _axis(_by_motion(s.pick, x), 1),
    ],
}
#: what feeds through and is not in proportion to the drive: a varactor, a stray capacitance that the motion moves
_FED: dict[tuple[str, str], list[Monomial]] = {
    ("|u|^2 u, u the drives", "drive"): [lambda s, x: _norm(s.drive) ** 2 * s.drive],
    ("|u_j|^2 u_j, u the drives", "drive"): [lambda s, x, k=k: _axis(np.abs(s.drive) ** 2 * s.drive, k) for k in range(2)],  # type: ignore[misc]
    ("|p|^2 u, p the motion, u the drives", "amplitude"): [lambda s, x: _norm(s.pick) ** 2 * s.drive],
    ("|p_j|^2 u_j, p the motion, u the drives", "amplitude"): [
        lambda s, x, k=k: _axis(np.abs(s.pick) ** 2 * s.drive, k)
        for k in range(2)  # type: ignore[misc]
    ],
    ("|p_k|^2 u_j, k the other axis, p the motion, u the drives", "amplitude"): [
        lambda s, x, k=k: _axis(np.abs(s.pick[:, ::-1]) ** 2 * s.drive, k)
        for k in range(2)  # type: ignore[misc]
    ],
    ("t u, u the drives", "time"): [lambda s, x: s.time_s[:, None] * s.drive],
}
#: terms that only tell anything new of a signal other than their own
_OF_DRIVE = (
    "|u|^2 x, u the drives",
    "|u|^2 x, u the drives, crossed",
    "|u_j|^2 x_j, u the drives",
    "u_x u_y x on the other axis, u the drives",
)
_OF_MOTION = ("|p_j|^2 x_j, p the motion",)
#: a bias that goes with the amplitude of a wave that turns: read or driven, it is one of the other axis
_OF_FLOW = ("|x|^2 x, crossed",)
#: effects of a level, tried with any share of what lies beyond it: a knee that is soft; and of whose levels a loss or a stiffness may begin
_KNEES: dict[str, Kind] = {"drive_saturation": "drive", "pickoff_saturation": "output"}
_OF_MOTIONS_LEVELS, _KNEE_STEP = "pickoff_saturation", 2


#: of a wave that never turns the other axis holds noise alone, which such a term would explain
_TURNING = (
    "|x_k|^2 x_j, k the other axis",
    "x_j/|x_j|",
    "|x_j| x_j",
    "|u_j|^2 x_j, u the drives",
    "|p_j|^2 u_j, p the motion, u the drives",
    "|p_k|^2 u_j, k the other axis, p the motion, u the drives",
)
#: on what no unnamed reading depends: L of a rate that steps is the table's clock and the recorder's filter, a wave held to the
#: reference is its own conjugate, and a filter of the pick-off is that of the drive but for the noise, which both together explain away;
#: its gain follows a resonator's own millikelvins, and so does the frequency
_NOT_READ = ("rate", "phase reference", "drive", "speed of change", "frequency")
_PHASES, _ANY_PHASE = (("in phase", 1.0 + 0j), ("in quadrature", 1j)), (("of any phase", 1.0 + 0j),)
#: but for what goes with squares: no clock of a table that turns both ways imitates that of its rate, no noise that of the drives
_READ = ("Omega^2 x", "|u|^2 x, u the drives")
#: on what a term may depend that follows its signal at once
_AT_ONCE = ("amplitude", "temperature", "time", "rate")


def anonymous_candidates(evidence: CampaignEvidence, linear: Linear) -> list[tuple[Anonymous, Candidate]]:
    """Every anonymous term as a candidate; its prior is wide: a relative size of a tenth of the linear device."""
    forms, found = [], []
    for (text, depends), monomials in _FED.items():
        if text in _TURNING and not evidence.turns:
            continue
        # a stray capacitance has the phase that it has, as the feedthrough itself does
        both: list[Monomial] = [lambda s, x, f=f, q=q: q * f(s, x) for f in monomials for q in (1.0, 1j)]  # type: ignore[misc]
        forms.append((Anonymous(LOCATIONS["output"], _ANY_PHASE[0][0], text, depends), _form("output", both, 1.0, at_once=False)))
    for kind, location in LOCATIONS.items():
        for (text, depends), monomials in _MONOMIALS.items():
            if text in _TURNING and not evidence.turns:
                continue
            if (text in _OF_DRIVE and kind == "drive") or (text in _OF_MOTION and kind != "drive") or (text in _OF_FLOW and kind != "flow"):
                continue
            if kind == "output" and depends in _NOT_READ and text not in _READ:
                continue
            for phase, factor in _PHASES if depends != "reference" else _ANY_PHASE:
                if (kind, phase) == ("flow", "in quadrature") and text in (_LATE, _RISING):
                    continue
                if (kind, phase, text) == ("flow", "in quadrature", _LATE_APART):
                    monomials = [lambda s, x: behind(s, _LATE_S) * x * np.array([1.0, -1.0])]
                forms.append((Anonymous(location, phase, text, depends), _form(kind, monomials, factor, at_once=depends in _AT_ONCE)))
    made = forms_columns(evidence, [(form, {}) for _, form in forms], linear)
    for (term, _), columns in zip(forms, made, strict=True):
        if any(np.any(v) for c in columns for v in c.signal):
            found.append((term, Candidate(f"{term.location} {term.form}", {}, tuple(columns), np.full(len(columns), 0.1))))
    return found + _knees(evidence, linear)


def _knees(evidence: CampaignEvidence, linear: Linear) -> list[tuple[Anonymous, Candidate]]:
    """What lies beyond a level grows otherwise, by any share; or a loss, or a stiffness, begins there."""
    knees = [(kind, "in phase", FORMS[name], 1.0, name) for name, kind in _KNEES.items()]
    knees += [("flow", phase, Form(_beyond(factor)), 0.1, _OF_MOTIONS_LEVELS) for phase, factor in _PHASES]
    found = []
    for kind, phase, form, prior_sd, levels in knees:
        settings = FORMS[levels].settings([r.signals for r in evidence])[::_KNEE_STEP]
        made = forms_columns(evidence, [(form, setting) for setting in settings], linear)
        for setting, columns in zip(settings, made, strict=True):
            if any(np.any(v) for c in columns for v in c.signal):
                term = Anonymous(LOCATIONS[kind], phase, f"what lies beyond {setting['level']:.3g} V", "amplitude")
                found.append((term, Candidate(term.name, setting, tuple(columns), np.full(len(columns), prior_sd), len(settings))))
    return found


def _beyond(factor: complex) -> Callable[[Signals, Linear, Setting], list[Part]]:
    """A force by the motion beyond a level."""

    def parts(s: Signals, d: Linear, setting: Setting) -> list[Part]:
        x = s.pick - s.drive @ d.E.T
        size = _norm(x)
        return [Part("c", "flow", factor * np.maximum(size - setting["level"], 0.0) / np.maximum(size, 1e-9) * x)]

    return parts


def _form(kind: Kind, monomials: list[Monomial], factor: complex, *, at_once: bool) -> Form:
    def parts(s: Signals, d: Linear, setting: Setting) -> list[Part]:
        if kind == "output" and at_once:
            return [read_at_once(f"c_{k}", s, d, lambda v, f=f: factor * f(s, v)) for k, f in enumerate(monomials)]  # type: ignore[misc]
        x = s.drive if kind == "drive" else s.pick if kind == "output" else s.pick - s.drive @ d.E.T
        return [Part(f"c_{k}", kind, factor * f(s, x)) for k, f in enumerate(monomials)]

    return Form(parts)
