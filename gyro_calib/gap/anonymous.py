"""Anonymous terms: what an effect that nobody has named looks like, by location, phase, symmetry and what it depends on.

{dynamics, drive, output} x {in phase, in quadrature} x monomials that the symmetry of the two modes allows. A gap that they close and the
registry does not is *something not in the catalogue*, and the term that closes most of it describes it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from .columns import forms_columns
from .evidence import CampaignEvidence
from .forms import FORMS
from .monomials import APART, DIRECTED, FED, LATE, MONOMIALS, RISING, Monomial, size_of
from .one_axis import heard
from .parts import Form, Kind, Linear, Part, Setting, read_at_once
from .screen import Candidate
from .signals import Signals

__all__ = ["HEATED", "LOCATIONS", "Anonymous", "anonymous_candidates"]

#: form and phase of what vibration warms: its frequency, all of which lies between records
HEATED = ("|x of 15 s|^2 x", "in quadrature")
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
        ``"in phase"`` or ``"in quadrature"`` with what it grows from; ``"of any phase"`` of what has one of its own.
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


#: terms that only tell anything new of a signal other than their own
_OF_DRIVE = (
    "|u|^2 x, u the drives",
    "|u|^2 x, u the drives, crossed",
    "|u_j|^2 x_j, u the drives",
    "u_x u_y x on the other axis, u the drives",
)
_OF_MOTION = ("|p_j|^2 x_j, p the motion",)
#: a bias that goes with the amplitude of a wave that turns: read or driven, it is one of the other axis; splits; what vibration warms
_OF_FLOW = (HEATED[0], "|x|^2 x, crossed", "|x| x, as a split", "|x|^2 x, as a split", "x/|x|, as a split", DIRECTED)
#: effects of a level, tried with any share of what lies beyond it: a knee that is soft; and of whose levels a loss or a stiffness may begin
_KNEES: dict[str, Kind] = {"drive_saturation": "drive", "pickoff_saturation": "output"}
_OF_MOTIONS_LEVELS, _KNEE_STEP = "pickoff_saturation", 2


#: of a wave that never turns the other axis holds noise alone, which such a term would explain
_TURNING = (
    DIRECTED,
    "|x_k|^2 x_j, k the other axis",
    "x_j/|x_j|",
    "|x_j| x_j",
    "|u_j|^2 x_j, u the drives",
    "|p_j|^2 u_j, p the motion, u the drives",
    "|p_k|^2 u_j, p the motion of the other axis",
)
#: on what no unnamed reading depends: L of a rate that steps is the table's clock and the recorder's filter, a wave held to the
#: reference is its own conjugate, and a filter of the pick-off is that of the drive but for the noise, which both together explain away;
#: its gain follows a resonator's own millikelvins, and so does the frequency
_NOT_READ = ("rate", "phase reference", "drive", "speed of change", "frequency")
_PHASES, _ANY_PHASE = (("in phase", 1.0 + 0j), ("in quadrature", 1j)), (("of any phase", 1.0 + 0j),)
#: but for what goes with squares: no clock of a table that turns both ways imitates that of its rate, no noise that of the drives
_READ = ("Omega^2 x", "|u|^2 x, u the drives")
#: what an unnamed size may be, sd; of what is read or driven the largest share of the largest signal that it may be, sd
_USUAL, _LARGEST = 0.1, 0.1
#: signals that are largest where terms are
_TELLING = ("pick", "drive", "temperature_k", "rate_rad_s", "time_s")
#: on what a term may depend that follows its signal at once
_AT_ONCE = ("amplitude", "azimuth", "temperature", "time", "rate")


def anonymous_candidates(evidence: CampaignEvidence, linear: Linear) -> list[tuple[Anonymous, Candidate]]:
    """Every anonymous term as a candidate; its prior is wide: of what is read or driven a tenth of the signal."""
    forms, found = [], []
    for (text, depends), monomials in FED.items():
        if text in _TURNING and not evidence.turns:
            continue
        # a stray capacitance has the phase that it has, as the feedthrough itself does
        both: list[Monomial] = [lambda s, x, f=f, q=q: q * f(s, x) for f in monomials for q in (1.0, 1j)]  # type: ignore[misc]
        forms.append((Anonymous(LOCATIONS["output"], _ANY_PHASE[0][0], text, depends), _form("output", both, 1.0, at_once=False)))
    for kind, location in LOCATIONS.items():
        for (text, depends), monomials in MONOMIALS.items():
            if (text in _TURNING or depends == "azimuth") and not evidence.turns:
                continue
            if (text in _OF_DRIVE and kind == "drive") or (text in _OF_MOTION and kind != "drive") or (text in _OF_FLOW and kind != "flow"):
                continue
            if kind == "output" and depends in _NOT_READ and text not in _READ:
                continue
            for phase, factor in _PHASES if depends != "reference" else _ANY_PHASE:
                if phase == "in quadrature" and (text == RISING or (kind, text) == ("flow", LATE)):
                    continue
                if phase == "in quadrature" and (kind == "flow" or text.startswith(RISING)) and text in APART:
                    monomials = [lambda s, x, f=APART[text]: f(s) * x * np.array([1.0, -1.0])]  # type: ignore[misc]
                forms.append((Anonymous(location, phase, text, depends), _form(kind, monomials, factor, at_once=depends in _AT_ONCE)))
    made = forms_columns(evidence, [(form, {}) for _, form in forms], linear)
    largest = _largest(evidence, linear, forms)
    for (term, _), columns in zip(forms, (heard(evidence, columns) for columns in made), strict=True):
        if any(np.any(v) for c in columns for v in c.signal):
            prior_sd = np.array([largest.get((term, c.name), _USUAL) for c in columns])
            found.append((term, Candidate(f"{term.location} {term.form}", {}, tuple(columns), prior_sd)))
    return found + _knees(evidence, linear)


def _largest(evidence: CampaignEvidence, linear: Linear, forms: Sequence[tuple[Anonymous, Form]]) -> dict[tuple[Anonymous, str], float]:
    """Of what is read or driven the coefficients at which terms are the largest share of their signal that they may be."""
    signals = [r.signals for r in evidence]
    told = {name: [float(np.abs(getattr(s, name)).max()) for s in signals] for name in _TELLING}
    telling = [signals[k] for k in {int(np.argmax(sizes)) for sizes in told.values()}]
    # where nothing is driven no share is anything
    whole = {"output": max(told["pick"]) or 1.0, "drive": max(told["drive"]) or 1.0}
    sizes: dict[tuple[Anonymous, str], float] = {}
    for s in telling:
        for term, form in forms:
            for part in form.parts(s, linear, {}) if term.location != LOCATIONS["flow"] else ():
                key, share = (term, part.parameter), float(np.abs(part.signal).max()) / whole[part.kind]
                sizes[key] = max(sizes.get(key, 0.0), share)
    return {key: _LARGEST / size for key, size in sizes.items() if size > 0.0}


def _knees(evidence: CampaignEvidence, linear: Linear) -> list[tuple[Anonymous, Candidate]]:
    """What lies beyond a level grows otherwise, by any share; a drive's lags there; or a loss, or a stiffness, begins there."""
    knees = [(kind, "in phase", FORMS[name], 1.0, name) for name, kind in _KNEES.items()]
    knees.append(("drive", _ANY_PHASE[0][0], Form(_driven_beyond), 1.0, "drive_saturation"))
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


def _driven_beyond(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    """What of either drive lies beyond a level, at any phase: an amplifier that cannot slew so fast is late before it is short."""
    size = np.abs(s.drive)
    more = np.maximum(size - setting["level"], 0.0) / np.maximum(size, 1e-300) * s.drive
    alone = [more * axis for axis in np.eye(2)]
    return [Part(f"c_{k}{part}", "drive", factor * x) for k, x in enumerate(alone) for part, factor in (("", 1.0), ("_late", -1j))]


def _beyond(factor: complex) -> Callable[[Signals, Linear, Setting], list[Part]]:
    """A force by the motion beyond a level."""

    def parts(s: Signals, d: Linear, setting: Setting) -> list[Part]:
        x = s.pick - s.drive @ d.E.T
        size = size_of(x)
        return [Part("c", "flow", factor * np.maximum(size - setting["level"], 0.0) / np.maximum(size, 1e-9) * x)]

    return parts


def _form(kind: Kind, monomials: list[Monomial], factor: complex, *, at_once: bool) -> Form:
    def parts(s: Signals, d: Linear, setting: Setting) -> list[Part]:
        if kind == "output" and at_once:
            return [read_at_once(f"c_{k}", s, d, lambda v, f=f: factor * f(s, v)) for k, f in enumerate(monomials)]  # type: ignore[misc]
        x = s.drive if kind == "drive" else s.pick if kind == "output" else s.pick - s.drive @ d.E.T
        return [Part(f"c_{k}", kind, factor * f(s, x)) for k, f in enumerate(monomials)]

    return Form(parts)
