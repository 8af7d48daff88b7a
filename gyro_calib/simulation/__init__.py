"""Simulate a device: carrier level and slow flow, under the same loops and filters."""

from .simulator import GyroSimulator
from .truth import Truth

__all__ = ["GyroSimulator", "Truth"]
