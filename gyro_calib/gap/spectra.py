"""Spectra of the pick-offs of plain records over their own floor: where effects show that leave no mean and no side band.

A hum, a tone of vibration and a noisy gain average to nothing on the lines that the equations are projected on. They stand in the spectrum:
as lines that no command asks for (:mod:`.tones`), or as a floor that grows with the amplitude (:mod:`.noise_growth`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from ..estimation.wave import wave_coordinates
from ..recording.applied_rate import is_turned
from ..recording.recording import Recording
from .signals import WARMING_K, smooth_temperature

__all__ = [
    "MEDIAN",
    "RATES_HZ",
    "PickSpectrum",
    "detrended",
    "is_image",
    "is_plain",
    "near_line",
    "pick_spectra",
    "plain_records",
    "steep_window",
    "turns_of",
]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: bins on which the floor's median is taken, to both sides; its ratio to the mean of an exponential distribution
_FLOOR_BINS, MEDIAN = 30, float(np.log(2.0))
#: bins about the carrier, and harmonics of a side band or of the wave's turning, that hold signal; nearer by a main lobe there is a place
#: to see the floor rise
_LEAST_BINS, _HARMONICS = 12.0, 16.0
#: bins from a tone within which an open drive shares its signal
_NEAR_BINS = 30.0
#: power of a Hann window whose side lobes fall below the floor within those bins: a turning wave of a volt stands beside nanovolts
_POWER = 3
#: half its main lobe
_LOBE_BINS = 4
_SHORTEST_S = 4.0
#: power over the floor down to which the skirt of something nearer to the carrier is followed
_SKIRT_POWER = 4.0
#: rates of converters are multiples of this [Hz]; harmonics of the carrier whose images are known; how near is the same [Hz], and [bins],
#: of which the window's main lobe has four
RATES_HZ, _IMAGED, _SAME_HZ, _SKIRT_BINS = 100.0, 5, 0.15, 5.0
#: side bands of the carrier whose mirrors are known, in frequencies of its modulation or of its turning
_MIRRORED = 2
#: share of the rows' rate within which the rows' own filter leaves a line
_PASSED = 0.45


@dataclass(frozen=True)
class PickSpectrum:
    """Spectrum of one record.

    Parameters
    ----------
    recording : Recording
    frequency_hz : ndarray, shape (n,)
        From the carrier, in order.
    ratio : ndarray, shape (n, 2)
        Power of x and y over the local floor; exponentially distributed about 1 where there is noise alone.
    clear_hz : float
        What is nearer to the carrier belongs to the signal.
    carrier_hz : float
        Mean frequency of the reference.
    busy_hz : float
        Of the side band, or of the turning of the wave.
    rise : ndarray, shape (n,)
        Power over the local floor that a line must exceed, 1 at least: of a floor that rises towards the carrier.
    """

    recording: Recording
    frequency_hz: FloatArray
    ratio: FloatArray
    clear_hz: float
    carrier_hz: float
    busy_hz: float
    rise: FloatArray

    @property
    def bin_hz(self) -> float:
        """Distance of two bins."""
        return 1.0 / self.recording.duration_s

    def at(self, away_hz: FloatArray) -> FloatArray:
        """Power over the floor and its rise of both axes at the bins nearest to distances from the carrier, shape (m,) -> (m, 2)."""
        places = np.round(away_hz / self.bin_hz).astype(int) + self.frequency_hz.size // 2
        places = np.clip(places, 0, len(self.ratio) - 1)
        return np.asarray(self.ratio[places] / self.rise[places, None])

    def hears(self, away_hz: FloatArray) -> NDArray[np.bool_]:
        """Whether a line there would be seen: beyond what belongs to the signal, within the rows' rate, and no image."""
        within = (np.abs(away_hz) > self.clear_hz) & (np.abs(away_hz) < _PASSED * self.recording.sample_rate_hz)
        return np.asarray(within & ~is_image(away_hz, self.carrier_hz, self.bin_hz, self.busy_hz, self.recording.sample_rate_hz))


def is_image(
    away_hz: FloatArray, carrier_hz: float, bin_hz: float, busy_hz: float = 0.0, row_hz: float = RATES_HZ, skirt_hz: float = 0.0
) -> NDArray[np.bool_]:
    """Whether lines at these distances are a harmonic of the carrier folded at a converter's rate, or stand on the skirt of one.

    ``skirt_hz``: half its width, where it is not that of a spectrum of so many bins.

    Of its mirror, the image of the conjugate, what is modulated or turns shows more than what stands (`images.py`): side bands without a
    carrier, 1.5 Hz from where that would be, and folded at the rows' rate again.
    """
    near = skirt_hz or max(_SAME_HZ, _SKIRT_BINS * bin_hz)
    found = np.zeros(away_hz.shape, dtype=bool)
    folded_hz = math.gcd(round(RATES_HZ), round(row_hz)) if row_hz == round(row_hz) else RATES_HZ
    for k in range(-_IMAGED, _IMAGED + 1):
        if k != 1:
            mirrored = k == -1 and busy_hz > 0.0
            for n in range(-_MIRRORED, _MIRRORED + 1) if mirrored else (0,):
                rate_hz = folded_hz if mirrored and n else RATES_HZ
                places = (away_hz + (1.0 - k) * carrier_hz + n * busy_hz) / rate_hz
                found |= np.abs(places - np.rint(places)) * rate_hz < near
    return found


def plain_records(recordings: Sequence[Recording]) -> list[Recording]:
    """Records whose loops hold a wave that nothing but a side band moves."""
    return [r for r in recordings if is_plain(r)]


def is_plain(r: Recording) -> bool:
    """Whether loops hold a wave here that nothing but a side band moves, at one temperature and at rest."""
    held = r.command.mode.startswith("ftr") or r.command.mode == "whole_angle"
    steady = not is_turned(r) and float(np.ptp(smooth_temperature(r))) < WARMING_K
    return held and steady and r.duration_s >= _SHORTEST_S and r.command.excitation.kind in ("none", "amplitude_modulation")


def pick_spectra(recordings: Sequence[Recording]) -> list[PickSpectrum]:
    """Spectra of the plain records."""
    return _above_the_rise([_spectrum(r) for r in plain_records(recordings)])


def _above_the_rise(spectra: list[PickSpectrum]) -> list[PickSpectrum]:
    """Near the carrier a floor of slow gains rises faster than its median follows: a line stands above what both sides of it hold as well.

    What the records of a campaign hold there on average, both axes and both sides of the carrier, nearer by just more than the window's
    main lobe and as much farther.
    """
    if not spectra:
        return spectra
    step = min(s.bin_hz for s in spectra)
    away = np.arange(0.0, 2.0 * _FLOOR_BINS * max(s.bin_hz for s in spectra), step)
    # of a record only what lies outside its carrier's own main lobe and its signal's harmonics
    heard = np.array([away > max((_LOBE_BINS + 0.5) * s.bin_hz, _HARMONICS * s.busy_hz) for s in spectra])
    held = np.array([0.5 * (s.at(away) + s.at(-away)).mean(axis=1) for s in spectra])
    mean = np.sum(heard * held, axis=0) / np.maximum(heard.sum(axis=0), 1)
    return [replace(s, rise=_rise(np.abs(s.frequency_hz), s.bin_hz, away, mean)) for s in spectra]


def _rise(away_hz: FloatArray, bin_hz: float, places_hz: FloatArray, mean: FloatArray) -> FloatArray:
    """Power over the floor at these distances from the carrier as what is nearer and farther has it, 1 at least."""
    lobe = (_LOBE_BINS + np.arange(3)) * bin_hz
    nearer, farther = (np.mean([np.interp(away_hz + side * d, places_hz, mean) for d in lobe], axis=0) for side in (-1.0, 1.0))
    return np.where(away_hz < _FLOOR_BINS * bin_hz, np.maximum(np.sqrt(nearer * farther), 1.0), 1.0)


def near_line(recordings: Sequence[Recording], frequency_hz: float) -> tuple[int, ...]:
    """Places of recordings of whose signal a line may be taken for a part: an open drive may stand beside it."""
    away = [abs(float(r.ref_omega_rad_s.mean()) / (2.0 * np.pi) - frequency_hz) for r in recordings]
    return tuple(k for k, (r, hz) in enumerate(zip(recordings, away, strict=True)) if hz < _NEAR_BINS / r.duration_s)


def _spectrum(r: Recording) -> PickSpectrum:
    x = detrended(r.pick)
    power = np.abs(np.fft.fftshift(np.fft.fft(x * steep_window(len(r))[:, None], axis=0), axes=0)) ** 2
    # a running median of one row of numbers is what scipy has a fast way for
    floor = np.stack([median_filter(of_axis, size=2 * _FLOOR_BINS + 1, mode="wrap") for of_axis in power.T.copy()], axis=1) / MEDIAN
    frequency = np.fft.fftshift(np.fft.fftfreq(len(r), 1.0 / r.sample_rate_hz))
    turning = turns_of(r) / r.duration_s
    busy = max(turning, r.command.excitation.frequency_hz if r.command.excitation.kind != "none" else 0.0)
    clear = max(_LEAST_BINS / r.duration_s, _HARMONICS * busy)
    ratio = power / floor
    beyond = _beyond_skirt(ratio.max(axis=1), clear, 1.0 / r.duration_s)
    return PickSpectrum(r, frequency, ratio, beyond, float(r.ref_omega_rad_s.mean()) / (2.0 * np.pi), busy, np.ones(len(r)))


def _beyond_skirt(ratio: FloatArray, clear_hz: float, bin_hz: float) -> float:
    """Where the skirt ends [Hz] of what stands within the carrier's own bins, in power over the floor, shape (n,): no line of its own."""
    middle, inner = ratio.size // 2, math.floor(clear_hz / bin_hz)
    if inner >= middle:
        return clear_hz
    ends = []
    for side in (ratio[middle + inner :], ratio[middle - inner :: -1]):
        falls = (side[:-1] > _SKIRT_POWER) & (side[1:] < side[:-1])
        ends.append(int(np.argmin(np.append(falls, False))))
    return max(clear_hz, (inner + max(ends) + 0.5) * bin_hz if max(ends) else 0.0)


def turns_of(r: Recording) -> float:
    """How often the wave of a recording turned, its first row to its last."""
    azimuth = wave_coordinates(r).azimuth_rad
    return abs(float(azimuth[-1] - azimuth[0])) / (2.0 * np.pi)


def steep_window(count: int) -> FloatArray:
    """Window of low side lobes."""
    return np.asarray(np.hanning(count) ** _POWER)


def detrended(x: ComplexArray) -> ComplexArray:
    """Less a parabola in time, each column by itself."""
    place = np.linspace(-1.0, 1.0, len(x))
    basis = np.stack([np.ones_like(place), place, place**2], axis=1)
    return np.asarray(x - basis @ np.linalg.lstsq(basis.astype(np.complex128), x, rcond=None)[0])
