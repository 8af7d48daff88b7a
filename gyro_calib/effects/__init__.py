"""The registry of effects that a linear gyro leaves out: one for simulator, estimators and diagnoser."""

from .catalogue import EFFECTS, checked_sizes, effect_named
from .effect import LOCATIONS, MODES, NEEDS, Effect, Parameter

__all__ = ["EFFECTS", "LOCATIONS", "MODES", "NEEDS", "Effect", "Parameter", "checked_sizes", "effect_named"]
