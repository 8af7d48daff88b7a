"""How large what no one calls a gap is on a healthy device: believed of any device, or told by a fleet of healthy ones."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

__all__ = ["HealthySpread", "size_of"]


@dataclass(frozen=True)
class HealthySpread:
    """Standard deviations of what healthy devices have, about zero: an effect of the same form shows only where it is larger.

    The defaults are those of any device. A maker whose units are known to be more alike has smaller ones (`fleet.py`).

    Parameters
    ----------
    gain_per_k : float
        Gain of the drives, or of the pick-offs, that both axes have alike [1/K].
    axis_gain_per_k : float
        Gain of one axis by itself [1/K]. Both are of one design: references and resistors of one lot part by tens of ppm/K; drives of two
        plants by other hands by 60 and 120.
    phase_per_k : float
        Phase of a drive or a pick-off [rad/K]: a tenth of a radian of filters whose parts move by 150 ppm/K.
    damping_per_k, damping_per_k2 : float
        Damping, relative [1/K], and its curvature [1/K^2].
    damping_axis_per_k : float
        Damping that does not go as all of it does, over its anisotropy [1/K].
    split_per_k, split_axis_per_k : float
        A split by its own size, and in any direction over all that is unequal [1/K]: what trims and gaps left of larger ones, each with a
        coefficient of its own. On a plant by another hand the axes of 24 units turned by 0.45 mrad/K (rms), which moves a split across
        itself by twice that share.
    feedthrough_per_k : float
        What feeds through, of itself [1/K]: strays by way of a board, whose permittivity moves by some 300 ppm/K.
    drive_lag_s : float
        Drives that are late carrier and all, by some samples of the converters [s].
    envelope_lag_s : float
        An envelope later than its record [s]: a sample of the converters, that firmware, filters and holds count or do not; of 31 healthy
        devices of two plants none lagged by 3e-6, and every ring of another led by one of its samples, 8.3e-6.
    sensor_lag_s, gradient_lag_s : float
        How late a temperature sensor is behind the resonator, and behind what warms elsewhere [s].
    stray_drift, gain_drift, phase_drift, rate_drift, damping_drift, split_drift : float
        How large a drift within a campaign may be at most, whose size each campaign tells: stray volts over those that hold a wave, gains
        [1] and phases [rad] of drives, rate, damping and split over the decay. Sixteen healthy devices of two plants came to 1e-5, and
        what drifts more is an effect, named or not.

    Raises
    ------
    ValueError
        A size that is not positive and finite.
    """

    gain_per_k: float = 3e-4
    axis_gain_per_k: float = 7.5e-5
    phase_per_k: float = 1.5e-5
    damping_per_k: float = 5e-3
    damping_per_k2: float = 3e-5
    damping_axis_per_k: float = 1e-3
    split_per_k: float = 1e-3
    split_axis_per_k: float = 1e-3
    feedthrough_per_k: float = 3e-4
    drive_lag_s: float = 3e-5
    envelope_lag_s: float = 1e-5
    sensor_lag_s: float = 0.1
    gradient_lag_s: float = 0.3
    stray_drift: float = 3e-5
    gain_drift: float = 3e-5
    phase_drift: float = 1e-5
    rate_drift: float = 3e-5
    damping_drift: float = 6e-5
    split_drift: float = 3e-5

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} must be a positive size of a healthy device, but got {value!r}. Leave it out if it is not known.")
            object.__setattr__(self, name, float(value))

    @classmethod
    def from_mapping(cls, sizes: Mapping[str, Any]) -> HealthySpread:
        """Of names and sizes; what is not named is as of any device.

        Raises
        ------
        ValueError
            A name that there is not, or a size that is not positive and finite.
        """
        known = [f.name for f in fields(cls)]
        if unknown := sorted(str(name) for name in sizes if name not in known):
            raise ValueError(f"no size of a healthy device is called {', '.join(unknown)}. There are: {', '.join(known)}.")
        return cls(**sizes)


#: the size that a nuisance's prior is of, by how its name begins
_SIZE_OF: Mapping[str, str] = {
    "both_thermal_drive_gain": "gain_per_k",
    "both_thermal_pickoff_gain": "gain_per_k",
    "thermal_drive_gain.": "axis_gain_per_k",
    "thermal_pickoff_gain.": "axis_gain_per_k",
    "thermal_drive_phase.": "phase_per_k",
    "thermal_pickoff_phase.": "phase_per_k",
    "thermal_damping.": "damping_per_k",
    "anisotropy_per_k": "damping_per_k",
    "rate_per_k": "damping_per_k",
    "damping_per_k2": "damping_per_k2",
    "thermal_damping_anisotropy.": "damping_axis_per_k",
    "split_per_k": "split_per_k",
    "thermal_split.": "split_axis_per_k",
    "fed_per_k": "feedthrough_per_k",
    "both_drive_delay": "drive_lag_s",
    "drive_lag.": "envelope_lag_s",
    "thermal_lag.": "sensor_lag_s",
    "gradient_": "gradient_lag_s",
    "drift.stray": "stray_drift",
    "drift.gain.": "gain_drift",
    "drift.phase.": "phase_drift",
    "drift.rate.": "rate_drift",
    "drift.damping.": "damping_drift",
    "drift.split.": "split_drift",
}


def size_of(column: str) -> str:
    """The field of :class:`HealthySpread` that the prior of a nuisance is of; "" for none."""
    return next((name for begins, name in _SIZE_OF.items() if column.startswith(begins)), "")
