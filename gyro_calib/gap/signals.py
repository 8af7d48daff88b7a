"""One recording, thinned and seen from its wave: where the envelope form of every effect is evaluated and projected.

The base of the fit (pick-offs, drives) is projected from full-rate products (:mod:`..estimation.wave_projection`). An effect is a small
correction: it is enough to form it from the thinned signals, so that fifty of them cost little.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from ..estimation.projection import moving_reference, test_functions
from ..estimation.wave import wave_coordinates
from ..estimation.wave_projection import frame_directions, spectral_derivatives, thin
from ..recording.applied_rate import applied_rate
from ..recording.recording import Recording

__all__ = [
    "SMOOTH_S",
    "WARMING_K",
    "Signals",
    "held_readings",
    "smooth_reading",
    "smooth_temperature",
    "with_pick",
    "with_temperature",
]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Made = TypeVar("Made")

#: temperature span of a recording from which on its temperature moved [K]; over how long a sensor is smoothed then [s]
WARMING_K, SMOOTH_S = 0.3, 0.4
#: a reading is held while it changes by less than this share of its largest change, for so long [s], so often, and most of the time
_HELD_SHARE, _HELD_S, _FEWEST_HELD, _HELD_MOST = 0.02, 0.15, 4, 0.5
#: over how long a reference is smoothed, which follows the resonance [s]; correlation with the temperature from which on it does
_CORNER_S, _FOLLOWS = 0.1, 0.99


def smooth_temperature(recording: Recording) -> FloatArray:
    """Temperature of every row without the noise of its sensor, which would be in the frequency: a straight line, or where the temperature
    moved a running mean. Its corners, which that rounds, are those of a reference that follows the resonance, if there is one.
    """
    running = smooth_reading(recording)
    if np.ptp(running) <= WARMING_K:
        return running
    reference = _of_the_resonance(recording, running)
    # as the sensor reads: corners between two readings are those of the reference, too
    slow = _running_mean(_through(held_readings(recording), reference), SMOOTH_S * recording.sample_rate_hz)
    warm = running - running.mean()
    follows = np.ptp(slow) > 0.0 and abs(np.corrcoef(warm, slow)[0, 1]) > _FOLLOWS
    if recording.command.mode == "loops_off" or not follows:
        return np.asarray(running)
    kelvin = float(warm @ warm) / float(warm @ slow)
    return np.asarray(running + kelvin * (_running_mean(reference, _CORNER_S * recording.sample_rate_hz) - slow))


def _of_the_resonance(recording: Recording, reading: FloatArray) -> FloatArray:
    """The reference less its mean, and less what a split makes of it as the wave turns: read once a second that was 40 mK of a ring."""
    reference = recording.ref_omega_rad_s - recording.ref_omega_rad_s.mean()
    if recording.command.mode != "whole_angle":
        return reference
    azimuth = wave_coordinates(recording).azimuth_rad
    if np.ptp(azimuth) < np.pi:
        return reference
    split = np.stack([np.cos(2.0 * azimuth), np.sin(2.0 * azimuth)], axis=1)
    together = np.column_stack([np.ones_like(reading), reading - reading.mean(), split])
    return np.asarray(reference - split @ np.linalg.lstsq(together, reference, rcond=None)[0][2:])


def smooth_reading(recording: Recording) -> FloatArray:
    """What the sensor alone says of every row: late by its own lag at every corner, as a reference is not."""
    raw, n = _through(held_readings(recording), recording.temperature_degc), len(recording)
    place = np.linspace(-1.0, 1.0, n)
    running = _running_mean(raw, SMOOTH_S * recording.sample_rate_hz)
    if np.ptp(running) > WARMING_K:
        return running
    return np.asarray(raw.mean() + place * float(place @ raw) / float(place @ place))


def held_readings(recording: Recording) -> NDArray[np.intp]:
    """Rows at which a sensor was read that is read more rarely than rows are written, each reading held until the next; or none.

    Steps of a second while it is warmed are no steps of the resonator: of a healthy ring's amplitude they were 550 000 times the noise.
    """
    raw = recording.temperature_degc
    change = np.abs(np.diff(raw))
    still = np.concatenate([[False], change <= _HELD_SHARE * change.max(initial=0.0), [False]])
    edges = np.flatnonzero(np.diff(still.astype(int)))
    first, last = edges[::2], edges[1::2]
    held = last - first > _HELD_S * recording.sample_rate_hz
    first, last = first[held], last[held]
    if len(first) < _FEWEST_HELD or np.sum(last - first) < _HELD_MOST * len(raw):
        return np.array([], dtype=np.intp)
    period = float(np.median(np.diff(first)))
    # one that stays for longer was read again meanwhile, and was the same
    again = np.round(last[last - first > 1.5 * period] + 1 - period).astype(int)
    rows = np.unique(np.concatenate([first, again, last[-1:]]))
    return np.asarray(rows[(rows >= 0) & (rows < len(raw))])


def _through(rows: NDArray[np.intp], x: FloatArray) -> FloatArray:
    """Straight lines between those rows; everything as it is where there are none."""
    return np.asarray(np.interp(np.arange(len(x)), rows, x[rows])) if len(rows) else x


def _running_mean(x: FloatArray, rows: float) -> FloatArray:
    """Over about so many rows, centred; at the ends a straight line through as many: a mirror bends what goes on or comes to rest."""
    width = 2 * (min(round(rows), len(x) // 4) // 2) + 1
    half, place = width // 2, np.arange(width) - width // 2
    total = np.cumsum(np.concatenate([[0.0], x]))
    out = np.empty(len(x))
    out[half : len(x) - half] = (total[width:] - total[:-width]) / width
    spread = max(float(place @ place), 1.0)
    for first, kept, into in ((0, slice(0, half), slice(0, half)), (len(x) - width, slice(half + 1, width), slice(len(x) - half, len(x)))):
        block = x[first : first + width]
        out[into] = (block.mean() + place * float(place @ block) / spread)[kept]
    return out


@dataclass(frozen=True)
class Signals:
    """Thinned signals of a recording with the frame that they are projected in.

    Parameters
    ----------
    recording : Recording
    omega0_rad_s, decay_rate : float
        As in :class:`..estimation.wave_projection.Products`.
    width : int
        Rows per thinned row.
    temperature_degc : float
        Temperature that ``temperature_k`` is counted from.
    start_s : float
        Device time that ``time_s`` is counted from.
    index : int
        Place of the recording in its campaign.
    before : Signals or None
        Of the recording that came before.
    """

    recording: Recording
    omega0_rad_s: float
    decay_rate: float
    width: int
    temperature_degc: float
    start_s: float
    index: int = 0
    before: Signals | None = field(default=None, repr=False, compare=False)

    @cached_property
    def _known(self) -> dict[Hashable, tuple[Any, Any]]:
        return {}

    def once(self, key: Hashable, of: object, make: Callable[[], Made]) -> Made:
        """What many forms need of these signals, made once: ``key`` says what, ``of`` the object besides the signals that it depends on."""
        if key not in self._known or self._known[key][0] is not of:
            self._known[key] = (of, make())
        made: Made = self._known[key][1]
        return made

    @cached_property
    def row_s(self) -> float:
        """Time of a thinned row [s]."""
        return self.width / self.recording.sample_rate_hz

    @cached_property
    def pick(self) -> ComplexArray:
        """V, shape (n, 2) [V]."""
        return np.asarray(thin(self.recording.pick, self.width))

    @cached_property
    def drive(self) -> ComplexArray:
        """u, shape (n, 2) [V]."""
        return np.asarray(thin(self.recording.drive, self.width))

    @cached_property
    def omega_rad_s(self) -> FloatArray:
        """Reference frequency, shape (n,)."""
        return np.asarray(thin(self.recording.ref_omega_rad_s, self.width))

    @cached_property
    def detuning_rad_s(self) -> FloatArray:
        """How far the reference is from ``omega0`` as the slow flow counts it, ``(omega^2 - omega0^2) / 2 omega0``, shape (n,).

        Of a hemisphere that is warmed by 8 K it is 8 mrad/s more than the difference: with 2 V of drive and E = 2e-4 that is 3e-6 rad/s.
        """
        return np.asarray((self.omega_rad_s**2 - self.omega0_rad_s**2) / (2.0 * self.omega0_rad_s))

    @cached_property
    def _shift(self) -> ComplexArray:
        """What multiplies x in L[x] while the reference stands still [rad/s], shape (n,)."""
        slow = (self.omega_rad_s - self.omega0_rad_s) / (2.0 * self.omega0_rad_s)
        return np.asarray(1j * self.detuning_rad_s + 2.0 * self.decay_rate * slow)

    def speed_of(self, x: ComplexArray) -> ComplexArray:
        """L[x] row by row [of x per second], shape (n, 2) as x, its second derivative left out: of a motion it is ``A x + G u``."""
        stretch, creep = moving_reference(self.omega_rad_s, self.row_s, self.omega0_rad_s)
        change = stretch[:, None] * np.gradient(x, self.row_s, axis=0)
        return np.asarray(change + (self._shift + creep)[:, None] * x)

    @cached_property
    def time_s(self) -> FloatArray:
        """Device time since the start of the campaign, shape (n,)."""
        return np.asarray(thin(self.recording.t, self.width)) - self.start_s

    @cached_property
    def temperature_k(self) -> FloatArray:
        """Temperature above the one that the campaign is referred to, shape (n,)."""
        return np.asarray(thin(smooth_temperature(self.recording), self.width)) - self.temperature_degc

    @cached_property
    def reading_k(self) -> FloatArray:
        """The same as its sensor alone tells it [K], shape (n,)."""
        return np.asarray(thin(smooth_reading(self.recording), self.width)) - self.temperature_degc

    @cached_property
    def rate_rad_s(self) -> FloatArray:
        """Applied rate, shape (n,)."""
        return np.asarray(thin(applied_rate(self.recording)[0], self.width))

    @cached_property
    def is_warming(self) -> bool:
        """Whether the recording's temperature moved, whatever these signals have in its place."""
        return bool(np.ptp(smooth_temperature(self.recording)) > WARMING_K)

    @cached_property
    def _frame(self) -> tuple[tuple[NDArray[Any], NDArray[Any], NDArray[Any]], ...]:
        directions, _ = frame_directions(self.recording, in_phase=self.is_warming)
        return tuple(
            (np.asarray(thin(d.m, self.width)), np.asarray(thin(d.m1, self.width)), np.asarray(thin(d.m2, self.width))) for d in directions
        )

    def projector(self, lines_hz: Sequence[float]) -> Projector:
        """Projection on these lines."""
        f = test_functions(np.asarray(thin(self.recording.t, self.width)), self.row_s, list(lines_hz))
        first, second = spectral_derivatives(f.value, self.row_s)
        return Projector(self, f.frequency_hz, f.value, first, second)


def with_pick(signals: Signals, pick: ComplexArray) -> Signals:
    """The same signals with other pick-off volts."""
    return _with(signals, "pick", pick)


def with_temperature(signals: Signals, temperature_k: float | FloatArray) -> Signals:
    """The same signals at another temperature, row by row or one that stands still."""
    return _with(signals, "temperature_k", np.broadcast_to(temperature_k, signals.time_s.shape))


def _with(signals: Signals, name: str, value: object) -> Signals:
    other = replace(signals)
    other.__dict__.update({key: known for key, known in signals.__dict__.items() if key != "_known"} | {name: value})
    return other


@dataclass(frozen=True)
class Projector:
    """Projects k signals of shape (n, 2) to equations (2 m, k): along the wave first, then across."""

    signals: Signals
    frequency_hz: FloatArray
    value: FloatArray
    first: FloatArray
    second: FloatArray

    @cached_property
    def walk_gram(self) -> FloatArray:
        """Covariance [s^2], shape (m, m), of a walk of density 1/f^2 about its own mean: integrals of Phi Phi, sums of phi less its mean.

        The window is flat, so that what a walk comes to at the ends of its record is in every line: 1 to 3 times 1/f^2, and alike in all.
        """
        row_s = self.signals.row_s
        summed = row_s * np.cumsum(self.value - self.value.mean(axis=1, keepdims=True), axis=1)
        return np.asarray((2.0 * np.pi) ** 2 * row_s * (summed @ summed.T))

    @cached_property
    def _plain(self) -> NDArray[Any]:
        """Operator of :meth:`plain`, shape (2 m, 2 n): a signal's rows one after the other, x and y beside each other."""
        s = self.signals
        return np.concatenate([s.row_s * (self.value[:, :, None] * m[None]).reshape(len(self.value), -1) for m, _, _ in s._frame])

    @cached_property
    def _through_flow(self) -> ComplexArray:
        """Operator of :meth:`through_flow`: L by parts, every derivative on the test functions and the frame."""
        s = self.signals
        stretch, creep = moving_reference(s.omega_rad_s, s.row_s, s.omega0_rad_s)
        gain = stretch[None, :, None]
        shift = (s._shift - creep)[None, :, None]
        twice = 2j * s.omega0_rad_s
        value, first, second = (w[:, :, None] for w in (self.value, self.first, self.second))
        parts = []
        for m, m1, m2 in ((d[0][None], d[1][None], d[2][None]) for d in s._frame):
            operator = (
                value * (-gain * m1 + shift * m + (m2 - 2.0 * s.decay_rate * m1) / twice)
                + first * (-gain * m + 2.0 * (m1 - s.decay_rate * m) / twice)
                + second * m / twice
            )
            parts.append(s.row_s * operator.reshape(len(self.value), -1))
        return np.concatenate(parts)

    def gain_floors(self, turn: complex, campaign_s: float = 0.0) -> FloatArray:
        """Covariance [V^2/s] that a 1/f floor of either pick-off's gain brings to the equations' real parts, shape (2, 2 m, 2 m).

        Of density 1/f from one half-cosine over the record on; what is slower moves the record as a whole, where ``campaign_s`` says how
        long that may be.
        """
        s = self.signals
        frequency_hz = np.arange(1, s.time_s.size) / (2.0 * s.row_s * s.time_s.size)
        found = []
        duration_s = s.row_s * s.time_s.size
        of_whole = np.sqrt(s.time_s.size * np.log(max(campaign_s, duration_s) / duration_s))
        scale = np.concatenate([[of_whole], 1.0 / np.sqrt(2.0 * s.row_s * frequency_hz)])
        for axis in range(2):
            heard = np.real(turn * self._through_flow[:, axis::2] * s.pick[None, :, axis])
            spectrum = scale * scipy.fft.dct(heard, norm="ortho", axis=1)
            found.append(spectrum @ spectrum.T)
        return np.stack(found)

    def plain(self, signals: Sequence[ComplexArray]) -> ComplexArray:
        """Projections of what is added to p'."""
        if np.iscomplexobj(self._plain):
            return np.asarray(self._plain @ _side_by_side(signals))
        return np.asarray((self._plain @ _side_by_side(signals).view(np.float64)).view(np.complex128))

    def through_flow(self, signals: Sequence[ComplexArray]) -> ComplexArray:
        """Projections of L[x]: what a change x of the pick-off's volts adds to the left of the slow flow."""
        return np.asarray(self._through_flow @ _side_by_side(signals))


def _side_by_side(signals: Sequence[ComplexArray]) -> ComplexArray:
    """Signals of shape (n, 2) as the columns of one matrix: rows one after the other, x and y beside each other."""
    out = np.empty((signals[0].size, len(signals)), dtype=np.complex128)
    for k, x in enumerate(signals):
        out[:, k] = x.reshape(-1)
    return out
