"""From recordings to parameters: the data table, the slow-flow fit, the side-band estimator, Allan statistics."""

from .calibrate import calibrate
from .result import CalibrationResult, ConvergencePoint, MissionChannel
from .slow_flow_estimate import TableRow

__all__ = ["CalibrationResult", "ConvergencePoint", "MissionChannel", "TableRow", "calibrate"]
