"""Lines beside an open drive's own: a drive whose gain or phase goes to and fro, by its supply or its reference.

Off resonance a closed loop's wave hardly follows: 37 Hz away a force moves a slow resonator by a hundredth of what it does 2 Hz away. An
open drive that stands 40 Hz beside the resonance has one of its two side bands there. What the linear device leaves of its motion,

    ``m' + i (omega - omega0) m - A m - G u``,

holds the line at ``+f`` and ``-f`` from the drive. Nothing else does so from one drive's frequency to another: a tone of vibration and
another mode keep their own frequency, the free motion stands at the resonance, which is left out. Noise of that sum is white where the
drives make it, and falls towards the resonance where the pick-offs do: both sizes are fitted in every record.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from ..recording.recording import Recording
from .parts import Linear
from .signals import WARMING_K, smooth_temperature
from .spectra import MEDIAN, is_image, steep_window

__all__ = ["OpenLine", "find_open_line"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: log evidence beyond the search from which on it is a line
_MARGIN = 15.0
#: power over the floor of a record that shows it; how many such records there must be, of how many frequencies of the drive
_SHOWN, _FEWEST, _FEWEST_DRIVES = 8.0, 2, 2
#: what its size costs in each bin
_PRICE = 2.0
#: bins about the drive's line and about the resonance that are the signal's: half the window's main lobe and more
_OWN_BINS = 4.5
#: half the width of an image, in bins: no image stood out of the floor of the practice devices' open drives
_IMAGE_BINS = 3.0
#: bins to both sides for a local floor; share of the rows' rate within which the rows' own filter leaves a line
_FLOOR_BINS, _PASSED = 30, 0.45
#: farthest that a side band is looked for [Hz]
_FARTHEST_HZ = 150.0
_SHORTEST_S = 1.0
_FEWEST_ROWS = 256
#: what a line between two bins is read too small by, at most
_BETWEEN_BINS = 0.06


@dataclass(frozen=True)
class OpenLine:
    """A gain or a phase of the drives that goes to and fro.

    Parameters
    ----------
    frequency_hz, frequency_sd_hz : float
        From the drive.
    share, share_sd : float
        Peak of the relative change.
    of_phase : bool or None
        Whether it is the phase and not the gain; None: only one side band tells, which is either's.
    log_evidence : float
        Beyond the search.
    """

    frequency_hz: float
    frequency_sd_hz: float
    share: float
    share_sd: float
    of_phase: bool | None
    log_evidence: float


@dataclass(frozen=True)
class _Open:
    """What an open drive's record leaves on its own axis, at frequencies from the drive.

    Parameters
    ----------
    drive_hz, bin_hz : float
    left : ndarray, shape (n,), complex
        Relative to the drive's own force, of the size of a line's amplitude.
    floor : ndarray, shape (n,)
        Mean square of noise.
    heard : ndarray of bool, shape (n,)
    """

    drive_hz: float
    bin_hz: float
    left: ComplexArray
    floor: FloatArray
    heard: NDArray[np.bool_]

    def places(self, away_hz: FloatArray) -> NDArray[np.int64]:
        """Bins nearest to frequencies from the drive."""
        return np.asarray(np.clip(np.rint(away_hz / self.bin_hz).astype(int) + self.left.size // 2, 0, self.left.size - 1))

    def power(self, away_hz: FloatArray) -> FloatArray:
        """Over the floor, of noise alone exponential about 1; nan where nothing is heard."""
        k = self.places(away_hz)
        return np.asarray(np.where(self.heard[k], np.abs(self.left[k]) ** 2 / self.floor[k], np.nan))


def find_open_line(recordings: Sequence[Recording], linear: Linear, omega0_rad_s: float, temperature_degc: float) -> OpenLine | None:
    """The line beside open drives of most evidence, if it is one.

    Parameters
    ----------
    recordings : sequence of Recording
    linear : Linear
    omega0_rad_s, temperature_degc : float
        About which its A is told: of what is warmer the free motion stands hertz away.
    """
    found = [_open(r, linear, omega0_rad_s) for r in recordings if _is_open(r, temperature_degc)]
    if len(found) < _FEWEST or len({round(o.drive_hz, 3) for o in found}) < _FEWEST_DRIVES:
        return None
    step = min(o.bin_hz for o in found)
    grid = np.asarray(np.arange(_OWN_BINS * step, _FARTHEST_HZ, 0.5 * step), dtype=np.float64)
    # records, sides, places
    power = np.array([[o.power(grid), o.power(-grid)] for o in found])
    told = np.isfinite(power)
    z = np.where(told, np.maximum(power, 1.0), 1.0)
    evidence = np.sum(z - 1.0 - np.log(z) - _PRICE * told, axis=(0, 1))
    shown = np.any(told & (z > _SHOWN), axis=1)
    enough = shown.sum(axis=0) >= _FEWEST
    for k in np.flatnonzero(enough):
        enough[k] = len({round(o.drive_hz, 3) for o, here in zip(found, shown[:, k], strict=True) if here}) >= _FEWEST_DRIVES
    evidence = np.where(enough, evidence, -math.inf) - math.log(2.0 * grid.size)
    best = int(np.argmax(evidence))
    return _told(found, float(grid[best]), float(evidence[best])) if evidence[best] > _MARGIN else None


def _is_open(r: Recording, temperature_degc: float) -> bool:
    """Whether one drive acts here at one amplitude and frequency, at the temperature of the linear device and off every loop."""
    e = r.command.excitation
    there = r.command.mode == "loops_off" and e.kind == "drive" and e.axis in ("x", "y")
    if not there or r.duration_s < _SHORTEST_S or len(r) < _FEWEST_ROWS:
        return False
    return float(np.abs(smooth_temperature(r) - temperature_degc).max()) < WARMING_K


def _open(r: Recording, linear: Linear, omega0_rad_s: float) -> _Open:
    axis = "xy".index(r.command.excitation.axis)
    drive_rad_s = float(r.ref_omega_rad_s.mean())
    away = 1j * (drive_rad_s - omega0_rad_s) * np.eye(2) - linear.A
    motion = _less_free_motion(r.pick - r.drive @ linear.E.T, away, (r.t - r.t[0]))
    window = steep_window(len(r))
    window = window / window.sum()
    slope = np.gradient(window) * r.sample_rate_hz
    f = np.fft.fftshift(np.fft.fftfreq(len(r), 1.0 / r.sample_rate_hz))
    moved, ends = (np.fft.fftshift(np.fft.fft(w[:, None] * motion, axis=0), axes=0) for w in (window, slope))
    # of w m' the transform is that of (w m)' less that of w' m
    flow = moved @ away.T + 2j * np.pi * f[:, None] * moved - ends
    left = flow[:, axis] / np.mean(r.drive @ linear.G.T, axis=0)[axis]
    bin_hz = 1.0 / r.duration_s
    resonance_hz = float(np.mean(np.imag(np.linalg.eigvals(-away)))) / (2.0 * np.pi)
    heard = (np.abs(f) > _OWN_BINS * bin_hz) & (np.abs(f) < min(_FARTHEST_HZ, _PASSED * r.sample_rate_hz))
    near = np.abs(f - resonance_hz) < _OWN_BINS * bin_hz
    # where the free motion stands in one record, another one's drive at the other side of the resonance would see its image
    heard &= ~near & ~is_image(f, drive_rad_s / (2.0 * np.pi), bin_hz, 0.0, r.sample_rate_hz, _IMAGE_BINS * bin_hz)
    return _Open(drive_rad_s / (2.0 * np.pi), bin_hz, left, _floor(np.abs(left) ** 2, f - resonance_hz, heard | near), heard)


def _less_free_motion(m: ComplexArray, away: ComplexArray, t: FloatArray) -> ComplexArray:
    """Less what stands at the drive, to a slope, and what rings freely, to a millihertz, shape (n, 2) each."""
    rings = np.exp(np.outer(t, np.linalg.eigvals(-away)))
    place = t / t[-1]
    basis = np.stack([np.ones_like(t), place, *rings.T, *(place[:, None] * rings).T], axis=1)
    return np.asarray(m - basis @ np.linalg.lstsq(basis.astype(np.complex128), m, rcond=None)[0])


def _floor(power: FloatArray, away_hz: FloatArray, heard: NDArray[np.bool_]) -> FloatArray:
    """Mean square of noise: white, and as the squared distance from the resonance, times what is there about each bin.

    A few turns of least squares with weights, of which no bin counts for more than a noise of its size makes likely.
    """
    basis = np.stack([np.ones_like(away_hz), away_hz**2], axis=1)
    law = np.full(power.size, float(np.median(power[heard])) / MEDIAN)
    for _ in range(8):
        weight = heard / law**2
        seen = np.minimum(power, 4.0 * law)
        sizes = np.linalg.solve((basis * weight[:, None]).T @ basis, (basis * weight[:, None]).T @ seen)
        if np.any(sizes <= 0.0):
            k = int(np.argmax(sizes))
            sizes = np.where(np.arange(2) == k, float(np.sum(weight * basis[:, k] * seen) / np.sum(weight * basis[:, k] ** 2)), 0.0)
        law = np.maximum(basis @ sizes, 1e-3 * law)
    about = median_filter(power / law, size=2 * _FLOOR_BINS + 1, mode="mirror") / MEDIAN
    return np.asarray(law * about)


def _told(found: Sequence[_Open], frequency_hz: float, evidence: float) -> OpenLine:
    """Its size, the mean square of all side bands less their noise, and whether both sides turn together."""
    frequency_hz, frequency_sd_hz = _between_bins(found, frequency_hz)
    at = np.array([frequency_hz, -frequency_hz])
    left, floor, heard = (np.array([getattr(o, name)[o.places(at)] for o in found]) for name in ("left", "floor", "heard"))
    weights = heard / floor**2 / np.sum(heard / floor**2)
    square = max(float(np.sum(weights * (np.abs(left) ** 2 - floor))), 0.0)
    square_sd = float(np.sqrt(np.sum(weights**2 * floor * (floor + 2.0 * square))))
    # side bands of a gain are each other's conjugates, of a phase less that
    both = np.all(heard, axis=1) / np.prod(floor, axis=1)
    together = float(np.sum(both * np.prod(left, axis=1).real))
    together_sd = math.sqrt(0.5 * float(np.sum(both**2 * np.sum(np.abs(left) ** 2 * floor[:, ::-1], axis=1))))
    share = 2.0 * math.sqrt(square)
    return OpenLine(
        frequency_hz,
        frequency_sd_hz,
        share,
        math.hypot(2.0 * square_sd / max(share, 1e-300), _BETWEEN_BINS * share),
        None if abs(together) < 3.0 * together_sd else together < 0.0,
        evidence,
    )


def _between_bins(found: Sequence[_Open], frequency_hz: float) -> tuple[float, float]:
    """Frequency and its sd [Hz]: mean of the side bands' parabolas through the logarithm of three bins, by what they are over the floor."""
    offs, weights = [], []
    for o in found:
        for side in (1.0, -1.0):
            k = int(o.places(np.array([side * frequency_hz]))[0])
            three = np.log(np.abs(o.left[k - 1 : k + 2]) ** 2)
            bend = float(three[0] - 2.0 * three[1] + three[2])
            if np.all(o.heard[k - 1 : k + 2]) and bend < 0.0:
                bin_hz = side * (k - o.left.size // 2) * o.bin_hz
                offs.append(bin_hz + side * o.bin_hz * float(np.clip(0.5 * (three[0] - three[2]) / bend, -1.0, 1.0)))
                weights.append(float(np.abs(o.left[k]) ** 2 / o.floor[k]))
    bin_hz = max(o.bin_hz for o in found)
    if not weights:
        return frequency_hz, bin_hz
    return float(np.average(offs, weights=weights)), bin_hz * math.hypot(0.6 / math.sqrt(sum(weights)), 0.02)
