"""The time-domain alternative of document 000: integrate the sensor over every recording and compare the pick-offs at all time instants.

The same 15 parameters, the same positions given measured drives, the same minimiser as :mod:`.document_fit`; only "the sum must be over all
time instants in the data set, which is part of the reason why computation time is so vast". As one would write it: a compiled integrator of
the slow flow (:func:`integrate`) and derivatives by finite differences, one integration of every recording per parameter and iteration.

``p' = A p + G u`` on the smooth reference of the data table, with two corrections that make it the exact envelope equation to second order
in 1/omega0 (theory.md Eq. 3 alone is good to some 7 deg/h on the diagonal): ``A - A^2/(2 i omega0)``, ``G - A G/(2 i omega0)`` and the
drive taken ``h/2 + 1/(2 i omega0)`` earlier, h the zero-order hold. A recording starts from its first measured positions; what is wrong
with them is forgotten within some decay times, which are integrated but not compared.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..errors import CalibrationRefused
from ..jit import kernel
from ..recording.recording import Recording
from .document_model import FIRST_FIFTEEN, DocumentModel
from .levenberg import levenberg_marquardt
from .sideband_table import sideband_table, smooth_reference

__all__ = ["TimeDomainEstimate", "integrate", "time_domain_fit"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: decay times that are integrated but not compared
_FORGET = 7.0
#: finite-difference step as a share of the scale of each parameter
_STEP = 1e-6


@dataclass(frozen=True)
class TimeDomainEstimate:
    """Outcome of :func:`time_domain_fit`.

    Parameters
    ----------
    model : DocumentModel
        Meaning of the parameters; the oscillator's detuning of every recording comes from its carrier, as in the frequency domain.
    values, covariance : ndarray, shape (15,), (15, 15)
        Covariance from the spectrum of the residuals, which are far from white.
    residual_v : float
        Root mean square of the residuals [V].
    instants : int
        Complex positions compared.
    integrations : int
        Integrations of the whole data set.
    converged : bool
    """

    model: DocumentModel
    values: FloatArray
    covariance: FloatArray
    residual_v: float
    instants: int
    integrations: int
    converged: bool


@kernel
def integrate(start, step, weights, drive, out):  # type: ignore[no-untyped-def]
    """Advance ``p[k + 1] = step p[k] + sum_j weights[j] u[k - 1 + j]`` over a recording, in place.

    Parameters
    ----------
    start : ndarray, shape (2,), complex
        p at row 1.
    step : ndarray, shape (2, 2), complex
        Propagator of one row.
    weights : ndarray, shape (4, 2, 2), complex
        What the drives of four neighbouring rows add (see :func:`row_propagator`).
    drive : ndarray, shape (n, 2), complex
        [V].
    out : ndarray, shape (n, 2), complex
        p at every row [V]; rows 0 and n - 1 are left as they are.
    """
    x, y = start[0], start[1]
    out[1, 0], out[1, 1] = x, y
    s00, s01, s10, s11 = step[0, 0], step[0, 1], step[1, 0], step[1, 1]
    for k in range(1, drive.shape[0] - 2):
        fx, fy = 0j, 0j
        for j in range(4):
            u, v = drive[k - 1 + j, 0], drive[k - 1 + j, 1]
            fx += weights[j, 0, 0] * u + weights[j, 0, 1] * v
            fy += weights[j, 1, 0] * u + weights[j, 1, 1] * v
        x, y = s00 * x + s01 * y + fx, s10 * x + s11 * y + fy
        out[k + 1, 0], out[k + 1, 1] = x, y


def row_propagator(A: ComplexArray, G: ComplexArray, row_s: float) -> tuple[ComplexArray, ComplexArray]:
    """Exact propagator of one row, and the weights of four neighbouring drives: the drive is the cubic through them.

    Returns
    -------
    step : ndarray, shape (2, 2)
    weights : ndarray, shape (4, 2, 2)
    """
    X = A * row_s
    # moments: integral over the row of exp(A (T - t)) (t/T)^m dt = T sum_i X^i m!/(m + i + 1)!
    moments = np.zeros((4, 2, 2), dtype=complex)
    power = np.eye(2, dtype=complex)
    step = np.zeros((2, 2), dtype=complex)
    for i in range(12):
        step += power / math.factorial(i)
        for m in range(4):
            moments[m] += power * (row_s * math.factorial(m) / math.factorial(m + i + 1))
        power = power @ X
    # Lagrange cubic through the rows at -1, 0, 1, 2: coefficients of 1, s, s^2, s^3 by row
    cubic = np.array([[0.0, -1 / 3, 1 / 2, -1 / 6], [1.0, -1 / 2, -1.0, 1 / 2], [0.0, 1.0, 1 / 2, -1 / 2], [0.0, -1 / 6, 0.0, 1 / 6]])
    return step, np.asarray(np.einsum("jm,mab,bc->jac", cubic, moments, G))


@dataclass(frozen=True)
class _Series:
    """One recording, ready to integrate; ``place`` is its number among the loop recordings, ``axis`` its oscillator."""

    pick: ComplexArray
    recorded: ComplexArray
    acting: ComplexArray
    row_s: float
    place: int
    axis: int
    first: int


def time_domain_fit(
    recordings: list[Recording], start: FloatArray, *, feedforward: ComplexArray | None = None, tolerance: float = 1e-8
) -> TimeDomainEstimate:
    """Fit the 15 parameters to the pick-offs at every row, all weights alike.

    Parameters
    ----------
    recordings : list of Recording
        Side bands with x and with y as the oscillator (loops-off recordings are not used).
    start : ndarray, shape (15,)
        In the order of :data:`.document_model.FIRST_FIFTEEN`.
    feedforward : ndarray, shape (2, 2), complex, optional
        E, removed from the pick-offs first.
    tolerance : float
        See :func:`.levenberg.levenberg_marquardt`.

    Raises
    ------
    CalibrationRefused
        An axis that never oscillated, or recordings that are too short.
    """
    loops = [r for r in recordings if r.command.oscillator_axis]
    model = DocumentModel(sideband_table(loops), fit_feedforward=False, feedforward=feedforward)
    series = [_series(r, place, model, float(start[FIRST_FIFTEEN.index("b_x")])) for place, r in enumerate(loops)]
    counts = np.concatenate([[0], np.cumsum([4 * (s.pick.shape[0] - 2 - s.first) for s in series])])
    # sizes of the parameters: forcers and damping as they start, cross terms like the damping
    scale = np.abs(start).copy()
    damping = float(np.mean(start[8:10]))
    scale[:8] = float(np.max(scale[:8]))
    scale[8:12], scale[12:14], scale[14] = damping, damping * 2.0 * model.omega0, 1.0
    runs = 0

    def residual(theta: FloatArray) -> FloatArray:
        nonlocal runs
        runs += 1
        left = np.empty(counts[-1])
        for s, a, b in zip(series, counts[:-1], counts[1:], strict=True):
            left[a:b] = _residual(model, theta, s).view(np.float64).ravel()
        return left

    def evaluate(theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        here = residual(theta)
        jacobian = np.empty((here.size, theta.size))
        for i in range(theta.size):
            moved = theta.copy()
            moved[i] += _STEP * scale[i]
            jacobian[:, i] = (residual(moved) - here) / (_STEP * scale[i])
        return here, jacobian

    fit = levenberg_marquardt(evaluate, start, tolerance=tolerance)
    here, jacobian = evaluate(fit.parameters)
    covariance = _sandwich(here, jacobian, fit.covariance, counts)
    return TimeDomainEstimate(
        model=model,
        values=fit.parameters,
        covariance=covariance,
        residual_v=float(np.sqrt(2.0 * np.mean(here**2))),
        instants=here.size // 2,
        integrations=runs,
        converged=fit.converged,
    )


def _series(recording: Recording, place: int, model: DocumentModel, damping: float) -> _Series:
    pick, drive, _ = smooth_reference(recording)
    row_s = 1.0 / recording.sample_rate_hz
    row = model.loops[place]
    slope = np.gradient(drive, row_s, axis=0)
    earlier = 0.5 * row.hold_s + 1.0 / (2j * model.omega0)
    first = math.ceil(_FORGET * 2.0 / damping / row_s)
    if pick.shape[0] < 2 * first:
        raise CalibrationRefused(
            f"Recording {row.label} must last some {2 * first * row_s:.1f} s in the time domain (its start is forgotten in half of that), "
            f"but got {recording.duration_s:.1f} s."
        )
    return _Series(pick, drive, (drive - earlier * slope) * row.hold(0.0, model.omega0), row_s, place, "xy".index(row.axis), first)


def _residual(model: DocumentModel, theta: FloatArray, series: _Series) -> ComplexArray:
    """Measured minus integrated pick-offs of one recording, (rows compared, 2)."""
    G, E, _ = model.matrices(np.ascontiguousarray(theta))
    A, inertia = model.flow_of(theta, series.place)
    A, G = np.asarray(np.linalg.solve(inertia, A), dtype=complex), np.asarray(np.linalg.solve(inertia, G), dtype=complex)
    second = 1.0 / (2j * model.omega0)
    step, weights = row_propagator(A - second * A @ A, G - second * A @ G, series.row_s)
    p = series.pick - series.recorded @ E.T
    out = np.empty_like(p)
    integrate(p[1], step, weights, series.acting, out)
    inner = slice(series.first, p.shape[0] - 2)
    return np.ascontiguousarray(p[inner] - out[inner])


def _sandwich(residual: FloatArray, jacobian: FloatArray, inverse: FloatArray, counts: NDArray[np.int_]) -> FloatArray:
    """Covariance of an unweighted fit whose residuals are coloured: their spectrum weighs the squares of the Jacobian's, per channel."""
    middle = np.zeros_like(inverse)
    for a, b in pairwise(counts):
        errors, slopes = residual[a:b].reshape(-1, 4), jacobian[a:b].reshape((b - a) // 4, 4, -1)
        window = np.hanning(errors.shape[0])[:, None]
        for channel in range(4):
            power = np.abs(np.fft.rfft(errors[:, channel] * window[:, 0])) ** 2 / float(np.sum(window**2))
            smooth = np.convolve(np.pad(power, 4, mode="reflect"), np.full(9, 1 / 9), mode="valid")
            lines = np.fft.rfft(slopes[:, channel], axis=0)
            share = np.full(smooth.size, 2.0)
            share[0] = 1.0
            middle += np.real(lines.conj().T @ (lines * (share * smooth)[:, None])) / errors.shape[0]
    return np.asarray(inverse @ middle @ inverse)
