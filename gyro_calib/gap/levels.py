"""Limits and dead zones at the carrier: what an axis loses of its fundamental beyond a level, or below it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import ive

from .parts import Linear, Part, Setting
from .signals import Signals

__all__ = ["clipped", "dead", "dead_drive", "dead_settings", "limit_settings", "lost_in_noise"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: levels of a limit over the largest amplitude of all recordings, and over that of the median one
_LIMITS = 1.0 - np.concatenate([[0.6, 0.45, 0.33, 0.25, 0.18, 0.13, 0.09, 0.06, 0.04], np.geomspace(0.025, 8e-5, 12)])
_COARSE = np.geomspace(0.4, 4.0, 10)
#: a dead zone that is small against the drive acts in proportion to its level: a coarse grid tells it
_DEAD = np.concatenate([[2e-6, 8e-6, 3e-5], np.geomspace(1e-4, 0.4, 14)])
#: noise of loops that reaches a drive between two rows of the record, over the largest drive of the median recording
_NOISE = np.geomspace(1e-3, 0.3, 10)
#: drive over its noise from which on it is as good as without
_LOUD = 1e3


def clipped(x: ComplexArray, level: float) -> ComplexArray:
    """Fundamental of a clipped sine less the sine: describing function of a limiter."""
    r = np.minimum(level / np.maximum(np.abs(x), 1e-300), 1.0)
    return np.asarray(x * (2.0 / np.pi * (np.arcsin(r) + r * np.sqrt(1.0 - r**2)) - 1.0))


def dead(x: ComplexArray, level: float) -> ComplexArray:
    """Fundamental behind a dead zone less the sine: a dead zone passes what a limiter takes away."""
    return np.asarray(-(x + clipped(x, level)))


def lost_in_noise(x: ComplexArray, noise_v: float) -> ComplexArray:
    """What a dead zone takes of a drive that is noisy between rows, per volt of its level, where that is small against the noise.

    A dead zone of level L takes ``4 L / pi`` of any amplitude above it, along the carrier of the moment. A mean drive x beside a complex
    Gaussian noise of sd s of either part keeps of that direction ``E[cos] = sqrt(pi/8) r exp(-q) (I0(q) + I1(q))``, r = ``|x|/s``,
    q = ``r^2/4`` (Rice): so the noise dithers the zone, and small drives lose in proportion.

    Parameters
    ----------
    x : ndarray, complex
        Drive [V].
    noise_v : float
        s [V].
    """
    # the Bessel functions give up on large arguments, where the noise no longer counts
    r = np.minimum(np.abs(x) / noise_v, _LOUD)
    along = math.sqrt(np.pi / 8.0) * r * (ive(0, r**2 / 4.0) + ive(1, r**2 / 4.0))
    return np.asarray(-4.0 / np.pi * along * x / np.maximum(np.abs(x), 1e-300))


def dead_drive(s: Signals, d: Linear, setting: Setting) -> list[Part]:
    """A dead zone of a level by its share; beside noise by its level."""
    if "noise" in setting:
        return [Part("level", "drive", lost_in_noise(s.drive, setting["noise"]))]
    return [Part("share", "drive", dead(s.drive, setting["level"]))]


def _peaks(signals: list[Signals], of: Literal["pick", "drive"]) -> FloatArray:
    return np.array([float(np.quantile(np.abs(getattr(s, of)), 0.998)) for s in signals])


def _levels(peaks: FloatArray, shares: FloatArray) -> list[Setting]:
    levels = np.concatenate([peaks.max() * shares, float(np.median(peaks)) * _COARSE])
    return [{"level": float(level)} for level in np.unique(levels)]


def limit_settings(of: Literal["pick", "drive"]) -> Callable[[list[Signals]], list[Setting]]:
    """Levels that are shares of the largest amplitude of any axis: of all recordings, and of those in which drives were not wound up."""
    return lambda signals: _levels(_peaks(signals, of), _LIMITS)


def dead_settings(signals: list[Signals]) -> list[Setting]:
    """Levels of dead zones, and noises beside which one is told by its level alone."""
    peaks = _peaks(signals, "drive")
    return [*_levels(peaks, _DEAD), *({"noise": float(np.median(peaks) * share)} for share in _NOISE)]
