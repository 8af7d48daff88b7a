"""Every plan by its name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..errors import DataError
from .bench_plans import BENCH_PLANS
from .gap_plans import GAP_PLANS
from .plan import Limits, Plan
from .plans import PLANS

__all__ = ["plan_by_name"]


def plan_by_name(name: str, factory: Mapping[str, Any], *, quality: str = "standard", limits: Limits | None = None, **options: Any) -> Plan:
    """Build a plan.

    Parameters
    ----------
    name : str
        One of :data:`PLANS`, of the bench's (:data:`.bench_plans.BENCH_PLANS`: a rate table, converter samples), or of the campaigns
        from which a gap is diagnosed (:data:`.gap_plans.GAP_PLANS`).
    factory : mapping
        Factory data of the unit.
    quality : {"quick", "standard", "fine"}
    limits : Limits, optional
        Abort conditions.
    **options
        Of the campaigns for a gap: ``seed``, ``abilities``, ``temperature_degc``.

    Raises
    ------
    DataError
        Unknown plan or quality, or factory data that lack what the plan needs.
    """
    plans = PLANS | BENCH_PLANS | GAP_PLANS
    if name not in plans:
        raise DataError(f"Plan must be one of {', '.join(plans)}, but got {name!r}.")
    return plans[name](factory, quality=quality, limits=limits, **options)
