"""A tone so near to the carrier that it stands within the signal: a force, or volts on a pick-off, at a frequency of its own.

Nearer than twelve bins, and than sixteen of a side band's frequencies, the spectra of the pick-offs (:mod:`.tones`) hear nothing. What the
linear device leaves of the slow flow does (:mod:`.flow_left`): ``c exp(2 pi i f t)`` with a complex c on each axis, f the tone's frequency
less the reference's. In the frame of a wave at azimuth psi its four channels are the real parts of

    ``(cos psi, -i cos psi, -sin psi, i sin psi) c_x e^{...} + (sin psi, -i sin psi, cos psi, -i cos psi) c_y e^{...}``

and noise is another in each: a resonance wanders in frequency, not in amplitude. Below what tells a floor nothing is heard: where images
covered all but 0.2 of the lowest 4 Hz, that wander was a tone of 473 in log evidence. Phases are free in every record, for nobody counts
the cycles of the reference between two of them. What goes to and fro (:mod:`.swings`) stands at ``-f`` as well, a tone at one of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .evidence import CHANNELS, CampaignEvidence, RecordingEvidence
from .flow_left import FlowLeft
from .parts import Linear
from .steady_swings import besides, floors_of
from .swings import HIGHEST_HZ, SHORTEST_S, is_imaged, kinds_of
from .tones import Tone

__all__ = ["find_near_tone", "heard_on_lines"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: fewest records; distance of the frequencies that are tried, in bins of the longest record; in each bin, those of its transform
_FEWEST, _STEP_BINS, _FINE = 4, 0.25, 8
#: log evidence beyond the search from which on it is a tone (of campaigns without one the highest came to 0.4); what may stand at the other
#: side of the carrier, over it
_MARGIN, _ONE_SIDED = 10.0, 0.25
#: bins about the carrier, harmonics of a side band and of a wave's turning, and bins about these, that belong to the signal
_LEAST_BINS, _OF_SIDE_BAND, _OF_TURNING, _SKIRT_BINS = 2.5, 5, 8, 2.5
#: share of the rows' rate within which their filter leaves a line; bins to both sides whose median a line must stand over, and how many
#: of them must be heard
_PASSED, _ABOUT_BINS, _FEWEST_ABOUT = 0.45, (3.0, 12.0), 2
#: bins beyond the last line of a record from which on a tone is not heard on it
_LEAKS_BINS = 4.0
#: variance of a frequency that a record with a Hann window tells, over that of one without
_WINDOWED = 1.5


def heard_on_lines(evidence: CampaignEvidence, frequency_hz: float) -> tuple[int, ...]:
    """Recordings, by index, on whose lines of the slow flow a tone leaks; none where it does on most, which are then all there is to ask.

    Of a hemisphere a tone 1.70 Hz from the resonance left 90 in chi-square on one record of 12 s whose lines reach to 1.5 Hz, and something
    that happened at its end was found (plant 33).

    Parameters
    ----------
    evidence : CampaignEvidence
    frequency_hz : float
        Of the tone.
    """
    waves = [r for r in evidence if r.is_wave]
    near = [
        r.index
        for r in waves
        if _beat_hz(r, frequency_hz) < float(r.lines("amplitude").frequency_hz.max()) + _LEAKS_BINS / r.recording.duration_s
    ]
    return tuple(near) if 2 * len(near) <= len(waves) else ()


def _beat_hz(r: RecordingEvidence, frequency_hz: float) -> float:
    """How fast a tone goes to and fro in the frame of a wave, which turns as well, at least."""
    turning_hz = abs(r.signal.turn_rad) / (2.0 * np.pi * r.recording.duration_s)
    return abs(float(r.signals.omega_rad_s.mean()) / (2.0 * np.pi) - frequency_hz) - turning_hz


@dataclass(frozen=True)
class _Heard:
    """What one record says of ``c`` at every frequency.

    Parameters
    ----------
    score : ndarray, shape (2, frequencies), complex
        Information times c, and noise.
    information : ndarray, shape (2, 2, frequencies)
    mirror : ndarray, shape (2, 2, frequencies), complex
        What of the conjugate c is in the score at the other side of the carrier: what its channels do not hear alike.
    alone : ndarray, shape (4, frequencies)
        Power of each channel by itself, over that of noise: of noise alone an exponential variable of mean 1.
    noise : float
        The score's covariance over its information.
    there : ndarray of bool, shape (frequencies,)
        Where a tone would be heard.
    """

    score: ComplexArray
    information: FloatArray
    mirror: ComplexArray
    alone: FloatArray
    noise: float
    there: NDArray[np.bool_]

    def c(self) -> ComplexArray:
        """The likeliest c [1/s], shape (frequencies, 2)."""
        return _solved(self.information, np.asarray(self.score.T))

    def power(self) -> FloatArray:
        """Over that of noise: of noise alone a sum of two exponential variables of mean 1."""
        return np.asarray(np.sum(self.score.T.conj() * self.c(), axis=1).real / self.noise)

    def mirrored(self) -> FloatArray:
        """Power that c makes at the other side of the carrier, over that of noise."""
        score = np.einsum("jkf,fk->fj", self.mirror, self.c().conj())
        return np.asarray(np.einsum("fj,fj->f", score.conj(), _solved(self.information, score)).real / self.noise)


def find_near_tone(flows: Sequence[FlowLeft], linear: Linear) -> Tone | None:
    """The tone of most evidence, if it is one.

    Parameters
    ----------
    flows : sequence of FlowLeft
    linear : Linear
        By whose drives its force is told in volts.
    """
    floors = _floors([flow for flow in flows if flow.duration_s >= SHORTEST_S and flow.amplitude_v > 0.0])
    if len(floors) < _FEWEST:
        return None
    longest_s = max(flow.duration_s for flow, _ in floors)
    carrier_hz = float(np.median([flow.carrier_hz for flow, _ in floors]))
    step = _STEP_BINS / longest_s
    count = math.floor(HIGHEST_HZ / step)
    grid = np.asarray(step * np.arange(-count, count + 1), dtype=np.float64)
    heard = [_heard(flow, grid - (flow.carrier_hz - carrier_hz), floor) for flow, floor in floors]
    evidence, ratio, rise = _evidence(_mean_of([h.power() for h in heard], heard, 2.0), longest_s)
    best = int(np.argmax(evidence))
    about = slice(max(best - round(1.0 / _STEP_BINS), 0), best + round(1.0 / _STEP_BINS) + 1)
    # where one of two channels is by far the quieter, a tone stands at both sides as well
    own = _mean_of([h.mirrored() for h in heard], heard, 2.0)[0][best] / rise[best]
    two_sided = float(ratio[::-1][about].max()) - 1.0 - float(own) > _ONE_SIDED * (float(ratio[best]) - 1.0)
    # and what goes to and fro in one channel alone takes as much with half the unknowns
    alone = max(
        float(_evidence(_mean_of([h.alone[k] for h in heard], heard, 1.0), longest_s)[0][about].max()) for k in range(len(CHANNELS))
    )
    if two_sided or evidence[best] - max(alone, 0.0) <= _MARGIN:
        return None
    return _told([flow for flow, _ in floors], heard, best, carrier_hz + float(grid[best]), float(evidence[best]), linear)


def _evidence(mean_of: tuple[FloatArray, FloatArray], longest_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Log evidence beyond the search, of a mean power and of how many variables it is; the mean over what it rises from, and that."""
    mean, n = mean_of
    rise = _about(mean, round(1.0 / _STEP_BINS))
    ratio = np.where(n > 0, mean / rise, 0.0)
    # of a gamma variable of n the likeliest other scale
    beyond = np.where(ratio > 1.0, n * (ratio - 1.0 - np.log(np.maximum(ratio, 1.0))), 0.0)
    return np.asarray(beyond - math.log(2.0 * HIGHEST_HZ * longest_s)), ratio, rise


def _solved(information: FloatArray, score: ComplexArray) -> ComplexArray:
    """Shape (frequencies, 2)."""
    return np.asarray(np.linalg.solve(information.transpose(2, 0, 1), score[:, :, None])[:, :, 0])


def _floors(flows: Sequence[FlowLeft]) -> list[tuple[FlowLeft, tuple[FloatArray, FloatArray]]]:
    """Records that tell the floors of all channels, with floors at these frequencies, shape (4, k): infinite below all that tells."""
    places = np.geomspace(1.0 / 64.0, 2.0 * HIGHEST_HZ, 400)
    of: dict[int, list[FloatArray]] = {id(flow): [] for flow in flows}
    for channel in CHANNELS:
        kinds = kinds_of(flows, channel)
        members = [(flow, kind.lowest_hz) for kind in kinds for flow in kind.flows]
        for (flow, lowest_hz), floor in zip(members, floors_of(kinds, places) if members else (), strict=True):
            of[id(flow)].append(np.where(places > lowest_hz, floor, np.inf))
    return [(flow, (places, np.array(of[id(flow)]))) for flow in flows if len(of[id(flow)]) == len(CHANNELS)]


def _heard(flow: FlowLeft, away_hz: FloatArray, floor: tuple[FloatArray, FloatArray]) -> _Heard:
    """Of a record at distances from its reference."""
    n = len(flow.azimuth_rad)
    window = np.hanning(n + 2)[1:-1]
    aside = besides(flow, window)
    cos, sin = np.cos(flow.azimuth_rad), np.sin(flow.azimuth_rad)
    shapes = ((cos, sin), (-1j * cos, -1j * sin), (-sin, cos), (1j * sin, -1j * cos))
    places = np.rint(away_hz * _FINE * n * flow.row_s).astype(int)
    score, information = np.zeros((2, away_hz.size), dtype=np.complex128), np.zeros((2, 2, away_hz.size))
    mirror = np.zeros((2, 2, away_hz.size), dtype=np.complex128)
    alone, noise = [], 2.0 * float(np.sum(window**2) / window.sum()) / flow.row_s
    told = _there(flow, np.abs(away_hz))
    for channel, shape, of_channel in zip(CHANNELS, shapes, floor[1], strict=True):
        x = flow.rate[channel]
        left = window * (x - aside @ (aside.T @ (window * x)))
        weight = np.interp(np.abs(away_hz), floor[0], 1.0 / np.maximum(of_channel, 1e-300))
        told &= weight > 0.0
        alone.append(2.0 * weight * np.abs(np.fft.fft(left, _FINE * n)[places]) ** 2 / (window.sum() * noise))
        for j in range(2):
            score[j] += weight * np.fft.fft(left * np.conj(shape[j]), _FINE * n)[places]
            for k in range(2):
                information[j, k] += 0.5 * weight * float(np.sum(window * (shape[j] * np.conj(shape[k])).real))
                mirror[j, k] += 0.5 * weight * complex(np.sum(window * np.conj(shape[j] * shape[k])))
    # a wave that never leaves an axis tells as little of the other one as of nothing
    information += (1e-9 * np.trace(information) + 1e-300) * np.eye(2)[:, :, None]
    return _Heard(score, information, mirror, np.array(alone), noise, told)


def _there(flow: FlowLeft, distance_hz: FloatArray) -> NDArray[np.bool_]:
    """Where neither the carrier nor a side band, the wave's turning nor an image stands."""
    bin_hz = 1.0 / flow.duration_s
    there = (distance_hz > _LEAST_BINS * bin_hz) & (distance_hz < _PASSED / flow.row_s)
    there &= ~is_imaged(flow, distance_hz, _SKIRT_BINS * bin_hz)
    for frequency_hz, harmonics in ((flow.excited_hz, _OF_SIDE_BAND), (0.0 if flow.is_still else flow.turning_hz, _OF_TURNING)):
        for k in range(1, harmonics + 1) if frequency_hz > 0.0 else ():
            there &= np.abs(distance_hz - k * frequency_hz) > _SKIRT_BINS * bin_hz
    return np.asarray(there)


def _mean_of(powers: Sequence[FloatArray], heard: Sequence[_Heard], variables: float) -> tuple[FloatArray, FloatArray]:
    """Mean of what the records say, so many exponential variables each, the loudest of them left out; and of how many variables it is.

    Of none where too few hear it.
    """
    each = np.array([np.where(h.there, power, 0.0) for h, power in zip(heard, powers, strict=True)])
    records = np.sum([h.there for h in heard], axis=0)
    n = np.where(records >= _FEWEST, variables * (records - 1), 0.0)
    return (each.sum(axis=0) - each.max(axis=0)) / np.maximum(n, 1.0), n


def _about(mean: FloatArray, bin_places: int) -> FloatArray:
    """Median of what is heard to both sides of each frequency, 1 at least: floors that are higher there than their law.

    Where neither says anything a rise is not known, and a line stands over nothing.
    """
    nearest, farthest = (round(b * bin_places) for b in _ABOUT_BINS)
    padded = np.pad(np.where(mean > 0.0, mean, np.nan), farthest, constant_values=np.nan)
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * farthest + 1)
    around = around[:, np.abs(np.arange(-farthest, farthest + 1)) >= nearest]
    fewest = _FEWEST_ABOUT * bin_places
    told = np.isfinite(around)
    median = np.array([float(np.median(w[ok])) if ok.sum() >= fewest else math.inf for w, ok in zip(around, told, strict=True)])
    return np.maximum(median, 1.0)


def _told(flows: Sequence[FlowLeft], heard: Sequence[_Heard], best: int, frequency_hz: float, evidence: float, linear: Linear) -> Tone:
    """In volts of the drives, as the mean square of all records has it less their noise."""
    to_drive = np.linalg.inv(linear.G)
    squares, noises, shares, weight = np.zeros(2), np.zeros(2), [], 0.0
    told = [(flow, h) for flow, h in zip(flows, heard, strict=True) if h.there[best]]
    for flow, h in told:
        amplitude_v = flow.amplitude_v
        c = amplitude_v * h.c()[best]
        covariance = h.noise * amplitude_v**2 * np.linalg.inv(h.information[:, :, best])
        own = float(np.trace(h.information[:, :, best])) / (h.noise * amplitude_v**2)
        squares += own * np.abs(to_drive @ c) ** 2
        noises += own * np.einsum("jk,kl,jl->j", to_drive, covariance, to_drive.conj()).real
        shares.append(float(np.linalg.norm(c)) / (2.0 * math.pi * abs(frequency_hz - flow.carrier_hz) * amplitude_v))
        weight += own
    volts = np.sqrt(np.maximum(squares - noises, 0.0) / weight)
    power = sum(float(h.power()[best]) for _, h in told)
    longest_s = max(flow.duration_s for flow in flows)
    frequency_sd_hz = math.hypot(math.sqrt(6.0 * _WINDOWED / power) / (2.0 * math.pi * longest_s), 0.3 * _STEP_BINS / longest_s)
    return Tone(
        name="external_tone",
        # a force, or volts that are added: both go round with the tone
        alike=("pickoff_interference",),
        frequency_hz=frequency_hz,
        frequency_sd_hz=frequency_sd_hz,
        volts=volts,
        volts_sd=np.sqrt(noises / weight / (2.0 * len(told))) + 1e-12,
        log_evidence=evidence,
        share=float(np.median(shares)),
    )
