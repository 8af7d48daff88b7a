"""Where a device differs from the simulation, which effect causes it, how far the gap shrinks once that effect is added."""

from .diagnose import diagnose
from .diagnosis import Diagnosis, FoundEffect, Gap, NextExperiment, Standing, Unknown

__all__ = ["Diagnosis", "FoundEffect", "Gap", "NextExperiment", "Standing", "Unknown", "diagnose"]
