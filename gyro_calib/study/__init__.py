"""Studies: claims that are tried over many seeds, with gates that hold or do not.

A study is a module in :mod:`gyro_calib.study.studies` with a constant ``STUDY``; nothing else needs to know of it.
"""

from .gates import Gate, coverage, quantile, rms
from .registry import Study, find_study, list_studies
from .runner import StudyResult, run_study

__all__ = ["Gate", "Study", "StudyResult", "coverage", "find_study", "list_studies", "quantile", "rms", "run_study"]
