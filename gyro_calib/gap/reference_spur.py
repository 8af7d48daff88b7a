"""A line that goes with the wave: a gain that swings, or the phase of the reference, which its frequency column does not say.

Side bands ``V+`` and ``V-`` of a carrier ``V0`` are those of a gain where ``V+ V- / V0^2`` is above zero, of a phase where it is below. A
phase-locked loop answers what it sees, and a drive of another phase pulls the motion as much as the damping lets it; the swing of the
reference is what all three leave, ``(d/dt + 1/tau) arg V + omega - omega0``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..recording.recording import Recording
from .parts import Linear
from .spectra import detrended, plain_records, steep_window

__all__ = ["phase_swing"]

ComplexArray = NDArray[np.complex128]
#: share of the wave that its mean must be: one that turns has no carrier of its own
_STANDS = 0.9
#: how well one record's side bands tell the swing beside the loops' filters, over itself
_FILTERS = 0.05
#: frequencies that are tried within a bin to both sides
_TRIED = 17


def phase_swing(recordings: Sequence[Recording], linear: Linear, frequency_hz: float) -> tuple[float, float] | None:
    """Amplitude of the reference's phase at a frequency and its sd [rad]; nothing where the line is a gain's or no wave stands still.

    Parameters
    ----------
    recordings : sequence of Recording
    linear : Linear
        By whose damping a drive of another phase pulls the motion.
    frequency_hz : float
        Of the line, to a bin of the longest record.
    """
    found, sign = [], 0.0
    for r in plain_records(recordings):
        axis = int(np.argmax(np.mean(np.abs(r.pick) ** 2, axis=0)))
        v = r.pick[:, axis]
        carrier = complex(v.mean())
        if abs(carrier) ** 2 < _STANDS * float(np.mean(np.abs(v) ** 2)):
            continue
        v = detrended(r.pick)[:, axis]
        near = frequency_hz + np.linspace(-1.0, 1.0, _TRIED) / r.duration_s
        f = float(max(near, key=lambda hz: abs(_line(r, v, hz)) + abs(_line(r, v, -hz))))
        above, below = _line(r, v, f) / carrier, _line(r, v, -f) / carrier
        sign += float((above * below).real)
        steered = 2.0 * _line(r, detrended(r.ref_omega_rad_s[:, None].astype(np.complex128))[:, 0], f)
        omega = 2.0 * np.pi * f
        phase = -1j * (above - np.conj(below))
        found.append(abs((1j * omega - linear.A[axis, axis].real) * phase + steered) / omega)
    if not found or sign >= 0.0:
        return None
    size = float(np.median(found))
    return size, float(np.hypot(1.253 * np.std(found) / np.sqrt(len(found)), _FILTERS * size))


def _line(r: Recording, x: ComplexArray, away_hz: float) -> complex:
    """Complex amplitude at a distance from the carrier."""
    window = steep_window(len(r))
    return complex((window * np.exp(-2j * np.pi * away_hz * (r.t - r.t[0]))) @ x / window.sum())
