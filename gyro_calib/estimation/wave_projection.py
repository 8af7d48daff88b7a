"""Project the slow flow in the frame of the wave: the four equations of theory.md Eq. 6, still exact and still linear in (A, G~, E).

A whole-angle wave precesses, so the test functions do too: ``phi(t) n(t)`` and ``phi(t) n_perp(t)`` with n along the measured (smoothed)
azimuth. Integration by parts holds for any smooth frame, so nothing is approximated; the frame only sorts what is measured: real part along
the wave = amplitude (damping, gain), imaginary part along = resonance frequency (where its wander is), real part across = precession (rate,
forcer errors), imaginary part across = quadrature (frequency split). Each has a noise of its own; in the axes of the pick-offs the wander
of the resonance would be in all of them.

Every product is formed at full rate and then thinned by one low-pass kernel, the same for all: that is a change of the test functions, not
an approximation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..recording.applied_rate import applied_rate
from ..recording.recording import Recording
from .projection import hold_delay, hold_factor, moving_reference, test_functions
from .wave import smooth_angle, wave_coordinates

__all__ = [
    *("CHANNELS", "Products", "WaveProjected", "frame_directions", "in_wave_frame", "slow_waves", "spectral_derivatives"),
    *("thin", "thinning"),
]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Signal = Callable[[ComplexArray, ComplexArray, FloatArray], ComplexArray]
#: what the equations are: real and imaginary part along the wave, then across it
CHANNELS = ("amplitude", "frequency", "precession", "quadrature")
#: rows per second after thinning, least rows of a record, and over how long the azimuth is smoothed [s]: the test functions rise in 0.3 of
#: the record at most, and need 36 rows for it; in 31 rows of a ring-down of 0.33 s they left 3.6e-4 of it, and its noise was 1e-5
_THIN_HZ, _FEWEST, _SMOOTH_S = 100.0, 120, 0.2
#: lines of the flicker of forces that do not follow the wave
_SLOW_LINES = 5


@dataclass(frozen=True)
class WaveProjected:
    """The equations of one recording on its lines, along the wave first, then across: 2 m of them.

    Parameters
    ----------
    frequency_hz : ndarray, shape (2 m,)
    lhs : ndarray, shape (2 m,), complex
        L[V] [V/s].
    pick, drive, drive_rate, drive_slope : ndarray, shape (2 m, 2, 2), complex
        Regressors [equation, axis a, column b] of A_ab, G~_ab, E_ab, and of a drive that acts later than it is recorded (its derivative).
    rate_pick, rate_drive, jerk : ndarray, shape (2 m, 2, 2), complex
        Applied rate times the velocity over i omega0, times u, and its change times V.
    body, constant : ndarray, shape (2 m, 2), complex
        Projected volts of the body excitation, and one, by axis: regressors of a force that does not follow the wave.
    slow : ndarray, shape (2 m, 2 k)
        The same of forces at k slow lines, each of unit sum of squares: what flicker of the drives looks like from the wave.
    slow_hz : ndarray, shape (2 k,)
        Their frequencies [Hz]; zero for the constant.
    resonance : ndarray, shape (2 m, 2), complex
        V, and V times time from -1 to 1: regressors of this recording's own resonance shift.
    terms : dict of str to ndarray, shape (2 m, k), complex
        By name, see :func:`in_wave_frame`.
    gram, slope_gram : ndarray, shape (2 m, 2 m)
        Inner products of the test functions, and of their derivatives, the frame's turning included: what white noise of the forces and of
        the pick-offs projects to.
    turn_rad : float
        How far the azimuth psi moved [rad].
    """

    frequency_hz: FloatArray
    lhs: ComplexArray
    pick: ComplexArray
    drive: ComplexArray
    drive_rate: ComplexArray
    drive_slope: ComplexArray
    rate_pick: ComplexArray
    rate_drive: ComplexArray
    jerk: ComplexArray
    body: ComplexArray
    constant: ComplexArray
    slow: FloatArray
    slow_hz: FloatArray
    resonance: ComplexArray
    terms: dict[str, ComplexArray]
    gram: FloatArray
    slope_gram: FloatArray
    turn_rad: float

    @property
    def slope_hz(self) -> FloatArray:
        """Root mean square slope of each test function over 2 pi [Hz]: near its line, but never below what the window's ends make."""
        return np.asarray(np.sqrt(np.diag(self.slope_gram)) / (2.0 * np.pi))


def thinning(recording: Recording) -> int:
    """Rows of a recording that are joined to one."""
    return max(1, min(round(recording.sample_rate_hz / _THIN_HZ), len(recording) // _FEWEST))


def thin(signal: NDArray[Any], width: int) -> NDArray[Any]:
    """Three running means of ``width`` rows, one row of ``width`` kept; along the first axis."""
    if width <= 1:
        return signal
    mean = np.full(width, 1.0 / width)
    weights = np.convolve(np.convolve(mean, mean), mean)
    last = max((len(signal) - weights.size) // width * width + 1, 0)
    out = weights[0] * signal[:last:width]
    for k, weight in enumerate(weights[1:], start=1):
        out += weight * signal[k : k + last : width]
    return np.asarray(out)


@dataclass(frozen=True)
class _Direction:
    """One direction of the frame and its first two derivatives, shape (n, 2); complex in a frame that keeps the wave's phase."""

    m: NDArray[Any]
    m1: NDArray[Any]
    m2: NDArray[Any]

    def turned_back(self, phase_rad: FloatArray, row_s: float) -> _Direction:
        """The same by a phase that moves: ``m exp(-i phase)``."""
        back, pace = np.exp(-1j * phase_rad)[:, None], np.gradient(phase_rad, row_s)
        first, second = pace[:, None], np.gradient(pace, row_s)[:, None]
        m1 = self.m1 - 1j * first * self.m
        return _Direction(back * self.m, back * m1, back * (self.m2 - 2j * first * self.m1 - (1j * second + first**2) * self.m))


class Products:
    """Thinned products of one recording; :meth:`project` puts them on lines.

    Parameters
    ----------
    recording : Recording
        One segment.
    omega0_rad_s : float
        Frequency about which A and G are written.
    decay_rate : float
        Rough 1/tau [1/s] (second-order terms only).
    resonance_shift_rad_s : float or ndarray, shape (n,)
        How far the resonance is known to have moved (temperature).
    plain, derived : mapping of str to callable
        Further signals, shape (n, k, 2) from (V, u, applied rate): projected as they are, or through L.
    drive_scale : ndarray, shape (n,), or None
        Factor of the drive at each row (drives at twice the frequency act in proportion to the motion).
    in_phase : bool
        Whether the frame keeps the wave's phase, as :func:`frame_directions` says.
    """

    def __init__(
        self,
        recording: Recording,
        omega0_rad_s: float,
        decay_rate: float,
        resonance_shift_rad_s: FloatArray | float = 0.0,
        *,
        plain: dict[str, Signal] | None = None,
        derived: dict[str, Signal] | None = None,
        drive_scale: FloatArray | None = None,
        in_phase: bool = False,
    ) -> None:
        rate_hz = recording.sample_rate_hz
        self._width = thinning(recording)
        self._row_s = self._width / rate_hz
        self._omega0, self._decay = omega0_rad_s, decay_rate
        omega = recording.ref_omega_rad_s
        stretch, creep = moving_reference(omega, 1.0 / rate_hz, omega0_rad_s)
        slow = (omega - omega0_rad_s) / (2.0 * omega0_rad_s)
        detuning = (omega**2 - omega0_rad_s**2) / (2.0 * omega0_rad_s) - resonance_shift_rad_s
        self._gain = stretch[:, None]
        self._shift = (1j * detuning + 2.0 * decay_rate * slow - creep)[:, None]
        delay = hold_delay(recording, omega0_rad_s)
        V, u = recording.pick, recording.drive
        acting = u * hold_factor(recording, omega, omega0_rad_s)[:, None]
        if drive_scale is not None:
            acting = acting * drive_scale[:, None]
        rate, slope = applied_rate(recording)
        excitation = recording.command.excitation
        body = complex(excitation.volts) if excitation.kind == "body" else 0j
        # a Coriolis force goes with the velocity, i omega V + V': of a wave that turns by kappa Omega that is kappa^2 Omega^2 / omega
        velocity = np.asarray((omega / omega0_rad_s)[:, None] * V - 1j / omega0_rad_s * np.gradient(V, 1.0 / rate_hz, axis=0))
        time = np.linspace(-1.0, 1.0, len(recording))[:, None]
        self._t = thin(recording.t, self._width)
        slow, self._slow_hz = slow_waves(recording)
        self._parts: list[dict[str, list[ComplexArray]]] = []
        directions, speed = frame_directions(recording, in_phase=in_phase)
        self._speed = thin(speed, self._width)
        #: how fast the azimuth moves, leaving out its few fastest rows [rad/s], and how far it moved [rad]
        self.speed_rad_s = float(np.quantile(np.abs(speed), 0.98))
        self.turn_rad = abs(float(np.sum(speed))) / rate_hz
        for d in directions:
            part: dict[str, list[ComplexArray]] = {
                "lhs": self._derived(d, V[:, None, :]),
                "drive_rate": self._derived_by_axis(d, u),
                "pick": self._by_axis(d.m, V),
                "drive": [
                    *(held + late for held, late in zip(self._by_axis(d.m, acting), self._by_axis(d.m1, delay * acting), strict=True)),
                    *self._by_axis(d.m, delay * acting),
                ],
                "drive_slope": [*self._by_axis(-d.m1, acting), *self._by_axis(-d.m, acting)],
                "rate_pick": self._by_axis(d.m, rate[:, None] * velocity),
                "rate_drive": self._by_axis(d.m, rate[:, None] * u),
                "jerk": self._by_axis(d.m, slope[:, None] * V),
                "body": [thin(d.m * body, self._width)],
                "constant": [thin(d.m * (1.0 + 0j), self._width)],
                "slow": [thin((d.m[:, :, None] * slow[:, None, :] + 0j).reshape(len(recording), -1), self._width)],
                "resonance": [thin(np.stack([np.sum(d.m * X, axis=1) for X in (V, time * V)], axis=1), self._width)],
            }
            part |= {name: [thin(np.sum(d.m[:, None, :] * f(V, u, rate), axis=2), self._width)] for name, f in (plain or {}).items()}
            part |= {name: self._derived(d, f(V, u, rate)) for name, f in (derived or {}).items()}
            self._parts.append(part)
        self._names = (*(plain or {}), *(derived or {}))

    def project(self, frequencies_hz: Sequence[float]) -> WaveProjected:
        """The equations on these lines (0: the mean)."""
        f = test_functions(self._t, self._row_s, list(frequencies_hz))
        weights = (f.value, *spectral_derivatives(f.value, self._row_s))

        def on_lines(name: str) -> ComplexArray:
            # the k-th entry of a signal goes with the k-th derivative of the test functions
            rows = []
            for part in self._parts:
                flat = [s.reshape(s.shape[0], -1) for s in part[name]]
                total = sum(w @ s.real + 1j * (w @ s.imag) for w, s in zip(weights, flat, strict=False))
                rows.append(self._row_s * np.asarray(total).reshape(-1, *part[name][0].shape[1:]))
            return np.concatenate(rows)

        gram = self._row_s * (f.value @ f.value.T)
        # (phi n)' = phi' n + psi' phi n_perp, (phi n_perp)' = phi' n_perp - psi' phi n
        steep, turned = weights[1], self._speed * f.value
        own = self._row_s * (steep @ steep.T + turned @ turned.T)
        between = self._row_s * (turned @ steep.T - steep @ turned.T)
        return WaveProjected(
            frequency_hz=np.tile(f.frequency_hz, 2),
            lhs=on_lines("lhs")[:, 0],
            pick=on_lines("pick"),
            drive=on_lines("drive"),
            drive_rate=on_lines("drive_rate"),
            drive_slope=on_lines("drive_slope"),
            rate_pick=on_lines("rate_pick"),
            rate_drive=on_lines("rate_drive"),
            jerk=on_lines("jerk"),
            body=on_lines("body"),
            constant=on_lines("constant"),
            slow=on_lines("slow").real,
            slow_hz=np.tile(self._slow_hz, 2),
            resonance=on_lines("resonance"),
            terms={name: on_lines(name) for name in self._names},
            gram=np.kron(np.eye(2), gram),
            slope_gram=np.block([[own, between], [between.T, own]]),
            turn_rad=self.turn_rad,
        )

    def _orders(self, d: _Direction, x: ComplexArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """What goes with phi, phi' and phi'' in the projection of L[x] on phi m; elementwise, x of shape (n, ..., 2)."""
        pad = (slice(None), *([None] * (x.ndim - 2)), slice(None))
        y, y1, y2 = d.m[pad] * x, d.m1[pad] * x, d.m2[pad] * x
        gain, shift = self._gain[pad], self._shift[pad]
        twice = 2j * self._omega0
        return (
            -gain * y1 + shift * y + (y2 - 2.0 * self._decay * y1) / twice,
            -gain * y + 2.0 * (y1 - self._decay * y) / twice,
            y / twice,
        )

    def _derived(self, d: _Direction, x: ComplexArray) -> list[ComplexArray]:
        """L of signals of shape (n, k, 2), both axes summed: three of shape (n', k)."""
        return [thin(part.sum(axis=-1), self._width) for part in self._orders(d, x)]

    def _derived_by_axis(self, d: _Direction, x: ComplexArray) -> list[ComplexArray]:
        """L of x_b on axis a: three of shape (n', a, b)."""
        columns = [self._orders(d, np.repeat(x[:, b : b + 1], 2, axis=1)) for b in range(2)]
        return [thin(np.stack([c[k] for c in columns], axis=2), self._width) for k in range(3)]

    def _by_axis(self, m: NDArray[Any], x: ComplexArray) -> list[ComplexArray]:
        """m_a x_b, shape (n', a, b)."""
        return [thin(m[:, :, None] * x[:, None, :], self._width)]


def slow_waves(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """1, cos, sin, … at multiples of one over the record, of unit sum of squares times the row time: shape (n, k), and their lines [Hz]."""
    duration, share = recording.duration_s, 2.0 * np.pi * (np.arange(len(recording)) + 0.5) / len(recording)
    columns, lines = [np.full(len(recording), 1.0 / np.sqrt(duration))], [0.0]
    for k in range(1, _SLOW_LINES + 1):
        columns += [np.sqrt(2.0 / duration) * f(k * share) for f in (np.cos, np.sin)]
        lines += [k / duration, k / duration]
    return np.column_stack(columns), np.array(lines)


def spectral_derivatives(value: FloatArray, row_s: float) -> tuple[FloatArray, FloatArray]:
    """First and second derivative of functions that vanish at both ends, in the sense of the sums that they enter.

    Spectral: then ``sum(phi' x) = -sum(phi x')`` holds for the samples as they are, however few of them the rise of a short window has;
    the formula's own derivative, sampled, leaves some 1e-5 of a steady amplitude there.
    """
    count = value.shape[1]
    spin = 2j * np.pi * np.fft.rfftfreq(count, row_s)
    spectrum = np.fft.rfft(value, axis=1)
    if count % 2 == 0:
        spin[-1] = 0.0  # the highest line has no phase, and nothing of these functions
    return np.fft.irfft(spin * spectrum, count, axis=1), np.fft.irfft(spin**2 * spectrum, count, axis=1)


def in_wave_frame(recording: Recording) -> bool:
    """Whether the recording holds a wave to follow: with loops off there is none, and its frame is the axes'."""
    return recording.command.mode != "loops_off"


def frame_directions(recording: Recording, *, in_phase: bool = False) -> tuple[tuple[_Direction, _Direction], FloatArray]:
    """Frame of a recording: along and across the wave, or x and y with loops off.

    Parameters
    ----------
    recording : Recording
    in_phase : bool
        Whether the frame of a wave keeps its phase to its mean. While a temperature moves, the reference lags the resonance, and the phase
        by which it does, of a milliradian, puts the wander of the resonance into the amplitude of a wave as large as its noise.

    Returns
    -------
    tuple of two directions
        With their derivatives in time, shape (n, 2) each.
    ndarray, shape (n,)
        Speed of the azimuth psi [rad/s].
    """
    row_s, rows = 1.0 / recording.sample_rate_hz, round(_SMOOTH_S * recording.sample_rate_hz)
    wave = wave_coordinates(recording) if in_wave_frame(recording) else None
    psi = np.zeros(len(recording)) if wave is None else smooth_angle(wave.azimuth_rad, rows)
    speed = np.gradient(psi, row_s)[:, None]
    turn = np.gradient(speed[:, 0], row_s)[:, None]
    along = np.column_stack([np.cos(psi), np.sin(psi)])
    across = np.column_stack([-np.sin(psi), np.cos(psi)])
    along_wave = _Direction(along, speed * across, turn * across - speed**2 * along)
    across_wave = _Direction(across, -speed * along, -turn * along - speed**2 * across)
    if in_phase and wave is not None:
        phase = smooth_angle(wave.phase_rad, rows)
        along_wave, across_wave = (d.turned_back(phase - phase.mean(), row_s) for d in (along_wave, across_wave))
    return (along_wave, across_wave), speed[:, 0]
