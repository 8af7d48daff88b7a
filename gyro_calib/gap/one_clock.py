"""One device clock for the whole campaign: recordings that overlap in time were written by a clock that was set back between them.

Drifts, memories and what flickers are told by when each recording was made. Where every file begins at zero, a healthy ring had a flicker
of its drives; put one behind the other in the order of the file it has none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from ..errors import DataError
from ..recording.recording import Recording

__all__ = ["on_one_clock"]

#: share of the shorter of two recordings that both may hold: a filter's length, a clock that was rounded
_SHARED = 0.5
#: time between recordings whose clock was set back [s]
_BETWEEN_S = 1.0


def on_one_clock(recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """Recordings whose times do not overlap, and a line where theirs did.

    Parameters
    ----------
    recordings : sequence of Recording
        In the order of the file.

    Returns
    -------
    recordings, warnings : list of Recording, list of str

    Raises
    ------
    DataError
        A recording that is there twice.
    """
    order = sorted(recordings, key=lambda r: float(r.t[0]))
    overlapping = [(a, b) for a, b in pairwise(order) if float(a.t[-1] - b.t[0]) > _SHARED * min(a.duration_s, b.duration_s)]
    _check_once(recordings)
    if not overlapping:
        return list(recordings), []
    a, b = overlapping[0]
    warning = (
        f"One clock must run through the campaign, but t of {a.label} ({a.t[0]:.6g} to {a.t[-1]:.6g} s) and of {b.label} ({b.t[0]:.6g} to "
        f"{b.t[-1]:.6g} s) overlap, as those of {len(overlapping)} pairs do. They are taken one behind the other in the order of the file: "
        "what drifts is told roughly. Give t of a clock that is not set back."
    )
    return _behind_each_other(recordings), [warning]


def _check_once(recordings: Sequence[Recording]) -> None:
    seen: dict[tuple[int, bytes], list[Recording]] = {}
    for r in recordings:
        alike = seen.setdefault((len(r), r.data[len(r) // 2, 2:].tobytes()), [])
        for other in alike:
            if np.array_equal(r.data[:, 2:], other.data[:, 2:]):
                raise DataError(
                    f"Each recording must be there once, but the {len(r)} rows of {r.label!r} (t from {r.t[0]:.6g} s) are those of "
                    f"{other.label!r} (t from {other.t[0]:.6g} s). Leave one of them out, or give each file once."
                )
        alike.append(r)


def _behind_each_other(recordings: Sequence[Recording]) -> list[Recording]:
    ends_s, moved = float(recordings[0].t[0]) - _BETWEEN_S, []
    for r in recordings:
        by_s = ends_s + _BETWEEN_S - float(r.t[0])
        data = r.data.copy()
        data[:, 0] += by_s
        raw = None if r.raw is None else {name: x + by_s if name == "t" else x for name, x in r.raw.items()}
        moved.append(replace(r, data=data, extras=_moved_start(r, by_s), raw=raw))
        ends_s = float(data[-1, 0])
    return moved


def _moved_start(r: Recording, by_s: float) -> dict[str, Any]:
    """What the logger said, with the start of the run on the same clock as the rows; without it where it was on another."""
    extras = dict(r.extras)
    begun, settled = extras.pop("t_run_start", None), extras.get("settle_s", 0.0)
    if isinstance(begun, int | float) and isinstance(settled, int | float) and abs(begun + settled - r.t[0]) < r.duration_s:
        extras["t_run_start"] = float(begun) + by_s
    return extras
