"""Scatter of the whole-angle estimate against the Cramer-Rao bound; bias of the estimator; coverage of its intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ...device import draw_unit, load_device
from ...estimation.drive_chain import drive_chain_of
from ...estimation.wave_bound import WaveNoise, wave_bound
from ...estimation.whole_angle_fit import WholeAngleEstimate, fit_whole_angle, usable_wave_recordings
from ...experiments import Limits, SimulatedInstrument, run_plan, self_calibration_plan
from ...quantity import Quantity
from ...simulation import GyroSimulator
from ...simulation.flicker import FLICKER_TIMES_S
from ...units import EARTH_RATE_RAD_S
from ..gates import Gate, coverage
from ..registry import Figures, Study

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: what the issue asks for; a scale factor is kappa a rho / |G_xx|, or kappa a / (rho |G_yy|), with kappa and rho from the factory
_FIGURES = ("delta_g", "two_delta", "two_lambda", "scale_factor_x", "scale_factor_y")
#: the slow flow: damping, cross terms, couplings
_FLOW = ("A_xx", "A_xy", "A_yx", "A_yy", "A_xy_im", "A_yx_im", "G_xy", "G_yx")
#: what the issue allows: scatter over the bound, bias of the estimator over the bound, coverage [%]
_SCATTER, _BIAS, _COVERAGE = 1.2, 0.2, (91.0, 98.0)


def run(seed: int) -> dict[str, float]:
    """One unit at carrier level: error over bound and over claimed sd of every figure."""
    device = draw_unit(load_device("hrg_hardware"), seed)
    rate = float(np.random.default_rng([seed, 2]).uniform(-2, 2)) * EARTH_RATE_RAD_S
    simulator = GyroSimulator(device, rng=np.random.default_rng([seed, 1]), fidelity="carrier")
    # units differ by per cents from the nominal one, and so does the precession of a commanded volt
    plan = self_calibration_plan(simulator.factory, quality="quick", limits=Limits(base_rate_rad_s=0.1))
    recordings = usable_wave_recordings(run_plan(SimulatedInstrument(simulator, rate), plan))[0]
    estimate = fit_whole_angle(recordings, math.pi * float(simulator.factory["nominal_f0_hz"]) / float(simulator.factory["nominal_q"]))
    flow = device.slow_flow(rate, estimate.flow.temperature_degc, estimate.flow.omega0_rad_s)
    bound = wave_bound(
        recordings,
        estimate.flow.omega0_rad_s,
        WaveNoise.of(device, estimate.flow.temperature_degc, FLICKER_TIMES_S),
        (flow.A, flow.G),
        has_feedthrough=estimate.flow.has_feedthrough,
        bodies=sorted({r.command.excitation.frequency_hz for r in recordings if r.command.excitation.kind == "body"}),
    )
    found, jacobian = _with_jacobian(estimate)
    error = found - _values(flow.A, flow.G)
    best, claimed = (np.sqrt(np.diag(jacobian @ c @ jacobian.T)) for c in (bound, estimate.covariance))
    figures = {}
    for k, name in enumerate((*_FIGURES, *_FLOW)):
        figures[f"{name}/crb"], figures[f"{name}/sd"] = float(error[k] / best[k]), float(error[k] / claimed[k])
        figures[f"{name}/bound"] = float(best[k])
    return figures


def _values(A: ComplexArray, G: ComplexArray) -> FloatArray:
    """Figures of a slow flow; scale factors by their logarithm."""
    chain = drive_chain_of(G)
    scales = -np.log(np.abs(np.diag(G)))
    cross = (A[0, 0].real, A[0, 1].real, A[1, 0].real, A[1, 1].real, A[0, 1].imag, A[1, 0].imag, G[0, 1].imag, G[1, 0].imag)
    return np.array([chain.delta_g, chain.two_delta, chain.two_lambda, *scales, *cross])


def _with_jacobian(estimate: WholeAngleEstimate) -> tuple[FloatArray, FloatArray]:
    """Figures of an estimate and their derivatives with respect to its parameter vector."""
    vector = estimate.vector()

    def at(values: FloatArray) -> FloatArray:
        parameters = estimate.unpack(values)[0]
        return _values(parameters.A, parameters.G)

    steps = np.diag(np.sqrt(np.diag(estimate.covariance)))
    return at(vector), np.column_stack([(at(vector + h) - at(vector - h)) / (2.0 * h.sum()) for h in steps])


def summarise(figures: Figures) -> Sequence[Gate]:
    """Gates of the issue: scatter, estimator bias, coverage; for the slow flow all together."""
    gates = []
    for name in _FIGURES:
        gates += _gates_of(name, figures)
    errors = np.concatenate([figures[f"{name}/crb"] for name in _FLOW])
    scatter = float(np.sqrt(np.mean(errors**2)))
    gates.append(Gate("slow flow: rms error / bound", Quantity(scatter, scatter / math.sqrt(2.0 * figures["A_xx/crb"].size), "1")))
    pooled = np.concatenate([figures[f"{name}/sd"] for name in _FLOW])
    gates.append(Gate("slow flow: coverage of 95 % intervals", coverage(pooled, np.ones_like(pooled))))
    return gates


def _gates_of(name: str, figures: Mapping[str, FloatArray]) -> list[Gate]:
    errors, claimed = figures[f"{name}/crb"], figures[f"{name}/sd"]
    scatter, mean = float(np.std(errors, ddof=1)), float(np.mean(errors))
    bound = float(np.median(figures[f"{name}/bound"]))
    return [
        Gate(f"{name}: bound (median)", Quantity(bound, 0.0, "1")),
        Gate(f"{name}: scatter / bound", Quantity(scatter, scatter / math.sqrt(2.0 * errors.size), "1"), upper=_SCATTER),
        Gate(f"{name}: |mean error| / bound", Quantity(abs(mean), scatter / math.sqrt(errors.size), "1"), upper=_BIAS),
        Gate(f"{name}: coverage of 95 % intervals", coverage(claimed, np.ones_like(claimed)), lower=_COVERAGE[0], upper=_COVERAGE[1]),
    ]


STUDY = Study(
    name="precession-crb",
    description="Scatter of Delta G, 2 delta, 2 lambda and the scale factors against the Cramer-Rao bound; coverage of 95 % intervals",
    run=run,
    summarise=summarise,
    default_seeds=80,
)
