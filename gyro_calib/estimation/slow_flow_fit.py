"""Identify the slow flow of a force-rebalance gyro from all recordings at once: A, G, E and the response to body excitation.

All experiments are parts of one linear model (theory.md section 2): side bands and carrier lines of both oscillator axes, open drive off
resonance (feedthrough) and body excitation (pick-off phase) enter one weighted least squares per axis.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

from ..errors import CalibrationRefused
from ..recording.recording import Campaign, Recording
from .linear_fit import AXES, Equation, LinearFit, NoiseModel, fit_axis, fit_noise
from .projection import Projected, project

__all__ = ["SlowFlowEstimate", "SlowFlowParameters", "TableRow", "fit_slow_flow", "usable_recordings"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

#: recordings further than this from the median temperature are left out of the fit [K]
TEMPERATURE_WINDOW_K = 0.5
_ROUNDS = 2
#: fewer carrier lines of one role say nothing of the scatter between records
_FEWEST_RUNS = 4
#: resonance wander when no repeated record tells [rad/s]: a millikelvin of silicon at 15 kHz
_WANDER_RAD_S = 2.5e-3
#: below this span the reference frequency is not regressed on temperature [K]
_TEMPERATURE_SPAN_K = 0.1
#: real cubic parameters of both axes
_CUBIC_TERMS = 8


@dataclass(frozen=True)
class TableRow:
    """One line of the data table: what was applied and measured at a side band, and what the fit leaves.

    Parameters
    ----------
    label, axis : str
        Recording and its oscillator axis (``""`` with loops off).
    frequency_hz : float
        Side band (0: the carrier).
    pick, drive, residual : tuple of 2 complex
        x, y: projected pick-offs and drives [V sqrt(s)], residual of the slow flow [V/s sqrt(s)].
    sd : tuple of 2 float
        Standard deviation of the residual (mean of real and imaginary part).
    """

    label: str
    axis: str
    frequency_hz: float
    pick: tuple[complex, complex]
    drive: tuple[complex, complex]
    residual: tuple[complex, complex]
    sd: tuple[float, float]


@dataclass(frozen=True)
class SlowFlowParameters:
    """One set of values of the slow flow.

    Parameters
    ----------
    A, G, E : ndarray, shape (2, 2), complex
        [1/s], [1/s], dimensionless.
    body : ndarray, shape (2, k), complex
        Response to one volt of body excitation at each of k frequencies [1/s].
    cubic : ndarray, shape (2, 2), complex
        ``c`` of ``c[:, j] |V_j|^2 V_j`` [1/(s V^2)]; zero when not fitted. Diagonal: imaginary Duffing, real nonlinear damping;
        off the diagonal: cubic cross stiffness and cross damping (document 000, Eqs. 22-27).
    """

    A: ComplexArray
    G: ComplexArray
    E: ComplexArray
    body: ComplexArray
    cubic: ComplexArray


@dataclass(frozen=True)
class SlowFlowEstimate:
    """What the recordings say of the slow flow about ``omega0_rad_s`` at ``temperature_degc``.

    Parameters
    ----------
    values : SlowFlowParameters
        Best estimate; ``A`` includes the constant input rate.
    covariance : ndarray, shape (n, n)
        Of the real parameter vector, see :meth:`vector`.
    has_feedthrough, has_cubic : bool
        E was measured (otherwise zero); the cubic terms were fitted (otherwise zero).
    cubic_gain : float
        How much chi-square the four cubic terms of both axes take away (0 when they were not tried).
    omega0_rad_s, temperature_degc, temperature_sd_k : float
        Operating point.
    chi2, dof, condition_number : float
        Fit quality, both axes together.
    noise : mapping
        (axis, role, part) -> NoiseModel.
    table : tuple of TableRow
        The data table.
    """

    values: SlowFlowParameters
    covariance: FloatArray
    has_feedthrough: bool
    has_cubic: bool
    cubic_gain: float
    omega0_rad_s: float
    temperature_degc: float
    temperature_sd_k: float
    chi2: float
    dof: int
    condition_number: float
    noise: dict[tuple[str, str, str], NoiseModel]
    table: tuple[TableRow, ...]

    def vector(self) -> FloatArray:
        """Real parameters per axis: A_ax, A_ay, G~_ax, G~_ay, (E_ax, E_ay), (H_a per body frequency), (c_ax, c_ay), each (re, im)."""
        v = self.values
        parts = [v.A, v.G - v.A @ v.E]
        if self.has_feedthrough:
            parts.append(v.E)
        parts.append(v.body)
        if self.has_cubic:
            parts.append(v.cubic)
        return np.ascontiguousarray(np.hstack(parts)).view(np.float64).ravel()

    def unpack(self, vector: FloatArray) -> SlowFlowParameters:
        """Values of a real parameter vector."""
        parts = np.ascontiguousarray(vector).view(np.complex128).reshape(2, -1)
        A, reduced, rest = parts[:, 0:2], parts[:, 2:4], parts[:, 4:]
        E = cubic = np.zeros((2, 2), dtype=complex)
        if self.has_feedthrough:
            E, rest = rest[:, :2], rest[:, 2:]
        if self.has_cubic:
            rest, cubic = rest[:, :-2], rest[:, -2:]
        return SlowFlowParameters(A, reduced + A @ E, E, rest, cubic)


def usable_recordings(campaign: Campaign, window_k: float = TEMPERATURE_WINDOW_K) -> tuple[list[Recording], list[str]]:
    """Recordings that a fit at one temperature and one constant rate may use, and why others are left out."""
    wanted = [r for r in campaign if r.command.mode in ("ftr_x", "ftr_y") or _is_open(r)]
    skipped = []
    chosen = []
    median = float(np.median([r.temperature_degc.mean() for r in wanted])) if wanted else math.nan
    for r in wanted:
        temperature = r.temperature_degc
        if "applied_rate" in r.extras:
            skipped.append(f"{r.label}: a rate was applied")
        elif abs(temperature.mean() - median) > window_k or np.ptp(temperature) > 2.0 * window_k:
            skipped.append(f"{r.label}: temperature {temperature.min():.2f} to {temperature.max():.2f} degC, median {median:.2f}")
        elif r.command.excitation.kind not in ("none", "amplitude_modulation", "drive", "body"):
            skipped.append(f"{r.label}: excitation {r.command.excitation.kind}")
        else:
            chosen.append(r)
    return chosen, skipped


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
    data = _Data.of(recordings, decay_rate)
    if cubic is None:
        plain = _fit(data, cubic=False, noise=noise)
        amplitudes = {round(r.command.setpoints.amplitude_v, 9) for r in recordings if r.command.oscillator_axis}
        if len(amplitudes) < 3:
            return plain
        # both fits are weighed with the noise of the richer one: the poorer one's misfit leaks into its own noise estimate
        rich = _fit(data, cubic=True, noise=noise)
        poor = _fit(data, cubic=False, noise=rich.noise)
        gain = poor.chi2 - rich.chi2
        ratio = (gain / _CUBIC_TERMS) / (rich.chi2 / max(rich.dof, 1))
        asked = ratio > fdtri(_CUBIC_TERMS, max(rich.dof, 1), 1.0 - 1e-3)
        return replace(rich if asked else plain, cubic_gain=gain)
    return _fit(data, cubic=cubic, noise=noise)


@dataclass(frozen=True)
class _Data:
    """Projected recordings at the lines of interest and at quiet lines; ``wander_rad_s``: how the resonance moves between records."""

    recordings: list[Recording]
    omega0: float
    wander_rad_s: float
    has_feedthrough: bool
    bodies: list[float]
    signal: list[Projected]
    quiet: list[Projected]

    @classmethod
    def of(cls, recordings: list[Recording], decay_rate: float) -> _Data:
        omega0 = float(np.mean([r.ref_omega_rad_s.mean() for r in recordings if r.command.oscillator_axis]))
        slope, middle, wander = _resonance_motion(recordings)

        def shift(recording: Recording) -> FloatArray:
            return slope * (recording.temperature_degc - middle)

        return cls(
            recordings=recordings,
            omega0=omega0,
            wander_rad_s=wander,
            has_feedthrough=any(r.command.excitation.kind == "drive" for r in recordings),
            bodies=sorted({r.command.excitation.frequency_hz for r in recordings if r.command.excitation.kind == "body"}),
            signal=[project(r, _lines(r), omega0, decay_rate, shift(r)) for r in recordings],
            quiet=[project(r, _quiet_lines(r), omega0, decay_rate, shift(r)) for r in recordings],
        )

    def columns(self, projected: list[Projected], *, cubic: bool) -> list[ComplexArray]:
        """Regressors of every recording: V, u, L[u] when E is sought, the body's volts by frequency, |V|^2 V when asked."""
        columns = []
        for p, r in zip(projected, self.recordings, strict=True):
            parts = [p.pick, p.drive]
            if self.has_feedthrough:
                parts.append(p.drive_rate)
            parts += [(p.body * (r.command.excitation.frequency_hz == f))[:, None] for f in self.bodies]
            if cubic:
                parts.append(p.cubic)
            columns.append(np.hstack(parts))
        return columns


def _resonance_motion(recordings: list[Recording]) -> tuple[float, float, float]:
    """How the resonance moves, from the closed-loop reference frequencies.

    Returns its slope with temperature [rad/s/K] (zero when the temperature hardly moved: then its wander says nothing), the mean temperature,
    and the standard deviation of what the slope does not explain [rad/s]. They bring the loops-off records, whose reference does not follow
    the resonance, to where the resonance was, and say how well.
    """
    loops = [r for r in recordings if r.command.oscillator_axis]
    temperature = np.array([r.temperature_degc.mean() for r in loops])
    middle = float(temperature.mean())
    omega = np.array([r.ref_omega_rad_s.mean() for r in loops])
    # an amplitude of its own shifts the frequency (Duffing): one mean for every axis and amplitude
    groups = sorted({(r.command.oscillator_axis or "", r.command.setpoints.amplitude_v) for r in loops})
    columns = [np.array([(r.command.oscillator_axis, r.command.setpoints.amplitude_v) == g for r in loops], dtype=float) for g in groups]
    if moved := bool(np.ptp(temperature) >= _TEMPERATURE_SPAN_K):
        columns.append(temperature - middle)
    design = np.column_stack(columns)
    solution = np.linalg.lstsq(design, omega, rcond=None)[0]
    left = omega - design @ solution
    spare = len(loops) - design.shape[1]
    wander = math.sqrt(float(left @ left) / spare) if spare > 0 else _WANDER_RAD_S
    return (float(solution[-1]) if moved else 0.0), middle, max(wander, 1e-4)


def _fit(data: _Data, *, cubic: bool, noise: Mapping[tuple[str, str, str], NoiseModel] | None = None) -> SlowFlowEstimate:
    """Both axes, with the noise measured along the way or given."""
    columns, quiet_columns = data.columns(data.signal, cubic=cubic), data.columns(data.quiet, cubic=cubic)
    fits: list[LinearFit] = []
    found: dict[tuple[str, str, str], NoiseModel] = dict(noise or {})
    for axis in range(2):
        roles = [_role(r, axis, data.omega0) for r in data.recordings]
        flat = NoiseModel((1.0, 0.0, 0.0), 0.01)
        models = {(role, part): found.get((AXES[axis], role, part), flat) for role in set(roles) for part in ("re", "im")}
        fit = fit_axis(_equations(data, columns, roles, axis, models))
        for _ in range(0 if noise else _ROUNDS):
            models = _measure_noise(data, quiet_columns, roles, axis, fit.coefficients)
            fit = fit_axis(_equations(data, columns, roles, axis, models))
            models = _run_to_run(data, roles, models, fit)
            fit = fit_axis(_equations(data, columns, roles, axis, models))
        fits.append(fit)
        found |= {(AXES[axis], role, part): model for (role, part), model in models.items()}
    return _assemble(data, fits, found, cubic=cubic)


def _equations(
    data: _Data, columns: list[ComplexArray], roles: list[str], axis: int, models: dict[tuple[str, str], NoiseModel]
) -> list[Equation]:
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


def _is_open(recording: Recording) -> bool:
    return recording.command.mode == "loops_off" and recording.command.excitation.kind in ("drive", "body")


def _role(recording: Recording, axis: int, omega0: float) -> str:
    """Recordings of one role share their noise: the pick-off's part of it grows with the distance from resonance."""
    oscillator = recording.command.oscillator_axis
    if oscillator is None:
        return f"open at {abs(recording.command.excitation.frequency_hz - omega0 / (2.0 * math.pi)):.0f} Hz"
    return "oscillator" if oscillator == AXES[axis] else "closed"


def _lines(recording: Recording) -> list[float]:
    excitation = recording.command.excitation
    return [0.0, excitation.frequency_hz] if excitation.kind == "amplitude_modulation" else [0.0]


def _quiet_lines(recording: Recording) -> list[float]:
    """Lines near those of interest where nothing was commanded."""
    step = 1.0 / recording.duration_s
    excitation = recording.command.excitation
    busy = np.arange(1, 6) * excitation.frequency_hz if excitation.kind == "amplitude_modulation" else np.zeros(0)
    top = min(max(4.0, 4.0 * step), 0.2 * recording.sample_rate_hz)
    candidates = np.arange(1.8 * step, top, 1.3 * step)
    free = [f for f in candidates if busy.size == 0 or np.min(np.abs(busy - f)) > 1.7 * step]
    if len(free) > 24:
        free = [free[i] for i in np.unique(np.geomspace(1, len(free), 24).astype(int) - 1)]
    return [float(f) for f in free]


def _measure_noise(
    data: _Data, columns: list[ComplexArray], roles: list[str], axis: int, coefficients: ComplexArray
) -> dict[tuple[str, str], NoiseModel]:
    models = {}
    for role in set(roles):
        members = [i for i, r in enumerate(roles) if r == role]
        residual = np.concatenate([data.quiet[i].lhs[:, axis] - columns[i] @ coefficients for i in members])
        lines = np.concatenate([data.quiet[i].frequency_hz for i in members])
        lowest = 0.3 / max(data.recordings[i].duration_s for i in members)
        models[role, "re"] = fit_noise(lines, residual.real**2, lowest)
        models[role, "im"] = fit_noise(lines, residual.imag**2, lowest)
    return models


def _run_to_run(
    data: _Data, roles: list[str], models: dict[tuple[str, str], NoiseModel], fit: LinearFit
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


def _assemble(data: _Data, fits: list[LinearFit], noise: dict[tuple[str, str, str], NoiseModel], *, cubic: bool) -> SlowFlowEstimate:
    vector = np.concatenate([f.coefficients for f in fits]).view(np.float64)
    size = fits[0].covariance.shape[0]
    covariance = np.zeros((2 * size, 2 * size))
    covariance[:size, :size], covariance[size:, size:] = fits[0].covariance, fits[1].covariance
    temperatures = np.array([r.temperature_degc.mean() for r in data.recordings if r.command.oscillator_axis])
    blank = SlowFlowParameters(*(np.zeros((2, 2), dtype=complex) for _ in range(5)))
    estimate = SlowFlowEstimate(
        values=blank,
        covariance=covariance,
        has_feedthrough=data.has_feedthrough,
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


def _table(data: _Data, fits: list[LinearFit], noise: dict[tuple[str, str, str], NoiseModel]) -> list[TableRow]:
    table = []
    for i, (r, p) in enumerate(zip(data.recordings, data.signal, strict=True)):
        for f in np.unique(p.frequency_hz):
            own = p.frequency_hz == f
            sd = [
                math.sqrt(
                    0.5 * sum(float(noise[AXES[a], _role(r, a, data.omega0), part].density(np.array([f]))[0]) for part in ("re", "im"))
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
