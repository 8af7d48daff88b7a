"""Lines that no command asks for: a hum about the carrier, a tone of vibration at a frequency of its own.

A line counts when it stands at one frequency in several records: at the same distance to both sides of the carrier (a hum), or at the same
frequency whatever the reference does (a tone). Its evidence is the sum of ``z - 1 - ln z`` over the records, z its power over the local
floor: the log likelihood ratio of a line of the best size, from which the search over all bins and the sizes are paid. An image of the
carrier or its harmonics by a converter's rate is no tone: every sampled drive has some, and some fall beside the resonance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..recording.recording import Recording
from .faint_lines import shared_line
from .line_frequency import shift_of_line
from .parts import Linear
from .spectra import PickSpectrum, detrended, steep_window

__all__ = ["Tone", "find_tone", "left_on_line"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: power over the floor from which on a bin is a place to look at; how many of a record, at most
_PEAK, _MOST_PEAKS = 12.0, 6
#: log evidence that a line must have beyond the search; what its size costs in each record and axis
_MARGIN, _PRICE = 30.0, 2.0
#: and one that no record shows by itself; the highest of 122 campaigns without one came to 10.7
_FAINT_MARGIN = 13.0
#: power over the floor of a record that holds the line, and how many such records there must be
_SHOWN, _FEWEST = 8.0, 2
#: nearer to the carrier than this the loops mirror a tone, and it is not told from a hum [Hz]
_MIRRORED_HZ = 20.0
#: what a line is read too small by, at most: a wave that turns parts it in two
_PARTED = 0.06
#: a line is the wave's where its power goes with the wave's by so much better than with nothing, if it is another from record to record
_OF_WAVE, _UNLIKE = 0.5, 0.05
#: least power of one side band over the other's for both to be those of a hum
_EVEN = 0.25


@dataclass(frozen=True)
class Tone:
    """A line.

    Parameters
    ----------
    name : str
        ``"mains_pickup"`` or ``"external_tone"``.
    alike : tuple of str
        What these records do not tell it from.
    frequency_hz, frequency_sd_hz : float
        Of the hum about the carrier; of the tone itself.
    volts, volts_sd : ndarray, shape (2,)
        Hum on each pick-off; drive volts that would shake each axis as the tone does.
    log_evidence : float
    share : float
        Amplitude of the line over the wave's.
    of_wave : bool
        Whether it grows with the wave or its drives from record to record: then a gain goes to and fro, and nothing is added.
    """

    name: str
    alike: tuple[str, ...]
    frequency_hz: float
    frequency_sd_hz: float
    volts: FloatArray
    volts_sd: FloatArray
    log_evidence: float
    share: float
    of_wave: bool = False


def find_tone(spectra: Sequence[PickSpectrum], linear: Linear) -> Tone | None:
    """The line of most evidence, if it is one.

    Parameters
    ----------
    spectra : sequence of PickSpectrum
    linear : Linear
        Device by which a tone's force is told from what it moves.
    """
    if len(spectra) < _FEWEST:
        return None
    hypotheses = [
        found
        for spectrum in spectra
        for away in _peaks(spectrum)
        for found in (_gathered(spectra, abs(away), hum=True), _gathered(spectra, spectrum.carrier_hz + away, hum=False))
    ]
    searched = math.log(2.0 * sum(s.frequency_hz.size for s in spectra))
    good = [h for h in hypotheses if h.shown >= _FEWEST and h.evidence > searched + _MARGIN]
    if not good:
        faint = [_Line(hum, *shared_line(spectra, hum=hum), len(spectra)) for hum in (True, False)]
        good = [h for h in faint if h.evidence > searched + _FAINT_MARGIN]
    best = max(good, key=lambda h: h.evidence, default=None)
    return _told(spectra, best, linear, best.evidence - searched) if best is not None else None


@dataclass(frozen=True)
class _Line:
    """A hypothesis with what speaks for it."""

    hum: bool
    frequency_hz: float
    evidence: float
    shown: int


def _peaks(s: PickSpectrum) -> list[float]:
    """Frequencies of the highest bins, one of each group."""
    power = np.where(s.hears(s.frequency_hz), s.ratio.max(axis=1), 0.0)
    found: list[float] = []
    for k in np.argsort(-power)[: 4 * _MOST_PEAKS]:
        f = float(s.frequency_hz[k])
        if power[k] > _PEAK * s.rise[k] and all(abs(f - other) > 6.0 * s.bin_hz for other in found):
            found.append(f)
    return found[:_MOST_PEAKS]


def _gathered(spectra: Sequence[PickSpectrum], frequency_hz: float, *, hum: bool) -> _Line:
    """Of a size of its own in every record and axis."""
    evidence, shown = 0.0, 0
    for s in spectra:
        sides = _sides(s, frequency_hz, hum=hum)
        # an image stands still only at one temperature: at another it passes by lines that have nothing to do with it
        z = s.at(sides[s.hears(sides)]).ravel()
        if z.size:
            evidence += float(np.sum(np.maximum(z - 1.0 - np.log(np.maximum(z, 1.0)), 0.0) - _PRICE))
            shown += bool(z.max() > _SHOWN)
    return _Line(hum, frequency_hz, evidence, shown)


def _sides(s: PickSpectrum, frequency_hz: float, *, hum: bool) -> FloatArray:
    """Where the line stands against the carrier of a record."""
    return np.array([frequency_hz, -frequency_hz] if hum else [frequency_hz - s.carrier_hz])


def _told(spectra: Sequence[PickSpectrum], line: _Line, linear: Linear, evidence: float) -> Tone:
    """Which of the two it is, and how large."""
    used = [s for s in spectra if line.hum or abs(line.frequency_hz - s.carrier_hz) > s.clear_hz]
    places = [line.frequency_hz if line.hum else line.frequency_hz - s.carrier_hz for s in used]
    # over the floor, of which each bin holds one
    upper, lower = (
        np.sum([s.at(np.array([side * f]))[0] - 1.0 for s, f in zip(used, places, strict=True)], axis=0) for side in (1.0, -1.0)
    )
    even = bool(np.min([upper.max(), lower.max()]) > _EVEN * np.max([upper.max(), lower.max()]))
    sign = 1.0 if upper.max() >= lower.max() else -1.0
    farther, frequency_sd = shift_of_line(used, places, (1.0, -1.0) if even else (sign,))
    places = [f + farther for f in places]
    distance = float(np.median(np.abs(places)))
    mirrored = distance < _MIRRORED_HZ
    name = "mains_pickup" if even and (line.hum or not mirrored) else "external_tone"
    other = "external_tone" if name == "mains_pickup" else "mains_pickup"
    hum = name == "mains_pickup"
    sizes = np.array([_volts(s.recording, f, linear, hum=hum) for s, f in zip(used, places, strict=True)])
    # the bin of a faint line holds the floor as well
    beyond = np.maximum(0.5 * (upper + lower) if hum else np.maximum(upper, lower), 0.0)
    volts = np.sqrt(np.mean(sizes**2, axis=0) * beyond / (beyond + len(used)))
    scatter = np.std(sizes**2, axis=0) / math.sqrt(len(used)) + 1e-300
    carrier = float(np.median([s.carrier_hz for s in used]))
    frequency = distance if hum else (line.frequency_hz + farther if not line.hum else carrier + sign * distance)
    return Tone(
        name=name,
        # one line: volts o on the pick-offs and a force L[o] are the same
        alike=((other,) if mirrored and even else ()) + (() if hum else ("pickoff_interference",)),
        frequency_hz=frequency,
        frequency_sd_hz=frequency_sd,
        volts=volts,
        volts_sd=np.hypot(0.5 * scatter / np.sqrt(np.maximum(volts**2, scatter)), _PARTED * volts) + 1e-12,
        log_evidence=evidence,
        share=float(np.median([_share(s.recording, f) for s, f in zip(used, places, strict=True)])),
        of_wave=hum and _goes_with_the_wave(sizes**2, [s.recording for s in used]),
    )


def _goes_with_the_wave(power: FloatArray, recordings: Sequence[Recording]) -> bool:
    """Whether a hum's power, by record and axis, is that of a gain which swings; of volts that are added it is the same in all records."""
    left = float(np.sum((power - power.mean(axis=0)) ** 2))
    if left < _UNLIKE * float(np.sum(power**2)):
        return False
    for of in ("pick", "drive"):
        wave = np.array([np.mean(np.abs(getattr(r, of)) ** 2, axis=0) for r in recordings])
        slope = np.sum(power * wave, axis=0) / np.maximum(np.sum(wave**2, axis=0), 1e-300)
        if float(np.sum((power - slope * wave) ** 2)) < _OF_WAVE * left:
            return True
    return False


def _share(r: Recording, away_hz: float) -> float:
    """Amplitude of the line over the mean amplitude of the wave."""
    window = steep_window(len(r))
    wave = window * np.exp(-2j * np.pi * away_hz * (r.t - r.t[0])) / window.sum()
    return float(np.linalg.norm(wave @ detrended(r.pick)) / np.sqrt(np.mean(np.sum(np.abs(r.pick) ** 2, axis=1))))


def left_on_line(r: Recording, linear: Linear, away_hz: float) -> ComplexArray:
    """What the slow flow does not explain at a distance from the carrier, shape (2,) [V/s]."""
    window = steep_window(len(r))
    wave = window * np.exp(-2j * np.pi * away_hz * (r.t - r.t[0])) / window.sum()
    swinging = 1j * (r.ref_omega_rad_s - r.ref_omega_rad_s.mean())[:, None] * r.pick
    pick, drive, steered = (wave @ detrended(x) for x in (r.pick, r.drive, swinging))
    return np.asarray((2j * np.pi * away_hz * np.eye(2) - linear.A) @ pick + steered - linear.G @ drive)


def _volts(r: Recording, away_hz: float, linear: Linear, *, hum: bool) -> FloatArray:
    """Hum on the pick-offs, or drive volts of the tone: what the slow flow does not explain of the line.

    A phase-locked loop answers the line with the reference, about which all phases are told.
    """
    lines = []
    for f in (away_hz, -away_hz) if hum else (away_hz,):
        flow = 2j * np.pi * f * np.eye(2) - linear.A
        lines.append(np.linalg.solve(flow if hum else linear.G, left_on_line(r, linear, f)))
    # a real hum stands to both sides of the carrier, half of it on each
    return np.asarray(np.sum(np.abs(lines), axis=0))
