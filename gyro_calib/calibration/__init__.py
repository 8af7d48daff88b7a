"""The calibration record, its store, and its application to rates."""

from .alignment import SenseAxes
from .apply import CorrectedRate, Corrector, validity_problems
from .document import dump_record, parse_record
from .errormodel import COVARIANCE_MODES, CovarianceModel, RateErrorModel
from .from_result import record_from_result
from .location import default_path, resolve_url, ros_home
from .record import NOISE_DENSITY_UNIT, SCHEMA_VERSION, CalibrationRecord
from .store import LoadedRecord, RecordMissingError, RecordStore, read_record

__all__ = [
    "COVARIANCE_MODES",
    "NOISE_DENSITY_UNIT",
    "SCHEMA_VERSION",
    "CalibrationRecord",
    "CorrectedRate",
    "Corrector",
    "CovarianceModel",
    "LoadedRecord",
    "RateErrorModel",
    "RecordMissingError",
    "RecordStore",
    "SenseAxes",
    "default_path",
    "dump_record",
    "parse_record",
    "read_record",
    "record_from_result",
    "resolve_url",
    "ros_home",
    "validity_problems",
]
