"""The virtual-precession method (document 004) on a whole-angle campaign: from recordings to rate, bias, scale factor, drive chain."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import CalibrationRefused
from ..quantity import Quantity
from ..recording.recording import Campaign
from .compensation import CHAIN_NAMES, IdentifiedChain
from .drive_chain import DriveChain
from .gain_ratio import off_axis, ring_gain, scale_factor
from .held import held_quadrature
from .latency import loop_latency
from .result import CalibrationResult, ConvergencePoint, MissionChannel
from .separation import Priors
from .slow_flow_data import TEMPERATURE_WINDOW_K
from .wave_data import WaveData
from .whole_angle_fit import WholeAngleEstimate, fit_wave_data, usable_wave_recordings, without_needless_lag
from .whole_angle_values import Derived, WholeAngleValues, unit_of

__all__ = ["calibrate_whole_angle"]

FloatArray = NDArray[np.float64]
_CHI2_WARN = 2.0
_CONVERGENCE_POINTS = 4
_AXES = ("x", "y")
#: relative uncertainty of a drive gain from which on nothing is calibrated
_WORST_GAIN = 0.05
#: a ring-down counts for an axis when its wave was this near to it
_NEAR_AXIS_RAD = 0.2


def calibrate_whole_angle(
    campaign: Campaign,
    *,
    priors: Priors | None = None,
    on_progress: Callable[[float], None] | None = None,
    with_convergence: bool = True,
    temperature_window_k: float = TEMPERATURE_WINDOW_K,
) -> CalibrationResult:
    """Estimate rate, bias, scale factor and drive chain of a whole-angle gyro.

    Parameters
    ----------
    campaign : Campaign
        Virtual precession of both senses at two or more volts; better with ring-down and ring-up, free runs, open drive (feedthrough) and
        body excitation (pick-off phase). Rate-table runs are used when they are there.
    priors : Priors, optional
        What is known of the pick-off chain.
    on_progress : callable, optional
        Called with a fraction 0-1.
    with_convergence : bool
        Also estimate from growing subsets of the recordings.
    temperature_window_k : float
        Recordings further than this from the median temperature are left out [K].

    Raises
    ------
    CalibrationRefused
        The recordings do not support the estimate; the text says what to record.
    """
    kappa = campaign.factory.get("angular_gain_kappa")
    if not isinstance(kappa, int | float) or not kappa > 0:
        raise CalibrationRefused(
            f"Factory data must hold a positive angular_gain_kappa, but got {kappa!r}. "
            "No self-calibration sees it: take it from the factory."
        )
    priors = priors or Priors()
    recordings, skipped = usable_wave_recordings(campaign, temperature_window_k)
    waves = [r for r in recordings if r.command.mode == "whole_angle"]
    if not waves:
        raise CalibrationRefused("Campaign must hold whole-angle recordings, but got none. Record virtual precession of both senses.")
    amplitude = float(campaign.factory.get("nominal_amplitude_v", 0.0)) or float(
        np.median([r.command.setpoints.amplitude_v for r in waves])
    )
    decay = math.pi * float(campaign.factory.get("nominal_f0_hz", 0.0)) / float(campaign.factory.get("nominal_q", math.inf))
    twice = bool(campaign.factory.get("drive_at_twice_frequency", False))
    data = without_needless_lag(WaveData.of(recordings, decay, amplitude if twice else None))
    estimate = fit_wave_data(data)
    if on_progress is not None:
        on_progress(0.5)
    _check_drives(estimate)
    latency = loop_latency(recordings)
    values = WholeAngleValues(
        estimate,
        campaign.factory,
        priors,
        amplitude,
        latency or _stated_latency(campaign.factory),
        np.reshape(np.asarray(waves[-1].command.compensation), (2, 2)),
        quadrature=held_quadrature(waves),
    )
    # the noise that the fit weighed with already holds what the signal lines show beyond the quiet ones
    derived, covariance = values.propagate(estimate.covariance)
    convergence: tuple[ConvergencePoint, ...] = ()
    if with_convergence:
        convergence = _convergence(data, campaign.factory, priors, amplitude, tuple(estimate.term_gains), on_progress)
    verdicts = _verdicts(estimate, values, derived, covariance, skipped)
    return _result(campaign, estimate, values, derived, covariance, latency, verdicts, convergence)


def _check_drives(estimate: WholeAngleEstimate) -> None:
    """Refuse recordings that say nothing of what a volt does: a wave that is merely held balances drive against damping at any scale."""
    G, sd = estimate.flow.values.G, np.sqrt(np.diag(estimate.flow.covariance)).reshape(2, -1)
    for axis in range(2):
        relative = float(sd[axis, 2 * (2 + axis) + 1]) / abs(G[axis, axis])
        if relative > _WORST_GAIN:
            raise CalibrationRefused(
                f"Recordings must excite the drives, but they leave the gain of {_AXES[axis]} uncertain by {100.0 * relative:.2g} %. "
                "Record virtual precession of both senses, or ring-down and ring-up."
            )


def _stated_latency(factory: Mapping[str, Any]) -> Quantity:
    """What the factory says of the loops' latency, where no wave turned: known to a tenth."""
    stated = factory.get("loop_latency_s")
    value = float(stated) if isinstance(stated, int | float) else 0.0
    return Quantity(value, 0.1 * value, "s")


def _result(
    campaign: Campaign,
    estimate: WholeAngleEstimate,
    values: WholeAngleValues,
    derived: Derived,
    covariance: FloatArray,
    latency: Quantity | None,
    verdicts: tuple[tuple[str, ...], tuple[str, ...]],
    convergence: tuple[ConvergencePoint, ...],
) -> CalibrationResult:
    flow = estimate.flow
    index = {name: i for i, name in enumerate(derived.names)}
    sd = np.sqrt(np.diag(covariance))

    def q(name: str) -> Quantity:
        return Quantity(float(derived.values[index[name]]), float(sd[index[name]]), unit_of(name))

    pick = [index["wave_bias"], index["wave_scale"]]
    chain = [index[f"{name}_seen"] for name in CHAIN_NAMES]
    mission = MissionChannel(float(derived.values[pick[0]]), float(derived.values[pick[1]]), covariance[np.ix_(pick, pick)], unit="rad/s")
    left_out = ("rate", "bias_x", "bias_y", "scale_x", "scale_y")
    parameters = {name: q(name) for name in derived.names if name not in left_out}
    for name, value in estimate.terms.items():
        unit = "1/V^2" if name.startswith("pickoff") else "1/(s V^2)"
        parameters[f"{name}_re"] = Quantity(value.real, estimate.terms_sd[name][0], unit)
        parameters[f"{name}_im"] = Quantity(value.imag, estimate.terms_sd[name][1], unit)
    if latency is not None:
        parameters["loop_latency"] = latency
    parameters |= _gain_ratio(campaign, values, derived)
    return CalibrationResult(
        device_id=campaign.device_id,
        method="virtual_precession",
        rate=q("rate"),
        bias={a: q(f"bias_{a}") for a in _AXES},
        scale_factor={a: q(f"scale_{a}") for a in _AXES},
        mission={"whole_angle": mission},
        parameters=parameters,
        rate_noise_density={"whole_angle": _noise_density(estimate, values)},
        condition_number=flow.condition_number,
        chi2_per_dof=flow.chi2 / flow.dof,
        amplitude_v=values.amplitude,
        temperature_degc=flow.temperature_degc,
        temperature_sd_k=flow.temperature_sd_k,
        reference_frequency_hz=flow.omega0_rad_s / (2.0 * math.pi),
        not_observable=verdicts[0],
        warnings=verdicts[1],
        table=flow.table,
        convergence=convergence,
        drive_chain=IdentifiedChain(
            DriveChain(*(float(derived.values[i]) for i in chain)), covariance[np.ix_(chain, chain)], *values.damping_pattern()
        ),
        axis_scale_covariance=float(covariance[index["scale_x"], index["scale_y"]]),
        compensation=next(r for r in reversed(campaign.recordings) if r.command.mode == "whole_angle").command.compensation,
    )


def _gain_ratio(campaign: Campaign, values: WholeAngleValues, derived: Derived) -> dict[str, Quantity]:
    """Scale factors by document 003's amplitude method, where ring-down and ring-up were recorded: a check by other equations."""
    if values.drive_ratio is None:
        return {}
    named = dict(zip(derived.names, derived.values, strict=True))
    chain = DriveChain(*(float(named[f"{name}_seen"]) for name in ("delta_g", "two_delta", "two_lambda")))
    ratio = Quantity(values.drive_ratio, values.priors.drive_ratio * values.drive_ratio, "1")
    cross = float(named["A_xy_re"] + named["A_yx_re"])
    flow = values.estimate.flow
    feedthrough = flow.values.E if flow.has_feedthrough else None
    twice = values.amplitude if campaign.factory.get("drive_at_twice_frequency", False) else None
    found = {}
    for axis in _AXES:
        legs = [r for r in campaign if r.command.mode.startswith("ring_") and abs(off_axis(r, axis)) < _NEAR_AXIS_RAD]
        try:
            ring = ring_gain(legs, axis, chain=chain, cross_damping=cross, drive_amplitude_v=twice, feedthrough=feedthrough)
        except CalibrationRefused:
            continue
        found[f"scale_factor_{axis}_gain_ratio"] = scale_factor(ring.gain, axis, ratio, values.kappa, values.amplitude, chain=chain)
    return found


def _noise_density(estimate: WholeAngleEstimate, values: WholeAngleValues) -> Quantity:
    """White rate noise, one-sided: the force noise across the wave over its effect on the rate, median of the recordings."""
    found = [model.coefficients[0] for (channel, label, _), model in estimate.flow.noise.items() if channel == "precession"]
    density = math.sqrt(2.0 * float(np.median(found))) / (values.kappa * values.amplitude)
    return Quantity(density, 0.2 * density, "rad/s/sqrt(Hz)")


def _verdicts(
    estimate: WholeAngleEstimate, values: WholeAngleValues, derived: Derived, covariance: FloatArray, skipped: list[str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    index = {name: i for i, name in enumerate(derived.names)}
    sd = np.sqrt(np.diag(covariance))
    not_observable = ["angular_gain_kappa: taken from the factory, no self-calibration sees it"]
    seen = float(derived.values[index["two_lambda_seen"]])
    not_observable.append(
        f"two_lambda: only relative to the pick-offs (two_lambda_seen = {seen:.6g} rad, what bias and compensation need); how "
        f"the pick-offs are turned in the body is a choice of axes, known to {values.priors.rotation_rad:.0e} rad. "
        "Crosstalk of the drive electronics in phase with the forcers counts as theirs, in two_delta too"
    )
    limits = (
        ("pickoff_ratio", 3e-4, "store the factory's drive-gain ratio, or turn the gyro once"),
        ("pickoff_phase", 1e-4, "record body excitation off resonance, or turn the gyro once; rate and bias are known apart no better"),
        ("pickoff_non_orthogonality", 1e-3, "needs cross stiffness and a frequency split along the axes, or a turn of the gyro"),
    )
    for name, limit, remedy in limits:
        found = float(sd[index[name]])
        if found > limit:
            not_observable.append(f"{name}: known to {found:.1e} only, {limit:.0e} is needed; {remedy}")
    warnings = []
    flow = estimate.flow
    if not flow.has_feedthrough:
        warnings.append("feedthrough E was not measured and is taken as zero: record open drive off resonance (run_feedthrough)")
    if flow.chi2 / flow.dof > _CHI2_WARN:
        warnings.append(
            f"the model leaves chi-square/dof {flow.chi2 / flow.dof:.1f}: an effect is missing from it, or the noise is no noise "
            "(converter steps); standard deviations allow for it, diagnose the gap before trusting them"
        )
    for name, gain in estimate.term_gains.items():
        warnings.append(f"{name} terms were needed (chi-square falls by {gain:.0f}): a nonlinearity is part of this estimate")
    if skipped:
        warnings.append("left out: " + "; ".join(skipped))
    return tuple(not_observable), tuple(warnings)


def _convergence(
    data: WaveData,
    factory: Mapping[str, Any],
    priors: Priors,
    amplitude: float,
    terms: tuple[str, ...],
    on_progress: Callable[[float], None] | None,
) -> tuple[ConvergencePoint, ...]:
    """Estimates from the open records and the first k others, k growing in time."""
    numbers = range(len(data.recordings))
    apart = [i for i in numbers if data.recordings[i].command.mode == "loops_off"]
    others = sorted((i for i in numbers if i not in apart), key=lambda i: float(data.recordings[i].t[0]))
    points = []
    marks = sorted({max(2, round(len(others) * (k + 1) / _CONVERGENCE_POINTS)) for k in range(_CONVERGENCE_POINTS)})
    for done, mark in enumerate(marks):
        try:
            estimate = fit_wave_data(data.subset(apart + others[:mark]), terms)
        except CalibrationRefused:
            continue
        values = WholeAngleValues(estimate, factory, priors, amplitude, _stated_latency(factory), np.eye(2), with_wave=False)
        derived, covariance = values.propagate(estimate.covariance)
        found = {
            name: Quantity(float(value), float(sd), unit_of(name))
            for name, value, sd in zip(derived.names, derived.values, np.sqrt(np.diag(covariance)), strict=True)
        }
        points.append(
            ConvergencePoint(
                float(data.recordings[others[mark - 1]].t[-1]),
                {a: found[f"bias_{a}"] for a in _AXES},
                {a: found[f"scale_{a}"] for a in _AXES},
            )
        )
        if on_progress is not None:
            on_progress(0.5 + 0.5 * (done + 1) / len(marks))
    return tuple(points)
