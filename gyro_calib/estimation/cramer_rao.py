"""Cramer-Rao bound of the slow-flow parameters: what no unbiased estimate can beat with these signals and this noise.

The bound of a linear model ``L[V] = sum_k r_k(t) c_k + e(t)`` with white circular ``e`` of two-sided density S per quadrature is the
inverse of ``F = sum_records integral Re[r_j* r_k] / S dt`` over the whole record (rectangular window, every instant), with each record's
own resonance shift as a nuisance. It shares neither the projection nor the weights nor the noise estimate of the product estimator.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..device import Device
from ..recording.recording import Recording

__all__ = ["device_noise_density", "resonance_wander_density", "slow_flow_bound"]

FloatArray = NDArray[np.float64]


def device_noise_density(device: Device, temperature_degc: float) -> Callable[[float], float]:
    """Two-sided density of ``e`` per quadrature [V^2/s^2/Hz] of a simulated device, by detuning [rad/s].

    Force noise of acceleration density S_f gives ``2 S_f (P/2w)^2``, pick-off noise of one-sided density n ``n^2 |i delta + 1/tau|^2``.
    """
    noise = device.noise
    thermal = device.resonator.thermal_acceleration_psd(temperature_degc) if noise.thermomechanical else 0.0
    force = thermal + 0.5 * (noise.drive_v_rthz * device.drive.gain_m_s2_per_v) ** 2
    response = device.pickoff.gain_v_per_m / (2.0 * device.resonator.omega0_rad_s)
    decay = device.resonator.decay_rate(temperature_degc)

    def density(detuning_rad_s: float) -> float:
        return 2.0 * force * response**2 + noise.pickoff_v_rthz**2 * (detuning_rad_s**2 + decay**2)

    return density


def resonance_wander_density(device: Device) -> Callable[[float], float]:
    """Two-sided density of the resonance's wander with temperature [(rad/s)^2/Hz] by frequency [Hz] (Ornstein-Uhlenbeck).

    The oscillator carries it: times its amplitude it is noise of the 90-degree part of its own equation, far above the white part.
    """
    resonator, surroundings = device.resonator, device.environment
    variance = (surroundings.wander_k * resonator.frequency_tempco_per_k * resonator.omega0_rad_s) ** 2

    def density(frequency_hz: float) -> float:
        corner = 2.0 * math.pi * frequency_hz * surroundings.wander_time_s
        return 2.0 * variance * surroundings.wander_time_s / (1.0 + corner**2)

    return density


def slow_flow_bound(
    recordings: list[Recording],
    omega0_rad_s: float,
    density: Callable[[float], float],
    *,
    has_feedthrough: bool,
    bodies: list[float],
    wander_rad_s: float,
    wander_density: Callable[[float], float],
    damping_wander: float,
) -> FloatArray:
    """Covariance bound of the parameter vector of :class:`.slow_flow_fit.SlowFlowEstimate` (without cubic terms), shape (n, n).

    Parameters
    ----------
    recordings : list of Recording
        What was recorded; the signals are far above their noise and enter as they are.
    omega0_rad_s : float
        Frequency about which A is written.
    density : callable
        Noise density of a detuning.
    has_feedthrough, bodies
        As in the fit: E is an unknown; body frequencies [Hz].
    wander_rad_s : float
        Standard deviation of the resonance between records: how well an open drive's distance from it can be known.
    wander_density : callable
        Its density inside a record [(rad/s)^2/Hz], taken at the side band.
    damping_wander : float
        Standard deviation of 1/tau between records, Q following the same temperature [1/s].
    """
    blocks = [
        _axis_bound(recordings, axis, omega0_rad_s, density, has_feedthrough, bodies, wander_rad_s, wander_density, damping_wander)
        for axis in range(2)
    ]
    size = blocks[0].shape[0]
    bound = np.zeros((2 * size, 2 * size))
    bound[:size, :size], bound[size:, size:] = blocks
    return bound


def _axis_bound(
    recordings: list[Recording],
    axis: int,
    omega0: float,
    density: Callable[[float], float],
    has_feedthrough: bool,
    bodies: list[float],
    wander: float,
    wander_density: Callable[[float], float],
    damping_wander: float,
) -> FloatArray:
    count = 2 * (4 + 2 * int(has_feedthrough) + len(bodies))
    closed = "yx"[axis]
    shifts = [i for i, r in enumerate(recordings) if r.command.oscillator_axis != closed]
    # behind the parameters: each record's resonance shift, then each oscillator record's change of damping
    size = count + 2 * len(shifts)
    information = np.zeros((size, size))
    for i, r in enumerate(recordings):
        detuning = r.ref_omega_rad_s - omega0
        columns = [r.pick[:, 0], r.pick[:, 1], r.drive[:, 0], r.drive[:, 1]]
        if has_feedthrough:
            columns += [1j * detuning * r.drive[:, 0], 1j * detuning * r.drive[:, 1]]
        excitation = r.command.excitation
        columns += [
            np.full(len(r), excitation.volts * (excitation.kind == "body" and excitation.frequency_hz == f), complex) for f in bodies
        ]
        complex_columns = np.column_stack(columns)
        real = np.zeros((2 * len(r), size))
        real[: len(r), 0:count:2], real[: len(r), 1:count:2] = complex_columns.real, -complex_columns.imag
        real[len(r) :, 0:count:2], real[len(r) :, 1:count:2] = complex_columns.imag, complex_columns.real
        if i in shifts:
            own = count + shifts.index(i)
            real[: len(r), own], real[len(r) :, own] = -r.pick[:, axis].imag, r.pick[:, axis].real
            if r.command.oscillator_axis is None:
                information[own, own] += 1.0 / wander**2
            else:
                real[: len(r), own + len(shifts)], real[len(r) :, own + len(shifts)] = r.pick[:, axis].real, r.pick[:, axis].imag
            information[own + len(shifts), own + len(shifts)] += 1.0 / damping_wander**2
        white = density(float(detuning.mean()))
        ninety = white
        if excitation.kind == "amplitude_modulation" and r.command.oscillator_axis == "xy"[axis]:
            ninety += float(np.mean(np.abs(r.pick[:, axis]) ** 2)) * wander_density(excitation.frequency_hz)
        for part, level in ((real[: len(r)], white), (real[len(r) :], ninety)):
            information += part.T @ part / (level * r.sample_rate_hz)
    scale = np.sqrt(np.diag(information))
    inverse = np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)
    if not math.isfinite(float(inverse.sum())):
        raise np.linalg.LinAlgError("The recordings do not excite every parameter: the bound does not exist.")
    return np.asarray(inverse[:count, :count])
