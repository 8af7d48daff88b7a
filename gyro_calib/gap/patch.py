"""The device file that a diagnosis makes: the linear part as the recordings say, and the effects that they hold.

Recordings give A, G and E in volts. A device file gives resonator, drives and pick-offs, which are more numbers, so a choice is made and
said (:func:`patch_notes`): D and K are symmetric (theory.md Eq. 1), which leaves of A one equation for the pick-offs. They stay as near to
the previous device file as that equation and the factory's drive-gain ratio allow, and what G then holds stands in the drives. A real
rotation, where the gyro was turned, tells the pick-offs themselves.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..device import Device, DriveChain, Feedthrough, Nonlinearity, PickoffChain, Resonator
from ..device.resonator import ZERO_CELSIUS_K
from ..effects import EFFECTS
from ..errors import CalibrationRefused, DeviceError
from ..estimation.separation import Priors
from ..units import DEG_H
from .diagnosis import Diagnosis, PatchedEstimate
from .drifts import BENT
from .forms import GRADIENT_DAMPS

__all__ = ["ONE_KIND", "check_kind", "constant_rate", "patch_notes", "patched_device", "with_factory_data"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Part = TypeVar("Part", Nonlinearity, PickoffChain)
_ROUNDS = 20
_STEP = 1e-6
#: how well a rate table, or the factory's drive-gain ratio, tells the pick-offs against :class:`Priors` of what is known without
_WELL = 0.1
#: what a healthy device may do with temperature: nuisances of the fit that are effects of a device file
_THERMAL = (
    "thermal_damping_anisotropy",
    "thermal_split",
    "thermal_drive_gain",
    "thermal_drive_phase",
    "thermal_pickoff_gain",
)
#: and what of that is a nuisance under another name
_RENAMED = {"thermal_frequency_curvature": "frequency_per_k2", "thermal_damping_curvature": "damping_per_k2", "thermal_bias": "rate_per_k"}
#: share by which nominal frequencies of one design differ at most: units of one come out within percents
ONE_KIND = 0.2
#: is there when the temperature moved enough to fit how the device follows it
_WARMED = "thermal_drive_gain.g_x"
#: coefficients of a device file that are effects of the registry under another name
_OF_PARTS = {
    "duffing": ("cubic_isotropic", "cubic_x", "cubic_y"),
    "cubic_cross_stiffness": ("cubic_cross_xy", "cubic_cross_yx"),
    "nonlinear_damping": ("damping_quadratic",),
}
#: of the pick-offs alike
_OF_PICKOFFS = {"pickoff_nonlinearity": ("cubic_per_v2", "gap_amplitude_v")}
#: what recordings say nothing of
_UNTESTED = ("not testable", "cannot tell")


def check_kind(device: Device, factory: Mapping[str, Any]) -> None:
    """Whether a description may be of the device that was recorded: asked before its recordings are diagnosed.

    Parameters
    ----------
    device : Device
        Nominal or previous description.
    factory : mapping
        Of the campaign.

    Raises
    ------
    DeviceError
        The nominal frequencies are those of two kinds of gyro.
    """
    stated, described = factory.get("nominal_f0_hz"), device.factory_data.nominal_f0_hz
    if isinstance(stated, int | float) and stated > 0.0 and abs(described - stated) > ONE_KIND * stated:
        raise DeviceError(
            f"Device description must be of the gyro that was recorded, with a nominal frequency of about {stated:g} Hz, but got "
            f"{device.device_id!r} of {described:g} Hz: another kind of gyro. Give --device the description of this one."
        )


def patched_device(device: Device, diagnosis: Diagnosis) -> Device:
    """The previous device file with what the diagnosis found in place of what it had.

    Parameters
    ----------
    device : Device
        Nominal or previous description: what no recording says stays its (gain in V/m, modal mass, electronics, loops, noise).
    diagnosis : Diagnosis
        With an estimate.

    Returns
    -------
    Device
        ``slow_flow(rate, temperature_degc=T, omega_rad_s=w)`` at the estimate's T and w gives its A, G and E, the rate being
        :func:`constant_rate` of the two (no E where the electronics of the device let nothing feed through).

    Raises
    ------
    CalibrationRefused
        No estimate, or one that is not of a damped resonator.
    """
    estimate = _estimate_of(diagnosis)
    base = replace(
        device,
        device_id=diagnosis.device_id,
        resonator=replace(
            device.resonator,
            frequency_hz=estimate.omega0_rad_s / (2.0 * math.pi),
            reference_temperature_degc=estimate.temperature_degc,
            angular_gain=estimate.angular_gain,
        ),
        environment=replace(device.environment, temperature_degc=estimate.temperature_degc),
        pickoff=_without_effects(device.pickoff, _OF_PICKOFFS, diagnosis),
        feedthrough=_feedthrough(estimate.E),
        nonlinearity=_without_effects(device.nonlinearity, _OF_PARTS, diagnosis),
        effects=_effects(device, diagnosis, estimate),  # of a skew P has the phase
    )
    if _WARMED in estimate.values:
        base = replace(base, pickoff=replace(base.pickoff, gain_tempco_per_k=0.0), drive=replace(base.drive, gain_tempco_per_k=0.0))
    base = replace(base, pickoff=_pickoffs(base, estimate))
    pick = base.pickoff_matrix()
    inner = np.asarray(np.linalg.solve(pick, estimate.A @ pick), dtype=np.complex128)
    resonator = _resonator(base.resonator, inner, estimate)
    return replace(
        base,
        resonator=resonator,
        drive=_drives(base, np.asarray(np.linalg.solve(pick, estimate.G), dtype=np.complex128), estimate.omega0_rad_s),
        factory_data=replace(device.factory_data, angular_gain_kappa=estimate.angular_gain),
    )


def constant_rate(device: Device, diagnosis: Diagnosis) -> float:
    """Input rate [rad/s] that the recordings hold if ``device``, a patched one, is right: ``simulate --rate`` wants it."""
    estimate = _estimate_of(diagnosis)
    pick = device.pickoff_matrix()
    inner = np.linalg.solve(pick, estimate.A @ pick)
    return float(0.5 * (inner[0, 1] - inner[1, 0]).real / device.resonator.angular_gain)


def patch_notes(device: Device, diagnosis: Diagnosis) -> tuple[str, ...]:
    """What a reader of a patched device file must know, one sentence each.

    Parameters
    ----------
    device : Device
        The patched device.
    diagnosis : Diagnosis
    """
    estimate = _estimate_of(diagnosis)
    found = ", ".join(e.registry_name for e in diagnosis.effects) or "none"
    turned = "rate_mismatch_re" in estimate.values
    notes = [
        f"Patched by a diagnosis of {diagnosis.recordings} recordings of {diagnosis.device_id}; effects found: {found}.",
        f"Linear part about {estimate.omega0_rad_s / (2.0 * math.pi):.6f} Hz at {estimate.temperature_degc:.4f} degC, now the reference "
        "temperature.",
        f"The recordings hold a constant rate of {constant_rate(device, diagnosis) / DEG_H:.2f} deg/h: give it to simulate --rate.",
        "The gyro was turned: mismatch, phase and non-orthogonality of the pick-offs come from its response to rate."
        if turned
        else "Without a rotation the recordings cannot tell pick-off from drive errors: pick-offs are the previous file's as far as the "
        "drive-gain ratio and the symmetry of stiffness allow, and what is left stands in the drives; rate and damping are split likewise.",
        "Gain of the pick-offs [V/m], modal mass, noise, loops and converters are the previous file's.",
    ]
    if not np.any(device.feedthrough_matrix()) and np.any(estimate.E):
        notes.append("The electronics of this device let nothing feed through: the feedthrough that was estimated has no effect.")
    bent = [e.name for e in diagnosis.effects if BENT in e.title]
    if bent:
        notes.append(f"Drifts of a device file are straight: the bent course of {', '.join(bent)} is its mean over these recordings there.")
    new = {e.registry_name for e in diagnosis.effects}
    if _gradient_damps(diagnosis, estimate):
        damping = device.effects["thermal_damping_lag"]["c"]
        notes.append(f"What the gradient of thermal_split_lag damps, {damping:.3g} 1/s/K, is thermal_damping_lag here.")
        new.add("thermal_damping_lag")
    kept = sorted(set(device.effects) - new - {*_THERMAL, *_RENAMED})
    if kept:
        notes.append(f"Kept from the previous file, because these recordings cannot test them: {', '.join(kept)}.")
    return tuple(notes)


def with_factory_data(device: Device, factory: Mapping[str, Any], diagnosis: Diagnosis) -> Device:
    """The device with what the recordings' factory data say of the unit, and a nominal scale factor that fits it.

    Parameters
    ----------
    device : Device
        Nominal or previous description, before it is patched.
    factory : mapping
        Of the campaign. Without a nominal scale factor in it, that of the estimate counts: ``kappa a / |G|`` (theory.md Eq. 7).
    diagnosis : Diagnosis
        Holds that estimate.
    """
    f = device.factory_data
    changes: dict[str, Any] = {
        name: float(factory[key])
        for name, key in (
            ("angular_gain_kappa", "angular_gain_kappa"),
            ("nominal_f0_hz", "nominal_f0_hz"),
            ("nominal_q", "nominal_q"),
            ("nominal_amplitude_v", "nominal_amplitude_v"),
            ("drive_gain_ratio_x_over_y", "drive_gain_ratio_x_over_y"),
        )
        if isinstance(factory.get(key), int | float)
    }
    nominal = factory.get("nominal_scale_factor_v_per_rad_s")
    G, amplitude = _estimate_of(diagnosis).G, changes.get("nominal_amplitude_v", f.nominal_amplitude_v)
    for axis, other, sign in (("x", 1, 1.0), ("y", 0, -1.0)):
        stated = nominal.get(axis) if isinstance(nominal, Mapping) else None
        fitting = sign * float(abs(1.0 / G[other, other])) * changes.get("angular_gain_kappa", f.angular_gain_kappa) * amplitude
        changes[f"nominal_scale_factor_{axis}_v_per_rad_s"] = float(stated) if isinstance(stated, int | float) else fitting
    return replace(device, factory_data=replace(f, **changes))


def _estimate_of(diagnosis: Diagnosis) -> PatchedEstimate:
    if diagnosis.estimate is None:
        raise CalibrationRefused("A diagnosis must have an estimate to make a device of, but got none. Diagnose the recordings again.")
    return diagnosis.estimate


# -- linear part ------------------------------------------------------------------------------------------------------------------------


def _pickoffs(base: Device, estimate: PatchedEstimate) -> PickoffChain:
    """Pick-offs near the previous ones for which the stiffness is symmetric: least departure in units of what is known of them."""
    priors, before = Priors(), base.pickoff
    mean = np.array([before.gain_mismatch, before.phase_y_rad, before.non_orthogonality_rad])
    width = np.array([priors.mismatch, priors.phase_rad, priors.non_orthogonality_rad])
    values, gain = estimate.values, estimate.angular_gain
    if "rate_mismatch_re" in values:
        # theory: dA/dOmega = -kappa M J / sqrt(det M) with M = P P^T (estimation.separation), to first order in the mismatch
        mean = np.array([
            math.exp(-values["rate_mismatch_re"] / gain) - 1.0,
            -values.get("rate_mismatch_im", 0.0) / gain + before.phase_x_rad,
            -0.5 * values.get("rate_skew_re", 0.0) / gain,
        ])  # fmt: skip
        width = width * _WELL
    elif math.isfinite(ratio := base.factory_data.drive_gain_ratio_x_over_y):
        # document 003's premise: the factory's drive-gain ratio is constant
        mean[0] = abs(estimate.G[1, 1] / estimate.G[0, 0]) * ratio - 1.0
        width[0] *= _WELL
    departure = np.zeros(3)

    def chain(q: FloatArray) -> PickoffChain:
        r, phase, n = (float(v) for v in mean + width * q)
        return replace(before, gain_mismatch=r, phase_y_rad=phase, non_orthogonality_rad=n)

    def asymmetry(q: FloatArray) -> float:
        pick = replace(base, pickoff=chain(q)).pickoff_matrix()
        inner = np.linalg.solve(pick, estimate.A @ pick)
        return float((inner[1, 0] - inner[0, 1]).imag)

    for _ in range(_ROUNDS):
        slope = np.array([(asymmetry(departure + _STEP * e) - asymmetry(departure - _STEP * e)) / (2.0 * _STEP) for e in np.eye(3)])
        left = asymmetry(departure)
        if not np.any(slope) or abs(left) <= 1e-13 * np.abs(estimate.A).max():
            break
        # the nearest point to the start on the tangent plane of the condition
        departure = slope * (slope @ departure - left) / (slope @ slope)
    return chain(departure)


def _resonator(before: Resonator, inner: ComplexArray, estimate: PatchedEstimate) -> Resonator:
    """D and K of theory.md Eq. 1 from P^-1 A P without its constant rate."""
    symmetric = 0.5 * (inner + inner.T)
    omega, damping = estimate.omega0_rad_s, -2.0 * symmetric.real
    stiffness = omega**2 * np.eye(2) + 2.0 * omega * symmetric.imag
    rate = 0.25 * float(np.trace(damping))
    square = 0.5 * float(np.trace(stiffness))
    if rate <= 0.0 or square <= 0.0:
        raise CalibrationRefused(f"The estimate must be of a damped resonator, but got a decay of {rate:.3g} 1/s. Check the recordings.")
    natural = math.sqrt(square)
    split, split_azimuth = _azimuth(stiffness / natural)
    anisotropy, damping_azimuth = _azimuth(damping / rate)
    if _WARMED in estimate.values:
        warming = estimate.values.get("thermal_damping.c", 0.0)
        before = replace(
            before,
            frequency_tempco_per_k=estimate.frequency_slope_rad_s_k / natural,
            quality_exponent=warming * (estimate.temperature_degc + ZERO_CELSIUS_K) / rate,
        )
    return replace(
        before,
        frequency_hz=natural / (2.0 * math.pi),
        quality_factor=natural / (2.0 * rate),
        frequency_split_hz=split / (2.0 * math.pi),
        split_azimuth_rad=split_azimuth,
        damping_anisotropy=anisotropy,
        damping_azimuth_rad=damping_azimuth,
    )


def _azimuth(matrix: FloatArray) -> tuple[float, float]:
    """Size and azimuth of the traceless part of a symmetric matrix, ``size R(azimuth)``."""
    c, s = 0.5 * float(matrix[0, 0] - matrix[1, 1]), 0.5 * float(matrix[0, 1] + matrix[1, 0])
    return math.hypot(c, s), 0.25 * math.atan2(s, c) % (0.5 * math.pi)


def _drives(base: Device, force: ComplexArray, omega: float) -> DriveChain:
    """Drive chain of ``P^-1 G``, each element's phase in the channel or in its coupling."""
    hold = float(np.sinc(omega / (2.0 * math.pi) / base.electronics.adc_rate_hz))
    B = 2j * omega / hold * force
    gain = float(abs(B[0, 0]))
    phases = cmath.phase(B[0, 0]), cmath.phase(B[1, 1])
    xy, phase_xy = _coupling(B[0, 1] / gain * cmath.exp(-1j * phases[1]))
    yx, phase_yx = _coupling(B[1, 0] / gain * cmath.exp(-1j * phases[0]))
    return replace(
        base.drive,
        gain_m_s2_per_v=gain,
        gain_mismatch=float(abs(B[1, 1])) / gain - 1.0,
        two_delta_rad=math.atan(0.5 * (yx + xy)),
        two_lambda_rad=math.atan(0.5 * (yx - xy)),
        phase_x_rad=phases[0],
        phase_y_rad=phases[1],
        coupling_phase_xy_rad=phase_xy,
        coupling_phase_yx_rad=phase_yx,
    )


def _coupling(value: complex) -> tuple[float, float]:
    """Signed size and the smaller phase of a coupling."""
    sign = 1.0 if value.real >= 0.0 else -1.0
    return sign * float(abs(value)), cmath.phase(sign * value) if value else 0.0


def _feedthrough(E: ComplexArray) -> Feedthrough:
    return Feedthrough(*(part for row in E for entry in row for part in (float(entry.real), float(entry.imag))))


# -- effects ----------------------------------------------------------------------------------------------------------------------------


def _untested(name: str, diagnosis: Diagnosis) -> bool:
    """Whether these recordings say nothing of an effect: what the previous file has of it stays. Variants by axis stand under one name."""
    status = {s.name: s.status for s in diagnosis.standings}
    return status.get(name.removesuffix("_axes"), status.get(name, _UNTESTED[0])) in _UNTESTED


def _without_effects(part: Part, effects: Mapping[str, tuple[str, ...]], diagnosis: Diagnosis) -> Part:
    """A part of the previous file whose nonlinear coefficients, where measured, give way to the effects."""
    fields = {field: 0.0 for name, fields in effects.items() if not _untested(name, diagnosis) for field in fields}
    return replace(part, **fields)


def _effects(device: Device, diagnosis: Diagnosis, estimate: PatchedEstimate) -> dict[str, dict[str, float]]:
    """What was found, with what a healthy device does with temperature, and what the previous file had and no recording could test."""
    sizes = {name: dict(values) for name, values in device.effects.items() if _untested(name, diagnosis)}
    for name in _THERMAL:
        values = {p.name: estimate.values.get(f"{name}.{p.name}", 0.0) for p in EFFECTS[name].parameters}
        if any(values.values()):
            sizes[name] = values
    for effect in diagnosis.effects:
        sizes[effect.registry_name] = effect.in_device_file()
    if _gradient_damps(diagnosis, estimate):
        column, per_unit = GRADIENT_DAMPS
        sizes["thermal_damping_lag"] = {"c": per_unit * estimate.values[column], "tau": sizes["thermal_split_lag"]["tau"]}
    for name, nuisance in _RENAMED.items():
        if nuisance in estimate.values:
            (parameter,) = (p.name for p in EFFECTS[name].parameters)
            # an effect that was found besides has but its share
            found = sizes[name][parameter] if name in {e.registry_name for e in diagnosis.effects} else 0.0
            sizes[name] = {parameter: found + _healthy(name, estimate)}
    return {name: _within(name, values) for name, values in sizes.items()}


def _gradient_damps(diagnosis: Diagnosis, estimate: PatchedEstimate) -> bool:
    """Whether a gradient was found: what it damps, most of what some show, is an effect of its own in a device file."""
    names = {e.registry_name for e in diagnosis.effects}
    return GRADIENT_DAMPS[0] in estimate.values and "thermal_split_lag" in names and "thermal_damping_lag" not in names


def _healthy(name: str, estimate: PatchedEstimate) -> float:
    """Size of an effect of `_RENAMED` that is a nuisance of the fit, in the effect's unit."""
    size = estimate.values[_RENAMED[name]]
    if name == "thermal_damping_curvature":
        return -size - _bend_of_law(estimate)
    return size / estimate.angular_gain if name == "thermal_bias" else size


def _bend_of_law(estimate: PatchedEstimate) -> float:
    """Half the second derivative [1/s/K^2] of the decay rate that the device file's law of the quality factor makes of the first."""
    kelvin, rate = estimate.temperature_degc + ZERO_CELSIUS_K, -0.5 * float(np.trace(estimate.A).real)
    exponent = estimate.values.get("thermal_damping.c", 0.0) * kelvin / rate
    return 0.5 * rate * exponent * (exponent - 1.0) / kelvin**2


def _within(name: str, values: Mapping[str, float]) -> dict[str, float]:
    """Sizes within the registry's bounds: a noisy estimate of what cannot be negative may be just below zero."""
    effect = EFFECTS[name]
    return {key: min(max(value, effect.parameter(key).lower), effect.parameter(key).upper) for key, value in values.items()}
