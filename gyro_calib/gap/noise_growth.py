"""Noise that grows with the amplitude: a gain of the pick-offs that is noisy, jitter of their clock.

Far from the carrier a pick-off's noise is its electronics' and does not know how large the wave is. What is multiplied by the wave does:
density ``S0 + Q a^2``, S0 of each kind of record, Q of the unit. Along the wave's phase that is a noisy gain, across it a noisy clock: a
gain of one-sided density s^2 gives s^2 a^2 along the phase; if it is noisy up to twice the carrier, half as much more along and a third of
all across.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..recording.recording import Recording
from .spectra import detrended, plain_records

__all__ = ["NoiseGrowth", "noise_growth"]

#: band over the rows' rate: above the loops, below where the recorder's filter cuts
_BAND = (0.06, 0.24)
#: below this the loops answer to noise, more or less with the amplitude [Hz]
_ABOVE_LOOPS_HZ = 30.0
#: least ratio of amplitudes that tells a growth
_SPAN = 1.3
_ROUNDS = 6
#: neighbouring bins behind a Hann window are not independent: variance of a mean over that of independent ones
_HANN = 1.94
#: most that a noisy gain puts across the phase over what it puts along
_ACROSS = 1.0 / 3.0
#: how well the band's density is that of the envelope: a recorder's filter takes some tenths of it
_FILTER = 0.15


@dataclass(frozen=True)
class NoiseGrowth:
    """How the floor grows with the amplitude.

    Parameters
    ----------
    along, across : (float, float)
        Excess density over the squared amplitude, one-sided [1/Hz], along and across the wave's phase, each with its sd.
    """

    along: tuple[float, float]
    across: tuple[float, float]

    @property
    def gain_per_rthz(self) -> tuple[float, float]:
        """Density of the noisy gain and its sd [1/sqrt(Hz)]."""
        value, sd = self.along
        size = float(np.sqrt(max(value, 0.0)))
        return size, float(np.hypot(0.5 * sd / size, _FILTER * size)) if size > 0.0 else self.gain_per_rthz_limit

    @property
    def gain_per_rthz_limit(self) -> float:
        """Density of a noisy gain that would be one standard deviation of the growth [1/sqrt(Hz)]."""
        return float(np.sqrt(self.along[1]))

    @property
    def gain_sigma(self) -> float:
        """Significance of a noisy gain, in standard deviations."""
        return self.along[0] / self.along[1]

    @property
    def clock_sigma(self) -> float:
        """Significance of noise across the phase beyond what a noisy gain brings."""
        gain = _ACROSS * max(self.along[0], 0.0)
        return (self.across[0] - gain) / float(np.hypot(self.across[1], _ACROSS * self.along[1]))


def noise_growth(recordings: Sequence[Recording]) -> NoiseGrowth | None:
    """Growth of the floor; nothing where the amplitude was not varied or the rows are too slow to see above the loops."""
    groups: dict[tuple[str, float], list[Recording]] = defaultdict(list)
    for r in plain_records(recordings):
        groups[r.command.mode, r.sample_rate_hz].append(r)
    kept = [members for (_, rate_hz), members in groups.items() if _span(members) > _SPAN and _BAND[0] * rate_hz >= _ABOVE_LOOPS_HZ]
    if not kept:
        return None
    floors = [[_floor(r) for r in members] for members in kept]
    return NoiseGrowth(_slope([[(f.along, f) for f in m] for m in floors]), _slope([[(f.across, f) for f in m] for m in floors]))


def _span(members: Sequence[Recording]) -> float:
    sizes = [r.command.setpoints.amplitude_v for r in members]
    return max(sizes) / min(sizes)


@dataclass(frozen=True)
class _Floor:
    """Density on the axes that hold the wave, along and across its phase, one-sided [V^2/Hz]; the squared amplitude there; bins."""

    along: float
    across: float
    square: float
    bins: int


def _floor(r: Recording) -> _Floor:
    squares = np.mean(np.abs(r.pick) ** 2, axis=0)
    share = squares / squares.sum()
    phase = 0.5 * float(np.angle(np.mean(np.sum(r.pick**2, axis=1))))
    x = detrended(r.pick * np.exp(-1j * phase))
    window = np.hanning(len(r))[:, None]
    frequency = np.fft.rfftfreq(len(r), 1.0 / r.sample_rate_hz)
    inside = (frequency > _BAND[0] * r.sample_rate_hz) & (frequency < _BAND[1] * r.sample_rate_hz)
    scale = 2.0 / (r.sample_rate_hz * float(np.sum(window**2)))
    along, across = (
        float(share @ (scale * np.mean(np.abs(np.fft.rfft(part * window, axis=0)[inside]) ** 2, axis=0))) for part in (x.real, x.imag)
    )
    return _Floor(along, across, float(share @ squares), int(inside.sum()))


def _slope(groups: Sequence[Sequence[tuple[float, _Floor]]]) -> tuple[float, float]:
    """Growth with the squared amplitude, each kind of record with a floor of its own: weighted least squares."""
    values = np.array([value for members in groups for value, _ in members])
    weight = np.sqrt(np.array([f.bins / _HANN for members in groups for _, f in members]))
    kinds = np.repeat(np.arange(len(groups)), [len(members) for members in groups])
    design = np.column_stack([*(kinds == k for k in range(len(groups))), [f.square for members in groups for _, f in members]]).astype(
        float
    )
    expected = values
    for _ in range(_ROUNDS):
        rows = weight / expected
        solution, *_ = np.linalg.lstsq(design * rows[:, None], values * rows, rcond=None)
        expected = np.maximum(design @ solution, 0.2 * values)
    covariance = np.linalg.inv((design * rows[:, None]).T @ (design * rows[:, None]))
    left = (values - design @ solution) * rows
    spread = max(1.0, float(left @ left) / max(values.size - design.shape[1], 1))
    return float(solution[-1]), float(np.sqrt(spread * covariance[-1, -1]))
