"""What the plots show, prepared from results and recordings: plain arrays, no drawing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..quantity import Quantity
from ..recording.recording import Campaign
from ..units import DEG_H

__all__ = [
    "Convergence",
    "RateTrace",
    "Residuals",
    "ResponseRun",
    "averaged",
    "convergence_series",
    "residual_series",
    "response_runs",
]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_AXES = ("x", "y")


@dataclass(frozen=True)
class ResponseRun:
    """Side bands of one run: one oscillator axis.

    Parameters
    ----------
    axis : str
        Oscillator axis.
    frequency_hz : ndarray, shape (k,)
        Side-band frequency, negative below the carrier.
    direct : ndarray, shape (k,), complex
        Oscillator pick-off over oscillator drive [V/V].
    cross : ndarray, shape (k,), complex
        Rebalance drive of the other axis over oscillator pick-off [V/V].
    fit_frequency_hz : ndarray, shape (n,)
        Where the fitted model is drawn; empty when the parameters are not known.
    fit_direct, fit_cross : ndarray, shape (n,), complex
        The fitted model.
    """

    axis: str
    frequency_hz: FloatArray
    direct: ComplexArray
    cross: ComplexArray
    fit_frequency_hz: FloatArray
    fit_direct: ComplexArray
    fit_cross: ComplexArray


@dataclass(frozen=True)
class Residuals:
    """Residuals of one equation (oscillator axis and pick-off) over their standard deviation.

    Parameters
    ----------
    oscillator, pickoff : str
        Axes; oscillator ``""`` with loops off.
    frequency_hz : ndarray, shape (k,)
        Side-band frequency, 0 for the carrier.
    pull : ndarray, shape (k, 2)
        Real and imaginary part over sd.
    """

    oscillator: str
    pickoff: str
    frequency_hz: FloatArray
    pull: FloatArray


@dataclass(frozen=True)
class Convergence:
    """An estimate from growing subsets of the data.

    Parameters
    ----------
    time_s : ndarray, shape (k,)
        Duration of data used.
    value, sd : ndarray, shape (k,)
        Estimate in ``unit``.
    unit : str
        Display unit.
    reference : float
        What the value is compared with: the truth when known, else the last estimate.
    reference_is_truth : bool
        Which of the two.
    """

    time_s: FloatArray
    value: FloatArray
    sd: FloatArray
    unit: str
    reference: float
    reference_is_truth: bool


@dataclass(frozen=True)
class RateTrace:
    """A rate against time: ``time_s`` shape (k,), ``rate_deg_h`` shape (k,), means over ``window_s``."""

    time_s: FloatArray
    rate_deg_h: FloatArray
    window_s: float


def averaged(time_s: ArrayLike, rate_rad_s: ArrayLike, window_s: float = 1.0) -> RateTrace:
    """Means over whole windows; a window without samples is left out.

    Parameters
    ----------
    time_s : array_like, shape (n,)
        Device time [s].
    rate_rad_s : array_like, shape (n,)
        Rate [rad/s].
    window_s : float
        Window [s].
    """
    time, rate = np.asarray(time_s, dtype=float), np.asarray(rate_rad_s, dtype=float)
    if time.size == 0:
        return RateTrace(np.empty(0), np.empty(0), window_s)
    index = np.floor((time - time[0]) / window_s).astype(int)
    count = np.bincount(index)
    # the last window is rarely whole
    keep = count > 0.5 * count.max()
    total_rate, total_time = np.bincount(index, rate), np.bincount(index, time)
    return RateTrace(total_time[keep] / count[keep], total_rate[keep] / count[keep] / DEG_H, window_s)


def response_runs(campaign: Campaign, parameters: Mapping[str, Quantity]) -> tuple[ResponseRun, ...]:
    """Measured response by oscillator axis, with the fitted model where A and G are among ``parameters``.

    With ``V = p + E u`` held at zero on the other axis, theory.md Eq. 3 at side band ν reads ``(G + (iν - A) E) u = (iν - A) V``.
    """
    return tuple(run for axis in _AXES if (run := _response_run(campaign, axis, parameters)) is not None)


def residual_series(table: Iterable[Any]) -> tuple[Residuals, ...]:
    """Residuals over sd, one series per oscillator axis (``""``: loops off) and pick-off."""
    rows = list(table)
    result = []
    for oscillator in (*_AXES, ""):
        mine = [row for row in rows if row.axis == oscillator]
        for k, pickoff in enumerate(_AXES if mine else ()):
            frequency = np.array([row.frequency_hz for row in mine], dtype=float)
            residual = np.array([row.residual[k] for row in mine], dtype=complex)
            sd = np.array([row.sd[k] for row in mine], dtype=float)
            known = np.isfinite(sd) & (sd > 0.0)
            pull = np.stack([residual.real, residual.imag], axis=1)[known] / sd[known, None]
            result.append(Residuals(oscillator, pickoff, frequency[known], pull))
    return tuple(result)


def convergence_series(
    convergence: Sequence[Any], name: str, axis: str, scale: float, unit: str, truth: float | None = None
) -> Convergence | None:
    """Convergence of ``name`` (``"bias"`` or ``"scale_factor"``) of one oscillator axis in a display unit.

    Parameters
    ----------
    convergence : sequence of ConvergencePoint
        ``time_s``, ``bias`` {x, y}, ``scale_factor`` {x, y}.
    name, axis : str
        Which.
    scale : float
        Display units per SI unit.
    unit : str
        Display unit.
    truth : float or None
        In display units.

    Returns
    -------
    Convergence or None
        None when there are fewer than two estimates.
    """
    points = [(float(p.time_s), getattr(p, name)[axis]) for p in convergence if axis in getattr(p, name)]
    if len(points) < 2:
        return None
    value = np.array([q.value for _, q in points]) * scale
    return Convergence(
        time_s=np.array([t for t, _ in points]),
        value=value,
        sd=np.array([q.sd for _, q in points]) * abs(scale),
        unit=unit,
        reference=float(value[-1]) if truth is None else truth,
        reference_is_truth=truth is not None,
    )


def side_band_amplitudes(signals: ComplexArray, time_s: FloatArray, frequency_hz: float) -> ComplexArray:
    """Complex amplitudes at ``-f``, 0, ``+f`` of envelopes by linear least squares (document 000, step 6), with drift and second harmonic.

    Parameters
    ----------
    signals : ndarray, shape (n, channels), complex
        Envelopes.
    time_s : ndarray, shape (n,)
        Time [s].
    frequency_hz : float
        Side-band frequency; 0 fits the carrier alone.

    Returns
    -------
    ndarray, shape (3, channels)
        Amplitudes; zero at ``-f`` and ``+f`` when ``frequency_hz`` is 0.
    """
    time = time_s - time_s.mean()
    columns = [np.ones_like(time, dtype=complex), time / max(float(np.ptp(time)), 1e-12) + 0j]
    if frequency_hz > 0.0:
        columns += [np.exp(2j * np.pi * k * frequency_hz * time) for k in (-1, 1, -2, 2)]
    found = np.linalg.lstsq(np.stack(columns, axis=1), signals, rcond=None)[0]
    sides = found[2:4] if frequency_hz > 0.0 else np.zeros((2, signals.shape[1]), dtype=complex)
    return np.stack([sides[0], found[0], sides[1]])


def _response_run(campaign: Campaign, axis: str, parameters: Mapping[str, Quantity]) -> ResponseRun | None:
    """One oscillator axis; None without side bands."""
    i = _AXES.index(axis)
    points: list[tuple[float, complex, complex]] = []
    for recording in campaign:
        excitation = recording.command.excitation
        if recording.command.oscillator_axis != axis or excitation.kind != "amplitude_modulation":
            continue
        f = excitation.frequency_hz
        pick = side_band_amplitudes(recording.pick, recording.t, f)[:, i]
        drive = side_band_amplitudes(recording.drive, recording.t, f)
        points += [(sign * f, pick[k] / drive[k, i], drive[k, 1 - i] / pick[k]) for k, sign in ((0, -1.0), (2, 1.0))]
    if not points:
        return None
    points.sort(key=lambda point: point[0])
    frequency = np.array([point[0] for point in points])
    direct, cross = (np.array([point[k] for point in points], dtype=np.complex128) for k in (1, 2))
    return ResponseRun(axis, frequency, direct, cross, *_fitted_response(parameters, i, frequency))


def _fitted_response(parameters: Mapping[str, Quantity], i: int, measured_hz: FloatArray) -> tuple[FloatArray, ComplexArray, ComplexArray]:
    """Model of ``direct`` and ``cross`` on a fine grid over the measured span."""
    A, G, E = (_matrix(parameters, name) for name in "AGE")
    if A is None or G is None:
        return np.empty(0), np.empty(0, dtype=complex), np.empty(0, dtype=complex)
    E = np.zeros((2, 2), dtype=complex) if E is None else E
    grid: FloatArray = np.linspace(float(measured_hz.min()), float(measured_hz.max()), 241)
    # the phase loop holds the oscillator at resonance, so the detuning is the imaginary part of its own A
    detuned = A - 1j * A[i, i].imag * np.eye(2)
    force = 2j * np.pi * grid[:, None, None] * np.eye(2) - detuned
    needed = np.asarray(np.linalg.solve(G + force @ E, force[:, :, i, None])[:, :, 0], dtype=np.complex128)
    return grid, np.reciprocal(needed[:, i]), needed[:, 1 - i]


def _matrix(parameters: Mapping[str, Quantity], name: str) -> ComplexArray | None:
    """2x2 complex matrix from ``<name>_<row><column>_re/_im`` or ``_abs/_arg``; None when an element is missing."""
    result = np.zeros((2, 2), dtype=complex)
    for i, row in enumerate(_AXES):
        for k, column in enumerate(_AXES):
            stem = f"{name}_{row}{column}"
            if f"{stem}_re" in parameters and f"{stem}_im" in parameters:
                result[i, k] = parameters[f"{stem}_re"].value + 1j * parameters[f"{stem}_im"].value
            elif f"{stem}_abs" in parameters and f"{stem}_arg" in parameters:
                result[i, k] = parameters[f"{stem}_abs"].value * np.exp(1j * parameters[f"{stem}_arg"].value)
            else:
                return None
    return result
