"""Chosen effects about the device that they are found in, not about the one that the fit without them believes.

The forms are of first order: they use A and G of the fit without effects, and the pick-off's volts as read. A strong effect bends those.
With the sizes found, A and G come from the fit with the effects, and the motion is what the read volts are once the pick-off's own share is
taken out (``V = p + c o(p)`` solved for p); a few rounds make the equations exact in both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .candidates import candidate_at
from .evidence import CampaignEvidence
from .forms import FORMS
from .linear_device import linear_of
from .model import CampaignModel
from .parts import Linear, Setting
from .screen import Candidate, Screened
from .signals import Signals, with_pick

__all__ = ["relinearised"]

ComplexArray = NDArray[np.complex128]
_ROUNDS, _INVERSIONS = 4, 12
#: a pick-off that clips is inverted slowly; when its volts move by less than this there is no more to invert [V]
_INVERTED_V = 1e-9
_LEVELS = (0.85, 0.92, 0.97, 0.99, 1.01, 1.03, 1.08, 1.15)


def relinearised(model: CampaignModel, chosen: Sequence[Candidate], start: Linear | None = None) -> list[Candidate]:
    """The same effects at the same settings, with columns about the fit that holds them; ``start``: a linear device to begin about."""
    current = [c if start is None else _again(model.evidence, start, c, c.setting) for c in chosen]
    for _ in range(_ROUNDS if chosen else 0):
        solution = model.fitted(current)
        values = solution.by_name()
        linear = linear_of(model.evidence, values, model.linear.angular_gain, model.linear.followed)
        if all(c.name != "thermal_lag" for c in current):
            linear = replace(linear, frequency_slope_rad_s_k=model.linear.frequency_slope_rad_s_k)
        sizes = {c.name: {column.name: values[f"{c.name}.{column.name}"] for column in c.columns} for c in current}
        found = [replace(r, signals=with_pick(r.signals, _motion(r.signals, linear, current, sizes))) for r in model.evidence]
        evidence = replace(model.evidence, recordings=tuple(found))
        again = [_again(evidence, linear, c, c.setting, sizes[c.name]) for c in current]
        for k, candidate in enumerate(current):
            if "level" in candidate.setting:
                again[k] = _best_level(model, evidence, linear, again, k)
        current = again
    return current


def _again(
    evidence: CampaignEvidence, linear: Linear, candidate: Candidate, setting: Setting, sizes: Mapping[str, float] | None = None
) -> Candidate:
    return candidate_at(evidence, linear, candidate.name, setting, candidate.choices, sizes)


def _best_level(model: CampaignModel, evidence: CampaignEvidence, linear: Linear, chosen: Sequence[Candidate], k: int) -> Candidate:
    """The neighbouring level that explains most: it was found about a device that the effect had bent."""
    screener = model.screener_with([c for j, c in enumerate(chosen) if j != k])
    here = chosen[k]
    found = screener.screen(here)
    share = found.sizes()["share"][0] if found is not None else 1.0
    factors = (*_LEVELS, share) if 0.2 < share < 5.0 else _LEVELS
    tried = [here, *(_again(evidence, linear, here, {**here.setting, "level": factor * here.setting["level"]}) for factor in factors)]
    scores = [_score(screener.screen(c)) for c in tried]
    return tried[int(np.argmax(scores))]


def _score(found: Screened | None) -> float:
    """Chi-square taken away, less what a share that is not one takes back."""
    if found is None:
        return 0.0
    share, sd = found.sizes()["share"]
    return found.gain - ((share - 1.0) / max(sd, 1e-9)) ** 2


def _motion(signals: Signals, linear: Linear, chosen: Sequence[Candidate], sizes: dict[str, dict[str, float]]) -> ComplexArray:
    """Volts of a pick-off without the effects of the pick-off."""
    pick = signals.pick
    for _ in range(_INVERSIONS):
        at = with_pick(signals, pick)
        added = np.zeros_like(pick)
        for candidate in chosen:
            for part in FORMS[candidate.name].parts(at, linear, candidate.setting):
                if part.kind == "output":
                    # what may come with an effect has a size only once it was found beside it
                    added = added + sizes[candidate.name].get(part.parameter, 0.0) * part.signal
        moved, pick = float(np.abs(signals.pick - added - pick).max()), signals.pick - added
        if moved < _INVERTED_V:
            break
    return pick
