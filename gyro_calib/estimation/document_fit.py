"""The estimator of document 000 as the document has it: nonlinear least squares of 15 parameters (23 with feed-forward), Eq. 19.

``J = sum over frequencies of weighted |estimated - measured|^2`` of positions, or of side-band transfer functions: both versions are here.
The product's estimator (:mod:`.slow_flow_fit`) asks the same recordings a linear question; on the same data the two agree within noise.

Start: rough damping and forcers, everything else zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import CalibrationRefused
from ..quantity import Quantity
from ..recording.recording import Recording
from .document_cost import Lines, Map, cost_model, noise_columns, positions, transfer_functions, whitened
from .document_model import DocumentModel
from .document_noise import Noise, measure_noise
from .levenberg import LeastSquares, levenberg_marquardt
from .sideband_table import SidebandRow, sideband_table
from .slow_flow_estimate import SlowFlowEstimate, SlowFlowParameters

__all__ = ["DocumentEstimate", "document_fit", "known_start", "rough_start"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

COSTS = ("positions", "transfer_functions")
WEIGHTS = ("noise", "equal")
#: fits with weights from the noise that the fit before left
_ROUNDS = 2


@dataclass(frozen=True)
class DocumentEstimate:
    """Outcome of :func:`document_fit`.

    Parameters
    ----------
    model : DocumentModel
        Names and meaning of the parameters.
    values : ndarray, shape (p,)
    covariance : ndarray, shape (p, p)
        From the measured noise, for any weights.
    chi2, dof : float, int
        Of the residuals against the measured noise, and what noise alone would leave.
    condition_number : float
        Of the Jacobian with columns scaled to unit length.
    iterations : int
        Jacobians evaluated from the start to the end.
    converged : bool
    noise : Noise
        Measured densities.
    """

    model: DocumentModel
    values: FloatArray
    covariance: FloatArray
    chi2: float
    dof: int
    condition_number: float
    iterations: int
    converged: bool
    noise: Noise

    def parameter(self, name: str) -> Quantity:
        """One parameter by its name.

        Raises
        ------
        KeyError
            The model has none of that name.
        """
        if name not in self.model.names:
            raise KeyError(f"Parameter must be one of {', '.join(self.model.names)}, but got {name!r}.")
        place = self.model.names.index(name)
        return Quantity(float(self.values[place]), math.sqrt(self.covariance[place, place]), _unit(name))

    def slow_flow(self) -> SlowFlowEstimate:
        """The same as A, G, E, body response, with covariance: what the separation of the input rate takes (:mod:`.separation`)."""
        model = self.model
        here = _flow_parameters(model, self.values)
        blank = SlowFlowEstimate(
            values=here,
            covariance=np.zeros((0, 0)),
            has_feedthrough=model.fit_feedforward,
            has_cubic=False,
            cubic_gain=0.0,
            omega0_rad_s=model.omega0,
            temperature_degc=float(np.mean([r.temperature_degc for r in model.table])),
            temperature_sd_k=float(np.std([r.temperature_degc for r in model.table])),
            chi2=self.chi2,
            dof=self.dof,
            condition_number=self.condition_number,
            noise=self.noise.by_role(),
            table=(),
        )
        columns = []
        for i, sd in enumerate(np.sqrt(np.diag(self.covariance))):
            step = np.zeros_like(self.values)
            step[i] = sd
            ends = [replace(blank, values=_flow_parameters(model, self.values + sign * step)).vector() for sign in (1.0, -1.0)]
            columns.append((ends[0] - ends[1]) / (2.0 * sd))
        jacobian = np.column_stack(columns)
        # the level of the resonances is known as well as single recordings scatter about their track
        scatter, factor = model.resonance_scatter(self.values)
        levels = []
        for a in range(2):
            moved = here.A.copy()
            moved[a, a] += 1j
            levels.append(replace(blank, values=replace(here, A=moved)).vector() - blank.vector())
        level = np.column_stack(levels)
        # the separation scales a covariance by chi-square itself
        scale = max(1.0, self.chi2 / max(self.dof, 1))
        return replace(blank, covariance=(jacobian @ self.covariance @ jacobian.T + scatter**2 * level @ factor @ level.T) / scale)


def rough_start(model: DocumentModel, factory: Mapping[str, Any]) -> FloatArray:
    """Rough damping and forcers from the design, all else zero (document 000: "sufficient for convergence").

    The forcers follow from the nominal scale factor, ``|G| = kappa a / S`` (theory.md Eq. 7); where the factory names none, from the
    volts that keep the oscillator going against the rough damping, ``|G| = (b/2) |p/u|``.

    Raises
    ------
    CalibrationRefused
        The factory data lack the nominal quality factor.
    """
    quality = factory.get("nominal_q")
    if not isinstance(quality, int | float) or not quality > 0:
        raise CalibrationRefused(f"Factory data must hold a positive nominal_q, but got {quality!r}. State the design's.")
    damping = model.omega0 / quality
    nominal, kappa = factory.get("nominal_scale_factor_v_per_rad_s"), factory.get("angular_gain_kappa")
    if isinstance(nominal, Mapping) and isinstance(kappa, int | float):
        # the scale factor with x as the oscillator is made by the y forcer
        gain = [kappa * float(factory.get("nominal_amplitude_v", 1.0)) / abs(float(nominal[axis])) for axis in "yx"]
    else:
        gain = [0.5 * damping / model.drive_per_pickoff(axis) for axis in "xy"]
    start = np.zeros(len(model.names))
    start[model.names.index("B_xx_re")], start[model.names.index("B_yy_re")] = (2.0 * model.omega0 * g for g in gain)
    start[model.names.index("b_x")] = start[model.names.index("b_y")] = damping
    return start


def known_start(model: DocumentModel, A: ComplexArray, G: ComplexArray, E: ComplexArray) -> FloatArray:
    """Parameters of a slow flow (theory.md Eqs. 3, 4): an earlier calibration, or the truth of a simulated unit.

    The diagonal of A gives the damping alone; the resonances are no parameters.
    """
    start = np.zeros(len(model.names))
    start[:8] = np.ascontiguousarray(2j * model.omega0 * G).reshape(4).view(np.float64)
    cross = np.array([A[0, 1], A[1, 0]])
    start[8:15] = [-2.0 * A[0, 0].real, -2.0 * A[1, 1].real, *(-2.0 * cross.real), *(2.0 * model.omega0 * cross.imag), 0.0]
    if model.fit_feedforward:
        start[15:23] = np.ascontiguousarray(E, dtype=complex).reshape(4).view(np.float64)
    return start


def document_fit(
    recordings: list[Recording] | list[SidebandRow],
    start: FloatArray | Callable[[DocumentModel], FloatArray],
    *,
    cost: str = "positions",
    weights: str = "noise",
    with_carrier: bool = False,
    feedforward: ComplexArray | None = None,
    stiffening: bool = False,
) -> DocumentEstimate:
    """Estimate the 15 parameters; with open drive off resonance the 23.

    Parameters
    ----------
    recordings : list of Recording or of SidebandRow
        Side bands with x and with y as the oscillator; open drive and body excitation as there are.
    start : ndarray or callable
        Starting values in the order of ``DocumentModel.names``, or a function that gives them (see :func:`rough_start`).
    cost : {"positions", "transfer_functions"}
        What Eq. 19 compares.
    weights : {"noise", "equal"}
        Weigh each term by the noise measured at neighbouring frequencies, or all alike.
    with_carrier : bool
        Also compare the carriers of the closed axis in the loop recordings (positions, noise weights only). The document's table holds
        side bands alone; the carrier is where most of the knowledge of a constant rate is.
    feedforward : ndarray, shape (2, 2), complex, optional
        E to remove instead of fitting it.
    stiffening : bool
        Let the resonances follow the amplitude (cubic stiffness): two parameters more.

    Raises
    ------
    CalibrationRefused
        Unknown option, an axis that never oscillated, no pair of direct and swapped runs, parameters that cannot be told apart.
    """
    if cost not in COSTS or weights not in WEIGHTS:
        raise CalibrationRefused(
            f"Cost must be one of {', '.join(COSTS)} and weights of {', '.join(WEIGHTS)}, but got {cost!r}, {weights!r}."
        )
    if with_carrier and (cost, weights) != ("positions", "noise"):
        raise CalibrationRefused(f"Carriers must be weighed by noise, as positions, but got {cost!r}, {weights!r}.")
    table = [r if isinstance(r, SidebandRow) else None for r in recordings]
    rows = [r for r in table if r is not None] if all(table) else sideband_table([r for r in recordings if isinstance(r, Recording)])
    fit_feedforward = feedforward is None and any(r.kind == "drive" for r in rows)
    model = DocumentModel(rows, fit_feedforward=fit_feedforward, feedforward=feedforward, stiffening=stiffening)
    theta = start(model) if callable(start) else np.asarray(start, dtype=float)
    lines = Lines.of(model, with_carrier=False)
    residuals = positions(lines) if cost == "positions" else transfer_functions(lines)
    fit = levenberg_marquardt(cost_model(model, lines, residuals), theta)
    iterations, converged = fit.iterations, fit.converged
    if with_carrier:
        lines = Lines.of(model, with_carrier=True)
    noise = measure_noise(model, fit.parameters)
    for _ in range(_ROUNDS if weights == "noise" else 0):
        residuals = _weighted(model, lines, fit.parameters, noise, cost)
        fit = levenberg_marquardt(cost_model(model, lines, residuals), fit.parameters)
        iterations += fit.iterations
        converged = converged and fit.converged
        noise = measure_noise(model, fit.parameters)
    return _estimate(model, lines, fit, residuals, noise, iterations, converged)


def _weighted(model: DocumentModel, lines: Lines, theta: FloatArray, noise: Noise, cost: str) -> Map:
    """The map whose residuals have unit variance."""
    sd = noise.deviations(lines)
    if cost == "positions":
        return whitened(model, lines, theta, sd)
    spread = transfer_functions(lines)(noise_columns(model, lines, theta, sd))
    return transfer_functions(lines, np.sqrt(np.sum(spread**2, axis=1)))


def _estimate(
    model: DocumentModel, lines: Lines, fit: LeastSquares, residuals: Map, noise: Noise, iterations: int, converged: bool
) -> DocumentEstimate:
    """Covariance from the measured noise through whatever weights the fit had, and chi-square."""
    theta = fit.parameters
    sd = noise.deviations(lines)
    error, slope = model.error(theta, lines.rows)
    jacobian = residuals(slope)
    noisy = residuals(noise_columns(model, lines, theta, sd))
    gain = fit.covariance @ jacobian.T @ noisy
    weigh = whitened(model, lines, theta, sd)
    left = weigh(error[:, :, None])[:, 0]
    # what noise alone would leave of these weights: the degrees of freedom when they are the best ones
    leaves = weigh(noise_columns(model, lines, theta, sd)) - weigh(slope) @ gain
    chi2, dof = float(left @ left), max(1, round(float(np.sum(leaves**2))))
    return DocumentEstimate(
        model=model,
        values=theta,
        covariance=max(1.0, chi2 / dof) * gain @ gain.T,
        chi2=chi2,
        dof=dof,
        condition_number=fit.condition_number,
        iterations=iterations,
        converged=converged,
        noise=noise,
    )


def _flow_parameters(model: DocumentModel, theta: FloatArray) -> SlowFlowParameters:
    G, E, body = model.matrices(np.ascontiguousarray(theta))
    return SlowFlowParameters(A=model.flow(theta), G=G, E=E, body=body, cubic=np.zeros((2, 2), dtype=complex))


def _unit(name: str) -> str:
    if name.startswith("B_"):
        return "1/s^2"
    if name.startswith("k_"):
        return "1/s^2"
    if name.startswith("stiffening_"):
        return "rad/s/V^2"
    return {"oscillator_phase": "rad"}.get(name, "1" if name.startswith("E_") else "1/s")
