"""The digital phase-locked loop of document 000 ("from the carrier a digital PLL may be used to remove higher harmonics and amplitude
modulation"), in the form that a file allows: non-causal and without phase error.

A causal loop follows the reference with a lag. With the whole record at hand the loop filter can be symmetric: demodulate by the present
phase, low-pass the complex envelope with a symmetric kernel, add its angle to the phase, repeat. The angle is blind to amplitude
modulation, harmonics fall outside the kernel's pass band, and each repetition takes away more of what the pass band's droop has left of a
phase modulation.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError

__all__ = ["carrier_frequency", "is_phase", "lock_phase"]

FloatArray = NDArray[np.float64]

#: least samples per carrier cycle: below, the second harmonic of the product comes too close to the carrier
LEAST_SAMPLES_PER_CYCLE = 4.0
#: samples that the search for the carrier looks at
_SEARCH_SAMPLES = 2**16
#: a line stands out of the spectrum's median by this (white noise: some 16)
_LINE_OVER_MEDIAN = 300.0
#: distance from an expected frequency within which the carrier is looked for, relative
_NEAR = 0.1
_ROUNDS = 3
#: carrier cycles that the loop's kernel must span on each side
_LEAST_CYCLES = 6.0
#: share of its median below which the reference's amplitude is lost
_LOST = 0.05


def is_phase(signal: FloatArray) -> bool:
    """Whether a reference channel holds the phase itself [rad], wrapped or not, rather than a voltage.

    A phase advances by nearly the same angle every sample; a sinusoid's steps, wrapped or not, scatter about zero.
    """
    steps = np.diff(signal)
    steps = (steps + math.pi) % (2.0 * math.pi) - math.pi
    middle = float(np.median(steps))
    scatter = float(np.median(np.abs(steps - middle)))
    return abs(middle) > 1e-6 and scatter < 0.1 * abs(middle)


def carrier_frequency(volts: FloatArray, rate_hz: float, near_hz: float | None = None, *, what: str = "phase_ref") -> float:
    """Frequency of the strongest line [Hz], to a fraction of a bin.

    Parameters
    ----------
    volts : ndarray, shape (n,)
        Channel.
    rate_hz : float
        Samples per second.
    near_hz : float, optional
        Look within 10 % of this only.
    what : str
        Name of the channel in an error's text.

    Raises
    ------
    DataError
        No line stands out of the noise, or it has too few samples per cycle.
    """
    middle = volts.size // 2
    part = volts[max(0, middle - _SEARCH_SAMPLES // 2) : middle + _SEARCH_SAMPLES // 2]
    part = part - part.mean()
    power = np.abs(np.fft.rfft(part * np.hanning(part.size))) ** 2
    frequency = np.fft.rfftfreq(part.size, 1.0 / rate_hz)
    allowed = frequency > 4.0 * rate_hz / part.size
    if near_hz is not None:
        allowed &= np.abs(frequency - near_hz) <= max(_NEAR * near_hz, 4.0 * rate_hz / part.size)
    median = float(np.median(power))
    peak = int(np.argmax(np.where(allowed, power, 0.0))) if allowed.any() else 0
    if not allowed.any() or not power[peak] > _LINE_OVER_MEDIAN * median:
        where = f" within 10 % of {near_hz:g} Hz" if near_hz is not None else ""
        raise DataError(
            f"Channel {what} must hold a carrier{where}, but none stands out of its noise (rms {float(part.std()):.3g} V). "
            "Check the channel's cable and name, or record while the oscillator runs."
        )
    found = float(frequency[peak])
    if 0 < peak < power.size - 1:
        below, at, above = np.log(np.maximum(power[peak - 1 : peak + 2], 1e-300))
        found += 0.5 * (below - above) / (below - 2.0 * at + above) * rate_hz / part.size
    if rate_hz < LEAST_SAMPLES_PER_CYCLE * found:
        raise DataError(
            f"Converter rate must be at least {LEAST_SAMPLES_PER_CYCLE:g} samples per carrier cycle, but got {rate_hz:g} Hz for a carrier "
            f"of {found:.6g} Hz on {what}. Sample faster."
        )
    return found


def lock_phase(
    volts: FloatArray, rate_hz: float, *, near_hz: float | None = None, bandwidth_hz: float = 200.0, what: str = "phase_ref"
) -> tuple[FloatArray, int]:
    """Phase of a reference voltage at every sample, without lag.

    Parameters
    ----------
    volts : ndarray, shape (n,)
        Reference, with whatever harmonics, amplitude modulation and noise it has.
    rate_hz : float
        Samples per second.
    near_hz : float, optional
        Where the carrier is expected.
    bandwidth_hz : float
        The kernel is a Hann window of twice ``1 / bandwidth_hz``; shortened to a quarter of a short record.
    what : str
        Name of the channel in an error's text.

    Returns
    -------
    phase : ndarray, shape (n,)
        ``volts ~ a(t) cos(phase)``, unwrapped [rad].
    margin : int
        Samples at each end where the kernel was cut and the phase is extrapolated.

    Raises
    ------
    DataError
        No carrier, too few samples per cycle, a record too short, or a reference that fades inside the record.
    """
    from scipy.signal import oaconvolve  # takes most of a second to load, and few recordings are of the carrier

    carrier = carrier_frequency(volts, rate_hz, near_hz, what=what)
    half = min(round(rate_hz / bandwidth_hz), volts.size // 8)
    if half * carrier / rate_hz < _LEAST_CYCLES:
        need = 8.0 * _LEAST_CYCLES / carrier
        raise DataError(
            f"Reference {what} must last at least {need:.3g} s, but got {volts.size} samples ({volts.size / rate_hz:.3g} s). Record longer."
        )
    taps = np.hanning(2 * half + 3)[1:-1]
    taps /= taps.sum()
    phase = 2.0 * math.pi * carrier / rate_hz * np.arange(volts.size)
    inner = slice(half, volts.size - half)
    for _ in range(_ROUNDS):
        envelope = oaconvolve(2.0 * volts * np.exp(-1j * phase), taps, mode="same")
        _check_amplitude(np.abs(envelope[inner]), half, what)
        phase += _extrapolated(np.unwrap(np.angle(envelope)), half)
    return np.asarray(phase, dtype=np.float64), half


def _check_amplitude(amplitude: FloatArray, first: int, what: str) -> None:
    median = float(np.median(amplitude))
    weak = amplitude < _LOST * median
    if weak.any():
        sample = first + int(np.argmax(weak))
        raise DataError(
            f"Reference {what} must not fade, but got {amplitude[sample - first]:.3g} V at sample {sample} (median {median:.3g} V): "
            "its phase is lost there. Record again, or cut the recording before it."
        )


def _extrapolated(error: FloatArray, half: int) -> FloatArray:
    """Phase error with its two ends, where the kernel hangs over, continued along the straight line of the ``half`` samples beside them."""
    k = np.arange(half, dtype=float)
    out = error.copy()
    slope, level = np.polyfit(k, error[half : 2 * half], 1)
    out[:half] = level + slope * (k - half)
    slope, level = np.polyfit(k, error[-2 * half : -half], 1)
    out[-half:] = level + slope * (k + half)
    return out
