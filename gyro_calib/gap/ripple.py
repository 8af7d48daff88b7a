"""What loops answer that read within a cycle: commands that ripple at twice the reference, which no row holds and the drive does.

A phasor that is followed from sample to sample swings at twice the reference by what it has not followed yet, ``conj(p') / 2 omega``. Loops
that read it now and then drive with that, turned by the phase of the moment, and the part of it that falls on the carrier is a force in
proportion to how fast the wave changes. The loops of amplitude and of quadrature have gains of their own, so it is one share of the change
along a wave and another of that across it, at any phase. What feeds through from a drive is read by its own loop as well, gain and all: of
a gain of 1100 V/V and a feedthrough of 3e-4 a fifth of the answer, which goes with the azimuth as the feedthrough of the direction across
the wave does. Of a hemisphere of another plant 24e-6 and 51e-6 of the rate of precession, and 4e-6 and 8e-6 of it as ``cos 2 psi``; without
a feedthrough these are none, without a split or an anisotropy of damping they stay. It was *unknown*, a reading as ``x cos 4theta``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .column import Column
from .columns import part_columns
from .evidence import CampaignEvidence
from .parts import Linear, Part

__all__ = ["answers", "ripple_columns"]

ComplexArray = NDArray[np.complex128]

#: share of the rate of change, sd: clock of the rows over that of the reference, of two crystals, and what loops answer: of four rings of a
#: plant 4e-6 to 7e-5, at any phase; by the harmonic of twice the azimuth what feeds through adds to that, once and once more
_ANSWERED, _FED_BACK = 3e-5, (5e-6, 5e-7)


def ripple_columns(evidence: CampaignEvidence, linear: Linear) -> list[Column]:
    """A share of how fast the motion changes: rows whose second is not that of the reference, and loops that answer their ripple.

    Parameters
    ----------
    evidence : CampaignEvidence
    linear : Linear

    Returns
    -------
    list of Column
        Real sizes, of the motion's rate of change: of all of it, and in two phases of that along and across the wave, alike at every
        azimuth psi and as cos 2psi; across also as sin 2psi, cos 4psi and sin 4psi.
    """
    by_recording = []
    for r in evidence:
        motion = r.signals.pick - r.signals.drive @ linear.E.T
        speed = np.gradient(motion, r.signals.row_s, axis=0)
        # where loops are off nothing answers
        shapes = answers(motion, float(r.is_wave) * speed)
        # of a wave that stands, the lobes across it are noise
        heard = {k: v if r.is_turning or not k.startswith("across_") else 0.0 * v for k, v in shapes.items()}
        parts = [Part(f"ripple_{k}_{n}", "flow", q * v) for k, v in heard.items() for n, q in (("re", 1.0), ("im", 1j))]
        by_recording.append([Part("clock", "flow", speed), *parts])
    sizes = {f"_{order}{part}_": sd for order, sd in enumerate(_FED_BACK, 1) for part in "cs"}
    found = [c for c in part_columns(evidence, by_recording, linear) if any(np.any(v) for v in c.signal)]
    return [replace(c, prior_sd=next((sd for k, sd in sizes.items() if k in c.name), _ANSWERED)) for c in found]


def answers(motion: ComplexArray, speed: ComplexArray) -> dict[str, ComplexArray]:
    """How a motion changes, along its wave and across it, by the lobes of the azimuth psi.

    Parameters
    ----------
    motion, speed : ndarray, complex, shape (n, 2)
        Pick-off envelopes [V] and how fast they change [V/s].

    Returns
    -------
    dict of str to ndarray, complex, shape (n, 2)
        ``along`` and ``across``; ``along_1c`` and ``across_1c`` times cos 2psi, ``across_1s`` times sin 2psi, ``across_2c`` cos 4psi ...
    """
    x, y = motion.T
    size = np.sum(np.abs(motion) ** 2, axis=1) + np.finfo(float).tiny
    cos, sin = (np.abs(x) ** 2 - np.abs(y) ** 2) / size, 2.0 * (x.conj() * y).real / size
    mirrored = np.stack([cos * speed[:, 0] + sin * speed[:, 1], sin * speed[:, 0] - cos * speed[:, 1]], axis=1)
    along, across = (speed + mirrored) / 2.0, (speed - mirrored) / 2.0
    shapes = {"along": along, "across": across, "along_1c": cos[:, None] * along}
    for order in range(1, len(_FED_BACK) + 1):
        lobes = (cos + 1j * sin)[:, None] ** order
        shapes |= {f"across_{order}c": lobes.real * across, f"across_{order}s": lobes.imag * across}
    return shapes
