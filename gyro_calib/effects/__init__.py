"""The registry of effects that a linear gyro leaves out: one for simulator, estimators and diagnoser."""

from .catalogue import EFFECTS, INSEPARABLE, checked_sizes, effect_named
from .effect import LOCATIONS, MODES, NEEDS, Effect, Parameter

__all__ = ["EFFECTS", "INSEPARABLE", "LOCATIONS", "MODES", "NEEDS", "Effect", "Parameter", "checked_sizes", "effect_named"]
