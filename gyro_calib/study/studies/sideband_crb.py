"""Scatter of the side-band estimate against the Cramer-Rao bound; bias of the estimator; coverage of its intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ...estimation.cramer_rao import device_noise_density, resonance_wander_density, slow_flow_bound
from ...estimation.separation import Priors
from ...estimation.sideband import SidebandProblem
from ...estimation.slow_flow_data import usable_recordings
from ...quantity import Quantity
from ..gates import Gate, rms
from ..registry import Figures, Study
from ._units import run_unit

#: the parameters of document 000 that the fit gives: complex G (8), damping (2), cross damping and cross stiffness as seen on each axis (4)
_PARAMETERS = (
    *("A_xy_re", "A_xy_im", "A_yx_re", "A_yx_im", "decay_rate_x", "decay_rate_y"),
    *(f"G_{i}{j}_{part}" for i in "xy" for j in "xy" for part in ("re", "im")),
)
#: absolute temperature of the campaign [K]
_ROOM_K = 298.15
_DERIVED = ("rate", "mission_bias_x", "mission_scale_x")


def run(seed: int) -> dict[str, float]:
    """One unit: error over bound and error over claimed sd of every parameter."""
    trial = run_unit(seed)
    recordings = usable_recordings(trial.campaign)[0]
    problem = SidebandProblem(recordings, trial.campaign.factory, trial.device.resonator.angular_gain, Priors())
    derived, claimed = problem.solve()
    bodies = sorted({r.command.excitation.frequency_hz for r in recordings if r.command.excitation.kind == "body"})
    noise = device_noise_density(trial.device, problem.fit.temperature_degc)
    resonator = trial.device.resonator
    wander = trial.device.environment.wander_k * abs(resonator.frequency_tempco_per_k) * resonator.omega0_rad_s
    bound = slow_flow_bound(
        recordings,
        problem.fit.omega0_rad_s,
        noise,
        has_feedthrough=problem.fit.has_feedthrough,
        bodies=bodies,
        wander_rad_s=wander,
        wander_density=resonance_wander_density(trial.device),
        damping_wander=resonator.quality_exponent * resonator.decay_rate() * trial.device.environment.wander_k / _ROOM_K,
    )
    _, best = problem.propagate(bound)
    nominal = trial.campaign.factory["nominal_scale_factor_v_per_rad_s"]["x"]
    # the truth at the frequency and at the temperature of the fit: G ~ 1/omega, and a millikelvin of Q(T) is as large as the bound
    flow = trial.device.slow_flow(trial.rate_rad_s, problem.fit.temperature_degc, problem.fit.omega0_rad_s)
    true = {
        "rate": trial.rate_rad_s,
        "mission_bias_x": trial.truth.bias_rad_s * nominal,
        "mission_scale_x": trial.truth.scale_factor * nominal,
        "decay_rate_x": -flow.A[0, 0].real,
        "decay_rate_y": -flow.A[1, 1].real,
    }
    for i, row in enumerate("xy"):
        for j, column in enumerate("xy"):
            true |= {f"A_{row}{column}_re": flow.A[i, j].real, f"A_{row}{column}_im": flow.A[i, j].imag}
            true |= {f"G_{row}{column}_re": flow.G[i, j].real, f"G_{row}{column}_im": flow.G[i, j].imag}
    figures = {}
    for name in (*_DERIVED, *_PARAMETERS):
        k = derived.names.index(name)
        error = float(derived.values[k]) - true[name]
        figures[f"{name}/crb"] = error / math.sqrt(best[k, k])
        figures[f"{name}/sd"] = error / math.sqrt(claimed[k, k])
    return figures


def summarise(figures: Figures) -> Sequence[Gate]:
    """Gates of the issue: scatter, estimator bias, coverage."""
    gates = []
    for name in _DERIVED:
        gates += _gates_of(name, figures)
    pooled = {kind: np.concatenate([figures[f"{name}/{kind}"] for name in _PARAMETERS]) for kind in ("crb", "sd")}
    scatter = {name: float(np.std(figures[f"{name}/crb"], ddof=1)) for name in _PARAMETERS}
    worst = max(scatter, key=lambda name: scatter[name])
    n = figures[f"{worst}/crb"].size
    # the worst of twenty sample deviations lies some 2.4 of its own standard errors high by chance alone
    allowed = 1.2 * (1.0 + 2.4 / math.sqrt(2 * n))
    spread = Quantity(scatter[worst], scatter[worst] / math.sqrt(2 * n), "1")
    gates.append(Gate(f"worst parameter ({worst}): scatter / bound", spread, upper=allowed))
    gates.append(Gate("all parameters: rms error / bound", rms(pooled["crb"], "1"), upper=1.2))
    gates.append(_coverage("all parameters", pooled["sd"], len(_PARAMETERS)))
    return gates


def _gates_of(name: str, figures: Mapping[str, np.ndarray]) -> list[Gate]:
    crb, sd = figures[f"{name}/crb"], figures[f"{name}/sd"]
    n = crb.size
    scatter = float(np.std(crb, ddof=1))
    mean = float(np.mean(crb))
    return [
        Gate(f"{name}: scatter / bound", Quantity(scatter, scatter / math.sqrt(2 * n), "1"), upper=1.2),
        Gate(f"{name}: |mean error| / bound", Quantity(abs(mean), scatter / math.sqrt(n), "1"), upper=0.2),
        _coverage(name, sd, 1),
    ]


def _coverage(name: str, errors_over_sd: np.ndarray, correlated: int) -> Gate:
    inside = float(np.mean(np.abs(errors_over_sd) < 1.959964))
    sd = math.sqrt(max(inside * (1 - inside), 1e-4) / (errors_over_sd.size / correlated))
    return Gate(f"{name}: coverage of 95 % intervals", Quantity(100 * inside, 100 * sd, "%"), lower=91.0, upper=98.0)


STUDY = Study(
    name="sideband-crb",
    description="Scatter of rate, bias, scale factor and fitted parameters against the Cramer-Rao bound; coverage of 95 % intervals",
    run=run,
    summarise=summarise,
    default_seeds=200,
)
