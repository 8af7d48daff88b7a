"""What is left of a wander where it feeds through: a slope of its own in every record.

Of the volts ``V = m + E u`` only m goes with the resonance, and what a wander makes of that is taken off with the column of E
(:mod:`.wander`). On a hemisphere of a nineteenth plant, whose precession takes 2.7 V of drive, that is 37 000 in chi-square. Some
hundred of it are left, as a slope of the resonance that is another in each record, which no constant of the device holds. Healthy, with
eleven noises, that unit had eight times an effect or something unknown, of 53 to 100 and each time another one. The cause is not known:
the course that is followed is right to 1e-6 rad/s.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .column import Column
from .columns import QUIET, SIGNAL, Place
from .evidence import CampaignEvidence, RecordingEvidence
from .parts import Linear
from .wander import tells_its_wander

__all__ = ["wander_feeds"]

ComplexArray = NDArray[np.complex128]
#: how far a resonance goes on within a record beyond what is followed, sd over its frequency: as usual ones lie from record to record
_SLIDES = 5e-8


def wander_feeds(evidence: CampaignEvidence, linear: Linear) -> list[Column]:
    """Two columns, of either phase, for each record that tells its wander, ``wander_feeds_index``; none where no wander is known.

    Parameters
    ----------
    evidence : CampaignEvidence
    linear : Linear
    """
    columns: list[Column] = []
    for r in evidence if linear.followed is not None else ():
        if tells_its_wander(r):
            signal, quiet = (_sliding(evidence, r, place, linear) for place in (SIGNAL, QUIET))
            for name, factor in (("re", 1.0 + 0j), ("im", 1j)):
                own, beside = (tuple(factor * v for v in side) for side in (signal, quiet))
                columns.append(Column(f"wander_feeds_{r.index}_{name}", own, beside, _SLIDES * evidence.omega0_rad_s))
    return [c for c in columns if any(np.any(v) for v in c.signal)]


def _sliding(evidence: CampaignEvidence, which: RecordingEvidence, place: Place, linear: Linear) -> list[ComplexArray]:
    """Of a resonance that slides by 1 rad/s to either side, ``-i w E u``, turned by the wave's phase, by recording."""
    drive = which.signals.drive
    fed = -1j * np.linspace(-1.0, 1.0, len(drive))[:, None] * (drive @ linear.E.T)
    found = which.turn * place.projector(which).plain([fed])[:, 0]
    sizes = ((r.quiet if place.quiet else r.signal).lhs.size for r in evidence)
    return [found if r is which else np.zeros(size, complex) for r, size in zip(evidence, sizes, strict=True)]
