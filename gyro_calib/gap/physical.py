"""Whether an effect's size is one that it can have."""

from __future__ import annotations

import numpy as np

from ..effects import EFFECTS
from .candidates import registry_name
from .screen import Screened

__all__ = ["physical", "worth_at_its_level"]

#: a share that multiplies an effect whose size is its setting must be near one
_SHARES, _ROUGH_SHARES, _SHARE_SD = (0.6, 1.7), (0.4, 2.5), 0.25
#: a lag of the thermometer that is long against a ramp [s]
_BENDING_LAG_S = 0.5


def physical(found: Screened, *, rough: bool = True) -> bool:
    """Whether an effect's size is one that it can have.

    The share of a level or of a lag is one, ``rough``: as far as a fit that lacks it can say.
    """
    low, high = _ROUGH_SHARES if rough else _SHARES
    known = {p.name: p for p in EFFECTS[registry_name(found.name, found.candidate.setting)].parameters}
    for name, (value, sd) in found.sizes().items():
        if name in known and not known[name].lower - 3.0 * sd <= value <= known[name].upper + 3.0 * sd:
            return False
    # a mode whose line covers the resonance is a memory
    if abs(found.candidate.setting.get("separation_hz", np.inf)) < found.candidate.setting.get("half_width_hz", 0.0):
        return False
    told = "level" in found.candidate.setting or found.name == "thermal_lag"
    if rough and found.candidate.setting.get("tau", 0.0) > _BENDING_LAG_S and found.name == "thermal_lag":
        # without it the frequency hardly seems to follow the temperature, and the share is of that
        high = np.inf
    return not told or low <= found.sizes()["share"][0] <= high


def worth_at_its_level(found: Screened) -> float:
    """Log evidence, less what speaks against a level of which not all is taken: where little lies beyond it levels are nearly alike."""
    share = found.sizes()["share"][0] if "level" in found.candidate.setting else 1.0
    return found.log_evidence - 0.5 * ((share - 1.0) / _SHARE_SD) ** 2
