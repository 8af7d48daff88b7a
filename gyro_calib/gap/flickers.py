"""How much the gains of a campaign's pick-offs and drives flicker, where that is more than a healthy device's.

A pick-off's is heard through L, the more the faster; :func:`.noise_law.gain_floors` measures it in every campaign, for a healthy device has
such a floor as well. A drive's is noise of the amplitude alone, as large as the damping times the wave; what shakes the resonator shakes it
across its wave as well.
"""

from __future__ import annotations

import math

import numpy as np

from .evidence import CampaignEvidence
from .noise_law import IN_PHASE
from .parts import Linear
from .system import NoiseByRole

__all__ = ["DRIVE_FLICKERS", "PICKOFF_FLICKERS", "drive_flicker", "flickers", "pickoff_flicker", "tells_drives"]

#: density of a gain at 1 Hz from which on it flickers more than a healthy one [1/sqrt(Hz)]: pick-offs of eight plants came to 3.7e-6,
#: drives of the practice devices to 3e-5
PICKOFF_FLICKERS, DRIVE_FLICKERS = 1.2e-5, 1.4e-4
#: of a drive's, over the density across the wave, in power: practice devices have 1 to 3; over a pick-off's, which moves the wave too (six
#: times in records of 4 s)
_BEYOND, _BEYOND_PICKOFF = 30.0, 8.0
#: recordings of an axis that tell its noise from what a fit of a few explains, and damping over the nominal one of which that is so
_FEWEST, _LEAST_DAMPING = 4, 0.3


def pickoff_flicker(noise: NoiseByRole) -> tuple[float, float]:
    """Densities at 1 Hz of the gains of x and y beyond a healthy device's [1/sqrt(Hz)], 0 for an axis that has no more."""
    of_gains = [law.floors for (_, channel), law in noise.items() if channel in IN_PHASE]
    x, y = (math.sqrt(max((floors[axis] for floors in of_gains), default=0.0)) for axis in range(2))
    return x if x > PICKOFF_FLICKERS else 0.0, y if y > PICKOFF_FLICKERS else 0.0


def drive_flicker(evidence: CampaignEvidence, linear: Linear, noise: NoiseByRole) -> tuple[float, float]:
    """Densities at 1 Hz of the gains of both drives beyond a healthy device's [1/sqrt(Hz)], 0 for an axis that has no more."""
    found, read = [], pickoff_flicker(noise)
    for axis, name in enumerate("xy"):
        role = f"ftr_{name}"
        laws = [noise.get((role, channel)) for channel in ("amplitude", "precession")]
        squares = [r.mean_square for r in evidence if r.role == role]
        if len(squares) < _FEWEST or laws[0] is None or laws[1] is None:
            found.append(0.0)
            continue
        along, across = (law.coefficients[0] + law.coefficients[1] for law in laws if law is not None)
        # a projection's variance is a two-sided density
        damping = max(abs(linear.A[axis, axis].real), _LEAST_DAMPING * evidence.decay_rate)
        size = math.sqrt(2.0 * max(along - across, 0.0) / float(np.median(squares))) / damping
        counts = along > _BEYOND * across and size > max(DRIVE_FLICKERS, _BEYOND_PICKOFF * max(read))
        found.append(float(size) if counts else 0.0)
    return found[0], found[1]


def tells_drives(evidence: CampaignEvidence) -> bool:
    """Whether there are recordings enough of an axis to say how its drive's gain flickers."""
    return any(sum(r.role == f"ftr_{axis}" for r in evidence) >= _FEWEST for axis in "xy")


def flickers(evidence: CampaignEvidence, linear: Linear, noise: NoiseByRole) -> float:
    """Largest density of a gain that flickers more than a healthy one [1/sqrt(Hz)], or 0."""
    return max(*pickoff_flicker(noise), *drive_flicker(evidence, linear, noise))
