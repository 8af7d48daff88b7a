"""Document 004's own method: precession rates under virtual precession of both senses, their difference and their sum.

With u_vir along u_perp_s of theory.md Eq. 6, a = tan 2 delta, b = tan 2 lambda and angles in 4 theta (document 004, Eqs. 30-35, signs as
in theory.md
section 6):

    theta' = rate_H(theta) + k_vir [u_amp (b + dG/2 sin 4theta + a cos 4theta) + u_vir (1 + dG/2 + dG/2 cos 4theta - a sin 4theta)]
    difference = 2 k_vir u_vir (1 + dG/2 + dG/2 cos 4theta - a sin 4theta)        ->  k_vir, dG, 2 delta
    sum        = 2 rate_H + 2 k_vir u_amp (b + dG/2 sin 4theta + a cos 4theta)     ->  2 lambda from its mean over whole periods of 4 theta

As the document has it, u_amp is a constant. It is not: it carries 4 theta itself and differs between the two senses (k_va of Eq. 30), which
costs 3.3e-4 in the difference's constant; ``recorded=True`` takes both from the recorded u_amp(theta). The complete estimate, which also
uses
the amplitude and quadrature equations and exact trigonometry, is :mod:`.whole_angle_fit`.

dG, 2 delta, 2 lambda are those *seen* by the controller (:mod:`.drive_chain`): what a compensation needs.

A constant rate Omega adds -kappa Omega to the sum and passes for ``tan 2 lambda = -kappa Omega tau`` (u_amp/a = 1/(g tau) whatever the
amplitude,
so a second amplitude does not help): the earth's rate and tau = 560 s make 0.022 rad, as much as the document's whole 2 lambda. Handled
by a known
rate, by a pair of orientations (:func:`orientation_pair`), or by the complete fit, where u_amp under +/- u_vir and ring-down tell them
apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import CalibrationRefused
from ..quantity import Quantity
from ..recording.recording import Recording
from .drive_chain import DriveChain
from .wave import smooth_angle, wave_coordinates

__all__ = [
    "AzimuthFit",
    "PrecessionErrors",
    "azimuth_fit",
    "difference_and_sum",
    "orientation_pair",
    "rate_as_two_lambda",
    "virtual_precession_gain",
    "volts_for",
]

FloatArray = NDArray[np.float64]
#: a wave that turns by less than one period of 4 theta (pi in psi) has no mean over it
_PERIOD_RAD = math.pi
_SMOOTH_S = 0.2
#: blocks of a recording whose steps are fitted
_BLOCKS = 80


@dataclass(frozen=True)
class AzimuthFit:
    """Precession over whole periods of 4 theta: ``theta' = mean + cos cos 4theta + sin sin 4theta`` (and a second harmonic, not kept).

    Parameters
    ----------
    coefficients : ndarray, shape (3,)
        mean, cos, sin [rad/s]; the mean is over the azimuth, not over time.
    covariance : ndarray, shape (3, 3)
    periods : int
        Whole periods of 4 theta used.
    volts : float
        Virtual precession [V].
    amplitude_drive : ndarray, shape (3,)
        u_amp(theta): mean, cos, sin [V].
    """

    coefficients: FloatArray
    covariance: FloatArray
    periods: int
    volts: float
    amplitude_drive: FloatArray


def azimuth_fit(recording: Recording) -> AzimuthFit:
    """Fit the precession of one recording against its azimuth, by the angle turned (not by a derivative of noisy samples).

    Raises
    ------
    CalibrationRefused
        The wave turned by less than a period of 4 theta.
    """
    wave = wave_coordinates(recording, commanded=True)
    rows = _whole_periods(wave.azimuth_rad)
    turned = abs(float(wave.azimuth_rad[rows][-1] - wave.azimuth_rad[rows][0]))
    periods = round(turned / _PERIOD_RAD)
    if periods < 1:
        raise CalibrationRefused(
            f"Wave of {recording.label or 'the recording'} must turn by a period of 4 theta (90 deg), but turned by "
            f"{math.degrees(0.5 * float(np.ptp(wave.azimuth_rad))):.3g} deg. Record longer, or with more virtual precession."
        )
    row_s = 1.0 / recording.sample_rate_hz
    angle = 2.0 * smooth_angle(wave.azimuth_rad, round(_SMOOTH_S * recording.sample_rate_hz))[rows]
    basis = _harmonics(angle, 2)
    # drives turn a wave by volts over amplitude, and that follows 4 theta as far as its loop is slow (5e-5 at 8 deg/s)
    amplitude = wave.amplitude_v[rows]
    flow = basis * (amplitude.mean() / amplitude)[:, None]
    passed = np.vstack([np.zeros(basis.shape[1]), np.cumsum(0.5 * row_s * (flow[1:] + flow[:-1]), axis=0)])
    design, turn = _steps(passed), _steps(wave.theta_rad[rows])
    solution, *_ = np.linalg.lstsq(design, turn, rcond=None)
    covariance = _correlated(design, turn - design @ solution)
    drive, *_ = np.linalg.lstsq(basis, wave.drive_along.imag[rows], rcond=None)
    return AzimuthFit(
        np.asarray(solution[:3], dtype=np.float64),
        covariance[:3, :3],
        periods,
        recording.command.setpoints.virtual_precession_v,
        np.asarray(drive[:3], dtype=float),
    )


def _whole_periods(azimuth_rad: FloatArray) -> slice:
    """Rows from the first one on over as many whole periods of 4 theta as the wave made."""
    turned = np.abs(azimuth_rad - azimuth_rad[0])
    count = int(turned[-1] / _PERIOD_RAD)
    return slice(0, int(np.argmax(turned >= count * _PERIOD_RAD)) + 1 if count else turned.size)


def _harmonics(angle: FloatArray, count: int) -> FloatArray:
    """1, cos, sin, cos 2, sin 2, … of an angle, shape (n, 1 + 2 count)."""
    waves = [f(k * angle) for k in range(1, count + 1) for f in (np.cos, np.sin)]
    return np.column_stack([np.ones_like(angle), *waves])


def _steps(values: FloatArray) -> FloatArray:
    """Steps between the means of neighbouring blocks: forces make the angle walk at random, so that only its steps are independent."""
    width = max(1, len(values) // _BLOCKS)
    count = len(values) // width
    return np.diff(values[: count * width].reshape(count, width, *values.shape[1:]).mean(axis=1), axis=0)


def _correlated(design: FloatArray, residual: FloatArray) -> FloatArray:
    """Covariance of a least-squares solution whose residuals are correlated with their neighbours (they share a block)."""
    inverse = np.linalg.inv(design.T @ design)
    scores = design * residual[:, None]
    total = scores.T @ scores
    for lag in (1, 2):
        near = scores[lag:].T @ scores[:-lag]
        total += (1.0 - lag / 3.0) * (near + near.T)
    spare = len(residual) / max(len(residual) - design.shape[1], 1)
    return np.asarray(spare * inverse @ total @ inverse)


@dataclass(frozen=True)
class PrecessionErrors:
    """What the difference and the sum give.

    Parameters
    ----------
    chain : DriveChain
        dG, 2 delta, 2 lambda as the controller sees them.
    covariance : ndarray, shape (3, 3)
        Of (dG, 2 delta, 2 lambda).
    k_vir : Quantity
        Precession theta' per volt of u_vir, of the x chain [rad/s/V].
    """

    chain: DriveChain
    covariance: FloatArray
    k_vir: Quantity


def difference_and_sum(
    forward: Recording, backward: Recording, *, recorded: bool = False, known_rate: Quantity | None = None, kappa: float = 0.0
) -> PrecessionErrors:
    """Drive-chain errors from one pair of recordings.

    Parameters
    ----------
    forward, backward : Recording
        Virtual precession with the same volts of opposite sign.
    recorded : bool
        Use u_amp(theta) as it was recorded; otherwise as the document does.
    known_rate : Quantity, optional
        The gyro's constant input rate [rad/s], where it is known (default: none, it passes for 2 lambda).
    kappa : float
        Angular gain, with ``known_rate``.

    Raises
    ------
    CalibrationRefused
        Volts that are not opposite, or a wave that turned by less than a period of 4 theta.
    """
    plus, minus = azimuth_fit(forward), azimuth_fit(backward)
    if plus.volts == 0.0 or abs(plus.volts + minus.volts) > 1e-6 * abs(plus.volts):
        raise CalibrationRefused(
            f"Virtual precession must be of opposite volts, but got {plus.volts:g} V and {minus.volts:g} V. Record a pair of both senses."
        )
    offset = 0.0 if known_rate is None else 0.5 * kappa * known_rate.value
    inputs = np.concatenate([plus.coefficients, minus.coefficients])

    def solved(values: FloatArray) -> FloatArray:
        return _solve(values[:3], values[3:], plus, minus, recorded, offset)

    covariance = np.zeros((6, 6))
    covariance[:3, :3], covariance[3:, 3:] = plus.covariance, minus.covariance
    here = solved(inputs)
    steps = np.diag(np.maximum(np.sqrt(np.diag(covariance)), 1e-15))
    jacobian = np.column_stack([(solved(inputs + h) - solved(inputs - h)) / (2.0 * h.sum()) for h in steps])
    spread = jacobian @ covariance @ jacobian.T
    if known_rate is not None:
        shift = rate_as_two_lambda(known_rate.sd, kappa, float(here[3]), 0.5 * float(plus.amplitude_drive[0] + minus.amplitude_drive[0]))
        spread[2, 2] += shift**2
    return PrecessionErrors(
        DriveChain(float(here[0]), float(here[1]), float(here[2])),
        spread[:3, :3],
        Quantity(float(here[3]), math.sqrt(spread[3, 3]), "rad/s/V"),
    )


def _solve(plus_rate: FloatArray, minus_rate: FloatArray, plus: AzimuthFit, minus: AzimuthFit, recorded: bool, offset: float) -> FloatArray:
    """(dG, 2 delta, 2 lambda, k_vir) from the harmonics of the two precession rates."""
    volts = plus.volts
    difference, total = plus_rate - minus_rate, plus_rate + minus_rate
    total = total + np.array([2.0 * offset, 0.0, 0.0])
    k = (difference[0] - difference[1]) / (2.0 * volts)
    delta_g, tan_delta = difference[1] / (k * volts), -difference[2] / (2.0 * k * volts)
    mean_drive = 0.5 * (plus.amplitude_drive[0] + minus.amplitude_drive[0])
    tan_lambda = total[0] / (2.0 * k * mean_drive)
    for _ in range(4 if recorded else 0):
        # k_av acts on u_amp as it was: its means over 4 theta, and its difference between the senses
        errors = np.array([tan_lambda, tan_delta, 0.5 * delta_g])
        by_sense = [_amplitude_part(fit.amplitude_drive, errors) for fit in (plus, minus)]
        difference = plus_rate - minus_rate - k * (by_sense[0] - by_sense[1])
        k = (difference[0] - difference[1]) / (2.0 * volts)
        delta_g, tan_delta = difference[1] / (k * volts), -difference[2] / (2.0 * k * volts)
        beside = by_sense[0][0] + by_sense[1][0] - 2.0 * tan_lambda * mean_drive
        tan_lambda = (total[0] / k - beside) / (2.0 * mean_drive)
    return np.array([delta_g, math.atan(tan_delta), math.atan(tan_lambda), k])


def _amplitude_part(drive: FloatArray, errors: FloatArray) -> FloatArray:
    """u_amp k_av: mean, cos, sin; ``errors`` = (b, a, dG/2) are the mean, cos and sin of k_av."""
    return np.array(
        [
            drive[0] * errors[0] + 0.5 * (drive[1] * errors[1] + drive[2] * errors[2]),
            drive[0] * errors[1] + drive[1] * errors[0],
            drive[0] * errors[2] + drive[2] * errors[0],
        ]
    )


def virtual_precession_gain(recordings: Sequence[Recording]) -> tuple[Quantity, Quantity]:
    """k_vir from three or more amplitudes of the same sign: slope of the mean precession over whole periods of 4 theta.

    Returns
    -------
    gain : Quantity
        Mean over the azimuth of theta' per volt [rad/s/V] (k_vir (1 + dG/2) of the document).
    drift : Quantity
        Precession at zero volts [rad/s].

    Raises
    ------
    CalibrationRefused
        Fewer than three amplitudes, or of both signs.
    """
    fits = [azimuth_fit(r) for r in recordings]
    volts = np.array([f.volts for f in fits])
    if len(set(np.round(volts, 9))) < 3 or np.any(volts * volts[0] <= 0.0):
        raise CalibrationRefused(
            f"Virtual precession must be of three amplitudes of the same sign, but got {', '.join(f'{v:g}' for v in volts) or 'none'} V."
        )
    rates = np.array([f.coefficients[0] for f in fits])
    sd = np.array([math.sqrt(f.covariance[0, 0]) for f in fits])
    design = np.column_stack([volts, np.ones_like(volts)]) / sd[:, None]
    covariance = np.linalg.inv(design.T @ design)
    solution = covariance @ (design.T @ (rates / sd))
    left = rates / sd - design @ solution
    scale = max(1.0, float(left @ left) / max(volts.size - 2, 1))
    spread = np.sqrt(scale * np.diag(covariance))
    return Quantity(float(solution[0]), float(spread[0]), "rad/s/V"), Quantity(float(solution[1]), float(spread[1]), "rad/s")


def volts_for(precession_rad_s: float, gain: Quantity) -> float:
    """Virtual precession drive for a precession theta' (document 004: 0.1 deg/s) [V]."""
    return precession_rad_s / gain.value


def rate_as_two_lambda(rate_rad_s: float, kappa: float, k_vir: float, amplitude_drive_v: float) -> float:
    """What a constant rate passes for: the 2 lambda [rad] that gives the same mean of the sum (``-kappa Omega tau``)."""
    return math.atan(-0.5 * kappa * rate_rad_s / (k_vir * amplitude_drive_v))


def orientation_pair(first: PrecessionErrors, turned: PrecessionErrors) -> tuple[Quantity, Quantity]:
    """2 lambda from two runs, the second with the sense axis turned about: the rate changes its sign, 2 lambda does not.

    Returns
    -------
    two_lambda : Quantity
        [rad].
    rate_part : Quantity
        What the rate of the first orientation passed for [rad].
    """
    sd = 0.5 * math.sqrt(first.covariance[2, 2] + turned.covariance[2, 2])
    mean = 0.5 * (first.chain.two_lambda + turned.chain.two_lambda)
    half = 0.5 * (first.chain.two_lambda - turned.chain.two_lambda)
    return Quantity(mean, sd, "rad"), Quantity(half, sd, "rad")
