"""Regress the slow flow with a known input rate: A at rest, G, E and A1 = dA/dOmega (document 000, "with known input rate the estimator may
determine the Bryant factor").

theory.md Eq. 4 is linear in the rate, ``A + Omega(t) A1`` with ``A1 = -kappa P J P^-1``, so a table run adds two regressors to the
projected equations of :mod:`.projection`: ``Omega p`` (p = V - E u; E comes from a first round) and, because a table's clock and its edges
are never quite the recorder's, ``Omega' p`` with coefficients of its own, which takes up a shift in time. Any mode serves: the equations
are the same.

Each axis about which the table turned the case has its own A1 (the sense axis' component along it); away from the first one the constant
rate is another (the earth's turns with the mounting), so those runs have an A of their own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

from ..errors import CalibrationRefused
from ..recording.applied_rate import applied_rate, is_turned, table_axis
from ..recording.recording import Recording
from .linear_fit import Equation, LinearFit, NoiseModel, fit_axis
from .projection import Projected, project, test_functions
from .rate_table_lines import measured_noise, quiet_lines_of, resonance_shift, role_of, signal_lines_of, wander_of

__all__ = ["RateTableFit", "fit_rate_table"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
_ROUNDS = 2
#: real cubic parameters of both axes
_CUBIC_TERMS = 8


@dataclass(frozen=True)
class RateTableFit:
    """Slow flow with its response to rate.

    Parameters
    ----------
    A, G, E : ndarray, shape (2, 2), complex
        [1/s] (the constant rate included), [1/s], dimensionless.
    axes : ndarray, shape (k, 3)
        Table axes in the frame of the case.
    A1 : ndarray, shape (k, 2, 2), complex
        Response to rate about each axis, dimensionless.
    A1_covariance : ndarray, shape (k, 8, 8)
        Of (re, im) of xx, xy, yx, yy; the axes' are taken as independent.
    has_cubic : bool
        Whether terms in ``|V|^2 V`` were needed (three or more amplitudes, F test).
    omega0_rad_s : float
        Frequency about which A and G are written.
    temperature_degc : float
        Mean of the recordings.
    chi2_per_dof, condition_number : float
    """

    A: ComplexArray
    G: ComplexArray
    E: ComplexArray
    axes: FloatArray
    A1: ComplexArray
    A1_covariance: FloatArray
    has_cubic: bool
    omega0_rad_s: float
    temperature_degc: float
    chi2_per_dof: float
    condition_number: float


def fit_rate_table(recordings: list[Recording], decay_rate: float) -> RateTableFit:
    """Fit all recordings of one unit at one temperature and one constant rate.

    Parameters
    ----------
    recordings : list of Recording
        Table runs among them (``extras["applied_rate"]``). The absolute scale of G, and with it of A1, needs something dynamic: side bands,
        virtual precession, ring-down.
    decay_rate : float
        Rough 1/tau [1/s].

    Raises
    ------
    CalibrationRefused
        No table run, or recordings that do not excite what must be found.
    """
    if not any(is_turned(r) for r in recordings):
        raise CalibrationRefused(
            "Recordings must include a rate-table run (attribute applied_rate), but got none. Turn the gyro, and say how it was turned."
        )
    data = _Data.of(recordings, decay_rate)
    E = np.zeros((2, 2), dtype=complex)
    plain = data.fit(E, cubic=False)
    if data.has_feedthrough:
        E = np.array([f.coefficients[4:6] for f in plain])
        plain = data.fit(E, cubic=False)
    fits, cubic = plain, False
    amplitudes = {round(r.command.setpoints.amplitude_v, 9) for r in recordings if r.command.mode != "loops_off"}
    if len(amplitudes) >= 3 and all(r.command.oscillator_axis or r.command.mode == "loops_off" for r in recordings):
        rich = data.fit(E, cubic=True)
        chi2, dof = _quality(rich)
        ratio = (_quality(plain)[0] - chi2) / _CUBIC_TERMS / (chi2 / max(dof, 1))
        cubic = ratio > fdtri(_CUBIC_TERMS, max(dof, 1), 1.0 - 1e-3)
        fits = rich if cubic else plain
    return data.result(fits, E, cubic)


def _quality(fits: list[LinearFit]) -> tuple[float, int]:
    return sum(f.chi2 for f in fits), sum(f.dof for f in fits)


@dataclass(frozen=True)
class _Turned:
    """Pick-offs and drives of a table run times its rate, and times the change of its rate, projected; shape (m, 2) each."""

    rate_pick: ComplexArray
    rate_drive: ComplexArray
    slope_pick: ComplexArray
    slope_drive: ComplexArray

    @classmethod
    def of(cls, recording: Recording, lines: list[float]) -> _Turned | None:
        if not is_turned(recording):
            return None
        row_s = 1.0 / recording.sample_rate_hz
        phi = test_functions(recording.t, row_s, lines).value
        rate, slope = applied_rate(recording)
        parts = [row_s * (phi @ (course[:, None] * signal)) for course in (rate, slope) for signal in (recording.pick, recording.drive)]
        return cls(*parts)


@dataclass(frozen=True)
class _Data:
    """Projected recordings at their own lines and at quiet ones."""

    recordings: list[Recording]
    axes: FloatArray
    omega0: float
    wander_rad_s: float
    has_feedthrough: bool
    bodies: list[float]
    signal: list[Projected]
    quiet: list[Projected]
    turned: list[_Turned | None]
    quiet_turned: list[_Turned | None]

    @classmethod
    def of(cls, recordings: list[Recording], decay_rate: float) -> _Data:
        omega0 = 2.0 * math.pi * float(np.mean([r.column("ref_freq").mean() for r in recordings if r.command.mode != "loops_off"]))
        axes: list[FloatArray] = []
        for r in recordings:
            if is_turned(r) and not any(np.allclose(table_axis(r), axis, atol=1e-9) for axis in axes):
                axes.append(table_axis(r))
        return cls(
            recordings=recordings,
            axes=np.array(axes),
            omega0=omega0,
            wander_rad_s=wander_of(recordings),
            has_feedthrough=any(r.command.excitation.kind == "drive" for r in recordings),
            bodies=sorted({r.command.excitation.frequency_hz for r in recordings if r.command.excitation.kind == "body"}),
            signal=[project(r, signal_lines_of(r), omega0, decay_rate) for r in recordings],
            quiet=[project(r, quiet_lines_of(r), omega0, decay_rate) for r in recordings],
            turned=[_Turned.of(r, signal_lines_of(r)) for r in recordings],
            quiet_turned=[_Turned.of(r, quiet_lines_of(r)) for r in recordings],
        )

    def fit(self, E: ComplexArray, *, cubic: bool) -> list[LinearFit]:
        """Both axes; ``E`` corrects what the rate acts on."""
        columns, noise = (
            [self._columns(p, t, r, E, cubic=cubic) for p, t, r in zip(projected, turned, self.recordings, strict=True)]
            for projected, turned in ((self.signal, self.turned), (self.quiet, self.quiet_turned))
        )
        return [self._fit(columns, noise, axis) for axis in range(2)]

    def _fit(self, columns: list[ComplexArray], noise: list[ComplexArray], axis: int) -> LinearFit:
        """One axis; the noise is measured on the quiet lines of the recordings of each role."""
        roles = [role_of(r, axis, self.omega0) for r in self.recordings]
        models = {(role, part): NoiseModel((1.0, 0.0, 0.0), 0.01) for role in roles for part in ("re", "im")}
        for turn in range(_ROUNDS + 1):
            equations = []
            for p, c, role in zip(self.signal, columns, roles, strict=True):
                detuning, detuning_sd = resonance_shift(p, role, axis, self.wander_rad_s)
                sd_re, sd_im = (np.sqrt(models[role, part].density(p.frequency_hz)) for part in ("re", "im"))
                equations.append(Equation(p.lhs[:, axis], c, p.gram, sd_re, sd_im, detuning, detuning_sd))
            fit = fit_axis(equations)
            if turn < _ROUNDS:
                models = measured_noise(self.recordings, self.quiet, noise, roles, axis, fit.coefficients)
        return fit

    def _columns(self, p: Projected, turned: _Turned | None, recording: Recording, E: ComplexArray, *, cubic: bool) -> ComplexArray:
        """V, u, L[u] when E is sought, body volts, cubic terms, Omega' p, A of further axes, Omega p of each axis."""
        parts = [p.pick, p.drive, *([p.drive_rate] if self.has_feedthrough else [])]
        parts += [(p.body * (recording.command.excitation.frequency_hz == f))[:, None] for f in self.bodies]
        parts += [p.cubic] if cubic else []
        count, zero = len(self.axes), np.zeros_like(p.pick)
        if turned is None:
            return np.hstack([*parts, *[zero] * (2 * count)])
        own = [bool(np.allclose(table_axis(recording), axis, atol=1e-9)) for axis in self.axes]
        parts.append(turned.slope_pick - turned.slope_drive @ E.T)
        parts += [p.pick if here else zero for here in own[1:]]
        parts += [turned.rate_pick - turned.rate_drive @ E.T if here else zero for here in own]
        return np.hstack(parts)

    def result(self, fits: list[LinearFit], E: ComplexArray, cubic: bool) -> RateTableFit:
        values = np.array([f.coefficients for f in fits])
        A, reduced, count = values[:, 0:2], values[:, 2:4], len(self.axes)
        chi2, dof = _quality(fits)
        scale = max(1.0, chi2 / max(dof, 1))
        first = values.shape[1] - 2 * count
        return RateTableFit(
            A=A,
            G=reduced + A @ E,
            E=E,
            axes=self.axes,
            A1=np.array([values[:, first + 2 * k : first + 2 * k + 2] for k in range(count)]),
            A1_covariance=scale * np.array([_block(fits, first + 2 * k) for k in range(count)]),
            has_cubic=cubic,
            omega0_rad_s=self.omega0,
            temperature_degc=float(np.mean([r.temperature_degc.mean() for r in self.recordings])),
            chi2_per_dof=chi2 / max(dof, 1),
            condition_number=max(f.condition_number for f in fits),
        )


def _block(fits: list[LinearFit], first: int) -> FloatArray:
    """Covariance of two complex coefficients of each axis, shape (8, 8)."""
    out = np.zeros((8, 8))
    for axis, fit in enumerate(fits):
        out[4 * axis : 4 * axis + 4, 4 * axis : 4 * axis + 4] = fit.covariance[2 * first : 2 * first + 4, 2 * first : 2 * first + 4]
    return out
