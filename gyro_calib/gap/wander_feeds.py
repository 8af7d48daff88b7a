"""What is left of a wander where it feeds through: a slope of its own in every record, and all of it in those that warm.

Of the volts ``V = m + E u`` only m goes with the resonance, and what a wander makes of that is taken off with the column of E
(:mod:`.wander`). On a hemisphere of a nineteenth plant, whose precession takes 2.7 V of drive, that is 37 000 in chi-square. Some
hundred of it are left, as a slope of the resonance that is another in each record, which no constant of the device holds. Healthy, with
eleven noises, that unit had eight times an effect or something unknown, of 53 to 100 and each time another one. The cause is not known:
the course that is followed is right to 1e-6 rad/s.

Of a record that warms the course is measured as well as that, but effects of the temperature move its resonance too, and their columns
take off what feeds through by themselves. There what was measured has a column, and how much of it is a wander the fit says: all of it on
a healthy device. Healthy hemispheres of a 22nd plant say 1.15 +- 0.14, 1.24 +- 0.26, 0.91 +- 0.33 and 1.75 +- 0.20; without it one had a
bent coefficient of its frequency (131 in chi-square) and one a gain that lags (75).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

from .column import Column
from .columns import QUIET, SIGNAL, Place
from .evidence import CampaignEvidence, RecordingEvidence
from .flow_left import rows_left
from .parts import Linear
from .wander import FASTEST_HZ, is_moved_by_temperature, tells_its_wander

__all__ = ["wander_feeds"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: how far a resonance goes on within a record beyond what is followed, sd over its frequency: as usual ones lie from record to record
_SLIDES = 5e-8
#: how much of what moved a resonance while it warmed is no effect's, sd
_WANDERS = 1.0
#: and how much it must feed through, rms over the wave's amplitude [1/s]: of 4e-3 deg/h there is nothing to ask
_LEAST_FED = 2e-8


def wander_feeds(evidence: CampaignEvidence, linear: Linear) -> list[Column]:
    """Two columns, of either phase, for each record that tells its wander, and one for each that warms; none where no wander is known.

    Parameters
    ----------
    evidence : CampaignEvidence
    linear : Linear
    """
    columns: list[Column] = []
    for r in evidence if linear.followed is not None else ():
        if tells_its_wander(r):
            signal, quiet = (
                _feeding(evidence, r, place, linear, np.linspace(-1.0, 1.0, len(r.signals.time_s))) for place in (SIGNAL, QUIET)
            )
            for name, factor in (("re", 1.0 + 0j), ("im", 1j)):
                own, beside = (tuple(factor * v for v in side) for side in (signal, quiet))
                columns.append(Column(f"wander_feeds_{r.index}_{name}", own, beside, _SLIDES * evidence.omega0_rad_s))
        elif is_moved_by_temperature(r):
            course = _measured(r, linear)
            if _fed(r, linear, course).std() < _LEAST_FED * math.sqrt(r.mean_square):
                continue
            own, beside = (tuple(_feeding(evidence, r, place, linear, course)) for place in (SIGNAL, QUIET))
            columns.append(Column(f"wander_feeds_{r.index}", own, beside, _WANDERS))
    return [c for c in columns if any(np.any(v) for v in c.signal)]


def _measured(r: RecordingEvidence, linear: Linear) -> FloatArray:
    """Where the resonance lay beyond what is known of it, as fast as a wander is followed [rad/s], shape (n,)."""
    cosines = dct(rows_left(r.signals, linear)[1].imag, norm="ortho")
    cosines[np.arange(len(cosines)) >= 2.0 * FASTEST_HZ * len(cosines) * r.signals.row_s] = 0.0
    return np.asarray(idct(cosines, norm="ortho"))


def _feeding(evidence: CampaignEvidence, which: RecordingEvidence, place: Place, linear: Linear, course: FloatArray) -> list[ComplexArray]:
    """Of a resonance that moves by ``w(t)`` in one recording, ``-i w E u``, turned by the wave's phase, by recording."""
    found = which.turn * place.projector(which).plain([_fed(which, linear, course)])[:, 0]
    sizes = ((r.quiet if place.quiet else r.signal).lhs.size for r in evidence)
    return [found if r is which else np.zeros(size, complex) for r, size in zip(evidence, sizes, strict=True)]


def _fed(r: RecordingEvidence, linear: Linear, course: FloatArray) -> ComplexArray:
    """``-i w E u`` row by row, shape (n, 2)."""
    return np.asarray(-1j * course[:, None] * (r.signals.drive @ linear.E.T))
