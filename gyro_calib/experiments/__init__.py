"""Sequences of commands and what they must record, written once against the instrument seam."""

from typing import TYPE_CHECKING

from ..later import loaded_later
from .bench_plans import BENCH_PLANS, factory_plan, pickoff_phase_plan
from .by_name import plan_by_name
from .gap_plans import GAP_ABILITIES, GAP_PLANS, gap_ftr_plan, gap_plan, gap_whole_angle_plan
from .instrument import Instrument, compensation_in_force
from .plan import Limits, Plan, Step
from .plans import (
    PLANS,
    QUALITIES,
    cubic_plan,
    feedthrough_plan,
    mission_mode,
    self_calibration_plan,
    sideband_plan,
    static_plan,
)
from .runner import Progress, run_plan
from .whole_angle_plans import scale_factor_plan, virtual_precession_plan

if TYPE_CHECKING:
    from .simulated import SimulatedInstrument

__all__ = [
    "BENCH_PLANS",
    "GAP_ABILITIES",
    "GAP_PLANS",
    "PLANS",
    "QUALITIES",
    "Instrument",
    "Limits",
    "Plan",
    "Progress",
    "SimulatedInstrument",
    "Step",
    "compensation_in_force",
    "cubic_plan",
    "factory_plan",
    "feedthrough_plan",
    "gap_ftr_plan",
    "gap_plan",
    "gap_whole_angle_plan",
    "mission_mode",
    "pickoff_phase_plan",
    "plan_by_name",
    "run_plan",
    "scale_factor_plan",
    "self_calibration_plan",
    "sideband_plan",
    "static_plan",
    "virtual_precession_plan",
]

# a live gyro's plans do without the simulation
__getattr__ = loaded_later(__name__, {"SimulatedInstrument": "simulated"})
