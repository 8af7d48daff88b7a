"""How likely a device is healthy, or has something that no name fits, after a diagnosis."""

from __future__ import annotations

import math
from collections.abc import Sequence

from .diagnosis import FoundEffect, Unknown
from .select import Selection

__all__ = ["beside_unknown", "none_or_unknown"]

#: how often what something unnamed takes an effect takes that stands beside it, and up to how many do: three names imitate one term
_STANDS, _BESIDE = 30.0, 2

#: a healthy device is believed this often before any recording; what is there and was not seen in trials, and how much of that has no name
_NONE_BEFORE, _MISSED, _NAMELESS = 0.5, 0.18, 0.7
#: log evidence of which healthy devices reach some, and by how much at most what is there reaches it more often.
#: From 4 on were, of those with verdict none in trials, 44 of 258 healthy devices and 5 of 21 others, which is 1.4 times as often; few are
#: the others, so up to three times is believed
_DOUBTFUL, _AT_MOST = 6.0, 0.36
#: how often what was found unknown is none, up to a chi-square, beyond which that falls with it, and at least: of 30 trials 22 took more
#: than that, all of them right, and of the 8 others one was healthy; how much of the rest has no name
_UNKNOWN_IS_NONE, _UP_TO, _AT_LEAST, _UNKNOWN_IS = 0.12, 100.0, 0.01, 0.93
#: log evidence of a line beside the carrier, which the selection does not weigh
_LINE = 50.0


def beside_unknown(effects: tuple[FoundEffect, ...], unknown: Unknown | None) -> tuple[FoundEffect, ...]:
    """Effects that are there whatever has no name: all if nothing has none, or one or two that each take many times as much."""
    if unknown is None:
        return effects
    return tuple(e for e in effects if e.gain > _STANDS * unknown.gain) if len(effects) <= _BESIDE else ()


def none_or_unknown(
    selection: Selection, lines: Sequence[FoundEffect], unknown: Unknown | None, beside: Sequence[FoundEffect] = ()
) -> tuple[float, float]:
    """Probability of none, and of something unnamed: by the evidence, and by how often such verdicts were right in trials.

    Parameters
    ----------
    selection : Selection
    lines : sequence of FoundEffect
        Effects that were found in the spectra.
    unknown : Unknown or None
    beside : sequence of FoundEffect
        Effects that stand beside what is unknown.

    Returns
    -------
    tuple of float
        What is left of 1 is for the catalogue: the effects that are named and, of a device without, one too small to be seen.
    """
    if unknown is not None:
        # what an effect stands in by many times as much is not healthy
        none = 0.0 if beside else max(_UNKNOWN_IS_NONE * min(_UP_TO / max(unknown.gain, 1.0), 1.0), _AT_LEAST)
        return none, _UNKNOWN_IS * (1.0 - none)
    found = [*selection.probabilities, *(e.probability for e in lines)]
    if found:
        # what is not this effect is another or unnamed: against none the evidence itself speaks
        strongest = max((e.log_evidence for e in selection.effects), default=_LINE)
        none = 1.0 / (1.0 + _odds(strongest))
        return none, max(1.0 - max(found) - none, 0.0)
    best = max((s.log_evidence for s in selection.screened.values()), default=-10.0)
    something = (1.0 - _NONE_BEFORE) * (min(_odds(best), _AT_MOST) + _MISSED)
    none = _NONE_BEFORE / (_NONE_BEFORE + something)
    return none, _NAMELESS * min(1.0 - none, _MISSED)


def _odds(log_evidence: float) -> float:
    return math.exp(min(0.5 * (log_evidence - _DOUBTFUL), 50.0))
