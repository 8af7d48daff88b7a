"""Factory: what only a rate table tells, the Bryant factor, the frame of the pick-offs, the mounting, and the fixed difference of rates
(document 000: "using a rate table … to determine the Bryant factor, sensor mounting plate misalignment"; "an estimated fixed difference
between the two rates may be applied to subsequent calibrations in the field").

From A1 = -kappa P J P^-1 of :mod:`.rate_table`, with P of :mod:`.separation` (M = P P^T = [[1, h], [h, r^2]], phase eps on y):

    A1 = (kappa / sqrt(r^2 - h^2)) [[-h, e^{-i eps}], [-r^2 e^{i eps}, h]],   det A1 = kappa^2,

so eight measured reals give kappa, r, h and eps without reciprocity, priors or body excitation, and four more check the form.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ..errors import CalibrationRefused
from ..quantity import Quantity
from ..recording.applied_rate import is_turned
from ..recording.recording import Campaign, Recording
from .rate_table import RateTableFit, fit_rate_table
from .separation import PickoffFrame, angular_response
from .sideband import calibrate_sideband
from .slow_flow_data import TEMPERATURE_WINDOW_K

__all__ = ["FactoryResult", "calibrate_factory"]

FloatArray = NDArray[np.float64]
#: a warning above these reduced chi-squares: of the regression, of the form of A1 (four degrees of freedom, once in ten thousand)
_CHI2_WARN, _FORM_WARN = 3.0, 5.9
#: kappa from a single table axis holds the cosine of a tilt of this size [rad] (an engineering estimate of a mounting plate)
_UNSEEN_TILT_RAD = 5e-3


@dataclass(frozen=True)
class FactoryResult:
    """What the factory found of one unit.

    Parameters
    ----------
    device_id : str
    angular_gain_kappa : Quantity
        kappa = 2 x Bryant factor, dimensionless.
    pickoff_ratio, pickoff_non_orthogonality, pickoff_phase : Quantity
        r [1], n = h/2 [rad], eps [rad] of the pick-offs at the factory.
    misalignment : dict of {"about_x", "about_y"} to Quantity, or None
        Small rotations that carry the case's z axis onto the sense axis [rad]; None when the table turned the case about one axis only.
    rate_difference : Quantity or None
        Constant rate as a field calibration finds it here, minus the known one [rad/s]; None when no known rate was given.
    temperature_degc : float
    chi2_per_dof, condition_number : float
        Of the regression.
    warnings : tuple of str
    """

    device_id: str
    angular_gain_kappa: Quantity
    pickoff_ratio: Quantity
    pickoff_non_orthogonality: Quantity
    pickoff_phase: Quantity
    misalignment: dict[str, Quantity] | None
    rate_difference: Quantity | None
    temperature_degc: float
    chi2_per_dof: float
    condition_number: float
    warnings: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """The JSON document of ``gyro-calib factory --json``."""
        return {
            "device_id": self.device_id,
            "method": "rate_table",
            "angular_gain_kappa": self.angular_gain_kappa.to_json(),
            "bryant_factor": self.angular_gain_kappa.scaled(0.5, "1").to_json(),
            "pickoff_ratio": self.pickoff_ratio.to_json(),
            "pickoff_non_orthogonality": self.pickoff_non_orthogonality.to_json(),
            "pickoff_phase": self.pickoff_phase.to_json(),
            "misalignment": None if self.misalignment is None else {k: q.to_json() for k, q in self.misalignment.items()},
            "rate_difference": None if self.rate_difference is None else self.rate_difference.to_json(),
            "temperature": Quantity(self.temperature_degc, 0.0, "degC").to_json(),
            "chi2_per_dof": self.chi2_per_dof,
            "condition_number": self.condition_number,
            "warnings": list(self.warnings),
        }


def calibrate_factory(
    campaign: Campaign, *, known_rate: Quantity | None = None, on_progress: Callable[[float], None] | None = None
) -> FactoryResult:
    """Estimate kappa, pick-off frame, mounting and fixed rate difference from rate-table recordings.

    Parameters
    ----------
    campaign : Campaign
        Table runs with both axes as the oscillator (or a wave that turns) and something dynamic: a self-calibration at rest.
    known_rate : Quantity, optional
        Constant rate about the sense axis while the table stands [rad/s]: the earth's, at the station.
    on_progress : callable, optional
        Called with a fraction 0-1.

    Raises
    ------
    CalibrationRefused
        No table run, one oscillator axis only, nothing dynamic, or no side bands when ``known_rate`` is given.
    """
    if known_rate is not None and known_rate.unit != "rad/s":
        raise CalibrationRefused(f"Known rate must be in rad/s, but got {known_rate.unit!r}. Convert it.")
    recordings, skipped = _usable(campaign)
    decay = math.pi * float(campaign.factory.get("nominal_f0_hz", 0.0)) / float(campaign.factory.get("nominal_q", math.inf))
    fit = fit_rate_table(recordings, decay)
    if on_progress is not None:
        on_progress(0.7)
    gain, frame, covariance, form_chi2 = _solve(fit)
    kappa, misalignment, warnings = _mounting(fit.axes, gain, covariance)
    if form_chi2 > _FORM_WARN:
        warnings.append(f"the response to rate leaves chi-square/dof {form_chi2:.1f} against -kappa P J P^-1: look at the table's rate")
    if fit.chi2_per_dof > _CHI2_WARN:
        warnings.append(f"the slow flow leaves chi-square/dof {fit.chi2_per_dof:.1f}: an effect is missing; standard deviations are scaled")
    if fit.has_cubic:
        warnings.append("cubic terms were needed: a nonlinearity is part of this estimate")
    if skipped:
        warnings.append("left out: " + "; ".join(skipped))
    difference = None
    if known_rate is not None:
        # with the kappa found here: what remains is not kappa's
        own = replace(campaign, factory={**campaign.factory, "angular_gain_kappa": kappa.value})
        found = calibrate_sideband(own, with_convergence=False).rate
        difference = Quantity(found.value - known_rate.value, math.hypot(found.sd, known_rate.sd), "rad/s")
    sd = np.sqrt(np.diag(covariance))[-3:]
    if on_progress is not None:
        on_progress(1.0)
    return FactoryResult(
        device_id=campaign.device_id,
        angular_gain_kappa=kappa,
        pickoff_ratio=Quantity(frame.ratio, float(sd[0]), "1"),
        pickoff_non_orthogonality=Quantity(0.5 * frame.skew, 0.5 * float(sd[1]), "rad"),
        pickoff_phase=Quantity(frame.phase_rad, float(sd[2]), "rad"),
        misalignment=misalignment,
        rate_difference=difference,
        temperature_degc=fit.temperature_degc,
        chi2_per_dof=fit.chi2_per_dof,
        condition_number=fit.condition_number,
        warnings=tuple(warnings),
    )


def _usable(campaign: Campaign) -> tuple[list[Recording], list[str]]:
    """Recordings near the temperature of the table runs."""
    turned = [r for r in campaign if is_turned(r)]
    if not turned:
        raise CalibrationRefused(
            f"Recordings of {campaign.device_id} must include a rate-table run (attribute applied_rate), but got none. "
            "Record run_factory on the table, or state applied_rate in the file."
        )
    middle = float(np.median([r.temperature_degc.mean() for r in turned]))
    chosen, skipped = [], []
    for r in campaign:
        low, high = float(r.temperature_degc.min()), float(r.temperature_degc.max())
        if max(abs(low - middle), abs(high - middle)) > 2.0 * TEMPERATURE_WINDOW_K:
            skipped.append(f"{r.label}: temperature {low:.2f} to {high:.2f} degC, table runs at {middle:.2f}")
        else:
            chosen.append(r)
    columns = {c for r in turned for c in (r.command.oscillator_axis or "xy")}
    if columns != {"x", "y"}:
        raise CalibrationRefused(
            f"Rate-table runs must have both axes as the oscillator, but got {', '.join(sorted(columns))}. "
            "One axis gives kappa times the pick-off ratio only: turn the table with the axes swapped too."
        )
    return chosen, skipped


def _solve(fit: RateTableFit) -> tuple[FloatArray, PickoffFrame, FloatArray, float]:
    """kappa times the sense axis along each table axis, the frame, covariance of (gains, r, h, eps), reduced chi-square of the form."""
    count = len(fit.axes)
    data = np.ascontiguousarray(fit.A1.reshape(count, 4)).view(np.float64)
    whiten = [np.linalg.inv(np.linalg.cholesky(c)) for c in fit.A1_covariance]

    def residual(q: FloatArray) -> FloatArray:
        r, h, eps = q[count:]
        shape = angular_response(PickoffFrame(r, h, eps, (0.0, 0.0, 0.0)), 1.0).reshape(4).view(np.float64)
        return np.concatenate([w @ (gain * shape - row) for w, gain, row in zip(whiten, q[:count], data, strict=True)])

    strongest = int(np.argmax(np.abs(fit.A1[:, 0, 1])))
    first = fit.A1[strongest]
    size = math.sqrt(abs(first[0, 1] * first[1, 0]))
    ratio = np.sqrt(-first[1, 0] / first[0, 1])
    signs = np.real(fit.A1[:, 0, 1] * np.exp(1j * np.angle(ratio)))
    start = np.concatenate([signs * abs(ratio), [abs(ratio), 0.0, float(np.angle(ratio))]])
    scales = np.concatenate([np.full(count, size), [1e-2, 1e-3, 1e-3]])
    solution = least_squares(residual, start, x_scale=scales, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    dof = 8 * count - count - 3
    chi2 = float(2.0 * solution.cost) / dof
    covariance = np.linalg.inv(solution.jac.T @ solution.jac) * max(1.0, chi2)
    r, h, eps = solution.x[count:]
    return solution.x[:count], PickoffFrame(float(r), float(h), float(eps), (0.0, 0.0, 0.0)), covariance, chi2


def _mounting(axes: FloatArray, gain: FloatArray, covariance: FloatArray) -> tuple[Quantity, dict[str, Quantity] | None, list[str]]:
    """kappa and the direction of the sense axis from its components along the table axes."""
    count = len(axes)
    own = covariance[:count, :count]
    if np.linalg.matrix_rank(axes, tol=1e-3) < 3:
        if count > 1:
            raise CalibrationRefused(f"Table axes must be one, or three that span space, but got {axes.round(3).tolist()}.")
        if gain[0] < 0.0:
            raise CalibrationRefused(
                "Response to the table's rate must be positive about the sense axis, but is negative. Correct the sign of applied_rate."
            )
        unseen = 0.5 * _UNSEEN_TILT_RAD**2 * gain[0]
        kappa = Quantity(float(gain[0]), math.hypot(math.sqrt(own[0, 0]), unseen), "1")
        return kappa, None, ["the table turned about one axis: kappa holds the cosine of the mounting's tilt, which is not observable"]
    back = np.linalg.pinv(axes)
    vector, spread = back @ gain, back @ own @ back.T
    size = float(np.linalg.norm(vector))
    kappa = Quantity(size, math.sqrt(float(vector @ spread @ vector)) / size, "1")
    if vector[2] <= 0.0:
        raise CalibrationRefused(
            "Sense axis must point along the case's +z, but the response to the table says otherwise. Correct the axes of applied_rate."
        )
    # a rotation a about x and b about y carries z to (sin b, -sin a cos b, …)
    tilt = {}
    for name, component, sign in (("about_x", 1, -1.0), ("about_y", 0, 1.0)):
        slope = np.zeros(3)
        slope[component], slope[2] = sign / vector[2], -sign * vector[component] / vector[2] ** 2
        tilt[name] = Quantity(math.atan(sign * vector[component] / vector[2]), math.sqrt(float(slope @ spread @ slope)), "rad")
    return kappa, tilt, []
