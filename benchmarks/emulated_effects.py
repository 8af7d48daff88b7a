"""Effects as functions of what a recording holds, by physics alone: nothing here knows the forms of the diagnosis.

Each gives volts, or volts per second, for every row, shape (n, 2): what a pick-off reads besides (``output``), what a drive makes besides
what was commanded (``drive``), or how fast a force moves the wave (``flow``). :mod:`emulated` makes them as loud as is asked.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

__all__ = ["EMULATED", "UNSEEN", "Emulated", "Rows"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


class Rows(Protocol):
    """Rows of a recording: volts (n, 2); time since the campaign began [s], temperature [K], rate [rad/s], frequency [rad/s], each (n,)."""

    index: int
    row_s: float
    omega0_rad_s: float
    pick: ComplexArray
    drive: ComplexArray
    motion: ComplexArray
    time_s: FloatArray
    temperature_k: FloatArray
    rate_rad_s: FloatArray
    omega_rad_s: FloatArray
    is_closed: bool


@dataclass(frozen=True)
class Emulated:
    """One effect.

    Parameters
    ----------
    name : str
    kind : str
        Where it enters.
    signal : callable
        (rows, random numbers of the effect) -> what is added, shape (n, 2).
    registry : tuple of str
        Names of the registry that would be right; none: a stranger.
    """

    name: str
    kind: Literal["output", "drive", "flow"]
    signal: Callable[[Rows, FloatArray], ComplexArray]
    registry: tuple[str, ...] = ()


def _size(x: ComplexArray) -> FloatArray:
    return np.asarray(np.sqrt(np.sum(np.abs(x) ** 2, axis=1, keepdims=True)))


def _unlike(z: FloatArray) -> FloatArray:
    """Weights of both axes, alike in sign, not in size."""
    return np.array([1.0, 1.0 + 0.6 * math.tanh(z[0])])


def _cross(x: ComplexArray) -> ComplexArray:
    return np.asarray(x[:, ::-1])


def _turn(x: ComplexArray) -> ComplexArray:
    return np.stack([-x[:, 1], x[:, 0]], axis=1)


def _split(x: ComplexArray, z: FloatArray) -> ComplexArray:
    """A symmetric, traceless matrix of a drawn axis times x."""
    c, s = math.cos(z[0] * 3.0), math.sin(z[0] * 3.0)
    return np.asarray(x @ np.array([[c, s], [s, -c]]).T)


def _low_pass(x: ComplexArray, tau_s: float, row_s: float) -> ComplexArray:
    a = math.exp(-row_s / tau_s)
    return np.asarray(lfilter([1.0 - a], [1.0, -a], x, axis=0, zi=a * x[:1])[0])


def _rate_of(x: ComplexArray, row_s: float) -> ComplexArray:
    return np.asarray(np.gradient(x, row_s, axis=0))


def _col(x: FloatArray) -> FloatArray:
    return np.asarray(x)[:, None]


def _middle(z: FloatArray) -> float:
    """A time in the middle half of a campaign of some six minutes [s]."""
    return 190.0 + 60.0 * math.tanh(z[1])


def _azimuth(x: ComplexArray) -> FloatArray:
    """psi = 2 theta of the wave, shape (n, 1)."""
    stokes = np.abs(x[:, 0]) ** 2 - np.abs(x[:, 1]) ** 2, 2.0 * (x[:, 0] * x[:, 1].conj()).real
    return _col(0.5 * np.arctan2(stokes[1], stokes[0]))


def _hops(time_s: FloatArray, z: FloatArray, mean_s: float) -> FloatArray:
    """A random telegraph, drawn once for the campaign."""
    rng = np.random.default_rng(int(1e6 * abs(z[2])))
    edges = np.cumsum(rng.exponential(mean_s, 400))
    return _col(np.searchsorted(edges, time_s) % 2.0 - 0.5)


def _random_walk_of(index: int, z: FloatArray) -> float:
    return float(np.random.default_rng([index, int(1e6 * abs(z[3]))]).normal())


def _after_start(r: Rows, tau_s: float) -> FloatArray:
    return _col(np.exp(-(r.time_s - r.time_s[0]) / tau_s))


def _heated(r: Rows, tau_s: float) -> ComplexArray:
    """Power of the drives of some time before."""
    return _low_pass((_size(r.drive) ** 2).astype(complex), tau_s, r.row_s)


def _warming(r: Rows) -> FloatArray:
    """How fast the temperature moves, of 3 s before."""
    return _col(np.gradient(_low_pass(_col(r.temperature_k).astype(complex), 3.0, r.row_s)[:, 0].real, r.row_s))


def _beyond(x: ComplexArray, level: float) -> ComplexArray:
    """What lies beyond a level of each axis."""
    return np.asarray(np.maximum(np.abs(x) - level, 0.0) * x / (np.abs(x) + 1e-9))


def _play(x: ComplexArray) -> ComplexArray:
    """What play of a tenth of its median keeps from each axis."""
    size = np.abs(x)
    width = 0.1 * np.median(size)
    out = size.copy()
    for k in range(1, len(out)):
        out[k] = np.clip(out[k - 1], size[k] - width, size[k] + width)
    return np.asarray((out - size) * x / (size + 1e-9))


E = Emulated
EMULATED: tuple[Emulated, ...] = (
    # -- of the registry --------------------------------------------------------------------------------------------------------------
    E("duffing", "flow", lambda r, z: 1j * _size(r.motion) ** 2 * r.motion, ("duffing", "duffing_axes")),
    E("nonlinear damping", "flow", lambda r, z: -(_size(r.motion) ** 2) * r.motion, ("nonlinear_damping", "nonlinear_damping_axes")),
    E("square damping", "flow", lambda r, z: -_size(r.motion) * r.motion, ("quadratic_damping",)),
    E("cubic cross stiffness", "flow", lambda r, z: 1j * _cross(np.abs(r.motion) ** 2 * r.motion), ("cubic_cross_stiffness",)),
    E("pick-off cubic", "output", lambda r, z: _unlike(z) * np.abs(r.pick) ** 2 * r.pick, ("pickoff_nonlinearity", "pickoff_saturation")),
    E("pick-off phase", "output", lambda r, z: 1j * _unlike(z) * np.abs(r.pick) ** 2 * r.pick, ("pickoff_amplitude_phase",)),
    E("drive cubic", "drive", lambda r, z: _unlike(z) * np.abs(r.drive) ** 2 * r.drive, ("drive_nonlinearity", "drive_saturation")),
    E(
        "drive squared stiffness",
        "drive",
        lambda r, z: np.abs(r.drive) ** 2 * r.motion + 0.5 * r.drive**2 * r.motion.conj(),
        ("drive_stiffness",),
    ),
    E("pick-off gain drift", "output", lambda r, z: _unlike(z) * [1, -1] * _col(r.time_s) * r.pick, ("pickoff_gain_drift",)),
    E("drive gain drift", "drive", lambda r, z: _unlike(z) * [1, -1] * _col(r.time_s) * r.drive, ("drive_gain_drift",)),
    E("damping drift", "flow", lambda r, z: -_col(r.time_s) * r.motion, ("damping_drift",)),
    E("split drift", "flow", lambda r, z: 1j * _col(r.time_s) * _split(r.motion, z), ("split_drift",)),
    E(
        "charge",
        "flow",
        lambda r, z: 1j * _col(1.0 - np.exp(-r.time_s / 90.0)) * _split(r.motion, z),
        ("charge_accumulation", "split_drift"),
    ),
    E("thermal drive gain", "drive", lambda r, z: [1.0, -0.7] * _col(r.temperature_k) * r.drive, ("thermal_drive_gain",)),
    E("thermal pick-off gain", "output", lambda r, z: [1.0, -0.7] * _col(r.temperature_k) * r.pick, ("thermal_pickoff_gain",)),
    E(
        "drive gain curved in temperature",
        "drive",
        lambda r, z: [1.0, -0.7] * _col(r.temperature_k**2) * r.drive,
        ("thermal_drive_gain_curvature",),
    ),
    E(
        "pick-off gain curved in temperature",
        "output",
        lambda r, z: [1.0, -0.7] * _col(r.temperature_k**2) * r.pick,
        ("thermal_pickoff_gain_curvature",),
    ),
    E("thermal split", "flow", lambda r, z: 1j * _col(r.temperature_k) * _split(r.motion, z), ("thermal_split",)),
    E("pick-off lag", "output", lambda r, z: _low_pass(r.pick, 0.02, r.row_s) - r.pick, ("pickoff_lag", "pickoff_memory", "drive_lag")),
    E("relaxation", "flow", lambda r, z: 1j * (_low_pass(r.motion, 0.1, r.row_s) - r.motion), ("relaxation",)),
    E("drive memory", "drive", lambda r, z: _low_pass(r.drive, 0.1, r.row_s), ("drive_memory", "pickoff_memory")),
    E("constant force", "flow", lambda r, z: np.full_like(r.motion, 1.0) * [1.0, 0.6j], ("constant_force", "pickoff_interference")),
    E("pump", "flow", lambda r, z: np.exp(3j * z[0]) * r.motion.conj(), ("parametric_pump",)),
    E("friction", "flow", lambda r, z: -r.motion / (_size(r.motion) + 1e-6), ("coulomb_friction",)),
    # -- strangers: pick-off ----------------------------------------------------------------------------------------------------------
    E("pick-off gain step", "output", lambda r, z: [1.0, 0.0] * _col(np.where(r.time_s > _middle(z), 1.0, 0.0)) * r.pick),
    E("pick-off telegraph", "output", lambda r, z: [1.0, 0.0] * _hops(r.time_s, z, 25.0) * r.pick),
    E("pick-off gain by recording", "output", lambda r, z: np.array([1.0, 0.0]) * _random_walk_of(r.index, z) * r.pick),
    E("pick-off ripple 0.7 Hz", "output", lambda r, z: _col(np.sin(2 * np.pi * 0.7 * r.time_s)) * r.pick),
    E(
        "pick-off integral nonlinearity",
        "output",
        lambda r, z: _unlike(z) * np.sin(11.0 * np.abs(r.pick)) * r.pick / (np.abs(r.pick) + 1e-6),
    ),
    E("pick-off image", "output", lambda r, z: np.exp(3j * z[0]) * r.pick.conj()),
    E("pick-off by the square of the rate", "output", lambda r, z: [1.0, -0.5] * _col(r.rate_rad_s**2) * r.pick),
    E("pick-off eight lobes", "output", lambda r, z: np.cos(4.0 * _azimuth(r.pick) + z[0]) * r.pick),
    E("pick-off two memories", "output", lambda r, z: _low_pass(r.pick, 0.3, r.row_s) + _low_pass(r.pick, 6.0, r.row_s) - 2.0 * r.pick),
    E("feedthrough drift", "output", lambda r, z: _col(r.time_s) * np.exp(3j * z[0]) * r.drive),
    E("feedthrough cubic", "output", lambda r, z: np.exp(3j * z[0]) * np.abs(r.drive) ** 2 * r.drive),
    E("feedthrough by motion", "output", lambda r, z: np.exp(3j * z[0]) * np.abs(r.motion) ** 2 * r.drive),
    E("pick-off cross talk by amplitude", "output", lambda r, z: [0.0, 1.0] * _cross(np.abs(r.pick) * r.pick)),
    # -- strangers: drive -------------------------------------------------------------------------------------------------------------
    E("drive gain step", "drive", lambda r, z: [0.0, 1.0] * _col(np.where(r.time_s > _middle(z), 1.0, 0.0)) * r.drive),
    E("drive hysteresis", "drive", lambda r, z: np.abs(r.drive) * r.drive * (1.0 - 0.42j)),
    E("drive ripple 0.4 Hz", "drive", lambda r, z: _col(np.sin(2 * np.pi * 0.4 * r.time_s + z[0])) * r.drive),
    E("drive droop", "drive", lambda r, z: _low_pass((_size(r.drive) ** 2).astype(complex), 5.0, r.row_s) * r.drive),
    E("drive by the azimuth", "drive", lambda r, z: np.cos(2.0 * _azimuth(r.motion) + z[0]) * r.drive),
    E("drive curved in temperature", "drive", lambda r, z: 1j * _col(r.temperature_k**2) * r.drive),
    E("drive by the motion", "drive", lambda r, z: np.abs(r.motion) ** 2 * r.drive + 0.5 * r.motion**2 * r.drive.conj()),
    E("drive shared reference", "drive", lambda r, z: _size(r.drive) * r.drive),
    # -- strangers: dynamics ----------------------------------------------------------------------------------------------------------
    E("fifth order stiffness", "flow", lambda r, z: 1j * _size(r.motion) ** 4 * r.motion),
    E("root damping", "flow", lambda r, z: -np.sqrt(_size(r.motion)) * r.motion),
    E("gyroscopic energy", "flow", lambda r, z: _size(r.motion) ** 2 * _turn(r.motion)),
    E("bias with temperature", "flow", lambda r, z: _col(r.temperature_k) * _turn(r.motion)),
    E("bias drift", "flow", lambda r, z: _col(r.time_s) * _turn(r.motion)),
    E("bias step", "flow", lambda r, z: _col(np.where(r.time_s > _middle(z), 1.0, 0.0)) * _turn(r.motion)),
    E("bias by drive power", "flow", lambda r, z: _size(r.drive) ** 2 * _turn(r.motion)),
    E("frequency step", "flow", lambda r, z: 1j * _col(np.where(r.time_s > _middle(z), 1.0, 0.0)) * r.motion),
    E("damping step", "flow", lambda r, z: -_col(np.where(r.time_s > _middle(z), 1.0, 0.0)) * r.motion),
    E("split telegraph", "flow", lambda r, z: 1j * _hops(r.time_s, z, 40.0) * _split(r.motion, z)),
    E("anisotropy by amplitude", "flow", lambda r, z: -(_size(r.motion) ** 2) * _split(r.motion, z)),
    E("split by amplitude", "flow", lambda r, z: 1j * _size(r.motion) * _split(r.motion, z)),
    E("damping curved in temperature", "flow", lambda r, z: -_col(r.temperature_k**2) * r.motion),
    E("damping resonance in temperature", "flow", lambda r, z: -_col(1.0 / (1.0 + (r.temperature_k - 4.0) ** 2)) * r.motion),
    E("split resonance in temperature", "flow", lambda r, z: 1j * _col(np.tanh(2.0 * (r.temperature_k - 5.0))) * _split(r.motion, z)),
    E("frequency by heating", "flow", lambda r, z: 1j * _low_pass((_size(r.motion) ** 2).astype(complex), 12.0, r.row_s) * r.motion),
    E("vibration at 3 Hz", "flow", lambda r, z: 1j * _col(np.sin(2 * np.pi * 3.0 * r.time_s)) * _split(r.motion, z)),
)
#: drawn up once the diagnosis had its rules, and none was made for them since but what benchmarks/diagnosis.md says
UNSEEN: tuple[Emulated, ...] = (
    E("pick-off droop by other axis", "output", lambda r, z: np.abs(_cross(r.pick)) ** 2 * r.pick),
    E("pick-off phase drift", "output", lambda r, z: 1j * np.array([1.0, -0.3]) * _col(r.time_s) * r.pick, ("pickoff_phase_drift",)),
    E("drive phase drift", "drive", lambda r, z: 1j * np.array([1.0, -0.3]) * _col(r.time_s) * r.drive, ("drive_phase_drift",)),
    E("pick-off misalignment drift", "output", lambda r, z: np.array([1.0, 0.2]) * _col(r.time_s) * _cross(r.pick)),
    E("drive misalignment with temperature", "drive", lambda r, z: np.array([1.0, 0.5]) * _col(r.temperature_k) * _cross(r.drive)),
    E("pick-off misalignment with temperature", "output", lambda r, z: np.array([1.0, -0.4]) * _col(r.temperature_k) * _cross(r.pick)),
    E("damping anisotropy drift", "flow", lambda r, z: -_col(r.time_s) * _split(r.motion, z)),
    E("warm-up of frequency each start", "flow", lambda r, z: 1j * _after_start(r, 2.0) * r.motion),
    E("warm-up of drive gain each start", "drive", lambda r, z: np.array([1.0, 0.8]) * _after_start(r, 3.0) * r.drive),
    E("warm-up of pick-off gain each start", "output", lambda r, z: np.array([1.0, -0.5]) * _after_start(r, 4.0) * r.pick),
    E("slew-limited pick-off", "output", lambda r, z: 1j * np.array([1.0, 0.8]) * np.abs(r.pick) * r.pick),
    E("knee of pick-off", "output", lambda r, z: -np.array([1.0, 0.7]) * _beyond(r.pick, 0.25)),
    E("knee of drive", "drive", lambda r, z: -np.array([1.0, 0.7]) * _beyond(r.drive, 0.05)),
    E("heat of drive moves frequency", "flow", lambda r, z: 1j * _heated(r, 3.0) * r.motion),
    E("heat of drive moves split", "flow", lambda r, z: 1j * _heated(r, 8.0) * _split(r.motion, z)),
    E("heat of drive moves damping", "flow", lambda r, z: -_heated(r, 8.0) * r.motion),
    E("bias by temperature rate", "flow", lambda r, z: _warming(r) * _turn(r.motion)),
    E("pick-off gain by temperature rate", "output", lambda r, z: np.array([1.0, -0.5]) * _warming(r) * r.pick),
    E("play of drive", "drive", lambda r, z: _play(r.drive)),
    E("damping by rate", "flow", lambda r, z: -_col(r.rate_rad_s**2) * r.motion),
    E("anisotropy by rate", "flow", lambda r, z: -_col(r.rate_rad_s) * _split(r.motion, z)),
    E("pick-off cross by drive power", "output", lambda r, z: _size(r.drive) ** 2 * _cross(r.pick)),
    E("pick-off gain by drive power", "output", lambda r, z: np.array([1.0, 0.3]) * _size(r.drive) ** 2 * r.pick),
    E("damping by squeeze power 1.5", "flow", lambda r, z: -(_size(r.motion) ** 1.5) * r.motion),
    E("cubic of x alone in damping of y", "flow", lambda r, z: -np.array([0.0, 1.0]) * np.abs(_cross(r.motion)) ** 2 * r.motion),
    E("hops of frequency", "flow", lambda r, z: 1j * _hops(r.time_s, z, 20.0) * r.motion),
    E("hops of drive gain", "drive", lambda r, z: np.array([1.0, 0.0]) * _hops(r.time_s, z, 12.0) * r.drive),
    E("hops of rate", "flow", lambda r, z: _hops(r.time_s, z, 15.0) * _turn(r.motion)),
    E("stiction of quadrature", "flow", lambda r, z: 1j * _split(r.motion, z) / (_size(r.motion) + 1e-6)),
    E("slow swing of rate 40 s", "flow", lambda r, z: _col(np.sin(2 * np.pi * r.time_s / 40.0 + z[0])) * _turn(r.motion)),
    E(
        "slow swing of pick-off 25 s",
        "output",
        lambda r, z: np.array([1.0, -1.0]) * _col(np.sin(2 * np.pi * r.time_s / 25.0 + z[0])) * r.pick,
    ),
    E("pick-off 16 lobes", "output", lambda r, z: np.cos(8.0 * _azimuth(r.pick) + z[0]) * r.pick),
    E("drive by four lobes", "drive", lambda r, z: np.cos(4.0 * _azimuth(r.motion) + z[0]) * r.drive),
    E("damping by four lobes", "flow", lambda r, z: -np.cos(4.0 * _azimuth(r.motion) + z[0]) * r.motion),
    E("rate by azimuth two lobes", "flow", lambda r, z: np.cos(4.0 * _azimuth(r.motion) + z[0]) * _turn(r.motion)),
)
