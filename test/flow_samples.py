"""What the linear device leaves of recordings in which nothing happens: noise of the forces, and a walk."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gyro_calib.gap.evidence import CHANNELS
from gyro_calib.gap.flow_left import FlowLeft

ROW_S = 0.01
#: no harmonic of it is folded near what goes to and fro
CARRIER_HZ = 15030.0
#: of a gain of forces and of a walk [1/s]
FORCED, WALK = 2e-5, 1e-7


def quiet_flows(rng: np.random.Generator, starts_s: Sequence[float], rows: int, excited_hz: float = 0.0) -> list[FlowLeft]:
    """Recordings of two kinds in turn, the second with a side band if one is given."""

    def noise() -> NDArray[np.float64]:
        return FORCED * rng.standard_normal(rows) + WALK * np.cumsum(rng.standard_normal(rows))

    return [
        FlowLeft(
            f"run_{k}",
            ("ftr_x", float(k % 2), False),
            ROW_S,
            CARRIER_HZ,
            excited_hz * (k % 2),
            0.0,
            {c: noise() for c in CHANNELS},
            np.zeros(rows),
            start_s,
        )
        for k, start_s in enumerate(starts_s)
    ]
