"""Side-band transfer functions (document 000, Eqs. 11-18): from the table to H_xx, H_xy, H_yx, H_yy, with covariance.

With ``H(nu) = G_sensor(i (omega + nu))`` the baseband transfer function of both signs of nu,

    H_s = [H(nu) + H*(-nu)]/2,   H_c = [H(nu) - H*(-nu)]/2i                                                  (Eqs. 11, 12)
    O_s = H_s D_s - H_c D_c,     O_c = H_c D_s + H_s D_c      of every drive D and pick-off O              (Eqs. 13, 14)

summed over the primary and the secondary drive (Eqs. 15, 16). A pick-off gives two equations in four unknowns per run; the run with the
axes swapped gives two more: 4x4 systems for (H_xx, H_xy) and (H_yx, H_yy) (Eqs. 17, 18).

The document's demodulation is ``+ s sin``, this package's envelope ``c cos - s sin``: ``D_s`` above is minus the amplitude of the recorded
s column. In amplitudes of ``exp(+-i nu t)`` the 4x4 system falls into two 2x2 systems, one per sign; both forms are here and agree.

The four equations hold for one H: the two runs must refer to one frequency. Swapping the axes moves the reference by the split of the
resonances, so a direct comparison with a model asks for equal resonances; the fit (:mod:`.document_fit`) instead solves the same 4x4 system
for the measured and for the estimated pick-offs, which is exact for any split.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import CalibrationRefused
from .sideband_table import SidebandRow, circular_covariance

__all__ = [
    "PAIRS",
    "TransferFunctions",
    "demodulated",
    "drive_system",
    "from_signs",
    "pairs_of_runs",
    "respond",
    "solve_transfer_functions",
    "to_signs",
]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

#: order of the four transfer functions: pick-off, drive
PAIRS = ("xx", "xy", "yx", "yy")


def from_signs(plus: ComplexArray, minus: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """H_s, H_c from H(nu), H(-nu) (Eqs. 11, 12); any shape."""
    return 0.5 * (plus + minus.conj()), -0.5j * (plus - minus.conj())


def to_signs(sine: ComplexArray, cosine: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """H(nu), H(-nu) from H_s, H_c: inverse of :func:`from_signs`."""
    return sine + 1j * cosine, (sine - 1j * cosine).conj()


def demodulated(sides: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Document's sine and cosine amplitudes (D_s, D_c) of envelopes given by sign, (2, …) -> (…), (…)."""
    plus, minus = sides[0], sides[1].conj()
    return 0.5j * (plus - minus), 0.5 * (plus + minus)


def respond(H_s: ComplexArray, H_c: ComplexArray, D_s: ComplexArray, D_c: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """O_s, O_c of one pick-off to one drive (Eqs. 13, 14); the sum over drives is Eqs. 15, 16."""
    return H_s * D_s - H_c * D_c, H_c * D_s + H_s * D_c


def drive_system(direct: ComplexArray, swapped: ComplexArray) -> ComplexArray:
    """4x4 matrix of Eqs. 17, 18 from the drives of both runs, each (2, 2) by (sign, axis).

    Rows O_s, O_c of the direct run, then of the swapped one; unknowns (H_ax_s, H_ax_c, H_ay_s, H_ay_c).
    """
    rows = []
    for run in (direct, swapped):
        D_s, D_c = demodulated(run)
        rows.append([D_s[0], -D_c[0], D_s[1], -D_c[1]])
        rows.append([D_c[0], D_s[0], D_c[1], D_s[1]])
    return np.array(rows)


@dataclass(frozen=True)
class TransferFunctions:
    """The four side-band transfer functions at one frequency.

    Parameters
    ----------
    frequency_hz : float
        nu / 2 pi.
    sine, cosine : ndarray, shape (2, 2), complex
        H_s, H_c, (pick-off, drive).
    covariance : ndarray, shape (16, 16)
        Of (re, im) of (H_s, H_c) of each of :data:`PAIRS`: noise of the pick-offs that the drives do not explain, from neighbouring
        frequencies.
    condition_number : float
        Of the 4x4 system.
    """

    frequency_hz: float
    sine: ComplexArray
    cosine: ComplexArray
    covariance: FloatArray
    condition_number: float

    @property
    def signs(self) -> ComplexArray:
        """H(nu), H(-nu), shape (2, 2, 2): (sign, pick-off, drive)."""
        return np.stack(to_signs(self.sine, self.cosine))


def pairs_of_runs(table: list[SidebandRow]) -> list[tuple[SidebandRow, SidebandRow]]:
    """Direct (x oscillates) and swapped (y oscillates) recordings of the same side band, in order of recording."""
    pairs = []
    waiting: dict[tuple[float, str], list[SidebandRow]] = {}
    for row in table:
        if not row.axis or row.frequency_hz == 0.0:
            continue
        key = (round(row.frequency_hz, 9), row.kind)
        partners = waiting.setdefault(key, [])
        if partners and partners[0].axis != row.axis:
            other = partners.pop(0)
            pairs.append((row, other) if row.axis == "x" else (other, row))
        else:
            partners.append(row)
    return pairs


def solve_transfer_functions(
    direct: SidebandRow, swapped: SidebandRow, feedforward: ComplexArray | None = None, *, omega0_rad_s: float | None = None
) -> TransferFunctions:
    """Solve Eqs. 17, 18.

    Parameters
    ----------
    direct, swapped : SidebandRow
        The same side band with x and with y as the oscillator.
    feedforward : ndarray, shape (2, 2), complex, optional
        E, removed from the pick-offs first (document 000: "from the position signal rather than from the force rebalance").
    omega0_rad_s : float, optional
        Frequency at which the drive gain is stated (default: the reference of the direct run).

    Raises
    ------
    CalibrationRefused
        Runs of different frequencies, or of the same drive.
    """
    if abs(direct.frequency_hz - swapped.frequency_hz) > 1e-9:
        raise CalibrationRefused(
            f"Runs must have the same side band, but got {direct.frequency_hz!r} and {swapped.frequency_hz!r} Hz "
            f"({direct.label}, {swapped.label})."
        )
    E = np.zeros((2, 2), dtype=complex) if feedforward is None else feedforward
    omega0 = direct.omega_rad_s if omega0_rad_s is None else omega0_rad_s
    drives = [r.acting_drive(omega0) for r in (direct, swapped)]
    system = drive_system(drives[0], drives[1])
    if np.linalg.cond(system) > 1e8:
        raise CalibrationRefused(
            f"Runs {direct.label} and {swapped.label} must be driven differently, but their 4x4 system is singular. Swap the axes."
        )
    inverse = np.asarray(np.linalg.inv(system), dtype=complex)
    sine, cosine = np.empty((2, 2), dtype=complex), np.empty((2, 2), dtype=complex)
    for axis in range(2):
        outputs: list[ComplexArray] = []
        for row in (direct, swapped):
            outputs += demodulated((row.pick - row.drive @ E.T)[:, axis])
        H = inverse @ np.array(outputs)
        sine[axis], cosine[axis] = H[0::2], H[1::2]
    signs = np.stack(to_signs(sine, cosine))
    return TransferFunctions(
        frequency_hz=direct.frequency_hz,
        sine=sine,
        cosine=cosine,
        covariance=_covariance(direct, swapped, E, signs, inverse),
        condition_number=float(np.linalg.cond(system)),
    )


def _covariance(direct: SidebandRow, swapped: SidebandRow, E: ComplexArray, signs: ComplexArray, inverse: ComplexArray) -> FloatArray:
    """Noise of what the drives do not explain, through the inverse of the 4x4 system."""
    covariance = np.zeros((16, 16))
    for run, row in enumerate((direct, swapped)):
        # feedback correlates drives and pick-offs: only the remainder of the relation is noise
        pick, drive = row.quiet_pick[row.near], row.quiet_drive[row.near]
        remainder = pick - drive @ E.T - np.einsum("sab,qsb->qsa", signs, drive)
        through = np.empty((remainder.shape[0], 8), dtype=complex)
        for axis in range(2):
            O_s, O_c = demodulated(np.moveaxis(remainder[:, :, axis], 1, 0))
            through[:, 4 * axis : 4 * axis + 4] = np.stack([O_s, O_c], axis=1) @ inverse[:, 2 * run : 2 * run + 2].T
        # (s, c) of the x drive, (s, c) of the y drive: already the order of PAIRS
        covariance += circular_covariance(through)
    return covariance
