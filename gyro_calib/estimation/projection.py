"""Project a recording on test functions: the slow flow as exact linear equations, without differentiating data.

Multiply the slow flow by ``phi(t) = w(t) cos(nu t)`` or ``w(t) sin(nu t)`` with a window ``w`` that vanishes smoothly at both
ends, integrate by parts, and every derivative falls on ``phi``: no end-point terms, no leakage error (both sides of the equation see
the same linear functional, whatever else the signals hold), and a free decay or a slow drift inside the record does no harm. This
replaces the Fourier window over whole periods of document 000 (step "data table"), whose end-point term must use the true ends
(theory.md section 2).

Exact envelope equation, normalised by ``2 i omega0`` (from theory.md Eq. 1 with x = Re[X e^{i phi}], no averaging):

    (omega/omega0) p' + (p'' + i omega' p + C p')/(2 i omega0)
        + [i (omega^2 - omega0^2)/(2 omega0) + C (omega - omega0)/(2 omega0)] p = A p + G u,   V = p + E u,

so with ``G~ = G - A E`` everything is linear in (A, G~, E): ``L[V] = A V + G~ u + E L[u]``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..recording.recording import Recording

__all__ = ["Projected", "TestFunctions", "hold_delay", "hold_factor", "moving_reference", "project", "test_functions"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: share of the record that each end of the window takes to rise; least rows (a faster rise folds at the rows' rate what a switched drive
#: does: 5e-6 V of a ring-down at 100 rows/s), and most of the record that they may take
TAPER, _RISING_ROWS, _MOST_RISING = 0.06, 36, 0.3
#: a rise of fewer rows has C5 ends instead of C3: of a wave that falls by half a second 30 rows of C3 left 6e-7, C5 leaves 2e-8; longer
#: ones need it not, and C5 lets in 21 % more of the pick-off's noise (its squared slope)
_FEW_ROWS = 60


@dataclass(frozen=True)
class TestFunctions:
    """Test functions with their first two derivatives.

    Parameters
    ----------
    frequency_hz : ndarray, shape (m,)
        Line of each function.
    value, first, second : ndarray, shape (m, n)
        phi, phi', phi'' at the rows, normalised to unit sum of squares of phi times the row time: a white process of two-sided density S
        projects to variance S.
    """

    __test__ = False

    frequency_hz: FloatArray
    value: FloatArray
    first: FloatArray
    second: FloatArray


def _window(n: int, row_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Flat window that rises by a smooth step, its first and second derivative."""
    duration = n * row_s
    rise = max(TAPER, min(_RISING_ROWS / n, _MOST_RISING)) * duration
    step = _step_c5 if rise < _FEW_ROWS * row_s else _step_c3
    t = (np.arange(n) + 0.5) * row_s
    w, d1, d2 = np.ones(n), np.zeros(n), np.zeros(n)
    for inside, x, sign in ((t < rise, t / rise, 1.0), (duration - t < rise, (duration - t) / rise, -1.0)):
        value, slope, bend = step(np.asarray(x[inside], dtype=np.float64))
        w[inside], d1[inside], d2[inside] = value, sign * slope / rise, bend / rise**2
    return w, d1, d2


def _step_c3(x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Smooth step of the 7th order from 0 to 1, its slope and its bend."""
    y = x * (1.0 - x)
    return x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3), 140.0 * y**3, 420.0 * y**2 * (1.0 - 2.0 * x)


def _step_c5(x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of the 11th order."""
    y = x * (1.0 - x)
    value = x**6 * (462.0 - 1980.0 * x + 3465.0 * x**2 - 3080.0 * x**3 + 1386.0 * x**4 - 252.0 * x**5)
    return value, 2772.0 * y**5, 13860.0 * y**4 * (1.0 - 2.0 * x)


def test_functions(t: FloatArray, row_s: float, frequencies_hz: list[float]) -> TestFunctions:
    """Cosine and sine test functions at each line (a single one at zero), referred to the device time ``t`` of the rows."""
    w, d1, d2 = _window(t.size, row_s)
    lines, value, first, second = [], [], [], []
    for f in frequencies_hz:
        nu = 2.0 * math.pi * f
        waves = [(np.ones_like(t), np.zeros_like(t))] if f == 0.0 else []
        if f != 0.0:
            c, s = np.cos(nu * t), np.sin(nu * t)
            waves = [(c, -s), (s, c)]
        for wave, slope in waves:
            phi = w * wave
            scale = 1.0 / math.sqrt(row_s * float(phi @ phi))
            lines.append(f)
            value.append(scale * phi)
            first.append(scale * (d1 * wave + nu * w * slope))
            second.append(scale * (d2 * wave + 2.0 * nu * d1 * slope - nu**2 * phi))
    return TestFunctions(np.array(lines), np.array(value), np.array(first), np.array(second))


test_functions.__test__ = False  # type: ignore[attr-defined]


@dataclass(frozen=True)
class Projected:
    """The linear equations of one recording: ``lhs[j, axis] = sum_k regressor[j, k] * coefficient[axis, k]``.

    Parameters
    ----------
    frequency_hz : ndarray, shape (m,)
        Line of each equation.
    lhs : ndarray, shape (m, 2), complex
        L[V_x], L[V_y] [V/s].
    pick, drive, drive_rate : ndarray, shape (m, 2), complex
        V, u, L[u]: regressors of A, G~ and E.
    body : ndarray, shape (m,), complex
        Projected volts of the body excitation.
    drift : ndarray, shape (m, 2), complex
        Projected V times time over the record, from -1 to 1: regressor of a resonance that moves steadily [V sqrt(s)].
    cubic : ndarray, shape (m, 2), complex
        Projected |V|^2 V of each axis [V^3].
    gram : ndarray, shape (m, m)
        Inner products of the test functions: correlation of their noise.
    warm_pick, warm_drive : ndarray, shape (m, 2), complex
        Projected V and u times how much warmer than the campaign's mean it was: regressors of what moves with temperature [V K sqrt(s)].
    """

    frequency_hz: FloatArray
    lhs: ComplexArray
    pick: ComplexArray
    drive: ComplexArray
    drive_rate: ComplexArray
    body: ComplexArray
    drift: ComplexArray
    cubic: ComplexArray
    gram: FloatArray
    warm_pick: ComplexArray
    warm_drive: ComplexArray


def project(
    recording: Recording,
    frequencies_hz: list[float],
    omega0_rad_s: float,
    decay_rate: float,
    resonance_shift_rad_s: FloatArray | float = 0.0,
    warmth_k: FloatArray | float = 0.0,
) -> Projected:
    """Project a recording on its lines.

    Parameters
    ----------
    recording : Recording
        One segment. ``extras`` may hold ``dac_zero_order_hold_s`` and ``firmware_drive_phase_advance_rad``.
    frequencies_hz : list of float
        Side-band lines; 0 is the carrier itself.
    omega0_rad_s : float
        Frequency about which A and G are written.
    decay_rate : float
        Rough 1/tau [1/s], for the small term C p'/(2 i omega0).
    resonance_shift_rad_s : float or ndarray, shape (n,)
        How far the resonance is known to have moved at each row (temperature) [rad/s].
    warmth_k : float or ndarray, shape (n,)
        Temperature of each row above the one that the estimate is for [K].
    """
    t, row_s = recording.t, 1.0 / recording.sample_rate_hz
    f = test_functions(t, row_s, frequencies_hz)
    omega = recording.ref_omega_rad_s
    volts = recording.pick
    drive = recording.drive * hold_factor(recording, omega, omega0_rad_s)[:, None]
    stretch, creep = (c[:, None] for c in moving_reference(omega, row_s, omega0_rad_s))
    detuning = ((omega**2 - omega0_rad_s**2) / (2.0 * omega0_rad_s) - resonance_shift_rad_s)[:, None]
    slow = (omega - omega0_rad_s)[:, None] / (2.0 * omega0_rad_s)
    delay = hold_delay(recording, omega0_rad_s)

    def rate(signal: ComplexArray) -> ComplexArray:
        # L: by parts, phi p' -> -phi' p, phi p'' -> phi'' p, phi (omega p' + omega' p / 2) -> -phi' omega p - phi omega' p / 2
        first = -_sums(f.first, stretch * signal) + _sums(f.second - 2.0 * decay_rate * f.first, signal) / (2j * omega0_rad_s)
        return row_s * (first + _sums(f.value, (1j * detuning + 2.0 * decay_rate * slow - creep) * signal))

    body = recording.command.excitation.volts if recording.command.excitation.kind == "body" else 0.0
    warmth = np.broadcast_to(warmth_k, t.shape)[:, None]
    return Projected(
        frequency_hz=f.frequency_hz,
        lhs=rate(volts),
        pick=row_s * _sums(f.value, volts),
        drive=row_s * (_sums(f.value, drive) + delay * _sums(f.first, drive)),
        drive_rate=rate(recording.drive),
        body=row_s * f.value.sum(axis=1) * complex(body),
        drift=row_s * _sums(f.value, np.linspace(-1.0, 1.0, t.size)[:, None] * volts),
        cubic=row_s * _sums(f.value, np.abs(volts) ** 2 * volts),
        gram=row_s * (f.value @ f.value.T),
        warm_pick=row_s * _sums(f.value, warmth * volts),
        warm_drive=row_s * _sums(f.value, warmth * drive),
    )


def moving_reference(omega_rad_s: FloatArray, row_s: float, omega0_rad_s: float) -> tuple[FloatArray, FloatArray]:
    """What multiplies ``-phi' p`` and ``-phi p`` when ``(omega p' + omega' p / 2)/omega0`` is integrated by parts: omega/omega0 and
    omega'/2 omega0 [1/s].

    The one derivative of data: that of the reference, which is smooth. A wave that turns while it warms up shows it: without this term a
    ramp of 3 Hz at 5 kHz and 0.26 rad/s of precession leave 4e-5 rad/s.
    """
    slope = np.gradient(omega_rad_s, row_s) if omega_rad_s.size > 1 else np.zeros(1)
    return omega_rad_s / omega0_rad_s, slope / (2.0 * omega0_rad_s)


def _sums(functions: FloatArray, signal: ComplexArray) -> ComplexArray:
    """``functions @ signal`` of real (m, n) and complex (n, k) without making the functions complex: a third of the time."""
    parts = np.ascontiguousarray(signal, dtype=np.complex128).view(np.float64)
    return np.asarray(np.ascontiguousarray(functions @ parts).view(np.complex128))


def hold_delay(recording: Recording, omega0_rad_s: float) -> complex:
    """By how much a held drive is late [s], its imaginary part what the slope of the hold's gain makes of an envelope that changes.

    ``sinc((omega + d) h / 2 pi) e^{-i (omega + d) h/2}`` with d = -i d/dt of the envelope: half the hold, and i times the gain's relative
    slope. A wave that precesses shows the latter: at 22 kHz and 5 kHz it is 5e-6 s.
    """
    hold = float(recording.extras.get("dac_zero_order_hold_s", 0.0) or 0.0)
    x = 0.5 * omega0_rad_s * hold
    return 0.5 * hold * (1.0 + 1j * (1.0 / math.tan(x) - 1.0 / x)) if x > 0.0 else 0j


def hold_factor(recording: Recording, omega: FloatArray, omega0_rad_s: float) -> ComplexArray:
    """Drive that acts over drive that is recorded, relative to the one at ``omega0``: zero-order hold against the firmware's phase advance.

    The hold of length h gives sinc(omega h / 2 pi) e^{-i omega h/2}; a firmware that advances the phase by a constant takes it back only at
    its own frequency, which matters off resonance (feedthrough, body excitation).
    """
    hold = float(recording.extras.get("dac_zero_order_hold_s", 0.0) or 0.0)
    if hold <= 0.0:
        return np.ones_like(omega, dtype=complex)
    gain = np.sinc(omega * hold / (2.0 * math.pi)) / np.sinc(omega0_rad_s * hold / (2.0 * math.pi))
    advance = recording.extras.get("firmware_drive_phase_advance_rad")
    if advance is None:
        return np.asarray(gain + 0j)
    return np.asarray(gain * np.exp(-0.5j * (omega - omega0_rad_s) * hold))
