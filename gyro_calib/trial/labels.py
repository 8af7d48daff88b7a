"""What a trial holds, drawn and sealed: the hash of the label is written before the diagnosis, the label opened after all verdicts."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from ..effects import EFFECTS
from ..errors import DataError
from ..gap.forms import FORMS
from .plans import POOR
from .units import KINDS

__all__ = ["LADDER", "STRATA", "Label", "Seal", "Trial", "draw_trials", "reported_name", "trial_effects"]

#: kinds of trial; of every twelve trials so many
STRATA: dict[str, int] = {"clean": 3, "one": 4, "two": 1, "removed": 2, "drift": 1, "poor": 1}
#: effective signal-to-noise ratios: root of the chi-square that the effect takes away on average, nuisances projected out
LADDER = (4.0, 6.0, 8.0, 12.0, 20.0, 40.0)
#: a variant is reported under the name of its effect
_VARIANTS = {form.per_axis: name for name, form in FORMS.items() if form.per_axis}
#: ratio from which on an effect is asked for
_STRONG = 8.0


def reported_name(name: str) -> str:
    """Name under which a diagnosis reports an effect of the registry."""
    return _VARIANTS.get(name, name)


def trial_effects(mode: str) -> tuple[str, ...]:
    """Effects that a trial may hold: those with an envelope form (a size can be given to a wanted ratio) in this kind of campaign."""
    return tuple(name for name, e in EFFECTS.items() if mode in e.modes and reported_name(name) in FORMS)


@dataclass(frozen=True)
class Trial:
    """What is asked of a trial before anything is simulated.

    Parameters
    ----------
    number : int
        Place in the run.
    stratum : str
        Of :data:`STRATA`.
    kind : str
        Of unit.
    snr : tuple of float
        Effective signal-to-noise ratio of each effect.
    order : tuple of str
        Effects in drawn order: the first whose size can be reached on this unit are taken.
    poor : str
        Of :data:`.plans.POOR`, or "".
    """

    number: int
    stratum: str
    kind: str
    snr: tuple[float, ...]
    order: tuple[str, ...]
    poor: str = ""


@dataclass(frozen=True)
class Label:
    """The truth of a trial.

    Parameters
    ----------
    number : int
    stratum, kind : str
    effects : mapping
        Sizes as they were given to the plant: effect -> parameter -> value.
    snr : tuple of float
        Effective signal-to-noise ratio of each.
    without : tuple of str
        What the registry does not hold in this trial.
    like : mapping
        For each effect those that imitate it on a clean campaign of the unit, with the ratio that is left of it behind them.
    poor : str
    ramp_k_per_s : float
        Drift of the temperature.
    drifts : tuple of str
        Effects of the registry by which the unit drifts besides: to name them is right, but not what is asked.
    """

    number: int
    stratum: str
    kind: str
    effects: Mapping[str, Mapping[str, float]]
    snr: tuple[float, ...]
    without: tuple[str, ...] = ()
    like: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    poor: str = ""
    ramp_k_per_s: float = 0.0
    drifts: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names under which the effects should be reported."""
        return tuple(reported_name(name) for name in self.effects)

    def to_json(self) -> dict[str, Any]:
        """Plain types."""
        return asdict(self)


@dataclass(frozen=True)
class Seal:
    """Hash of a label with a nonce: nobody can read the label from it, and nobody can change the label after it."""

    sha256: str

    @classmethod
    def of(cls, label: Label, nonce: str) -> Seal:
        """Seal a label."""
        text = json.dumps(label.to_json(), sort_keys=True, allow_nan=False) + nonce
        return cls(hashlib.sha256(text.encode()).hexdigest())

    def check(self, label: Label, nonce: str) -> None:
        """Raises :class:`DataError` when the label is not the sealed one."""
        opened = Seal.of(label, nonce)
        if opened != self:
            raise DataError(f"Label of trial {label.number} must have the hash {self.sha256}, but got {opened.sha256}. The trial is void.")


def draw_trials(count: int, seed: int, strata: Sequence[str] = (), ladder: Sequence[float] = LADDER) -> list[Trial]:
    """Draw trials, ring and hemisphere alternating, the strata in their shares.

    Parameters
    ----------
    count, seed : int
    strata : sequence of str
        Only these (default: all).
    ladder : sequence of float
        Effective signal-to-noise ratios in turn; other strata than single effects take those from 8 on.

    Raises
    ------
    DataError
        An unknown stratum, a ladder without a ratio from 8 on.
    """
    unknown = sorted(set(strata) - set(STRATA))
    if unknown:
        raise DataError(f"Argument strata must be of {', '.join(STRATA)}, but got {', '.join(unknown)}.")
    if not all(0.0 < snr < math.inf for snr in ladder) or not any(snr >= _STRONG for snr in ladder):
        raise DataError(f"Argument ladder must hold positive ratios, one of them >= {_STRONG:g}, but got {list(ladder)}.")
    cycle = _spread({name: share for name, share in STRATA.items() if not strata or name in strata})
    seen: dict[str, int] = {}
    trials = []
    for number in range(count):
        # both kinds of unit go through the whole cycle
        stratum = cycle[(number // 2) % len(cycle)]
        place = seen[stratum] = seen.get(stratum, -1) + 1
        trials.append(_drawn(number, stratum, place, seed, ladder))
    return trials


def _spread(shares: Mapping[str, int]) -> list[str]:
    """Strata in turn, each as often as its share and as evenly as can be."""
    places = [((k + 0.5) / share, name) for name, share in shares.items() for k in range(share)]
    return [name for _, name in sorted(places, key=lambda p: p[0])]


def _drawn(number: int, stratum: str, place: int, seed: int, ladder: Sequence[float]) -> Trial:
    rng = np.random.default_rng([0x7A1A, seed, number])
    kind = ("ring", "hemisphere")[number % 2]
    names = trial_effects(KINDS[kind])
    # one shuffle for all trials of a kind and a stratum, begun elsewhere in each: every effect once before any comes again
    shuffled = np.random.default_rng([0x0DE, seed, number % 2, list(STRATA).index(stratum)]).permutation(len(names))
    step = place // 2
    order = tuple(names[k] for k in np.roll(shuffled, -step))
    strong = tuple(snr for snr in ladder if snr >= _STRONG)
    poor = ""
    if stratum == "clean":
        snr: tuple[float, ...] = ()
    elif stratum == "two":
        snr = tuple(float(s) for s in rng.choice(strong, size=2))
    elif stratum == "one":
        snr = (ladder[step % len(ladder)],)
    elif stratum == "removed":
        # of the faintest little is left behind what comes nearest
        behind = strong[1:] or strong
        snr = (behind[step % len(behind)],)
    else:
        snr = (strong[step % len(strong)],)
    if stratum == "poor":
        poor = POOR[step % len(POOR)]
    return Trial(number, stratum, kind, snr, order if snr else (), poor)
