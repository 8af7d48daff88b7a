"""Numbers of the factory data that an estimate needs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ..errors import CalibrationRefused

__all__ = ["angular_gain", "factory_value"]


def angular_gain(factory: Mapping[str, Any]) -> float:
    """Kappa of the factory data; refuses without.

    Raises
    ------
    CalibrationRefused
        There is none, or it is not a positive number.
    """
    kappa = factory.get("angular_gain_kappa")
    if not isinstance(kappa, int | float) or not kappa > 0:
        raise CalibrationRefused(
            f"Factory data must hold a positive angular_gain_kappa, but got {kappa!r}. "
            "No self-calibration sees it: take it from the factory."
        )
    return float(kappa)


def factory_value(factory: Mapping[str, Any], name: str) -> float:
    """A number that the factory may have left out: zero then.

    Parameters
    ----------
    factory : mapping
    name : str
    """
    value = factory.get(name)
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else 0.0
