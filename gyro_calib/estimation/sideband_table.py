"""The data table of document 000: complex amplitudes of the eight channels at the side bands, by linear least squares.

One row per recording. Document 000, step "processing": a digital PLL follows the phase reference but not its side bands, every channel is
demodulated by it and filtered alike, amplitudes at the known frequency come from linear least squares. The recorded envelopes refer to the
device's own phase reference, which its PLL modulates; here they are turned to a reference that follows the resonance (a parabola in time)
and nothing faster, so that the relation of drives and pick-offs is a transfer function, whatever the loops do.

Sign convention: a channel is ``c cos(phi) - s sin(phi)``, so the sine amplitude of the document (``+ s sin``) is ``-s`` here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..recording.recording import Recording

__all__ = ["MODULATIONS", "SidebandRow", "circular_covariance", "sideband_table", "smooth_reference", "table_row"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

#: kinds of excitation that put side bands on the channels
MODULATIONS = ("amplitude_modulation", "frequency_modulation", "secondary_modulation")
#: harmonics of the side band that least squares takes along, the first included
_HARMONICS = 3
#: share of the record that each end of the window takes to rise
_TAPER = 0.1
#: highest frequency at which noise is looked for [Hz]
_QUIET_TOP_HZ = 4.0
#: quiet frequencies that make a covariance
_NEAR = 8


@dataclass(frozen=True)
class SidebandRow:
    """Amplitudes of one recording; the first index of side-band arrays is the sign: 0 is ``+nu``, 1 is ``-nu``.

    Parameters
    ----------
    label, axis, kind : str
        Recording, its oscillator axis (``""`` with loops off), kind of its excitation.
    frequency_hz : float
        nu / 2 pi; 0 when nothing was modulated.
    time_s, duration_s : float
        Middle and length in device time.
    omega_rad_s, temperature_degc : float
        Mean of the reference and of the temperature.
    carrier_pick, carrier_drive : ndarray, shape (2,), complex
        x, y at the carrier [V].
    pick, drive : ndarray, shape (2, 2), complex
        (sign, axis) [V]; amplitudes of ``exp(+-i nu t)`` of the envelopes. Zero when nothing was modulated.
    hold_s : float
        Zero-order hold of the drive [s], 0 when it is not known.
    constant_advance : bool
        The firmware takes back the hold's delay by a constant phase; otherwise at every frequency of the reference.
    body_v : float
        Volts of the body excitation.
    quiet_hz : ndarray, shape (q,)
        Frequencies at which nothing was commanded.
    quiet_pick, quiet_drive : ndarray, shape (q, 2, 2), complex
        (frequency, sign, axis): amplitudes there, which are noise.
    noise_bandwidth_hz : float
        Expected squared amplitude over two-sided density, for white noise.
    """

    label: str
    axis: str
    kind: str
    frequency_hz: float
    time_s: float
    duration_s: float
    omega_rad_s: float
    temperature_degc: float
    carrier_pick: ComplexArray
    carrier_drive: ComplexArray
    pick: ComplexArray
    drive: ComplexArray
    hold_s: float
    constant_advance: bool
    body_v: float
    quiet_hz: FloatArray
    quiet_pick: ComplexArray
    quiet_drive: ComplexArray
    noise_bandwidth_hz: float

    @property
    def nu_rad_s(self) -> float:
        """nu [rad/s]."""
        return 2.0 * math.pi * self.frequency_hz

    def hold(self, nu_rad_s: FloatArray | float, omega0_rad_s: float) -> ComplexArray:
        """Drive that acts over drive that is recorded at ``omega + nu``, relative to the one at ``omega0``.

        A hold of length h has the gain sinc(f h) and delays by h/2; the firmware takes the delay back for the carrier, not for side bands.
        """
        nu = np.asarray(nu_rad_s, dtype=float)
        if self.hold_s <= 0.0:
            return np.ones(nu.shape, dtype=complex)
        cycles = self.hold_s / (2.0 * math.pi)
        gain = np.sinc((self.omega_rad_s + nu) * cycles) / np.sinc(omega0_rad_s * cycles)
        late = nu + (self.omega_rad_s - omega0_rad_s if self.constant_advance else 0.0)
        return np.asarray(gain * np.exp(-0.5j * late * self.hold_s))

    def acting_drive(self, omega0_rad_s: float) -> ComplexArray:
        """Side bands of the drive as the resonator gets it, shape (2, 2): (sign, axis) [V]."""
        return np.asarray(self.drive * self.hold(np.array([self.nu_rad_s, -self.nu_rad_s]), omega0_rad_s)[:, None])

    @property
    def channels(self) -> ComplexArray:
        """Amplitudes at nu of the eight real channels, shape (8,), in the order of the recording: x_pick_c, x_pick_s, … y_drive_s [V]."""
        return _channels(np.concatenate([self.pick, self.drive], axis=1))

    @property
    def near(self) -> NDArray[np.int_]:
        """Places of the quiet frequencies nearest to the side band: noise is coloured."""
        return np.argsort(np.abs(np.log(self.quiet_hz / max(self.frequency_hz, self.quiet_hz[0]))))[:_NEAR]

    @property
    def covariance(self) -> FloatArray:
        """Covariance of :attr:`channels` as (re, im) pairs, shape (16, 16) [V^2]: mean over the nearest quiet frequencies."""
        return circular_covariance(_channels(np.concatenate([self.quiet_pick, self.quiet_drive], axis=2)[self.near]))


def sideband_table(recordings: list[Recording]) -> list[SidebandRow]:
    """One row per recording, in order."""
    return [table_row(r) for r in recordings]


def table_row(recording: Recording) -> SidebandRow:
    """Amplitudes of one recording at its side band; same window and same regressors for every channel."""
    excitation = recording.command.excitation
    modulated = excitation.kind in MODULATIONS and excitation.frequency_hz > 0.0
    nu = 2.0 * math.pi * excitation.frequency_hz if modulated else 0.0
    row_s = 1.0 / recording.sample_rate_hz
    t = recording.t
    least = _least_squares(t.size, row_s, nu)
    turn, slow = _turn(recording, least, row_s)
    signals = _envelopes(recording) * turn[:, None]
    amplitudes, left = least.fit(signals)
    window, omega = least.window, float(slow[0])
    # with loops off the last oscillation still dies away beside the drive: only full rate keeps it out of the low frequencies
    block = max(1, int(recording.sample_rate_hz / (16.0 * _QUIET_TOP_HZ))) if recording.command.oscillator_axis else 1
    quiet_hz, quiet = _quiet(left, window, recording.sample_rate_hz, excitation.frequency_hz if modulated else 0.0, block)
    sides = np.zeros((2, 4), dtype=complex)
    if modulated:
        cosine, sine = amplitudes[3], amplitudes[4]
        # phases refer to the device's clock, not to the start of the recording
        turn_back = np.exp(-1j * nu * t[0])
        sides = 0.5 * np.stack([(cosine - 1j * sine) * turn_back, (cosine + 1j * sine) * turn_back.conj()])
    return SidebandRow(
        label=recording.label,
        axis=recording.command.oscillator_axis or "",
        kind=excitation.kind,
        frequency_hz=excitation.frequency_hz if modulated else 0.0,
        time_s=float(0.5 * (t[0] + t[-1])),
        duration_s=recording.duration_s,
        omega_rad_s=omega,
        temperature_degc=float(recording.temperature_degc.mean()),
        carrier_pick=amplitudes[0, :2],
        carrier_drive=amplitudes[0, 2:],
        pick=sides[:, :2],
        drive=sides[:, 2:],
        hold_s=float(recording.extras.get("dac_zero_order_hold_s", 0.0) or 0.0),
        constant_advance="firmware_drive_phase_advance_rad" in recording.extras,
        body_v=excitation.volts if excitation.kind == "body" else 0.0,
        quiet_hz=quiet_hz,
        quiet_pick=quiet[:, :, :2],
        quiet_drive=quiet[:, :, 2:],
        noise_bandwidth_hz=float(window @ window) / float(window.sum()) ** 2 / row_s,
    )


def smooth_reference(recording: Recording) -> tuple[ComplexArray, ComplexArray, FloatArray]:
    """Envelopes on the reference that follows the resonance and nothing faster.

    Returns
    -------
    pick, drive : ndarray, shape (n, 2), complex
        [V].
    omega_rad_s : ndarray, shape (n,)
        That reference [rad/s].
    """
    excitation = recording.command.excitation
    nu = 2.0 * math.pi * excitation.frequency_hz if excitation.kind in MODULATIONS else 0.0
    least = _least_squares(len(recording), 1.0 / recording.sample_rate_hz, nu)
    turn, slow = _turn(recording, least, 1.0 / recording.sample_rate_hz)
    turned = _envelopes(recording) * turn[:, None]
    return turned[:, :2], turned[:, 2:], least.basis[:, : slow.size] @ slow


class _LeastSquares:
    """Windowed least squares on a parabola, then cos and sin of nu and its harmonics, time counted from the first row."""

    def __init__(self, n: int, row_s: float, nu: float) -> None:
        x = np.linspace(-1.0, 1.0, n)
        self.basis = np.empty((n, 3 + (2 * _HARMONICS if nu > 0.0 else 0)))
        self.basis[:, 0], self.basis[:, 1], self.basis[:, 2] = 1.0, x, 1.5 * x**2 - 0.5
        if nu > 0.0:
            first = np.exp(1j * nu * row_s * np.arange(n))
            wave = first
            for k in range(_HARMONICS):
                self.basis[:, 3 + 2 * k], self.basis[:, 4 + 2 * k] = wave.real, wave.imag
                wave = wave * first
        self.window = _window(n)
        self._weighted = self.basis * self.window[:, None]
        # normal equations: the columns are nearly orthogonal
        self._inverse = np.linalg.inv(self._weighted.T @ self.basis)

    def fit(self, signals: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Coefficients (regressors, channels) and what they leave (n, channels)."""
        real = np.ascontiguousarray(signals).view(np.float64)
        found = self._inverse @ (self._weighted.T @ real)
        return found.view(np.complex128), (real - self.basis @ found).view(np.complex128)

    def slow(self, signal: FloatArray) -> FloatArray:
        """Coefficients of the parabola in a real signal, shape (3,)."""
        return np.asarray((self._inverse @ (self._weighted.T @ signal))[:3])


#: recordings of a campaign share their length and a few side bands
_least_squares = lru_cache(maxsize=16)(_LeastSquares)


def _window(n: int) -> FloatArray:
    """Flat with raised-cosine ends: what is not periodic in the record does not leak into the lines."""
    rise = max(1, round(_TAPER * n))
    window = np.ones(n)
    edge = 0.5 - 0.5 * np.cos(math.pi * (np.arange(rise) + 0.5) / rise)
    window[:rise], window[-rise:] = edge, edge[::-1]
    return window


def _envelopes(recording: Recording) -> ComplexArray:
    """x, y pick-off, x, y drive, shape (n, 4): the c and s columns stand side by side [V]."""
    return np.ascontiguousarray(recording.data[:, 2:10]).view(np.complex128)


def _turn(recording: Recording, least: _LeastSquares, row_s: float) -> tuple[ComplexArray, FloatArray]:
    """Factor that refers the envelopes to the smooth reference, and the parabola of that (3,) [rad/s]."""
    omega = recording.ref_omega_rad_s
    slow = least.slow(omega)
    fast = omega - least.basis[:, :3] @ slow
    # the phase at the middle of each row
    phase = row_s * (np.cumsum(fast) - 0.5 * fast)
    phase -= phase.mean()
    return np.cos(phase) + 1j * np.sin(phase), slow


def _quiet(residual: ComplexArray, window: FloatArray, rate_hz: float, line_hz: float, block: int) -> tuple[FloatArray, ComplexArray]:
    """Amplitudes at the Fourier frequencies near the lines of interest, shape (q, 2, channels), by sign.

    From means over ``block`` rows, whose droop is taken back: only low frequencies are wanted.
    """
    n = residual.shape[0] // block
    step = rate_hz / block / n
    windowed = (residual * window[:, None])[: n * block].reshape(n, block, -1)
    coarse = windowed[:, 0].copy()
    for k in range(1, block):
        coarse += windowed[:, k]
    top = min(n // 4, max(24, math.ceil(_QUIET_TOP_HZ / step)))
    bins = np.arange(3, top)
    if line_hz > 0.0:
        harmonics = line_hz * np.arange(1, _HARMONICS + 3)
        bins = bins[np.min(np.abs(bins[:, None] * step - harmonics[None, :]), axis=1) > 1.5 * step]
    spectrum = np.fft.fft(coarse, axis=0) / window.sum()
    droop = np.sinc(bins / n)[:, None, None]
    return bins * step, np.stack([spectrum[bins], spectrum[-bins]], axis=1) / droop


def circular_covariance(amplitudes: ComplexArray) -> FloatArray:
    """Covariance of (re, im) pairs from samples (q, k) of noise whose phase is random, shape (2 k, 2 k)."""
    complex_covariance = 0.5 * amplitudes.T @ amplitudes.conj() / amplitudes.shape[0]
    k = amplitudes.shape[1]
    covariance = np.empty((2 * k, 2 * k))
    covariance[0::2, 0::2] = covariance[1::2, 1::2] = complex_covariance.real
    covariance[1::2, 0::2], covariance[0::2, 1::2] = complex_covariance.imag, -complex_covariance.imag
    return covariance


def _channels(sides: ComplexArray) -> ComplexArray:
    """Complex amplitudes at nu of (c, s) of every envelope from its amplitudes at +-nu: (…, 2, k) -> (…, 2 k)."""
    plus, minus = sides[..., 0, :], sides[..., 1, :].conj()
    return np.ascontiguousarray(np.stack([0.5 * (plus + minus), -0.5j * (plus - minus)], axis=-1).reshape(*plus.shape[:-1], -1))
