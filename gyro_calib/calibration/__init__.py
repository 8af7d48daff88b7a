"""The calibration record, its store, and its application to rates."""

from typing import TYPE_CHECKING

from ..later import loaded_later
from .alignment import SenseAxes
from .apply import CorrectedRate, Corrector, validity_problems
from .document import dump_record, parse_record
from .errormodel import COVARIANCE_MODES, CovarianceModel, RateErrorModel
from .factory_record import FactoryRecord, factory_record_from_result, with_factory_record
from .factory_store import FactoryStore
from .location import default_path, resolve_url, ros_home
from .merge import with_scale_factor_of
from .record import NOISE_DENSITY_UNIT, SCHEMA_VERSION, CalibrationRecord
from .store import LoadedRecord, RecordMissingError, RecordStore, read_record

if TYPE_CHECKING:
    from .compensation_rounds import Compensated, CompensationRound, compensate
    from .from_result import record_from_result
    from .mission import Drifts, MissionRate, mission_rate

__all__ = [
    "COVARIANCE_MODES",
    "NOISE_DENSITY_UNIT",
    "SCHEMA_VERSION",
    "CalibrationRecord",
    "Compensated",
    "CompensationRound",
    "CorrectedRate",
    "Corrector",
    "CovarianceModel",
    "Drifts",
    "FactoryRecord",
    "FactoryStore",
    "LoadedRecord",
    "MissionRate",
    "RateErrorModel",
    "RecordMissingError",
    "RecordStore",
    "SenseAxes",
    "compensate",
    "default_path",
    "dump_record",
    "factory_record_from_result",
    "mission_rate",
    "parse_record",
    "read_record",
    "record_from_result",
    "resolve_url",
    "ros_home",
    "validity_problems",
    "with_factory_record",
    "with_scale_factor_of",
]

# what needs the estimators, half a second and 100 MB to load; a corrector does without for months
__getattr__ = loaded_later(
    __name__,
    {
        "Compensated": "compensation_rounds",
        "CompensationRound": "compensation_rounds",
        "Drifts": "mission",
        "MissionRate": "mission",
        "compensate": "compensation_rounds",
        "mission_rate": "mission",
        "record_from_result": "from_result",
    },
)
