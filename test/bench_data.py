"""Where the practice recordings of another plant are, and what was true of them. Tests that use them skip when they are absent."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

BENCH = Path(os.environ.get("GYRO_CALIB_BENCH", Path(__file__).resolve().parents[2] / "shared" / "bench"))
needs_bench = pytest.mark.skipif(not (BENCH / "truth.json").is_file(), reason="bench recordings are not here (GYRO_CALIB_BENCH)")


def truth(name: str) -> dict[str, Any]:
    """Truth of one campaign, matrices as complex arrays."""
    entry = json.loads((BENCH / "truth.json").read_text())[name]
    for key, short in (("A_per_s", "A"), ("G_per_s", "G"), ("E", "E")):
        entry[short] = _complex(entry[key])
    entry["ratio"] = complex(*entry["pickoff_ratio_y_over_x"])
    return dict(entry)


def _complex(nested: list[Any]) -> NDArray[np.complex128]:
    return np.asarray(nested)[..., 0] + 1j * np.asarray(nested)[..., 1]
