"""The columns of a recording: names, order, units. A contract (live block, bag and file alike)."""

from __future__ import annotations

__all__ = ["CHANNELS", "COLUMNS", "COLUMN_UNITS", "column_index"]

#: name -> unit, in the order of a live block
COLUMN_UNITS: dict[str, str] = {
    "t": "s",
    "segment": "1",
    "x_pick_c": "V",
    "x_pick_s": "V",
    "y_pick_c": "V",
    "y_pick_s": "V",
    "x_drive_c": "V",
    "x_drive_s": "V",
    "y_drive_c": "V",
    "y_drive_s": "V",
    "ref_freq": "Hz",
    "temperature": "degC",
}

#: the twelve columns in their order
COLUMNS: tuple[str, ...] = tuple(COLUMN_UNITS)

#: the eight envelope columns [V]
CHANNELS: tuple[str, ...] = COLUMNS[2:10]


def column_index(name: str) -> int:
    """Index of column ``name``; raises ``KeyError`` naming the known ones."""
    try:
        return COLUMNS.index(name)
    except ValueError:
        raise KeyError(f"Column must be one of {', '.join(COLUMNS)}, but got {name!r}.") from None
