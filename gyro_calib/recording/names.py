"""The usual spellings of column names, matched to ours."""

from __future__ import annotations

import re
from collections.abc import Iterable

from ..errors import DataError
from .columns import CHANNELS, COLUMN_UNITS, COLUMNS

__all__ = ["match_columns", "match_envelope", "match_raw"]

#: other words (letters and digits only, lower case) for the columns whose meaning they leave no doubt of
_OTHER_WORDS = {
    "time": "t",
    "times": "t",
    "ts": "t",
    "reffreq": "ref_freq",
    "reffreqhz": "ref_freq",
    "fref": "ref_freq",
    "frefhz": "ref_freq",
    "freq": "ref_freq",
    "freqhz": "ref_freq",
    "frequency": "ref_freq",
    "referencefrequency": "ref_freq",
    "referencefrequencyhz": "ref_freq",
    "temp": "temperature",
    "tempc": "temperature",
    "tempdegc": "temperature",
    "temperaturec": "temperature",
    "temperaturedegc": "temperature",
    "segmentid": "segment",
}
_RAW_WORDS = {
    "t": "t",
    "time": "t",
    "xadc": "x_pick",
    "yadc": "y_pick",
    "xpick": "x_pick",
    "ypick": "y_pick",
    "xdac": "x_drive",
    "ydac": "y_drive",
    "xdrive": "x_drive",
    "ydrive": "y_drive",
    "phase": "phase_ref",
    "phaseref": "phase_ref",
    "phasereference": "phase_ref",
    "temperature": "temperature",
    "temperaturedegc": "temperature",
}
#: columns that a file may lack
_OPTIONAL = ("segment", "temperature")


def match_columns(found: Iterable[str], where: str) -> dict[str, str]:
    """Column of ours -> name in the file.

    Parameters
    ----------
    found : iterable of str
        Names in the file; others than columns are left alone.
    where : str
        Names the recording in an error's text.

    Returns
    -------
    dict of str to str
        Every column that was found; ``segment`` and ``temperature`` may be missing.

    Raises
    ------
    DataError
        A column is missing, or two names mean the same one.
    """
    names = list(found)
    matched = {name: name for name in names if name in COLUMNS}
    for name in names:
        column = _column_for(name)
        if column is None or matched.get(column) == name:
            continue
        if column in matched and matched[column] not in COLUMNS:
            raise DataError(f"Column {column} of {where} must stand once, but got {matched[column]!r} and {name!r}. Rename one of them.")
        matched.setdefault(column, name)
    missing = [column for column in COLUMNS if column not in matched and column not in _OPTIONAL]
    if missing:
        raise DataError(
            f"Recording {where} must have the columns {', '.join(f'{c} [{COLUMN_UNITS[c]}]' for c in missing)}, but got only "
            f"{', '.join(sorted(names)) or 'none'}. Name the columns as listed."
        )
    return matched


def match_envelope(name: str) -> bool:
    """Whether a name in the file means one of the eight envelope columns."""
    return _column_for(name) in CHANNELS


def match_raw(found: Iterable[str]) -> dict[str, str]:
    """Carrier-rate channel (``t``, ``x_pick``, ``y_pick``, ``x_drive``, ``y_drive``, ``phase_ref``, ``temperature``) -> name in file."""
    matched: dict[str, str] = {}
    for name in found:
        channel = _RAW_WORDS.get(_letters(name))
        if channel is not None:
            matched.setdefault(channel, name)
    return matched


def _column_for(name: str) -> str | None:
    letters = _letters(name).replace("pickoff", "pick")
    plain = {_letters(column): column for column in COLUMNS}
    return plain.get(letters) or _OTHER_WORDS.get(letters)


def _letters(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())
