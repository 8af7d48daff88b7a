"""The campaigns of blind trials, and poor ones. One function knows which plan a kind of unit runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ..experiments import Plan, SimulatedInstrument, Step
from ..experiments.gap_plans import gap_ftr_plan, gap_whole_angle_plan
from ..experiments.plan import Limits

__all__ = ["POOR", "campaign_plan", "poor_plan"]

#: what a poor campaign lacks
POOR = ("few recordings", "no temperature run", "one amplitude")
#: a unit with a large effect must not end its trial
_LIMITS = Limits(temperature_k=30.0, base_rate_rad_s=10.0)
_FEW = {"force-rebalance": 8, "whole-angle": 6}


def campaign_plan(kind: str, factory: Mapping[str, Any], rng: np.random.Generator, quality: str = "standard") -> Plan:
    """The whole campaign of a kind of unit, its order drawn."""
    plan = gap_ftr_plan if kind == "ring" else gap_whole_angle_plan
    seed = int(rng.integers(2**31))
    return plan(factory, quality=quality, limits=_LIMITS, seed=seed, abilities=SimulatedInstrument.abilities)


def poor_plan(plan: Plan, how: str, mode: str, amplitude_v: float) -> Plan:
    """What is left of a campaign whose owner did not do all of it.

    Parameters
    ----------
    plan : Plan
    how : str
        Of :data:`POOR`.
    mode : {"force-rebalance", "whole-angle"}
    amplitude_v : float
        The mission's.
    """
    if how == "no temperature run":
        kept = [s for s in plan.steps if s.temperature_degc is None and "thermal" not in s.label]
    elif how == "one amplitude":
        kept = [s for s in plan.steps if s.detuning_hz is not None or s.label == "locate" or _at_mission(s, amplitude_v)]
    else:
        plain = [s for s in plan.steps if s.command.mode.startswith("ftr") or s.command.mode == "whole_angle"]
        kept = [s for s in plain if _at_mission(s, amplitude_v) and s.temperature_degc is None and not s.applied_rate][: _FEW[mode]]
    return replace(plan, name=f"{plan.name}, {how}", steps=tuple(kept))


def _at_mission(step: Step, amplitude_v: float) -> bool:
    return abs(step.command.setpoints.amplitude_v / amplitude_v - 1.0) < 0.01 and not step.command.mode.startswith("ring")
