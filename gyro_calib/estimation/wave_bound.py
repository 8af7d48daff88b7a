"""Cramer-Rao bound of a whole-angle campaign: what no unbiased estimate can beat with these signals and this noise.

Time domain, no projection, no frame of the wave, no weights of the estimator. With block means V_k of the pick-offs over T the slow flow
(theory.md Eq. 3) reads, w_k the triangle over two neighbouring blocks,

    (V_(k+1) - V_k)/T + i <dw V>_w = A <V>_w + G~ <u>_w + E <L[u]>_w + noise,

linear in what is sought, and the covariance of its noise is known in closed form from the device's densities: white forces, pick-off noise
(a moving average of first order) and flicker of the drives (correlated over the whole campaign, across recordings). The temperature
wanders too, but it is recorded: how resonance, damping and gain follow it are three more unknowns, and what is sought is A and G at the
recordings' mean temperature. The bound is ``(X^T C^-1 X)^-1`` with that dense C. What is left out: noise in the regressors, of second
order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from ..device import Device
from ..recording.recording import Recording
from .cramer_rao import device_noise_density

__all__ = ["WaveNoise", "wave_bound"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: length of a block [s]: short against a turn of the wave, long against the rows' filter
_BLOCK_S = 0.5
#: points over which a triangle is summed
_FINE = 24


@dataclass(frozen=True)
class WaveNoise:
    """Noise of a simulated gyro, per quadrature and axis, two-sided densities.

    Parameters
    ----------
    force : float
        White, of the slow flow [V^2/s^2/Hz].
    pickoff : float
        White, of the pick-offs [V^2/Hz].
    flicker_v : float
        Standard deviation of each Ornstein-Uhlenbeck part of the stray drive [V].
    flicker_times_s : ndarray
        Their correlation times [s].
    """

    force: float
    pickoff: float
    flicker_v: float
    flicker_times_s: FloatArray

    @classmethod
    def of(cls, device: Device, temperature_degc: float, flicker_times_s: FloatArray) -> WaveNoise:
        """From a device file and the correlation times of the simulated flicker."""
        density, decay = device_noise_density(device, temperature_degc), device.resonator.decay_rate()
        pickoff = device.noise.pickoff_v_rthz**2
        return cls(
            force=density(0.0) - pickoff * decay**2,
            pickoff=pickoff,
            flicker_v=device.noise.drive_flicker_v,
            flicker_times_s=flicker_times_s,
        )


def wave_bound(
    recordings: list[Recording],
    omega0_rad_s: float,
    noise: WaveNoise,
    flow: tuple[ComplexArray, ComplexArray],
    *,
    has_feedthrough: bool,
    bodies: list[float],
    block_s: float = _BLOCK_S,
) -> FloatArray:
    """Covariance bound of the parameter vector of :class:`.whole_angle_fit.WholeAngleEstimate` (without cubic terms), shape (n, n).

    Parameters
    ----------
    recordings : list of Recording
        What was recorded; the signals are far above their noise and enter as they are.
    omega0_rad_s : float
        Frequency about which A is written.
    noise : WaveNoise
    flow : tuple of 2 ndarray
        (A, G), for the size of the noise only.
    has_feedthrough, bodies
        As in the fit: E is an unknown; body frequencies [Hz].
    block_s : float
        Length of a block [s].

    Raises
    ------
    numpy.linalg.LinAlgError
        The recordings do not excite every parameter.
    """
    mean_degc = float(np.mean([r.temperature_degc.mean() for r in recordings]))
    blocks = [_Blocks.of(r, omega0_rad_s, block_s, has_feedthrough, bodies, mean_degc) for r in recordings]
    design = np.vstack([b.columns for b in blocks])
    count, unknowns = design.shape
    both = _real(design)
    covariance = _covariance(blocks, noise, flow, block_s)
    # axis x, then axis y: their unknowns are apart, their noise is not (one temperature moves both)
    stacked = np.zeros((4 * count, 4 * unknowns))
    stacked[: 2 * count, : 2 * unknowns], stacked[2 * count :, 2 * unknowns :] = both, both
    # columns that vanish belong to a temperature that stood still
    warm = [c for c in _warm_columns(blocks, flow[1]) if np.any(c)]
    stacked = np.column_stack([stacked, *warm])
    white = linalg.solve_triangular(linalg.cholesky(covariance, lower=True, overwrite_a=True), stacked, lower=True)
    scale = np.linalg.norm(white, axis=0)
    information = (white / scale).T @ (white / scale)
    if not np.linalg.cond(information) < 1e14:
        raise np.linalg.LinAlgError("The recordings do not excite every parameter: the bound does not exist.")
    bound = np.linalg.inv(information) / np.outer(scale, scale)
    return np.asarray(bound[: 4 * unknowns, : 4 * unknowns])


def _warm_columns(blocks: list[_Blocks], G: ComplexArray) -> list[FloatArray]:
    """What a change of resonance, damping and gain per kelvin adds to all equations, and a temperature that is recorded late: real
    unknowns that both axes share.
    """
    V, late, driven = (np.concatenate([b.warm[k] for b in blocks]) for k in range(3))
    return [np.concatenate([m[:, 0].real, m[:, 0].imag, m[:, 1].real, m[:, 1].imag]) for m in (1j * V, V, 1j * late, driven @ G.T)]


def _real(design: ComplexArray) -> FloatArray:
    """Rows (real parts, imaginary parts), columns (re, im) of each unknown in turn."""
    rows, unknowns = design.shape
    out = np.empty((2 * rows, 2 * unknowns))
    out[:rows, 0::2], out[:rows, 1::2] = design.real, -design.imag
    out[rows:, 0::2], out[rows:, 1::2] = design.imag, design.real
    return out


@dataclass(frozen=True)
class _Blocks:
    """One recording in overlapping triangles: centres, regressors, pick-offs and drives times the rise of temperature, mean detuning."""

    centre_s: FloatArray
    columns: ComplexArray
    warm: tuple[ComplexArray, ComplexArray, ComplexArray]
    detuning: float

    @classmethod
    def of(cls, r: Recording, omega0: float, block_s: float, has_feedthrough: bool, bodies: list[float], mean_degc: float) -> _Blocks:
        width = max(1, round(block_s * r.sample_rate_hz))
        count = len(r) // width

        def blocks(values: ComplexArray) -> ComplexArray:
            return np.asarray(values[: count * width].reshape(count, width, -1).mean(axis=1))

        def triangles(values: ComplexArray) -> ComplexArray:
            """Means of running means of a block's length, one per pair of blocks."""
            total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values[: count * width], axis=0)])
            running = (total[width:] - total[:-width]) / width
            total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(running, axis=0)])
            sums = (total[width:] - total[:-width]) / width
            # a difference of block means is a mean of increments: its centre lies between rows
            return np.asarray(0.5 * (sums[::width][: count - 1] + sums[1::width][: count - 1]))

        detuning = r.ref_omega_rad_s - omega0
        excitation = r.command.excitation
        columns = [triangles(r.pick), triangles(r.drive)]
        if has_feedthrough:
            slope = np.diff(blocks(r.drive), axis=0) * r.sample_rate_hz / width
            columns.append(slope + triangles(1j * detuning[:, None] * r.drive))
        body = [excitation.volts * (excitation.kind == "body" and excitation.frequency_hz == f) for f in bodies]
        if bodies:
            columns.append(np.tile(np.array(body, dtype=complex), (count - 1, 1)))
        rise = (r.temperature_degc - mean_degc)[:, None]
        change = np.gradient(rise, 1.0 / r.sample_rate_hz, axis=0)
        warm = triangles(rise * r.pick), triangles(change * r.pick), triangles(rise * r.drive)
        return cls(triangles(r.t[:, None].astype(complex))[:, 0].real, np.hstack(columns), warm, float(np.mean(detuning)))


def _covariance(blocks: list[_Blocks], noise: WaveNoise, flow: tuple[ComplexArray, ComplexArray], block_s: float) -> FloatArray:
    """Of the noise of all equations: x real, x imaginary, y real, y imaginary parts, each of all blocks in turn."""
    time = np.concatenate([b.centre_s for b in blocks])
    apart = np.abs(time[:, None] - time[None, :])
    gain = float(np.abs(np.diag(flow[1])).mean())
    common = np.zeros_like(apart)
    if noise.flicker_v > 0.0:
        for tau in noise.flicker_times_s:
            common += (gain * noise.flicker_v) ** 2 * _averaged(apart, float(tau), block_s)
    decay, first = -0.5 * float(np.trace(flow[0]).real), 0
    for b in blocks:
        n = b.centre_s.size
        place = slice(first, first + n)
        white = noise.force + noise.pickoff * (b.detuning**2 + decay**2)
        near = np.eye(n, k=1) + np.eye(n, k=-1)
        common[place, place] += white * (2.0 / 3.0 * np.eye(n) + near / 6.0) / block_s
        common[place, place] += noise.pickoff * (2.0 * np.eye(n) - near) / block_s**3
        first += n
    return np.asarray(linalg.block_diag(common, common, common, common))


def _averaged(apart: FloatArray, tau: float, block_s: float) -> FloatArray:
    """Covariance ``exp(-|t|/tau)`` seen through a triangle at either end, at these distances."""
    half = 0.5 * block_s / tau
    far = np.exp(-np.maximum(apart, 2.0 * block_s) / tau) * (math.sinh(half) / half) ** 4
    points = block_s * (np.arange(_FINE) + 0.5 - 0.5 * _FINE) / (0.5 * _FINE)
    weights = 1.0 - np.abs(points) / block_s
    weights /= weights.sum()
    lags = np.linspace(0.0, 2.0 * block_s, 33)
    pairs = points[:, None] - points[None, :]
    near = np.array([weights @ np.exp(-np.abs(lag + pairs) / tau) @ weights for lag in lags])
    return np.where(apart < 2.0 * block_s, np.interp(apart, lags, near), far)
