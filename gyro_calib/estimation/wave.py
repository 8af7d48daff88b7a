"""Wave coordinates of a recording: amplitude, azimuth, quadrature, phase, and the drives along and across the wave (theory.md section 3).

``p = e^{i delta}(a n - i q n_perp)``, n = (cos psi, sin psi), psi = 2 theta: document 004's E, Q, L, M in closed form, because
``p . p = (a^2 - q^2) e^{2 i delta}`` holds whatever the azimuth. Drives in the same frame are ``u = e^{i delta}(u_par n + u_perp n_perp)``:
the amplitude loop drives Im u_par, virtual precession Im u_perp, the quadrature loop Re u_perp.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..recording.recording import Recording

__all__ = ["Wave", "smooth_angle", "wave_coordinates"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Wave:
    """One recording in wave coordinates, every array of shape (n,).

    Parameters
    ----------
    t : ndarray
        Device time [s].
    azimuth_rad : ndarray
        psi = 2 theta, unwrapped [rad].
    amplitude_v, quadrature_v : ndarray
        a and q [V].
    phase_rad : ndarray
        delta, of the wave against the reference, unwrapped [rad].
    drive_along, drive_across : ndarray, complex
        u_par and u_perp [V]; real part in phase with the displacement, imaginary part in phase with the velocity. As they acted.
    """

    t: FloatArray
    azimuth_rad: FloatArray
    amplitude_v: FloatArray
    quadrature_v: FloatArray
    phase_rad: FloatArray
    drive_along: ComplexArray
    drive_across: ComplexArray

    @property
    def theta_rad(self) -> FloatArray:
        """Mechanical azimuth, half of psi [rad]."""
        return 0.5 * self.azimuth_rad


def wave_coordinates(recording: Recording, *, commanded: bool = False) -> Wave:
    """Wave coordinates of every row.

    Parameters
    ----------
    recording : Recording
        A closed-loop recording: the wave must be there.
    commanded : bool
        Give the drives before the compensation matrix, as the loops command them, instead of after it, as they act.

    Raises
    ------
    DataError
        No vibration, or a compensation matrix that cannot be inverted.
    """
    pick, drive = recording.pick, recording.drive
    if commanded:
        matrix = np.asarray(recording.command.compensation, dtype=np.float64).reshape(2, 2)
        if abs(np.linalg.det(matrix)) < 1e-6:
            raise DataError(f"Compensation must be invertible, but got {recording.command.compensation!r}. Set another.")
        drive = drive @ np.linalg.inv(matrix).T
    square = np.sum(pick**2, axis=1)
    if np.any(square == 0.0):
        raise DataError(f"Recording {recording.label!r} must hold a vibration, but got zero volts. Wave coordinates need a wave.")
    phase = 0.5 * np.unwrap(np.angle(square))
    turned = pick * np.exp(-1j * phase)[:, None]
    azimuth = np.unwrap(np.arctan2(turned[:, 1].real, turned[:, 0].real))
    cos, sin = np.cos(azimuth), np.sin(azimuth)
    drive = drive * np.exp(-1j * phase)[:, None]
    return Wave(
        t=recording.t,
        azimuth_rad=azimuth,
        amplitude_v=np.hypot(turned[:, 0].real, turned[:, 1].real),
        quadrature_v=sin * turned[:, 0].imag - cos * turned[:, 1].imag,
        phase_rad=phase,
        drive_along=cos * drive[:, 0] + sin * drive[:, 1],
        drive_across=cos * drive[:, 1] - sin * drive[:, 0],
    )


def smooth_angle(angle_rad: FloatArray, rows: int) -> FloatArray:
    """An angle without its noise above about one over ``rows`` rows: three running means about a straight line, ends mirrored."""
    index = np.arange(angle_rad.size, dtype=np.float64)
    line = np.polyval(np.polyfit(index, angle_rad, 1), index) if angle_rad.size > 1 else angle_rad
    rest = angle_rad - line
    half = max(0, min(rows // 2, (angle_rad.size - 1) // 2))
    for _ in range(3 if half else 0):
        padded = np.concatenate([[0.0], np.cumsum(np.pad(rest, half, mode="reflect"))])
        rest = (padded[2 * half + 1 :] - padded[: -2 * half - 1]) / (2 * half + 1)
    return np.asarray(line + rest)
