"""Steps of the pick-offs' converter, read off carrier-rate samples: coarse ones without dither make an error that follows the signal.

Noise of half a step and more makes rounding a white noise of ``lsb^2/12`` a sample, which is that of any floor. Below that the error
depends on the signal (Widrow and Kollar, Quantization Noise, 2008, ch. 4), and no form of the slow flow has it; the samples themselves show
the grid.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..recording.recording import Recording

__all__ = ["ConverterSteps", "converter_steps", "step_of"]

FloatArray = NDArray[np.float64]
#: fewest samples that tell a grid; largest distance from it, in steps, and fewest samples apart by a few steps
_FEWEST, _OFF_GRID, _NEAR, _FEW_STEPS = 256, 0.02, 12, 6.0
#: step over the standard deviation of what is left beside a carrier from which on no noise dithers it: noise of half a step, and the
#: rounding's own third of one, make 1.7
_UNDITHERED = 1.7
#: gain of rounding by that measure, and the least noise, in squared steps, that is told beside the rounding's own: of three campaigns whose
#: noise was 0.14 to 0.30 of a step it came to 240, to 1750, and to nothing
_ROUNDED, _LEAST_NOISE = 5e3, 2e-3
#: how well the volts of a sample are known, relative: the grid itself is told better
_SCALE = 1e-6


@dataclass(frozen=True)
class ConverterSteps:
    """A grid that all samples lie on.

    Parameters
    ----------
    lsb_v, lsb_sd_v : float
        Its step [V], and its standard deviation: how far recordings differ in it, and a millionth for the scale of the volts.
    over_noise : float
        The step over the standard deviation of a sample, rounding included.
    """

    lsb_v: float
    lsb_sd_v: float
    over_noise: float

    @property
    def undithered(self) -> bool:
        """Whether the noise is too small to make rounding a white noise."""
        return self.over_noise > _UNDITHERED

    @property
    def rounded_gain(self) -> float:
        """Chi-square in the slow flow that rounding may have under any name.

        Noise of s steps leaves ``exp(-2 pi^2 s^2)`` of the error that follows the signal (Widrow and Kollar, ch. 4), which counts by its
        square, over that of the noise.
        """
        s = max(1.0 / self.over_noise**2 - 1.0 / 12.0, _LEAST_NOISE)
        return _ROUNDED * math.exp(-4.0 * math.pi**2 * s) / s


def step_of(samples: FloatArray) -> float | None:
    """Step of the grid that samples lie on, or None where they lie on none that their number can tell.

    Parameters
    ----------
    samples : ndarray, shape (n,)
        Readings of a converter [V].
    """
    values = np.unique(samples[np.isfinite(samples)])
    if samples.size < _FEWEST or values.size < _NEAR:
        return None
    apart = np.diff(values)
    rounding = 1e-9 * float(np.abs(values).max())
    apart = apart[apart > rounding]
    if not apart.size:
        return None
    step = float(apart.min())
    # differences that are few steps each, at random, are whole by chance once in thousands: smallest ones first, then all
    few = apart[apart < _FEW_STEPS * step]
    if few.size < _NEAR:
        return None
    step = float(np.sum(few) / np.sum(np.round(few / step)))
    off = apart / step
    return step if np.all(np.abs(off - np.round(off)) < _OFF_GRID * np.maximum(1.0, 1e-3 * off)) else None


def converter_steps(recordings: Sequence[Recording], channels: Sequence[str] = ("x_pick", "y_pick")) -> ConverterSteps | None:
    """Steps of a converter, where samples at its rate are there and lie on a grid.

    Parameters
    ----------
    recordings : sequence of Recording
        Those without carrier-rate samples say nothing.
    channels : sequence of str
        Of the raw samples that it makes.
    """
    steps, over = [], []
    for r in recordings:
        for channel in channels:
            samples = np.asarray((r.raw or {}).get(channel, np.zeros(0)), dtype=np.float64)
            step = step_of(samples)
            if step is None:
                continue
            steps.append(step)
            noise = _beside_carrier(r, samples)
            if noise is not None:
                over.append(step / max(noise, step / math.sqrt(12.0)))
    if not steps or not over:
        return None
    lsb_v = float(np.median(steps))
    return ConverterSteps(lsb_v, math.hypot(float(np.std(steps)), _SCALE * lsb_v), float(np.median(over)))


def _beside_carrier(r: Recording, samples: FloatArray) -> float | None:
    """Standard deviation of samples beside a carrier whose envelope goes as a parabola; None where their time is not recorded."""
    raw = r.raw or {}
    if "t" not in raw:
        return None
    time = np.asarray(raw["t"], dtype=np.float64)
    middle = (time - time.mean()) / max(float(np.ptp(time)), 1e-300)
    phase = np.asarray(raw["phase_ref"]) if "phase_ref" in raw else float(np.median(r.ref_omega_rad_s)) * (time - time[0])
    base = np.stack([np.ones_like(middle), middle, middle**2], axis=1)
    design = np.concatenate([base * np.cos(phase)[:, None], base * np.sin(phase)[:, None], base[:, :1]], axis=1)
    left = samples - design @ np.linalg.lstsq(design, samples, rcond=None)[0]
    return float(np.sqrt(np.sum(left**2) / max(len(left) - design.shape[1], 1)))
