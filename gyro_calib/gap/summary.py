"""What a diagnosis says in a sentence that a person reads first."""

from __future__ import annotations

import math
from collections.abc import Mapping

from ..quantity import Quantity
from .diagnosis import AsHealthy, FoundEffect, Standing, Unknown
from .flicker_effects import FLICKERS
from .heldout import Shrinkage
from .loop_effects import LOOP_EFFECTS
from .reciprocity import RECIPROCITY
from .spectral_effects import SAMPLED, SPECTRAL

__all__ = ["said", "summary_of"]

#: where effects stand that no residual of the slow flow shows
_PLACES = (
    (SPECTRAL, "in the spectra"),
    (FLICKERS, "in the floors of the noise"),
    (LOOP_EFFECTS, "in what the loops ask for"),
    ((RECIPROCITY,), "in the constants of the linear device"),
)
#: sd of the share that is closed, beyond which it is no figure to be told
_UNKNOWN_SHARE = 0.5
#: share of the effects that cannot be tested, from which on none found is no more than half an answer: the practice campaigns have 0.08
_MUCH_UNTESTED = 0.25
#: what a device has as healthy ones may is said first where it is so many times as large as they usually have it
_UNUSUAL = 1.5


def summary_of(
    verdict: str,
    effects: tuple[FoundEffect, ...],
    unknown: Unknown | None,
    shrunk: Shrinkage,
    lines: tuple[Standing, ...] = (),
    held: tuple[AsHealthy, ...] = (),
    untested: str = "",
) -> str:
    """One sentence for people, or two.

    Parameters
    ----------
    verdict : str
        As in the JSON.
    effects : tuple of FoundEffect
    unknown : Unknown or None
    shrunk : Shrinkage
        On unseen experiments.
    lines : tuple of Standing
        Of every effect.
    held : tuple of AsHealthy
        What it has as any healthy device may.
    untested : str
        What these recordings hold that they cannot test.
    """
    if verdict == "none":
        count = sum(s.status == "not testable" for s in lines)
        but = f", but {count} of {len(lines)} effects cannot be tested with these recordings: see the list of those not testable"
        explained = f"None: the linear device explains all {shrunk.dof} unseen figures to {shrunk.rms_before:.2f} of their noise"
        unusual = "; ".join(f"{h.name} ({_sizes(h.told or h.parameters)})" for h in held if h.times_usual > _UNUSUAL)
        as_some = (
            f" More than healthy devices usually have, but as some do: {unusual}. A fleet of healthy units decides." if unusual else ""
        )
        return f"{explained}{but if count > _MUCH_UNTESTED * len(lines) else ''}.{as_some}"
    if verdict == "not_testable":
        little = "these recordings vary too little to tell an effect from the constants of a linear device"
        return f"Not testable: {untested or little}."
    if unknown is not None:
        something = f"Beside {' and '.join(e.name for e in effects)}, by far the larger, something" if effects else "Something"
        return f"{something} that is not in the catalogue, {unknown.words()} (nearest known: {unknown.nearest or 'none'})."
    words = []
    for e in effects:
        others = [name for name in e.group if name != e.name]
        alike = f"one of {', '.join(others)}, which these data cannot tell from it" if others else "anything these data cannot tell from it"
        words.append(f"{e.name} ({_sizes(e.parameters)}), or {alike}")
    beside = {name for names, _ in _PLACES for name in names}
    if all(e.name in beside for e in effects):
        places = [place for names, place in _PLACES if any(e.name in names for e in effects)]
        return f"Present: {'; and '.join(words)}. It stands {' and '.join(places)}, and leaves the means of the slow flow alone."
    if all(e.name in beside.union(SAMPLED) for e in effects):
        return f"Present: {'; and '.join(words)}. How much of the gap it closes no form of the slow flow tells."
    present = f"Present: {'; and '.join(words)}."
    if shrunk.told_sd > _UNKNOWN_SHARE:
        return f"{present} How much of the gap it closes, the experiments that it was not found on are too few to tell."
    return f"{present} It closes {100.0 * min(shrunk.told, 1.0):.1f} % of the gap on experiments that it was not found on."


def _sizes(parameters: Mapping[str, Quantity]) -> str:
    return ", ".join(f"{name} = {said(q)}" for name, q in parameters.items())


def said(q: Quantity) -> str:
    """A quantity to the second digit of its standard deviation."""
    unit = "" if q.unit == "1" else f" {q.unit}"
    if not (q.sd > 0.0 and math.isfinite(q.sd)):
        return f"{q.value:.3g} ± {q.sd:.2g}{unit}"
    last = math.floor(math.log10(q.sd)) - 1
    # no minus before nothing
    value = round(q.value, -last) + 0.0
    digits = max(math.floor(math.log10(abs(value))) - last + 1, 1) if value else 1
    return f"{value:.{digits}g} ± {q.sd:.2g}{unit}"
