"""Identify the slow flow of a force-rebalance gyro from all recordings at once: A, G, E and the response to body excitation.

All experiments are parts of one linear model (theory.md section 2): side bands and carrier lines of both oscillator axes, open drive off
resonance (feedthrough) and body excitation (pick-off phase) enter one weighted least squares per axis.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

from ..errors import CalibrationRefused
from ..recording.recording import Recording
from .linear_fit import AXES, Equation, LinearFit, NoiseModel, fit_axis, fit_noises
from .slow_flow_data import CampaignData, role_of
from .slow_flow_estimate import SlowFlowEstimate, SlowFlowParameters, TableRow
from .thermal_terms import THERMAL_TERMS, ThermalTerms

__all__ = ["campaign_equations", "fit_slow_flow"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_ROUNDS = 2
#: fewer carrier lines of one role say nothing of the scatter between records
_FEWEST_RUNS = 4
#: how large a feedthrough may be that was never measured (bad trim of the drive lines); its place among the columns
_FEEDTHROUGH_SD, _FEEDTHROUGH = 1e-3, slice(4, 6)
#: real cubic parameters of both axes
_CUBIC_TERMS = 8


def fit_slow_flow(
    recordings: list[Recording],
    decay_rate: float,
    *,
    cubic: bool | None = None,
    noise: Mapping[tuple[str, str, str], NoiseModel] | None = None,
) -> SlowFlowEstimate:
    """Fit A, G, E, the body response and, when the data ask for them, the cubic terms.

    Parameters
    ----------
    recordings : list of Recording
        From :func:`usable_recordings`.
    decay_rate : float
        Rough 1/tau [1/s] (only the small second-order terms use it).
    cubic : bool, optional
        Fit the cubic terms of document 000, Eqs. 20-27. Default: when three or more amplitudes were recorded and the terms take away more
        chi-square than chance does once in a thousand campaigns (F test).
    noise : mapping, optional
        Noise by (axis, role, part), as another fit of the same experiments measured it; default: measured on these recordings.

    Raises
    ------
    CalibrationRefused
        An axis was never the oscillator, or the recordings do not excite what must be found.
    """
    for mode in ("ftr_x", "ftr_y"):
        if not any(r.command.mode == mode for r in recordings):
            raise CalibrationRefused(
                f"Recordings must include mode {mode}, but got {', '.join(sorted({r.command.mode for r in recordings})) or 'none'}. "
                "Both axes must be the oscillator once: record the same side bands with the axes swapped."
            )
    # C p'/(2i omega0) turns G by 1/(2Q): a Q that is 8 % off its nominal value is 1.3 ppm, as much as the noise
    A, G = _rough_flow(CampaignData.of(recordings, decay_rate, with_quiet=False))
    found = -0.5 * float((A[0, 0] + A[1, 1]).real)
    data = CampaignData.of(recordings, found if found > 0 else decay_rate)
    thermal = None if data.stiffness_per_k is None else ThermalTerms.of(A, G, data.stiffness_per_k)
    if cubic is None:
        plain = _fit(data, thermal, cubic=False, noise=noise)
        amplitudes = {round(r.command.setpoints.amplitude_v, 9) for r in recordings if r.command.oscillator_axis}
        if len(amplitudes) < 3:
            return plain
        # both fits are weighed with the noise of the richer one: the poorer one's misfit leaks into its own noise estimate
        rich = _fit(data, thermal, cubic=True, noise=noise)
        poor = _fit(data, thermal, cubic=False, noise=rich.noise)
        gain = poor.chi2 - rich.chi2
        ratio = (gain / _CUBIC_TERMS) / (rich.chi2 / max(rich.dof, 1))
        asked = ratio > fdtri(_CUBIC_TERMS, max(rich.dof, 1), 1.0 - 1e-3)
        return replace(rich if asked else plain, cubic_gain=gain)
    return _fit(data, thermal, cubic=cubic, noise=noise)


def _rough_flow(data: CampaignData) -> tuple[ComplexArray, ComplexArray]:
    """A and G~ of a first, unweighted fit."""
    flat = NoiseModel((1.0, 0.0, 0.0), 0.01)
    columns = data.columns(data.signal, cubic=False)
    rows = []
    for axis in range(2):
        roles = [role_of(r, axis, data.omega0) for r in data.recordings]
        models = {(role, part): flat for role in set(roles) for part in ("re", "im")}
        rows.append(fit_axis(campaign_equations(data, columns, roles, axis, models) + _feedthrough_prior(data, columns)).coefficients)
    found = np.array(rows)
    return found[:, 0:2], found[:, 2:4]


def _fit(
    data: CampaignData, thermal: ThermalTerms | None, *, cubic: bool, noise: Mapping[tuple[str, str, str], NoiseModel] | None = None
) -> SlowFlowEstimate:
    """Both axes, with the noise measured along the way or given; what moves with temperature beside them, when it moved."""
    fits: list[LinearFit] = []
    found: dict[tuple[str, str, str], NoiseModel] = dict(noise or {})
    for axis in range(2):
        columns, quiet_columns = data.columns(data.signal, cubic=cubic), data.columns(data.quiet, cubic=cubic)
        known: list[Equation] = []
        if thermal is not None:
            columns = [np.hstack([c, thermal.columns(p, axis)]) for c, p in zip(columns, data.signal, strict=True)]
            quiet_columns = [np.hstack([c, thermal.columns(p, axis)]) for c, p in zip(quiet_columns, data.quiet, strict=True)]
            known = [thermal.prior(axis, columns[0].shape[1])]
        known += _feedthrough_prior(data, columns)
        roles = [role_of(r, axis, data.omega0) for r in data.recordings]
        flat = NoiseModel((1.0, 0.0, 0.0), 0.01)
        models = {(role, part): found.get((AXES[axis], role, part), flat) for role in set(roles) for part in ("re", "im")}
        fit = fit_axis(campaign_equations(data, columns, roles, axis, models) + known)
        for _ in range(0 if noise else _ROUNDS):
            models = _measure_noise(data, quiet_columns, roles, axis, fit.coefficients)
            fit = fit_axis(campaign_equations(data, columns, roles, axis, models) + known)
            models = _run_to_run(data, roles, models, fit)
            fit = fit_axis(campaign_equations(data, columns, roles, axis, models) + known)
        fits.append(fit)
        found |= {(AXES[axis], role, part): model for (role, part), model in models.items()}
    return _assemble(data, fits, found, cubic=cubic)


def _feedthrough_prior(data: CampaignData, columns: list[ComplexArray]) -> list[Equation]:
    """E about zero, where no open drive shows it: the side bands alone tell it from the drive gains by frequency only."""
    if data.feedthrough_measured:
        return []
    regressors = np.zeros((2, columns[0].shape[1]), dtype=complex)
    regressors[:, _FEEDTHROUGH] = np.eye(2)
    sd = np.full(2, _FEEDTHROUGH_SD)
    return [Equation(np.zeros(2, dtype=complex), regressors, np.eye(2), sd, sd)]


def campaign_equations(
    data: CampaignData, columns: list[ComplexArray], roles: list[str], axis: int, models: Mapping[tuple[str, str], NoiseModel]
) -> list[Equation]:
    """The equations of one axis: each recording's rows with its columns, its noise and its own resonance shift."""
    equations = []
    for p, c, role in zip(data.signal, columns, roles, strict=True):
        detuning, detuning_sd = None, math.inf
        if role == "oscillator":
            detuning = np.column_stack([p.pick[:, axis], p.drift[:, axis]])
        elif role != "closed":
            # an open drive's distance from a resonance that wanders is not known better than the wander
            detuning, detuning_sd = p.pick[:, axis : axis + 1], data.wander_rad_s
        equations.append(
            Equation(
                lhs=p.lhs[:, axis],
                regressors=c,
                gram=p.gram,
                sd_re=np.sqrt(models[role, "re"].density(p.frequency_hz)),
                sd_im=np.sqrt(models[role, "im"].density(p.frequency_hz)),
                detuning=detuning,
                detuning_sd=detuning_sd,
            )
        )
    return equations


def _measure_noise(
    data: CampaignData, columns: list[ComplexArray], roles: list[str], axis: int, coefficients: ComplexArray
) -> dict[tuple[str, str], NoiseModel]:
    models = {}
    for role in set(roles):
        members = [i for i, r in enumerate(roles) if r == role]
        residual = np.concatenate([data.quiet[i].lhs[:, axis] - columns[i] @ coefficients for i in members])
        lines = np.concatenate([data.quiet[i].frequency_hz for i in members])
        lowest = 0.3 / max(data.recordings[i].duration_s for i in members)
        models[role, "re"], models[role, "im"] = fit_noises(lines, np.stack([residual.real, residual.imag]) ** 2, lowest)
    return models


def _run_to_run(
    data: CampaignData, roles: list[str], models: dict[tuple[str, str], NoiseModel], fit: LinearFit
) -> dict[tuple[str, str], NoiseModel]:
    """Add what the carrier lines of a role scatter by beyond the noise inside its records.

    A flicker floor or a wander slower than a record shows only between records. It is taken up when the scatter exceeds chance.
    """
    widened = dict(models)
    for role in set(roles):
        if role == "oscillator":
            continue  # each record's own resonance shift is a nuisance there: its carrier line says nothing of the noise
        members = [i for i, r in enumerate(roles) if r == role]
        for part in ("re", "im"):
            carriers = [fit.residuals[i][data.signal[i].frequency_hz == 0.0] for i in members]
            squares = np.concatenate([np.square(c.real if part == "re" else c.imag) for c in carriers])
            model = models[role, part]
            ratio = float(squares.mean()) / float(model.density(np.zeros(1))[0])
            if squares.size >= _FEWEST_RUNS and ratio > 1.0 + 2.0 * math.sqrt(2.0 / squares.size):
                # one degree of freedom in four is spent on the coefficients that the carrier lines determine
                excess = (4.0 / 3.0 * ratio - 1.0) * float(model.density(np.zeros(1))[0])
                widened[role, part] = replace(model, carrier=excess)
    return widened


def _assemble(data: CampaignData, fits: list[LinearFit], noise: dict[tuple[str, str, str], NoiseModel], *, cubic: bool) -> SlowFlowEstimate:
    # the slopes with temperature are nuisances: what the estimate is for is the mean temperature
    count = fits[0].coefficients.size - (THERMAL_TERMS if data.stiffness_per_k is not None else 0)
    vector = np.concatenate([f.coefficients[:count] for f in fits]).view(np.float64)
    size = 2 * count
    covariance = np.zeros((2 * size, 2 * size))
    covariance[:size, :size], covariance[size:, size:] = fits[0].covariance[:size, :size], fits[1].covariance[:size, :size]
    temperatures = np.array([r.temperature_degc.mean() for r in data.recordings if r.command.oscillator_axis])
    blank = SlowFlowParameters(*(np.zeros((2, 2), dtype=complex) for _ in range(5)))
    estimate = SlowFlowEstimate(
        values=blank,
        covariance=covariance,
        has_feedthrough=True,
        feedthrough_measured=data.feedthrough_measured,
        has_cubic=cubic,
        cubic_gain=0.0,
        omega0_rad_s=data.omega0,
        temperature_degc=float(temperatures.mean()),
        temperature_sd_k=float(temperatures.std()),
        chi2=sum(f.chi2 for f in fits),
        dof=sum(f.dof for f in fits),
        condition_number=max(f.condition_number for f in fits),
        noise=noise,
        table=tuple(_table(data, fits, noise)),
    )
    return replace(estimate, values=estimate.unpack(vector))


def _table(data: CampaignData, fits: list[LinearFit], noise: dict[tuple[str, str, str], NoiseModel]) -> list[TableRow]:
    table = []
    for i, (r, p) in enumerate(zip(data.recordings, data.signal, strict=True)):
        for f in np.unique(p.frequency_hz):
            own = p.frequency_hz == f
            sd = [
                math.sqrt(
                    0.5 * sum(float(noise[AXES[a], role_of(r, a, data.omega0), part].density(np.array([f]))[0]) for part in ("re", "im"))
                )
                for a in range(2)
            ]
            pick, drive = (_phasor(q[own]) for q in (p.pick, p.drive))
            left = [_phasor(fits[a].residuals[i][own][:, None])[0] for a in range(2)]
            table.append(
                TableRow(
                    label=r.label,
                    axis=r.command.oscillator_axis or "",
                    frequency_hz=float(f),
                    pick=(pick[0], pick[1]),
                    drive=(drive[0], drive[1]),
                    residual=(left[0], left[1]),
                    sd=(sd[0], sd[1]),
                )
            )
    return table


def _phasor(projected: ComplexArray) -> list[complex]:
    """Cosine and sine projections as one complex amplitude of e^{+i nu t}, per channel."""
    if projected.shape[0] == 1:
        return [complex(v) for v in projected[0]]
    return [complex(v) for v in (projected[0] - 1j * projected[1]) / math.sqrt(2.0)]
