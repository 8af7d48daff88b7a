"""What the methods of document 003 share: the drive that pushes along the wave, the angle off an axis, means over blocks."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..recording.recording import Recording
from .drive_chain import DriveChain
from .wave import Wave, wave_coordinates

__all__ = ["COUPLING_SD", "SWITCHED", "block_means", "effective_drive", "off_axis", "wave_off_axis", "without_feedthrough"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: change of the drive ratio within a block, over the largest, from which on the drive is being switched
SWITCHED = 0.1
#: how well the couplings of the drives, and the angles of the pick-offs, are known when nobody says [rad]
COUPLING_SD = 5e-3


def block_means(values: FloatArray, width: int) -> FloatArray:
    """Means over blocks of ``width`` rows; what is left at the end is dropped."""
    count = values.size // width
    return np.asarray(values[: count * width].reshape(count, width).mean(axis=1))


def off_axis(recording: Recording, axis: str) -> float:
    """Mean angle of the wave of a recording from an axis (psi, or psi less a right angle), within half a turn [rad]."""
    return wave_off_axis(wave_coordinates(recording), axis)


def wave_off_axis(wave: Wave, axis: str) -> float:
    """:func:`off_axis` of a wave that is known [rad]."""
    psi = float(np.mean(wave.azimuth_rad)) - (0.5 * math.pi if axis == "y" else 0.0)
    return (psi + 0.5 * math.pi) % math.pi - 0.5 * math.pi


def effective_drive(wave: Wave, axis: str, chain: DriveChain | None) -> ComplexArray:
    """Drive of the axis that would push along the wave as the recorded ones do: ``n R (u_par n + u_perp n_perp)`` over R_xx or R_yy [V].

    The drive across the wave has its part: a rebalance or quadrature loop takes back what the couplings leak there, and they return some of
    it (the product of both couplings, 5e-4 of a hemisphere's gain).
    """
    if chain is None:
        return wave.drive_along
    n = np.stack([np.cos(wave.azimuth_rad), np.sin(wave.azimuth_rad)])
    across = np.stack([-n[1], n[0]])
    pushed = chain.matrix @ (wave.drive_along * n + wave.drive_across * across)
    return np.asarray(np.sum(n * pushed, axis=0) / (1.0 if axis == "x" else 1.0 + chain.delta_g))


def without_feedthrough(recording: Recording, feedthrough: ComplexArray) -> Recording:
    """The recording with pick-offs ``V - E u``: what the drives put straight onto them taken out; ``feedthrough``: E, shape (2, 2)."""
    data = recording.data.copy()
    clean = recording.pick - recording.drive @ np.asarray(feedthrough).T
    data[:, 2:6:2], data[:, 3:6:2] = clean.real, clean.imag
    return replace(recording, data=data)
