"""A cross stiffness that is not symmetric: a constant of the linear device, which no residual shows, and which a rate table tells.

With the pick-offs P the volts have ``A = P (i K - D - kappa Omega J) P^-1``, and a rate changes A by ``-kappa R``, ``R = P J P^-1``
(:func:`.linear_device.reaction_of`). So ``-tr(A R) / 2`` is the part of what stands between the P's that goes with J, whatever their gains,
phases and angles: its real part is the rate's, its imaginary part a stiffness that gives work to a wave that goes round (effects.md 3).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable

import numpy as np

from ..effects import EFFECTS
from ..quantity import Quantity
from ..recording.applied_rate import is_turned
from .diagnosis import FoundEffect, Standing
from .evidence import CampaignEvidence
from .linear_device import linear_of
from .spectral_effects import SEEN, SIGMA, found_beside
from .system import Solution

__all__ = ["RECIPROCITY", "circulatory_stiffness", "reciprocity"]

RECIPROCITY = "circulatory_stiffness"
#: what is not linear of second order in pick-offs and table, over what is unequal of A (sd)
_SECOND_ORDER = 1e-4
#: step of a derivative, in standard deviations
_STEP = 0.5
#: what A and the response to rate are told by
_TOLD_BY = ("A_", "G_", "rate_mismatch", "rate_skew")


def reciprocity(
    evidence: CampaignEvidence, solution: Solution, angular_gain: float, found: Iterable[str], without: Collection[str] = ()
) -> tuple[tuple[FoundEffect, ...], tuple[Standing, ...]]:
    """The effect, if there is one, and its line.

    Parameters
    ----------
    evidence : CampaignEvidence
    solution : Solution
        With all effects that were found.
    angular_gain : float
    found : iterable of str
        Their names: beside one that changes what a rate does to the pick-offs nothing is said.
    without : collection of str
        Effects that the registry shall not hold.
    """
    if RECIPROCITY in without:
        return (), ()
    effect = EFFECTS[RECIPROCITY]
    told = any(is_turned(r.recording) for r in evidence) and not any(_changes_the_reaction(name) for name in found)
    size = circulatory_stiffness(evidence, solution, angular_gain) if told else None
    if size is None:
        return (), (Standing(RECIPROCITY, effect.title, effect.location, "not testable", None, 0.0, 0.0, 0.0),)
    present = abs(size.value) > SIGMA * size.sd
    limit = None if present else Quantity(SEEN * size.sd, size.sd, size.unit)
    line = Standing(RECIPROCITY, effect.title, effect.location, "present" if present else "excluded", limit, 0.0, 0.0, 0.0)
    return ((found_beside(RECIPROCITY, {"k": size}, SIGMA**2, harmless=False),) if present else ()), (line,)


def circulatory_stiffness(evidence: CampaignEvidence, solution: Solution, angular_gain: float) -> Quantity:
    """Antisymmetric part of the cross stiffness and its sd [rad/s].

    Parameters
    ----------
    evidence : CampaignEvidence
        With recordings on a rate table.
    solution : Solution
    angular_gain : float
    """
    values = solution.by_name()

    def at(moved: dict[str, float]) -> complex:
        linear = linear_of(evidence, moved, angular_gain)
        return complex(-0.5 * np.trace(linear.A @ linear.reaction))

    here = at(values)
    slopes = np.zeros(len(solution.columns))
    for k, column in enumerate(solution.columns):
        step = _STEP * math.sqrt(solution.covariance[k, k])
        if column.name.startswith(_TOLD_BY) and step > 0.0:
            slopes[k] = (at({**values, column.name: values[column.name] + step}) - here).imag / step
    A = linear_of(evidence, values, angular_gain).A
    unequal = float(np.abs(A - np.eye(2) * np.trace(A) / 2.0).max())
    sd = math.hypot(math.sqrt(max(float(slopes @ solution.covariance @ slopes), 0.0)), _SECOND_ORDER * unequal)
    return Quantity(here.imag, sd, EFFECTS[RECIPROCITY].parameter("k").unit)


def _changes_the_reaction(name: str) -> bool:
    effect = EFFECTS[name]
    return effect.location == "pick-off" or "rate" in effect.needs
