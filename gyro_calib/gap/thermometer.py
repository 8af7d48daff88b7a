"""A thermometer that errs: what follows the temperature errs with it, by a number of its own in every record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .columns import Column
from .evidence import CampaignEvidence
from .linear_device import span_k
from .nuisance import NOTICED_K, following_columns
from .parts import Linear
from .signals import with_temperature

__all__ = ["THERMOMETER", "thermometer_columns"]

ComplexArray = NDArray[np.complex128]
#: how the names of these columns begin
THERMOMETER = "thermometer_"


def thermometer_columns(evidence: CampaignEvidence, linear: Linear, values: Mapping[str, float], error_k: float) -> list[Column]:
    """What a kelvin of a sensor's noise, of its drift or of its distance from the resonator makes, record by record.

    The resonance alone tells where it was (`wander_columns`); damping, gains and phases were taken at the temperature that was read.

    Parameters
    ----------
    evidence : CampaignEvidence
    linear : Linear
    values : mapping
        What follows the temperature as it was found, by name.
    error_k : float
        How far a sensor may be from the resonator [K].
    """
    if span_k(evidence) < NOTICED_K:
        return []
    warmer = replace(evidence, recordings=tuple(replace(r, signals=with_temperature(r.signals, 1.0)) for r in evidence))
    found = [c for c in following_columns(warmer, linear) if values.get(c.name)]
    columns = []
    for k, r in enumerate(evidence):
        signal = _alone(k, [values[c.name] * c.signal[k] for c in found], [o.signal.lhs.size for o in evidence])
        quiet = _alone(k, [values[c.name] * c.quiet[k] for c in found], [o.quiet.lhs.size for o in evidence])
        if r.is_wave and np.any(signal[k]):
            columns.append(Column(f"{THERMOMETER}{r.index}", signal, quiet, error_k))
    return columns


def _alone(k: int, parts: list[ComplexArray], sizes: list[int]) -> tuple[ComplexArray, ...]:
    """The sum of parts in recording k, nothing in the others."""
    return tuple(sum(parts, np.zeros(n, complex)) if j == k else np.zeros(n, complex) for j, n in enumerate(sizes))
